"""Planned path -> trajectory."""

from __future__ import annotations

from threadline.machine import Machine
from threadline.path.types import PlannedPath, Timing
from threadline.signals import Stream
from threadline.trajectory.follow import followed_blocks
from threadline.trajectory.timed import smoothed_blocks, timed_blocks
from threadline.trajectory.types import Trajectory


def plan_trajectory(path: PlannedPath, machine: Machine) -> Trajectory:
    """Return the axis positions over time.

    A path whose pieces have their times keeps them, smoothed where the path leaves room for it
    (``smoothing_m``) because its acceleration steps; the shape of any other is followed as fast
    as the limits of ``machine`` and the programmed feed allow.
    """
    if path.timing is Timing.TIME and path.smoothing_m > 0:
        return Trajectory(axes=path.axes, blocks=Stream(lambda: smoothed_blocks(path, machine)))
    if path.timing is Timing.TIME:
        return Trajectory(
            axes=path.axes,
            historical=path.historical,
            blocks=Stream(lambda: timed_blocks(path)),
        )
    return Trajectory(axes=path.axes, blocks=Stream(lambda: followed_blocks(path, machine)))
