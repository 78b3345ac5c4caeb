"""``equal`` for firmwares that plan by themselves: their own code, step by step, if named.

Klipper's host, grbl's code and Marlin's are no packages: ``docs/equal.md`` says how to get them.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

import threadline as tl
from tests.conftest import NO_FIRMWARE
from threadline.machine import load_machine
from threadline.readback import grbl_steps, klipper_host, marlin_steps
from threadline.readback.stepped import Steps, beside

CIRCUIT = "G21 G90\nG1 X60 A490.961 F6000\nG1 A590.961\nG4 P0.2\nG1 X0 A781.922\nG1 A891.922\nM30\n"


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("job") / "c.prg"
    file.write_text(CIRCUIT)
    return file


def needs(missing: str) -> None:
    if missing:
        pytest.skip(f"{NO_FIRMWARE}{missing}")


def machine_with(board: str, folder: Path) -> Path:
    """Return the stepper winder with a planner, of the version of the named Marlin."""
    file = folder / "mine.toml"
    text = f'base = "stepper-winder+{board}"\nname = "mine"\n'
    if board == "marlin" and not marlin_steps.missing():
        own = marlin_steps.bounds_axes_in_corners(Path(os.environ[marlin_steps.FOLDER]))
        text += f"[planner]\ncorner_axes = {str(own).lower()}\n"
    file.write_text(text)
    return file


@pytest.mark.parametrize("target", ["csv", "grbl", "klipper", "marlin", "reprapfirmware"])
def test_a_winders_program_is_the_plan_on_each_of_its_boards(
    job: Path, target: str, tmp_path: Path
) -> None:
    """The stepper winder with each planner, whose plan is the firmware's own motion of the job."""
    board = "grbl" if target == "csv" else target
    machine = machine_with(board, tmp_path)
    found = tl.equal(job, machine, [target], interpolation="firmware")
    (one,) = found.targets
    assert found.passed and one.verdict in {"equal", "read back"}
    if one.verdict == "read back":
        # Without the firmware's own code its model gives the time.
        assert one.place is not None and one.place < 1e-9
        assert one.curve is not None and one.curve.time_s[0] == 0.0  # drawn from the beginning
        assert one.time_s is not None and one.time_limit_s is not None
        assert abs(one.time_s) < one.time_limit_s
        assert bool(one.missing) == (target in {"grbl", "klipper", "marlin"})


def test_klippers_host_makes_each_step_of_the_plan(job: Path, tmp_path: Path) -> None:
    """Within half a step, to which ends are rounded; a digit of an end, a wait and F is found."""
    needs(klipper_host.missing())
    machine = "stepper-winder+klipper"
    (one,) = tl.equal(job, machine, ["klipper"], interpolation="firmware").targets
    assert (one.reader, one.verdict, one.unit) == ("Klipper's host", "equal", "step")
    assert one.place is not None and 0.0 < one.place < 0.5
    file = tmp_path / "c.gcode"
    tl.compile(job, machine, "klipper", file, interpolation="firmware")
    text = file.read_text()
    for wrong, message in [
        (text.replace("A490.961", "A491.961"), "place"),
        (text.replace("G4 P200", "G4 P300"), "time"),
        (text.replace("F2160.28", "F1160.28"), "time"),
    ]:
        assert wrong != text
        file.write_text(wrong)
        files = [f"klipper={file}"]
        (one,) = tl.equal(job, machine, files=files, interpolation="firmware").targets
        assert one.verdict == "differs" and one.place is not None and one.place > 1.0
        if message == "time":
            assert one.time_s is not None and one.time_limit_s is not None
            assert abs(one.time_s) > one.time_limit_s


def test_grbls_own_code_follows_the_plan(job: Path, tmp_path: Path) -> None:
    """Within a step of each axis of the path; a changed wait and a changed end are found."""
    needs(grbl_steps.missing())
    machine = "stepper-winder+grbl"
    (one,) = tl.equal(job, machine, ["grbl"], interpolation="firmware").targets
    assert (one.reader, one.verdict, one.unit) == ("grbl's own code", "equal", "m")
    assert one.time_s is not None and 0.0 < one.time_s < 0.012
    file = tmp_path / "c.nc"
    tl.compile(job, machine, "grbl", file, interpolation="firmware")
    text = file.read_text()
    for digit, to in (("A490.961", "A491.961"), ("G4 P0.2", "G4 P0.3")):
        assert digit in text
        file.write_text(text.replace(digit, to))
        files = [f"grbl={file}"]
        (one,) = tl.equal(job, machine, files=files, interpolation="firmware").targets
        assert one.verdict == "differs"
        if digit[0] == "A":
            # 1 degree at 50 mm, all but along the path: 0.87 mm times 60 mm by 432 mm.
            assert one.place is not None and 1.0e-4 < one.place < 1.6e-4
        else:
            assert one.time_s == pytest.approx(0.1, abs=0.012)


