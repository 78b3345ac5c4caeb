"""The plan's time at each tick of a run, if rows are not played one per tick.

A hold, a stop and a start from rest play rows at another rate than one per tick. Only the machine
knows which were played: rows carry their places, and the machine reports them.
"""

from __future__ import annotations

import math

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.files import Clock, Event
from threadline.machine import Machine


class Pace:
    """Makes events of the kind ``plan`` from played rows; none at one row per tick.

    Each event has the plan's time at its tick. After an event the plan advances one row per tick,
    or stands still if the previous event had the same time; a tick gets its own event only if it
    differs from that.

    Parameters
    ----------
    clock
        Clock whose period a row lasts.
    """

    def __init__(self, clock: Clock) -> None:
        self._per_row = float(clock.period_s.numerator), float(clock.period_s.denominator)
        self._rate = 1.0
        self._told: float | None = None  # place of the latest event
        self.place = 0.0
        """Number of played rows of the table, whole or not."""

    def played(self, first: int, places: FloatArray) -> tuple[Event, ...]:
        """Return the events of played rows.

        Parameters
        ----------
        first
            Tick of the first of them.
        places
            (n,) number of rows of the table, whole or not, played after each of them.
        """
        ahead = self.place + self._rate * np.arange(1.0, len(places) + 1.0)
        if np.array_equal(places, ahead):
            self.place = float(places[-1]) if len(places) else self.place
            return ()
        found: list[Event] = []
        for tick, place in enumerate(places.tolist(), first + 1):
            if place != self.place + self._rate:
                # Rounded as a clock converts ticks to seconds: a whole row has its tick's time.
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
