"""The steps of a program, and their times, by Klipper's own host in batch mode.

``THREADLINE_KLIPPER`` names a checkout of Klipper in which ``cp test/configs/linuxprocess.config
.config && make olddefconfig && make`` has made ``out/klipper.dict``, and
``THREADLINE_KLIPPER_PYTHON`` a Python with the packages of its ``scripts/klippy-requirements.txt``.
Klipper is GPL and no part of Threadline: it runs as a separate program, in a separate folder.
"""

from __future__ import annotations

import os
import re
import subprocess
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from threadline.base.arrays import IntArray
from threadline.errors import OptionError, Place, RecordingError
from threadline.machine import Machine
from threadline.machine.motion_planner import KlipperPlanner
from threadline.readback.stepped import Steps

CHECKOUT, PYTHON = "THREADLINE_KLIPPER", "THREADLINE_KLIPPER_PYTHON"
BEGIN_S = 1.25
"""Time at which the program begins, s: Klipper starts 0.25 s ahead, and pauses for 1 s first."""
_RAILS = "XYZ"
_OTHER_AXES = "ABCUVW"
_CLOCK_HZ = 50e6  # CLOCK_FREQ of its Linux process
_FULL, _MICRO = 200, 16
_FAR_MM = 1e6  # mm
_CORNER = 5.0  # mm/s: square_corner_velocity without [planner]
_TIMEOUT_S = 600.0
_REFUSED = re.compile(
    r'Unknown command:"?([^"\n]*)|^!! (.*)$|Traceback|gcode\.CommandError: (.*)', re.M
)


def missing() -> str:
    """Return why Klipper's host cannot be run here, and how to get it; empty if it can."""
    text = f"Klipper's host is not installed: {CHECKOUT} names a checkout of it (docs/equal.md)"
    checkout_name = os.environ.get(CHECKOUT)
    if not checkout_name:
        return text
    checkout = Path(checkout_name)
    for part in ("klippy/klippy.py", "klippy/parsedump.py", "out/klipper.dict"):
        if not (checkout / part).is_file():
            return f"{CHECKOUT} is {checkout_name[:120]}, which has no {part} (docs/equal.md)"
    return ""


def unfit(machine: Machine, axes: Sequence[str]) -> str:
    """Return why Klipper cannot run a job with these axes; empty if it can."""
    for axis in axes:
        if axis in _RAILS and machine.axes[axis].kind != "linear":
            return f"{axis} turns, and Klipper's {axis} is a linear rail"
        if axis not in _RAILS + _OTHER_AXES:
            return f"Klipper has no axis {axis}"
    return ""


def steps_on_klipper(
    program: Path, machine: Machine, axes: Sequence[str], counts: Mapping[str, float]
) -> dict[str, Steps]:
    """Return the steps of every axis for a program that begins at position 0, from time 0 on.

    Parameters
    ----------
    counts
        Steps per mm or degree of each axis.

    Raises
    ------
    OptionError
        If Klipper's host cannot be run.
    RecordingError
        If Klipper's host refuses a word of the program.
    """
    checkout = Path(os.environ[CHECKOUT])
    python = os.environ.get(PYTHON, "python3")
    dictionary = str(checkout.resolve() / "out" / "klipper.dict")
    with tempfile.TemporaryDirectory(prefix="threadline-klipper-") as name:
        folder = Path(name)
        (folder / "printer.cfg").write_text(_printer(machine, axes, counts), encoding="ascii")
        text = program.read_text(encoding="utf-8")
        begin, end = _lines_around(machine, axes)
        (folder / "job.gcode").write_text(f"{begin}{text}\n{end}", encoding="utf-8")
        words = ["printer.cfg", "-i", "job.gcode", "-o", "out.serial", "-d", dictionary]
        messages = _run([python, str(checkout / "klippy" / "klippy.py"), *words], folder, None)
        refusal = _REFUSED.search(messages)
        if refusal is not None:
            reason = next((group for group in refusal.groups() if group), refusal[0])
            raise RecordingError(
                f"Klipper's host refuses the program: {' '.join(reason.split())[:120]}",
                place=Place(str(program)),
                remedy="Compile it again for klipper.",
            )
        script = str(checkout / "klippy" / "parsedump.py")
        dumped = folder / "steps.txt"
        _run([python, script, dictionary, "out.serial"], folder, dumped)
        with dumped.open(encoding="utf-8", errors="replace") as lines:
            return _decoded(lines, _pins(axes))


