"""Planned path + limits -> time, and the dense check of every limit."""

from threadline.trajectory.plan import plan_trajectory
from threadline.trajectory.types import Trajectory, TrajectoryBlock

__all__ = ["Trajectory", "TrajectoryBlock", "plan_trajectory"]
