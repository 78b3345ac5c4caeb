"""What a kernel is written for: all that is fixed when its code is made."""

from __future__ import annotations

from typing import NamedTuple

from threadline.twin.kernel.names import Action, Row, SampleLayout

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
    encoder: str = "nearest"  # how its encoder rounds: "nearest", "floor", "truncate"
    dac: str = "nearest"  # how its DAC rounds
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
    kinds: tuple[tuple[Action, ...], ...]  # the actions of each kind of step
    uniform: tuple[Row, ...]  # rows that hold one number for all lanes, for good

    @property
    def states(self) -> int:
        """Number of states."""
        return len(self.matrix)

    @property
    def columns(self) -> int:
        """States, inputs and the constant."""
        return self.states + len(self.drives) + 1

    @property
    def sample(self) -> SampleLayout:
        """Columns of a sample."""
        return SampleLayout(len(self.controllers), len(self.axes), len(self.drives), self.inputs)

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
