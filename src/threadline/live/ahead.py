"""What an executor has sent ahead: where the run is at each tick, and the rows made of it."""

from __future__ import annotations

from dataclasses import replace
from math import ceil

import numpy as np

from threadline.arrays import FloatArray
from threadline.errors import LimitError
from threadline.live.braking import MOST_PLACES, CountLimits, brake, rise
from threadline.live.path_window import PathWindow
from threadline.live.wire import Message, event_told
from threadline.machine import Machine
from threadline.signals import Event, TickTable

_KEPT = 4  # ticks that are remembered behind the machine
_LIMIT_COUNTS = 2.0
"""What rounding to whole counts adds to a row: one at either end."""


class Ahead:
    """The run as far as it has been sent, as places along the table at the ticks of the machine.

    Parameters
    ----------
    table
        What is run.
    machine
        Whose limits every row keeps.
    pass_stops
        Whether stops of the program halt nothing.

    Attributes
    ----------
    to_rest
        Whether the rows end at the next rest of the program: a hold that may not leave the path.
    """

    def __init__(self, table: TickTable, machine: Machine, *, pass_stops: bool = False) -> None:
        self._window = PathWindow(table, pass_stops=pass_stops)
        self._machine, self._limits = machine, CountLimits.of(machine)
        self._start = table.start_counts
        self._first = 0  # tick of the first place that is kept
        self._places = np.zeros(1)  # at the ticks from there on
        self._rising: FloatArray = np.empty(0)  # places on the way back to the full rate
        self._given: list[tuple[int, Event]] = []  # events that were sent, and for which tick
        self._window.reach(MOST_PLACES)
        self.to_rest = False
        self._before_cut: tuple[FloatArray, FloatArray, list[tuple[int, Event]]] | None = None

    @property
    def end(self) -> int:
        """The tick up to which rows have been sent that are wanted."""
        return self._first + len(self._places) - 1

    @property
    def place(self) -> float:
        """Where the run is then."""
        return float(self._places[-1])

    @property
    def complete(self) -> bool:
        """Whether the last row has been sent."""
        return self._window.at_end and self.place >= self._window.reach(self.place)

    @property
    def halt(self) -> Event | None:
        """The stop or wait at which the rows that were sent end, None where there is none."""
        halt = self._window.halt()
        return halt if halt is not None and self.place >= halt.tick else None

    @property
    def rests(self) -> bool:
        """Whether the rows that were sent end at the rest that was asked for."""
        return self.to_rest and self.place >= self._end_of_path()

    def pass_halt(self) -> None:
        """Let the run go on after the stop or wait at which it stands."""
        self._window.pass_halt()

    def place_at(self, tick: int) -> float:
        """Return where the run is at a tick that has been sent and is not long past."""
        return float(self._places[np.clip(tick - self._first, 0, len(self._places) - 1)])

    def forget(self, tick: int) -> None:
        """Keep nothing of what is before ``tick``, but for what braking has to know."""
        gone = tick - _KEPT - self._first
        if gone > 0:
            gone = min(gone, len(self._places) - 1)
            self._places = self._places[gone:].copy()
            self._first += gone
            self._window.forget(float(self._places[0]) - _KEPT)
            self._given = [given for given in self._given if given[0] >= self._first]

    # --- what is sent ----------------------------------------------------------------------

    def extend(self, until: int) -> Message:
        """Return the refill with the rows up to tick ``until``, and the tail that follows them."""
        begin, self._before_cut = self.end, None
        self._window.reach(self.place + (until - begin) + MOST_PLACES)
        stop = float(self._end_of_path())
        added: list[float] = []
        place = self.place
        for _ in range(begin, until):
            if len(self._rising):
                following, self._rising = float(self._rising[0]), self._rising[1:]
            else:
                following = place + 1.0
            if place >= stop:
                break
            place = min(following, stop)
            added.append(place)
        self._places = np.concatenate([self._places, added])
        tail = np.empty(0) if self.place >= stop else self._brake()
        return self._refill(begin, tail)

    def cut(self, tick: int) -> Message:
        """Return the refill that comes to rest along the path, from ``tick`` on."""
        tick = min(max(tick, self._first), self.end)
        self._before_cut = (self._places, self._rising, self._given)
        self._places = self._places[: tick - self._first + 1]
        self._rising = np.empty(0)
        back = [event for at, event in self._given if at >= tick]
        self._given = [given for given in self._given if given[0] < tick]
        self._window.put_back(back)
        self._places = np.concatenate([self._places, self._brake()])
        return self._refill(tick, np.empty(0))

    def undo(self) -> bool:
        """Take back the last cut, which was refused; say whether there was one."""
        if self._before_cut is None:
            return False
        self._places, self._rising, given = self._before_cut
        self._before_cut = None
        self._window.take_events(self.place)  # those that the cut had put back
        self._given = given
        return True

    def rest_until(self, tick: int) -> None:
        """Stand until ``tick``, and go on from there."""
        still = np.full(max(tick - self.end, 0), self.place)
        self._places = np.concatenate([self._places, still])

    def start_again(self) -> None:
        """Let the rate rise from 0 to 1 with the next rows."""
        self._window.reach(self.place + MOST_PLACES)
        self._rising = rise(self._window, self.place, self._limits)

    def _end_of_path(self) -> int:
        """Return the place where rows end for now: a stop, a wait, or the last of them."""
        last = self._window.reach(self.place)
        halt = self._window.halt()
        rest = self._window.next_rest(self.place) if self.to_rest else None
        ends = [last if rest is None else rest, last if halt is None else halt.tick]
        return min(last, *ends)

    def _brake(self) -> FloatArray:
        now = self.end
        before = (self.place_at(now - 2), self.place_at(now - 1), self.place)
        stop = float(self._end_of_path())
        return np.minimum(brake(self._window, before, self._limits), stop)

    def _refill(self, begin: int, tail: FloatArray) -> Message:
        places = np.concatenate([self._places[begin - self._first :], tail])
        wanted = self.end - begin
        at = self._window.rounded(places)
        counts = np.diff(at, axis=0)
        self._check(places, counts)
        head = {
            "first": begin,
            "wanted": wanted,
            "last": self.complete,
            "events": [event_told(event) for event in self._events(begin)],
        }
        arrays = {
            "at": at[0], "counts": counts, "operation": self._window.operations(places[:-1]),
        }  # fmt: skip
        return Message("refill", head, arrays)

    def _events(self, begin: int) -> list[Event]:
        """Return the events that are due at the ticks from ``begin`` on; each is sent once."""
        found: list[Event] = []
        for due in self._window.take_events(self.place):
            at = np.searchsorted(self._places, due.tick) + self._first
            tick = max(int(at), begin)
            self._given.append((tick, due))
            found.append(replace(due, tick=tick))
        return found

    def _check(self, places: FloatArray, counts: FloatArray) -> None:
        """Refuse rows beyond travel or speed, whatever they come from.

        Raises
        ------
        LimitError
            Naming the axis; nothing was sent then.
        """
        limits, names = self._limits, self._machine.axis_names
        stands = self._window.counts(places) + self._start
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
                    remedy="Lower the feed, or prove the job with another interpolation.",
                )
            low, high = float(stands[:, k].min()), float(stands[:, k].max())
            beyond = low < limits.low[k] - _LIMIT_COUNTS
            if beyond or high > limits.high[k] + _LIMIT_COUNTS:
                goes = (low if beyond else high) / scale[k]
                ends = float((limits.low if beyond else limits.high)[k] / scale[k])
                raise LimitError(
                    f"axis {name}: a row goes to {goes:.4g}, beyond its travel, which ends at "
                    f"{ends:.4g}",
                    axis=name,
                    quantity="position",
                    value_si=float(goes),
                    limit_si=ends,
                    remedy="Move the job, or the position where it starts.",
                )


def ticks_in(duration_s: float, machine: Machine) -> int:
    """Return the ticks of a machine that a duration has, at least 1."""
    return max(1, ceil(duration_s / float(machine.tick_clock.period_s) - 1e-9))
