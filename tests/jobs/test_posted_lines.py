"""Lines as posts write them: line ends and comments that controls accept and editors hide."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.jobs.in_dialects import millimetres, read
from tests.jobs.made_machines import made_machine
from threadline.errors import JobError
from threadline.machine import Machine


@pytest.fixture(scope="module")
def xyza(tmp_path_factory: pytest.TempPathFactory) -> Machine:
    return made_machine(tmp_path_factory.mktemp("xyza"), "XYZ", "A")


@pytest.mark.parametrize("dialect", ["grbl", "fluidnc", "linuxcnc", "marlin", "winder"])
def test_a_carriage_return_behind_the_line_feed_ends_no_line(
    tmp_path: Path, xyza: Machine, dialect: str
) -> None:
    """Gcodetools' templates for lasers end lines with LF CR; controls read the CR as a blank."""
    text = "G21\n\rG90\n\rG1 X5 F600\n\rG1 X7\n\rM30\n\r"
    assert [p[0] for p in millimetres(read(tmp_path, xyza, text, dialect))] == [5, 7]
    with pytest.raises(JobError, match="0x0D in column"):
        read(tmp_path, xyza, "G1 X5 F600 \rX7\nM30\n", dialect)


def test_grbl_ends_a_comment_at_its_first_bracket(tmp_path: Path, xyza: Machine) -> None:
    """``protocol.c``: text after ( is dropped up to the first ), or to the end of the line."""
    text = "(REPLACE (CUT); (CUT) S9 (on))\nG1 X5 (a (b) F600\nX7 (open G1 Y9\nX8 (M (8) ; (Y4\n"
    assert [p[:2] for p in millimetres(read(tmp_path, xyza, text, "grbl"))] == [
        (5, 0), (7, 0), (8, 0),
    ]  # fmt: skip
    with pytest.raises(JobError, match="is closed and not opened"):
        read(tmp_path, xyza, "G1 X5 F600\nX7 (a (b) Y9)\n", "grbl")
    for line in ("X7 (a (b) Y9", "X7 (open"):
        with pytest.raises(JobError, match="is opened and not closed"):
            read(tmp_path, xyza, f"G1 X5 F600\n{line}\nM2\n", "linuxcnc")
