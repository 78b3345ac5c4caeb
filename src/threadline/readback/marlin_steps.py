"""The steps of a program by Marlin's own planner, compiled for this computer.

``THREADLINE_MARLIN`` names the folder ``Marlin`` of a checkout of Marlin bugfix-2.1.x, with
``Configuration.h`` and ``src`` in it. Its ``planner.cpp`` and ``motion.cpp`` are compiled as they
are, with ``marlin_program`` in place of all other code. The configuration is the checkout's own,
set to X, Y, Z and a rotary A, without heaters and extruder; the machine file gives limits and
steps. Marlin is GPL and no part of Threadline: it is built and run in a separate folder.

Threadline reads the moves of the program. Marlin's planner turns them into blocks: steps of each
axis, with a trapezoid of speed. Within a block the steps are spread evenly by Bresenham's rule, as
in ``stepper.cpp``, at the instants that follow from the trapezoid.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.commands.boards import read_written
from threadline.errors import OptionError, Place, RecordingError
from threadline.machine import Machine
from threadline.machine.motion_planner import MarlinPlanner
from threadline.motion.path import plan_path, programmed_path
from threadline.motion.path.interpolations import FIRMWARE
from threadline.readback.marlin_program import MAIN
from threadline.readback.stepped import Steps

FOLDER = "THREADLINE_MARLIN"
_AXES = "XYZI"
_NEEDS = ("Configuration.h", "src/MarlinCore.h", "src/module/planner.cpp", "src/module/motion.cpp")
_CONFIGURED = {
    "MOTHERBOARD": "BOARD_SIMULATED",
    "I_DRIVER_TYPE": "A4988",
    "EXTRUDERS": "0",
    "TEMP_SENSOR_0": "0",
    "TEMP_SENSOR_BED": "0",
    "DEFAULT_AXIS_STEPS_PER_UNIT": "{ 80, 80, 80, 80 }",
    "DEFAULT_MAX_FEEDRATE": "{ 300, 300, 300, 300 }",
    "DEFAULT_MAX_ACCELERATION": "{ 3000, 3000, 3000, 3000 }",
    "DEFAULT_IJERK": "0.3",
    "I_MIN_POS": "0",
    "I_MAX_POS": "50",
    "I_HOME_DIR": "-1",
    "I_ENABLE_ON": "0",
    "INVERT_I_DIR": "false",
    "HOMING_FEEDRATE_MM_M": "{ 3000, 3000, 240, 240 }",
    "HOMING_BUMP_MM": "{ 5, 5, 2, 2 }",
    "HOMING_BUMP_DIVISOR": "{ 2, 2, 4, 4 }",
}
_PINS = {"MIN": 70, "STEP": 71, "DIR": 72, "ENABLE": 73, "CS": -1}
# Its arc cosine counts the leading zeros of 0, too; without lzcnt this number is undefined.
_FLAGS = ("-std=gnu++17", "-O1", "-w", "-fpermissive", "-mlzcnt", "-ffunction-sections")
_HELD = re.compile(r"^[ \t]*(?://)?[ \t]*#define[ \t]+(\w+)\b.*$", re.MULTILINE)
_MOST = 1e9  # in place of a limit that the machine does not have
_RING, _SHORT_US = 16, 20_000
_TIMEOUT_S = 600.0


def missing() -> str:
    """Return why Marlin's planner cannot be compiled here, and what it needs; empty if it can."""
    named = os.environ.get(FOLDER)
    if not named:
        return f"Marlin's own planner is missing: {FOLDER} names its folder (docs/equal.md)"
    for part in _NEEDS:
        if not (Path(named) / part).is_file():
            return f"{FOLDER} is {named[:120]}, which has no {part} (docs/equal.md)"
    if shutil.which("c++") is None:
        return "Marlin's own planner is not compiled: there is no C++ compiler c++"
    return ""


