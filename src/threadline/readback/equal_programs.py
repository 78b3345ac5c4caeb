"""Comparison of part programs with a plan, for ``equal``: their path and their clock."""

from __future__ import annotations

import math
import os
import re
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.commands.boards import BOARDS, read_written
from threadline.commands.firmware_program import as_run_times_s
from threadline.commands.plan import Plan
from threadline.errors import OptionError, Place, RecordingError
from threadline.jobs.operations import Job, Move
from threadline.readback.equal_found import Curve, Found

TIME_SHARE = 1e-3
"""Share of the plan's time by which the clock of a program with times may differ."""
_RS274 = "rs274"
_TIMEOUT_S = 300.0
_CALL = re.compile(r"(?:N(\S*)\s+)?\b([A-Z_]+)\(([^()]*)\)")
_TIMED = re.compile(r"^N(\d+)\b.*\bF(\d+\.?\d*)", re.MULTILINE)
_LETTERS = "XYZABC"
_COARSE = 0.01
"""Length in mm or degrees below which the four decimals of rs274 are too coarse for a time."""
PLACE_M = 20e-6
"""Largest distance between a program and its plan: two tolerances of a chord."""
_SAMPLED_M = 1e-6  # a sampled plan leaves the plan by at most this
_SLACK_M = 1e-3


def compare_interpreted(target: str, plan: Plan, path: Path) -> Found:
    """Compare a program for LinuxCNC with ``plan`` by the moves of LinuxCNC's own ``rs274``.

    Raises
    ------
    RecordingError
        If ``rs274`` does not reach the end of the program.
    OptionError
        If ``rs274`` is not installed: see ``missing_rs274``.
    """
    timed = target == "nc"
    found = followed(plan, _by_rs274(plan, path, timed=timed))
    note = "" if timed else firmware_note(target, plan, path)
    return of_path(f"{_RS274} of LinuxCNC", plan, found, note)


def compare_read_back(target: str, plan: Plan, path: Path) -> Found:
    """Compare a program with ``plan`` as Threadline's own reader of its dialect reads it.

    Raises
    ------
    JobError
        If the program cannot be read.
    """
    job = read_written(path, replace(plan.machine, operator=None), target)
    found = followed(plan, _of_job(plan, job))
    differences = of_path(
        f"Threadline, as {target}", plan, found, firmware_note(target, plan, path)
    )
    return replace(differences, own=True)


def of_path(reader: str, plan: Plan, found: Followed, note: str) -> Found:
    """Return the differences of a followed program, with their limits."""
    return Found(
        reader=reader,
        place=found.place_m,
        place_limit=PLACE_M,
        unit="m",
        tool_m=found.place_m,
        time_s=found.time_s,
        time_limit_s=None if found.time_s is None else TIME_SHARE * plan.duration_s,
        at=found.at,
        note=note,
        curve=found.curve,
    )


def missing_rs274() -> str:
    """Return why ``rs274`` cannot be run here, and how to get it; empty if it can."""
    if shutil.which(_RS274) is None:
        return f"{_RS274} of LinuxCNC is not installed: apt-get install linuxcnc-uspace"
    return ""


def firmware_note(target: str, plan: Plan, path: Path) -> str:
    """Return the plan's time, and the firmware's own time if its planner is known, in words."""
    planned_s = f"planned {plan.duration_s:.4g} s"
    machine = replace(plan.machine, operator=None)
    job = read_written(path, machine, target)
    run_s = as_run_times_s(target, plan.motion.programmed, job, plan.machine)
    if run_s is None:
        kind = BOARDS[target].planner or target
        return f"{planned_s}; the machine file has no [planner] of {kind}, so its time is unknown"
    return f"{planned_s}; {run_s[1]:.4g} s by the planner of {BOARDS[target].planner}"


