"""Trajectory -> commands, and one writer per controller."""

from threadline.targets.calculate import Calculation, calculate
from threadline.targets.ticks import compile_ticks
from threadline.targets.write import target_names, write

__all__ = ["Calculation", "calculate", "compile_ticks", "target_names", "write"]
