"""The fastest motion along a path within velocity, acceleration and jerk."""

from threadline.motion.timing.optimal.elements import Elements, elements_of
from threadline.motion.timing.optimal.motion_limits import Limits
from threadline.motion.timing.optimal.solve import Solution, fastest

__all__ = ["Elements", "Limits", "Solution", "elements_of", "fastest"]
