"""A machine whose controller plans by itself reaches every point at which a path goes back.

grbl, Marlin, Klipper and LinuxCNC stop where the next block goes back along the present one, so a
drilled hole is as deep as written. A program compiled for them must be as deep, too.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from tests.jobs.made_machines import made_machine
from threadline.commands.plan import Plan
from threadline.proof.options import Options
from threadline.proof.pipeline import open_job, plan_job, write

PLANNER = '[planner]\nkind = "grbl"\njunction_deviation = "0.01 mm exact, assumed"\n'
DRILLED = (
    "G21 G90\nG0 X10 Y10 Z2\nG1 Z-5 F300\nG0 Z2\nX20\nG1 Z-3.25\nZ2 F900\nG0 X30\nG1 Z-5 F300\n"
    "Z-5\nG0 Z2\nX0 Y0\nM30\n"
)


def planned(folder: Path, text: str, more: str, **options: object) -> Plan:
    machine = made_machine(folder, "XYZ", "", f'{more}[programs]\ndialect = "grbl"\n')
    (folder / "job.nc").write_text(text)
    chosen = Options(**options)  # type: ignore[arg-type]
    return plan_job(open_job(folder / "job.nc", machine, chosen), machine, chosen)


def lowest_mm(made: Plan, hole_x_mm: float) -> float:
    """Return the lowest Z of the motion within 1 mm of a hole."""
    times = np.arange(0.0, made.motion.trajectory.duration_s, 1e-4)
    places_mm = 1e3 * made.motion.trajectory(times)
    return float(places_mm[np.abs(places_mm[:, 0] - hole_x_mm) < 1.0, 2].min())


@pytest.mark.parametrize("interpolation", ["auto", "optimal", "parabolic"])
def test_a_hole_is_as_deep_as_written(tmp_path: Path, interpolation: str) -> None:
    made = planned(tmp_path, DRILLED, PLANNER, interpolation=interpolation)
    found = [lowest_mm(made, x) for x in (10.0, 20.0, 30.0)]
    # The samples are 0.1 ms apart, and the rest is between two of them.
    assert found == pytest.approx([-5.0, -3.25, -5.0], abs=1e-4)
    write(made, "grbl", tmp_path / "out.nc")
    depths = [float(z) for z in re.findall(r"Z(-[0-9.]+)", (tmp_path / "out.nc").read_text())]
    assert depths.count(-5.0) == 2 and depths.count(-3.25) == 1


def test_only_a_path_that_goes_back_along_itself_is_stopped(tmp_path: Path) -> None:
    """Within a degree; a needle of two degrees is rounded within the tolerance, like any corner."""
    rests = {}
    for beside_mm in (0.0, 0.1, 0.4):
        text = f"G1 X-1 Y-1 F600\nX10\nX0 Y{beside_mm - 1.0}\nM30\n"
        folder = tmp_path / f"{beside_mm}"
        folder.mkdir()
        path = planned(folder, text, PLANNER, interpolation="auto").motion.path
        rests[beside_mm] = sum(int(block.rest_after.sum()) for block in path)
    assert rests == {0.0: 2, 0.1: 2, 0.4: 1}


@pytest.mark.parametrize("target", ["grbl", "linuxcnc", "klipper"])
def test_an_axis_stays_until_the_program_moves_it(tmp_path: Path, target: str) -> None:
    """The operator left Z above the work: a rounded corner would bring it to 0.

    Firmwares go to the place of the hole first, and then along Z.
    """
    text = "G21 G90\nG0 X20 Y10\nG0 Z5\nG1 Z-1 F300\nX30\nG0 Z5\nM30\n"
    made = planned(tmp_path, text, PLANNER, interpolation="auto")
    (file,) = write(made, target, tmp_path / "out.nc")
    lines = (tmp_path / "out.nc").read_text().splitlines()
    (at,) = [k for k, line in enumerate(lines) if "X20 Y10" in line]
    assert not any("Z" in line for line in lines[: at + 1] if line[0] != ";")
    assert re.fullmatch(r"(G0 )?Z(5|4\.\d+)( F[0-9.]+)?", lines[at + 1])
    assert not any("where job.nc first moves it" in warning for warning in file.warnings)


def test_without_a_planner_the_tolerance_holds(tmp_path: Path) -> None:
    """The controllers of other machines follow the planned motion."""
    made = planned(tmp_path, DRILLED, "", interpolation="auto")
    for x, depth in ((10.0, -5.0), (20.0, -3.25), (30.0, -5.0)):
        assert depth + 0.02 < lowest_mm(made, x) <= depth + 0.1
