"""The modes and the exact position of a part program, and the effect of each block on them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from threadline.errors import JobError
from threadline.jobs.gcode.block import (
    DRILLING,
    DWELL,
    RESET,
    SET_NATIVE,
    SHIFT,
    TAKES_AXES,
    Block,
)
from threadline.jobs.gcode.curves import CURVED, Curves
from threadline.jobs.gcode.cycles import Cycles, Frame
from threadline.jobs.gcode.dialects import CANCEL, Reading
from threadline.jobs.gcode.feeds import FeedCache, FRule, travelling, value_of
from threadline.jobs.gcode.textfile import SourceFile
from threadline.jobs.gcode.words import ONE
from threadline.jobs.gcode.zeros import FIRST, MACHINE, NO_LENGTH, SYSTEMS, TURN, Zeros
from threadline.jobs.operations import (
    NO_TAGS,
    Dwell,
    Feed,
    FeedMode,
    Move,
    Operation,
    Source,
    Stop,
    Tags,
    ToolEvent,
)

RAPID = Feed(FeedMode.RAPID, 0.0)
MILLIMETRE = 10  # tenths of a millimetre
_MM_PER_M = 1000 * ONE
_CHANGE = 6  # M6
_SPINDLE = frozenset({"M3", "M4", "M5"})
_OFF = ("M5", "M9")
_ALL_OFF = "M5 M9"
_LENGTHS = "XYZUVW"


@dataclass(frozen=True, slots=True)
class ProgramText:
    """A checked part program and the settings for reading its blocks.

    Parameters
    ----------
    linear
        (axes,) whether each axis is linear.
    rule
        Meaning of F in G94.
    systems
        Zeros of work coordinate systems (``work_offsets``).
    """

    file: SourceFile
    reading: Reading
    linear: tuple[bool, ...]
    rule: FRule
    systems: Mapping[int, tuple[int, ...]]


class Modal:
    """The state of one reading; positions are exact, in units of 10**-18 mm or degrees.

    Parameters
    ----------
    program
        Program to read.
    """

    def __init__(self, program: ProgramText) -> None:
        self._file = program.file
        self._rule = program.rule
        self._path = program.file.path
        self._linear = program.linear
        self._dialect = program.reading.dialect
        self._exact = [0] * len(program.linear)
        self._zeros = Zeros(len(program.linear), program.systems)
        self._curves = Curves(program.reading, program.linear)
        self._cycles = Cycles()
        self._axes = program.reading.axes
        self._position = [0.0] * len(program.linear)
        self._motion = -1
        self._cancelled = False  # by G80
        self._relative = False
        self._tenth_mm = MILLIMETRE  # the unit of length in force
        self._feed_tenth_mm = MILLIMETRE  # the unit of length in which F was given
        axes = enumerate(program.reading.names)
        self._lengths = [index for index, name in axes if name in _LENGTHS]
        self._inverse_time = False
        self._passes: tuple[int, ...] = ()
        self._feeds = FeedCache(program.rule)
        first_feed_m_s = self._dialect.first_feed_m_s
        self._feed: Feed | None = None if first_feed_m_s is None else self._feed_of(first_feed_m_s)
        self._letters = program.reading.names
        self._waiting: list[ToolEvent] = []  # for the next move
        self._length = ""  # G43 in force
        self._known = program.reading.lengths
        self._wrapped = program.reading.wrapped
        self._moved = self._acted = self._repeats = False
        self._one_system = not program.systems
        systems_at_zero = (
            code for code, zero in program.systems.items() if code != MACHINE and not any(zero)
        )
        self._first_system = next(systems_at_zero, FIRST)

    def _ends(self, block: Block) -> bool:
        """Say whether the reading ends at a block, because its M word ends the program."""
        return block.ends == "end"

    def _put(self, index: int, exact: int) -> None:
        """Set the position of an axis, exactly and in SI."""
        self._exact[index] = exact
        linear = self._linear[index]
        self._position[index] = exact / _MM_PER_M if linear else math.radians(exact / ONE)

    def _step(self, block: Block) -> Iterator[Operation]:
        """Return the operations of one block, in the order of RS274/NGC."""
        if self._dialect.grammar.repeats:
            repeated = self._repeats and block.motion == block.action == -1 and block.goes
            self._repeats = block.motion in (0, 1, 2, 3) or repeated
        if block.settings:
            self._set(block.settings)
        self._cycles.take(block.settings, block.motion)
        if block.feed is not None:
            feed = value_of(block.feed, self._tenth_mm, inverse_time=self._inverse_time)
            self._feed = self._feed_of(feed)
            self._feed_tenth_mm = self._tenth_mm
        if block.motion >= 0:
            self._motion = -1 if block.motion == CANCEL else block.motion
            self._cancelled = block.motion == CANCEL
        self._check_modes(block)
        if block.length or NO_LENGTH in block.settings:
            yield from self._take_length(block)
        words_before, words_after = self._split(block) if block.acts else ((), ())
        yield from self._worked(block, words_before)
        if block.action == DWELL:
            yield from self._rest(Dwell(block.dwell_s, self._source(block)))
        elif block.action == 280:
            yield from self._return_to_start(block)
        else:
            resets_after_move = block.action == RESET and self._dialect.grammar.reset_last
            if block.action != -1 and not resets_after_move:
                axis_words = {index: self._scaled(index, value) for index, value in block.axes}
                if block.action == SHIFT and not self._moved:
                    # The plan begins at 0, whatever position the control shows.
                    zero_words = " ".join(f"{self._letters[index]}0" for index in axis_words)
                    shift = ToolEvent("G92", 0.0, self._source(block), f"G92 {zero_words}")
                    self._waiting.append(shift)
                self._zeros.take(block.action, self._exact, axis_words)
            if block.action not in TAKES_AXES and (
                block.axes or (block.curve and self._motion in CURVED)
            ):
                yield from self._move(block)
            if resets_after_move:
                self._zeros.take(block.action, self._exact, {})
        yield from self._worked(block, words_after)
        if block.waits and not block.acts:
            yield from self._rest(Dwell(0.0, self._source(block)))
        if self._ends(block):
            yield from self._rest(Stop(True, self._source(block)))
        elif block.ends == "end" and self._acted:
            # A program that goes on after an end starts with spindle and coolant off.
            yield from self._rest(ToolEvent(_ALL_OFF, 0.0, self._source(block), _ALL_OFF))
        elif block.ends == "end":
            yield from self._rest(Dwell(0.0, self._source(block)))

    def _take_length(self, block: Block) -> Iterator[Operation]:
        """Take or leave a tool length; one that the machine file gives moves the zero."""
        source, length_before, self._length = self._source(block), self._length, block.length
        if length_before in self._known or block.length in self._known:
            yield from self._rest(Dwell(0.0, source))
            self._zeros.lengthen(self._axes["Z"], self._known.get(block.length, 0))
        elif length_before and not block.length:
            yield from self._rest(ToolEvent("G49", 0.0, source, "G49"))

    def _split(self, block: Block) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Return the acting words before the motion of a block, and the words after the motion."""
        words_after: tuple[str, ...] = ()
        if block.ends == "stop" and block.program != _CHANGE:
            words_after = block.acts if self._dialect.one_command else (f"M{block.program}",)
        elif self._dialect.off_behind and block.axes:
            words_after = _OFF
        words_before = tuple(word for word in block.acts if word not in words_after)
        return words_before, tuple(word for word in block.acts if word in words_after)

    def _worked(self, block: Block, words: tuple[str, ...]) -> Iterator[Operation]:
        """Return the operations of acting words; words that need no rest go with the next move."""
        if not words:
            return
        self._acted = True
        text, source = " ".join(words), self._source(block)
        if block.ends == "stop" and f"M{block.program}" in words:
            yield from self._rest(Stop(False, source, text))
        elif block.waits or block.length or not _SPINDLE.isdisjoint(words):
            # LinuxCNC ends the motion before it takes or leaves a tool length. Without the rest a
            # rounded corner would move Z before G43.
            yield from self._rest(ToolEvent(text, block.power, source, text))
        else:
            with_move = bool(block.axes) and block.action not in (*TAKES_AXES, DWELL)
            event = ToolEvent(text, block.power, source, text, with_move, block.limits)
            self._waiting.append(event)

    def _rest(self, item: Operation) -> Iterator[Operation]:
        """Yield the waiting tool events, then an operation for which the motion rests."""
        yield from self._waiting
        self._waiting = []
        yield item

    def _acting(self, source: Source) -> tuple[ToolEvent, ...]:
        """Return the tool events at the start of the next move, which comes from ``source``."""
        if not self._moved and self._first_system != FIRST:
            word = f"G{self._first_system // 10}"
            self._waiting.append(ToolEvent(word, 0.0, source, word))
        self._moved = True
        acts, self._waiting = tuple(self._waiting), []
        return acts

    def _to(self, feed: Feed, source: Source, tags: Tags = NO_TAGS) -> Move:
        """Return the move to the present position."""
        acts = self._acting(source) if self._waiting or not self._moved else ()
        return Move(tuple(self._position), feed, source, tags, acts)

    def _check_modes(self, block: Block) -> None:
        """Refuse words that the modes in force forbid or leave without use."""
        grammar = self._dialect.grammar
        drills = self._motion in DRILLING and block.action not in (*TAKES_AXES, DWELL)
        if block.passes and block.program != 98 and not drills:
            raise self._error(
                block.line, "L has no use in this block", "L belongs to M98 and to drilling cycles."
            )
        if drills:
            self._check_drilling(block)
        elif block.curve and not (
            self._motion in CURVED and block.action not in (*TAKES_AXES, DWELL)
        ):
            raise self._error(
                block.line,
                f"{block.curve[0][0]} has no use in this block",
                "I J K R Q belong to G2, G3 and G5.",
            )
        if block.axes and self._cancelled and grammar.cancelled:
            raise self._error(
                block.line,
                f"axis words while G80 is in force, which {self._dialect.name} refuses",
                "Write G0 or G1 before them.",
            )
        if block.action == SET_NATIVE and self._zeros.shifted.intersection(
            index for index, _ in block.axes
        ):
            raise self._error(
                block.line,
                "G92.9 behind a G92 of the same axis, whose shift then counts twice",
                "Use one of the two words for an axis.",
            )
        if MACHINE in block.settings and not (block.axes and self._motion in (0, 1)):
            raise self._error(
                block.line,
                "G53 needs axis words, and G0 or G1",
                "Write them in its block.",
            )
        if grammar.feed_first and block.motion in (1, 2, 3):
            self._check_feed(block)
        if grammar.plain_arcs and block.motion in (2, 3):
            has_radius = any(letter == "R" for letter, _ in block.curve)
            if self._relative or has_radius or not any(value for _, value in block.curve):
                fault = "with R" if has_radius else "without a centre"
                raise self._error(
                    block.line,
                    f"{self._dialect.name} takes no arc "
                    + ("while G91 is in force" if self._relative else fault),
                    "Write G90 before it." if self._relative else "Give its centre by I and J.",
                )
        if block.motion in (2, 3) and not (
            block.axes or (block.curve and not grammar.arc_ends) or self._dialect.one_command
        ):
            raise self._error(
                block.line,
                f"{self._dialect.name} takes no G{block.motion} without axis words",
                "Write the end of the arc, also of a full circle.",
            )

    def _check_drilling(self, block: Block) -> None:
        """Refuse a block of a drilling cycle that the control would refuse."""
        name = f"G{self._motion}"
        if self._inverse_time:
            raise self._error(
                block.line,
                f"{name} in G93, which {self._dialect.name} refuses",
                "Write G94 and a feed in mm/min before it.",
            )
        if not block.axes and (block.motion != -1 or block.curve or block.p is not None):
            raise self._error(
                block.line,
                f"{name} without the place of a hole",
                "Write X or Y into its block.",
            )

    def _check_feed(self, block: Block) -> None:
        """Refuse G1, G2 or G3 without a feed, even in a block without axis words."""
        if self._inverse_time and block.feed is None:
            raise self._error(
                block.line,
                f"in G93 every G{block.motion} block needs its own F",
                "Give F as 1 / minutes of the move.",
            )
        if self._feed is None:
            raise self._error(
                block.line,
                f"G{block.motion} moves before any feed F"
                if block.axes
                else f"G{block.motion} before any feed F, which {self._dialect.name} refuses in a "
                "block without axis words, too",
                self._dialect.asks_feed,
            )

    def _source(self, block: Block) -> Source:
        return Source(self._path, block.line, self._passes)

    def _set(self, settings: tuple[int, ...]) -> None:
        for code in settings:
            if code in (900, 910):
                self._relative = code == 910
            elif code in (200, 210):
                self._tenth_mm = 254 if code == 200 else 10
            elif code in (930, 940) and (
                self._inverse_time != (code == 930) or self._dialect.grammar.forgets_feed
            ):
                # A speed must not become an inverse time, or the reverse.
                self._inverse_time = code == 930
                self._feed = None
            elif code in (170, 180, 190):
                self._curves.plane = code
            elif code in SYSTEMS:
                self._zeros.choose(code)
                if self._one_system:
                    self._first_system = code if not self._moved else self._first_system

    def _feed_of(self, value: float) -> Feed:
        """Return the feed with ``value`` in the present mode."""
        return self._feeds.feed(value, inverse_time=self._inverse_time)

    def _scaled(self, index: int, value: int) -> int:
        """Return the word of an axis in mm or degrees."""
        return value * self._tenth_mm // 10 if self._linear[index] else value

    def _go(self, block: Block) -> None:
        """Set the position to the axis words of ``block``."""
        origin: Sequence[int] = self._exact if self._relative else self._zeros.offset
        if MACHINE in block.settings:
            origin = self._zeros.machine
        for index, value in block.axes:
            if index in self._wrapped and not self._relative:
                self._put(index, self._within_turn(block, index, value))
            else:
                self._put(index, origin[index] + self._scaled(index, value))

    def _within_turn(self, block: Block, index: int, value: int) -> int:
        """Return the position to which a wrapped axis turns for an absolute angle."""
        letter = self._letters[index]
        if MACHINE in block.settings:
            raise self._error(
                block.line,
                f"G53 with the wrapped axis {letter}: its machine coordinates are not read",
                f"Leave out {letter}, or give its angle in another block.",
            )
        if not abs(value) < TURN:
            raise self._error(
                block.line,
                f"{letter}{value / ONE:g}: LinuxCNC takes angles of a wrapped axis between -360 "
                "and 360",
                "Write the angle within one turn; its sign says which way the axis turns.",
            )
        back = index in block.back
        return self._zeros.within_turn(index, abs(value), self._exact[index], back=back)

    def _move(self, block: Block) -> Iterator[Operation]:
        rapid = self._motion == 0 and not self._dialect.rapid_is_feed
        feed = RAPID if rapid else self._feed
        if feed is None and self._motion == 0 and self._stays(block):
            feed = RAPID  # no feed matters for no motion; CAM programs begin like this
        if self._motion == -1 and self._cancelled:
            raise self._error(
                block.line,
                "axis words without G0 or G1 behind G80, which ends the cycle and every motion",
                "Write G0 (or G1 and a feed) in this block.",
            )
        lacks_g_word = self._dialect.each_g and block.motion == -1 and not self._repeats
        if self._motion == -1 or lacks_g_word:
            raise self._error(
                block.line,
                "axis words before any G0 or G1"
                if self._motion == -1
                else f"axis words without a G word, which {self._dialect.name} does not take",
                "Write G1 and a feed first.",
            )
        if self._motion == 0 and not rapid and feed is not None:
            feed = travelling(feed)
        if feed is None:
            raise self._error(
                block.line, f"G{self._motion} moves before any feed F", self._dialect.asks_feed
            )
        if feed.mode is FeedMode.INVERSE_TIME and block.feed is None:
            raise self._error(
                block.line,
                f"in G93 every G{self._motion} block needs its own F",
                "Give F as 1 / minutes of the move.",
            )
        source = self._source(block)
        tags = dict(block.tags) if block.tags else NO_TAGS
        if self._motion in DRILLING:
            yield from self._drill(block, feed, source, tags)
            return
        before = tuple(self._exact)
        self._go(block)
        if self._motion in CURVED:
            yield from self._along(block, before, feed, source, tags)
            return
        if (
            self._feed_tenth_mm != MILLIMETRE
            and feed.mode is FeedMode.IN_TURN
            and all(self._exact[index] == before[index] for index in self._lengths)
        ):
            feed = self._feed_of(feed.value * MILLIMETRE / self._feed_tenth_mm)
        yield self._to(feed, source, tags)

    def _stays(self, block: Block) -> bool:
        """Return whether the axis words of a block name the present position."""
        origin = self._exact if self._relative else self._zeros.offset
        return all(
            self._within_turn(block, i, v) == self._exact[i]
            if i in self._wrapped and not self._relative
            else origin[i] + self._scaled(i, v) == self._exact[i]
            for i, v in block.axes
        )

    def _along(
        self, block: Block, before: tuple[int, ...], feed: Feed, source: Source, tags: Tags
    ) -> Iterator[Operation]:
        """Return the chords of an arc or spline; the last chord ends at the end of the block."""
        after = tuple(self._exact)
        points = list(self._curves.points(self._motion, block, before, after, self._tenth_mm))
        chords = len(points) + 1
        if feed.mode is FeedMode.INVERSE_TIME:
            feed = self._feed_of(feed.value * chords)
        for point in points:
            for index, exact in enumerate(point):
                self._put(index, exact)
            yield self._to(feed, source, tags)
        for index, exact in enumerate(after):
            self._put(index, exact)
        yield self._to(feed, source, tags)

    def _drill(self, block: Block, feed: Feed, source: Source, tags: Tags) -> Iterator[Operation]:
        """Return the moves and dwells of a drilling cycle."""
        frame = Frame(
            tuple(self._exact), tuple(self._zeros.offset), self._axes, self._curves.plane,
            self._relative, self._tenth_mm, self._file.place(block.line),
        )  # fmt: skip
        for step in self._cycles.steps(self._motion, block, frame):
            if step.kind == "dwell":
                yield from self._rest(Dwell(step.dwell_s, source))
                continue
            for index, exact in step.to:
                self._put(index, exact)
            yield self._to(RAPID if step.kind == "rapid" else feed, source, tags)

    def _return_to_start(self, block: Block) -> Iterator[Operation]:
        """Return the moves of G28: to the axis words of the block, then to the home position.

        A control that homes moves to the home position directly, and has its zero there afterwards.
        """
        source = self._source(block)
        named_axes = [i for i, _ in block.axes] or range(len(self._exact))
        if not self._wrapped.isdisjoint(named_axes):
            letter = self._letters[min(self._wrapped.intersection(named_axes))]
            raise self._error(
                block.line,
                f"G28 moves the wrapped axis {letter}, and which way it turns home is not read",
                f"Name the axes of G28 without {letter}, and turn {letter} in another block.",
            )
        if block.axes and not self._dialect.homes:
            self._go(block)
            yield self._to(RAPID, source)
        for index in named_axes:
            self._put(index, self._zeros.home[index])
            if self._dialect.homes:
                self._zeros.offset[index] = 0
        yield self._to(RAPID, source)
        if self._dialect.homes:
            text = " ".join(["G28", *(self._letters[index] for index, _ in block.axes)])
            yield ToolEvent(text, 0.0, source, text)

    def _error(self, line: int, message: str, remedy: str) -> JobError:
        return JobError(message, place=self._file.place(line), remedy=remedy)
