"""The planned motion as a part program for a firmware that plans its own ramps.

The firmware accelerates and decelerates by itself, so the program gives only end points and a
maximum speed for each. The program consists of chords that stay within 0.01 mm of the planned path;
F of a chord is the highest planned speed along the chord. A chord ends where the planned speed
rises again after a fall, where the feed of the job changes, where G0 changes to G1 or back, and
where a word switches something. The program is read back in its own dialect and compared with the
plan before the file exists.

If an axis moves before the place where the job first moves it, a warning says so. A job may
position X and Y first and then lower Z, from the height at which the operator has left it. The
rounded corner before the descent moves Z earlier, and from the zero of the program.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import IO, NamedTuple

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.base.progress import WRITING
from threadline.commands.boards import BOARDS, LINUXCNC_BLENDS, read_written, refuse_lost
from threadline.commands.endless_axes import EndlessNumbers
from threadline.commands.merged_chords import CLOSE_M, Chord, Chords, travels
from threadline.commands.nc_blocks import operation_words
from threadline.commands.planned_job import CHORD_TOLERANCE_M
from threadline.errors import PlanError
from threadline.files.formats.common import Written, atomic_file, written
from threadline.jobs.feed_times import programmed_time_s
from threadline.jobs.gcode.dialects import DIALECTS
from threadline.jobs.operations import (
    Dwell,
    Feed,
    FeedMode,
    Job,
    Move,
    MoveRun,
    Operation,
    Stop,
    ToolEvent,
    move_runs,
)
from threadline.machine import Machine
from threadline.machine.motion_planner import LinuxCncPlanner
from threadline.motion.path import plan_path, programmed_path
from threadline.motion.path.interpolations import FIRMWARE
from threadline.motion.path.types import ProgrammedPath
from threadline.motion.timing import plan_trajectory
from threadline.motion.timing.types import Trajectory

_DECIMALS = 4  # decimals of a millimetre or a degree
_HOMES = "G28"
_NO_SLOWER = 1e-3
"""Share by which a program may be slower than the job itself: F and end points are rounded."""


def write_firmware_program(
    planned: Chords, path: Path, *, programmed: ProgrammedPath, slower: bool = True
) -> Written:
    """Write a plan for a firmware; the file appears only after a correct read-back.

    Parameters
    ----------
    planned
        Chords of the plan.
    programmed
        Path of the job, with its times at the requested feeds.
    slower
        Whether the firmware's planner may take longer for the program than for the job itself. If
        False and the program is slower, F is the feed of the job in place of the planned speeds,
        and moves of ``planned.vertices`` are written as in the job. The program then has fewer
        blocks, and the firmware slows down by itself where the plan does.

    Raises
    ------
    PlanError
        If the dialect has no word for a part of the job, a line is too long, the program read back
        differs from the plan, or the program is slower than allowed.
    """
    target, job, machine = planned.target, planned.job, planned.planned_on
    override, vertices = planned.override, planned.vertices
    refuse_lost(job, machine, target)
    with atomic_file(path) as file:
        summary, as_run_s = _written_once(planned, file, programmed, (0.25, 0.4))
        if not slower and _is_slower(as_run_s):
            if override is not None or vertices:
                own = planned.at_own_feeds()
                summary, as_run_s = _written_once(own, file, programmed, (0.6, 0.75))
                moves = " and its moves are as programmed" if vertices else ""
                summary += (
                    f"; F is the job's own{moves}, since the planned speeds as F would be slower"
                )
            refuse_slower(target, job, as_run_s, override)
        WRITING.pass_to(0.9)
        paths = (item.points for item in planned if isinstance(item, Chord))
        early = tuple(early_moves(job, paths, machine))
    return replace(written(path, (f"{path.name}: {summary}", *early)), as_run_s=as_run_s)


def _written_once(
    chords: Chords, file: IO[bytes], programmed: ProgrammedPath, shares: tuple[float, float]
) -> tuple[str, tuple[float, float] | None]:
    """Replace the contents of a file with a program, and compare the program with the plan.

    ``shares`` are the shares of the whole work done after writing and after reading back.
    """
    target, machine = chords.target, chords.planned_on
    file.seek(0)
    file.truncate()
    WRITING.pass_to(shares[0])
    file.writelines(f"{line}\n".encode() for line in _Lines(chords))
    file.flush()
    WRITING.pass_to(shares[1])
    summary, again, by_feed_s = _read_back(chords, Path(file.name))
    as_run_s = as_run_times_s(target, programmed, again, machine)
    planned_by = "which the firmware makes itself"
    if as_run_s is not None:
        planned_by = (
            f"{as_run_s[1]:.4g} s as the planner of {BOARDS[target].planner} runs it, which takes "
            f"{as_run_s[0]:.4g} s over {_as_fed(chords.job, chords.override)}"
        )
    rate = _rate_words(target, Path(file.name), by_feed_s)
    planned_s = chords.trajectory.duration_s
    return f"{summary}, {planned_s:.4g} s as planned with its ramps, {planned_by}{rate}", as_run_s


def _is_slower(as_run_s: tuple[float, float] | None) -> bool:
    return as_run_s is not None and as_run_s[1] > as_run_s[0] * (1.0 + _NO_SLOWER)


def _as_fed(job: Job, override: float | None) -> str:
    """Return the name of the job, with the feed for which its time is given."""
    return f"{job.name} as it stands" if override == 1.0 else f"{job.name} at the same feed"


def refuse_slower(
    target: str, job: Job, as_run_s: tuple[float, float] | None, override: float | None = 1.0
) -> None:
    """Refuse a program for which the firmware's planner takes longer than for the job.

    ``override`` is the factor on the feeds of the job, None if another feed replaces them.

    Raises
    ------
    PlanError
        If the program is slower; the message gives both times.
    """
    if as_run_s is None or not _is_slower(as_run_s):
        return
    raise PlanError(
        f"the program for {target} would be slower: the planner of the firmware takes "
        f"{as_run_s[1]:.5g} s over it, and {as_run_s[0]:.5g} s over {_as_fed(job, override)}",
        remedy=f"Run {job.name} itself, or give another --interpolation (firmware writes its moves "
        "as they are, at this feed), a wider --tolerance or a higher --feed; --slower writes it "
        "all the same.",
    )


def planned_instants(
    target: str, job: Job, trajectory: Trajectory, machine: Machine, *, override: float | None = 1.0
) -> FloatArray:
    """Return the instant of the plan, in s, at which each written line begins.

    The parameters are as for ``Chords``.
    """
    lines = _Lines(Chords(target, job, trajectory, machine, override))
    return np.array([begins_s for begins_s, _ in lines.timed()])


class _Lines:
    """The lines of a program; each line with a move changes at least one printed digit."""

    def __init__(self, merged: Chords) -> None:
        self._merged = merged
        self._target, self._job, self._machine = merged.target, merged.job, merged.machine
        self._board = BOARDS[merged.target]
        self._dialect = DIALECTS[merged.target]
        axes = merged.machine.axes
        self._linear = [axes[name].kind == "linear" for name in merged.job.axes]

    def __iter__(self) -> Iterator[str]:
        for _, line in self.timed():
            if len(line) > self._board.longest:
                raise PlanError(
                    f"a line has {len(line)} characters, and {self._target} takes "
                    f"{self._board.longest}",
                    remedy="Use another target, or fewer axes.",
                )
            yield line

    def timed(self) -> Iterator[tuple[float, str]]:
        """Yield each line after the instant of the plan at which the line begins, s."""
        at, feed, now_s = _written_position(np.array(self._job.start), self._linear), "", 0.0
        turning = EndlessNumbers(self._target, self._job.axes, self._machine)
        if self._board.head is not None:
            head = self._board.head(self._machine, self._job.axes)
            yield from ((now_s, f"; {line}") for line in head)
        yield from ((now_s, line) for line in self._board.begin)
        modal = -1
        waiting: list[ToolEvent] = []  # actions of chords too short for a printed digit
        for item in self._merged:
            begins_s = now_s
            if not isinstance(item, Chord):
                yield from ((begins_s, act.words) for act in waiting)
                waiting = []
                now_s += item.duration_s if isinstance(item, Dwell) else 0.0
                yield from ((begins_s, line) for line in self._other(item))
                if not (isinstance(item, Stop) and item.final):
                    yield from ((now_s, line) for line in turning.taken_off(at))
                continue
            now_s += item.duration_s
            waiting += item.acts
            now = _written_position(item.points[-1], self._linear)
            words = [
                f"{name}{self._number(text)}"
                for name, text, new, before in zip(
                    self._job.axes, turning.written(now), now, at, strict=True
                )
                if new != before
            ]
            if not words:
                continue
            at = now
            yield from ((begins_s, act.words) for act in waiting if not act.beside)
            words += [act.words for act in waiting if act.beside]
            waiting = []
            g = self._motion(item.feed)
            if g != modal or self._dialect.each_g:
                words.insert(0, f"G{g}")
            modal = g
            f_text = f"{60_000.0 * item.speed:.6g}"
            if "e" in f_text:
                f_text = f"{60_000.0 * item.speed:.12f}".rstrip("0").rstrip(".")
            if f_text != feed and (g == 1 or self._dialect.rapid_is_feed):
                words.append(f"F{f_text}")
                feed = f_text
            yield begins_s, " ".join(words)
        yield from ((now_s, act.words) for act in waiting)
        yield from ((now_s, line) for line in self._board.end)

    def _motion(self, feed: Feed | None) -> int:
        """Return the G word of a chord: G0 at a feed only where the dialect's G0 uses the feed."""
        if feed is not None and feed.mode is FeedMode.RAPID:
            return 0
        return 0 if travels(feed) and self._dialect.rapid_is_feed else 1

    def _number(self, text: str) -> str:
        return f"{text}." if self._dialect.points and "." not in text else text

    def _other(self, item: Operation) -> Iterator[str]:
        if isinstance(item, Dwell):
            letter, units = self._board.pause
            text = _decimal(item.duration_s * units)
            yield f"G4 {letter}{self._number(text)}"
        elif isinstance(item, Stop) and item.final:
            pass
        elif isinstance(item, Stop | ToolEvent) and item.words:
            yield item.words
        elif isinstance(item, Stop) and self._board.stops:
            yield "M0"
        else:
            raise PlanError(
                f"{self._target} has no word for {operation_words(item)}",
                place=item.source.place,
                remedy="Take it out of the job, or write csv or npz.",
            )


