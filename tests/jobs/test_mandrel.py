"""A mandrel acts at its radius beside the carriage: a cone, compared with closed forms."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.jobs.made_machines import made_machine
from threadline.cli.main import main
from threadline.commands.plan import Plan
from threadline.errors import MachineError, OptionError
from threadline.jobs import read_job
from threadline.jobs.feed_times import programmed_time_s
from threadline.machine import Machine, load_machine
from threadline.machine.radii import with_radii, written_out
from threadline.motion.path import plan_path, programmed_path
from threadline.proof.options import Options
from threadline.proof.pipeline import plan_job
from threadline.verdict.deviation import measure_path_deviation

CONE = """[axes.A.profile]
along = "X"
at = ["0 mm exact, measured", "100 mm exact, measured"]
radius = ["10 mm exact, measured", "50 mm exact, measured"]
"""


def with_cone(folder: Path, text: str = CONE) -> Machine:
    """A carriage X along a cone of 10 mm at X 0 and 50 mm at X 100, mandrel A."""
    base = made_machine(folder, "X", "A")
    file = folder / "cone.toml"
    file.write_text(f'base = "{Path(base.file).name}"\nname = "cone"\n{text}')
    return load_machine(file)


def judged_deviation_m(machine: Machine, folder: Path, at_mm: float, name: str) -> float:
    """Return a reversal of A at one place of X: 30 degrees forth and back."""
    path = folder / "reversal.nc"
    path.write_text(f"G0 X{at_mm}\nG1 F6000 A30\nA0\nM30\n")
    job = read_job(path, machine)
    programmed = programmed_path(job, machine)
    planned = plan_path(programmed, machine, name)
    plan = plan_of(job, machine, programmed, planned)
    (found,) = measure_path_deviation(plan)
    assert found.value is not None
    return found.value


def plan_of(job: object, machine: Machine, programmed: object, planned: object) -> Plan:
    """Return a plan with the two paths alone: the deviation of a path needs nothing else."""
    whole = plan_job(job, machine, Options(interpolation="b-spline"))  # type: ignore[arg-type]
    motion = replace(whole.motion, programmed=programmed, path=planned)
    return replace(whole, intent=motion)


@pytest.mark.parametrize(("at_mm", "radius_mm"), [(0.0, 10.0), (25.0, 20.0), (100.0, 50.0)])
def test_a_reversal_is_missed_by_what_the_mandrel_has_there(
    tmp_path: Path, at_mm: float, radius_mm: float
) -> None:
    """A plain B-spline misses its middle point by |P0 - 2 P1 + P2| / 6: here 10 degrees of A."""
    missed = judged_deviation_m(with_cone(tmp_path), tmp_path, at_mm, "b-spline")
    assert missed == pytest.approx(radius_mm / 1000 * math.radians(10.0), rel=1e-6)


@pytest.mark.parametrize("name", ["auto", "parabolic", "optimal"])
def test_the_tolerance_is_kept_by_the_radius_beside(tmp_path: Path, name: str) -> None:
    """A zigzag of A along the cone: each corner may be cut by the tolerance at its own radius.

    At 10 mm the same length is five times as many degrees as at 50 mm, so that the turning points
    are cut by more degrees there. Earlier paths used the largest radius everywhere, and left less
    than the tolerance by that share.
    """
    machine = with_cone(tmp_path)
    path = tmp_path / "zigzag.nc"
    words = [f"X{5 * k} A{30 * (k % 2)}" for k in range(1, 21)]
    path.write_text("G1 F6000\n" + "\n".join(words) + "\nM30\n")
    job = read_job(path, machine)
    programmed = programmed_path(job, machine)
    planned = plan_path(programmed, machine, name, tolerance_m=1e-4)
    (found,) = measure_path_deviation(plan_of(job, machine, programmed, planned))
    assert found.value is not None and found.value <= 1.0e-4
    cut = {}
    for block in planned:
        c = block.coefficients
        ends = np.concatenate([c[:, 0], c.sum(axis=1)])
        for k in (1, 19):  # odd corners, at 30 degrees
            near = np.abs(ends[:, programmed.axes.index("X")] - 0.005 * k) < 1e-3
            if near.any():
                top = ends[near, programmed.axes.index("A")].max()
                cut[k] = max(cut.get(k, -np.inf), top)
    missed = {k: math.radians(30.0) - top for k, top in cut.items()}
    assert missed[1] > 2.0 * missed[19] > 0.0


def test_feeds_have_the_largest_radius(tmp_path: Path) -> None:
    machine = with_cone(tmp_path)
    assert machine.radius_m[list(machine.axes).index("A")] == pytest.approx(0.05)
    path = tmp_path / "turn.nc"
    path.write_text("G1 F6000 A90\nM30\n")
    job = read_job(path, machine)
    assert programmed_time_s(job, machine) == pytest.approx(math.pi / 2 * 0.05 / 0.1)


def test_a_job_brings_its_profile_as_a_table(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The recording keeps the rows, so that it is judged alike when the table is gone."""
    machine = with_cone(tmp_path)
    table = tmp_path / "mandrel.csv"
    table.write_text("X_mm,radius_mm\n0,10\n100,30\n")
    (tmp_path / "there.nc").write_text("G1 F6000 X25 A30\nX50 A0\nM30\n")
    spec, trace = tmp_path / "spec.toml", tmp_path / "a.npz"
    spec.write_text(
        'name = "any"\n[[criteria]]\nname = "path_deviation"\n[[criteria]]\n'
        'name = "contour_error"\n'
    )
    common = [str(tmp_path / "there.nc"), "-m", str(machine.file), "-s", str(spec)]
    run("prove", *common, "--radius", f"A={table}", "--recording", str(trace), "--json")
    printed = json.loads(capsys.readouterr().out)
    assert printed["options"]["radius"] == "A=10 mm at X 0 mm; 30 mm at X 100 mm"
    table.unlink()
    run("judge", str(trace), "-s", str(spec), "--json")
    judged = json.loads(capsys.readouterr().out)
    assert judged["criteria"][0] == printed["criteria"][0]
    assert judged["criteria"][0]["name"] == "path_deviation"


