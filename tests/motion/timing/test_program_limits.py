"""Limits that a program sets by ``SET_VELOCITY_LIMIT`` and M204, as Klipper plans with them.

``test_firmwares_themselves.py`` compares them with Klipper's own host, step by step.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest

from tests.jobs.made_machines import made_machine
from tests.motion.timing.test_firmwares_themselves import KLIPPER, compiled_with, number
from threadline.errors import JobError
from threadline.jobs import read_job
from threadline.machine import Machine, load_machine
from threadline.motion.path import plan_path, programmed_path
from threadline.motion.timing import plan_trajectory

PLANNER = replace(KLIPPER, minimum_cruise_ratio=number("0", ""))


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    """A machine with 100 mm/s and 500 mm/s^2 in Klipper's settings."""
    base = made_machine(tmp_path, "XY", "", '[programs]\ndialect = "klipper"\n')
    file = tmp_path / "measured.toml"
    axes = "".join(
        f'[axes.{axis}]\nvelocity = "100 mm/s exact, assumed"\n'
        'acceleration = "500 mm/s^2 exact, assumed"\n'
        for axis in "XY"
    )
    file.write_text(f'base = "{Path(base.file).name}"\nname = "measured"\n{axes}')
    return replace(load_machine(file), planner=PLANNER)


def time_s(folder: Path, machine: Machine, *lines: str) -> float:
    program = folder / "job.gcode"
    program.write_text("\n".join(lines) + "\n")
    job = read_job(program, machine)
    path = plan_path(programmed_path(job, machine), machine, "firmware")
    return plan_trajectory(path, machine).duration_s


def ramped_s(distance: float, speed: float, acceleration: float) -> float:
    """Time from rest to rest: the distance at the speed, and a ramp more."""
    return distance / speed + speed / acceleration


@pytest.mark.parametrize(
    ("message", "speed", "acceleration"),
    [
        ("SET_VELOCITY_LIMIT ACCEL=250", 100, 250),
        ("set_velocity_limit velocity=50 accel=250 # slowly", 50, 250),
        ("SET_VELOCITY_LIMIT VELOCITY=150 ACCEL=900", 150, 900),
        ("M204 S1000", 100, 1000),
        ("M204 P300 T400", 100, 300),
        ("M204 P300", 100, 500),
        ("SET_VELOCITY_LIMIT COLOUR=7", 100, 500),
    ],
)
def test_a_move_takes_its_time_at_the_limits_of_the_program(
    tmp_path: Path, machine: Machine, message: str, speed: float, acceleration: float
) -> None:
    found = time_s(tmp_path, machine, message, "G1 X100 F60000")
    assert found == pytest.approx(ramped_s(100.0, speed, acceleration), rel=1e-9)


def test_limits_hold_for_the_moves_behind_their_line_alone(
    tmp_path: Path, machine: Machine
) -> None:
    lines = ["G1 X100 F60000", "G4 P0", "SET_VELOCITY_LIMIT ACCEL=100", "G1 X0", "G4 P0"]
    again = ["M204 S500", "SET_VELOCITY_LIMIT VELOCITY=20", "G1 X50"]
    expected = ramped_s(100, 100, 500) + ramped_s(100, 100, 100) + ramped_s(50, 20, 500)
    assert time_s(tmp_path, machine, *lines, *again) == pytest.approx(expected, rel=1e-9)


def test_a_corner_of_90_degrees_is_passed_at_the_lower_of_both_corner_speeds(
    tmp_path: Path, machine: Machine
) -> None:
    lines = ["SET_VELOCITY_LIMIT SQUARE_CORNER_VELOCITY=8", "G1 X100 F60000"]
    for message, speed in ((3, 3.0), (20, 8.0)):
        turn = [f"SET_VELOCITY_LIMIT SQUARE_CORNER_VELOCITY={message}", "G1 Y100"]
        found = time_s(tmp_path, machine, *lines, *turn)
        saved = speed / 500.0 - (speed**2 / 1000.0) / 100.0  # of a ramp, less its way at the top
        assert found == pytest.approx(2.0 * (ramped_s(100, 100, 500) - saved), rel=1e-9)


def test_the_least_share_at_constant_speed_is_the_programs(
    tmp_path: Path, machine: Machine
) -> None:
    """Half of 10 mm at one speed: the ramps have 5 mm at 250 mm/s^2 in the second plan."""
    lines = ["SET_VELOCITY_LIMIT MINIMUM_CRUISE_RATIO=0.5", "G1 X10 F60000"]
    top = math.sqrt(2 * 250.0 * 5.0)
    assert time_s(tmp_path, machine, *lines) == pytest.approx(ramped_s(10, top, 500), rel=1e-9)
    older = ["SET_VELOCITY_LIMIT ACCEL=500 ACCEL_TO_DECEL=250", "G1 X10 F60000"]
    assert time_s(tmp_path, machine, *older) == pytest.approx(ramped_s(10, top, 500), rel=1e-9)


def test_lines_that_move_nothing_stay_in_what_is_compiled_for_klipper(tmp_path: Path) -> None:
    own = [
        "EXCLUDE_OBJECT_START NAME=a", "SET_PRESSURE_ADVANCE ADVANCE=0.04",
        "SET_VELOCITY_LIMIT ACCEL=300",
    ]  # fmt: skip
    lines = ["G1 X50 F6000", *own, "G1 X90 A40", "EXCLUDE_OBJECT_END"]
    blocks = compiled_with(tmp_path, lines, "A", "klipper", "klipper")
    at = [blocks.index(line) for line in own]
    assert at == sorted(at)
    moves = [k for k, block in enumerate(blocks) if block.startswith("G1 ")]
    assert moves[0] < at[0] < at[-1] < moves[-1] < blocks.index("EXCLUDE_OBJECT_END")


def test_macros_are_a_rest_where_they_are_left_out(tmp_path: Path, machine: Machine) -> None:
    lines = ["PRINT_START BED=60", "G1 X100 F60000", "PEN_UP", "G1 X200", "PEN_UP"]
    program = tmp_path / "job.gcode"
    program.write_text("\n".join(lines) + "\n")
    with pytest.raises(JobError, match=r"PRINT_START runs a macro.*--axes macros=none"):
        read_job(program, machine)
    job = read_job(program, machine, axes="macros=none")
    assert "macros, first seen: PRINT_START (line 1), PEN_UP (line 3)" in job.warnings[0]
    path = plan_path(programmed_path(job, machine), machine, "firmware")
    found = plan_trajectory(path, machine).duration_s
    assert found == pytest.approx(2.0 * ramped_s(100, 100, 500), rel=1e-9)
    (tmp_path / "of").mkdir()
    written = "\n".join(
        compiled_with(tmp_path / "of", lines, "A", "klipper", "klipper", "macros=none")
    )
    assert written.count("PEN_UP") == 2 and written.count("PRINT_START BED=60") == 1
