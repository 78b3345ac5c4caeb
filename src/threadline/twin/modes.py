"""Kernels: the modes of a piecewise linear system, their propagators, and events between them.

Advance by matrix exponentials, computed once per mode: ``E(cell) = exp(A cell)`` by its series
(the spectral radius times the cell is at most 1/4, 16 terms), then squared for every power of
two. A guard is watched over an advance through the four Bezier points of its cubic Hermite
interpolant; only an advance with all of them inside is taken. Otherwise shorter ones are tried,
and within a single cell the guards are polynomials (12 terms of the Taylor series, remainder
below 1e-16 of the state) whose first exit is found to rounding. A guard that is left and entered
again within one watched interval h escapes only when it goes beyond its bound by less than the
error of the interpolant, ``h^4 max|g''''| / 384``; h times the fastest rate is at most 1.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from threadline.arrays import FloatArray, IntArray
from threadline.twin.tables import PlantTables

TERMS = 12
_SERIES = 16
_MAX_EVENTS = 500
_SECTIONS = 4


class ModeCache(NamedTuple):
    """Modes already met: S slots, n states, N columns, W guards, J powers of two, L lengths.

    ``fast`` has, per slot and length, the n rows of the state's propagator, then for every guard
    its value at the start and, per watched interval, the two inner Bezier points and the end.
    """

    code: IntArray  # (S, E) mode of each element
    used: IntArray  # (2,) slots filled, slot to be reused next
    generator: FloatArray  # (S, n, N)
    guard: FloatArray  # (S, W, N)
    guard_rate: FloatArray  # (S, W, N)
    low: FloatArray  # (S, W)
    high: FloatArray  # (S, W)
    owner: IntArray  # (S, W, 2) element and guard
    step: FloatArray  # (S, J, n, N) advance by cell * 2**j
    fast: FloatArray  # (S, L, rows, N)
    lengths: IntArray  # (L,) in cells
    intervals: IntArray  # (L,) watched intervals per length
    watched: IntArray  # (1,) powers of two that a slow advance may use
    cell_s: FloatArray  # (1,)


@njit(cache=True)
def compose(plant: PlantTables, v: int, cache: ModeCache, slot: int) -> None:
    """Fill generator and guards of the slot from its code."""
    code = cache.code[slot]
    Z = cache.generator[slot]
    n, size = Z.shape
    Z[:, :] = plant.base[v]
    for e in range(len(code)):
        for i in range(n):
            d = plant.direction[v, e, i]
            if d != 0.0:
                for j in range(size):
                    Z[i, j] += d * plant.law[v, e, code[e], j]
    at = 0
    for e in range(len(code)):
        m = code[e]
        for g in range(plant.guards[e]):
            cache.owner[slot, at, 0] = e
            cache.owner[slot, at, 1] = g
            cache.low[slot, at] = -np.inf
            cache.high[slot, at] = np.inf
            cache.guard[slot, at, :] = 0.0
            kind = plant.guard_kind[e, m, g]
            if kind != 0:
                cache.low[slot, at] = plant.guard_low[v, e, m, g]
                cache.high[slot, at] = plant.guard_high[v, e, m, g]
            for j in range(size):
                if kind == 1:
                    cache.guard[slot, at, j] = plant.guard_row[v, e, m, g, j]
                elif kind == 2:
                    cache.guard[slot, at, j] = plant.net_scale[v, e, m] * Z[plant.holds[e, m], j]
            at += 1
    for e in range(len(code)):
        held = plant.holds[e, code[e]]
        if held >= 0:
            Z[held, :] = 0.0
    for w in range(at):
        for j in range(size):
            total = 0.0
            for i in range(n):
                total += cache.guard[slot, w, i] * Z[i, j]
            cache.guard_rate[slot, w, j] = total


@njit(cache=True)
def _multiply(P, Q, out):  # type: ignore[no-untyped-def]
    """Out = P after Q, both (n, N) with the identity below."""
    n, size = P.shape
    for i in range(n):
        for j in range(size):
            total = P[i, j] if j >= n else 0.0
            for k in range(n):
                total += P[i, k] * Q[k, j]
            out[i, j] = total


@njit(cache=True)
def build(plant: PlantTables, v: int, cache: ModeCache, slot: int) -> None:
    """Fill every table of the slot from its code."""
    compose(plant, v, cache, slot)
    Z = cache.generator[slot]
    n, size = Z.shape
    cell = cache.cell_s[0]
    first = cache.step[slot, 0]
    term = np.zeros((n, size))
    other = np.zeros((n, size))
    for i in range(n):
        for j in range(size):
            term[i, j] = Z[i, j] * cell
            first[i, j] = term[i, j] + (1.0 if i == j else 0.0)
    for k in range(2, _SERIES + 1):
        for i in range(n):
            for j in range(size):
                total = 0.0
                for m in range(n):
                    total += Z[i, m] * term[m, j]
                other[i, j] = total * cell / k
        term[:, :] = other
        for i in range(n):
            for j in range(size):
                first[i, j] += term[i, j]
    for level in range(1, cache.step.shape[1]):
        _multiply(cache.step[slot, level - 1], cache.step[slot, level - 1], cache.step[slot, level])
    for index in range(len(cache.lengths)):
        _fill_fast(cache, slot, index)


@njit(cache=True)
def _power(cache: ModeCache, slot: int, cells: int, out, spare):  # type: ignore[no-untyped-def]
    """Out = advance by ``cells`` cells."""
    n, _ = out.shape
    out[:, :] = 0.0
    for i in range(n):
        out[i, i] = 1.0
    level = 0
    while cells:
        if cells & 1:
            _multiply(cache.step[slot, level], out, spare)
            out[:, :] = spare
        cells >>= 1
        level += 1


@njit(cache=True)
def _fill_fast(cache: ModeCache, slot: int, index: int) -> None:
    n, size = cache.generator.shape[1:]
    length = cache.lengths[index]
    parts = cache.intervals[index]
    fast = cache.fast[slot, index]
    before = np.zeros((n, size))
    after = np.zeros((n, size))
    spare = np.zeros((n, size))
    _power(cache, slot, length, after, spare)
    fast[:n] = after
    guards = cache.guard.shape[1]
    per = (fast.shape[0] - n) // max(1, guards)
    for part in range(parts):
        a = length * part // parts
        b = length * (part + 1) // parts
        third = cache.cell_s[0] * (b - a) / 3.0
        _power(cache, slot, a, before, spare)
        _power(cache, slot, b, after, spare)
        for w in range(guards):
            at = n + w * per
            G = cache.guard[slot, w]
            D = cache.guard_rate[slot, w]
            for j in range(size):
                start = G[j] if j >= n else 0.0
                end = start
                rise = D[j] if j >= n else 0.0
                fall = rise
                for i in range(n):
                    start += G[i] * before[i, j]
                    rise += D[i] * before[i, j]
                    end += G[i] * after[i, j]
                    fall += D[i] * after[i, j]
                if part == 0:
                    fast[at, j] = start
                fast[at + 1 + 3 * part, j] = start + rise * third
                fast[at + 2 + 3 * part, j] = end - fall * third
                fast[at + 3 + 3 * part, j] = end


@njit(cache=True)
def find_slot(plant: PlantTables, v: int, cache: ModeCache, code) -> int:  # type: ignore[no-untyped-def]
    """Return the slot of a mode; build it when it is met for the first time."""
    count = len(code)
    for slot in range(cache.used[0]):
        same = True
        for e in range(count):
            if cache.code[slot, e] != code[e]:
                same = False
                break
        if same:
            return int(slot)
    slots = len(cache.code)
    if cache.used[0] < slots:
        slot = cache.used[0]
        cache.used[0] += 1
    else:
        # Full: the oldest goes.
        slot = cache.used[1]
        cache.used[1] = (slot + 1) % slots
    for e in range(count):
        cache.code[slot, e] = code[e]
    build(plant, v, cache, slot)
    return int(slot)


@njit(cache=True)
def _dot(row, z):  # type: ignore[no-untyped-def]
    total = 0.0
    for j in range(len(z)):
        total += row[j] * z[j]
    return total


@njit(cache=True)
def _switch(plant, v, cache, slot, w, above, code, z, tripped):  # type: ignore[no-untyped-def]
    """Take the transition of guard w of the slot; return the new slot."""
    e = cache.owner[slot, w, 0]
    g = cache.owner[slot, w, 1]
    m = code[e]
    switch = plant.guard_switch[e, m, g]
    if switch >= 0:
        tripped[switch] = 1
    code[e] = plant.guard_to[e, m, g, 1 if above else 0]
    held = plant.holds[e, code[e]]
    if held >= 0:
        z[held] = plant.held_at[v, e, code[e]]
    return find_slot(plant, v, cache, code)


@njit(cache=True)
def settle(plant, v, cache, slot, code, z, tripped, counts):  # type: ignore[no-untyped-def]
    """Leave modes whose guards don't hold at z; return the slot that holds."""
    guards = cache.guard.shape[1]
    for _ in range(8 * len(code) + 8):
        left = False
        for w in range(guards):
            low = cache.low[slot, w]
            high = cache.high[slot, w]
            if low == -np.inf and high == np.inf:
                continue
            value = _dot(cache.guard[slot, w], z)
            if value > high or value < low:
                slot = _switch(plant, v, cache, slot, w, value > high, code, z, tripped)
                counts[1] += 1
                left = True
                break
        if not left:
            return slot
    counts[2] += 1
    return slot


