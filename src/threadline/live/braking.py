"""Brake along the path, start again on it and change its rate, within the limits of every axis.

The *rate* of a run is the number of rows of its table per tick, 1 in normal running. To brake, the
rate falls to 0 along a smooth curve, so that the axes slow down together and stay on the path. To
start again, it rises along the mirrored curve. A feed override changes the rate along the same
curve, but slowly, so that loads do not swing. A change to the rate 1 ends on a whole row, so that
all later rows are rows of the table.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, floor
from typing import Protocol

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.base.compiled import njit
from threadline.dynamics.analysis import fastest
from threadline.machine import Machine

GENTLE_HOLD_S = 0.5
"""Duration of the braking and of the restart of a gentle hold, s: loops catch up their lag in
it."""
_DURATIONS = (1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 11.0, 16.0, 22.0, 32.0, 45.0, 64.0, 90.0, 128.0, 256.0)
"""Braking durations in ticks to try in turn; the first one that keeps every limit is used."""
MOST_PLACES = ceil(_DURATIONS[-1]) + 2
"""Number of rows that braking or starting may read beyond the row at which it begins."""
_LANDS = 200
"""Most ticks by which a change to the rate 1, from a rate of at most 0.99, is made longer so that
it ends on a whole row."""
_LONGER = (1.0, 2.0, 4.0)
"""Durations of a gentle change of the rate to try in turn, as multiples of the shortest one."""
_ROUNDED = (0.5, 1.0, 2.0, 4.0)
"""Largest error, in counts, that rounding to whole counts causes in a position and in its first,
second and third difference (velocity, acceleration and jerk)."""


class Path(Protocol):
    """Positions of the axes as a function of the place: a row of the table, with a fraction."""

    def counts(self, places: FloatArray) -> FloatArray:
        """Return (n, axes) counts at (n,) places."""


@dataclass(frozen=True, slots=True, eq=False)
class CountLimits:
    """Limits of the axes in counts and ticks.

    Parameters
    ----------
    velocity, acceleration, jerk
        (axes,) counts per tick, per tick^2, per tick^3; infinite without a limit.
    low, high
        (axes,) counts from the position zero; infinite for an endless axis.
    """

    velocity: FloatArray
    acceleration: FloatArray
    jerk: FloatArray
    low: FloatArray
    high: FloatArray

    @classmethod
    def of(cls, machine: Machine, *, loads_follow: bool = False) -> CountLimits:
        """Return the limits of a machine.

        Parameters
        ----------
        loads_follow
            Whether rows are motor commands that make the loads follow (feed-forward). Then the
            axes' limits apply to the loads, and the plan keeps them; the motors, which lead
            through belts and loop lag, may move more, up to their own top speed.
        """
        tick_s = float(machine.tick_clock.period_s)
        scale = machine.counts_per_unit
        axes = machine.axes.values()
        jerk = np.array([np.inf if axis.jerk is None else axis.jerk.si for axis in axes])
        low = [-np.inf if axis.travel is None else axis.travel[0].si for axis in axes]
        high = [np.inf if axis.travel is None else axis.travel[1].si for axis in axes]
        return cls(
            velocity=_velocity(machine, loads_follow=loads_follow) * scale * tick_s,
            acceleration=machine.acceleration_limit * scale * tick_s**2,
            jerk=jerk * scale * tick_s**3,
            low=np.array(low) * scale,
            high=np.array(high) * scale,
        )

    def excess(self, counts: FloatArray, own: FloatArray) -> float:
        """Return the largest ratio of a motion to its limits: at most 1 if it keeps them.

        Parameters
        ----------
        counts
            (n, axes) positions at consecutive ticks.
        own
            (m, axes) positions of the table from which the motion is made. If the table itself
            exceeds a limit, as with historical interpolations, its own peak is the limit.
        """
        return float(_excess(counts, own, self.velocity, self.acceleration, self.jerk))


@njit()
def _excess(
    counts: FloatArray,
    own: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    jerk: FloatArray,
) -> float:
    """Return the largest ratio of the differences of ``counts`` to the limits or to ``own``'s.

    It is compiled because it runs at every refill, on some 260 rows.
    """
    worst = 0.0
    for k in range(counts.shape[1]):
        reached, planned = np.zeros(4), np.zeros(4)
        for values, largest in ((counts, reached), (own, planned)):
            last_difference, last_second_difference = 0.0, 0.0
            for i in range(1, len(values)):
                difference = values[i, k] - values[i - 1, k]
                largest[1] = max(largest[1], abs(difference))
                if i > 1:
                    second_difference = difference - last_difference
                    largest[2] = max(largest[2], abs(second_difference))
                    if i > 2:  # the third difference needs four values
                        largest[3] = max(
                            largest[3], abs(second_difference - last_second_difference)
                        )
                    last_second_difference = second_difference
                last_difference = difference
        for order, limit in enumerate((velocity[k], acceleration[k], jerk[k]), 1):
            worst = max(worst, reached[order] / (max(limit, planned[order]) + _ROUNDED[order]))
    return worst


def _velocity(machine: Machine, *, loads_follow: bool) -> FloatArray:
    """Return the (axes,) largest speeds of rows, m/s or rad/s."""
    limits = machine.velocity_limit.copy()
    if loads_follow:
        motors = [fastest(machine, axis) or 0.0 for axis in machine.axes]
        limits = np.maximum(limits, motors)
    return limits


def _fallen(share: FloatArray) -> FloatArray:
    """Return the distance after a share of the time while the rate falls from 1 to 0 in time 1.

    It is the integral of 1 - 3 u^2 + 2 u^3, which begins and ends with slope 0; the whole is 1/2.
    """
    return np.asarray(share - share**3 + 0.5 * share**4)


def _risen(share: FloatArray) -> FloatArray:
    """Return the distance after a share of the time while the rate rises from 0 to 1 in time 1."""
    return np.asarray(share**3 - 0.5 * share**4)


_FALLS = {
    ticks: _fallen(np.minimum(np.arange(1, ceil(ticks) + 1) / ticks, 1.0)) for ticks in _DURATIONS
}


def _fall(previous: float, place: float, ticks: float) -> FloatArray:
    """Return the places at the ticks after ``place`` while the rate falls to 0 in ``ticks``.

    ``ticks`` is one of ``_DURATIONS``.
    """
    rate = place - previous
    return np.asarray(place + rate * ticks * _FALLS[ticks])


def gentle_hold_ticks(tick_s: float) -> float:
    """Return the shortest braking of a gentle hold in ticks: about ``GENTLE_HOLD_S``."""
    return next((ticks for ticks in _DURATIONS if ticks * tick_s >= GENTLE_HOLD_S), _DURATIONS[-1])


def brake(
    path: Path, before: tuple[float, float, float], limits: CountLimits, gently: float = 0.0
) -> FloatArray:
    """Return the (n,) places at the next ticks for braking to rest along the path.

    Parameters
    ----------
    path
        The path, known for ``MOST_PLACES`` beyond the present place, or to its end.
    before
        Places two ticks ago, one tick ago, and now.
    limits
        Limits of the axes. If no duration keeps them, the duration that exceeds them least is used.
    gently
        Shortest duration, in ticks, at most ``gentle_hold_ticks``; 0 for as short as the limits
        allow.
    """
    second_last, previous, now = before
    if now <= previous:
        return np.empty(0)
    best_places, least_excess = np.empty(0), np.inf
    path_counts = path.counts(
        np.arange(floor(second_last), floor(now) + MOST_PLACES, dtype=np.float64)
    )
    for ticks in (one for one in _DURATIONS if one >= gently):
        places = _fall(previous, now, ticks)
        # Two ticks of rest after it: the jerk of stopping counts, too.
        all_places = np.concatenate([before, places, places[-1:], places[-1:]])
        excess = limits.excess(path.counts(all_places), path_counts)
        if excess < least_excess:
            best_places, least_excess = places, excess
        if excess <= 1.0:
            break
    return best_places


def rise(path: Path, place: float, limits: CountLimits, gently: float = 0.0) -> FloatArray:
    """Return the (n,) places at the next ticks for starting again from rest, up to the rate 1.

    Parameters
    ----------
    path
        The path, known for ``most_changed`` beyond ``place``, or to its end.
    place
        Place at which the run rests.
    limits
        Limits of the axes, as for ``brake``.
    gently
        Shortest duration, in ticks.
    """
    return change_rate(path, place, (0.0, 1.0), limits, gently)


def most_changed(gently: float) -> int:
    """Return the number of rows that a change of the rate may read beyond its first row."""
    return ceil(_LONGER[-1] * gently) + _LANDS + 2 if gently else MOST_PLACES


def change_rate(
    path: Path, place: float, rates: tuple[float, float], limits: CountLimits, gently: float = 0.0
) -> FloatArray:
    """Return the (n,) places at the next ticks while the rate changes; n is at least 1.

    If the new rate is 1, the last place is a whole number; after it one row of the table is played
    at each tick.

    Parameters
    ----------
    path
        The path, known for ``most_changed`` beyond ``place``, or to its end.
    place
        Place at which the change begins.
    rates
        The old rate (0 at rest, else 0.1 to 1) and the new rate (above 0). A rate below 1 is at
        most 0.99.
    limits
        Limits of the axes, as for ``brake``.
    gently
        Shortest duration, in ticks; 0 for as short as the limits allow.
    """
    rate_before, rate_after = rates
    best_places, least_excess = np.empty(0), np.inf
    arriving = place - rate_before * np.arange(2.0, -1.0, -1.0)
    last = floor(place) + most_changed(gently) + 2
    path_counts = path.counts(np.arange(floor(arriving[0]), last, dtype=np.float64))
    for duration in [gently * factor for factor in _LONGER] if gently else _DURATIONS:
        ticks = _landing(place, rate_before, duration) if rate_after == 1.0 else duration
        k = np.arange(1, ceil(ticks) + 1)
        elapsed = np.minimum(k, ticks)
        places = np.asarray(
            place
            + rate_before * elapsed
            + (rate_after - rate_before) * ticks * _risen(elapsed / ticks)
            + rate_after * np.maximum(k - ticks, 0.0)
        )
        all_places = np.concatenate([arriving, places, places[-1] + rate_after * np.arange(1, 4)])
        excess = limits.excess(path.counts(all_places), path_counts)
        if excess < least_excess:
            best_places, least_excess = places, excess
        if excess <= 1.0:
            break
    return (
        np.concatenate([best_places[:-1], np.rint(best_places[-1:])])
        if rate_after == 1.0
        else best_places
    )


def _landing(place: float, rate_before: float, duration: float) -> float:
    """Return a duration of at least ``duration`` ticks, so that the rate 1 begins on a whole row.

    A change in T ticks is T (1 - before) / 2 rows shorter than T ticks at the rate 1.
    """
    row = 2.0 / (1.0 - rate_before)  # ticks that lose a row
    over_row = row * (place - floor(place))
    return over_row + row * max(ceil((duration - over_row) / row), 0 if over_row else 1)
