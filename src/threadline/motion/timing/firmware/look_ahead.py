"""Look-ahead of firmwares: the squared speeds at the start of every move.

Grbl and Marlin hold a number of blocks and can always stop at the end of the last one (grbl wiki,
"Grbl v1.1 Overview", planner). Klipper looks ahead as far as its plan could still change
(docs/Kinematics.md, "Look-ahead" and "Minimum cruise ratio").
"""
# mypy: disable-error-code="no-untyped-def,untyped-decorator"

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.motion.path.types import PieceBlock
from threadline.motion.timing.firmware.rules import Rules, standing
from threadline.motion.timing.types import TrajectoryBlock


@njit()
def entries_of_ring(most, gain, ring, begin):
    """Return the (n + 1,) squared speeds at the ends of n moves, for a ring of blocks.

    Parameters
    ----------
    most : (n,)
        Largest v^2 at the start of each move.
    gain : (n,)
        2 a s: possible change of v^2 along each move.
    ring : int
        Moves planned together; the machine could stop at the end of the last of them.
    begin : float
        v^2 at the start of the first move.
    """
    count = len(most)
    entries = np.zeros(count + 1)
    entries[0] = begin
    for i in range(count - 1):
        end = min(count, i + ring)
        reachable = 0.0
        for j in range(end - 1, i, -1):
            reachable = min(most[j], reachable + gain[j])
        entries[i + 1] = min(reachable, entries[i] + gain[i])
    return entries


@njit()
def entries_in_marlin(most, least, gain, ring, goes_on, begin):
    """Return the (n + 1,) squared speeds at the ends of n moves, as Marlin computes them.

    With every added move it looks back as far as speeds can rise, but not beyond a move that stays
    unchanged, even if earlier ones could then begin faster; then it looks forward. The running move
    and the start of the next one are left unchanged.

    Parameters
    ----------
    most, least : (n,)
        Largest and least v^2 at the start of each move.
    gain : (n,)
        2 a s: possible change of v^2 along each move.
    ring : int
        Buffered moves, without the running one.
    goes_on : bool
        Whether earlier moves are running; else the ring is filled before anything moves.
    begin : float
        v^2 at the start of the first move.
    """
    count = len(most)
    entries = np.zeros(count + 1)
    sure_entries, largest_entries = np.copy(least), np.copy(most)
    changed = np.zeros(count, np.bool_)
    entries[0] = sure_entries[0] = largest_entries[0] = begin
    for added in range(1, count):
        running = added - ring
        if running < 0 or (running == 0 and not goes_on):
            running = -1
        entries[added] = entry_after = least[added]
        i = added
        while i > running + 1:
            reachable = min(entry_after + gain[i], largest_entries[i])
            if entries[i] == largest_entries[i] or entries[i] == reachable:
                break
            entries[i], changed[i] = reachable, True
            entry_after = reachable
            i -= 1
        changed[added] = True
        for i in range(max(running, 0) + 1, added + 1):
            if not changed[i]:
                continue
            changed[i] = False
            if i - 1 == running:
                entries[i] = sure_entries[i]
            elif entries[i] != sure_entries[i]:
                reachable = entries[i - 1] + gain[i - 1]
                if reachable < entries[i]:
                    entries[i] = largest_entries[i] = max(reachable, sure_entries[i])
                sure_entries[i] = entries[i]
    entries[count] = least[count - 1]
    return entries


@njit()
def speeds_with_cruise(most, top, gain, smooth, start, smooth_start, cruise):
    """Plan moves so that none speeds up only to slow down at once.

    A second plan with the lower acceleration of ``smooth`` limits the largest speed of a stretch of
    moves to half way between the speeds that its two ends permit. No move of the stretch is faster.

    Parameters
    ----------
    most : (n,)
        Largest v^2 at the start of each move, from the corners.
    top : (n,)
        Largest v^2 of each move.
    gain, smooth : (n,)
        Possible change of v^2 along each move, in the plan and in the second plan.
    start, smooth_start : float
        v^2 at the start of the first move, in both.
    cruise : float
        Largest v^2 of the previous move.

    Returns
    -------
    enter, leave, peak : (n,)
        v^2 at both ends of each move and its largest.
    fixed : int
        Number of first moves that stay unchanged, whatever comes after the last.
    first, second : (n,)
        The largest v^2 at each start if nothing has to stop ahead, in both plans.
    """
    count = len(most)
    first, second = np.empty(count), np.empty(count)
    first[0], second[0] = start, smooth_start
    for i in range(1, count):
        first[i] = min(most[i], top[i], top[i - 1], first[i - 1] + gain[i - 1])
        second[i] = min(first[i], second[i - 1] + smooth[i - 1])
    enter, leave, peak = np.empty(count), np.empty(count), np.empty(count)
    peak_limit, waiting_count, fixed = 0.0, 0, 0
    entry_after, smooth_entry_after = 0.0, 0.0
    is_free = False  # whether moves after the last one are irrelevant
    for i in range(count - 1, -1, -1):
        reachable, smooth_reachable = entry_after + gain[i], smooth_entry_after + smooth[i]
        enter[i], leave[i], peak[i] = min(first[i], reachable), entry_after, -1.0
        smooth_entry = min(second[i], smooth_reachable)
        waiting_count += 1
        if smooth_entry < smooth_reachable:
            if smooth_entry + smooth[i] > smooth_entry_after or waiting_count > 1:
                if not is_free and peak_limit > 0.0:
                    is_free, fixed = True, i + waiting_count
                peak_limit = 0.5 * (smooth_entry + smooth_reachable)
            peak[i] = min(0.5 * (enter[i] + reachable), top[i], peak_limit)
            waiting_count = 0
        entry_after, smooth_entry_after = enter[i], smooth_entry
    for i in range(count):
        if peak[i] < 0.0:
            peak[i] = min(cruise, enter[i])
        cruise = peak[i]
        enter[i], leave[i] = min(enter[i], cruise), min(leave[i], cruise)
    return enter, leave, peak, fixed, first, second


