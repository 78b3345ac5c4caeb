"""Kernels: what happens to a lane now and then - its modes change, it is sampled."""

from __future__ import annotations

import numpy as np
from numba import njit

from threadline.twin.compiled import stays_apart
from threadline.twin.events import DONE, MODE, advance_watched
from threadline.twin.modes import (
    AT_CURRENT,
    AT_FAST,
    AT_LOW,
    COLUMNS,
    DRIVES,
    GUARDS,
    LENGTHS,
    N_STATES,
    PARTS,
    meet,
)
from threadline.twin.shape import LEVEL, PHASE, VOLT


@njit
def leave(w, u, L, v, offsets, cells, plant, t, modes, where, z, y, D, q, tripped):  # type: ignore[no-untyped-def]
    """Advance lane u, modes changing, from z of the workspace to its next state."""
    stays_apart(True)
    before = modes[u]
    where[MODE] = max(before, 0)
    where[DONE] = 0
    q[-1] = 1.0
    n, size, guards = t.sizes[N_STATES], t.sizes[COLUMNS], t.sizes[GUARDS]
    for j in range(size):
        z[j] = w[j * L + u]
    while not advance_watched(t, v, where, z, y, D, q, cells, tripped):
        meet(plant, v, t, where[MODE])
    for i in range(n):
        w[(size + i) * L + u] = z[i]
    if where[MODE] == before:
        return
    modes[u] = where[MODE]
    row = t.slot_of[v, where[MODE]]
    f = t.values
    for g in range(2 * guards):
        w[(offsets[0] + g) * L + u] = f[row, t.sizes[AT_LOW] + g]
    for d in range(t.sizes[DRIVES] * size):
        w[(offsets[2] + d) * L + u] = f[row, t.sizes[AT_CURRENT] + d]
    checks = guards * (1 + 3 * t.sizes[PARTS])
    for x in range(t.sizes[LENGTHS]):
        fast = t.sizes[AT_FAST] + x * (n + checks) * size
        for i in range(n * size):
            w[(offsets[3] + x * n * size + i) * L + u] = f[row, fast + i]
        for i in range(checks * size):
            w[(offsets[4] + x * checks * size + i) * L + u] = f[row, fast + n * size + i]


@njit
def is_outside(w, u, L, sizes, offsets, x):  # type: ignore[no-untyped-def]
    """Whether an advance of length x might leave a guard of lane u."""
    stays_apart(True)
    size, guards = sizes[COLUMNS], sizes[GUARDS]
    per = 1 + 3 * sizes[PARTS]
    for g in range(guards):
        for p in range(per):
            at = offsets[4] + ((x * guards + g) * per + p) * size
            total = w[(at + size - 1) * L + u]
            for j in range(size - 1):
                total += w[(at + j) * L + u] * w[j * L + u]
            if total > w[(offsets[1] + g) * L + u] or total < w[(offsets[0] + g) * L + u]:
                return True
    return False


@njit
def sample(w, L, first, offsets, K, nb, quantised, frame, tripped, peak, out):  # type: ignore[no-untyped-def]
    """Fill a sample of every lane.

    Columns: counts and volts of each controller, load and frame of each axis, current and its
    peak of each drive, every switch.
    """
    stays_apart(True)
    axes = frame.shape[1]
    size = frame.shape[2]
    drives = peak
    C, S, F, CU, PK = offsets[5], offsets[6], offsets[7], offsets[2], offsets[8]
    for u in range(L):
        at = 0
        for c in range(K):
            now = 0.0
            for i in range(nb):
                now += w[(S + c * nb + i) * L + u] * w[i * L + u]
            o = C + 18 * c
            if quantised:
                now = np.floor(now + w[(o + PHASE) * L + u])
            out[at, u] = now
            out[at + 1, u] = w[(o + LEVEL) * L + u] * w[(o + VOLT) * L + u]
            at += 2
        for x in range(axes):
            load = w[(F + x * nb) * L + u] * w[u]
            for i in range(1, nb):
                load += w[(F + x * nb + i) * L + u] * w[i * L + u]
            now = 0.0
            for j in range(size):
                now += frame[first + u, x, j] * w[j * L + u]
            out[at, u] = load
            out[at + 1, u] = now
            at += 2
        for d in range(drives):
            now = 0.0
            for j in range(size):
                now += w[(CU + d * size + j) * L + u] * w[j * L + u]
            kept = w[(PK + d) * L + u]
            out[at, u] = now
            out[at + 1, u] = now if abs(now) > abs(kept) else kept
            w[(PK + d) * L + u] = 0.0
            at += 2
        for s in range(tripped.shape[1]):
            out[at + s, u] = tripped[first + u, s]
