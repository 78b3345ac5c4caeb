"""Trajectory of a planned path: as fast as limits and feed allow, as programmed, or by a law."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.progress import PLANNING
from threadline.errors import BudgetError, OptionError, Place
from threadline.files import CachedStream, Stream
from threadline.jobs.feed_times import feed_of_move, nominal_time_s
from threadline.jobs.operations import Dwell, Feed, FeedMode, Job, Move, MoveRun, gathered
from threadline.machine import Machine
from threadline.machine.vary import within_path
from threadline.motion.path.durations import Smoothing, smoothing_for
from threadline.motion.path.interpolations import CHORDS, on_chords
from threadline.motion.path.types import PieceBlock, PlannedPath, Timing
from threadline.motion.timing import profile
from threadline.motion.timing.averaged import Smoother
from threadline.motion.timing.by_law import as_programmed, breaks_jerk, by_law
from threadline.motion.timing.pieces import (
    Allowance,
    Pieces,
    allowance,
    caps,
    divide,
    factors,
    join,
    prepare,
)
from threadline.motion.timing.timed import smoothed_blocks, timed_blocks
from threadline.motion.timing.types import Trajectory, TrajectoryBlock, held_block

if TYPE_CHECKING:
    from threadline.motion.laws import Law

SAMPLES = 16384  # buffered at once
MOST_PENDING = 200_000  # pieces that wait for later ones; a longer wait is ended by a stop


def followed_blocks(path: PlannedPath, machine: Machine) -> Iterator[TrajectoryBlock]:
    """Yield the trajectory of ``path`` within velocity, acceleration and jerk limits."""
    columns = [machine.axis_names.index(axis) for axis in path.axes]
    limits = machine.velocity_limit[columns], machine.acceleration_limit[columns]
    smoothing = smoothing_for(machine, path.axes)
    _refuse_endless(smoothing, machine, path.axes)
    run = _Run(limits, allowance(smoothing, path.radius_m, path.smoothing_m, *limits))
    for block in path:
        stops = np.flatnonzero(block.rest_after)
        first = 0
        for stop in stops:
            yield from run.extend(block, first, int(stop) + 1, is_last=True)
            first = int(stop) + 1
        if first < len(block):
            yield from run.extend(block, first, len(block), is_last=False)


def _refuse_endless(smoothing: Smoothing, machine: Machine, axes: tuple[str, ...]) -> None:
    """Refuse a jerk limit that alone needs more ticks than the machine file allows."""
    ticks = smoothing.width_s / float(machine.tick_clock.period_s)
    if ticks <= machine.tick_budget.si:
        return
    columns = [machine.axis_names.index(axis) for axis in axes]
    slowest_axis = int(np.argmax(machine.acceleration_limit[columns] / machine.jerk_limit[columns]))
    raise BudgetError(
        f"with the jerk limit of axis {axes[slowest_axis]}, its own or the path's, its "
        f"acceleration takes {smoothing.width_s:.3g} s to come and go, {ticks:.3g} ticks; the "
        f"machine file allows {machine.tick_budget.si:.3g}",
        place=machine.place,
        remedy="Raise that jerk, lower the acceleration, or take another interpolation: optimal.",
    )


@dataclass(slots=True)
class _Run:
    """The current run between two rests."""

    limits: tuple[FloatArray, FloatArray]
    allowed: Allowance
    pending: Pieces | None = None
    run_over: int = 0  # leading pending pieces that are done, kept as neighbours of the next
    speed: float = 0.0  # u'^2 at the start of the first piece that is not done
    time_s: float = 0.0  # time from there to the first sample
    begin_s: float = 0.0  # start of the run
    done: int = 0  # yielded spline pieces of the run
    smoother: Smoother | None = None

    def extend(
        self, block: PieceBlock, first: int, stop: int, *, is_last: bool
    ) -> Iterator[TrajectoryBlock]:
        """Add pieces ``first`` to ``stop`` and yield the part that is settled."""
        rows = slice(first, stop)
        coefficients = block.coefficients[rows]
        moving = np.any(coefficients[:, 1:], axis=(1, 2))
        pieces = prepare(
            coefficients[moving],
            block.nominal_s[rows][moving],
            block.operation[rows][moving],
            self.allowed,
        )
        self.pending = pieces if self.pending is None else join([self.pending, pieces])
        if self.smoother is None and len(self.pending):
            start, operation = self.pending.c[0, 0], int(self.pending.operation[0])
            self.smoother = Smoother(self.allowed.smoothing, start, operation)
        yield from self._advance(is_last)
        if not is_last:
            return
        end_position = coefficients[-1].sum(axis=0)
        if self.smoother is not None:
            operation = int(block.operation[stop - 1])
            yield from self._emit(*self.smoother.finish(end_position, operation))
        self.begin_s += self.done * self.allowed.smoothing.step_s
        dwell = float(block.dwell_s[stop - 1])
        if dwell > 0:
            yield held_block(end_position, self.begin_s, dwell, int(block.operation[stop - 1]))
            self.begin_s += dwell
        self.pending, self.smoother, self.run_over = None, None, 0
        self.speed, self.time_s, self.done = 0.0, 0.0, 0

    def _advance(self, is_last: bool) -> Iterator[TrajectoryBlock]:
        if self.pending is None or not len(self.pending):
            return
        p = self.pending = divide(self.pending, self.allowed, is_last=is_last)
        factor = factors(p.c, self.allowed.radius)
        cap = caps(p, factor, self.allowed)
        # Finished pieces are never whole: their number does not change.
        unfinished = slice(self.run_over, None)
        c, straight, cap, factor = (
            p.c[unfinished],
            p.straight[unfinished],
            cap[unfinished],
            factor[unfinished],
        )
        run = (c, straight, cap, factor)
        count = len(c)
        largest_x = np.zeros((count, profile.PARTS + 1))
        profile.backward(run, self.limits, 0.0, largest_x, False)
        settled_count = count
        if not is_last:
            settled_count = profile.backward(run, self.limits, np.inf, largest_x, True)
            # Later pieces may still lower the caps of the last stretch.
            length_left = np.cumsum(p.length[unfinished][::-1])[::-1]
            reach_m = self.allowed.reach_s * self.allowed.top_m_s
            settled_count = min(
                settled_count, int(np.searchsorted(-length_left, -reach_m)), count - 1
            )
            if count - settled_count > MOST_PENDING:
                settled_count = count // 2
        if settled_count <= 0:
            return
        x = np.zeros((settled_count, profile.PARTS + 1))
        run = (
            c[:settled_count],
            straight[:settled_count],
            cap[:settled_count],
            factor[:settled_count],
        )
        x_after = profile.forward(run, self.limits, self.speed, largest_x, x)
        yield from self._sample(run, x, p.operation[unfinished][:settled_count])
        self.speed = x_after
        # The last finished pieces still affect the next ones.
        finished = self.run_over + settled_count
        reach_m = self.allowed.reach_s * self.allowed.top_m_s
        length_passed = np.cumsum(p.length[:finished][::-1])[::-1]
        first_kept = int(np.searchsorted(-length_passed, -reach_m))
        self.pending, self.run_over = p.take(slice(first_kept, None)), finished - first_kept

    def _sample(
        self,
        run: tuple[FloatArray, IntArray, FloatArray, FloatArray],
        x: FloatArray,
        operation: IntArray,
    ) -> Iterator[TrajectoryBlock]:
        """Yield the motion of pieces, given as in ``profile.backward``, with x from ``forward``."""
        c = run[0]
        state = np.array([0.0, 0.0, self.time_s])
        positions = np.empty((SAMPLES, c.shape[2]))
        piece_of_sample = np.empty(SAMPLES, dtype=np.int64)
        step = self.allowed.smoothing.step_s
        assert self.smoother is not None
        while state[0] < len(c):
            count = profile.sample(run, self.limits, x, step, state, positions, piece_of_sample)
            if count:
                spline_pieces = self.smoother.extend(
                    positions[:count].copy(), operation[piece_of_sample[:count]]
                )
                yield from self._emit(*spline_pieces)
        self.time_s = float(state[2])

    def _emit(self, coefficients: FloatArray, operation: IntArray) -> Iterator[TrajectoryBlock]:
        count = len(coefficients)
        if not count:
            return
        step = self.allowed.smoothing.step_s
        yield TrajectoryBlock(
            start_s=np.asarray(self.begin_s + (self.done + np.arange(count)) * step),
            duration_s=np.full(count, step),
            coefficients=coefficients,
            operation=operation,
        )
        self.done += count
        PLANNING.reach(self.begin_s + self.done * step)


_MOST_CACHED = 20_000  # pieces of a path whose fastest motion is kept


class Pace(StrEnum):
    """How the timing along a path is chosen."""

    LIMITED = "limited"  # as fast as the limits and the feed allow
    PROGRAMMED = "programmed"  # every programmed time exactly, for a smoothing in time afterwards
    LAW = "law"  # every chord from rest to rest by a motion law, as fast as limits and feed allow


def plan_trajectory(
    path: PlannedPath,
    machine: Machine,
    pace: Pace = Pace.LIMITED,
    law: Law | None = None,
    contour_m: float = np.inf,
    *,
    of_loads: bool = False,
    along_m_s2: float = np.inf,
) -> Trajectory:
    """Return the axis positions over time.

    If the pieces of a path have times, the motion keeps them; it is smoothed if the acceleration of
    the path steps and the path leaves room (``smoothing_m``). Any other path is followed as fast as
    the limits of ``machine`` and the programmed feed allow, or at its programmed times.

    Parameters
    ----------
    path
        The path to follow.
    machine
        The machine with the limits.
    pace
        ``PROGRAMMED`` for chords keeps every programmed time; their velocity steps, so that the
        trajectory is historical until it is smoothed. ``LAW`` makes every chord a move from rest
        to rest; it is historical if its jerk is infinite and an axis limits it.
    law
        The motion law for the pace ``LAW``.
    contour_m
        For a path timed as the fastest: allowed contour error of the loads due to their loops;
        infinite for no limit.
    of_loads
        For a path timed as the fastest: whether the loads follow it, not the motors.
    along_m_s2
        For a path timed as the fastest: largest acceleration along it, at the tool.

    Raises
    ------
    OptionError
        If a curved path should keep programmed times or follow a law, or the law goes back.
    BudgetError
        While the trajectory is read: if the programmed feeds and dwells alone take more ticks
        than the machine file allows. It is raised before any sample of the pieces that are too
        long.
    PlanError
        While the trajectory with ``contour_m`` is read: if loads exceed it at any speed.
    """
    if path.timing not in (Timing.FASTEST, Timing.FIRMWARE):
        machine = within_path(machine, path.axes, path.radius_m)
    if pace is Pace.LAW:
        if not on_chords(path.interpolation) or law is None:
            raise OptionError(
                f"a motion law is followed along chords, not along {path.interpolation}",
                remedy="Take chord_path, and name the law.",
            )
        path = replace(
            path,
            blocks=Stream(by_law, path, machine, law),
            timing=Timing.TIME,
            historical=breaks_jerk(law, path.axes, machine),
        )
    if pace is Pace.PROGRAMMED and path.timing is Timing.GEOMETRIC:
        if path.interpolation != CHORDS:
            raise OptionError(
                f"only chords keep their programmed times, not {path.interpolation}",
                remedy="Take chord_path.",
            )
        timed = Stream(as_programmed, path, machine)
        path = replace(path, blocks=timed, timing=Timing.TIME, historical=True)
    path = replace(path, blocks=CachedStream(_within_budget, path, machine))
    if path.timing is Timing.TIME and path.smoothing_m > 0:
        return Trajectory(axes=path.axes, blocks=CachedStream(smoothed_blocks, path, machine))
    if path.timing is Timing.TIME:
        return Trajectory(
            axes=path.axes, historical=path.historical, blocks=CachedStream(timed_blocks, path)
        )
    if path.timing is Timing.FIRMWARE and machine.planner is not None:
        from threadline.motion.timing.firmware import firmware_blocks

        return Trajectory(
            axes=path.axes,
            historical=True,
            blocks=CachedStream(firmware_blocks, path, machine, machine.planner),
        )
    if path.timing is Timing.FASTEST:
        from threadline.motion.timing.optimal.fastest_motion import fastest_blocks

        blocks = Stream(
            fastest_blocks, path, machine, contour_m, of_loads=of_loads, along_m_s2=along_m_s2
        )
        # A short motion is computed once and kept, as it is read many times.
        return Trajectory(
            axes=path.axes, blocks=Stream.of(list(blocks)) if _short(path) else blocks
        )
    return Trajectory(axes=path.axes, blocks=CachedStream(followed_blocks, path, machine))


def _short(path: PlannedPath) -> bool:
    """Return whether all pieces of a path may be kept in memory."""
    count = 0
    for block in path:
        count += len(block)
        if count > _MOST_CACHED:
            return False
    return True


def _longest(
    block: PieceBlock, moved_s: FloatArray, axes: tuple[str, ...], fastest: FloatArray
) -> str:
    """Return which of the pieces takes longest, and why."""
    lasts_s = moved_s + block.dwell_s
    longest = int(np.argmax(lasts_s))
    axis_times_s = np.abs(block.coefficients[longest, 1:].sum(axis=0)) / fastest
    if block.dwell_s[longest] >= moved_s[longest]:
        reason = "its dwell"
    elif block.nominal_s[longest] >= axis_times_s.max():
        reason = "its feed"
    else:
        reason = f"the velocity limit of axis {axes[int(np.argmax(axis_times_s))]}"
    return f"line {block.line[longest]} of the job alone takes {lasts_s[longest]:.3g} s by {reason}"


def _within_budget(path: PlannedPath, machine: Machine) -> Iterator[PieceBlock]:
    """Yield the pieces of ``path`` while their least times are within the budget."""
    period_s = float(machine.tick_clock.period_s)
    budget = machine.tick_budget.si
    least_s = 0.0
    # A geometric piece takes as long as its slowest axis needs between its ends.
    fastest = np.array([machine.axes[axis].velocity.si for axis in path.axes])
    bound_by_limits = path.timing is not Timing.TIME
    for block in path:
        moved_s, order = block.nominal_s, block.coefficients.shape[1]
        if bound_by_limits:
            # Column by column: numpy is slow along short inner axes.
            displacement = block.coefficients[:, 1].copy()
            for k in range(2, order):
                displacement += block.coefficients[:, k]
            for axis_s in (np.abs(displacement) / fastest).T:
                moved_s = np.maximum(moved_s, axis_s)
        least_s += float(moved_s.sum() + block.dwell_s.sum())
        if least_s / period_s > budget:
            raise BudgetError(
                f"the job needs more than {least_s / period_s:.3g} ticks of {period_s * 1e3:g} ms "
                f"at its feeds and velocity limits, the machine file allows {budget:.3g}; "
                f"{_longest(block, moved_s, path.axes, fastest)}",
                remedy="Raise the feed or the limits, shorten the job, or raise tick_budget in the "
                "machine file.",
            )
        yield block


_MOST_WORK = 1_000_000
_WORK_PER_ITEM = 64  # cost of a single item, in moves of a run


def check_budget(job: Job, machine: Machine, feed: Feed | None = None) -> None:
    """Refuse a job that takes more ticks than the machine file allows, before it is planned.

    The times of the moves at their feeds are summed. Repeated passes are multiplied, so that
    ``M98 P1 L1000000000`` costs three passes of computation. Rapid moves count at the velocity
    limits. Only the beginning of a long job is summed, for about a second of computation: the
    trajectory counts the rest.

    Parameters
    ----------
    job, machine
        The job, and the machine that does it.
    feed
        Replaces the programmed feeds.

    Raises
    ------
    BudgetError
        If the budget is exceeded; names the line of the call or move that takes most ticks.
    JobError
        If a block lacks a value that it needs.
    PlanError
        If a feed is missing or not above 0.
    """
    budget = machine.tick_budget.si
    period_s = float(machine.tick_clock.period_s)
    position = np.array(job.start)
    ticks_by_line: defaultdict[int, float] = defaultdict(float)
    total = work = 0.0
    for operation, times, call in job.folded():
        item = gathered([operation]) if isinstance(operation, Move) else operation
        if isinstance(item, MoveRun):
            moves_s = _times_s(item, position, feed, job, machine)
            position = item.targets[-1]
            line = int(item.line[int(np.argmax(moves_s))])
            ticks = times * float(moves_s.sum()) / period_s
        elif isinstance(item, Dwell):
            line, ticks = item.source.line, times * item.duration_s / period_s
        else:
            continue
        ticks_by_line[call or line] += ticks
        total += ticks
        work += _WORK_PER_ITEM + (len(item) if isinstance(item, MoveRun) else 0)
        if total > budget:
            worst_line = max(ticks_by_line, key=ticks_by_line.__getitem__)
            raise BudgetError(
                f"the job takes more than {total:.3g} ticks of {period_s * 1e3:g} ms at its "
                f"feeds; the tick budget of {machine.name!r} is {budget:.3g}",
                place=Place(job.file, worst_line),
                remedy="Lower L or the dwell, raise the feed, or raise tick_budget in the "
                "machine file.",
            )
        if work > _MOST_WORK:
            return


def _times_s(
    run: MoveRun, position: FloatArray, feed: Feed | None, job: Job, machine: Machine
) -> FloatArray:
    """Return the (moves,) least times of the moves of a run that begins at ``position``."""
    displacement = np.diff(run.targets, axis=0, prepend=position[None])
    columns = [machine.axis_names.index(axis) for axis in job.axes]
    least_s: FloatArray = (np.abs(displacement) / machine.velocity_limit[columns]).max(axis=1)
    ends = [begin for begin, _ in run.feeds[1:]] + [len(displacement)]
    for (begin, programmed), end in zip(run.feeds, ends, strict=True):
        if programmed is None or programmed.mode is not FeedMode.RAPID:
            move_feed = feed_of_move(
                programmed, feed, Place(run.file, int(run.line[begin])), job, machine
            )
            least_s[begin:end], _ = nominal_time_s(
                displacement[begin:end], move_feed, feed, job, machine
            )
    return least_s