def _of_job(plan: Plan, job: Job) -> Points:
    trajectory = plan.motion.trajectory
    order = [job.axes.index(axis) for axis in trajectory.axes]
    moves = [item for item in job if isinstance(item, Move)]
    ends = np.array([move.target for move in moves]).reshape(-1, len(job.axes))[:, order]
    return Points(
        ends=ends * radius_m(plan),
        end_s=None,
        where=[f"line {move.source.line}" for move in moves],
    )


def _by_rs274(plan: Plan, path: Path, *, timed: bool) -> Points:
    """Return the ends and the clock of a program by the canonical calls of LinuxCNC."""
    axes = plan.motion.trajectory.axes
    columns = [_LETTERS.index(axis) for axis in axes]
    output = _interpreted(path)
    times_s = _BlockTimes(path)
    scale, rate, now_s = 1.0, 0.0, 0.0
    position = [0.0] * len(_LETTERS)
    ends, clock_s, where = [], [], []
    for number, (block, name, argument) in enumerate(_CALL.findall(output), 1):
        if name == "USE_LENGTH_UNITS":
            scale = 25.4 if "INCHES" in argument else 1.0
        elif name == "SET_FEED_RATE":
            rate = float(argument) * scale
        elif name == "DWELL":
            now_s += float(argument)
        elif name == "ARC_FEED":
            raise RecordingError(
                "the program has an arc, which compile never writes",
                place=Place(str(path)),
                remedy="Give a file that compile wrote.",
            )
        elif name in {"STRAIGHT_FEED", "STRAIGHT_TRAVERSE"}:
            position_before, numbers = position, [float(text) for text in argument.split(",")]
            position = [value * (scale if k < 3 else 1.0) for k, value in enumerate(numbers)]
            step = [a - b for a, b in zip(position, position_before, strict=True)]
            length = math.hypot(*step[:3]) or math.hypot(*step[3:])
            stated_s = times_s.of(block)
            if stated_s is not None and length < _COARSE:
                now_s += stated_s
            elif length and rate:
                now_s += 60.0 * length / rate
            ends.append([position[k] for k in columns])
            clock_s.append(now_s)
            where.append(f"N{block}" if block.strip(".") else f"call {number} of {_RS274}")
    if "PROGRAM_END()" not in output:
        last = (output.strip().splitlines() or ["nothing"])[-1]
        raise RecordingError(
            f"{_RS274} does not come to the end of the program: {' '.join(last.split())[:120]}",
            place=Place(str(path)),
            remedy="Compile it again.",
        )
    kinds = [plan.machine.axes[axis].kind for axis in axes]
    to_si = np.array([1e-3 if kind == "linear" else math.pi / 180.0 for kind in kinds])
    return Points(
        ends=np.array(ends).reshape(-1, len(axes)) * to_si * radius_m(plan),
        end_s=np.array(clock_s) if timed else None,
        where=where,
    )


class _BlockTimes:
    """Times in s of blocks with N and F of G93, to be asked for in the order of the program."""

    def __init__(self, path: Path) -> None:
        text = path.read_text(encoding="utf-8", errors="replace")
        self._blocks = iter(_TIMED.findall(text) if "G93" in text and "G94" not in text else ())
        self._last: tuple[str, float | None] = ("", None)

    def of(self, number: str) -> float | None:
        """Return the time of the block N ``number``; None if it has none."""
        if number != self._last[0]:
            rates = (float(f) for n, f in self._blocks if n == number)
            rate = next(rates, 0.0)
            self._last = (number, 60.0 / rate if rate else None)
        return self._last[1]


