"""What a kernel is written for, and where each number lies in its workspace.

The workspace of a group of variants ("lanes") is rows of ``width`` numbers, so that one vector
instruction serves all of them; a block is as many groups as fit the fastest memory. Only entries
of matrices that can differ from zero (and, on the diagonal of a propagator, from one) have rows.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from threadline.arrays import FloatArray

_LINE, _PAGE = 64, 4096
_FEW = 3

Pattern = tuple[int, ...]
"""Columns of a row that may differ from zero."""


class ControllerShape(NamedTuple):
    """What of a controller is fixed when its kernel is written."""

    drive: int
    sensor: Pattern
    feedback: bool  # it uses its earlier outputs
    second: bool  # it looks two ticks back
    reversal: bool  # a zero tick where its level changes sign
    limited: bool  # its drive's input has a limit of its own
    profile: str = ""  # what it makes positions from: "speed", "target"; "" where it does not


class AxisShape(NamedTuple):
    """What of an axis is fixed."""

    controller: int
    load: Pattern
    frame: Pattern


class GuardShape(NamedTuple):
    """What of a guard is fixed; its bounds have taken up the constant of its row."""

    row: Pattern
    bounded_below: bool
    bounded_above: bool


class Shape(NamedTuple):
    """Everything that a kernel is written for; columns are states, drives' inputs and 1."""

    lanes: int  # of a block
    width: int  # of a vector
    matrix: tuple[Pattern, ...]  # of the derivative, one for each state, of all modes together
    drives: tuple[Pattern, ...]  # of their currents
    controllers: tuple[ControllerShape, ...]
    axes: tuple[AxisShape, ...]
    guards: tuple[GuardShape, ...]
    inputs: int  # limit switches
    lengths: int  # distinct advances
    terms: int  # of Taylor's series over a cell
    sections: int  # of a cell in which guards are looked at one after the other
    peak: bool  # currents are watched
    quantised: bool
    delayed: bool  # some command is under way longer than no time
    shared: bool  # every tick each controller reads just what is its axis' load
    kinds: tuple[tuple[tuple[int, int], ...], ...]  # the actions of each kind of step
    uniform: tuple[tuple[object, ...], ...]  # rows that hold one number for all lanes, for good

    @property
    def states(self) -> int:
        """Number of states."""
        return len(self.matrix)

    @property
    def columns(self) -> int:
        """States, inputs and the constant."""
        return self.states + len(self.drives) + 1

    def reach(self) -> tuple[tuple[Pattern, ...], tuple[bool, ...]]:
        """Return the pattern of a propagator's rows, and which have 1 on the diagonal exactly.

        Entry (i, j) of ``exp(A t)`` differs from zero only where a chain of entries of A leads
        from i to j; entry (i, i) is 1 where no chain leads back.
        """
        found = [set(row) for row in self.matrix]
        for k in range(self.states):
            found = [row | found[k] if k in row else row for row in found]
        unit = tuple(i not in row for i, row in enumerate(found))
        return tuple(tuple(sorted(row)) for row in found), unit

    def monotone(self, w: int) -> bool:
        """Return whether guard w only rises or only falls during an advance, in any mode.

        It does where it follows one state at most whose rate depends on no other: inputs are
        held, so that this state goes to its end as an exponential or a straight line.
        """
        states = [j for j in self.guards[w].row if j < self.states]
        return all(
            states == [j] and not any(i < self.states for i in self.matrix[j] if i != j)
            for j in states
        )

    def rates(self) -> tuple[Pattern, ...]:
        """Return the patterns of the guards' rates; none where the ends of an advance tell all."""
        found = []
        for w, guard in enumerate(self.guards):
            rows = (self.matrix[j] for j in guard.row if j < self.states)
            pattern = () if self.monotone(w) else tuple(sorted(set().union(*rows)))
            found.append(pattern)
        return tuple(found)

    def nearness(self) -> tuple[Pattern, ...]:
        """Return the patterns of the rows of a cheap first look at guards that may turn.

        It is worth its loads only where few columns reach every guard: else there are none.
        """
        reach, _ = self.reach()
        found: list[Pattern] = []
        for w, guard in enumerate(self.guards):
            columns = set(guard.row).union(*(reach[j] for j in guard.row if j < self.states))
            found.append(() if self.monotone(w) else tuple(sorted(columns - {self.columns - 1})))
        few = any(found) and all(len(row) <= _FEW for row in found)
        return tuple(found) if few else ()


CHANGING = ("e1", "e2", "o1", "o2", "level", "held", "at", "speed", "goal", "seen")
"""Of a controller: errors and outputs one and two ticks ago, level, level that has arrived; of its
profile: position, speed, speed or target that it goes to, the last reference.
"""
NUMBERS = ("b0", "b1", "b2", "a1", "a2", "level low", "level high", "volt", "gain", "limit",
           "phase", "acceleration", "fastest", "per tick")  # fmt: skip
