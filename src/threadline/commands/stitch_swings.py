"""The swing of an embroidery frame turn by turn, on machines all over a band of modes, with slopes.

The swing at the end of a move is interpolated between turn times that are 0.1 % apart. The slopes
are the derivatives of the swing with respect to the time of its turn and of the turn before it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from threadline.base.arrays import ComplexArray, FloatArray, IntArray
from threadline.base.compiled import njit

BEFORE = 40  # turns before a stretch that still swing


class Sums(NamedTuple):
    """Swing at the end of each window, with slopes; n turns, M columns.

    Parameters
    ----------
    swing
        (n, M) swing at the end of the window of each turn, m.
    decay
        (n, M) factor on the swing from the end of the window before to the end of this window.
    own, last
        (n, M) derivative of the swing with respect to this turn and to the turn before, m/s.
    """

    swing: ComplexArray
    decay: ComplexArray
    own: ComplexArray
    last: ComplexArray


class Swung(NamedTuple):
    """The swinging modes; M columns, each a mode of an axis of a machine; G groups, A axes.

    The columns of a group are the modes of one axis of one machine; their amplitudes add up.

    Parameters
    ----------
    poles
        (M,) decay and frequency, rad/s.
    axis
        (M,) axis of each column.
    begin
        (G + 1,) first column of each group.
    row
        (G,) row of each group: the groups of one axis and one damping, in order of frequency.
    log_s
        (2,) logarithm of the first turn time of ``fresh``, and its step.
    fresh
        (N, M) swing at the end of a move of 1 m.
    late
        Time from the end of a window until the needle enters, in turns.
    """

    poles: ComplexArray
    axis: IntArray
    begin: IntArray
    row: IntArray
    log_s: FloatArray
    fresh: ComplexArray
    late: float


class Limits(NamedTuple):
    """The moves of a schedule and its limits; n turns, A axes.

    Parameters
    ----------
    travels_m, needle, shortest_s
        As in ``TurnMoves``.
    slowest_s
        Longest time of a turn, s.
    share
        Share of the window in a turn.
    change
        Largest change of the square of the speed from turn to turn, 1/s^2.
    tolerance_m
        Largest swing of an axis when the needle enters, m.
    """

    travels_m: FloatArray
    needle: IntArray
    shortest_s: FloatArray
    slowest_s: float
    share: float
    change: float
    tolerance_m: float


def swings_before(first: int, turns: FloatArray, limits: Limits, swung: Swung) -> ComplexArray:
    """Return (M,) the swing at the end of the window before turn ``first``, m; 0 before any."""
    if first == 0:
        return np.zeros(len(swung.poles), dtype=np.complex128)
    return np.asarray(swings_of(max(0, first - BEFORE), first, turns, limits, swung).swing[-1])


def amplitudes(swing: ComplexArray, turn_s: FloatArray, swung: Swung) -> FloatArray:
    """Return (n, G) amplitude of each group when the needle enters, m."""
    late = np.exp(-swung.late * np.outer(turn_s, swung.poles.real))
    return np.add.reduceat(np.abs(swing) * late, swung.begin[:-1], axis=1)


def _swings_of(before: int, end: int, turns: FloatArray, limits: Limits, swung: Swung) -> Sums:
    """Return the swings and slopes of turns ``before`` to ``end``; nothing swings before them."""
    axis, poles, log_s, fresh = swung.axis, swung.poles, swung.log_s, swung.fresh
    travels_m, share = limits.travels_m, limits.share
    count, columns = end - before, len(poles)
    swing = np.zeros((count, columns), np.complex128)
    decay = np.zeros((count, columns), np.complex128)
    own = np.zeros((count, columns), np.complex128)
    last = np.zeros((count, columns), np.complex128)
    for q in range(count):
        k = before + q
        place = (np.log(turns[k]) - log_s[0]) / log_s[1]
        i = min(max(int(place), 0), len(fresh) - 2)
        part = place - i
        time, by_own, by_last = 0.0, 0.0, 0.0
        if q > 0:
            a, b = 1.0 / turns[k - 1], 1.0 / turns[k]
            pair = 2.0 * (1.0 - share) / (a + b)
            time = pair + share * turns[k]
            by_own = share + pair / (a + b) * b * b
            by_last = pair / (a + b) * a * a
        for m in range(columns):
            way = travels_m[k, axis[m]]
            rise = fresh[i + 1, m] - fresh[i, m]
            value = way * (fresh[i, m] + part * rise)
            slope = way * rise / (log_s[1] * turns[k])
            if q > 0:
                decay[q, m] = np.exp(-poles[m] * time)
                carried = swing[q - 1, m] * decay[q, m]
                value += carried
                slope -= poles[m] * carried * by_own
                last[q, m] = -poles[m] * carried * by_last
            swing[q, m] = value
            own[q, m] = slope
    return Sums(swing, decay, own, last)


swings_of = njit(nogil=True)(_swings_of)
