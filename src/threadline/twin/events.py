"""Kernel: an advance in which modes change, every change located.

A guard is watched over an advance through the four Bezier points of its cubic Hermite
interpolant; only an advance with all of them inside is taken. Otherwise shorter ones are tried,
and within a single cell the guards are polynomials (12 terms of the Taylor series, remainder
below 1e-16 of the state) whose first exit is found to rounding. A guard that is left and entered
again within one watched interval h escapes only when it goes beyond its bound by less than the
error of the interpolant, ``h^4 max|g''''| / 384``; h times the fastest rate is at most 1.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from threadline.twin.compiled import stays_apart
from threadline.twin.modes import (
    AT_HOLD,
    AT_LOW,
    AT_RATE,
    AT_STEP,
    COLUMNS,
    GUARDS,
    N_STATES,
    WATCHED,
)

TERMS = 12
_MOST_EVENTS = 2000
_SECTIONS = 4

MODE, DONE, EVENTS, ENDLESS, SLOW = 0, 1, 2, 3, 4
"""Entries of ``where``: the mode, cells done, events so far, endless changes, slow advances."""


@njit
def _first_exit(q, low, high, until):  # type: ignore[no-untyped-def]
    """Return the first s in (0, until] at which a polynomial leaves its bounds, and the side.

    The side is 0 when it stays. The sections of the interval are looked at in order, then
    Newton's method, kept within a bracket, finds the crossing.
    """
    stays_apart(False)
    before = q[0]
    for section in range(_SECTIONS):
        a = section / _SECTIONS
        if a >= until:
            break
        b = min((section + 1) / _SECTIONS, until)
        value = q[TERMS]
        for k in range(TERMS - 1, -1, -1):
            value = value * b + q[k]
        if low <= value <= high:
            before = value
            continue
        side = 1 if value > high else -1
        bound = high if side > 0 else low
        left, right = a, b
        # The secant's crossing, then Newton's; what is left squares itself at every turn.
        s = a + (b - a) * (bound - before) / (value - before)
        if not (a <= s <= b):
            s = 0.5 * (a + b)
        for _ in range(80):
            value, slope = q[TERMS], 0.0
            for k in range(TERMS - 1, -1, -1):
                slope = slope * s + value
                value = value * s + q[k]
            value = (value - bound) * side
            if value > 0.0:
                right = s
            else:
                left = s
            better = s - value / (slope * side) if slope != 0.0 else 0.5 * (left + right)
            if not (left <= better <= right):
                better = 0.5 * (left + right)
            done = abs(better - s) < 1e-9 or right - left < 1e-15
            s = better
            if done:
                break
        return s, side
    return until, 0


@njit
def advance_watched(t, v, where, z, y, D, q, cells, tripped):  # type: ignore[no-untyped-def]  # noqa: PLR0915
    """Advance z by ``cells`` cells; return False when a mode has to be met first.

    Called again after that, it goes on where it was: ``where[DONE]`` cells and, of the next, the
    fraction ``1 - q[-1]``. ``cells`` = 0 only leaves modes that don't hold at z.
    """
    stays_apart(False)
    f, sizes = t.values, t.sizes
    n, size, guards = sizes[N_STATES], sizes[COLUMNS], sizes[GUARDS]
    guard, rate, low, hold = n * size, sizes[AT_RATE], sizes[AT_LOW], sizes[AT_HOLD]
    high = low + guards
    changes = 0
    while True:
        row = t.slot_of[v, where[MODE]]
        if row < 0:
            return False
        event = 0
        for w in range(guards):
            value = 0.0
            for j in range(size):
                value += f[row, guard + w * size + j] * z[j]
            if value > f[row, high + w]:
                event = w + 1
            elif value < f[row, low + w]:
                event = -w - 1
            if event != 0:
                break
        if event == 0:
            if where[DONE] >= cells:
                return True
            level = sizes[WATCHED] - 1 if q[-1] == 1.0 else -1
            while level >= 0:
                inside = where[DONE] + (1 << level) <= cells
                if inside:
                    third = t.cell_s[0] * (1 << level) / 3.0
                    for i in range(n):
                        total = 0.0
                        for j in range(size):
                            total += f[row, sizes[AT_STEP] + (level * n + i) * size + j] * z[j]
                        y[i] = total
                    for j in range(n, size):
                        y[j] = z[j]
                    for w in range(guards):
                        start, end, last = 0.0, 0.0, 0.0
                        for j in range(size):
                            bend = f[row, rate + w * size + j] * third
                            start += (f[row, guard + w * size + j] + bend) * z[j]
                            end += (f[row, guard + w * size + j] - bend) * y[j]
                            last += f[row, guard + w * size + j] * y[j]
                        most = max(start, end, last)
                        least = min(start, end, last)
                        inside = inside and most <= f[row, high + w] and least >= f[row, low + w]
                if inside:
                    break
                level -= 1
            if level >= 0:
                for i in range(n):
                    z[i] = y[i]
                where[DONE] += 1 << level
                continue
            # Within one cell: the state as a polynomial of the fraction of what is left of it.
            span = t.cell_s[0] * q[-1]
            for i in range(n):
                D[0, i] = z[i]
                total = 0.0
                for j in range(size):
                    total += f[row, i * size + j] * z[j]
                D[1, i] = total * span
            for k in range(2, TERMS + 1):
                for i in range(n):
                    total = 0.0
                    for j in range(n):
                        total += f[row, i * size + j] * D[k - 1, j]
                    D[k, i] = total * span / k
            until = 1.0
            for w in range(guards):
                if f[row, low + w] == -np.inf and f[row, high + w] == np.inf:
                    continue
                for k in range(TERMS + 1):
                    total = 0.0
                    for i in range(n):
                        total += f[row, guard + w * size + i] * D[k, i]
                    q[k] = total
                for j in range(n, size):
                    q[0] += f[row, guard + w * size + j] * z[j]
                s, side = _first_exit(q, f[row, low + w], f[row, high + w], until)
                if side != 0:
                    until, event = s, side * (w + 1)
            for i in range(n):
                value = D[TERMS, i]
                for k in range(TERMS - 1, -1, -1):
                    value = value * until + D[k, i]
                z[i] = value
            q[-1] *= 1.0 - until
            if q[-1] <= 1e-14:
                q[-1] = 1.0
                where[DONE] += 1
        if event != 0:
            w = abs(event) - 1
            side = 1 if event > 0 else 0
            if t.plan[row, 1 + w] >= 0:
                tripped[t.plan[row, 1 + w]] = 1
            if t.plan[row, 1 + 3 * guards + 2 * w + side] >= 0:
                z[t.plan[row, 1 + 3 * guards + 2 * w + side]] = f[row, hold + 2 * w + side]
            where[MODE] = t.plan[row, 1 + guards + 2 * w + side]
            where[EVENTS] += 1
            changes += 1
            if changes > _MOST_EVENTS:
                where[ENDLESS] += 1
                return True
