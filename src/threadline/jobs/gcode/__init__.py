"""The reader of part programs (G-code): it checks every block and runs in bounded memory."""

from typing import TYPE_CHECKING

from threadline.base.importing import later

if TYPE_CHECKING:
    from threadline.jobs.gcode.part_program import read_part_program

__all__ = ["read_part_program"]

__getattr__ = later(__name__, {"part_program": "read_part_program"})