def run(*arguments: str) -> None:
    with pytest.raises(SystemExit):
        main(list(arguments))


@pytest.mark.parametrize(
    "text",
    [
        "A=4 mm at X", "A=4 mm at X 0 mm", "A=4 mm at Q 0 mm; 5 mm at Q 1 mm", "A=4 at X 0 mm",
        "A=4 mm at X 0 mm; 5 mm at A 9 mm", "A=4 mm at X 0 mm; 5 mm at X 0 mm",
        "A=4 mm at X 0 mm; 0 mm at X 1 mm", "A=4 mm at X 0 mm; 5",
        "X=4 mm at X 0 mm; 5 mm at X 9 mm",
        "A=4 mm at X 0 mm; 5 mm at X -1 mm",
    ],
)  # fmt: skip
def test_a_profile_that_is_none_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(OptionError, match="--radius"):
        with_radii(with_cone(tmp_path), text)


@pytest.mark.parametrize(
    "text", ["", "X_mm\n1\n", "a,b\n1,2\n", "X_mm,radius_mm\n1\n", "radius_mm,radius_mm\n1,2\n"]
)
def test_a_table_that_is_none_is_refused(tmp_path: Path, text: str) -> None:
    table = tmp_path / "mandrel.csv"
    table.write_text(text)
    with pytest.raises(OptionError, match=r"mandrel\.csv"):
        written_out(f"A={table}")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (CONE.replace('"X"', '"Q"'), "does not exist"),
        (CONE.replace('"X"', '"A"'), "a rotary axis"),
        (CONE.replace("100 mm", "-5 mm"), "increase"),
        (f'[axes.A]\nradius = "1 mm exact, assumed"\n{CONE}', "replaces its radius"),
        (CONE.replace(', "50 mm exact, measured"', ""), "2 positions and 1 radii"),
    ],
)  # fmt: skip
def test_a_profile_in_a_machine_file_is_checked(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(MachineError, match=message):
        with_cone(tmp_path, text)
