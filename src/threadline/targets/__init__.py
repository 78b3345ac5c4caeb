"""Trajectory -> commands, and one writer per controller."""

from threadline.targets.ticks import compile_ticks

__all__ = ["compile_ticks"]