def bounds_axes_in_corners(marlin: Path) -> bool:
    """Return whether this Marlin limits its speed through a corner by each axis's acceleration.

    ``corner_axes`` in a machine file says the same about the machine's own Marlin.
    """
    text = (marlin / "src/module/planner.cpp").read_text(encoding="utf-8", errors="replace")
    return "limit_value_by_axis_maximum(block->acceleration" in text


def apart(machine: Machine) -> str:
    """Return how this Marlin differs from the machine file, in words; empty if it does not."""
    planner = machine.planner
    if not isinstance(planner, MarlinPlanner) or planner.jump:
        return ""
    own = bounds_axes_in_corners(Path(os.environ[FOLDER]))
    if own == planner.corner_axes:
        return ""
    return (
        f"the Marlin that {FOLDER} names has corner_axes = {str(own).lower()}, the "
        f"machine file {str(planner.corner_axes).lower()}: speeds in corners may differ"
    )


def unfit(machine: Machine, axes: Sequence[str]) -> str:
    """Return why this Marlin cannot run a job with these axes; empty if it can."""
    turning = [axis for axis in axes if machine.axes[axis].kind == "rotary"]
    if len(turning) > 1:
        return f"it is compiled with one axis that turns, and {' and '.join(turning)} turn"
    if len(axes) - len(turning) > len(_AXES) - 1:
        return "it is compiled with three axes that do not turn"
    return ""