def _interpreted(path: Path) -> str:
    program = shutil.which(_RS274)
    if program is None:
        raise OptionError(missing_rs274(), remedy="Install linuxcnc-uspace.")
    # LinuxCNC keeps the tool table of an account in the file ~/.tool.mmap and shares it with each
    # of its programs: rs274 would write into the tools of a machine that runs meanwhile.
    with tempfile.TemporaryDirectory(prefix="threadline-") as home:
        try:
            done = subprocess.run(  # noqa: S603
                [program, "-g", f"./{path.name}"],
                cwd=path.resolve().parent,
                env=os.environ | {"HOME": home},
                capture_output=True,
                text=True,
                errors="replace",
                timeout=_TIMEOUT_S,
                check=False,
            )
        except subprocess.TimeoutExpired as error:
            raise RecordingError(
                f"{_RS274} takes longer than {_TIMEOUT_S:g} s over the program",
                place=Place(str(path)),
            ) from error
    if done.returncode < 0:
        raise OptionError(f"{_RS274} dies of signal {-done.returncode}", remedy="Try again.")
    return done.stdout + done.stderr


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Points:
    """The ends of a program's moves.

    Parameters
    ----------
    ends
        (n, axes) in m, rotary axes at their radius.
    end_s
        (n,) clock at each end, s; None where a firmware sets the timing.
    where
        Line or block of each end.
    """

    ends: FloatArray
    end_s: FloatArray | None
    where: list[str]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Followed:
    """Largest distance in m and clock difference in s, the place of the worst, and both over time.

    ``time_s`` is None where a firmware sets the timing.
    """

    place_m: float
    time_s: float | None
    at: str
    curve: Curve


def radius_m(plan: Plan) -> FloatArray:
    """Return the (axes,) radius of each axis of a plan: 1 for a linear one, m for a rotary one."""
    axes = plan.motion.trajectory.axes
    radii: FloatArray = plan.machine.radius_m[
        [plan.machine.axis_names.index(axis) for axis in axes]
    ]
    return radii


def _sampled(plan: Plan) -> tuple[FloatArray, FloatArray]:
    """Return (n,) instants and (n, axes) places in m of the plan; chords leave it by 1 um."""
    radii = radius_m(plan)
    times: list[FloatArray] = []
    points: list[FloatArray] = []
    for block in plan.motion.trajectory:
        sample_s = (np.arange(9) / 8.0)[None] * block.duration_s[:, None] + block.start_s[:, None]
        # The ends of a piece belong to its neighbour; inside it they are safe.
        sample_s[:, -1] -= 1e-9 * block.duration_s
        acceleration = np.linalg.norm(block.evaluate(sample_s.ravel(), 2) * radii, axis=1)
        peak = acceleration.reshape(sample_s.shape).max(axis=1)
        parts = np.ceil(block.duration_s * np.sqrt(1.2 * peak / (8.0 * _SAMPLED_M)))
        parts = np.maximum(parts, 1.0).astype(np.int64)
        piece_begin = np.repeat(np.cumsum(parts) - parts, parts)
        share = (np.arange(int(parts.sum())) - piece_begin) / np.repeat(parts, parts)
        instants = np.repeat(block.start_s, parts) + share * np.repeat(block.duration_s, parts)
        times.append(instants)
        points.append(block.evaluate(instants) * radii)
        last = np.array([block.end_s])
        end = block.evaluate(last) * radii
    return np.concatenate([*times, last]), np.concatenate([*points, end])


@dataclass(slots=True)
class _Worst:
    value: float = 0.0
    at: str = ""

    def take(self, value: float, at: str) -> None:
        if abs(value) > abs(self.value):
            self.value, self.at = value, at