@njit(cache=True)
def _watched(cache, slot, z, y, third):  # type: ignore[no-untyped-def]
    """Whether every guard's Bezier points stay inside over an advance from z to y."""
    for w in range(cache.guard.shape[1]):
        low = cache.low[slot, w]
        high = cache.high[slot, w]
        if low == -np.inf and high == np.inf:
            continue
        start = _dot(cache.guard[slot, w], z)
        end = _dot(cache.guard[slot, w], y)
        second = start + _dot(cache.guard_rate[slot, w], z) * third
        other = end - _dot(cache.guard_rate[slot, w], y) * third
        if end > high or end < low or second > high or second < low or other > high or other < low:
            return False
    return True


@njit(cache=True)
def _first_exit(q, low, high, until):  # type: ignore[no-untyped-def]
    """Return the first s in (0, until] at which the polynomial leaves, and on which side.

    The side is 0 when it stays. Sections of the interval are looked at in order, then Newton's
    method, kept in a bracket, finds the crossing.
    """
    order = len(q) - 1
    for section in range(_SECTIONS):
        a = section / _SECTIONS
        if a >= until:
            break
        b = min((section + 1) / _SECTIONS, until)
        value = q[order]
        for k in range(order - 1, -1, -1):
            value = value * b + q[k]
        if value > high:
            side, bound = 1, high
        elif value < low:
            side, bound = -1, low
        else:
            continue
        left, right = a, b
        s = 0.5 * (a + b)
        for _ in range(80):
            value, slope = q[order], 0.0
            for k in range(order - 1, -1, -1):
                slope = slope * s + value
                value = value * s + q[k]
            value = (value - bound) * side
            slope *= side
            if value > 0.0:
                right = s
            else:
                left = s
            better = s - value / slope if slope != 0.0 else 0.5 * (left + right)
            if not (left < better < right):
                better = 0.5 * (left + right)
            done = abs(better - s) < 1e-15 or right - left < 1e-15
            s = better
            if done:
                break
        return s, side
    return until, 0


