"""Klipper's own host in batch mode: every step that it would let a board make, and when.

``THREADLINE_KLIPPER`` names a checkout of Klipper in which ``cp test/configs/linuxprocess.config
.config && make olddefconfig && make`` has made ``out/klipper.dict``, and
``THREADLINE_KLIPPER_PYTHON`` a Python with the packages of its ``scripts/klippy-requirements.txt``.
"""

from __future__ import annotations

import os
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from threadline.base.arrays import FloatArray

STEP_MM, STEP_DEG = 40.0 / 3200.0, 360.0 / 3200.0
_CLOCK_HZ = 50e6  # CLOCK_FREQ of its Linux process
_PINS = "step_pin: gpiochip0/gpio{0}\ndir_pin: gpiochip0/gpio{1}\nmicrosteps: 16\n"
_RAIL = """rotation_distance: 40
endstop_pin: gpiochip0/gpio{0}
position_min: -5000
position_max: 5000
position_endstop: 0
homing_positive_dir: False
"""
_PRINTER = """[mcu]
serial: /dev/null
[force_move]
enable_force_move: True
[printer]
kinematics: cartesian
max_velocity: {velocity}
max_accel: {acceleration}
square_corner_velocity: {corner}
"""
_MANDREL = (
    "[manual_stepper mandrel]\n" + _PINS.format(9, 10) + "rotation_distance: 360\naccel: {alone}\n"
)
_BEGIN = """SET_KINEMATIC_POSITION X=0 Y=0 Z=0
MANUAL_STEPPER STEPPER=mandrel GCODE_AXIS=A LIMIT_VELOCITY={turning} LIMIT_ACCEL={spinning} \
INSTANTANEOUS_CORNER_VELOCITY={instant}
G90
G4 P1000
"""
# Setting a position makes it compute every step; at the end of its input it drops the rest.
_END = "M400\nSET_KINEMATIC_POSITION X=0 Y=0 Z=0\n"


@dataclass(frozen=True, slots=True, eq=False)
class Steps:
    """Steps of a motor: the time of each, and the places before and after it, in steps."""

    time_s: FloatArray
    middle: FloatArray


def installed() -> tuple[Path, str] | None:
    """Return the checkout and its Python; None if they are not named."""
    checkout = os.environ.get("THREADLINE_KLIPPER")
    if checkout is None:
        return None
    return Path(checkout), os.environ.get("THREADLINE_KLIPPER_PYTHON", "python3")


def steps_on_klipper(
    moves: str, folder: Path, limits: dict[str, float], klipper: tuple[Path, str]
) -> dict[str, Steps]:
    """Return the steps of X and A for ``moves`` from zero on.

    Parameters
    ----------
    limits
        ``velocity`` and ``acceleration`` of X, ``turning`` and ``spinning`` of A, ``corner``, the
        square corner velocity; ``instant`` and ``alone`` of A, its step of speed at corners and its
        acceleration in moves of its own (0 for that of all moves); in mm and degrees.
    """
    checkout, python = klipper
    rails = "".join(
        f"[stepper_{axis}]\n{_PINS.format(3 * k, 3 * k + 1)}{_RAIL.format(3 * k + 2)}"
        for k, axis in enumerate("xyz")
    )
    (folder / "printer.cfg").write_text(
        _PRINTER.format(**limits) + rails + _MANDREL.format(**limits)
    )
    (folder / "job.gcode").write_text(f"{_BEGIN.format(**limits)}{moves}{_END}")
    dictionary = checkout / "out" / "klipper.dict"
    words = ["printer.cfg", "-i", "job.gcode", "-o", "out.serial", "-d", str(dictionary)]
    for script, given in (
        ("klippy.py", words),
        ("parsedump.py", [str(dictionary), "out.serial"]),
    ):
        ran = subprocess.run(
            [python, str(checkout / "klippy" / script), *given],
            cwd=folder, capture_output=True, text=True, timeout=300, check=False,
        )  # fmt: skip
        assert ran.returncode == 0, ran.stdout[-500:] + ran.stderr[-2000:]
        unknown = [line for line in ran.stderr.splitlines() if "Unknown command" in line]
        assert not unknown, unknown[0]
    return _steps(ran.stdout)


def _steps(dump: str) -> dict[str, Steps]:
    named = {"gpiochip0/gpio0": "X", "gpiochip0/gpio9": "A"}
    axis: dict[str, str] = {}
    sense, clock, place = dict[str, int](), dict[str, int](), dict[str, int]()
    found: dict[str, list[tuple[float, float]]] = {"X": [], "A": []}
    for line in dump.splitlines():
        name, *words = line.split()
        values = dict(word.split("=", 1) for word in words if "=" in word)
        oid = values.get("oid", "")
        if name == "config_stepper":
            axis[oid] = named.get(values["step_pin"], "")
        elif name == "set_next_step_dir":
            sense[oid] = 1 if values["dir"] == "1" else -1
        elif name == "queue_step" and axis[oid]:
            interval = int(values["interval"])
            for _ in range(int(values["count"])):
                clock[oid] = clock.get(oid, 0) + interval
                interval += int(values["add"])
                before = place.get(oid, 0)
                place[oid] = before + sense[oid]
                found[axis[oid]].append((clock[oid] / _CLOCK_HZ, before + 0.5 * sense[oid]))
    return {name: Steps(*np.array(rows).reshape(-1, 2).T) for name, rows in found.items()}