def steps_on_marlin(
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
        If Marlin's planner does not compile.
    RecordingError
        If Marlin's planner fails before the end of the program.
    """
    planner = machine.planner
    assert isinstance(planner, MarlinPlanner)
    column = _columns(machine, axes)
    shown = {axis: 1e3 if machine.axes[axis].kind == "linear" else np.degrees(1.0) for axis in axes}
    words = _settings(planner, machine, column, shown, counts)
    moves = list(_moves(program, machine, column, shown))
    ring = _RING if planner.blocks is None else round(planner.blocks.si)
    with tempfile.TemporaryDirectory(prefix="threadline-marlin-") as name:
        built = compiled(Path(os.environ[FOLDER]), Path(name), jumps=bool(planner.jump), ring=ring)
        rows = run(built, words, moves)
    if rows is None:
        raise RecordingError(
            "Marlin's own planner breaks off",
            place=Place(str(program)),
            remedy="Compile the program again for marlin.",
        )
    return _steps(rows, column)


def compiled(
    marlin: Path, folder: Path, *, jumps: bool, curved: bool = False, ring: int = _RING
) -> Path:
    """Compile Marlin's planner in ``folder``, and return the executable.

    Parameters
    ----------
    jumps
        Whether corners are taken by jumps of speed, not by the deviation of a junction.
    curved
        Whether speeds follow S-curves.
    ring
        Size of the ring of waiting blocks.

    Raises
    ------
    OptionError
        If it does not compile.
    """
    if not (folder / "src").exists():
        passed_by = shutil.ignore_patterns("fontdata", "images", "docs")
        shutil.copytree(marlin / "src", folder / "src", ignore=passed_by)
        for name in ("Configuration.h", "Configuration_adv.h", "Version.h"):
            text = (marlin / name).read_text(encoding="utf-8")
            (folder / name).write_text(_HELD.sub(_configured, text), encoding="utf-8")
        (folder / "main.cpp").write_text(MAIN, encoding="ascii")
    core = (folder / "src/MarlinCore.h").read_text(encoding="utf-8")
    alone = re.search(r"^class Marlin", core, re.MULTILINE) is None
    defined = ["__PLAT_LINUX__", "F_CPU=100000000", "I_ENABLE_ON=0", "INVERT_I_DIR=false"]
    defined += [f"IDLE_ALONE={int(alone)}", f"BLOCK_BUFFER_SIZE={ring}"]
    defined += [f"I_{name}_PIN={pin}" for name, pin in _PINS.items()]
    defined += ["CLASSIC_JERK"] * jumps + ["S_CURVE_ACCELERATION"] * curved
    where = [folder, folder / "src/HAL/LINUX/include"]
    made = folder / f"planner-{int(jumps)}{int(curved)}-{ring}"
    sources = [folder / "main.cpp", folder / "src/module/planner.cpp"]
    words = ["c++", *_FLAGS, *(f"-I{path}" for path in where), *(f"-D{one}" for one in defined)]
    words += [*map(str, sources), str(folder / "src/module/motion.cpp"), "-Wl,--gc-sections"]
    done = subprocess.run(  # noqa: S603
        [*words, "-o", str(made)], capture_output=True, text=True, errors="replace", check=False
    )
    if done.returncode:
        first = next((row for row in done.stderr.splitlines() if "error" in row), "c++ fails")
        raise OptionError(
            f"Marlin's own planner does not compile: {first[:160]}",
            remedy=f"{FOLDER} names the folder Marlin of bugfix-2.1.x (docs/equal.md).",
        )
    return made


def run(built: Path, words: Iterable[str], moves: Iterable[str]) -> list[list[float]] | None:
    """Run the compiled planner on settings and moves; return its rows, None if it fails."""
    process = subprocess.run(  # noqa: S603
        [str(built)], input="\n".join([*words, "go", *moves, ""]), capture_output=True, text=True,
        errors="replace", timeout=_TIMEOUT_S, check=False,
    )  # fmt: skip
    *rows, last = process.stdout.splitlines() or [""]
    if process.returncode or last != "end":
        return None
    return [[float(word) for word in row.split()] for row in rows]


def _configured(found: re.Match[str]) -> str:
    value = _CONFIGURED.get(found[1])
    if found[1] == "BLOCK_BUFFER_SIZE":
        return ""  # it is given to the compiler
    return found[0] if value is None else f"#define {found[1]} {value}"


def _columns(machine: Machine, axes: Sequence[str]) -> dict[str, int]:
    """Return the column of each axis among Marlin's X, Y, Z and rotary I."""
    linear = [axis for axis in axes if machine.axes[axis].kind == "linear"]
    named = {axis: _AXES.index(axis) for axis in linear if axis in _AXES}
    left = [k for k in range(len(_AXES) - 1) if k not in named.values()]
    for axis in linear:
        if axis not in named:
            named[axis] = left.pop(0)
    return {axis: named.get(axis, len(_AXES) - 1) for axis in axes}


def _settings(
    planner: MarlinPlanner,
    machine: Machine,
    column: Mapping[str, int],
    shown: Mapping[str, float],
    counts: Mapping[str, float],
) -> list[str]:
    """Return the lines that set Marlin's planner, in mm, degrees and seconds."""
    rows = {name: np.full(len(_AXES), fill) for name, fill in _FILLED.items()}
    jumps = np.full(len(_AXES), _MOST)
    for axis, k in column.items():
        own = machine.axes[axis]
        rows["steps"][k] = counts[axis]
        rows["rate"][k] = shown[axis] * own.velocity.si
        rows["most"][k] = shown[axis] * own.acceleration.si
        if axis in planner.jump:
            jumps[k] = shown[axis] * planner.jump[axis].si
    deviation = planner.junction_deviation
    corner = jumps if deviation is None else np.array([1e3 * deviation.si])
    travel = _MOST if planner.acceleration is None else 1e3 * planner.acceleration.si
    least = 0.0 if planner.least_speed is None else 1e3 * planner.least_speed.si
    short = _SHORT_US if planner.short_time is None else 1e6 * planner.short_time.si
    rows |= {"travel": np.array([travel]), "least": np.array([least])}
    rows |= {"short": np.array([short]), "corner": corner}
    return [f"{name} {' '.join(f'{value:.9g}' for value in row)}" for name, row in rows.items()]


_FILLED = {"steps": 80.0, "rate": 1000.0, "most": 1000.0}
"""Settings of an axis that the job does not have."""


def _moves(
    program: Path,
    machine: Machine,
    column: Mapping[str, int],
    shown: Mapping[str, float],
) -> Iterator[str]:
    """Yield a line for each move: position of X Y Z I, speed, whether it rests, dwell."""
    own = replace(machine, operator=None)
    path = plan_path(programmed_path(read_written(program, own, "marlin"), own), own, FIRMWARE)
    scale = np.array([shown[axis] for axis in path.axes])
    linear = np.array([machine.axes[axis].kind == "linear" for axis in path.axes])
    for pieces in path:
        way = pieces.coefficients[:, 1] * scale
        ends = pieces.coefficients[:, 0] * scale + way
        straight = np.linalg.norm(way[:, linear], axis=1)
        length = np.where(straight > 0.0, straight, np.abs(way).sum(axis=1))
        for k, end in enumerate(ends):
            place = np.zeros(len(_AXES))
            for axis, value in zip(path.axes, end.tolist(), strict=True):
                place[column[axis]] = value
            nominal_s = float(pieces.nominal_s[k])
            speed = length[k] / nominal_s if nominal_s > 0.0 else _MOST
            rests = int(pieces.rest_after[k])
            move = " ".join(f"{value:.6f}" for value in (*place, min(speed, _MOST)))
            yield f"{move} {rests} {float(pieces.dwell_s[k]):.9g}"


def _steps(rows: Sequence[Sequence[float]], column: Mapping[str, int]) -> dict[str, Steps]:
    """Return the steps of the blocks, one row each, and of the waits between them."""
    now = 0.0
    times: dict[str, list[FloatArray]] = {axis: [] for axis in column}
    senses: dict[str, list[FloatArray]] = {axis: [] for axis in column}
    for row in rows:
        if len(row) == 1:
            now += row[0]
            continue
        events, lasts_s = round(row[4]), row[11]
        at_s = now + event_times(events, *row[5:11])
        for axis, k in column.items():
            count = abs(round(row[k]))
            if count:
                number = np.arange(1, count + 1)
                event = -(-(2 * number - 1) * events // (2 * count))
                times[axis].append(at_s[event - 1])
                senses[axis].append(np.full(count, np.sign(row[k])))
        now += lasts_s
    return {
        axis: Steps(
            time_s=np.concatenate(times[axis]),
            sense=np.concatenate(senses[axis]).astype(np.int64),
        )
        for axis in column
        if times[axis]
    }


def event_times(
    events: int, first: float, top: float, last: float, faster: float, slower: float, gain: float
) -> FloatArray:
    """Return (events,) instants of the steps of a block, s from its start.

    Parameters
    ----------
    first, top, last
        Initial, highest and final speed, steps/s.
    faster, slower
        Number of the step up to which the speed grows, and of the step from which on it falls.
    gain
        Acceleration, steps/s^2.
    """
    up = min(faster, events)
    down = events - max(min(slower, events), up)
    number = np.arange(1.0, events + 1.0)
    grown = np.minimum(number, up)
    speed = np.minimum(np.sqrt(first * first + 2.0 * gain * grown), max(top, first))
    over = grown - (speed * speed - first * first) / (2.0 * gain)
    time_s = (speed - first) / gain + np.maximum(over, 0.0) / speed
    reached = float(speed[-1]) if up else first
    if events > up + down:
        reached = top
        time_s += np.clip(number - up, 0.0, events - up - down) / top
    fallen = np.maximum(number - (events - down), 0.0)
    if down and reached <= last:
        return np.asarray(time_s + fallen / last)
    lower = np.maximum(np.sqrt(np.maximum(reached**2 - 2.0 * gain * fallen, 0.0)), last)
    rest = fallen - (reached**2 - lower**2) / (2.0 * gain)
    return np.asarray(time_s + (reached - lower) / gain + np.maximum(rest, 0.0) / lower)