def _decimal(value: float) -> str:
    text = f"{value:.{_DECIMALS}f}".rstrip("0").rstrip(".")
    return "0" if text in {"-0", ""} else text


def _written_position(position: FloatArray, linear: list[bool]) -> list[str]:
    return [
        _decimal(1e3 * value if straight else math.degrees(value))
        for value, straight in zip(position.tolist(), linear, strict=True)
    ]


def _read_back(merged: Chords, path: Path) -> tuple[str, Job, float]:
    """Compare the written program with the plan.

    Returns a description, the job read back, and its time by F alone, s.

    Raises
    ------
    PlanError
        If a block leaves the plan by more than a chord may.
    """
    target, job, machine = merged.target, merged.job, merged.machine
    again = read_written(path, machine, target)
    column = [machine.axis_names.index(axis) for axis in job.axes]
    radius_m = machine.radius_m[column]
    order = [again.axes.index(axis) for axis in job.axes]
    moves = (item for item in again if isinstance(item, Move))
    linear = [machine.axes[name].kind == "linear" for name in job.axes]
    at = np.array(job.start)
    text_at = _written_position(at, linear)
    worst_m, count = 0.0, 0
    for chord in merged:
        if not isinstance(chord, Chord):
            if isinstance(chord, ToolEvent) and chord.words.startswith(_HOMES):
                next(moves, None)  # the reader adds a move to home; the plan is there already
            continue
        text = _written_position(chord.points[-1], linear)
        if text != text_at:
            text_at = text
            move = next(moves, None)
            if move is None:
                raise _not_the_plan(target, "ends before it", 0.0)
            count += 1
            before, at = at, np.array(move.target)[order]
            away_m = _away_m(chord.points * radius_m, before * radius_m, at * radius_m)
            end_m = float(np.linalg.norm((at - chord.points[-1]) * radius_m))
            worst_m = max(worst_m, away_m, end_m)
        if worst_m > 2.0 * CHORD_TOLERANCE_M + CLOSE_M:
            raise _not_the_plan(target, "leaves it by", worst_m)
    if next(moves, None) is not None:
        raise _not_the_plan(target, "goes on behind it", 0.0)
    by_feed_s = programmed_time_s(again, machine)
    summary = (
        f"{count} blocks, read back: within {1e3 * worst_m:.2g} mm of the plan, "
        f"{by_feed_s:.4g} s by F alone"
    )
    return summary, again, by_feed_s