AT_ONCE = 16_384  # buffered moves before planning; more if too few are settled

Taken = tuple[FloatArray, FloatArray, FloatArray, IntArray]
"""For n moves: (n, axes) starts, (n, axes) displacements, (n,) times at the feed and operations."""


@dataclass(slots=True)
class MovesInHand(ABC):
    """Buffers the moves since the last rest whose speeds may still change.

    Attributes
    ----------
    begin_s
        Start time of the first of them.
    begun
        Whether it continues a move that was already yielded.
    """

    rules: Rules
    begin_s: float = 0.0
    start: list[FloatArray] = field(default_factory=list)
    way: list[FloatArray] = field(default_factory=list)
    nominal_s: list[FloatArray] = field(default_factory=list)
    operation: list[IntArray] = field(default_factory=list)
    waiting: int = 0
    begun: bool = False

    def extend(self, block: PieceBlock, rows: slice, *, is_last: bool) -> Iterator[TrajectoryBlock]:
        """Add moves and yield the settled ones; all of them, and the dwell, at a run's end."""
        start, displacement = block.coefficients[rows, 0], block.coefficients[rows, 1]
        moving = displacement.any(axis=1)
        nominal_s, operation = block.nominal_s[rows][moving], block.operation[rows][moving]
        taken = self._made((start[moving], displacement[moving], nominal_s, operation), is_last)
        self.start.append(taken[0])
        self.way.append(taken[1])
        self.nominal_s.append(taken[2])
        self.operation.append(taken[3])
        self.waiting += len(taken[0])
        if self.waiting and (is_last or self.waiting >= AT_ONCE):
            self._join()
            yield from self._settle(is_last)
        if not is_last:
            return
        dwell_s = float(block.dwell_s[rows][-1])
        if dwell_s > 0.0:
            yield standing(
                self.begin_s, start[-1] + displacement[-1], dwell_s, block.operation[rows][-1:]
            )
            self.begin_s += dwell_s
        self._keep(self.waiting)
        self.begun = False
        self._rest()

    def _made(self, taken: Taken, is_last: bool) -> Taken:  # noqa: ARG002 - Marlin's moves may wait
        """Return the moves made from the added ones; ``is_last``: the machine rests then."""
        return taken

    @abstractmethod
    def _settle(self, is_last: bool) -> Iterator[TrajectoryBlock]:
        """Yield the settled moves, each buffered list being one array, and drop them."""

    @abstractmethod
    def _rest(self) -> None:
        """Forget the speed at which the first buffered move begins."""

    def _timed(
        self, time_s: FloatArray, coefficients: FloatArray, operation: IntArray
    ) -> TrajectoryBlock:
        """Return (n, k) parts of n moves in a row, without parts of zero duration."""
        count, parts = time_s.shape
        is_kept = time_s.reshape(-1) > 0.0
        duration = time_s.reshape(-1)[is_kept]
        begin = self.begin_s + np.concatenate(([0.0], np.cumsum(duration)))
        self.begin_s = float(begin[-1])
        return TrajectoryBlock(
            start_s=begin[:-1],
            duration_s=duration,
            coefficients=coefficients.reshape(parts * count, *coefficients.shape[2:])[is_kept],
            operation=np.repeat(operation, parts)[is_kept],
        )

    def _join(self) -> None:
        for column in (self.start, self.way, self.nominal_s):
            column[:] = [np.concatenate(column)]
        self.operation[:] = [np.concatenate(self.operation)]

    def _keep(self, done: int) -> None:
        """Discard the moves that were yielded."""
        self._join()
        for column in (self.start, self.way, self.nominal_s):
            column[:] = [column[0][done:]]
        self.operation[:] = [self.operation[0][done:]]
        self.waiting -= done
