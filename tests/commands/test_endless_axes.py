"""Firmwares that store positions in single precision, and an axis that turns without end."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest

from tests.jobs.in_dialects import moves
from tests.jobs.made_machines import made_machine
from threadline.commands.plan import Plan
from threadline.errors import PlanError
from threadline.jobs import read_job
from threadline.machine import Machine
from threadline.proof.options import Options
from threadline.proof.pipeline import open_job, plan_job, write


@pytest.fixture(scope="module")
def xa(tmp_path_factory: pytest.TempPathFactory) -> Machine:
    return made_machine(tmp_path_factory.mktemp("xa"), "X", "A", '[programs]\nfeed_mode = "grbl"\n')


def planned(folder: Path, machine: Machine, layers: int, rest: str) -> Plan:
    """Return the plan of layers that each turn A on by 40 000 deg and then rest."""
    lines = ["G21 G90", "G1 X0 A0 F1000000"]
    for layer in range(1, layers + 1):
        lines += [f"G1 X{10 * (layer % 2)} A{40_000 * layer}.25", rest]
    job = folder / "job.nc"
    job.write_text("\n".join([*lines, "M30", ""]))
    chosen = Options(dialect="grbl", interpolation="linear")  # type: ignore[arg-type]
    return plan_job(open_job(job, machine, chosen), machine, chosen)


@pytest.mark.parametrize(("target", "word"), [("marlin", "G92.9"), ("reprapfirmware", "G92")])
def test_whole_turns_are_taken_off_where_the_job_rests(
    tmp_path: Path, xa: Machine, target: str, word: str
) -> None:
    """Each written position differs from its single-precision number by less than 0.004 degrees."""
    plan = planned(tmp_path, xa, 5, "G4 P0.5")
    path = tmp_path / "out.gcode"
    write(plan, target, path)
    text = path.read_text()
    assert [line for line in text.splitlines() if line.startswith(word)]
    numbers = [float(n) for n in re.findall(r"A(-?[0-9.]+)", text)]
    assert max(numbers) < 60_000
    assert all(abs(float(np.float32(n)) - n) < 0.004 for n in numbers)
    ends = [move.target[-1] for move in moves(read_job(path, xa, dialect=target))]
    assert math.degrees(ends[-1]) == pytest.approx(200_000.25)


def test_a_small_number_is_left_alone(tmp_path: Path, xa: Machine) -> None:
    write(planned(tmp_path, xa, 1, "G4 P0.5"), "klipper", tmp_path / "k.gcode")
    assert "G92" not in (tmp_path / "k.gcode").read_text()


@pytest.mark.parametrize(
    ("target", "rest", "remedy"),
    [
        ("grbl", "G4 P0.5", "Cut the job into programs"),
        ("fluidnc", "G4 P0.5", "Cut the job into programs"),
        ("marlin", "", "Let the job rest between its parts"),
    ],
)
def test_a_number_that_the_firmware_cannot_keep_is_refused(
    tmp_path: Path, xa: Machine, target: str, rest: str, remedy: str
) -> None:
    path = tmp_path / "out.nc"
    with pytest.raises(PlanError, match="stores positions in 24 bits, in steps of") as caught:
        write(planned(tmp_path, xa, 20, rest), target, path)
    assert remedy in str(caught.value)
    assert not path.exists()


@pytest.mark.parametrize("target", ["klipper", "linuxcnc"])
def test_double_precision_turns_on(tmp_path: Path, xa: Machine, target: str) -> None:
    path = tmp_path / "out.nc"
    write(planned(tmp_path, xa, 20, "G4 P0.5"), target, path)
    assert "A800000.25" in path.read_text()