def _rate_words(target: str, path: Path, by_feed_s: float) -> str:
    """Return a note if a serial port is too slow for a program, else an empty string."""
    most = BOARDS[target].bytes_s
    rate = path.stat().st_size / max(by_feed_s, 1e-9)
    if not most or rate <= most:
        return ""
    return (
        f"; its {rate:.0f} characters a second are more than a port of 115200 baud takes ({most})"
    )


def as_run_times_s(
    target: str, programmed: ProgrammedPath, again: Job, machine: Machine
) -> tuple[float, float] | None:
    """Return the time of the firmware's planner for the job and for its program, s.

    None if the machine file does not describe the planner of this firmware.
    """
    planner = machine.planner
    if planner is None or planner.kind != BOARDS[target].planner:
        return None
    own = replace(machine, operator=None)
    before = plan_trajectory(plan_path(programmed, own, FIRMWARE), own).duration_s
    if isinstance(planner, LinuxCncPlanner):
        own = replace(own, planner=LINUXCNC_BLENDS)  # the program itself sets the blending
    path = plan_path(programmed_path(again, own), own, FIRMWARE)
    return before, plan_trajectory(path, own).duration_s


def _not_the_plan(target: str, what: str, off_m: float) -> PlanError:
    by = f" {1e3 * off_m:.3g} mm" if off_m else ""
    return PlanError(
        f"the program for {target}, read back, is not the plan: it {what}{by}",
        remedy="Report it with the job and the machine file.",
    )