def _run(words: list[str], folder: Path, output_file: Path | None) -> str:
    """Run a script of Klipper's; return its messages, without the output that goes into a file."""
    try:
        if output_file is None:
            finished = subprocess.run(  # noqa: S603
                words, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
                errors="replace", timeout=_TIMEOUT_S, check=False,
            )  # fmt: skip
            output = finished.stdout
        else:
            with output_file.open("wb") as out:
                finished = subprocess.run(  # noqa: S603
                    words, cwd=folder, stdout=out, stderr=subprocess.PIPE, text=True,
                    errors="replace", timeout=_TIMEOUT_S, check=False,
                )  # fmt: skip
            output = finished.stderr
    except (OSError, subprocess.TimeoutExpired) as error:
        raise OptionError(
            f"Klipper's host does not run: {' '.join(str(error).split())[:160]}",
            remedy=f"{PYTHON} names a Python with Klipper's packages (docs/equal.md).",
        ) from error
    if finished.returncode:
        last = (output.strip().splitlines() or ["without a message"])[-1]
        raise OptionError(
            f"Klipper's host ends with status {finished.returncode}: {last[:160]}",
            remedy=f"{PYTHON} names a Python with Klipper's packages (docs/equal.md).",
        )
    return str(output)


def _pins(axes: Sequence[str]) -> dict[str, str]:
    """Return the axis of each pin that makes steps."""
    others = [axis for axis in axes if axis not in _RAILS]
    rails = {f"gpiochip0/gpio{3 * k}": axis for k, axis in enumerate(_RAILS)}
    return rails | {f"gpiochip0/gpio{9 + 2 * k}": axis for k, axis in enumerate(others)}


def _printer(machine: Machine, axes: Sequence[str], counts: Mapping[str, float]) -> str:
    """Return a printer.cfg with the limits of a machine file."""
    planner = machine.planner if isinstance(machine.planner, KlipperPlanner) else None
    linear = [axis for axis in axes if axis in _RAILS]
    speeds = [1e3 * machine.axes[axis].velocity.si for axis in linear] or [100.0]
    ramps = [1e3 * machine.axes[axis].acceleration.si for axis in linear] or [1000.0]
    lines = ["[mcu]", "serial: /dev/null", "[printer]", "kinematics: cartesian"]
    lines += [
        f"max_velocity: {1e3 * planner.velocity.si if planner else min(speeds):.9g}",
        f"max_accel: {1e3 * planner.acceleration.si if planner else min(ramps):.9g}",
        "square_corner_velocity: "
        f"{1e3 * planner.square_corner_velocity.si if planner else _CORNER:.9g}",
    ]
    if planner is not None:
        lines.append(f"minimum_cruise_ratio: {planner.cruise_ratio:.9g}")
    if "Z" in axes:
        lines += [f"max_z_velocity: {1e3 * machine.axes['Z'].velocity.si:.9g}"]
        lines += [f"max_z_accel: {1e3 * machine.axes['Z'].acceleration.si:.9g}"]
    for k, axis in enumerate(_RAILS):
        lines += [f"[stepper_{axis.lower()}]", *_motor(3 * k, counts.get(axis, 80.0))]
        lines += [
            f"endstop_pin: gpiochip0/gpio{3 * k + 2}", f"position_min: {-_FAR_MM:.0f}",
            f"position_max: {_FAR_MM:.0f}", "position_endstop: 0", "homing_positive_dir: False",
        ]  # fmt: skip
    for k, axis in enumerate(axis for axis in axes if axis not in _RAILS):
        own_acceleration = planner.alone.get(axis) if planner else None
        lines += [f"[manual_stepper axis_{axis.lower()}]", *_motor(9 + 2 * k, counts[axis])]
        lines += [
            f"accel: {_shown(machine, axis, own_acceleration.si) if own_acceleration else 0:.9g}"
        ]
    lines += ["[force_move]", "enable_force_move: True"]
    return "\n".join(lines) + "\n"


