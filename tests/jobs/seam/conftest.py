"""A sewing machine for the tests of seams."""

from pathlib import Path

import pytest

from threadline.machine import Machine, load_machine

SEWER = """
base = "lathe-winder"
name = "sewer"
operator = "none"

[axes.X]
velocity = "0.4 m/s exact, assumed"
acceleration = "30 m/s^2 exact, assumed"
jerk = "none"
travel = ["-1 m exact, assumed", "10 m exact, assumed"]

[axes.Y]
velocity = "0.4 m/s exact, assumed"
acceleration = "40 m/s^2 exact, assumed"
jerk = "none"
travel = ["-1 m exact, assumed", "10 m exact, assumed"]

[inputs.x_low]
at = "-1.1 m exact, assumed"

[inputs.x_high]
at = "10.1 m exact, assumed"

[inputs.y_low]
at = "-1.1 m exact, assumed"

[inputs.y_high]
at = "10.1 m exact, assumed"
"""


@pytest.fixture(scope="session")
def sewer(tmp_path_factory: pytest.TempPathFactory) -> Machine:
    """X and Y with room to sew in: 30 and 40 m/s^2, 0.4 m/s, -1 to 10 m."""
    file: Path = tmp_path_factory.mktemp("machine") / "sewer.toml"
    file.write_text(SEWER, encoding="utf-8")
    return load_machine(file)
