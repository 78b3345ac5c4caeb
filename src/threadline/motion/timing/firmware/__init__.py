"""What a firmware's own planner makes of a program: trapezoids of speed along its chords."""

from threadline.motion.timing.firmware.trapezoids import firmware_blocks

__all__ = ["firmware_blocks"]