def _motor(pin: int, per_unit: float) -> list[str]:
    turn = _FULL * _MICRO / per_unit
    return [
        f"step_pin: gpiochip0/gpio{pin}", f"dir_pin: gpiochip0/gpio{pin + 1}",
        f"microsteps: {_MICRO}", f"rotation_distance: {turn:.12g}",
    ]  # fmt: skip


def _shown(machine: Machine, axis: str, value: float) -> float:
    """Return a value in m or rad as mm or degrees."""
    return 1e3 * value if machine.axes[axis].kind == "linear" else float(np.degrees(value))


def _lines_around(machine: Machine, axes: Sequence[str]) -> tuple[str, str]:
    """Return the lines before and after the program.

    Setting a position makes the host compute all steps so far; at the end of its input it would
    drop those that it has not computed.
    """
    planner = machine.planner if isinstance(machine.planner, KlipperPlanner) else None
    zero_line = "SET_KINEMATIC_POSITION X=0 Y=0 Z=0\n"
    lines = [zero_line]
    for axis in axes:
        if axis in _RAILS:
            continue
        axis_part, jump = machine.axes[axis], planner.jump.get(axis) if planner else None
        lines.append(
            f"MANUAL_STEPPER STEPPER=axis_{axis.lower()} GCODE_AXIS={axis} "
            f"LIMIT_VELOCITY={_shown(machine, axis, axis_part.velocity.si):.9g} "
            f"LIMIT_ACCEL={_shown(machine, axis, axis_part.acceleration.si):.9g} "
            "INSTANTANEOUS_CORNER_VELOCITY="
            f"{_shown(machine, axis, jump.si) if jump else 1.0:.9g}\n"
        )
    return "".join([*lines, "G90\nG4 P1000\n"]), f"M400\n{zero_line}"


def _decoded(lines: Iterator[str], axis_of_pin: Mapping[str, str]) -> dict[str, Steps]:
    """Return the steps of each axis from the commands to the board."""
    axis, sense, clock = dict[str, str](), dict[str, int](), dict[str, int]()
    ticks: dict[str, list[IntArray]] = {}
    senses: dict[str, list[IntArray]] = {}
    for line in lines:
        name, *words = line.split() or [""]
        if name not in {"config_stepper", "set_next_step_dir", "queue_step"}:
            continue
        fields = dict(word.split("=", 1) for word in words if "=" in word)
        oid = fields.get("oid", "")
        if name == "config_stepper":
            axis[oid] = axis_of_pin.get(fields["step_pin"], "")
        elif name == "set_next_step_dir":
            sense[oid] = 1 if fields["dir"] == "1" else -1
        elif axis.get(oid):
            interval, count, add = (int(fields[key]) for key in ("interval", "count", "add"))
            step_ticks = clock.get(oid, 0) + np.cumsum(interval + add * np.arange(count))
            clock[oid] = int(step_ticks[-1])
            ticks.setdefault(axis[oid], []).append(step_ticks)
            senses.setdefault(axis[oid], []).append(np.full(count, sense[oid]))
    return {
        name: Steps(
            time_s=np.concatenate(ticks[name]) / _CLOCK_HZ - BEGIN_S,
            sense=np.concatenate(senses[name]),
        )
        for name in ticks
    }
