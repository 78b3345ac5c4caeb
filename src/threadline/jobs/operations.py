"""A job: a re-iterable source of operations, each with its place in the job file."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from itertools import repeat
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray, IntArray
from threadline.errors import Place
from threadline.files import CachedStream, Stream

if TYPE_CHECKING:
    from threadline.geometry.contours import DrawnLine
    from threadline.jobs.program_limits import LimitChange

Tags: TypeAlias = Mapping[str, float | str]
Column: TypeAlias = NDArray[np.float64] | NDArray[np.int64] | NDArray[np.str_] | NDArray[np.object_]
"""Values of one tag for a run of moves; NaN, "" or None for a move without the tag."""
NO_TAGS: Tags = {}
NO_COLUMNS: Mapping[str, Column] = {}


class FeedMode(StrEnum):
    """Meaning of the value of a feed, in SI."""

    FASTEST_AXIS = "fastest-axis"  # m/s of the fastest axis, rotary axes at the tool radius
    BASE_AXES = "base-axes"  # m/s of the base axes alone (CADFIL modes 1 and 2)
    PATH = "path"  # m/s along the path of the linear axes
    ALL_AXES = "all-axes"  # m/s along the path of all axes, with a degree as a millimetre
    IN_TURN = "in-turn"  # m/s along X Y Z; if they rest along U V W, else A B C, 1 deg as 1 mm
    COUNT_PER_TICK = "count-per-tick"  # encoder counts per tick of the fastest axis
    INVERSE_TIME = "inverse-time"  # moves per second: the move takes 1 / value
    F_WORD = "f-word"  # m/s; the job's feed rule says which speed F is
    SHAFT = "shaft"  # stitches per second, one per turn of the machine's main shaft
    RAPID = "rapid"  # as fast as the machine's limits allow; value unused
    OVERRIDE = "override"  # factor on the programmed feed of any mode


@dataclass(frozen=True, slots=True)
class Feed:
    """The wanted speed of a move: ``value`` in the SI unit of ``mode``.

    ``base_axes`` names the axes whose displacement counts in mode ``BASE_AXES``. ``most`` replaces
    ``value`` in a timing by the machine's limits; None: ``value`` applies. ``travel`` says that the
    move is a G0 at the feed; some firmwares run such a move with the tool off.
    """

    mode: FeedMode
    value: float
    base_axes: tuple[str, ...] = ()
    most: float | None = None
    travel: bool = False

    @property
    def at_limits(self) -> Feed:
        """The feed for a timing by limits."""
        return self if self.most is None else replace(self, value=self.most, most=None)

    @property
    def travels(self) -> bool:
        """Whether the move is a G0, either rapid or at the feed."""
        return self.travel or self.mode is FeedMode.RAPID


@dataclass(frozen=True, slots=True)
class Source:
    """The place of an operation in its job file.

    Parameters
    ----------
    file, line
        File, and line from 1.
    passes
        Pass number of each open subroutine call, from 1, outermost call first: ``(3,)`` is the
        third pass of a subroutine.
    """

    file: str
    line: int
    passes: tuple[int, ...] = ()

    @property
    def place(self) -> Place:
        """The place for an error message."""
        return Place(self.file, self.line)


@dataclass(frozen=True, slots=True)
class ToolEvent:
    """An action of the tool, ``name``, with its ``value`` (trim, thread, tension, power).

    ``words`` are the words of a part program that request the action, empty for other jobs.
    ``beside`` says that these words stand in the same block as their move. ``limits`` are the
    limits of velocity or acceleration that the words set for all later moves.
    """

    name: str
    value: float
    source: Source
    words: str = ""
    beside: bool = False
    limits: LimitChange | None = None


@dataclass(frozen=True, slots=True)
class Thread:
    """Thread of a design.

    Parameters
    ----------
    rgb
        Colour as ``#rrggbb``.
    name
        Name in the maker's catalogue; empty if the file has none.
    """

    rgb: str
    name: str = ""

    def __str__(self) -> str:
        return f"{self.name} {self.rgb}".strip()


@dataclass(frozen=True, slots=True)
class Move:
    """Travel of all axes together to ``target``, (axes,) positions in m or rad.

    The events ``acts`` happen at the start of the move; the axes do not stop for them.
    """

    target: tuple[float, ...]
    feed: Feed | None
    source: Source
    tags: Tags = field(default_factory=lambda: NO_TAGS)
    acts: tuple[ToolEvent, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class MoveRun:
    """Consecutive moves as arrays, which are faster to process than single ``Move`` objects.

    Parameters
    ----------
    targets
        (n, axes) targets of the moves, m or rad.
    line
        (n,) line of each move in the file.
    feeds
        ``(i, feed)``: the feed from move ``i`` onwards; the first entry has i = 0.
    file, passes
        File and passes as in ``Source``; all moves of a run share them.
    columns
        (n,) values of each tag, by the tag's name: stitch, layer, circuit, tension, thread.
    acts
        ``(i, events)``: the events at the start of move ``i`` (``Move.acts``), in order.
    """

    targets: FloatArray
    line: IntArray
    feeds: tuple[tuple[int, Feed | None], ...]
    file: str
    passes: tuple[int, ...]
    columns: Mapping[str, Column] = field(default_factory=lambda: NO_COLUMNS)
    acts: tuple[tuple[int, tuple[ToolEvent, ...]], ...] = ()

    def __len__(self) -> int:
        return len(self.targets)

    def __iter__(self) -> Iterator[Move]:
        ends = [*[begin for begin, _ in self.feeds[1:]], len(self.targets)]
        for (begin, feed), end in zip(self.feeds, ends, strict=True):
            lines = self.line[begin:end].tolist()
            sources = map(Source, repeat(self.file), lines, repeat(self.passes))
            targets = map(tuple, self.targets[begin:end].tolist())
            tags = tagged(self.columns, begin, end) if self.columns else repeat(NO_TAGS)
            acts: Iterable[tuple[ToolEvent, ...]] = repeat(())
            if self.acts:
                acts_at = dict(self.acts)
                acts = (acts_at.get(index, ()) for index in range(begin, end))
            yield from map(Move, targets, repeat(feed), sources, tags, acts)


def tagged(columns: Mapping[str, Column], begin: int, end: int) -> Iterator[Tags]:
    """Yield the tags of each move from ``begin`` up to ``end``, without ``end``."""
    names = tuple(columns)
    parts = [column[begin:end] for column in columns.values()]
    rows = zip(*(part.tolist() for part in parts), strict=True)
    if not any(lacking(part).any() for part in parts):
        yield from (dict(zip(names, row, strict=True)) for row in rows)
        return
    for row in rows:
        present_tags = {
            name: value
            for name, value in zip(names, row, strict=True)
            if value is not None and value == value and value != ""  # noqa: PLR0124 - NaN
        }
        yield present_tags or NO_TAGS


def columns_of(tags: Sequence[Tags]) -> Mapping[str, Column]:
    """Return the columns of the tags of consecutive moves; empty if no move has tags."""
    if not any(tags):
        return NO_COLUMNS
    names = dict.fromkeys(name for move_tags in tags for name in move_tags)
    return {name: _column([move_tags.get(name) for move_tags in tags]) for name in names}


def _column(values: list[float | str | None]) -> Column:
    kinds = {type(value) for value in values}
    if kinds == {int}:
        return np.array(values, dtype=np.int64)
    if kinds <= {int, float, type(None)}:
        return np.array(values, dtype=np.float64)  # None becomes NaN
    if kinds == {str}:
        return np.array(values, dtype=np.str_)
    column = np.empty(len(values), dtype=np.object_)
    column[:] = values
    return column


def lacking(column: Column) -> NDArray[np.bool_]:
    """Return (n,) whether each move lacks the tag of a column."""
    if column.dtype.kind == "f":
        return np.isnan(column)
    if column.dtype.kind == "U":
        return np.asarray(column == "")
    if column.dtype.kind == "O":
        return np.array([value is None for value in column], dtype=np.bool_)
    return np.zeros(len(column), dtype=np.bool_)


@dataclass(frozen=True, slots=True)
class Dwell:
    """A rest of ``duration_s``."""

    duration_s: float
    source: Source


@dataclass(frozen=True, slots=True)
class SetOutput:
    """A switch of the output ``name`` to ``value`` once the preceding motion has ended."""

    name: str
    value: float
    source: Source


@dataclass(frozen=True, slots=True)
class WaitInput:
    """A wait until the input ``name`` is ``value``; after ``timeout_s`` the wait is a fault.

    With ``creep``, a cylinder that stopped short of its end switch creeps to it during the wait.
    """

    name: str
    value: float
    timeout_s: float
    source: Source
    creep: bool = True


@dataclass(frozen=True, slots=True)
class Home:
    """Homing of the cylinders ``axes`` to their starts, one by one, with their contacts."""

    axes: tuple[str, ...]
    source: Source


@dataclass(frozen=True, slots=True)
class Stop:
    """A stop until the operator resumes; with ``final`` it ends the job.

    ``words`` has the meaning of ``ToolEvent.words``: a tool change is a stop, too.
    """

    final: bool
    source: Source
    words: str = ""


Pace: TypeAlias = Literal["feed", "needle", "switchings", "shaft"]
"""The quantity that sets the speed of a job; see ``Job.paced_by``."""
Operation: TypeAlias = Move | Dwell | SetOutput | WaitInput | Home | Stop | ToolEvent


class CachedOperations(CachedStream[Any]):
    """Operations and runs of moves that can be read many times; a short job is kept in memory."""

    MOST_CACHED = 1 << 15

    __slots__ = ()

    @staticmethod
    def _rows_of(item: Any) -> int:
        if not isinstance(item, MoveRun):
            return 1
        for column in (item.targets, item.line, *item.columns.values()):
            column.setflags(write=False)  # all readers share it
        return len(item)


class OperationStream(Stream[Operation]):
    """A stream of operations that can also be read as runs of moves.

    Parameters
    ----------
    runs
        Operations and runs of moves.
    folded
        ``(item, times, line)``, in which a repeated pass appears once: how often the item is
        executed, and the line of the call that repeats it (0: no call). None: nothing repeats.
    """

    __slots__ = ("_folded", "_runs")

    def __init__(
        self,
        runs: Stream[Operation | MoveRun],
        folded: Stream[tuple[Operation | MoveRun, int, int]] | None = None,
    ) -> None:
        super().__init__(_one_by_one, runs)
        self._runs = runs
        self._folded = folded

    def folded(self) -> Iterator[tuple[Operation | MoveRun, int, int]]:
        """Return a new iterator in which each repeated pass appears once."""
        if self._folded is not None:
            return iter(self._folded)
        return ((item, 1, 0) for item in self._runs)

    def runs(self) -> Iterator[Operation | MoveRun]:
        """Return a new iterator that yields moves in runs."""
        return iter(self._runs)


def _one_by_one(runs: Iterable[Operation | MoveRun]) -> Iterator[Operation]:
    for item in runs:
        if isinstance(item, MoveRun):
            yield from item
        else:
            yield item


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Job:
    """A job of any length.

    Parameters
    ----------
    name
        Name to show to the user, usually the name of the file.
    file
        Path of the job file.
    sha256
        Hash of the file's bytes.
    axes
        Names of the axes of every ``Move.target``, in order.
    start
        (axes,) position before the first operation, m or rad.
    operations
        Re-iterable operations; later stages refer to an operation by its index here.
    warnings
        Warnings of the reader, each with its place.
    capped
        Warnings about programmed feeds that the machine's normal feed caps, each with its place;
        they apply only if no other feed is given.
    feed_rule
        Name of the rule for the meaning of F; empty for a job without F.
    dialect
        Name of the dialect of a part program; empty for other jobs.
    drawn
        Drawn lines of a seam. The tag ``contour`` of a stitch is the index of its line; the tags
        ``from_m`` and ``to_m`` give the stretch of the line that the stitch covers.
    paced_by
        The quantity that sets the speed of the job: ``feed``, ``needle`` (stitches per second),
        ``switchings``, or ``shaft`` (one stitch per turn of the machine's main shaft).
    needle_follows
        Whether the needle is geared to the path length of the head, in the head's final motion
        after smoothing.
    along_m_s2
        Largest acceleration along the path, m/s^2, that a geared needle allows.
    home
        Homing order of the cylinders; empty if the moves of the list decide the order.
    once
        Number of operations at the beginning that only the first cycle has.
    threads
        Thread of each block of a design, block 1 first; None where the file does not say its
        colour.
    sets_limits
        Whether the program sets limits of velocity or acceleration (``ToolEvent.limits``).
    """

    name: str
    file: str
    sha256: str
    axes: tuple[str, ...]
    start: tuple[float, ...]
    operations: Stream[Operation]
    warnings: tuple[str, ...] = ()
    capped: tuple[str, ...] = ()
    paced_by: Pace = "feed"
    feed_rule: str = ""
    dialect: str = ""
    drawn: tuple[DrawnLine, ...] = ()
    home: tuple[str, ...] = ()
    needle_follows: bool = False
    along_m_s2: float = math.inf
    once: int = 0
    threads: tuple[Thread | None, ...] = ()
    sets_limits: bool = False

    def __iter__(self) -> Iterator[Operation]:
        return iter(self.operations)

    def suspicions(self, *, own_feed: bool) -> tuple[str, ...]:
        """Return the warnings; ``own_feed`` (no other feed is given) adds ``capped``."""
        return (*self.capped, *self.warnings) if own_feed else self.warnings

    def runs(self) -> Iterator[Operation | MoveRun]:
        """Return the operations, with moves in runs if the reader makes runs."""
        if isinstance(self.operations, OperationStream):
            return self.operations.runs()
        return iter(self.operations)

    def folded(self) -> Iterator[tuple[Operation | MoveRun, int, int]]:
        """Return the operations with each repeated pass once; see ``OperationStream``."""
        if isinstance(self.operations, OperationStream):
            return self.operations.folded()
        return ((item, 1, 0) for item in move_runs(self))


def move_runs(job: Job, longest: int = 4096) -> Iterator[Operation | MoveRun]:
    """Return the operations of ``job`` with every move in a run.

    Single moves of a reader are gathered into runs of at most ``longest`` moves; runs of a reader
    stay unchanged.
    """
    moves: list[Move] = []
    for item in job.runs():
        if isinstance(item, Move):
            if moves and (len(moves) >= longest or not _in_one_run(item.source, moves[0].source)):
                yield gathered(moves)
                moves = []
            moves.append(item)
            continue
        if moves:
            yield gathered(moves)
            moves = []
        yield item
    if moves:
        yield gathered(moves)


def _in_one_run(one: Source, other: Source) -> bool:
    return one.passes == other.passes and one.file == other.file


def gathered(moves: list[Move]) -> MoveRun:
    """Return ``moves`` (at least one) as a run."""
    feeds = [(0, moves[0].feed)]
    for index, move in enumerate(moves):
        if move.feed is not feeds[-1][1]:
            feeds.append((index, move.feed))
    return MoveRun(
        targets=np.array([move.target for move in moves], dtype=np.float64),
        line=np.array([move.source.line for move in moves], dtype=np.int64),
        feeds=tuple(feeds),
        file=moves[0].source.file,
        passes=moves[0].source.passes,
        columns=columns_of([move.tags for move in moves]),
        acts=tuple((index, move.acts) for index, move in enumerate(moves) if move.acts),
    )


def begins_circuit(before: Source | None, now: Source) -> bool:
    """Say whether a circuit begins between two consecutive operations.

    Parameters
    ----------
    before
        Source of the earlier operation; None at the start of the job.
    now
        Source of the later operation.
    """
    if not now.passes:
        return False
    if before is None or not before.passes or before.passes[0] != now.passes[0]:
        return True
    # Between two calls of one pass each, the line number falls back.
    return len(before.passes) == len(now.passes) == 1 and now.line < before.line
