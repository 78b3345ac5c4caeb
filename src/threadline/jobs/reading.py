"""The readers of all job formats; the first line tells X-Winder programs from part programs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from threadline.errors import JobError, OptionError, Place
from threadline.jobs import embroidery
from threadline.jobs.axis_table import is_axis_table, read_axis_table
from threadline.jobs.gcode import read_part_program
from threadline.jobs.gcode.dialects import dialect_of
from threadline.jobs.gcode.foreign import guesses
from threadline.jobs.moves import read_moves
from threadline.jobs.operations import Job
from threadline.jobs.seam import STITCHING_KEYS, SUFFIXES, read_seam
from threadline.jobs.xwinder import begins_as_x_winder, read_x_winder
from threadline.machine import Machine

X_WINDER = "x-winder"
DEFAULT_DIALECT = "winder"
"""Dialect of a machine file that names none."""


def read_program(
    path: str | Path,
    *,
    machine: Machine,
    dialect: str | None = None,
    feed_mode: str | None = None,
    base_axes: tuple[str, ...] = (),
    axes: str | None = None,
) -> Job:
    """Return the job of a program; the first line identifies an X-Winder program.

    Where neither an option nor the machine file names a dialect, the dialect is guessed from the
    program, and a warning says so.

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
        read = partial(
            read_part_program,
            path,
            machine=machine,
            feed_mode=feed_mode,
            base_axes=base_axes,
            axes=axes,
        )
        guessed = dialect is None and machine.programs.dialect == DEFAULT_DIALECT
        return _read_guessed(path, read) if guessed else read(dialect=dialect)
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
    return read_x_winder(path, machine=machine, axes=axes)


def _read_guessed(path: Path, read: Callable[..., Job]) -> Job:
    """Return the job of a program in the default dialect, else in one that the program shows."""
    try:
        return read(dialect=DEFAULT_DIALECT)
    except JobError as error:
        refused = [error]
    likely = guesses(path)
    for guess in likely:
        try:
            job = read(dialect=guess.dialect)
        except JobError as error:
            refused.append(error)
            continue
        said = (
            f"{Place(str(path))}: read in the dialect {guess.dialect}, guessed from the file "
            f"(it has {guess.mark!r}); --dialect names another."
        )
        return replace(job, warnings=(said, *job.warnings))
    # The dialect that the file names explains best what is wrong, else the one that read furthest.
    if likely and likely[0].named:
        raise refused[1]
    raise max(refused, key=lambda error: error.place.line if error.place is not None else 0)


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
    has
        Whether a file with such an ending has this format; None: always.
    """

    name: str
    extensions: tuple[str, ...]
    read: Callable[..., Job]
    options: tuple[str, ...] = ()
    has: Callable[[Path], bool] | None = None

    @property
    def article(self) -> str:
        """Indefinite article for the name."""
        return "an" if self.name[0] in "aeiou" else "a"


_TYPED = {
    "dialect": "--dialect", "feed_mode": "--feed-mode", "base_axes": "--feed-mode",
    "needle_speed": "--needle", "axes": "--axes",
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
        ("dialect", "feed_mode", "base_axes", "axes"),
    ),
    Format(
        "axis table",
        (".csv",),
        read_axis_table,
        ("feed_mode", "base_axes", "axes"),
        is_axis_table,
    ),
    Format("seam", SUFFIXES, read_seam, STITCHING_KEYS),
    Format("move list", (".toml",), read_moves),
    Format("embroidery design", embroidery.SUFFIXES, embroidery.read_design),
)

_PLANNED_ELSEWHERE = {
    ".wind": "a winding definition of FiberPath: mandrel, fibre and layers, from which a planner "
    "makes the moves; it has none itself",
}
"""Files that belong to a job and hold no moves, by their ending."""


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
        fits = path.name.lower().endswith(known.extensions)
        if fits and (known.has is None or known.has(path)):
            for name in options:
                if name not in known.options:
                    raise _refused(path, known, name)
            return known.read(path, machine=machine, **options)
    if extension in _PLANNED_ELSEWHERE:
        raise JobError(
            _PLANNED_ELSEWHERE[extension],
            place=Place(str(path)),
            remedy="Have that planner write its program (.gcode), and give the program.",
        )
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
