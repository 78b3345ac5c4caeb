"""Tables of references that begin and end together with the motion of the loads."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import ceil

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.dynamics.loop_ticks import InverseOutput
from threadline.dynamics.preview import AxisPreview, Demand
from threadline.dynamics.table_ends import CHOSEN, EARLIEST, AxisEnds, TableEnd
from threadline.files import Stream
from threadline.machine import Machine
from threadline.motion.timing import Trajectory, TrajectoryBlock

_EDGE_TICKS = 1024
"""Ticks kept at either end of a motion: more than any loop of ``AxisEnds`` remembers."""
_CLOSE_S = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ShortTable:
    """The changes that make a table of references shorter.

    Parameters
    ----------
    rows
        Number of rows of the shorter table.
    start_change, end_change
        (k, axes) corrections of the references: ``start_change`` from tick 0 on, ``end_change``
        for the last references up to the end of the last row.
    ends
        Table ends of each axis; empty for an axis without.
    """

    rows: int
    start_change: FloatArray
    end_change: FloatArray
    ends: tuple[tuple[TableEnd, ...], ...]

    def demands(self, whole: Sequence[Demand]) -> tuple[Demand, ...]:
        """Return the demand of the motion on each axis, including the ends of the table."""
        return tuple(
            demand.at_least(max((end.volts for end in ends), default=0.0))
            for demand, ends in zip(whole, self.ends, strict=True)
        )


class InverseEnds:
    """The inverse output of an axis at the ticks next to both ends of its motion."""

    def __init__(self) -> None:
        self.first = self.last = InverseOutput.none()
        self.ticks = 0

    def add(self, outputs: InverseOutput) -> None:
        """Append the inverse output of the next ticks."""
        self.ticks += len(outputs)
        if len(self.first) < _EDGE_TICKS:
            self.first = self.first.joined(outputs.part(0, _EDGE_TICKS - len(self.first)))
        both = self.last.joined(outputs)
        self.last = both.part(max(len(both) - _EDGE_TICKS, 0), len(both))

    @property
    def moves(self) -> bool:
        """Whether the reference changes at all."""
        return any(float(np.ptp(of.references_si)) > 0.0 for of in (self.first, self.last))

    def from_start(self, count: int, memory: int) -> InverseOutput:
        """Return the first ``count`` ticks, and as many more as the loop remembers."""
        first = self.first.part(0, count + memory)
        return first.held(count + memory - len(first))

    def to_end(self, first: int, memory: int) -> InverseOutput:
        """Return the ticks from ``first`` on, then rest for as many as the loop remembers."""
        begin = len(self.last) - (self.ticks - first)
        return self.last.part(begin, len(self.last)).held(memory)


def leads_s(machine: Machine, previews: Sequence[AxisPreview], whole_s: float) -> Iterator[float]:
    """Yield how long loads may rest at the start of a short table, s; the shortest first.

    Yields nothing unless every controller takes one reference per tick and one tick per row.

    Parameters
    ----------
    whole_s
        Rest at the start of a whole table, s: the longest rest that is tried.
    """
    step_s = float(machine.tick_clock.period_s)
    timings = [preview.timing for preview in previews]
    if not timings or any(
        timing.held_s > 0.0
        or abs(timing.tick_s - step_s) > _CLOSE_S
        or abs(timing.step_s - step_s) > _CLOSE_S
        for timing in timings
    ):
        return
    # A voltage in the tick before the first one would act, with half its hold, before the motion.
    early_s = max(timing.early_s for timing in timings) - step_s
    least = max(0, ceil(early_s / step_s - _CLOSE_S))
    yield from (step_s * k for k in range(least, round(whole_s / step_s) + 1))


def short_table(
    machine: Machine,
    trajectory: Trajectory,
    previews: Sequence[AxisPreview],
    inverse_ends: Sequence[InverseEnds],
    planned_s: float,
    within_m: float,
) -> ShortTable | None:
    """Return the shortest table with which loads leave their motion by ``within_m`` at most.

    None if no shorter table keeps the loads within ``within_m``.

    Parameters
    ----------
    trajectory
        Motion of the loads, at rest at its end until the oscillation of the inverses has decayed.
    inverse_ends
        Inverse output of each axis for this motion.
    planned_s
        Instant at which the motion and the wait after the motion are over.
    """
    step_s, axes = float(machine.tick_clock.period_s), trajectory.axes
    from threadline.motion.timing.optimal.motion_limits import reserve_of

    radius_m = machine.radius_m[[machine.axis_names.index(axis) for axis in axes]]
    rest_si = trajectory(np.array([0.0, trajectory.duration_s]))
    ends = {
        k: AxisEnds(machine, axis, previews[k], reserve_of(machine, axis))
        for k, axis in enumerate(axes)
        if inverse_ends[k].moves
    }
    ticks = max((of.ticks for of in inverse_ends), default=0)
    least = ceil(planned_s / step_s - 1e-9)
    if trajectory.moves_s[1] > planned_s - step_s:  # else the job itself rests at the end
        least = max(least - EARLIEST, 2)
    count = min(CHOSEN, least // 2)
    if ticks - least + count > _EDGE_TICKS:
        return None
    begun = {
        k: end.first_references(inverse_ends[k].from_start(count, end.memory), count, rest_si[0, k])
        for k, end in ends.items()
    }
    # Ends close to each other err at the same time: their errors add up.
    close = least < 2 * count + max((end.memory for end in ends.values()), default=0)
    for rows in range(least, ticks):
        found: dict[int, tuple[TableEnd, TableEnd]] = {}
        for k, end in ends.items():
            tail = inverse_ends[k].to_end(rows - count, end.memory)
            start, stop = begun[k], end.last_references(tail, count, rest_si[1, k])
            if start is None or stop is None:
                break
            found[k] = start, stop
        joined = sum if close else max
        off_m = [joined(end.off_si for end in pair) * radius_m[k] for k, pair in found.items()]
        if len(found) == len(ends) and float(np.linalg.norm(off_m)) <= within_m:
            return _table(rows, count, len(axes), found)
        if None in begun.values():
            return None
    return None


def _table(
    rows: int, count: int, axes: int, found: dict[int, tuple[TableEnd, TableEnd]]
) -> ShortTable:
    start_change, end_change = np.zeros((count + 1, axes)), np.zeros((count + 1, axes))
    for k, (start, end) in found.items():
        start_change[:, k], end_change[:, k] = start.more_si[: count + 1], end.more_si[: count + 1]
    return ShortTable(
        rows=rows,
        start_change=start_change,
        end_change=end_change,
        ends=tuple(found.get(k, ()) for k in range(axes)),
    )


def shortened(references: Trajectory, table: ShortTable) -> Trajectory:
    """Return the references of a shorter table, one straight piece per row."""
    return Trajectory(
        axes=references.axes, historical=True, blocks=Stream(_shortened, references, table)
    )


def _shortened(references: Trajectory, table: ShortTable) -> Iterator[TrajectoryBlock]:
    row = 0
    for block in references:
        count = min(len(block), table.rows - row)
        if count <= 0:
            return
        coefficients = block.coefficients[:count].copy()
        at = np.arange(row, row + count + 1)
        more = np.zeros((count + 1, coefficients.shape[2]))
        for start, change in (
            (0, table.start_change),
            (table.rows + 1 - len(table.end_change), table.end_change),
        ):
            inside = (at >= start) & (at < start + len(change))
            more[inside] += change[at[inside] - start]
        coefficients[:, 0] += more[:-1]
        coefficients[:, 1] += np.diff(more, axis=0)
        yield TrajectoryBlock(
            start_s=block.start_s[:count],
            duration_s=block.duration_s[:count],
            coefficients=coefficients,
            operation=block.operation[:count],
        )
        row += count
