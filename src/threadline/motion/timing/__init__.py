"""Planned path + limits -> time, and the dense check of every limit."""

from typing import TYPE_CHECKING

from threadline.base.importing import later

if TYPE_CHECKING:
    from threadline.motion.timing.averaged import (
        Averages,
        averaged_trajectory,
        even_averages,
        held_trajectory,
    )
    from threadline.motion.timing.by_law import Leads, leads_of, with_steps
    from threadline.motion.timing.limits import Peak, check_limits, limit_peaks
    from threadline.motion.timing.path_to_trajectory import Pace, check_budget, plan_trajectory
    from threadline.motion.timing.types import Trajectory, TrajectoryBlock, TrajectoryReader

__all__ = [
    "Averages", "Leads", "Pace", "Peak", "Trajectory", "TrajectoryBlock", "TrajectoryReader",
    "averaged_trajectory", "check_budget", "check_limits", "even_averages", "held_trajectory",
    "leads_of", "limit_peaks", "plan_trajectory", "with_steps",
]  # fmt: skip

__getattr__ = later(
    __name__,
    {
        "averaged": "Averages averaged_trajectory even_averages held_trajectory",
        "by_law": "Leads leads_of with_steps",
        "limits": "Peak check_limits limit_peaks",
        "path_to_trajectory": "Pace check_budget plan_trajectory",
        "types": "Trajectory TrajectoryBlock TrajectoryReader",
    },
)
