"""Volts for a DAC whose first tick after a reversal of its sign puts out nothing.

The rule takes the tick at which the sign changes, whatever it was to put out, and of two ticks that
is the later one or the earlier as an encoder's phase has it: what is lost differs from run to run.
Here the tick that is lost is chosen, the one with less to lose; its level is put as far on the new
side as its neighbours are from 0, so that noise does not decide. Half of what is lost is given to
either neighbour, so that neither the sum of the volts nor their first moment changes.
"""
# mypy: disable-error-code="no-untyped-def,untyped-decorator"

from __future__ import annotations

import numpy as np
from numba import njit

from threadline.arrays import FloatArray

AHEAD = 3
"""So many volts after a tick are looked at before its level is certain."""
_NOISE_COUNTS = 2.0
_LEAST = 0.5  # of a level is left beside a tick that is lost


class Levels:
    """Turns the volts that an axis is to get into the levels that its controller is to ask for.

    Parameters
    ----------
    numerator
        Of the filter that asks for them, volts per count: what its sensor's phase makes of them.
    skips
        Whether the DAC puts out nothing at the first tick after a reversal; else the levels are
        the volts.
    """

    def __init__(self, numerator: FloatArray, *, skips: bool) -> None:
        self._skips = skips
        self._band = _NOISE_COUNTS * float(np.abs(numerator).sum())
        self._volts: FloatArray = np.zeros(0)
        self._level = np.zeros(2)  # of the last tick before them; what is added to the next
        self._sign = 0.0
        self._begun = False

    def feed(self, volts: FloatArray) -> FloatArray:
        """Return the next (k,) levels; the last ``AHEAD`` wait for the volts after them."""
        if not self._skips:
            held = np.concatenate([self._volts, volts])
            self._volts = held[-AHEAD:]
            return np.asarray(held[:-AHEAD])
        held = np.concatenate([self._volts, volts])
        levels, self._sign = _levels(held, self._level, self._sign, self._band)
        self._volts = held[1 - AHEAD :]
        # The first level is that of the tick before: before any tick there is none.
        levels = levels if self._begun else levels[1:]
        self._begun = True
        return np.asarray(levels)


@njit(cache=True)
def _levels(volts, held, sign, band):
    """Return the levels of the tick before ``volts`` and of all but their last three, and a sign.

    Parameters
    ----------
    held
        The level of the tick before, and what is added to that of the next; it is moved on.
    sign
        Of what was put out at the tick before; the same is returned for the last that is certain.
    band
        A smaller level may have either sign, by noise: none is left so small.
    """
    count = len(volts) - 2
    out = np.empty(count)
    before, given = held[0], held[1]
    for k in range(count):
        now, after = volts[k], volts[k + 1]
        level = now + given
        given = 0.0
        away = sign * now < 0.0
        # The tick before a reversal may have less to lose; of a reversal of one tick alone it and
        # the one behind are lost, or that tick.
        back = abs(volts[k + 2]) if after * volts[k + 2] < 0.0 else 0.0
        soon = sign * now > 0.0 and now * after < 0.0 and abs(now) + back < abs(after)
        if away or soon:
            lost = level
            sure = min(abs(before), abs(after))
            level = -sign * max(abs(now) if away else band, sure)
            share = _kept(before, 0.5 * lost)
            before += share
            given = _kept(after, lost - share)
        elif sign * level > 0.0 and abs(level) < band:
            given = level - sign * band
            level = sign * band
        out[k] = before
        sign = 0.0 if away or soon else np.sign(level)
        before = level
    held[0], held[1] = before, given
    return out, sign


@njit(cache=True)
def _kept(level, change):
    """Return how much of a change leaves a level half of itself, so that noise keeps its sign."""
    if level * change >= 0.0:
        return change
    return -np.sign(level) * min(abs(change), _LEAST * abs(level))
