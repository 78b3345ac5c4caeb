"""Modes of a piecewise linear system as tables: generator, guards, transitions, propagators.

Every combination of the elements' modes is one mode of the whole, numbered in mixed radix; its
tables are filled when it is met for the first time. Propagators are matrix exponentials:
``E(cell) = exp(Z cell)`` by its series (the spectral radius times the cell is at most 1/4,
16 terms), then squared for every power of two.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from threadline.arrays import FloatArray, IntArray
from threadline.twin.compiled import stays_apart
from threadline.twin.tables import PlantTables

_SERIES = 16


class Modes(NamedTuple):
    """Tables of the modes met so far; Q = V * S rows, S slots for each of V variants.

    n states, N columns, W guards, J powers of two, D drives, T distinct lengths of advance.
    """

    slot_of: IntArray  # (V, modes) row of a mode, -1 while it hasn't been met
    used: IntArray  # (V, 2) slots filled, slot to be reused next
    mode_of: IntArray  # (Q,)
    generator: FloatArray  # (Q, n, N)
    guard: FloatArray  # (Q, W, N)
    rate: FloatArray  # (Q, W, N) the guard's derivative
    low: FloatArray  # (Q, W)
    high: FloatArray  # (Q, W)
    next_mode: IntArray  # (Q, W, 2) the mode below and above
    hold_state: IntArray  # (Q, W, 2) the state that this transition holds still, -1 for none
    hold_value: FloatArray  # (Q, W, 2)
    latch: IntArray  # (Q, W) the limit switch that this guard is, -1 for none
    step: FloatArray  # (Q, J, n, N) advance by cell * 2**j
    current: FloatArray  # (Q, D, N) current of each drive
    fast: FloatArray  # (Q, T, n + W * (1 + 3 * intervals), N), see ``_fill_fast``
    lengths: IntArray  # (T,) in cells
    intervals: IntArray  # (1,) watched intervals per length
    watched: IntArray  # (1,) powers of two that a slow advance may use
    cell_s: FloatArray  # (1,)


@njit
def _after(t, row, level, source, x, target, y):  # type: ignore[no-untyped-def]
    """target[y] = advance by cell * 2**level after source[x], rows (n, N), identity below."""
    stays_apart()
    n = t.generator.shape[1]
    size = t.generator.shape[2]
    for i in range(n):
        for j in range(size):
            total = t.step[row, level, i, j] if j >= n else 0.0
            for k in range(n):
                total += t.step[row, level, i, k] * source[x, k, j]
            target[y, i, j] = total


@njit
def _compose(plant, v, t, row, mode):  # type: ignore[no-untyped-def]
    """Fill generator, guards, transitions and currents of the row."""
    stays_apart()
    n = t.generator.shape[1]
    size = t.generator.shape[2]
    elements = len(plant.modes)
    for i in range(n):
        for j in range(size):
            t.generator[row, i, j] = plant.base[v, i, j]
    radix = 1
    for e in range(elements):
        m = mode // radix % plant.modes[e]
        for i in range(n):
            for j in range(size):
                t.generator[row, i, j] += plant.direction[v, e, i] * plant.law[v, e, m, j]
        for d in range(t.current.shape[1]):
            if plant.drive_element[d] == e:
                for j in range(size):
                    t.current[row, d, j] = plant.law[v, e, m, j]
        radix *= plant.modes[e]
    at = 0
    radix = 1
    for e in range(elements):
        m = mode // radix % plant.modes[e]
        for g in range(plant.guards[e]):
            kind = plant.guard_kind[e, m, g]
            t.low[row, at] = plant.guard_low[v, e, m, g] if kind != 0 else -np.inf
            t.high[row, at] = plant.guard_high[v, e, m, g] if kind != 0 else np.inf
            t.latch[row, at] = plant.guard_switch[e, m, g]
            for side in range(2):
                to = plant.guard_to[e, m, g, side]
                t.next_mode[row, at, side] = mode + (to - m) * radix if to >= 0 else mode
                held = plant.holds[e, to] if to >= 0 else -1
                t.hold_state[row, at, side] = held
                t.hold_value[row, at, side] = plant.held_at[v, e, to] if held >= 0 else 0.0
            for j in range(size):
                value = 0.0
                if kind == 1:
                    value = plant.guard_row[v, e, m, g, j]
                elif kind == 2:
                    # The force on a held state, whatever else is held, before it is taken out.
                    value = plant.net_scale[v, e, m] * t.generator[row, plant.holds[e, m], j]
                t.guard[row, at, j] = value
            at += 1
        radix *= plant.modes[e]
    while at < t.guard.shape[1]:
        t.low[row, at] = -np.inf
        t.high[row, at] = np.inf
        at += 1
    radix = 1
    for e in range(elements):
        m = mode // radix % plant.modes[e]
        if plant.holds[e, m] >= 0:
            for j in range(size):
                t.generator[row, plant.holds[e, m], j] = 0.0
        radix *= plant.modes[e]
    for w in range(t.guard.shape[1]):
        for j in range(size):
            total = 0.0
            for i in range(n):
                total += t.guard[row, w, i] * t.generator[row, i, j]
            t.rate[row, w, j] = total


@njit
def _fill_fast(t, row, index, P):  # type: ignore[no-untyped-def]
    """Fill what one whole advance needs; P is space for three matrices.

    The n rows of the state's propagator, then per guard its value at the start and, per watched
    interval, the two inner Bezier points of its cubic Hermite interpolant and its end.
    """
    stays_apart()
    n = t.generator.shape[1]
    size = t.generator.shape[2]
    length = t.lengths[index]
    parts = t.intervals[0]
    per = 1 + 3 * parts
    now, then, spare = np.int64(0), np.int64(1), np.int64(2)
    for i in range(n):
        for j in range(size):
            P[now, i, j] = 1.0 if i == j else 0.0
    before = 0
    for part in range(parts):
        after = length * (part + 1) // parts
        third = t.cell_s[0] * (after - before) / 3.0
        for i in range(n):
            for j in range(size):
                P[then, i, j] = P[now, i, j]
        for level in range(t.step.shape[1]):
            if (after - before) >> level & 1:
                _after(t, row, level, P, then, P, spare)
                then, spare = spare, then
        for w in range(t.guard.shape[1]):
            at = n + w * per
            for j in range(size):
                start = t.guard[row, w, j] if j >= n else 0.0
                rise = t.rate[row, w, j] if j >= n else 0.0
                end, fall = start, rise
                for i in range(n):
                    start += t.guard[row, w, i] * P[now, i, j]
                    rise += t.rate[row, w, i] * P[now, i, j]
                    end += t.guard[row, w, i] * P[then, i, j]
                    fall += t.rate[row, w, i] * P[then, i, j]
                if part == 0:
                    t.fast[row, index, at, j] = start
                t.fast[row, index, at + 1 + 3 * part, j] = start + rise * third
                t.fast[row, index, at + 2 + 3 * part, j] = end - fall * third
                t.fast[row, index, at + 3 + 3 * part, j] = end
        now, then = then, now
        before = after
    for i in range(n):
        for j in range(size):
            t.fast[row, index, i, j] = P[now, i, j]


@njit
def meet(plant: PlantTables, v: int, t: Modes, mode: int) -> None:
    """Fill the tables of a mode of variant v that is met for the first time."""
    stays_apart()
    slots = len(t.mode_of) // len(t.slot_of)
    row = v * slots + t.used[v, 0]
    if t.used[v, 0] < slots:
        t.used[v, 0] += 1
    else:
        # All slots are taken: the one that was filled first goes.
        row = v * slots + t.used[v, 1]
        t.used[v, 1] = (t.used[v, 1] + 1) % slots
        t.slot_of[v, t.mode_of[row]] = -1
    t.mode_of[row] = mode
    t.slot_of[v, mode] = row
    _compose(plant, v, t, row, mode)
    n = t.generator.shape[1]
    size = t.generator.shape[2]
    P = np.zeros((3, n, size))
    first, second = np.int64(0), np.int64(1)
    for i in range(n):
        for j in range(size):
            P[0, i, j] = 1.0 if i == j else 0.0
            t.step[row, 0, i, j] = P[0, i, j]
    for k in range(1, _SERIES + 1):
        # Column by column: P[1] = Z P[0] cell / k; the columns of inputs start from Z itself.
        for i in range(n):
            for j in range(size):
                total = t.generator[row, i, j] if k == 1 and j >= n else 0.0
                for m in range(n):
                    total += t.generator[row, i, m] * P[0, m, j]
                P[1, i, j] = total * t.cell_s[0] / k
        for i in range(n):
            for j in range(size):
                P[0, i, j] = P[1, i, j]
                t.step[row, 0, i, j] += P[1, i, j]
    for level in range(1, t.step.shape[1]):
        for i in range(n):
            for j in range(size):
                P[0, i, j] = t.step[row, level - 1, i, j]
        _after(t, row, level - 1, P, first, P, second)
        for i in range(n):
            for j in range(size):
                t.step[row, level, i, j] = P[1, i, j]
    for index in range(len(t.lengths)):
        _fill_fast(t, row, index, P)
