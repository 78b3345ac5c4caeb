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
from threadline.errors import Place, RecordingError
from threadline.machine import Machine
from threadline.machine.motion_planner import MarlinPlanner
from threadline.motion.path import plan_path, programmed_path
from threadline.motion.path.interpolations import FIRMWARE
from threadline.readback.marlin_program import MAIN
from threadline.readback.stepped import Steps, compile_code

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
_DEFINITION = re.compile(r"^[ \t]*(?://)?[ \t]*#define[ \t]+(\w+)\b.*$", re.MULTILINE)
_NO_LIMIT = 1e9  # in place of a limit that the machine does not have
_RING, _SHORT_US = 16, 20_000
_TIMEOUT_S = 600.0


def missing() -> str:
    """Return why Marlin's planner cannot be compiled here, and what it needs; empty if it can."""
    folder_name = os.environ.get(FOLDER)
    if not folder_name:
        return f"Marlin's own planner is missing: {FOLDER} names its folder (docs/equal.md)"
    for part in _NEEDS:
        if not (Path(folder_name) / part).is_file():
            return f"{FOLDER} is {folder_name[:120]}, which has no {part} (docs/equal.md)"
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
    corner_axes = bounds_axes_in_corners(Path(os.environ[FOLDER]))
    if corner_axes == planner.corner_axes:
        return ""
    return (
        f"the Marlin that {FOLDER} names has corner_axes = {str(corner_axes).lower()}, the "
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
            (folder / name).write_text(_DEFINITION.sub(_configured, text), encoding="utf-8")
        (folder / "main.cpp").write_text(MAIN, encoding="ascii")
    core_text = (folder / "src/MarlinCore.h").read_text(encoding="utf-8")
    outside_class = re.search(r"^class Marlin", core_text, re.MULTILINE) is None
    defined = ["__PLAT_LINUX__", "F_CPU=100000000", "I_ENABLE_ON=0", "INVERT_I_DIR=false"]
    defined += [f"IDLE_ALONE={int(outside_class)}", f"BLOCK_BUFFER_SIZE={ring}"]
    defined += [f"I_{name}_PIN={pin}" for name, pin in _PINS.items()]
    defined += ["CLASSIC_JERK"] * jumps + ["S_CURVE_ACCELERATION"] * curved
    include_folders = [folder, folder / "src/HAL/LINUX/include"]
    executable = folder / f"planner-{int(jumps)}{int(curved)}-{ring}"
    sources = [folder / "main.cpp", folder / "src/module/planner.cpp"]
    words = [
        "c++",
        *_FLAGS,
        *(f"-I{path}" for path in include_folders),
        *(f"-D{definition}" for definition in defined),
    ]
    words += [*map(str, sources), str(folder / "src/module/motion.cpp"), "-Wl,--gc-sections"]
    remedy = f"{FOLDER} names the folder Marlin of bugfix-2.1.x (docs/equal.md)."
    compile_code([*words, "-o", str(executable)], "Marlin's own planner", remedy)
    return executable


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


def _configured(match: re.Match[str]) -> str:
    value = _CONFIGURED.get(match[1])
    if match[1] == "BLOCK_BUFFER_SIZE":
        return ""  # it is given to the compiler
    return match[0] if value is None else f"#define {match[1]} {value}"


def _columns(machine: Machine, axes: Sequence[str]) -> dict[str, int]:
    """Return the column of each axis among Marlin's X, Y, Z and rotary I."""
    linear = [axis for axis in axes if machine.axes[axis].kind == "linear"]
    columns = {axis: _AXES.index(axis) for axis in linear if axis in _AXES}
    free_columns = [k for k in range(len(_AXES) - 1) if k not in columns.values()]
    for axis in linear:
        if axis not in columns:
            columns[axis] = free_columns.pop(0)
    return {axis: columns.get(axis, len(_AXES) - 1) for axis in axes}


def _settings(
    planner: MarlinPlanner,
    machine: Machine,
    column: Mapping[str, int],
    shown: Mapping[str, float],
    counts: Mapping[str, float],
) -> list[str]:
    """Return the lines that set Marlin's planner, in mm, degrees and seconds."""
    rows = {name: np.full(len(_AXES), fill) for name, fill in _DEFAULT_SETTINGS.items()}
    jumps = np.full(len(_AXES), _NO_LIMIT)
    for axis, k in column.items():
        axis_part = machine.axes[axis]
        rows["steps"][k] = counts[axis]
        rows["rate"][k] = shown[axis] * axis_part.velocity.si
        rows["most"][k] = shown[axis] * axis_part.acceleration.si
        if axis in planner.jump:
            jumps[k] = shown[axis] * planner.jump[axis].si
    deviation = planner.junction_deviation
    corner = jumps if deviation is None else np.array([1e3 * deviation.si])
    travel = _NO_LIMIT if planner.acceleration is None else 1e3 * planner.acceleration.si
    least = 0.0 if planner.least_speed is None else 1e3 * planner.least_speed.si
    short = _SHORT_US if planner.short_time is None else 1e6 * planner.short_time.si
    rows |= {"travel": np.array([travel]), "least": np.array([least])}
    rows |= {"short": np.array([short]), "corner": corner}
    return [f"{name} {' '.join(f'{value:.9g}' for value in row)}" for name, row in rows.items()]


_DEFAULT_SETTINGS = {"steps": 80.0, "rate": 1000.0, "most": 1000.0}
"""Settings of an axis that the job does not have."""


def _moves(
    program: Path,
    machine: Machine,
    column: Mapping[str, int],
    shown: Mapping[str, float],
) -> Iterator[str]:
    """Yield a line for each move: position of X Y Z I, speed, whether it rests, dwell."""
    own_machine = replace(machine, operator=None)
    path = plan_path(
        programmed_path(read_written(program, own_machine, "marlin"), own_machine),
        own_machine,
        FIRMWARE,
    )
    scale = np.array([shown[axis] for axis in path.axes])
    linear = np.array([machine.axes[axis].kind == "linear" for axis in path.axes])
    for pieces in path:
        displacements = pieces.coefficients[:, 1] * scale
        ends = pieces.coefficients[:, 0] * scale + displacements
        linear_length = np.linalg.norm(displacements[:, linear], axis=1)
        length = np.where(linear_length > 0.0, linear_length, np.abs(displacements).sum(axis=1))
        for k, end in enumerate(ends):
            place = np.zeros(len(_AXES))
            for axis, value in zip(path.axes, end.tolist(), strict=True):
                place[column[axis]] = value
            nominal_s = float(pieces.nominal_s[k])
            speed = length[k] / nominal_s if nominal_s > 0.0 else _NO_LIMIT
            rests = int(pieces.rest_after[k])
            move = " ".join(f"{value:.6f}" for value in (*place, min(speed, _NO_LIMIT)))
            yield f"{move} {rests} {float(pieces.dwell_s[k]):.9g}"


def _steps(rows: Sequence[Sequence[float]], column: Mapping[str, int]) -> dict[str, Steps]:
    """Return the steps of the blocks, one row each, and of the waits between them."""
    now_s = 0.0
    times: dict[str, list[FloatArray]] = {axis: [] for axis in column}
    senses: dict[str, list[FloatArray]] = {axis: [] for axis in column}
    for row in rows:
        if len(row) == 1:
            now_s += row[0]
            continue
        events, lasts_s = round(row[4]), row[11]
        at_s = now_s + event_times(events, *row[5:11])
        for axis, k in column.items():
            count = abs(round(row[k]))
            if count:
                number = np.arange(1, count + 1)
                event = -(-(2 * number - 1) * events // (2 * count))
                times[axis].append(at_s[event - 1])
                senses[axis].append(np.full(count, np.sign(row[k])))
        now_s += lasts_s
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
    events_up = min(faster, events)
    events_down = events - max(min(slower, events), events_up)
    number = np.arange(1.0, events + 1.0)
    events_faster = np.minimum(number, events_up)
    speed = np.minimum(np.sqrt(first * first + 2.0 * gain * events_faster), max(top, first))
    events_cruising = events_faster - (speed * speed - first * first) / (2.0 * gain)
    time_s = (speed - first) / gain + np.maximum(events_cruising, 0.0) / speed
    speed_reached = float(speed[-1]) if events_up else first
    if events > events_up + events_down:
        speed_reached = top
        time_s += np.clip(number - events_up, 0.0, events - events_up - events_down) / top
    events_slower = np.maximum(number - (events - events_down), 0.0)
    if events_down and speed_reached <= last:
        return np.asarray(time_s + events_slower / last)
    falling_speed = np.maximum(
        np.sqrt(np.maximum(speed_reached**2 - 2.0 * gain * events_slower, 0.0)), last
    )
    events_at_last = events_slower - (speed_reached**2 - falling_speed**2) / (2.0 * gain)
    return np.asarray(
        time_s
        + (speed_reached - falling_speed) / gain
        + np.maximum(events_at_last, 0.0) / falling_speed
    )
