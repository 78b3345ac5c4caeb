"""Planned path -> trajectory."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

from threadline.errors import BudgetError
from threadline.machine import Machine
from threadline.path.types import PieceBlock, PlannedPath, Timing
from threadline.signals import Stream
from threadline.trajectory.follow import followed_blocks
from threadline.trajectory.timed import smoothed_blocks, timed_blocks
from threadline.trajectory.types import Trajectory


def plan_trajectory(path: PlannedPath, machine: Machine) -> Trajectory:
    """Return the axis positions over time.

    A path whose pieces have their times keeps them, smoothed where the path leaves room for it
    (``smoothing_m``) because its acceleration steps; the shape of any other is followed as fast
    as the limits of ``machine`` and the programmed feed allow.

    Raises
    ------
    BudgetError
        While the trajectory is read: if the programmed feeds and dwells alone take more ticks
        than the machine file allows. It comes before any sample of the pieces that are too long.
    """
    path = replace(path, blocks=Stream(partial(_within_budget, path, machine)))
    if path.timing is Timing.TIME and path.smoothing_m > 0:
        return Trajectory(axes=path.axes, blocks=Stream(lambda: smoothed_blocks(path, machine)))
    if path.timing is Timing.TIME:
        return Trajectory(
            axes=path.axes,
            historical=path.historical,
            blocks=Stream(lambda: timed_blocks(path)),
        )
    return Trajectory(axes=path.axes, blocks=Stream(lambda: followed_blocks(path, machine)))


def _within_budget(path: PlannedPath, machine: Machine) -> Iterator[PieceBlock]:
    """Yield the pieces of ``path`` as long as the least time they take is within the budget."""
    period_s = float(machine.tick_clock.period_s)
    budget = machine.tick_budget.si
    least_s = 0.0
    for block in path:
        least_s += float(block.nominal_s.sum() + block.dwell_s.sum())
        if least_s / period_s > budget:
            raise BudgetError(
                f"the job needs more than {least_s / period_s:.3g} ticks of {period_s * 1e3:g} ms "
                f"at its feeds, the machine file allows {budget:.3g}",
                remedy="Raise the feed, shorten the job, or raise tick_budget in the machine file.",
            )
        yield block
