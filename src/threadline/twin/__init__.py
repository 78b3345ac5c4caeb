"""Tick-exact simulation: commands and machine in, recording out."""

from threadline.twin.simulate import simulate

__all__ = ["simulate"]
