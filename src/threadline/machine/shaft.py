"""Parts of an embroidery machine: main shaft and step tables.

Each turn of the shaft has a window in which the controller moves the frame by step tables. After
the window the needles enter the cloth and leave it again.
"""

from __future__ import annotations

from fractions import Fraction
from math import pi
from typing import Annotated

from pydantic import model_validator
from pydantic.dataclasses import dataclass

from threadline.machine.parts import STRICT, PositiveTime
from threadline.machine.quantity import Quantity, Units

Angle = Annotated[Quantity, Units(("rad",), positive=True, most=2.0 * pi)]
Length = Annotated[Quantity, Units(("m",), positive=True)]
_FINEST = 360_000
"""Resolution of an angle, in parts of a turn: a thousandth of a degree."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Shaft:
    """The main shaft, which makes one stitch per turn.

    Angles count from the angle at which the frame begins to move. The frame must be at rest after
    ``window``.
    """

    turn: PositiveTime
    """Time of a turn at the highest speed."""
    slowest_turn: PositiveTime
    """Time of a turn at the lowest speed."""
    window: Angle
    """Angle until which the frame may move; it begins at angle 0."""
    needle_enters: Angle
    """Angle from which the needle is in the cloth."""
    needle_leaves: Angle
    """Angle until which the needle is in the cloth."""
    acceleration: Annotated[Quantity, Units(("rad/s^2",), positive=True)] | None = None
    """Largest rate of change of the shaft speed between two windows. Without it: the speed cannot
    change during sewing."""

    @model_validator(mode="after")
    def _in_order(self) -> Shaft:
        if not self.window.si <= self.needle_enters.si < self.needle_leaves.si:
            raise ValueError(
                "the needle must enter at the end of the window or later, and then leave: "
                "window <= needle_enters < needle_leaves"
            )
        if self.window_share == 0:
            raise ValueError(
                f"the window is {self.window.si * 180.0 / pi:.3g} deg; the resolution is a "
                "thousandth of a degree"
            )
        if self.window_share >= 1:
            raise ValueError("the window must end before the turn ends")
        if self.slowest_turn.si < self.turn.si:
            raise ValueError(
                f"slowest_turn, {self.slowest_turn.si:g} s, is shorter than turn, "
                f"{self.turn.si:g} s"
            )
        return self

    @property
    def window_share(self) -> Fraction:
        """Share of a turn in which the frame may move, rounded to a thousandth of a degree."""
        return Fraction(round(self.window.si / (2.0 * pi) * _FINEST), _FINEST)

    @property
    def turn_s(self) -> Fraction:
        """Exact time of the shortest turn, s."""
        assert self.turn.exact_s is not None
        return self.turn.exact_s


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Tables:
    """The controller's tables of step intervals, one table for each length of a move.

    An interval is a whole number of periods of the clock.
    """

    clock: str
    """The timer, a name of ``[clocks]``; clocks of the drives are multiples of it."""
    unit: Length
    """Shortest move."""
    longest: Length
    """Longest move; there is one table for each number of units up to it."""
    fetch: PositiveTime
    """Time to load one table. Between two moves the controller loads a table for each axis that
    moves."""
    step_rate: Annotated[Quantity, Units(("Hz",), positive=True)]
    """Highest rate of steps."""
    law: str
    """Motion law of the tables, unless ``--law`` names another."""

    @model_validator(mode="after")
    def _whole(self) -> Tables:
        units = self.longest.si / self.unit.si
        if abs(units - round(units)) > 1e-6 * units or not 1 <= round(units) <= 100_000:
            raise ValueError(f"longest is {units:.6g} units: it must be a whole number")
        return self

    @property
    def longest_units(self) -> int:
        """Length of the longest move, in units."""
        return round(self.longest.si / self.unit.si)
