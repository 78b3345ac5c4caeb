"""The plan's time at each tick of a run, if rows are not played one per tick.

A hold, a stop, a start from rest and an override play rows at another rate than one per tick. Only
the machine knows the played rows: each row carries its place, and the machine reports it.
"""

from __future__ import annotations

import math

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.files import Clock, Event
from threadline.machine import Machine

_SAME = 1e-7
"""Largest error, in rows, of a place at a constant rate other than 1: some rounding errors."""
_DIGITS = 6  # of a rate; an override has two
_AT_ONCE = 1 << 12  # places that are compared at once


class Pace:
    """Makes events of the kind ``plan`` from played rows; none at one row per tick.

    Each event has the plan's time at its tick. After an event the plan advances one row per tick,
    or at the rate in its name, or stands still if the previous event had the same time; a tick gets
    its own event only if its time differs from this rule. So a long stretch at a constant rate has
    a few events at its beginning.

    Parameters
    ----------
    clock
        Clock of the rows: one row per period.
    """

    def __init__(self, clock: Clock) -> None:
        self._per_row = float(clock.period_s.numerator), float(clock.period_s.denominator)
        self._rate = 1.0
        self._latest: float | None = None  # place of the latest event
        self._since = 0  # ticks since that event
        self._step = 0.0  # rows played in the latest tick with an event
        self.place = 0.0
        """Number of played rows of the table, whole or not."""

    def played(self, first: int, places: FloatArray) -> tuple[Event, ...]:
        """Return the events of played rows.

        Parameters
        ----------
        first
            Tick of the first row.
        places
            (n,) number of rows of the table, whole or not, played up to the end of each tick.
        """
        events: list[Event] = []
        index = 0
        while index < len(places):
            computed_count = self._goes_on(places[index : index + _AT_ONCE])
            if computed_count:
                self._since += computed_count
                self._step = self._rate
                self.place = float(places[index + computed_count - 1])
                index += computed_count
                continue
            events.append(self._event(first + 1 + index, float(places[index])))
            index += 1
        return tuple(events)

    def _goes_on(self, places: FloatArray) -> int:
        """Return how many of the next places a reader computes without an event."""
        ticks = np.arange(1.0, len(places) + 1.0)
        if self._rate in (0.0, 1.0):
            differs = places != self.place + self._rate * ticks
        else:
            assert self._latest is not None
            expected_places = self._latest + self._rate * (self._since + ticks)
            differs = np.abs(places - expected_places) > _SAME
        return int(np.argmax(differs)) if differs.any() else len(places)

    def _event(self, tick: int, place: float) -> Event:
        """Return the event of a place that a reader cannot compute."""
        # Rounded as a clock converts ticks to seconds: a whole row has its tick's time.
        time_s = place * self._per_row[0] / self._per_row[1]
        step, name = place - self.place, ""
        self._rate = 0.0 if place == self._latest else 1.0
        rate = round(step, _DIGITS)
        if 0.0 < rate < 1.0 and max(abs(step - self._step), abs(step - rate)) <= _SAME:
            self._rate, name = rate, f"{rate:g}"  # the same rate twice: it is likely to last
        self._latest, self._step, self._since, self.place = place, step, 0, place
        return Event(tick=tick, kind="plan", operation=-1, name=name, value=time_s)

    def after_end(self, first: int, ticks: int) -> tuple[Event, ...]:
        """Return the events of ticks from ``first`` on after the last row: the clock goes on.

        No event is needed if the rate was 1 or 0: a reader computes these ticks.
        """
        if self._rate in (0.0, 1.0):
            return ()
        return self.played(first, self.place + np.arange(1.0, ticks + 1.0))

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
