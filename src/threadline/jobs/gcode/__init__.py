"""The reader of part programs (G-code): it checks every block and runs in bounded memory."""

from threadline.jobs.gcode.part_program import read_part_program

__all__ = ["read_part_program"]