AXIS_ROWS = ("worst", "lowest", "highest", "last", "scale")
"""Largest |commanded - load|, least and greatest load of the window, last load, units per count."""


class Layout:
    """Rows of the workspace by name; the rows of a mode come last, those of an advance at the end.

    With several distinct advances their rows stay in the tables of the modes: ``source`` is the
    address of the first there, while all lanes are in one mode. Where they are not, the rows of one
    advance at a time are put together in the workspace.

    Attributes
    ----------
    fixed
        Rows that do not belong to a mode.
    of_mode, copied
        Rows in the table of a mode, and the first of them that a change of modes copies.
    per_length
        Rows of one advance.
    stride
        Rows from one group of lanes to the next.
    """

    def __init__(self, shape: Shape) -> None:
        self.row: dict[tuple[object, ...], int] = {}
        self.shape = shape
        n, size = shape.states, shape.columns
        for i in range(size - 1):
            self._add("z", i)
        if shape.guards:
            for i in range(n):
                self._add("old", i)
        unused = [self._unused(c) for c in shape.controllers]
        for c in range(len(unused)):
            for name in CHANGING:
                if name not in unused[c]:
                    self._add(name, c)
        for x in range(len(shape.axes)):
            for name in AXIS_ROWS[:-1]:
                self._add(name, x)
        for d in range(len(shape.drives)):
            self._add("peak", d)
        for s in range(shape.inputs):
            self._add("tripped", s)
        self._add("mode")
        if shape.lengths > 1:
            self._add("source")
        changing = len(self.row)
        for c, controller in enumerate(shape.controllers):
            for name in NUMBERS:
                if name not in unused[c]:
                    self._add(name, c)
            for j in controller.sensor:
                self._add("sensor", c, j)
        for x, axis in enumerate(shape.axes):
            self._add(AXIS_ROWS[-1], x)
            for j in axis.load:
                self._add("load", x, j)
            for j in axis.frame:
                self._add("frame", x, j)
        self.fixed = len(self.row)
        reach, _ = shape.reach()
        for w in range(len(shape.guards)):
            self._add("low", w)
            self._add("high", w)
        for w, guard in enumerate(shape.guards):
            for j in guard.row:
                self._add("guard", w, j)
        for d, pattern in enumerate(shape.drives):
            for j in pattern:
                self._add("current", d, j)
        for i, pattern in enumerate(shape.matrix if shape.guards else ()):
            for j in pattern:
                self._add("matrix", i, j)
        self.first_length = len(self.row)
        for i, pattern in enumerate(reach):
            for j in pattern:
                self._add("step", i, j)
        for w, pattern in enumerate(shape.rates()):
            for j in pattern:
                self._add("third", w, j)
        for w, pattern in enumerate(shape.nearness()):
            if pattern:
                self._add("near low", w)
                self._add("near high", w)
            for j in pattern:
                self._add("middle", w, j)
                self._add("spread", w, j)
        self.rows = len(self.row)
        self.per_length = self.rows - self.first_length
        common = self.first_length - self.fixed
        self.of_mode = common + shape.lengths * self.per_length
        self.copied = common + (self.per_length if shape.lengths == 1 else 0)

        # A load waits for an earlier store whose address is alike in its last twelve bits: what
        # changes must not look like anything that is read of the vector of lanes after it.
        lines = max(1, 8 * shape.width // _LINE)
        period = _PAGE // _LINE // lines
        self.stride = self.rows
        if shape.lanes > shape.width:
            self.stride += (changing - self.rows) % period

    def _unused(self, controller: ControllerShape) -> set[str]:
        """Return the rows that a controller does without."""
        unused: set[str] = set()
        if not controller.second:
            unused |= {"e2", "o2", "b2", "a2"}
        if not (controller.second or controller.feedback):
            unused |= {"o1", "a1"}
        if not self.shape.delayed:
            unused.add("held")
        if not controller.limited:
            unused.add("limit")
        if not controller.profile:
            unused |= {"at", "speed", "goal", "acceleration"}
        if controller.profile != "speed":
            unused |= {"seen", "per tick"}
        if controller.profile != "target":
            unused.add("fastest")
        return unused

    def _add(self, *name: object) -> None:
        self.row[name] = len(self.row)

    def __getitem__(self, name: tuple[object, ...]) -> int:
        return self.row[name]


def aligned(shape: tuple[int, ...]) -> FloatArray:
    """Return zeros that begin at a cache line: a vector that straddles two costs twice."""
    count = int(np.prod(shape))
    room = np.zeros(8 * count + _LINE, dtype=np.uint8)
    first = -room.ctypes.data % _LINE
    return room[first : first + 8 * count].view(np.float64).reshape(shape)
