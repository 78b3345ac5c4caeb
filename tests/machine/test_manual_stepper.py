"""Steppers of Klipper beside X, Y and Z: how they become axes of programs, and their limits."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest

from tests.machine.test_firmware import KLIPPER, machine
from threadline.errors import MachineError, OptionError
from threadline.machine.firmware import read_settings
from threadline.machine.motion_planner import KlipperPlanner

MANDREL = """[manual_stepper mandrel]
microsteps: 16
rotation_distance: 360
velocity: 50   # of MANUAL_STEPPER MOVE, not of programs
accel: 700
"""
TAKEN = """[gcode_macro WIND]
gcode:
    G28 X
    MANUAL_STEPPER STEPPER=mandrel GCODE_AXIS=A LIMIT_VELOCITY=400 LIMIT_ACCEL=1500 """ + (
    "INSTANTANEOUS_CORNER_VELOCITY=20\n"
)
X_ALONE = KLIPPER.replace(KLIPPER[KLIPPER.index("[stepper_y]") : KLIPPER.index("[printer]")], "")


def test_a_manual_stepper_of_klipper_is_the_axis_that_a_macro_makes_it(tmp_path: Path) -> None:
    """400 deg/s and 1500 deg/s^2, from that command; 200 x 16 microsteps for 360 degrees."""
    own = machine(tmp_path, X_ALONE + MANDREL + TAKEN, "rotary=A")
    assert math.degrees(own.axes["A"].velocity.si) == pytest.approx(400.0)
    assert math.degrees(own.axes["A"].acceleration.si) == pytest.approx(1500.0)
    assert own.counts_per_unit[own.axis_names.index("A")] * math.radians(1.0) == pytest.approx(
        3200 / 360
    )
    assert isinstance(own.planner, KlipperPlanner)
    assert math.degrees(own.planner.jump["A"].si) == pytest.approx(20.0)
    assert math.degrees(own.planner.alone["A"].si) == pytest.approx(700.0)
    assert not read_settings(tmp_path / "settings.txt").ignored


def test_missing_limits_of_a_manual_stepper_are_requested(tmp_path: Path) -> None:
    taken = TAKEN.replace("LIMIT_VELOCITY=400 LIMIT_ACCEL=1500 ", "")
    with pytest.raises(OptionError, match=r"rate\.A=.*acceleration\.A="):
        machine(tmp_path, X_ALONE + MANDREL + taken, "rotary=A")


@pytest.mark.parametrize(
    ("text", "axes", "message"),
    [
        (MANDREL, "X", "is omitted: no macro of this file makes it an axis"),
        (MANDREL.replace("mandrel", "a"), "XA", "is read as the axis A"),
    ],
)
def test_a_manual_stepper_without_its_command_is_told(
    tmp_path: Path, text: str, axes: str, message: str
) -> None:
    file = tmp_path / "printer.cfg"
    file.write_text(X_ALONE + text)
    settings = read_settings(file)
    assert "".join(settings.axes) == axes
    assert len(settings.ignored) == 1 and message in settings.ignored[0]


@pytest.mark.parametrize(
    ("macro", "message"),
    [
        (TAKEN.replace("GCODE_AXIS=A", "GCODE_AXIS=Y"), "the axis Y; it must be one of A, B"),
        (TAKEN + TAKEN.splitlines()[-1].replace("=A", "=B"), "the axis B here and A on line"),
        (TAKEN + TAKEN.splitlines()[-1].replace("400", "500"), "is 500 here and 400 on line"),
        (TAKEN.replace("=400", "=fast"), "LIMIT_VELOCITY is 'FAST'"),
    ],
)
def test_a_manual_stepper_that_is_two_axes_is_refused(
    tmp_path: Path, macro: str, message: str
) -> None:
    file = tmp_path / "printer.cfg"
    file.write_text(X_ALONE + MANDREL + macro + "\n")
    with pytest.raises(MachineError, match=re.escape(message)):
        read_settings(file)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("rotation_distance: 360", "rotation_distance: -360", "rotation_distance is '-360'"),
        ("rotation_distance: 360", "rotation_distance: 1e300", "rotation_distance is '1e300'"),
        ("rotation_distance: 360", "rotation_distance: 1e8", "rotation_distance is '1e8' at"),
        ("microsteps: 16\nrot", "microsteps: 0\nrot", "microsteps is '0'"),
        (
            "microsteps: 16\nrot",
            "microsteps: 16.5\nrot",
            "microsteps is '16.5'; it must be a whole",
        ),
        ("LIMIT_VELOCITY=400", "LIMIT_VELOCITY=-400", "LIMIT_VELOCITY is '-400'"),
        ("GCODE_AXIS=A", "GCODE_AXIS=AB", "GCODE_AXIS=AB is not an axis"),
    ],
)
def test_an_error_quotes_what_is_typed_and_its_line(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    file = tmp_path / "printer.cfg"
    own = MANDREL + TAKEN
    assert own.count(old) == 1
    file.write_text(X_ALONE + own.replace(old, new))
    line = X_ALONE.count("\n") + own[: own.index(old)].count("\n") + 1
    with pytest.raises(
        MachineError, match=re.escape(f"printer.cfg:{line}: ") + ".*" + re.escape(message)
    ):
        read_settings(file)


def test_a_comment_makes_no_axis(tmp_path: Path) -> None:
    file = tmp_path / "printer.cfg"
    for mark in ("; ", "# "):
        file.write_text(X_ALONE + MANDREL + TAKEN.replace("MANUAL", mark + "MANUAL"))
        settings = read_settings(file)
        assert list(settings.axes) == ["X"]
        assert "is omitted" in settings.ignored[0]


def test_an_axis_that_is_taken_away_again_is_told(tmp_path: Path) -> None:
    file = tmp_path / "printer.cfg"
    file.write_text(X_ALONE + MANDREL + TAKEN + "    MANUAL_STEPPER STEPPER=mandrel GCODE_AXIS=\n")
    settings = read_settings(file)
    assert list(settings.axes) == ["X", "A"]
    assert len(settings.ignored) == 1 and "removes the axis again" in settings.ignored[0]


def test_two_steppers_of_one_letter_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "printer.cfg"
    second = MANDREL.replace("mandrel", "carriage")
    also = TAKEN.splitlines()[-1].replace("mandrel", "carriage")
    file.write_text(text := X_ALONE + MANDREL + second + TAKEN + also + "\n")
    last = text.count("\n")
    message = f"printer.cfg:{last}: carriage is the axis A here, and mandrel on line {last - 1}"
    with pytest.raises(MachineError, match=re.escape(message)):
        read_settings(file)


def test_a_value_that_goes_on_in_the_next_line_is_no_number(tmp_path: Path) -> None:
    """For Klipper, too, a key behind a tab is the rest of the previous value."""
    file = tmp_path / "printer.cfg"
    file.write_text(X_ALONE + "\tmax_velocity: 20\n")
    with pytest.raises(MachineError, match="max_accel is '3000 max_velocity: 20'"):
        read_settings(file)
