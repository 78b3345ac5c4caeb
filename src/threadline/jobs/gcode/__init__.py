"""Part programs (G-code) -> a job: every block checked, then followed in bounded memory."""

from threadline.jobs.gcode.part_program import read_part_program

__all__ = ["read_part_program"]
