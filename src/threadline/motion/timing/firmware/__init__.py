"""Motion as planned by a firmware: trapezoids of speed along its chords."""

from threadline.motion.timing.firmware.trapezoids import firmware_blocks

__all__ = ["firmware_blocks"]
