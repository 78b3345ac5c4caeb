"""Planned path + limits -> time, and the dense check of every limit."""

from threadline.trajectory.limits import Peak, check_limits, limit_peaks
from threadline.trajectory.plan import plan_trajectory
from threadline.trajectory.types import Trajectory, TrajectoryBlock

__all__ = [
    "Peak",
    "Trajectory",
    "TrajectoryBlock",
    "check_limits",
    "limit_peaks",
    "plan_trajectory",
]
