"""Trajectory of a path whose shape alone is settled: as fast as limits and feed allow."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.durations.smoothing import Smoothing, smoothing_for
from threadline.errors import BudgetError
from threadline.machine import Machine
from threadline.path.types import PieceBlock, PlannedPath
from threadline.planning_so_far import PLANNING
from threadline.trajectory import profile
from threadline.trajectory.pieces import (
    Allowance,
    Pieces,
    allowance,
    caps,
    divide,
    factors,
    join,
    prepare,
)
from threadline.trajectory.smoothing import Smoother
from threadline.trajectory.timed import held_block
from threadline.trajectory.types import TrajectoryBlock

SAMPLES = 16384  # in hand at once
MOST_PENDING = 200_000  # pieces that wait for what follows; a longer wait is cut short by a stop


def followed_blocks(path: PlannedPath, machine: Machine) -> Iterator[TrajectoryBlock]:
    """Yield the trajectory of ``path`` within velocity, acceleration and jerk limits."""
    column = [machine.axis_names.index(axis) for axis in path.axes]
    limits = machine.velocity_limit[column], machine.acceleration_limit[column]
    smoothing = smoothing_for(machine, path.axes)
    _refuse_endless(smoothing, machine, path.axes)
    run = _Run(limits, allowance(smoothing, path.radius_m, path.smoothing_m, *limits))
    for block in path:
        stops = np.flatnonzero(block.rest_after)
        first = 0
        for stop in stops:
            yield from run.extend(block, first, int(stop) + 1, ends=True)
            first = int(stop) + 1
        if first < len(block):
            yield from run.extend(block, first, len(block), ends=False)


def _refuse_endless(smoothing: Smoothing, machine: Machine, axes: tuple[str, ...]) -> None:
    """Refuse a jerk limit that by itself asks for more ticks than the machine file allows."""
    ticks = smoothing.width_s / float(machine.tick_clock.period_s)
    if ticks <= machine.tick_budget.si:
        return
    column = [machine.axis_names.index(axis) for axis in axes]
    k = int(np.argmax(machine.acceleration_limit[column] / machine.jerk_limit[column]))
    raise BudgetError(
        f"with the jerk limit of axis {axes[k]}, its own or that along the path, its acceleration "
        f"takes {smoothing.width_s:.3g} s to come and go, {ticks:.3g} ticks; the machine file "
        f"allows {machine.tick_budget.si:.3g}",
        place=machine.place,
        remedy="Raise that jerk, lower the acceleration, or take another interpolation: optimal.",
    )


@dataclass(slots=True)
class _Run:
    """The run under way between two rests."""

    limits: tuple[FloatArray, FloatArray]
    allowed: Allowance
    pending: Pieces | None = None
    run_over: int = 0  # leading pending pieces that are done, kept for what they ask of the next
    speed: float = 0.0  # u'^2 at the start of the first piece that is not done
    time_s: float = 0.0  # from there to its first sample
    begin_s: float = 0.0  # when the run began
    done: int = 0  # spline pieces of the run that are out
    smoother: Smoother | None = None

    def extend(
        self, block: PieceBlock, first: int, stop: int, *, ends: bool
    ) -> Iterator[TrajectoryBlock]:
        """Take in pieces ``first`` to ``stop`` and yield what they settle."""
        rows = slice(first, stop)
        here = block.coefficients[rows]
        moves = np.any(here[:, 1:], axis=(1, 2))
        pieces = prepare(
            here[moves], block.nominal_s[rows][moves], block.operation[rows][moves], self.allowed
        )
        self.pending = pieces if self.pending is None else join([self.pending, pieces])
        if self.smoother is None and len(self.pending):
            start, label = self.pending.c[0, 0], int(self.pending.operation[0])
            self.smoother = Smoother(self.allowed.smoothing, start, label)
        yield from self._advance(ends)
        if not ends:
            return
        last = here[-1].sum(axis=0)
        if self.smoother is not None:
            label = int(block.operation[stop - 1])
            yield from self._emit(*self.smoother.finish(last, label))
        self.begin_s += self.done * self.allowed.smoothing.step_s
        dwell = float(block.dwell_s[stop - 1])
        if dwell > 0:
            yield held_block(last, self.begin_s, dwell, int(block.operation[stop - 1]))
            self.begin_s += dwell
        self.pending, self.smoother, self.run_over = None, None, 0
        self.speed, self.time_s, self.done = 0.0, 0.0, 0

    def _advance(self, ends: bool) -> Iterator[TrajectoryBlock]:
        if self.pending is None or not len(self.pending):
            return
        p = self.pending = divide(self.pending, self.allowed, ends=ends)
        factor = factors(p.c, self.allowed.radius)
        cap = caps(p, factor, self.allowed)
        # Pieces that are done are never whole: their number does not change.
        new = slice(self.run_over, None)
        c, straight, cap, factor = p.c[new], p.straight[new], cap[new], factor[new]
        path = (c, straight, cap, factor)
        count = len(c)
        most = np.zeros((count, profile.PARTS + 1))
        profile.backward(*path, *self.limits, 0.0, most, False)
        settled = count
        if not ends:
            settled = profile.backward(*path, *self.limits, np.inf, most, True)
            # What comes later may still lower the caps of the last stretch.
            left = np.cumsum(p.length[new][::-1])[::-1]
            far = self.allowed.reach_s * self.allowed.top_m_s
            settled = min(settled, int(np.searchsorted(-left, -far)), count - 1)
            if count - settled > MOST_PENDING:
                settled = count // 2
        if settled <= 0:
            return
        x = np.zeros((settled, profile.PARTS + 1))
        c, straight, cap = c[:settled], straight[:settled], cap[:settled]
        after = profile.forward(c, straight, factor[:settled], *self.limits, self.speed, most, x)
        yield from self._sample(c, straight, cap, x, p.operation[new][:settled])
        self.speed = after
        # The last pieces that are done still ask something of those to come.
        over = self.run_over + settled
        far = self.allowed.reach_s * self.allowed.top_m_s
        passed = np.cumsum(p.length[:over][::-1])[::-1]
        kept = int(np.searchsorted(-passed, -far))
        self.pending, self.run_over = p.take(slice(kept, None)), over - kept

    def _sample(
        self,
        c: FloatArray,
        straight: IntArray,
        cap: FloatArray,
        x: FloatArray,
        operation: IntArray,
    ) -> Iterator[TrajectoryBlock]:
        state = np.array([0.0, 0.0, self.time_s])
        out = np.empty((SAMPLES, c.shape[2]))
        owner = np.empty(SAMPLES, dtype=np.int64)
        step = self.allowed.smoothing.step_s
        assert self.smoother is not None
        while state[0] < len(c):
            count = profile.sample(c, straight, cap, x, *self.limits, step, state, out, owner)
            if count:
                fresh = self.smoother.extend(out[:count].copy(), operation[owner[:count]])
                yield from self._emit(*fresh)
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
