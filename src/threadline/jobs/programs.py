"""The reader of programs: part programs, and those of X-Winder, told apart by their first line."""

from __future__ import annotations

from pathlib import Path

from threadline.errors import OptionError, Place
from threadline.jobs.gcode import read_part_program
from threadline.jobs.gcode.dialects import dialect_of
from threadline.jobs.operations import Job
from threadline.jobs.xwinder import begins_as_x_winder, read_x_winder
from threadline.machine import Machine

X_WINDER = "x-winder"


def read_program(
    path: str | Path,
    *,
    machine: Machine,
    dialect: str | None = None,
    feed_mode: str | None = None,
    base_axes: tuple[str, ...] = (),
) -> Job:
    """Return the job of a program; an X-Winder program is recognised by its first line.

    Raises
    ------
    JobError
        With file and line, if it cannot be read.
    BudgetError
        If it has more moves than the machine's tick budget.
    OptionError
        If the options do not fit together, or the file.
    """
    path = Path(path)
    theirs = begins_as_x_winder(path)
    if dialect_of(machine, dialect) != X_WINDER and not theirs:
        return read_part_program(
            path, machine=machine, dialect=dialect, feed_mode=feed_mode, base_axes=base_axes
        )
    if dialect not in (None, X_WINDER):
        raise OptionError(
            f"{Place(str(path))} is an X-Winder Designer program, and no {dialect} one",
            remedy="Leave --dialect out.",
        )
    if feed_mode is not None:
        raise OptionError(
            "X-Winder programs say what F means: inches or millimetres a second of the carriage",
            remedy="Leave --feed-mode out.",
        )
    return read_x_winder(path, machine=machine)
