"""Output of the commands: tables for people, one JSON object for programs."""

from __future__ import annotations

import json
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from threadline.cli.told import STARTING, STDOUT, at_work
from threadline.escaping import plain
from threadline.pipeline import Progress as ProgressCall

_SHOW_AFTER_S = 1.0
_WRAPPED = 40  # characters: a narrower column breaks a note too often
_FILE_WIDTH = 120  # of a table in a file or a pipe, which has no width of its own


def print_json(content: Any) -> None:
    """Print ``content`` as one JSON object; a number that JSON lacks is an error, not a NaN."""
    text = json.dumps(content, allow_nan=False, indent=2)
    with _to_stdout():
        sys.stdout.write(text + "\n")


def say(text: str) -> None:
    """Print a line for people, with control characters written as escapes."""
    with _to_stdout():
        sys.stdout.write(plain(text) + "\n")


@contextmanager
def _to_stdout() -> Iterator[None]:
    """Name standard output in an ``OSError`` of writing to it, such as that of a full disk."""
    STARTING.over()
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        error.filename = error.filename or STDOUT
        raise


def say_lines(text: str) -> None:
    """Print the lines of ``text``, each by ``say``."""
    for line in text.splitlines():
        say(line)


def print_table(title: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table; all columns but the first and a last one called note are aligned right."""
    console = Console() if sys.stdout.isatty() else Console(width=_FILE_WIDTH)
    title, header = plain(title), [plain(cell) for cell in header]
    rows = [[plain(cell) for cell in row] for row in rows]
    notes: list[tuple[str, str]] = []
    if header[-1] == "note" and not _fits(header, rows, console.width):
        named = 2 if len(header) > 1 and header[1] == "axis" else 1
        notes = [(" ".join(row[:named]).strip(), row[-1]) for row in rows if row[-1]]
        header, rows = header[:-1], [row[:-1] for row in rows]
    # Text, not str: rich would take "[/b]" for its own markup, and ":x:" for a picture.
    table = Table(title=Text(title), title_justify="left", title_style="bold", box=SIMPLE_HEAD)
    for index, name in enumerate(header):
        text = index == 0 or name == "note"
        table.add_column(
            Text(name),
            justify="left" if text else "right",
            no_wrap=name != "note",
            overflow="fold",
        )
    for row in rows:
        table.add_row(*map(Text, row))
    with _to_stdout():
        console.print(table)
        for subject, said in notes:
            console.print(f"  {subject}: {said}", markup=False, highlight=False, soft_wrap=True)


def _fits(header: Sequence[str], rows: Sequence[Sequence[str]], width: int) -> bool:
    """Return whether the last column has room for its longest text, or for ``_WRAPPED``."""
    lines = [header, *rows]
    others = sum(max(len(line[k]) for line in lines) + 2 for k in range(len(header) - 1))
    return width - others - 2 >= min(max(len(line[-1]) for line in lines), _WRAPPED)


@contextmanager
def progress_bar(wanted: bool = True) -> Iterator[ProgressCall]:
    """Yield a progress call that draws a bar on a terminal once a second has passed.

    Without a terminal nothing is drawn; the line that ``told`` prints each minute has the share.
    """
    if not wanted or not sys.stderr.isatty():
        yield partial(at_work, shown=False)
        return
    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f}%"),
        TimeElapsedColumn(),
        console=Console(stderr=True),
        transient=True,
    )
    task = bar.add_task("starting", total=1.0)
    shown, over, lock = threading.Event(), threading.Event(), threading.Lock()

    def show() -> None:
        with lock:
            if not over.is_set():
                STARTING.over()
                bar.start()
                shown.set()

    def update(what: str, fraction: float) -> None:
        at_work(what, fraction, shown=shown.is_set())
        bar.update(task, description=what, completed=fraction)

    # A single step may take minutes: the bar does not wait for the next one to be told.
    timer = threading.Timer(_SHOW_AFTER_S, show)
    timer.daemon = True
    timer.start()
    try:
        yield update
    finally:
        timer.cancel()
        with lock:
            over.set()
            if shown.is_set():
                bar.stop()
