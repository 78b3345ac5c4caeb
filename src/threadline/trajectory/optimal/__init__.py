"""The fastest motion along a path within velocity, acceleration and jerk."""

from threadline.trajectory.optimal.motion_limits import Limits
from threadline.trajectory.optimal.path_elements import Elements, elements_of
from threadline.trajectory.optimal.solve import Solution, fastest

__all__ = ["Elements", "Limits", "Solution", "elements_of", "fastest"]
