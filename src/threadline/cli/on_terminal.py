"""Tables and progress bars drawn with rich."""

from __future__ import annotations

import io
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import IO, TextIO, cast

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn, TimeElapsedColumn
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from threadline.base.progress import COMPILING, USUAL_FUNCTIONS
from threadline.base.progress import Progress as ProgressCall
from threadline.base.wording import plain
from threadline.cli.messages import STARTING, at_work, in_full, share_of

_SHOW_AFTER_S = 1.0
_SHORT_BAR = 20  # characters, so that the text beside it takes two lines of a terminal of 80
_BETWEEN = 3  # characters that a column takes beside its text
_WRAPPED = 40  # characters: a narrower column breaks a note too often
_NARROW = 24  # characters of a note, for which the other columns stay on one line


def laid_out(
    title: str, header: Sequence[str], rows: Sequence[Sequence[str]], width: int | None
) -> tuple[Console, Table, list[tuple[str, str]]]:
    """Return a table, its console, and the notes to print below it with their subjects.

    Parameters
    ----------
    title, header, rows
        Texts; columns are aligned right, except the first and a last one called note.
    width
        Width of the console in characters; None: width of the terminal.
    """
    console = Console() if width is None else Console(width=width)
    title, header = plain(title), [plain(cell) for cell in header]
    rows = [[plain(cell) for cell in row] for row in rows]
    notes: list[tuple[str, str]] = []
    if header[-1] == "note" and not _fits(header, rows, console.width):
        subject_cells = 2 if len(header) > 1 and header[1] == "axis" else 1
        notes = [(" ".join(row[:subject_cells]).strip(), row[-1]) for row in rows if row[-1]]
        header, rows = header[:-1], [row[:-1] for row in rows]
    widths: Sequence[int | None] | None = _widths(header, rows, console.width)
    if widths is None:
        turned_table = [list(column) for column in zip(header, *rows, strict=True)]
        widths = _widths(turned_table[0], turned_table[1:], console.width)
        if widths is not None:
            header, *rows = turned_table
    # Text, not str: rich would read "[/b]" as markup, and ":x:" as an emoji.
    table = Table(title=Text(title), title_justify="left", title_style="bold", box=SIMPLE_HEAD)
    # Text that does not fit is cut unless it wraps, and 0.5 mm would be read as 0.5 m.
    first_width = max(len(line[0]) for line in [header, *rows]) + _BETWEEN
    for index, name in enumerate(header):
        text = index == 0 or name == "note"
        table.add_column(
            Text(name),
            justify="left" if text else "right",
            no_wrap=widths is None and index == 0 and 2 * first_width <= console.width,
            width=None if widths is None else widths[index],
            overflow="fold",
        )
    for row in rows:
        table.add_row(*map(Text, row))
    return console, table, notes


def _widths(
    header: Sequence[str], rows: Sequence[Sequence[str]], width: int
) -> list[int | None] | None:
    """Return widths at which cells wrap between words alone; None if there are no such widths.

    The other columns stay on one line as long as a column called note has room for a few words.
    """
    columns = list(zip(header, *rows, strict=True))
    longest = [max(map(len, column)) for column in columns]
    widths = [max(len(word) for cell in column for word in cell.split(" ")) for column in columns]
    note = len(header) - 1 if header[-1] == "note" else None
    if note is not None:
        widths[note] = max(widths[note], min(longest[note], _NARROW))
    spare = width - 1 - sum(widths) - _BETWEEN * len(header)
    if spare < 0:
        return None
    for k in sorted(range(len(header)), key=lambda k: (k == note, longest[k] - widths[k])):
        added = min(longest[k] - widths[k], spare)
        widths[k] += added
        spare -= added
    return list(widths)


def _fits(header: Sequence[str], rows: Sequence[Sequence[str]], width: int) -> bool:
    """Return whether the last column has room for its longest text, or for ``_WRAPPED``."""
    lines = [header, *rows]
    other_widths = sum(max(len(line[k]) for line in lines) + 2 for k in range(len(header) - 1))
    return width - other_widths - 2 >= min(max(len(line[-1]) for line in lines), _WRAPPED)


class _WhileItStands(io.TextIOBase):
    """A stream to a terminal; output is lost without an error once the terminal has hung up."""

    def __init__(self, stream: IO[str]) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        """Write text."""
        with suppress(OSError):
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        """Flush the stream."""
        with suppress(OSError):
            self._stream.flush()

    def isatty(self) -> bool:
        """Return whether the stream is a terminal."""
        return self._stream.isatty()

    def fileno(self) -> int:
        """Return the file descriptor."""
        return self._stream.fileno()


class _Stage(ProgressColumn):
    """Column with the stage; its text is read at each drawing, so that it shows the progress."""

    def render(self, task: Task) -> Text:
        """Return the text of the column, the first; the columns beside it draw the same share.

        While machine code is compiled, the stage stands still, and the text says how far that is.
        """
        if COMPILING.busy():
            return Text(COMPILING.words())
        share = share_of(task.description, task.completed)
        if share > task.completed:
            task.completed, task.total = share, 1.0
        return Text(in_full(task.description))


class _Bar(BarColumn):
    """The bar of the stage; while machine code is compiled, that of the compiled functions.

    A bar of functions is full at ``USUAL_FUNCTIONS``, and only moves if there are more.
    """

    def render(self, task: Task) -> ProgressBar:
        """Return the bar."""
        bar = super().render(task)
        if COMPILING.busy():
            bar.total, bar.completed = float(USUAL_FUNCTIONS), float(COMPILING.functions)
            bar.width = _SHORT_BAR
            bar.pulse = COMPILING.functions > USUAL_FUNCTIONS
        return bar


class _Percent(TextColumn):
    """The share done of the stage, while it is known and no machine code is compiled."""

    def render(self, task: Task) -> Text:
        """Return the text of the column."""
        unknown = task.total is None or COMPILING.busy()
        return Text("") if unknown else super().render(task)


@contextmanager
def bar_on_terminal() -> Iterator[ProgressCall]:
    """Yield a progress call that draws a bar on standard error after one second.

    A stage without a share done has a bar that only moves. While machine code is compiled, the bar
    shows the number of compiled functions.
    """
    bar = Progress(
        _Stage(),
        _Bar(),
        _Percent("{task.percentage:>3.0f}%"),
        TimeElapsedColumn(),
        console=Console(file=cast("TextIO", _WhileItStands(Console(stderr=True).file))),
        transient=True,
    )
    task = bar.add_task("starting", total=None)
    shown, over, lock = threading.Event(), threading.Event(), threading.Lock()

    def show() -> None:
        with lock:
            if not over.is_set():
                STARTING.over()
                bar.start()
                shown.set()

    def update(what: str, fraction: float) -> None:
        at_work(what, fraction, shown=shown.is_set())
        # The library takes a total of None for none given: an unknown total is set by itself.
        bar.update(task, description=what, completed=fraction, total=1.0)
        if not fraction:
            bar.tasks[0].total = None

    # A single step may take minutes: the bar appears without waiting for the next call.
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
