"""Operations as blocks of a part program, in absolute or incremental positions."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from itertools import chain
from typing import NamedTuple

import numpy as np

from threadline.commands import nc_numbers as numbers
from threadline.errors import PlanError
from threadline.jobs.feed_times import feed_time_s
from threadline.jobs.gcode.feeds import F_MODES
from threadline.jobs.gcode.words import ONE
from threadline.jobs.operations import (
    Dwell,
    Feed,
    FeedMode,
    Job,
    Move,
    Operation,
    SetOutput,
    Stop,
    ToolEvent,
    WaitInput,
)
from threadline.machine import Machine
from threadline.motion.path import programmed_path

_DECIMALS = 4
_UNIT = ONE // 10**_DECIMALS


class OutBlock(NamedTuple):
    """A block to write.

    Parameters
    ----------
    motion
        0 for G0, 1 for G1, -1 for a block without motion.
    words
        Axis words and other words that are not modal, ready to write.
    inverse_time
        Whether F of a G1 is in 1/min.
    feed
        Exact F; None for G0.
    comment
        Text after the semicolon.
    passes
        Passes of the operation's source.
    final
        Whether the block ends the program.
    """

    motion: int
    words: str
    inverse_time: bool = False
    feed: int | None = None
    comment: str = ""
    passes: tuple[int, ...] = ()
    final: bool = False


@dataclass(frozen=True, slots=True)
class Wording:
    """Rules for writing operations as words.

    Parameters
    ----------
    incremental
        Whether positions are written as differences.
    blank
        Text between the letter of a word and its number.
    timed
        True: every G1 gets Threadline's time, as G93 F. False: F is the programmed speed wherever
        the dialect has it.
    points
        Whether every length, angle and time has a decimal point, and ``_DECIMALS`` decimals at
        most: Fanuc reads a number without a point by a parameter of the control, and refuses one
        with more digits than it keeps.
    """

    incremental: bool
    blank: str
    timed: bool
    points: bool = False

    def rounded(self, exact: int) -> int:
        """Return an exact number with the decimals that are written."""
        return exact if not self.points else _UNIT * round(Fraction(exact, _UNIT))

    def text(self, exact: int) -> str:
        """Return an exact number as it is written."""
        text = numbers.text(self.rounded(exact))
        return f"{text}." if self.points and "." not in text else text


def blocks_of(
    job: Job, machine: Machine, wording: Wording, feed: Feed | None = None
) -> Iterator[OutBlock]:
    """Return the blocks of ``job``, one per operation.

    Raises
    ------
    PlanError
        If a part program has no word for a part of the job.
    """
    if any(job.start):
        raise PlanError(
            f"job {job.name!r} does not begin at the start position, where part programs begin",
            remedy="Shift the start of the job to 0.",
        )
    return _Words(job, machine, wording).blocks(feed)


class _Words:
    def __init__(self, job: Job, machine: Machine, wording: Wording) -> None:
        self._job = job
        self._machine = machine
        self._wording = wording
        self._linear = [machine.axes[name].kind == "linear" for name in job.axes]
        self._at = [0] * len(job.axes)
        self._passes: tuple[int, ...] = ()
        self._position = list(job.start)

    def blocks(self, feed: Feed | None) -> Iterator[OutBlock]:
        if not self._wording.timed:
            for operation in self._job:
                if isinstance(operation, Move):
                    yield from self._acts(operation)
                    yield self._move(operation)
                else:
                    yield self._other(operation)
            return
        programmed = programmed_path(self._job, self._machine, feed)
        times = chain.from_iterable(block.nominal_s.tolist() for block in programmed)
        next(times)  # the time of the start position
        for operation in self._job:
            if isinstance(operation, Move):
                yield from self._acts(operation)
                yield self._move(operation, next(times))
            else:
                yield self._other(operation)

    def _acts(self, move: Move) -> Iterator[OutBlock]:
        for act in move.acts:
            yield OutBlock(-1, act.words, passes=move.source.passes)

    def _move(self, move: Move, planned_s: float | None = None) -> OutBlock:
        before = list(self._position)
        words = self._axis_words(move)
        comment = " ".join(self._tag(name, value, move) for name, value in move.tags.items())
        passes = move.source.passes
        feed = move.feed
        rapid = feed is not None and feed.mode is FeedMode.RAPID
        if rapid:
            return OutBlock(0, words, comment=comment, passes=passes)
        if planned_s is None and feed is not None and feed.mode in F_MODES:
            return OutBlock(1, words, False, numbers.per_minute(feed.value), comment, passes)
        if planned_s is None and feed is not None and feed.mode is FeedMode.INVERSE_TIME:
            return OutBlock(1, words, True, numbers.inverse_minutes(feed.value), comment, passes)
        duration_s = self._time_s(move, before) if planned_s is None else planned_s
        if duration_s == 0.0:
            # A move without travel has no time and no motion.
            return OutBlock(0, words, comment=comment, passes=passes)
        if planned_s is None:
            value = numbers.inverse_minutes(1.0 / duration_s)
        else:
            value = numbers.inverse_minutes_of(duration_s)
        return OutBlock(1, words, True, value, comment, passes)

    def _time_s(self, move: Move, before: list[float]) -> float:
        """Return the time of a move whose feed has no word (counts per tick) or is missing, s."""
        feed = move.feed
        if feed is None:
            if self._machine.operator is None:
                raise PlanError(
                    "a move has no feed", place=move.source.place, remedy="Give the job a feed."
                )
            feed = Feed(FeedMode.COUNT_PER_TICK, self._machine.operator.normal_feed.si)
        displacement = np.array([move.target]) - np.array([before])
        return float(feed_time_s(displacement, feed, self._job.axes, self._machine)[0])

    def _axis_words(self, move: Move) -> str:
        words = []
        blank, incremental = self._wording.blank, self._wording.incremental
        if move.source.passes != self._passes:
            # Each pass begins without the rounding error of the last one, so passes are equal.
            self._passes = move.source.passes
            self._at = [self._exact(k, at) for k, at in enumerate(self._position)]
        for index, target in enumerate(move.target):
            if target == self._position[index]:
                continue
            exact = self._exact(index, target)
            written = self._wording.rounded(exact - self._at[index] if incremental else exact)
            words.append(f"{self._job.axes[index]}{blank}{self._wording.text(written)}")
            self._at[index] = self._at[index] + written if incremental else exact
            self._position[index] = target
        if not words:
            nothing = 0 if incremental else self._at[0]
            words.append(f"{self._job.axes[0]}{blank}{self._wording.text(nothing)}")
        return " ".join(words)

    def _exact(self, index: int, position: float) -> int:
        """Return the position of an axis as an exact number of mm or degrees."""
        linear = self._linear[index]
        return numbers.millimetres(position) if linear else numbers.degrees(position)

    def _tag(self, name: str, value: float | str, move: Move) -> str:
        if isinstance(value, str):
            raise PlanError(
                f"the tag {name} = {value!r} is text, for which part programs have no word",
                place=move.source.place,
                remedy="Write another format.",
            )
        return f"{name}={numbers.text(numbers.seconds(value))}"

    def _other(self, operation: Operation) -> OutBlock:
        passes = operation.source.passes
        blank = self._wording.blank
        if isinstance(operation, Dwell):
            duration = self._wording.text(numbers.seconds(operation.duration_s))
            letter = "X" if self._wording.points else "P"
            return OutBlock(-1, f"G{blank}4 {letter}{blank}{duration}", passes=passes)
        if isinstance(operation, Stop):
            code = f"M{blank}{30 if operation.final else 0}"
            return OutBlock(-1, operation.words or code, passes=passes, final=operation.final)
        if isinstance(operation, ToolEvent) and operation.words:
            return OutBlock(-1, operation.words, passes=passes)
        raise PlanError(
            f"a part program has no word for {operation_words(operation)}",
            place=operation.source.place,
            remedy="Take it out of the job, or write csv or npz.",
        )


def operation_words(operation: Operation) -> str:
    """Return the name of an operation other than a move, for messages.

    >>> from threadline.jobs.operations import Source
    >>> operation_words(SetOutput("valve", 1.0, Source("winding.prg", 4)))
    "the output 'valve'"
    """
    match operation:
        case SetOutput(name=name):
            return f"the output {name!r}"
        case WaitInput(name=name):
            return f"the wait for the input {name!r}"
        case ToolEvent(name=name):
            return f"the tool event {name!r}"
        case _:
            return f"a {type(operation).__name__.lower()}"
