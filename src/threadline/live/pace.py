"""Which instant of the plan each tick of a run belongs to, where rows aren't played one a tick.

A hold, a stop and a start from rest play rows at another rate than one a tick. What was played is
known only where it was played: rows carry their places, and the machine tells what came of them.
"""

from __future__ import annotations

import math

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.files import Clock, Event
from threadline.machine import Machine


class Pace:
    """Tells events of the kind ``plan`` of what is played; none while it is one row a tick.

    Each has the plan's time at its tick. Behind an event the plan goes on by a row a tick, or
    stands where the event before it has the same time: a tick has its own event only where that
    isn't so.

    Parameters
    ----------
    clock
        Whose period a row lasts.
    """

    def __init__(self, clock: Clock) -> None:
        self._per_row = float(clock.period_s.numerator), float(clock.period_s.denominator)
        self._rate = 1.0
        self._told: float | None = None  # place of the latest event
        self.place = 0.0
        """Rows of the table that were played, whole or not."""

    def played(self, first: int, places: FloatArray) -> tuple[Event, ...]:
        """Return the events of rows that were played.

        Parameters
        ----------
        first
            Tick at which the first of them was taken up.
        places
            (n,) rows of the table, whole or not, that were played after each of them.
        """
        ahead = self.place + self._rate * np.arange(1.0, len(places) + 1.0)
        if np.array_equal(places, ahead):
            self.place = float(places[-1]) if len(places) else self.place
            return ()
        found: list[Event] = []
        for tick, place in enumerate(places.tolist(), first + 1):
            if place != self.place + self._rate:
                # As a clock turns its ticks into seconds: a whole row has the time of its tick.
                time_s = place * self._per_row[0] / self._per_row[1]
                found.append(Event(tick=tick, kind="plan", operation=-1, value=time_s))
                self._rate = 0.0 if place == self._told else 1.0
                self._told = place
            self.place = place
        return tuple(found)

    def stood(self, first: int, ticks: int) -> tuple[Event, ...]:
        """Return the events of ticks from ``first`` on at which nothing was played."""
        return self.played(first, np.full(ticks, self.place))


def place_words(machine: Machine, axis: str, place: float) -> str:
    """Return a place of an axis, m or rad, as mm or degrees with the unit."""
    if machine.axes[axis].kind == "linear":
        return f"{1e3 * place:.5g} mm"
    return f"{math.degrees(place):.5g} deg"


def speed_words(machine: Machine, axis: str, speed: float) -> str:
    """Return a speed of an axis, m/s or rad/s, as mm/s or degrees/s with the unit."""
    return f"{place_words(machine, axis, speed)}/s"
