"""Commands of a trajectory, and one writer per controller."""

from threadline.commands.feedforward import (
    Followed,
    Following,
    followed_by_loads,
    followed_by_motors,
)
from threadline.commands.robust_following import robust_averages
from threadline.commands.ticks import compile_ticks

__all__ = [
    "Followed",
    "Following",
    "compile_ticks",
    "followed_by_loads",
    "followed_by_motors",
    "robust_averages",
]
