"""Planned path + limits -> time, and the dense check of every limit."""

from threadline.trajectory.averaged import averaged_trajectory, held_trajectory
from threadline.trajectory.limits import Peak, check_limits, limit_peaks
from threadline.trajectory.plan import plan_trajectory
from threadline.trajectory.reading import TrajectoryReader
from threadline.trajectory.types import Trajectory, TrajectoryBlock

__all__ = [
    "Peak",
    "Trajectory",
    "TrajectoryBlock",
    "TrajectoryReader",
    "averaged_trajectory",
    "check_limits",
    "held_trajectory",
    "limit_peaks",
    "plan_trajectory",
]
