"""Each rotary axis acts at a radius of its own: the machine's, the axis', or the job's."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from tests.jobs.made_machines import made_machine
from threadline.cli.main import main
from threadline.errors import MachineError, OptionError
from threadline.jobs import read_job
from threadline.jobs.feed_times import programmed_time_s
from threadline.machine import Machine, load_machine
from threadline.machine.radii import with_radii
from threadline.motion.path import path_deviation, plan_path, programmed_path

EYE = '[axes.B]\nradius = "2 mm exact, assumed: half of a band of 4 mm"\n'


def with_eye(folder: Path, text: str = EYE) -> Machine:
    """Return mandrel A at the tool's 50 mm, carriage X, an eye that rolls at half of its band."""
    base = made_machine(folder, "X", "AB")
    file = folder / "eye.toml"
    file.write_text(f'base = "{Path(base.file).name}"\nname = "eye"\n{text}')
    return load_machine(file)


def roll(folder: Path, machine: Machine, words: str = "B90 B0") -> object:
    path = folder / "roll.nc"
    path.write_text("G1 F6000\n" + "\n".join(words.split()) + "\nM30\n")
    return read_job(path, machine)


def test_an_eye_rolls_at_its_band_and_not_at_the_mandrel(tmp_path: Path) -> None:
    """F 6000 is 0.1 m/s of the arc: 90 degrees forth and back at 2 mm, and of A at 50 mm.

    A plain B-spline misses its middle point by |P0 - 2 P1 + P2| / 6: 30 degrees here, which are
    1.05 mm at the band and would be 26 mm at the mandrel.
    """
    machine = with_eye(tmp_path)
    for axis, radius_m in (("A", 0.05), ("B", 0.002)):
        job = roll(tmp_path, machine, f"{axis}90 {axis}0")
        assert programmed_time_s(job, machine) == pytest.approx(math.pi * radius_m / 0.1)
        programmed = programmed_path(job, machine)
        found = path_deviation(programmed, plan_path(programmed, machine, "b-spline"))
        assert found.at_tool_m == pytest.approx(radius_m * math.radians(30.0), rel=1e-6)


def test_a_job_brings_its_mandrel(tmp_path: Path) -> None:
    machine = with_radii(with_eye(tmp_path), "A=40 mm, B = 0.1 in")
    assert machine.radius_m.tolist() == pytest.approx([1.0, 0.04, 0.00254])
    job = roll(tmp_path, machine, "A90")
    assert programmed_time_s(job, machine) == pytest.approx(math.pi / 2 * 0.04 / 0.1)


def test_the_command_line_takes_a_radius(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The nominal time follows, the recording remembers it, and judge plans with it again."""
    roll(tmp_path, with_eye(tmp_path), "A90")
    spec, trace = tmp_path / "spec.toml", tmp_path / "a.npz"
    spec.write_text('name = "any"\n[[criteria]]\nname = "path_deviation"\n')
    common = [str(tmp_path / "roll.nc"), "-m", str(tmp_path / "eye.toml"), "-s", str(spec)]
    run("prove", *common, "--radius", "A=25 mm", "--recording", str(trace), "--json")
    printed = json.loads(capsys.readouterr().out)
    assert printed["nominal_s"] == pytest.approx(math.pi / 2 * 0.025 / 0.1)
    assert printed["options"]["radius"] == "A=25 mm"
    run("judge", str(trace), "-s", str(spec), "--json")
    assert json.loads(capsys.readouterr().out)["nominal_s"] == printed["nominal_s"]


def run(*arguments: str) -> None:
    with pytest.raises(SystemExit):
        main(list(arguments))


@pytest.mark.parametrize(
    "text", ["A", "X=4 mm", "Q=4 mm", "A=4", "A=4 deg", "A=-1 mm", "A=0 mm", "A=4 mm, A=5 mm"]
)
def test_a_radius_that_is_none_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(OptionError, match="--radius"):
        with_radii(with_eye(tmp_path), text)


def test_a_line_has_no_radius_and_a_tool_may_be_left_out(tmp_path: Path) -> None:
    with pytest.raises(MachineError, match="a linear axis has no radius"):
        with_eye(tmp_path, '[axes.X]\nradius = "2 mm exact, assumed"\n')
    both = EYE + '[axes.A]\nradius = "30 mm exact, assumed"\n'
    assert with_eye(tmp_path, 'tool = "none"\n' + both).radius_m.tolist() == [1.0, 0.03, 0.002]
    with pytest.raises(MachineError, match=r"'tool' is missing: it gives the radius of .* axis A"):
        with_eye(tmp_path, 'tool = "none"\n' + EYE)
