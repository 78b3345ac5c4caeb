"""What a firmware's own planner makes of a program: trapezoids of speed along its chords."""

from threadline.trajectory.firmware.trapezoids import firmware_blocks

__all__ = ["firmware_blocks"]
