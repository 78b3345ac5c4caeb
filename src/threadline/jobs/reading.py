"""The readers of all job formats; the first line tells X-Winder programs from part programs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from threadline.errors import JobError, OptionError, Place
from threadline.jobs import embroidery
from threadline.jobs.gcode import read_part_program
from threadline.jobs.gcode.dialects import dialect_of
from threadline.jobs.moves import read_moves
from threadline.jobs.operations import Job
from threadline.jobs.seam import STITCHING_KEYS, SUFFIXES, read_seam
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
    """Return the job of a program; the first line identifies an X-Winder program.

    Raises
    ------
    JobError
        If the program cannot be read; the error gives file and line.
    BudgetError
        If the program has more operations than the machine's tick budget.
    OptionError
        If the options do not fit together, or do not fit the file.
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


@dataclass(frozen=True, slots=True)
class Format:
    """A format of job files.

    Parameters
    ----------
    name
        Name of the format to show to the user.
    extensions
        Endings of file names, with the dot, in lower case. The first format with a matching ending
        applies, so ``.seam.toml`` stands before ``.toml``.
    read
        Reader of the format; its arguments are the path, ``machine=`` and the options.
    options
        Names of the options that ``read`` takes.
    """

    name: str
    extensions: tuple[str, ...]
    read: Callable[..., Job]
    options: tuple[str, ...] = ()

    @property
    def article(self) -> str:
        """Indefinite article for the name."""
        return "an" if self.name[0] in "aeiou" else "a"


_TYPED = {
    "dialect": "--dialect", "feed_mode": "--feed-mode", "base_axes": "--feed-mode",
    "needle_speed": "--needle",
}  # fmt: skip
"""Command-line option for each reader option that has one."""

FORMATS: tuple[Format, ...] = (
    Format(
        "part program",
        (
            ".prg",
            ".nc",
            ".ngc",
            ".gcode",
            ".gco",
            ".g",
            ".cnc",
            ".tap",
            ".iso",
            ".txt",
            ".x4g",
            ".x2g",
        ),
        read_program,
        ("dialect", "feed_mode", "base_axes"),
    ),
    Format("seam", SUFFIXES, read_seam, STITCHING_KEYS),
    Format("move list", (".toml",), read_moves),
    Format("embroidery design", embroidery.SUFFIXES, embroidery.read_design),
)


def read_job(path: str | Path, machine: Machine, **options: Any) -> Job:
    """Return the job of a file, from the reader for its format.

    Parameters
    ----------
    path
        Job file; the ending of its name gives the format.
    machine
        Machine for the job.
    options
        Options of the format's reader.

    Raises
    ------
    JobError
        If the format is unknown, or the file does not have this format.
    OptionError
        If the format has no such option.
    """
    path = Path(path)
    extension = path.suffix.lower()
    for known in FORMATS:
        if path.name.lower().endswith(known.extensions):
            for name in options:
                if name not in known.options:
                    raise _refused(path, known, name)
            return known.read(path, machine=machine, **options)
    extensions = ", ".join(e for known in FORMATS for e in known.extensions)
    raise JobError(
        f"{extension or 'no extension'!r} is not a format of jobs that is known",
        place=Place(str(path)),
        remedy=f"Known: {extensions}.",
    )


def _refused(path: Path, known: Format, name: str) -> OptionError:
    """Return the error for an option that the file's format does not have."""
    of = [f"{one.name}s" for one in FORMATS if name in one.options]
    if not of:
        return OptionError(
            f"a {known.name} has no option {name!r}",
            remedy=f"It has: {', '.join(known.options) or 'none'}.",
        )
    typed = _TYPED.get(name, name)
    return OptionError(
        f"{Place(str(path))} is {known.article} {known.name}, and {typed} is of {' and '.join(of)}",
        remedy=f"Leave {typed} out.",
    )
