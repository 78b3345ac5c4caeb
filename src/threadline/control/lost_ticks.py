"""Voltages for a DAC that puts out nothing at the first tick after a change of their sign.

Such a DAC loses the voltage of one tick at each change of sign. Where the voltage passes through 0
between two ticks, the phase of the encoder decides which of the two ticks is lost, so that the
motion differs from run to run. ``Levels`` decides it beforehand: the tick with the smaller voltage
is the lost one. That tick is given the new sign and a magnitude as large as its neighbours', so
that noise of the sensor cannot move the change of sign. Each neighbour receives half of the lost
voltage, which leaves the sum of the voltages and their first moment as they were
(decision 14).
"""
# mypy: disable-error-code="no-untyped-def,untyped-decorator"

from __future__ import annotations

import numpy as np

from threadline.arrays import FloatArray
from threadline.compiled import njit

AHEAD = 3
"""Number of voltages after a tick on which its level depends."""
_NOISE_COUNTS = 2.0
_LEAST = 0.5  # share of its level that a tick beside a lost one keeps at least


class Levels:
    """Turns the voltages that a plant needs into the levels that its controller has to put out.

    Levels are in volts, too.

    Parameters
    ----------
    numerator
        (n,) numerator of the controller's filter, in volts per count: the sum of its magnitudes is
        the change of output that one count of the sensor can make.
    skips
        Whether the DAC puts out nothing at the first tick after a change of sign; otherwise the
        levels equal the voltages.
    """

    def __init__(self, numerator: FloatArray, *, skips: bool) -> None:
        self._skips = skips
        self._band = _NOISE_COUNTS * float(np.abs(numerator).sum())
        self._volts: FloatArray = np.zeros(0)
        # The level of the tick before ``_volts``, and what is added to the level of the next one.
        self._level = np.zeros(2)
        self._sign = 0.0
        self._begun = False

    def feed(self, volts: FloatArray) -> FloatArray:
        """Return the next levels for the next (k,) voltages; the last ``AHEAD`` of them wait."""
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


@njit()
def _levels(volts, held, sign, band):
    """Return the levels of the tick before ``volts`` and of all but their last three, and a sign.

    Parameters
    ----------
    volts
        (k,) voltages that the plant needs.
    held
        (2,) the level of the tick before ``volts``, and what is added to the level of the first of
        them; both are overwritten with those of the next call.
    sign
        Sign of the output at the tick before ``volts``. The sign that is returned is that of the
        last tick whose level is returned or held.
    band
        Smallest magnitude of a level, in volts: noise of the sensor can change the sign of a
        smaller one.
    """
    count = len(volts) - 2
    out = np.empty(count)
    before, given = held[0], held[1]
    for k in range(count):
        now, after = volts[k], volts[k + 1]
        level = now + given
        given = 0.0
        away = sign * now < 0.0
        # The tick before a reversal may have less to lose. Where the sign changes for one tick
        # alone, either that tick is lost, or the tick before it and the tick after it are.
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


@njit()
def _kept(level, change):
    """Return ``change``, cut so that at least half of ``level`` is left with its sign."""
    if level * change >= 0.0:
        return change
    return -np.sign(level) * min(abs(change), _LEAST * abs(level))
