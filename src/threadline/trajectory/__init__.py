"""Planned path + limits -> time, and the dense check of every limit."""

from threadline.trajectory.at_times import TrajectoryReader
from threadline.trajectory.averaged import (
    Averages,
    averaged_trajectory,
    even_averages,
    held_trajectory,
)
from threadline.trajectory.budget import check_budget
from threadline.trajectory.limits import Peak, check_limits, limit_peaks
from threadline.trajectory.limits_used import Retimed
from threadline.trajectory.path_to_trajectory import Pace, plan_trajectory
from threadline.trajectory.retime import retime
from threadline.trajectory.speed_steps import Leads, leads_of, with_steps
from threadline.trajectory.types import Trajectory, TrajectoryBlock

__all__ = [
    "Averages",
    "Leads",
    "Pace",
    "Peak",
    "Retimed",
    "Trajectory",
    "TrajectoryBlock",
    "TrajectoryReader",
    "averaged_trajectory",
    "check_budget",
    "check_limits",
    "even_averages",
    "held_trajectory",
    "leads_of",
    "limit_peaks",
    "plan_trajectory",
    "retime",
    "with_steps",
]
