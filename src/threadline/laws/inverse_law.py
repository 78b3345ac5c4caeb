"""The time at which a form has reached a rise, by Newton's method within brackets."""

from __future__ import annotations

import numpy as np

from threadline.arrays import FloatArray
from threadline.laws.forms import Form

_CELLS = 2048
_ENOUGH = 1e-9  # a relative step of Newton's after which its error is about the square of this
_ROUNDS = 120


def invert(form: Form, end: float, rise: FloatArray, *, latest: bool = False) -> FloatArray:
    """Return the times in [0, ``end``] at which ``form`` has risen to ``rise``.

    A table of the form brackets each root in at most a 2048th of the time. There Newton's method
    converges in two or three steps; a step that leaves its bracket is replaced by a bisection.

    Parameters
    ----------
    form
        A rise that never goes back.
    rise
        (n,) from 0 to the rise at ``end``.
    latest
        Where the form dwells at a rise, return the last time of the dwell and not the first.
    """
    inner = [b for b in form.breaks if 0.0 < b < end]
    grid = np.union1d(np.linspace(0.0, end, _CELLS + 1), inner)
    table = np.maximum.accumulate(form.value(grid, 0))
    upper = np.searchsorted(table, rise, side="right" if latest else "left")
    upper = np.clip(upper, 1, len(grid) - 1)
    low, high = grid[upper - 1], grid[upper]
    below, above = table[upper - 1], table[upper]
    span = np.where(above > below, above - below, 1.0)
    share = np.clip((rise - below) / span, 0.0, 1.0)
    # From rest a rise starts as a power of time, which gives the first guess in the first cell.
    first = upper == 1
    if first.any():
        half = float(form.value(np.array([0.5 * grid[1]]), 0)[0])
        power = np.log2(table[1] / half) if half > 0.0 and table[1] > half else 1.0
        share[first] **= 1.0 / power
    t: FloatArray = np.clip(low + share * (high - low), low, high)
    active = np.flatnonzero((share > 0.0) & (share < 1.0))
    for _ in range(_ROUNDS):
        if not len(active):
            break
        at = t[active]
        missed = form.value(at, 0) - rise[active]
        slope = form.value(at, 1)
        under = missed < 0.0 if not latest else missed <= 0.0
        low[active[under]] = at[under]
        high[active[~under]] = at[~under]
        lowest, highest = low[active], high[active]
        with np.errstate(divide="ignore", invalid="ignore"):
            moved = at - missed / slope
        inside = (moved >= lowest) & (moved <= highest) & (missed != 0.0)
        moved = np.where(missed == 0.0, at, np.where(inside, moved, 0.5 * (lowest + highest)))
        t[active] = moved
        step = np.abs(moved - at)
        done = (missed == 0.0) | (inside & (step <= _ENOUGH * moved))
        done |= (highest - lowest) <= 1e-16 * highest
        active = active[~done]
    return t