@njit(cache=True)
def _cross_cell(plant, v, cache, slot, code, z, tripped, counts, D, q):  # type: ignore[no-untyped-def]
    """Advance z by one cell with every event in it located; return the slot at its end."""
    n, size = cache.generator.shape[1:]
    guards = cache.guard.shape[1]
    left = 1.0
    for _ in range(_MAX_EVENTS):
        slot = settle(plant, v, cache, slot, code, z, tripped, counts)
        span = cache.cell_s[0] * left
        Z = cache.generator[slot]
        for i in range(n):
            D[0, i] = z[i]
            D[1, i] = _dot(Z[i], z) * span
        for k in range(2, TERMS + 1):
            for i in range(n):
                total = 0.0
                for j in range(n):
                    total += Z[i, j] * D[k - 1, j]
                D[k, i] = total * span / k
        until, first, above = 1.0, -1, False
        for w in range(guards):
            low = cache.low[slot, w]
            high = cache.high[slot, w]
            if low == -np.inf and high == np.inf:
                continue
            for k in range(TERMS + 1):
                total = 0.0
                for i in range(n):
                    total += cache.guard[slot, w, i] * D[k, i]
                q[k] = total
            for j in range(n, size):
                q[0] += cache.guard[slot, w, j] * z[j]
            s, side = _first_exit(q, low, high, until)
            if side != 0:
                until, first, above = s, w, side > 0
        for i in range(n):
            value = D[TERMS, i]
            for k in range(TERMS - 1, -1, -1):
                value = value * until + D[k, i]
            z[i] = value
        if first < 0:
            return slot
        counts[1] += 1
        slot = _switch(plant, v, cache, slot, first, above, code, z, tripped)
        left *= 1.0 - until
        if left <= 1e-14:
            return slot
    counts[2] += 1
    return slot


@njit(cache=True)
def advance_watched(plant, v, cache, slot, code, z, y, cells, tripped, counts, D, q):  # type: ignore[no-untyped-def]
    """Advance z by ``cells`` cells through whatever events there are; return the slot.

    ``counts`` gathers slow advances, events, and places where modes changed without end.
    """
    n = cache.generator.shape[1]
    levels = cache.watched[0]
    counts[0] += 1
    done = 0
    level = levels - 1
    while done < cells:
        slot = settle(plant, v, cache, slot, code, z, tripped, counts)
        while level > 0 and (1 << level) > cells - done:
            level -= 1
        taken = False
        while True:
            P = cache.step[slot, level]
            for i in range(n):
                y[i] = _dot(P[i], z)
            for j in range(n, len(z)):
                y[j] = z[j]
            if _watched(cache, slot, z, y, cache.cell_s[0] * (1 << level) / 3.0):
                taken = True
                break
            if level == 0:
                break
            level -= 1
        if taken:
            for i in range(n):
                z[i] = y[i]
            done += 1 << level
            level = min(level + 1, levels - 1)
        else:
            slot = _cross_cell(plant, v, cache, slot, code, z, tripped, counts, D, q)
            done += 1
            level = min(level + 1, levels - 1)
    # What was entered at the very end must hold too.
    return settle(plant, v, cache, slot, code, z, tripped, counts)
