"""Modes of a piecewise linear system as tables: generator, guards, transitions, propagators.

Every combination of the elements' modes is one mode of the whole, numbered in mixed radix; its
tables are filled when it is met for the first time. Propagators are matrix exponentials:
``E(cell) = exp(Z cell)`` by its series (the spectral radius times the cell is at most 1/4,
16 terms), then squared for every power of two.

The tables are packed into few plain arrays: each array that a compiled function takes costs
compilation time, at every call, and there would be thirty of them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from threadline.arrays import FloatArray, IntArray
from threadline.twin.compiled import stays_apart
from threadline.twin.tables import PlantTables

_SERIES = 16
_ROWS = ("base", "direction", "law", "held_at", "net_scale", "guard_row", "guard_low", "guard_high")
_PLANS = ("modes", "guards", "drive_element", "holds", "guard_kind", "guard_to", "guard_switch")


class Plant(NamedTuple):
    """``PlantTables`` packed: V variants, E elements, M modes and G guards at most of each."""

    values: FloatArray  # (V, F): the arrays named in _ROWS, one after the other
    plan: IntArray  # n, N, E, M, G, D, then the arrays named in _PLANS


class Modes(NamedTuple):
    """Tables of the modes met so far; Q = V * S rows, S slots for each of V variants.

    n states, N columns, W guards, J powers of two, D drives, T distinct lengths of advance, P
    rows per guard and length. A row of ``values`` has generator (n, N), guard (W, N), its rate
    (W, N), low (W), high (W), hold_value (W, 2), current (D, N), step (J, n, N) and fast
    (T, n + W P, N); a row of ``plan`` its mode, the limit switch that a guard is (W), next mode
    (W, 2) and the state that is held then (W, 2), each below and above.
    """

    values: FloatArray  # (Q, F)
    plan: IntArray  # (Q, I)
    slot_of: IntArray  # (V, modes) row of a mode, -1 while it hasn't been met
    used: IntArray  # (V, 2) slots filled, slot to be reused next
    sizes: IntArray  # n, N, W, J, D, T, parts, watched powers of two, offsets (6), lengths (T)
    cell_s: FloatArray  # (1,)


N_STATES, COLUMNS, GUARDS, POWERS, DRIVES, LENGTHS, PARTS, WATCHED = range(8)
AT_RATE, AT_LOW, AT_HOLD, AT_CURRENT, AT_STEP, AT_FAST, AT_LENGTHS = range(8, 15)
"""Entries of ``sizes``; AT_... are offsets in a row of values, high follows low, guard is n N."""


def pack_plant(tables: PlantTables, which: IntArray) -> Plant:
    """Return the packed tables of the variants ``which``."""
    _, n, size = tables.base.shape
    _, elements, most_modes, most_guards = tables.guard_low.shape
    parts = [getattr(tables, name).reshape(len(tables.base), -1) for name in _ROWS]
    head = [n, size, elements, most_modes, most_guards, len(tables.drive_element)]
    plan = [np.array(head), *(getattr(tables, name).ravel() for name in _PLANS)]
    return Plant(
        values=np.ascontiguousarray(np.concatenate(parts, axis=1)[which]),
        plan=np.concatenate(plan).astype(np.int64),
    )


def new_modes(
    plant: PlantTables,
    variants: int,
    *,
    slots: int,
    guards: int,
    lengths: IntArray,
    parts: int,
    watched: int,
    cell_s: float,
) -> Modes:
    """Return empty tables; see ``prepare.Prepared`` for what the numbers mean."""
    n, size = plant.base.shape[1:]
    drives, powers = len(plant.drive_element), int(lengths.max()).bit_length()
    rate = n * size + guards * size
    low = rate + guards * size
    hold = low + 2 * guards
    current = hold + 2 * guards
    step = current + drives * size
    fast = step + powers * n * size
    total = fast + len(lengths) * (n + guards * (1 + 3 * parts)) * size
    head = [n, size, guards, powers, drives, len(lengths), parts, watched]
    head += [rate, low, hold, current, step, fast]
    return Modes(
        values=np.zeros((variants * slots, total)),
        plan=np.full((variants * slots, 1 + 5 * guards), -1, dtype=np.int64),
        slot_of=np.full((variants, int(np.prod(plant.modes))), -1, dtype=np.int64),
        used=np.zeros((variants, 2), dtype=np.int64),
        sizes=np.concatenate((np.array(head), lengths)).astype(np.int64),
        cell_s=np.array([cell_s]),
    )


@njit
def _compose(plant, v, t, row, mode):  # type: ignore[no-untyped-def]  # noqa: PLR0915
    """Fill generator, guards, transitions and currents of the row."""
    stays_apart(True)
    f, p, out, to_out = plant.values, plant.plan, t.values, t.plan
    n, size, elements, M, G, drives = p[0], p[1], p[2], p[3], p[4], p[5]
    direction = n * size
    law = direction + elements * n
    held_at = law + elements * M * size
    net = held_at + elements * M
    rows = net + elements * M
    low = rows + elements * M * G * size
    high = low + elements * M * G
    guards_of = 6 + elements
    drive_element = guards_of + elements
    holds = drive_element + drives
    kind_at = holds + elements * M
    to_at = kind_at + elements * M * G
    switch = to_at + 2 * elements * M * G
    W = t.sizes[GUARDS]
    guard, rate, bound = n * size, t.sizes[AT_RATE], t.sizes[AT_LOW]
    for i in range(n * size):
        out[row, i] = f[v, i]
    radix = 1
    for e in range(elements):
        m = mode // radix % p[6 + e]
        for i in range(n):
            for j in range(size):
                out[row, i * size + j] += (
                    f[v, direction + e * n + i] * f[v, law + (e * M + m) * size + j]
                )
        for d in range(drives):
            if p[drive_element + d] == e:
                for j in range(size):
                    out[row, t.sizes[AT_CURRENT] + d * size + j] = f[
                        v, law + (e * M + m) * size + j
                    ]
        radix *= p[6 + e]
    for w in range(W):
        out[row, bound + w] = -np.inf
        out[row, bound + W + w] = np.inf
    at = 0
    radix = 1
    for e in range(elements):
        m = mode // radix % p[6 + e]
        for g in range(p[guards_of + e]):
            place = (e * M + m) * G + g
            kind = p[kind_at + place]
            to_out[row, 1 + at] = p[switch + place]
            if kind != 0:
                out[row, bound + at] = f[v, low + place]
                out[row, bound + W + at] = f[v, high + place]
            for side in range(2):
                to = p[to_at + 2 * place + side]
                here = 2 * at + side
                held = p[holds + e * M + to] if to >= 0 else -1
                to_out[row, 1 + W + here] = mode + (to - m) * radix if to >= 0 else mode
                to_out[row, 1 + 3 * W + here] = held
                out[row, t.sizes[AT_HOLD] + here] = f[v, held_at + e * M + to] if held >= 0 else 0.0
            for j in range(size):
                value = 0.0
                if kind == 1:
                    value = f[v, rows + place * size + j]
                elif kind == 2:
                    # The force on a held state, whatever else is held, before it is taken out.
                    value = f[v, net + e * M + m] * out[row, p[holds + e * M + m] * size + j]
                out[row, guard + at * size + j] = value
            at += 1
        radix *= p[6 + e]
    radix = 1
    for e in range(elements):
        held = p[holds + e * M + mode // radix % p[6 + e]]
        if held >= 0:
            for j in range(size):
                out[row, held * size + j] = 0.0
        radix *= p[6 + e]
    for w in range(W):
        for j in range(size):
            total = 0.0
            for i in range(n):
                total += out[row, guard + w * size + i] * out[row, i * size + j]
            out[row, rate + w * size + j] = total


@njit
def _after(t, row, level, P, source, target):  # type: ignore[no-untyped-def]
    """P[target] = advance by cell * 2**level after P[source], rows (n, N), identity below."""
    stays_apart(True)
    n, size = t.sizes[N_STATES], t.sizes[COLUMNS]
    step = t.sizes[AT_STEP] + level * n * size
    for i in range(n):
        for j in range(size):
            total = t.values[row, step + i * size + j] if j >= n else 0.0
            for k in range(n):
                total += t.values[row, step + i * size + k] * P[source, k, j]
            P[target, i, j] = total


@njit
def _fill_fast(t, row, index, P):  # type: ignore[no-untyped-def]
    """Fill what one whole advance needs; P is space for three matrices.

    The n rows of the state's propagator, then per guard its value at the start and, per watched
    interval, the two inner Bezier points of its cubic Hermite interpolant and its end.
    """
    stays_apart(True)
    n, size, W, parts = t.sizes[N_STATES], t.sizes[COLUMNS], t.sizes[GUARDS], t.sizes[PARTS]
    values = t.values
    length = t.sizes[AT_LENGTHS + index]
    per = 1 + 3 * parts
    fast = t.sizes[AT_FAST] + index * (n + W * per) * size
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
        for level in range(t.sizes[POWERS]):
            if (after - before) >> level & 1:
                _after(t, row, level, P, then, spare)
                then, spare = spare, then
        for w in range(W):
            at = fast + (n + w * per) * size
            guard = n * size + w * size
            rate = t.sizes[AT_RATE] + w * size
            for j in range(size):
                start = values[row, guard + j] if j >= n else 0.0
                rise = values[row, rate + j] if j >= n else 0.0
                end, fall = start, rise
                for i in range(n):
                    start += values[row, guard + i] * P[now, i, j]
                    rise += values[row, rate + i] * P[now, i, j]
                    end += values[row, guard + i] * P[then, i, j]
                    fall += values[row, rate + i] * P[then, i, j]
                if part == 0:
                    values[row, at + j] = start
                values[row, at + (1 + 3 * part) * size + j] = start + rise * third
                values[row, at + (2 + 3 * part) * size + j] = end - fall * third
                values[row, at + (3 + 3 * part) * size + j] = end
        now, then = then, now
        before = after
    for i in range(n):
        for j in range(size):
            values[row, fast + i * size + j] = P[now, i, j]


@njit
def meet(plant, v, t, mode):  # type: ignore[no-untyped-def]
    """Fill the tables of a mode of variant v that is met for the first time."""
    stays_apart(True)
    n, size = t.sizes[N_STATES], t.sizes[COLUMNS]
    slots = len(t.values) // len(t.slot_of)
    row = v * slots + t.used[v, 0]
    if t.used[v, 0] < slots:
        t.used[v, 0] += 1
    else:
        # All slots are taken: the one that was filled first goes.
        row = v * slots + t.used[v, 1]
        t.used[v, 1] = (t.used[v, 1] + 1) % slots
        t.slot_of[v, t.plan[row, 0]] = -1
    t.plan[row, 0] = mode
    t.slot_of[v, mode] = row
    _compose(plant, v, t, row, mode)
    P = np.zeros((3, n, size))
    first, second = np.int64(0), np.int64(1)
    step = t.sizes[AT_STEP]
    for i in range(n):
        for j in range(size):
            P[0, i, j] = 1.0 if i == j else 0.0
            t.values[row, step + i * size + j] = P[0, i, j]
    for k in range(1, _SERIES + 1):
        # P[0] = Z P[0] cell / k; the columns of the inputs begin with Z itself.
        for i in range(n):
            for j in range(size):
                total = t.values[row, i * size + j] if k == 1 and j >= n else 0.0
                for m in range(n):
                    total += t.values[row, i * size + m] * P[0, m, j]
                P[1, i, j] = total * t.cell_s[0] / k
        for i in range(n):
            for j in range(size):
                P[0, i, j] = P[1, i, j]
                t.values[row, step + i * size + j] += P[1, i, j]
    for level in range(1, t.sizes[POWERS]):
        before = step + (level - 1) * n * size
        for i in range(n):
            for j in range(size):
                P[0, i, j] = t.values[row, before + i * size + j]
        _after(t, row, level - 1, P, first, second)
        for i in range(n):
            for j in range(size):
                t.values[row, before + (n + i) * size + j] = P[1, i, j]
    for index in range(t.sizes[LENGTHS]):
        _fill_fast(t, row, index, P)
