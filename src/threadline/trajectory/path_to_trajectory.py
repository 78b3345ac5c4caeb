"""Planned path -> trajectory."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from enum import StrEnum

import numpy as np

from threadline.arrays import FloatArray
from threadline.errors import BudgetError, OptionError
from threadline.laws import Law
from threadline.machine import Machine
from threadline.machine.within_path import within_path
from threadline.path.interpolations import CHORDS, on_chords
from threadline.path.types import PieceBlock, PlannedPath, Timing
from threadline.signals import KeptStream, Stream
from threadline.trajectory.as_programmed import as_programmed
from threadline.trajectory.by_law import breaks_jerk, by_law
from threadline.trajectory.firmware import firmware_blocks
from threadline.trajectory.follow import followed_blocks
from threadline.trajectory.optimal.fastest_motion import fastest_blocks
from threadline.trajectory.timed import smoothed_blocks, timed_blocks
from threadline.trajectory.types import Trajectory

_MOST_KEPT = 20_000  # pieces of a path whose fastest motion is kept


class Pace(StrEnum):
    """How the time along a path is chosen."""

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

    A path whose pieces have their times keeps them, smoothed where the path leaves room for it
    (``smoothing_m``) because its acceleration steps; the shape of any other is followed as fast
    as the limits of ``machine`` and the programmed feed allow, or at its programmed times.

    Parameters
    ----------
    path
        What is to be followed.
    machine
        Its limits.
    pace
        ``PROGRAMMED`` of chords keeps every programmed time; their velocity steps, so that the
        trajectory is historical until it is smoothed. ``LAW`` makes every chord a move from rest
        to rest; it is historical where its jerk is infinite and an axis limits it.
    law
        The motion law for the pace ``LAW``.
    contour_m
        How far the loads may be from a path that is timed as the fastest, while their loops
        follow it; infinite where that is no limit.
    of_loads
        Whether loads are to follow a path that is timed as the fastest, and no motors.
    along_m_s2
        Most acceleration along a path that is timed as the fastest, at the tool.

    Raises
    ------
    OptionError
        If a curved path is to keep programmed times or to follow a law, or the law goes back.
    BudgetError
        While the trajectory is read: if the programmed feeds and dwells alone take more ticks
        than the machine file allows. It comes before any sample of the pieces that are too long.
    PlanError
        While the trajectory of ``contour_m`` is read: if loads stray farther however slow it is.
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
    path = replace(path, blocks=KeptStream(_within_budget, path, machine))
    if path.timing is Timing.TIME and path.smoothing_m > 0:
        return Trajectory(axes=path.axes, blocks=KeptStream(smoothed_blocks, path, machine))
    if path.timing is Timing.TIME:
        return Trajectory(
            axes=path.axes,
            historical=path.historical,
            blocks=KeptStream(timed_blocks, path),
        )
    if path.timing is Timing.FIRMWARE and machine.planner is not None:
        return Trajectory(
            axes=path.axes,
            historical=True,
            blocks=KeptStream(firmware_blocks, path, machine, machine.planner),
        )
    if path.timing is Timing.FASTEST:
        blocks = Stream(
            fastest_blocks, path, machine, contour_m, of_loads=of_loads, along_m_s2=along_m_s2
        )
        # It will be read many times: a short motion is worked out once and kept.
        return Trajectory(
            axes=path.axes, blocks=Stream.of(list(blocks)) if _short(path) else blocks
        )
    return Trajectory(axes=path.axes, blocks=KeptStream(followed_blocks, path, machine))


def _short(path: PlannedPath) -> bool:
    """Say whether all pieces of a path may be kept."""
    count = 0
    for block in path:
        count += len(block)
        if count > _MOST_KEPT:
            return False
    return True


def _longest(
    block: PieceBlock, moved_s: FloatArray, axes: tuple[str, ...], fastest: FloatArray
) -> str:
    """Say which of the pieces takes longest, and what makes it so long."""
    lasts_s = moved_s + block.dwell_s
    k = int(np.argmax(lasts_s))
    ways = np.abs(block.coefficients[k, 1:].sum(axis=0)) / fastest
    if block.dwell_s[k] >= moved_s[k]:
        why = "its dwell"
    elif block.nominal_s[k] >= ways.max():
        why = "its feed"
    else:
        why = f"the velocity limit of axis {axes[int(np.argmax(ways))]}"
    return f"line {block.line[k]} of the job alone takes {lasts_s[k]:.3g} s by {why}"


def _within_budget(path: PlannedPath, machine: Machine) -> Iterator[PieceBlock]:
    """Yield the pieces of ``path`` as long as the least time they take is within the budget."""
    period_s = float(machine.tick_clock.period_s)
    budget = machine.tick_budget.si
    least_s = 0.0
    # A geometric piece takes as long as its slowest axis takes over the way between its ends.
    fastest = np.array([machine.axes[axis].velocity.si for axis in path.axes])
    bound = path.timing is not Timing.TIME
    for block in path:
        moved_s, order = block.nominal_s, block.coefficients.shape[1]
        if bound:
            # Column by column: numpy adds and compares along short inner axes slowly.
            way = block.coefficients[:, 1].copy()
            for k in range(2, order):
                way += block.coefficients[:, k]
            for axis_s in (np.abs(way) / fastest).T:
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