def test_marlins_own_planner_follows_the_plan(job: Path, tmp_path: Path) -> None:
    """Within a step of each axis of the path; a changed end, wait and feed are found."""
    needs(marlin_steps.missing())
    machine = machine_with("marlin", tmp_path)
    (one,) = tl.equal(job, machine, ["marlin"], interpolation="firmware").targets
    assert (one.reader, one.verdict, one.unit) == ("Marlin's own planner", "equal", "m")
    assert one.time_s is not None and abs(one.time_s) < 0.003
    file = tmp_path / "c.gcode"
    tl.compile(job, machine, "marlin", file, interpolation="firmware")
    text = file.read_text()
    for digit, to in (("A490.961", "A491.961"), ("G4 P200", "G4 P300"), ("X0 F2", "X0 F1")):
        assert digit in text
        file.write_text(text.replace(digit, to))
        (one,) = tl.equal(job, machine, files=[f"marlin={file}"], interpolation="firmware").targets
        assert one.verdict == "differs" and one.place is not None and one.time_s is not None
        if digit[0] == "A":
            assert 1.0e-4 < one.place < 1.6e-4
        else:
            assert abs(one.time_s) > 0.09


def test_another_marlin_than_the_machines_is_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """An older planner has other times in corners; the machine file has to name it."""
    code = tmp_path / "src/module/planner.cpp"
    code.parent.mkdir(parents=True)
    code.write_text("x = limit_value_by_axis_maximum(block->acceleration, way);")
    monkeypatch.setenv(marlin_steps.FOLDER, str(tmp_path))
    machine = load_machine("stepper-winder+marlin")
    assert "corner_axes = true" in marlin_steps.apart(machine)
    code.write_text("x = block->acceleration;")
    assert marlin_steps.apart(machine) == ""


@pytest.mark.parametrize("short", [True, False])
def test_steps_of_a_block_come_as_its_trapezoid_says(short: bool) -> None:
    """400 or 30 steps from 100 to 100 steps/s, 1000 at most, by 5000 steps/s^2."""
    count, up, first, top, gain = (
        (30, 15, 100.0, 1000.0, 5e3) if short else (400, 99, 1e2, 1e3, 5e3)
    )
    at_s = marlin_steps.event_times(count, first, top, first, up, count - up, gain)
    peak = np.sqrt(first**2 + 2.0 * gain * up)
    ramp_s = (peak - first) / gain
    assert at_s[up - 1] == pytest.approx(ramp_s, rel=1e-9)
    cruise_s = 0.0 if short else (count - 2 * up) / top
    assert at_s[-1] == pytest.approx(2.0 * ramp_s + cruise_s, rel=6e-3)
    each_s = np.diff(np.append(0.0, at_s))
    assert (each_s > 0.0).all()
    np.testing.assert_allclose(each_s, each_s[::-1], rtol=1e-9)


def test_missing_firmware_reader_is_named(job: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The variable is named, and so is a folder that is no checkout."""
    monkeypatch.delenv(klipper_host.CHECKOUT, raising=False)
    monkeypatch.delenv(grbl_steps.FOLDER, raising=False)
    monkeypatch.delenv(marlin_steps.FOLDER, raising=False)
    targets = ["klipper", "grbl", "marlin"]
    found = tl.equal(job, "stepper-winder+klipper", targets, interpolation="firmware")
    assert marlin_steps.FOLDER in found.missing["marlin"]
    assert klipper_host.CHECKOUT in found.missing["klipper"]
    assert grbl_steps.FOLDER in found.missing["grbl"]
    assert found.passed and {one.verdict for one in found.targets} == {"read back"}
    monkeypatch.setenv(klipper_host.CHECKOUT, "/nonexistent")
    assert "has no klippy/klippy.py" in klipper_host.missing()
    monkeypatch.setenv(grbl_steps.FOLDER, "/nonexistent")
    assert "has no gcode.c" in grbl_steps.missing()
    monkeypatch.setenv(marlin_steps.FOLDER, "/nonexistent")
    assert "has no Configuration.h" in marlin_steps.missing()


def test_steps_beside_a_motion(job: Path) -> None:
    """Steps made by hand from a plan: none off, and 3 steps or 20 ms off where they are moved."""
    found = tl.equal(job, "stepper-winder+klipper", ["csv"], interpolation="firmware")
    trajectory = found.plan.motion.trajectory
    table = found.plan.commands
    counts, radius = table.counts_per_unit, found.plan.machine.radius_m[[0, 1]]
    fine_s = np.linspace(0.0, trajectory.duration_s, 400_000)
    start = trajectory(np.zeros(1))[0]
    steps = {}
    for k, axis in enumerate(trajectory.axes):
        places = (trajectory(fine_s)[:, k] - start[k]) * counts[k]
        level = np.floor(places + 0.5)
        at = np.flatnonzero(np.diff(level))
        steps[axis] = Steps(fine_s[at + 1], np.diff(level)[at].astype(np.int64))
    difference = beside(steps, trajectory, counts, start, radius)
    assert difference.off < 0.5 and abs(difference.late_s) < 1e-4 and difference.path_m < 40e-6
    x = steps["X"]
    late = Steps(x.time_s + np.where(x.time_s > 3.0, 0.02, 0.0), x.sense)
    difference = beside({**steps, "X": late}, trajectory, counts, start, radius)
    assert difference.axis == "X" and difference.off > 20.0
    begin = Steps(np.concatenate([[0.0] * 3, x.time_s]), np.concatenate([[1] * 3, x.sense]))
    difference = beside({**steps, "X": begin}, trajectory, counts, start, radius)
    assert difference.axis == "X" and 2.9 < difference.off < 3.1
    del steps["A"]
    assert beside(steps, trajectory, counts, start, radius).axis == "A"
