"""The shape of a kernel: everything that is fixed when its code is written."""

from __future__ import annotations

from typing import NamedTuple

from threadline.twin.kernel.names import Action, Row, SampleLayout

_FEW = 3

Pattern = tuple[int, ...]
"""Columns of a row that can differ from zero."""


class BankShape(NamedTuple):
    """Fixed properties of a state-space controller, whose loops lie side by side.

    Its columns are its states, the references and readings of its loops, then other sensors.
    """

    loops: int
    sensors: tuple[int, ...]  # indices of its other sensors
    following: tuple[Pattern, ...]  # of each state at the next tick
    output: tuple[Pattern, ...]  # of each output
    back: tuple[Pattern, ...]  # of each state, over the loops


class SensorShape(NamedTuple):
    """Fixed properties of an observing sensor."""

    sees: Pattern
    feels: Pattern  # states whose rates it reads
    rounding: str  # of whole steps: "floor", "trunc", "" for none
    offset: float  # added before rounding
    noisy: bool
    limited: bool


class ControllerShape(NamedTuple):
    """Fixed properties of a controller, or of one loop of a state-space controller."""

    drive: int
    sensor: Pattern
    feedback: bool  # it uses its earlier outputs
    second: bool  # it uses values from two ticks earlier
    reversal: bool  # its DAC outputs 0 for a tick at a change of sign
    limited: bool  # its drive's input has a limit
    encoder: str = "nearest"  # rounding of its encoder: "nearest", "floor", "truncate"
    dac: str = "nearest"  # rounding of its DAC
    profile: str = ""  # it generates positions from "speed" or "target"; "" for none
    bank: BankShape | None = None  # of the first loop of a state-space controller
    banked: bool = False  # it is a loop of a state-space controller


class AxisShape(NamedTuple):
    """Fixed properties of an axis."""

    controller: int
    load: Pattern
    frame: Pattern
    rate: Pattern


class GuardShape(NamedTuple):
    """Fixed properties of a guard; the constant of its row is included in its bounds."""

    row: Pattern
    bounded_below: bool
    bounded_above: bool


class Shape(NamedTuple):
    """Fixed properties of a kernel; columns are states, inputs of drives and forces, and 1."""

    lanes: int  # of a block
    width: int  # of a vector
    matrix: tuple[Pattern, ...]  # of the derivative of each state, over all modes
    drives: tuple[Pattern, ...]  # of their currents
    controllers: tuple[ControllerShape, ...]
    axes: tuple[AxisShape, ...]
    guards: tuple[GuardShape, ...]
    inputs: int  # limit switches
    lengths: int  # distinct advances
    terms: int  # of Taylor's series over a cell
    sections: int  # of a cell, in which guards are checked one after the other
    peak: bool  # currents are watched
    quantised: bool
    delayed: bool  # a command has a dead time above 0
    shared: bool  # each controller reads its axis' load at every tick
    kinds: tuple[tuple[Action, ...], ...]  # the actions of each kind of step
    observing: tuple[SensorShape, ...]
    uniform: tuple[Row, ...]  # constant rows with equal numbers in all lanes
    pulls: int = 0  # inputs behind the drives' own: forces on the axes from outside

    @property
    def states(self) -> int:
        """Number of states."""
        return len(self.matrix)

    @property
    def columns(self) -> int:
        """States, inputs and the constant."""
        return self.states + len(self.drives) + self.pulls + 1

    @property
    def sample(self) -> SampleLayout:
        """Columns of a sample."""
        return SampleLayout(
            len(self.controllers), len(self.axes), len(self.drives), self.inputs,
            len(self.observing),
        )  # fmt: skip

    @property
    def derived(self) -> tuple[int, ...]:
        """States whose derivatives the code computes: all if there is a guard."""
        felt = {i for sensor in self.observing for i in sensor.feels}
        return tuple(range(self.states)) if self.guards else tuple(sorted(felt))

    def reach(self) -> tuple[tuple[Pattern, ...], tuple[bool, ...]]:
        """Return the patterns of a propagator's rows, and which have exactly 1 on the diagonal.

        Entry (i, j) of ``exp(A t)`` differs from zero only if a chain of entries of A leads from i
        to j; entry (i, i) is 1 if no chain leads back.
        """
        found = [set(row) for row in self.matrix]
        for k in range(self.states):
            found = [row | found[k] if k in row else row for row in found]
        unit = tuple(i not in row for i, row in enumerate(found))
        return tuple(tuple(sorted(row)) for row in found), unit

    def monotone(self, w: int) -> bool:
        """Return whether guard w is monotone during an advance, in any mode.

        It is monotone if it depends on at most one state whose rate depends on no other: inputs are
        held, so this state follows an exponential or a straight line.
        """
        states = [j for j in self.guards[w].row if j < self.states]
        return all(
            states == [j] and not any(i < self.states for i in self.matrix[j] if i != j)
            for j in states
        )

    def rates(self) -> tuple[Pattern, ...]:
        """Return the patterns of the guards' rates; empty for monotone guards."""
        found = []
        for w, guard in enumerate(self.guards):
            rows = (self.matrix[j] for j in guard.row if j < self.states)
            pattern = () if self.monotone(w) else tuple(sorted(set().union(*rows)))
            found.append(pattern)
        return tuple(found)

    def nearness(self) -> tuple[Pattern, ...]:
        """Return the patterns of the rows of the cheap test of non-monotone guards.

        The test is worth its loads only if few columns affect every guard; otherwise the result is
        empty.
        """
        reach, _ = self.reach()
        found: list[Pattern] = []
        for w, guard in enumerate(self.guards):
            columns = set(guard.row).union(*(reach[j] for j in guard.row if j < self.states))
            found.append(() if self.monotone(w) else tuple(sorted(columns - {self.columns - 1})))
        few = any(found) and all(len(row) <= _FEW for row in found)
        return tuple(found) if few else ()
