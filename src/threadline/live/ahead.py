"""The part of a tick table sent ahead to the machine: its place at each tick, and its rows."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from math import ceil
from typing import Any

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.errors import CommandError, LimitError
from threadline.files import Commands, Event, tick_table
from threadline.live.braking import (
    MOST_PLACES,
    CountLimits,
    brake,
    change_rate,
    gentle_hold_ticks,
    most_changed,
)
from threadline.live.feed_override import feed_words
from threadline.live.pace import place_words
from threadline.live.path_window import PathWindow
from threadline.live.wire import Message, event_row
from threadline.machine import Machine

_PAST_TICKS = 4  # past ticks that are kept
SETTLE_S = 0.5
"""Recording time in s after the last row, as in a simulation."""
OVERRIDE_S = 0.5
"""Shortest duration of a change of the feed by an override, s: four periods of a mode of 8 Hz."""
_LIMIT_COUNTS = 2.0
"""Tolerance of the limits, in counts: rounding adds up to one count at either end of a row."""


class Ahead:
    """The part of a run that was sent to the machine, as a place in the table for each tick.

    A place is a row number of the table, with a fraction (``PathWindow``).

    Parameters
    ----------
    commands
        Table to run.
    machine
        Machine whose limits every row must keep.
    pass_stops
        Whether the run goes on at stops of the program.
    loads_follow
        Whether the rows are motor commands that make the loads follow; see ``CountLimits.of``.

    Attributes
    ----------
    to_rest
        Whether the rows end at the program's next rest, for a hold that would leave the path
        anywhere else.
    gently
        Whether the next ``cut`` and the next start from rest are gentle.
    rate
        Rows of the table per tick that the run is to play: 1, or from 0.1 to 0.99. The next refill
        begins the change.
    """

    keeps_home = True  # positions are counted through every stop
    share_done = None  # it follows from the time

    def __init__(
        self,
        commands: Commands,
        machine: Machine,
        *,
        pass_stops: bool = False,
        loads_follow: bool = False,
    ) -> None:
        table = tick_table(commands)
        self._window = PathWindow(table, pass_stops=pass_stops)
        self._machine = machine
        self._limits = CountLimits.of(machine, loads_follow=loads_follow)
        self.start = table.start_counts
        self.settle_ticks = ticks_in(SETTLE_S, machine) + 1
        self._first = 0  # tick of the first place that is kept
        self._places = np.zeros(1)  # at the ticks from there on
        self.rate = 1.0
        self._gently = float(ticks_in(OVERRIDE_S, machine))
        self._rate = 1.0  # rate that the rows play, or are changing to
        self._on_the_way: FloatArray = np.empty(0)  # places of the change to that rate
        self._line = (0, 0.0)  # tick and place from which on that rate is played
        self._overrides = [(-1, 1.0)]  # ticks and rates that the machine was sent
        self._sent_events: list[tuple[int, Event]] = []  # sent events, and their ticks
        self._window.reach(MOST_PLACES)
        self.to_rest = self.gently = False
        self._held_ticks = gentle_hold_ticks(float(machine.tick_clock.period_s))
        self._before_cut: tuple[Any, ...] | None = None

    @property
    def end(self) -> int:
        """Tick up to which rows were sent, without the braking tail."""
        return self._first + len(self._places) - 1

    @property
    def place(self) -> float:
        """Place of the run at the tick ``end``."""
        return float(self._places[-1])

    @property
    def complete(self) -> bool:
        """Whether the last row has been sent."""
        return self._window.at_end and self.place >= self._window.reach(self.place)

    @property
    def halt(self) -> Event | None:
        """Stop or wait at which the sent rows end; None if they end at neither."""
        halt = self._window.halt()
        return halt if halt is not None and self.place >= halt.tick else None

    def refuse_elsewhere(self, stands: IntArray) -> None:
        """Refuse a run that does not begin where the axes stand."""
        refuse_start_elsewhere(self._machine, stands, self.start)

    def hear(self, head: Mapping[str, Any]) -> str:  # noqa: ARG002
        """Return nothing: the place of the rows is known from their ticks."""
        return ""

    def met(self, now: Mapping[str, float]) -> bool:
        """Return whether it stands at a wait whose input has the wanted value."""
        halt = self.halt
        return halt is not None and halt.kind == "wait" and now.get(halt.name) == halt.value

    @property
    def rests(self) -> bool:
        """Whether the sent rows end at the rest that ``to_rest`` asks for."""
        return self.to_rest and self.place >= self._end_of_path()

    def pass_halt(self) -> None:
        """Go on after the present stop or wait."""
        self._window.pass_halt()

    def place_at(self, tick: int) -> float:
        """Return the place of the run at a tick that is still kept."""
        return float(self._places[min(max(tick - self._first, 0), len(self._places) - 1)])

    def forget(self, tick: int) -> None:
        """Delete everything before ``tick``, except the few ticks that braking needs."""
        forgotten = tick - _PAST_TICKS - self._first
        if forgotten > 0:
            forgotten = min(forgotten, len(self._places) - 1)
            self._places = self._places[forgotten:].copy()
            self._first += forgotten
            self._window.forget(float(self._places[0]) - _PAST_TICKS)
            self._sent_events = [given for given in self._sent_events if given[0] >= self._first]

    # --- sending ---------------------------------------------------------------------------

    def extend(self, until: int) -> Message:
        """Return the refill with the rows up to tick ``until`` and a braking tail after them."""
        begin, self._before_cut = self.end, None
        change_rows = most_changed(self._gently) if self.rate != self._rate else 0
        self._window.reach(self.place + (until - begin) + max(change_rows, MOST_PLACES))
        stop = float(self._end_of_path())
        places: list[float] = []
        place = self.place
        for tick in range(begin + 1, until + 1):
            if place >= stop:
                break
            place = self._following(tick, place, stop)
            places.append(place)
        self._places = np.concatenate([self._places, places])
        tail = np.empty(0) if self.place >= stop else self._brake()
        return self._refill(begin, tail, self._override_event(begin))

    def _following(self, tick: int, place: float, stop: float) -> float:
        """Return the place at ``tick`` after ``place``, at most ``stop``; begin a change of rate.

        At a constant rate the place is computed from the place and tick at which that rate began: a
        sum of steps would add up their rounding.
        """
        if not len(self._on_the_way) and self._rate != self.rate:
            rates, self._rate = (self._rate, self.rate), self.rate
            self._on_the_way = change_rate(self._window, place, rates, self._limits, self._gently)
        if len(self._on_the_way):
            following, self._on_the_way = float(self._on_the_way[0]), self._on_the_way[1:]
            if not len(self._on_the_way):
                self._line = tick, following
        else:
            line_tick, line_place = self._line
            following = line_place + self._rate * (tick - line_tick)
        if following >= stop:
            self._on_the_way, self._line = np.empty(0), (tick, stop)
        return min(following, stop)

    def _override_event(self, begin: int) -> list[Event]:
        """Return the event of a change of rate that the rows from ``begin`` on begin."""
        if self._rate == self._overrides[-1][1]:
            return []
        self._overrides.append((begin, self._rate))
        operation = int(self._window.operations(np.array([self.place_at(begin)]))[0])
        event = Event(
            tick=begin, kind="override", operation=operation,
            name=feed_words(round(100.0 * self._rate)), value=self._rate,
        )  # fmt: skip
        return [event]

    def cut(self, tick: int) -> Message:
        """Return the refill that brakes along the path from ``tick`` on."""
        tick = min(max(tick, self._first), self.end)
        rates = self._rate, self._on_the_way, self._line, self._overrides
        self._before_cut = (self._first, self._places, self._sent_events, rates)
        self._places = self._places[: tick - self._first + 1]
        events_put_back = [event for event_tick, event in self._sent_events if event_tick >= tick]
        self._sent_events = [given for given in self._sent_events if given[0] < tick]
        self._overrides = [change for change in self._overrides if change[0] < tick]
        self._window.put_back(events_put_back)
        braking_places = self._brake(self._held_ticks if self.gently else 0.0)
        self._places = np.concatenate([self._places, braking_places])
        self._rate, self._on_the_way = self.rate, np.empty(0)  # from the next start on
        self._line = self.end, self.place
        return self._refill(tick, np.empty(0))

    def undo(self) -> bool:
        """Undo the last cut, which the machine refused; return whether there was one."""
        if self._before_cut is None:
            return False
        self._first, self._places, sent_events, rates = self._before_cut
        self._rate, self._on_the_way, self._line, self._overrides = rates
        self._before_cut = None
        self._window.take_events(self.place)  # events that the cut had put back
        self._sent_events = sent_events
        return True

    def rest_until(self, tick: int) -> None:
        """Extend the rest of the run to ``tick``."""
        rest_places = np.full(max(tick - self.end, 0), self.place)
        self._places = np.concatenate([self._places, rest_places])
        if len(rest_places):
            self._line = self.end, self.place

    def start_again(self) -> None:
        """Start from rest: the rate rises from 0 to the rate of the run over the next rows."""
        gently = self._held_ticks if self.gently else 0.0
        self._window.reach(self.place + most_changed(gently))
        self._rate, rates = self.rate, (0.0, self.rate)
        self._on_the_way = change_rate(self._window, self.place, rates, self._limits, gently)

    def _end_of_path(self) -> int:
        """Return the place at which rows end: the next stop, wait or wanted rest, or the end."""
        last = self._window.reach(self.place)
        halt = self._window.halt()
        rest = self._window.next_rest(self.place) if self.to_rest else None
        ends = [last if rest is None else rest, last if halt is None else halt.tick]
        return min(last, *ends)

    def _brake(self, gently: float = 0.0) -> FloatArray:
        end_tick = self.end
        last_places = (self.place_at(end_tick - 2), self.place_at(end_tick - 1), self.place)
        stop = float(self._end_of_path())
        return np.minimum(brake(self._window, last_places, self._limits, gently), stop)

    def _refill(self, begin: int, tail: FloatArray, events: Sequence[Event] = ()) -> Message:
        places = np.concatenate([self._places[begin - self._first :], tail])
        row_count = self.end - begin
        positions = self._window.counts(places)
        at_counts = np.rint(positions).astype(np.int64)
        counts = at_counts[1:] - at_counts[:-1]
        self._check(positions + self.start, counts)
        head = {
            "first": begin,
            "wanted": row_count,
            "last": self.complete,
            "events": [event_row(event) for event in (*events, *self._events(begin))],
        }
        arrays = {
            "at": at_counts[0], "counts": counts, "operation": self._window.operations(places[:-1]),
            "place": places[1:],
        }  # fmt: skip
        return Message("refill", head, arrays)

    def _events(self, begin: int) -> list[Event]:
        """Return the events due at the ticks from ``begin`` on; each is sent once."""
        events: list[Event] = []
        for due in self._window.take_events(self.place):
            row = np.searchsorted(self._places, due.tick) + self._first
            tick = max(int(row), begin)
            self._sent_events.append((tick, due))
            events.append(replace(due, tick=tick))
        return events

    def _check(self, positions: FloatArray, counts: IntArray) -> None:
        """Refuse rows beyond the travel or the speed of an axis.

        Parameters
        ----------
        stands
            (n + 1, axes) positions before, between and after the rows, in counts, not rounded.
        counts
            (n, axes) the rows.

        Raises
        ------
        LimitError
            If a row exceeds a limit; the error names the axis, and the rows are not sent.
        """
        limits = self._limits
        if not _breaks(positions, counts, limits.velocity, limits.low, limits.high):
            return
        names = self._machine.axis_names
        scale = self._machine.counts_per_unit
        tick_s = float(self._machine.tick_clock.period_s)
        for k, name in enumerate(names):
            fastest = float(np.abs(counts[:, k]).max(initial=0.0))
            if fastest > limits.velocity[k] + _LIMIT_COUNTS:
                to_si = 1.0 / (scale[k] * tick_s)
                raise LimitError(
                    f"axis {name}: a row asks for {fastest:.0f} counts in a tick, the limit is "
                    f"{limits.velocity[k]:.0f}",
                    axis=name,
                    quantity="velocity",
                    value_si=fastest * to_si,
                    limit_si=float(limits.velocity[k] * to_si),
                    remedy="Let the job be slower, or prove it with another interpolation.",
                )
            low, high = float(positions[:, k].min()), float(positions[:, k].max())
            below = low < limits.low[k] - _LIMIT_COUNTS
            if below or high > limits.high[k] + _LIMIT_COUNTS:
                position_si = (low if below else high) / scale[k]
                end_si = float((limits.low if below else limits.high)[k] / scale[k])
                raise LimitError(
                    f"axis {name}: a row goes to {position_si:.4g}, beyond its travel, which ends "
                    f"at {end_si:.4g}",
                    axis=name,
                    quantity="position",
                    value_si=float(position_si),
                    limit_si=end_si,
                    remedy="Move the job, or the position where it starts.",
                )


@njit()
def _breaks(
    stands: FloatArray, counts: IntArray, velocity: FloatArray, low: FloatArray, high: FloatArray
) -> bool:
    """Return whether a row is faster than ``velocity`` or goes beyond ``low`` or ``high``."""
    for k in range(counts.shape[1]):
        for i in range(len(counts)):
            if abs(counts[i, k]) > velocity[k] + _LIMIT_COUNTS:
                return True
        for i in range(len(stands)):
            position = stands[i, k]
            if position < low[k] - _LIMIT_COUNTS or position > high[k] + _LIMIT_COUNTS:
                return True
    return False


def ticks_in(duration_s: float, machine: Machine) -> int:
    """Return the number of ticks in a duration, rounded up, at least 1."""
    return max(1, ceil(duration_s / float(machine.command_clock.period_s) - 1e-9))


def halts_of_rows(commands: Commands) -> Iterator[Event]:
    """Yield the stops and waits of a table; reads it twice. A stop at its end does not count."""
    table = tick_table(commands)
    rows = table.tick_count()
    for block in table:
        for event in block.events:
            if event.kind == "wait" or (event.kind == "stop" and event.tick < rows):
                yield event


def refuse_start_elsewhere(machine: Machine, stands: IntArray, starts: IntArray) -> None:
    """Refuse a run that does not begin at the present position of the machine.

    Raises
    ------
    CommandError
        If an axis stands elsewhere; the error names the first such axis and both positions.
    """
    scale, names = machine.counts_per_unit, machine.axis_names
    for k, (position, start) in enumerate(zip(stands, starts, strict=True)):
        if position != start:
            raise CommandError(
                f"axis {names[k]} stands at {place_words(machine, names[k], position / scale[k])}, "
                f"the run begins at {place_words(machine, names[k], start / scale[k])}",
                remedy="Home the machine, or move it there.",
            )
