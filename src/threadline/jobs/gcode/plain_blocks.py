"""A compiled reader of the plain blocks of a part program.

Almost all lines of a long program are plain: N, G0 G1 G90 G91, axis words, F, a comment, tags. This
reader takes plain lines. It stops before the first line that has other words, is wrong, or has too
many digits; ``block`` and ``part_program`` read that line. They can read plain blocks, too, and
tests compare both readers.

Positions are integers of 1e-7 mm or degrees below 2**53. Their conversion to SI is therefore
correctly rounded, as is the conversion of the interpreter's exact integers.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.jobs.gcode.comments import (
    BLANK,
    BOOK_SIZE,
    CLOSE,
    CR,
    DECIMALS,
    DIGITS,
    DOT,
    IN_BLOCK,
    LAST_ASCII,
    LF,
    LOWER_A,
    LOWER_Z,
    MAX_DIGITS,
    MINUS,
    NAMES,
    NINE,
    NOT_PLAIN,
    OPEN,
    PLUS,
    POWERS,
    SEMICOLON,
    TAB,
    UPPER_A,
    UPPER_Z,
    WHICH,
    ZERO,
    follow_comment,
    name_of,
)
from threadline.jobs.gcode.dialects import Reading
from threadline.jobs.gcode.textfile import MAX_LINE_BYTES, Lines
from threadline.jobs.operations import NO_COLUMNS, Column

STEPS = 10**7
PLACES = 7
EXACT_LIMIT = 2**53

# Indices of the state vector.
MOTION, RELATIVE, TENTH_MM, INVERSE, LINE, AT, FOLLOW, RAPID_FEED, EACH_G, RAPID_F = range(10)
LONGEST, FEED_FIRST, SPLIT_COMMENTS, ONE_COMMAND = range(10, 14)
STATE_SIZE = 14

_F, _G, _N = ord("F"), ord("G"), ord("N")
_RAD = math.pi / 180.0


def _follow_plain(  # noqa: PLR0915 - one loop over the bytes; calls would cost half the speed
    data: NDArray[np.uint8],
    axis_of: NDArray[np.int8],
    linear: NDArray[np.bool_],
    state: IntArray,
    exact: IntArray,
    offset: IntArray,
    position: FloatArray,
    feed: FloatArray,
    out_position: FloatArray,
    out_feed: FloatArray,
    out_line: IntArray,
    out_word: IntArray,
    used: NDArray[np.bool_],
    book: IntArray,
    out_tag: FloatArray,
    tagged: IntArray,
) -> int:
    """Read plain blocks from ``state[AT]``; return the number of moves written.

    Parameters
    ----------
    data
        (bytes,) whole lines of the program.
    axis_of
        (128,) index of the axis by letter, -1 for a letter without an axis.
    linear
        (axes,) whether each axis is linear.
    state
        (STATE_SIZE,) modes, line and place in ``data``; updated. If FOLLOW is 0, words are checked
        and noted and no position is computed. If RAPID_FEED is not 0, G0 moves at the feed. If
        EACH_G is not 0, axis words need a G word in their block. RAPID_F becomes the line of the
        first G0 with an F. The reader stops before a line of more than LONGEST bytes; if FEED_FIRST
        is not 0, before a line with G1 and no axis words; if SPLIT_COMMENTS is not 0, before a line
        with a semicolon in parentheses; if ONE_COMMAND is not 0, before a line that does not begin
        with its only G word, or has small letters or a comment in parentheses.
    offset
        (axes,) position of the programmed zero, in 1e-7 mm or degrees.
    exact, position
        (axes,) present position in 1e-7 mm or degrees, and in m or rad; updated.
    feed
        (1,) F in m/s, or in 1/s in G93; NaN before the first F; updated.
    out_position, out_feed, out_line
        (room, axes), (room,), (room,) targets, feeds and lines of the moves. The feed of a G0 is
        -1, or the negative feed if G0 moves at the feed.
    out_word
        (room,) F of the block times 1e7, -1 without F.
    used
        (axes,) whether each axis has a word in the program; updated.
    book
        (BOOK_SIZE,) names and values of tags (see ``comments``); updated.
    out_tag, tagged
        (names, room), (names,) tag values of the moves, NaN for a move without the tag; and for
        each tag the number of moves up to the last move with the tag, 0 without one. Both are
        updated if FOLLOW is not 0. ``out_tag`` holds no values after the last move with the tag.
    """
    # ruff: noqa: PLR1714 - the compiler makes two comparisons of these, not a search
    n_axes = exact.shape[0]
    room = out_line.shape[0]
    end = data.shape[0]
    target = np.empty(n_axes, np.int64)
    has_word = np.empty(n_axes, np.bool_)
    new_position = np.empty(n_axes, np.float64)
    moves = 0
    follow = state[FOLLOW] != 0
    while moves < room:
        start = state[AT]
        if start >= end:
            break
        at = start
        motion, relative = state[MOTION], state[RELATIVE]
        f_word = -1
        seen_g_motion = seen_g_distance = seen_n = has_axes = False
        for k in range(n_axes):
            has_word[k] = False
        plain = True
        code_seen = False
        book[IN_BLOCK] = 0
        while True:
            if at >= end:
                break
            c = data[at]
            if c == BLANK or (c == TAB and state[ONE_COMMAND] == 0):
                at += 1
                continue
            if c == LF:
                break
            if c == CR:
                if at + 1 < end and data[at + 1] == LF:
                    at += 1
                    break
                plain = False
                break
            if c == OPEN:
                at += 1
                while at < end and data[at] != CLOSE:
                    if data[at] == OPEN or data[at] < BLANK or data[at] > LAST_ASCII:
                        break
                    if data[at] == SEMICOLON and state[SPLIT_COMMENTS] != 0:
                        break
                    at += 1
                if at >= end or data[at] != CLOSE or state[ONE_COMMAND] != 0:
                    plain = False
                    break
                at += 1
                continue
            if c == SEMICOLON:
                at = follow_comment(data, at + 1, code_seen, book)
                plain = at != NOT_PLAIN
                if plain and at < end and data[at] == CR:
                    at += 1
                break
            # A word is a letter, blanks and a number.
            if LOWER_A <= c <= LOWER_Z and state[ONE_COMMAND] == 0:
                c -= 32
            if c < UPPER_A or c > UPPER_Z:
                plain = False
                break
            letter = c
            if state[ONE_COMMAND] != 0 and (letter == _G) == code_seen:
                plain = False
                break
            code_seen = True
            at += 1
            while at < end and (data[at] == BLANK or data[at] == TAB):
                at += 1
            if state[ONE_COMMAND] != 0 and (
                data[at - 1] == TAB
                or (letter == _G and (data[at - 1] == BLANK or (at < end and data[at] < ZERO)))
            ):
                plain = False
                break
            sign = 1
            if at < end and (data[at] == MINUS or data[at] == PLUS):
                if data[at] == MINUS:
                    sign = -1
                at += 1
            value = 0
            digits = decimals = 0
            dotted = False
            while at < end:
                c = data[at]
                if ZERO <= c <= NINE:
                    value = value * 10 + int(c - ZERO)
                    digits += 1
                    if dotted:
                        decimals += 1
                    if digits > MAX_DIGITS:
                        break
                elif c == DOT and not dotted:
                    dotted = True
                else:
                    break
                at += 1
            if digits == 0 or digits > MAX_DIGITS or decimals > PLACES:
                plain = False
                break
            if at < end and data[at] == DOT:
                plain = False
                break
            value *= sign
            if letter == _N:
                if seen_g_motion or seen_g_distance or has_axes or f_word != -1:
                    plain = False
                    break
                if seen_n or dotted or sign < 0 or digits > 7:
                    plain = False
                    break
                seen_n = True
                continue
            if letter == _G:
                if dotted:
                    plain = False
                    break
                if (value == 0 or value == 1) and not seen_g_motion:
                    seen_g_motion = True
                    motion = value
                elif (value == 90 or value == 91) and not seen_g_distance:
                    seen_g_distance = True
                    relative = value - 90
                else:
                    plain = False
                    break
                continue
            # The unit is 1e-7: 15 digits stay below 2**63 only for numbers up to 10**11.
            if digits - decimals > 11:
                plain = False
                break
            for _ in range(PLACES - decimals):
                value *= 10
            if letter == _F:
                if f_word != -1 or value <= 0:
                    plain = False
                    break
                f_word = value
                continue
            axis = axis_of[letter]
            if axis < 0 or has_word[axis]:
                plain = False
                break
            has_word[axis] = True
            has_axes = True
            target[axis] = value
        if not plain or at - start > state[LONGEST]:
            break
        if state[FEED_FIRST] != 0 and seen_g_motion and motion == 1 and not has_axes:
            break
        if f_word != -1 and not has_axes:
            break  # F without a move: the interpreter reads the block
        if motion > 1 or (has_axes and state[EACH_G] != 0 and not seen_g_motion):
            break  # a curve, or a missing G word
        if has_axes and follow:
            # Check the whole block before any state changes.
            feed_value = feed[0]
            if f_word != -1:
                if state[INVERSE] != 0:
                    feed_value = f_word / (60.0 * STEPS)
                else:
                    if f_word >= EXACT_LIMIT // 254:
                        break
                    feed_value = (f_word * state[TENTH_MM]) / (600_000.0 * STEPS)
            if motion < 0:
                break
            at_feed = motion == 1 or state[RAPID_FEED] != 0
            if at_feed and (math.isnan(feed_value) or (state[INVERSE] != 0 and f_word == -1)):
                break
            fits = True
            for k in range(n_axes):
                if has_word[k]:
                    value = target[k]
                    if linear[k]:
                        if abs(value) >= EXACT_LIMIT:
                            fits = False
                            break
                        value *= state[TENTH_MM]
                        if value % 10 != 0:
                            fits = False
                            break
                        value //= 10
                    value += exact[k] if relative != 0 else offset[k]
                    if abs(value) >= EXACT_LIMIT:
                        fits = False
                        break
                    target[k] = value
                    if linear[k]:
                        new_position[k] = value / (1000.0 * STEPS)
                    else:
                        new_position[k] = (value / (1.0 * STEPS)) * _RAD
                else:
                    target[k] = exact[k]
                    new_position[k] = position[k]
            if not fits:
                break
            for k in range(n_axes):
                exact[k] = target[k]
                position[k] = new_position[k]
                out_position[moves, k] = new_position[k]
            feed[0] = feed_value
            if motion == 1:
                out_feed[moves] = feed_value
            else:
                out_feed[moves] = -feed_value if at_feed else -1.0
            for k in range(book[IN_BLOCK]):
                tag, decimals = book[WHICH + k], book[DECIMALS + k]
                tag_value = float(book[DIGITS + k])
                if decimals != 0:  # a division costs as much as one or two digits
                    # Both are exact (15 digits, powers of ten up to 1e15): this rounds once.
                    tag_value /= POWERS[decimals if decimals > 0 else ~decimals]
                    if decimals < 0:
                        tag_value = -tag_value
                for move_without in range(tagged[tag], moves):
                    out_tag[tag, move_without] = np.nan
                out_tag[tag, moves] = tag_value
                tagged[tag] = moves + 1
        if has_axes:
            if motion == 0 and f_word != -1 and state[RAPID_F] == 0:
                state[RAPID_F] = state[LINE]
            out_line[moves] = state[LINE]
            out_word[moves] = f_word
            for k in range(n_axes):
                used[k] = used[k] or has_word[k]
            moves += 1
        state[MOTION] = motion
        state[RELATIVE] = relative
        state[LINE] += 1
        state[AT] = at + 1
    return moves


follow_plain = njit(nogil=True)(_follow_plain)


FIRST_LINES = 200
"""Lines of a program that ``block`` and ``part_program`` read before this reader is tried: they
read these lines in about 10 ms, and compiling this reader takes seconds on a new computer."""
_ROOM = 4096
_LONGEST_PAUSE = 63


class PlainReader:
    """The compiled reader with its arrays.

    Parameters
    ----------
    axis_of
        Index of each axis by its letter.
    linear
        (axes,) whether each axis is linear.
    follow
        Whether to compute positions; False: only check and note the words.
    """

    def __init__(self, axis_of: Mapping[str, int], linear: tuple[bool, ...], follow: bool) -> None:
        self._axis_of = np.full(128, -1, np.int8)
        for letter, index in axis_of.items():
            self._axis_of[ord(letter)] = index
        self._linear = np.array(linear, np.bool_)
        axes = len(linear)
        self.state = np.zeros(STATE_SIZE, np.int64)
        self.state[FOLLOW] = follow
        self.state[LONGEST] = MAX_LINE_BYTES
        self.exact = np.zeros(axes, np.int64)
        self.offset = np.zeros(axes, np.int64)
        self.position = np.zeros(axes)
        self.feed = np.full(1, np.nan)
        self.out_position = np.empty((_ROOM, axes))
        self.out_feed = np.empty(_ROOM)
        self.out_line = np.empty(_ROOM, np.int64)
        self.out_word = np.empty(_ROOM, np.int64)
        self.used = np.zeros(axes, np.bool_)
        self._book = np.zeros(BOOK_SIZE, np.int64)
        self._out_tag = np.empty((NAMES, _ROOM))
        self._tagged = np.zeros(NAMES, np.int64)
        self._names: dict[int, str] = {}
        self.usable = True
        self._pause, self._patience = FIRST_LINES, 0

    def worth_trying(self) -> bool:
        """Return whether to try the next line; after lines that were not plain, tries are rare."""
        self._pause -= 1
        return self._pause < 0 and self.usable

    def read(self, lines: Lines) -> int:
        """Read plain blocks of ``lines``; return the number of moves in the ``out`` arrays."""
        self.state[AT] = lines.at
        self.state[LINE] = lines.number
        moves = follow_plain(
            lines.data, self._axis_of, self._linear, self.state, self.exact, self.offset,
            self.position, self.feed, self.out_position, self.out_feed, self.out_line,
            self.out_word, self.used, self._book, self._out_tag, self._tagged,
        )  # fmt: skip
        self._patience = min(2 * self._patience + 1, _LONGEST_PAUSE) if moves == 0 else 0
        self._pause = self._patience
        lines.at = int(self.state[AT])
        lines.number = int(self.state[LINE])
        return int(moves)

    def columns(self, count: int) -> Mapping[str, Column]:
        """Return the tags of the ``count`` moves just read, as (count,) values by name."""
        tag_columns: dict[str, Column] = {}
        for tag, end in enumerate(self._tagged.tolist()):
            if end == 0:
                continue
            if tag not in self._names:
                self._names[tag] = name_of(self._book, tag)
            column = self._out_tag[tag, :count].copy()
            if end < count:
                column[end:] = np.nan
            tag_columns[self._names[tag]] = column
        if tag_columns:
            self._tagged[:] = 0
        return tag_columns or NO_COLUMNS


def plain_reader(reading: Reading, linear: tuple[bool, ...], follow: bool) -> PlainReader:
    """Return the compiled reader for the dialect of a program."""
    dialect = reading.dialect
    # The compiled reader knows no wrapped axes, and stops before their words.
    axes = {letter: index for letter, index in reading.axes.items() if index not in reading.wrapped}
    plain = PlainReader(axes, linear, follow)
    plain.state[RAPID_FEED] = dialect.rapid_is_feed
    plain.state[EACH_G] = dialect.each_g
    grammar = dialect.grammar
    plain.state[LONGEST] = grammar.longest or MAX_LINE_BYTES
    plain.state[FEED_FIRST] = grammar.feed_first
    plain.state[SPLIT_COMMENTS] = grammar.split_comments
    plain.state[ONE_COMMAND] = dialect.one_command
    # This reader does not require decimal points, and does not tell which command was the last.
    plain.usable = not dialect.points and not grammar.repeats
    return plain
