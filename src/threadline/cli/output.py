"""Output of the commands: tables for people, one JSON object for programs, and files.

Code that needs rich is in ``on_terminal``, which is loaded only to draw.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

from threadline.base.progress import Progress as ProgressCall
from threadline.base.wording import plain
from threadline.base.writing import check_output, is_stdout
from threadline.cli.messages import ASKING, STARTING, STDOUT, at_work, note, warning
from threadline.errors import OptionError

if TYPE_CHECKING:
    from threadline.jobs.operations import Job
    from threadline.machine import Machine

_STDOUT = 1  # its file descriptor
_FILE_WIDTH = 120  # width of a table in a file or a pipe, which has no width of its own


def print_json(content: Any) -> None:
    """Print ``content`` as one JSON object; a number that JSON lacks is an error, not a NaN."""
    text = json.dumps(content, allow_nan=False, indent=2)
    with _to_stdout():
        sys.stdout.write(text + "\n")


def say(text: str) -> None:
    """Print a line for people, with control characters written as escapes."""
    with _to_stdout():
        sys.stdout.write(plain(text) + "\n")


def ask(question: str) -> str:
    """Print a question and return the line typed after it; empty if input has ended."""
    with _to_stdout():
        sys.stdout.write(plain(question))
        sys.stdout.flush()
    ASKING.set()
    try:
        return sys.stdin.readline()
    finally:
        ASKING.clear()


@contextmanager
def _to_stdout() -> Iterator[None]:
    """Name standard output in an ``OSError`` from writing to it, such as a full disk."""
    STARTING.over()
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        error.filename = error.filename or STDOUT
        raise


@contextmanager
def report_failed_print(else_: str) -> Iterator[None]:
    """Print as far as standard output accepts it; report a failure on standard error only.

    For results that are already final: a failed print must not change their exit status. If the
    reader of a pipe is gone, the program ends as other commands do.

    Parameters
    ----------
    else_
        Where the same content can be found.
    """
    try:
        yield
        sys.stdout.flush()
    except BrokenPipeError:
        raise
    except OSError as error:
        with suppress(OSError):  # otherwise the interpreter flushes the rest at exit, and fails
            os.dup2(os.open(os.devnull, os.O_WRONLY), _STDOUT)
        note(f"{STDOUT} cannot be written ({error.strerror or error}); {else_}")


def say_lines(text: str) -> None:
    """Print the lines of ``text``, each with ``say``."""
    for line in text.splitlines():
        say(line)


def print_table(title: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table; columns are aligned right, except the first and a last one called note."""
    from threadline.cli.on_terminal import laid_out

    width = None if sys.stdout.isatty() else _FILE_WIDTH
    console, table, notes = laid_out(title, header, rows, width)
    with _to_stdout():
        console.print(table)
        for subject, note_text in notes:
            console.print(
                f"  {subject}: {note_text}", markup=False, highlight=False, soft_wrap=True
            )


@contextmanager
def progress_bar(wanted: bool = True) -> Iterator[ProgressCall]:
    """Yield a progress call that draws a bar on a terminal after one second.

    Without a terminal no bar is drawn; ``telling`` prints the share done each minute.
    """
    if not wanted or not sys.stderr.isatty():
        yield partial(at_work, shown=False)
        return
    from threadline.cli.on_terminal import bar_on_terminal

    with bar_on_terminal() as update:
        yield update


_STEMS = ("report", "comparison", "shaper", "analysis", "design")
"""Page names of reports, without suffix, whose files must be writable."""


def check_outputs(
    *, file: Path | None = None, folder: Path | None = None, worst: Path | None = None
) -> None:
    """Refuse outputs that could not be written, before hours of work go into them.

    Parameters
    ----------
    file
        File to write; its folder may be missing.
    folder
        Folder to write into; it may be missing.
    worst
        Machine file to write; commands take a name for one if it ends in .toml.

    Raises
    ------
    OptionError
        If ``worst`` has another ending, a file stands where a folder is needed, the folder is not
        writable, or the target exists and cannot be replaced.
    """
    if file is not None:
        check_output(file)
        if not is_stdout(file):
            _check_folder(Path(os.path.realpath(file)).parent, file)
    if worst is not None and worst.suffix != ".toml" and not is_stdout(worst):
        raise OptionError(
            f"--worst {str(worst)!r}: the name of a machine file ends in .toml",
            remedy=f"Write --worst {worst.name}.toml, or another such name.",
        )
    if folder is not None:
        _check_folder(Path(os.path.realpath(folder)), folder)
        for stem, ending in product(_STEMS, ("html", "pdf")):
            if (page := folder / f"{stem}.{ending}").exists():
                check_output(page)


def _check_folder(folder: Path, wanted: Path) -> None:
    existing = folder
    while not os.path.lexists(existing) and existing != existing.parent:
        existing = existing.parent
    if not existing.is_dir():
        raise OptionError(
            f"cannot write {str(wanted)!r}: {str(existing)!r} is not a folder",
            remedy="Give another path.",
        )
    if not os.access(existing, os.W_OK | os.X_OK):
        raise OptionError(
            f"cannot write {str(wanted)!r}: no permission to write in {str(existing)!r}",
            remedy="Give another path.",
        )


def warn(machine: Machine, job: Job, more: Iterable[str] = (), *, own_feed: bool) -> None:
    """Warn of suspicious values of ``machine`` and ``job``, and print the warnings in ``more``.

    ``own_feed``: the job runs at its own feeds, which are then checked too.
    """
    from threadline.dynamics.plausibility import plausibility_warnings

    tell([*plausibility_warnings(machine), *job.suspicions(own_feed=own_feed), *more])


def tell(warnings: Iterable[str]) -> None:
    """Print warnings once the command has answered."""
    for text in warnings:
        warning(text)
