"""The compiled reader of plain blocks with its arrays, and when it is worth trying."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from threadline.jobs.gcode.comments import BOOK_SIZE, NAMES, name_of
from threadline.jobs.gcode.dialects import Reading
from threadline.jobs.gcode.plain_blocks import (
    AT,
    EACH_G,
    FEED_FIRST,
    FOLLOW,
    LINE,
    LONGEST,
    ONE_COMMAND,
    RAPID_FEED,
    SPLIT_COMMENTS,
    STATE_SIZE,
    follow_plain,
)
from threadline.jobs.gcode.textfile import MAX_LINE_BYTES, Lines
from threadline.jobs.operations import NO_COLUMNS, Column

_ROOM = 4096
_LONGEST_PAUSE = 63


class PlainReader:
    """The compiled reader with its arrays.

    Parameters
    ----------
    axis_of
        Index of the axis by letter.
    linear
        (axes,) whether an axis is linear.
    follow
        Whether to compute positions, or only to check and note words.
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
        self._pause = self._patience = 0

    def worth_trying(self) -> bool:
        """Return whether to try the next line, which is rarely after lines that were not plain."""
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
        """Return the tags of the ``count`` moves just read, (count,) values each by name."""
        found: dict[str, Column] = {}
        for which, end in enumerate(self._tagged.tolist()):
            if end == 0:
                continue
            if which not in self._names:
                self._names[which] = name_of(self._book, which)
            column = self._out_tag[which, :count].copy()
            if end < count:
                column[end:] = np.nan
            found[self._names[which]] = column
        if found:
            self._tagged[:] = 0
        return found or NO_COLUMNS


def plain_reader(reading: Reading, linear: tuple[bool, ...], follow: bool) -> PlainReader:
    """Return the compiled reader for the dialect of a program."""
    dialect = reading.dialect
    plain = PlainReader(reading.axes, linear, follow)
    plain.state[RAPID_FEED] = dialect.rapid_is_feed
    plain.state[EACH_G] = dialect.each_g
    grammar = dialect.grammar
    plain.state[LONGEST] = grammar.longest or MAX_LINE_BYTES
    plain.state[FEED_FIRST] = grammar.feed_first
    plain.state[SPLIT_COMMENTS] = grammar.split_comments
    plain.state[ONE_COMMAND] = dialect.one_command
    plain.usable = not dialect.points  # it does not look for them
    return plain
