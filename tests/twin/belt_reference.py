"""A motor that drives a head through a belt, integrated by scipy between exact instants.

The numbers are those of ``BELT_AXIS``; nothing here uses the package's equations of the machine.
The controller is written out, too, with and without its quantisers.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np
from scipy.integrate import solve_ivp

from tests.dop853 import state_after

J, M, BM, BH, RP, K, C = 2e-4, 1.5, 1e-3, 4.0, 0.012, 2e4, 15.0
KT = KE = 0.1
R = 0.5
TICK = Fraction(2, 1000)
ROWS = np.concatenate((np.full(40, 25), np.full(40, -35), np.zeros(60, dtype=int)))
COUNT_M = RP / 500


def closed_loop(
    advance, *, tick=TICK, delay=Fraction(0), rows=ROWS, state=4, settle=10, quantised=False
):
    """Return the (n, state) states at the ticks: PD, DAC clamped, inputs delayed.

    With quantisers the encoder, which rests between two counts, gives whole counts, and the DAC
    gets the nearest whole level.
    """
    x = np.zeros(state)
    error_before, reference, now = 0.0, 0.0, Fraction(0)
    arrivals: list[tuple[Fraction, float]] = []
    volts, states = 0.0, []
    for row in np.concatenate((rows, np.zeros(settle, dtype=int))):
        states.append(x)
        read = np.floor(500 * x[0] + 0.5) if quantised else 500 * x[0]
        error = reference - read
        level = 3 * error + 6 * (error - error_before)
        level = np.clip(np.rint(level) if quantised else level, -2048, 2047)
        error_before = error
        arrivals.append((now + delay, level * 20 / 4096))
        end = now + tick
        while now < end:
            while arrivals and arrivals[0][0] <= now:
                volts = arrivals.pop(0)[1]
            until = min([end, *(at for at, _ in arrivals[:1])])
            x = advance(x, volts, float(until - now))
            now = until
        reference += row
    return np.array(states)


def integrate(slope, x, span, events=()):
    return solve_ivp(slope, (0, span), x, "DOP853", rtol=1e-12, atol=1e-14, events=events)


def amperes(limit=None):
    """Return the current as a function of volts and speed, clipped at a limit if there is one."""
    most = np.inf if limit is None else limit
    return lambda volts, w: min(most, max(-most, (volts - KE * w) / R))


UNLIMITED = amperes()


def amplifier(limit):
    """Return the line of an amplifier with that limit, none when None."""
    more = "" if limit is None else f', current_limit = "{limit} A exact, assumed"'
    return f'amplifier = {{ mode = "voltage", gain = "1 exact, assumed"{more} }}'


def smooth(force, current=UNLIMITED):
    """Return an advance for a belt whose force is continuous in stretch and rate."""

    def advance(x, volts, span):
        def slope(_t, y):
            th, pos, w, v = y.tolist()
            pull = force(RP * th - pos, RP * w - v)
            return [w, v, (KT * current(volts, w) - BM * w - RP * pull) / J, (pull - BH * v) / M]

        return state_after(slope, x, span, rtol=1e-12, atol=1e-14)

    return advance


def linear(s, r):
    return K * s + C * r