def followed(plan: Plan, found: Points) -> Followed:
    """Follow the plan from end to end of a program's moves, in order."""
    times, points = _sampled(plan)
    place, clock = _Worst(), _Worst()
    end_before, last_point = points[0], 0
    at_s, offs, lates = list[float](), list[float](), list[float]()
    for k, match in enumerate(_matches(times, points, found.ends)):
        end = found.ends[k]
        # The plan's own points between two ends lie beside the straight move.
        passed = points[match.first : match.last + 1]
        off_m = float(_from_segment(passed, end_before, end).max()) if len(passed) else 0.0
        off_m = max(match.off_m, off_m)
        place.take(off_m, found.where[k])
        late_s = 0.0
        if found.end_s is not None:
            end_s = float(found.end_s[k])
            late_s = end_s - min(max(end_s, match.from_s), match.to_s)
            clock.take(late_s, found.where[k])
        if not k:  # a move counts from its begin: the first one from the plan's begin
            at_s, offs = [float(times[0])], [off_m]
            lates = [0.0]
        lates.append(late_s)
        at_s.append(match.from_s)
        offs.append(off_m)
        end_before, last_point = end, match.last
    left_m = float(
        np.linalg.norm(points[min(last_point + 1, len(points) - 1) :] - end_before, axis=1).max()
    )
    if left_m > place.value:
        place.take(left_m, "its end")
    return Followed(
        place_m=place.value,
        time_s=None if found.end_s is None else clock.value,
        at=place.at if place.value > PLACE_M or not clock.at else clock.at,
        curve=Curve(
            time_s=np.array(at_s),
            place=np.array(offs),
            late_s=np.array(lates) if found.end_s is not None else None,
        ),
    )


@dataclass(frozen=True, slots=True)
class _Match:
    """Where the plan passes an end: first and last point on the way, distance, time from and to."""

    first: int
    last: int
    off_m: float
    from_s: float
    to_s: float


def _matches(times: FloatArray, points: FloatArray, ends: FloatArray) -> Iterator[_Match]:
    """Yield where the plan first passes each end, onwards from the place of the end before."""
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    path_m = np.concatenate([[0.0], np.cumsum(steps)])
    index = 0
    for end in ends:
        reach = 2.0 * float(np.linalg.norm(end - points[index])) + _SLACK_M
        stop = max(int(np.searchsorted(path_m, path_m[index] + reach, side="right")), index + 2)
        stop = min(stop, len(points))
        window = points[index:stop]
        off = _from_segments(end, window)
        is_near = off <= PLACE_M
        enters, leaves = 0, len(off)
        if is_near.any():
            enters = int(np.argmax(is_near))
            leaves = enters + int(np.argmin(np.append(is_near[enters:], False)))
        # Where the path turns back, the way there and the way back are equally near.
        is_nearest = off <= off[enters:leaves].min() + 2.0 * _SAMPLED_M
        low = enters + int(np.argmax(is_nearest[enters:leaves]))
        high = low + int(np.argmin(np.append(is_nearest[low:leaves], False))) - 1
        best = low + int(np.argmin(off[low : high + 1]))
        window_s = times[index : stop + 1]
        next_point = min(high + 1, len(window_s) - 1)
        yield _Match(
            index + 1,
            index + low,
            float(off[best]),
            float(window_s[low]),
            float(window_s[next_point]),
        )
        index += low


def _from_segments(point: FloatArray, chain: FloatArray) -> FloatArray:
    """Return the distances of a point from the segments of a chain, or from its single point."""
    distances_m: FloatArray
    if len(chain) < 2:
        distances_m = np.linalg.norm(chain - point, axis=1)
        return distances_m
    begin, steps = chain[:-1], np.diff(chain, axis=0)
    length2 = (steps**2).sum(axis=1)
    projection = ((point - begin) * steps).sum(axis=1)
    share = np.clip(
        np.divide(projection, length2, out=np.zeros_like(projection), where=length2 > 0), 0, 1
    )
    distances_m = np.linalg.norm(begin + share[:, None] * steps - point, axis=1)
    return distances_m


def _from_segment(points: FloatArray, begin: FloatArray, end: FloatArray) -> FloatArray:
    """Return the (n,) distances of points from one segment."""
    step = end - begin
    length2 = float(step @ step)
    share = (
        np.clip((points - begin) @ step / length2, 0.0, 1.0) if length2 else np.zeros(len(points))
    )
    distances_m: FloatArray = np.linalg.norm(begin + share[:, None] * step - points, axis=1)
    return distances_m
