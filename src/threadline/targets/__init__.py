"""Trajectory -> commands, and one writer per controller."""

from threadline.targets.calculate import Calculation, calculate
from threadline.targets.feedforward import FeedForwardPlan, feed_forward_commands
from threadline.targets.ticks import compile_ticks
from threadline.targets.write import target_names, write

__all__ = [
    "Calculation",
    "FeedForwardPlan",
    "calculate",
    "compile_ticks",
    "feed_forward_commands",
    "target_names",
    "write",
]