def _away_m(points: FloatArray, begin: FloatArray, end: FloatArray) -> float:
    """Return the largest distance of (n, axes) points from a segment."""
    way = end - begin
    squared = float(way @ way)
    share = np.clip((points - begin) @ way / squared, 0.0, 1.0) if squared else 0.0
    nearest = begin + np.multiply.outer(share, way) if squared else begin
    return float(np.sqrt(((points - nearest) ** 2).sum(axis=1).max()))


class _First(NamedTuple):
    """Line of the first move of an axis, and the (axes,) position before it."""

    line: int
    before: FloatArray


def early_moves(job: Job, paths: Iterable[FloatArray], machine: Machine) -> Iterator[str]:
    """Yield a sentence for each linear axis that moves too early.

    Parameters
    ----------
    paths
        (n, axes) points of each move of the written program, the place before it included.
    """
    start = np.array(job.start)
    waiting = {
        k: first
        for k, first in _first_moves(job).items()
        if machine.axes[job.axes[k]].kind == "linear" and np.any(first.before != start)
    }
    for points in paths:
        if not waiting:
            return
        for k in [k for k in waiting if points[-1][k] != start[k]]:
            first = waiting.pop(k)
            if np.any(np.delete(points[0] - first.before, k) != 0.0):
                name = job.axes[k]
                yield (
                    f"{name} moves before line {first.line}, where {job.name} first moves it: the "
                    f"corner there is rounded. Begin with {name} at the zero of the program, or "
                    "write its position into the first move"
                )


def _first_moves(job: Job) -> dict[int, _First]:
    """Return the first move of each axis that moves, by the index of the axis."""
    found: dict[int, _First] = {}
    start = at = np.array(job.start)
    for run in move_runs(job):
        if not isinstance(run, MoveRun):
            continue
        targets = run.targets
        moved = targets != start
        for k in np.flatnonzero(moved.any(axis=0)).tolist():
            if k not in found:
                row = int(np.argmax(moved[:, k]))
                found[k] = _First(int(run.line[row]), targets[row - 1] if row else at)
        if len(found) == len(start):
            break
        at = targets[-1]
    return found
