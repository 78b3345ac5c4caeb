"""Steppers of Klipper beside X, Y and Z: what makes them axes of programs, and their limits."""

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
    assert not read_settings(tmp_path / "settings.txt").unheeded


def test_what_a_manual_stepper_does_not_say_is_asked_for(tmp_path: Path) -> None:
    taken = TAKEN.replace("LIMIT_VELOCITY=400 LIMIT_ACCEL=1500 ", "")
    with pytest.raises(OptionError, match=r"rate\.A=.*acceleration\.A="):
        machine(tmp_path, X_ALONE + MANDREL + taken, "rotary=A")


@pytest.mark.parametrize(
    ("text", "axes", "said"),
    [
        (MANDREL, "X", "is left out: no macro of this file makes it an axis"),
        (MANDREL.replace("mandrel", "a"), "XA", "is taken for the axis A"),
    ],
)
def test_a_manual_stepper_without_its_command_is_told(
    tmp_path: Path, text: str, axes: str, said: str
) -> None:
    file = tmp_path / "printer.cfg"
    file.write_text(X_ALONE + text)
    settings = read_settings(file)
    assert "".join(settings.axes) == axes
    assert len(settings.unheeded) == 1 and said in settings.unheeded[0]


@pytest.mark.parametrize(
    ("macro", "said"),
    [
        (TAKEN.replace("GCODE_AXIS=A", "GCODE_AXIS=Y"), "the axis Y; it must be one of A, B"),
        (TAKEN + TAKEN.splitlines()[-1].replace("=A", "=B"), "the axis B here and A on line"),
        (TAKEN + TAKEN.splitlines()[-1].replace("400", "500"), "is 30000 here and 24000 on line"),
        (TAKEN.replace("=400", "=fast"), "LIMIT_VELOCITY is 'FAST'"),
    ],
)
def test_a_manual_stepper_that_is_two_axes_is_refused(
    tmp_path: Path, macro: str, said: str
) -> None:
    file = tmp_path / "printer.cfg"
    file.write_text(X_ALONE + MANDREL + macro + "\n")
    with pytest.raises(MachineError, match=re.escape(said)):
        read_settings(file)


def test_a_value_that_goes_on_in_the_next_line_is_no_number(tmp_path: Path) -> None:
    """A key behind a tab is the rest of the value before it, to Klipper too."""
    file = tmp_path / "printer.cfg"
    file.write_text(X_ALONE + "\tmax_velocity: 20\n")
    with pytest.raises(MachineError, match="max_accel is '3000 max_velocity: 20'"):
        read_settings(file)
