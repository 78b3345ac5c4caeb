"""Trajectory -> commands, and one writer per controller."""

from threadline.targets.feedforward import followed_by_loads
from threadline.targets.following import Followed, Following, followed_by_motors
from threadline.targets.robust_following import robust_averages
from threadline.targets.ticks import compile_ticks

__all__ = [
    "Followed",
    "Following",
    "compile_ticks",
    "followed_by_loads",
    "followed_by_motors",
    "robust_averages",
]
