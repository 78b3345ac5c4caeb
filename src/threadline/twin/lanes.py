"""Kernel: one connected piece under its controllers, tick by tick, L variants side by side.

All that a tick touches lies in one workspace with the variants ("lanes") innermost, so that the
common tick - control, one product with a matrix, one comparison of guards - is straight vector
code with sizes known to the compiler. A tick in which a guard may be left goes through
``advance_watched`` for that lane alone. With L = 1 it is the kernel of a single machine: scalar
and batch run the same arithmetic in the same order.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
from numba import njit

from threadline.twin.compiled import stays_apart
from threadline.twin.events import SLOW, TERMS
from threadline.twin.modes import AT_LENGTHS
from threadline.twin.rare import is_outside, leave, sample
from threadline.twin.shape import (
    A1,
    A2,
    B0,
    B1,
    B2,
    E1,
    E2,
    GAIN,
    HEADS,
    HELD,
    HIGH,
    HIGHEST,
    LAST,
    LEVEL,
    LIMIT,
    LOW,
    LOWEST,
    O1,
    O2,
    PHASE,
    SCALE,
    STEP,
    TICK,
    UNTIL_SAMPLE,
    WORST,
    ZERO,
    Shape,
)


@cache
def _sources() -> str:
    """Return a digest of the kernels' sources: numba must not reuse code of older ones."""
    digest = hashlib.sha256()
    for name in ("lanes", "rare", "shape", "events", "modes", "tables", "compiled"):
        digest.update((Path(__file__).parent / f"{name}.py").read_bytes())
    return digest.hexdigest()


def lanes_kernel(shape: Shape, *, fixed: bool) -> Callable[..., None]:
    """Return the kernel for one shape; compiled code is kept on disk.

    Parameters
    ----------
    fixed
        True compiles for this very shape: several times as fast, and seconds of compilation for
        each. False gives the kernel that is compiled once for all shapes with as many lanes.

    Notes
    -----
    Its arguments: first and last block of lanes; the shape's numbers; work (blocks, rows * L); ring
    (blocks, K, R, L) levels in the dead times; modes (blocks, L); clock (blocks, 3 + 2K);
    first_action, actions, length of the schedule; references (ticks, K) counts; every; window:
    first tick of which lowest and highest load are kept; plant and tables; frame (V, axes, N);
    drive (K,) and axis_controller (A,) indices; records (blocks, samples, columns, L), none are
    taken when ``every`` is 0; tripped (V, inputs); counts (blocks, 5), see ``events``.
    """
    return _kernel(shape.lanes, shape.numbers() if fixed else None)


@cache
def _kernel(L: int, numbers: tuple[int, ...] | None) -> Callable[..., None]:  # noqa: PLR0915
    fixed = numbers is not None
    (
        _n,
        _nu,
        _K,
        _A,
        _W,
        _P,
        _T,
        _feedback,
        _second,
        _peak,
        _quantised,
        _delayed,
        _limited,
        _nb,
        _reversal,
        _shared,
        _Y,
        _C,
        _S,
        _M,
        _F,
        _PK,
        _CU,
        _LO,
        _HI,
        _MX,
        _WX,
    ) = numbers or (0,) * 27
    sources = _sources()

    @njit(cache=True, nogil=True)
    def run(  # type: ignore[no-untyped-def]  # noqa: PLR0915
        begin, end, numbers, work, ring, mode, clock, first_action, actions, length, references,
        every, window, plant, t, frame, drive, axis_controller, records, tripped, counts,
    ):  # fmt: skip
        _ = sources
        if not fixed:
            stays_apart(True)
        n = _n if fixed else numbers[0]
        nu = _nu if fixed else numbers[1]
        K = _K if fixed else numbers[2]
        A = _A if fixed else numbers[3]
        W = _W if fixed else numbers[4]
        P = _P if fixed else numbers[5]
        T = _T if fixed else numbers[6]
        feedback = _feedback if fixed else numbers[7]
        second = _second if fixed else numbers[8]
        peak = _peak if fixed else numbers[9]
        quantised = _quantised if fixed else numbers[10]
        delayed = _delayed if fixed else numbers[11]
        limited = _limited if fixed else numbers[12]
        nb = _nb if fixed else numbers[13]
        reversal = _reversal if fixed else numbers[14]
        shared = _shared if fixed else numbers[15]
        Y = _Y if fixed else numbers[16]
        C = _C if fixed else numbers[17]
        S = _S if fixed else numbers[18]
        M = _M if fixed else numbers[19]
        F = _F if fixed else numbers[20]
        PK = _PK if fixed else numbers[21]
        CU = _CU if fixed else numbers[22]
        LO = _LO if fixed else numbers[23]
        HI = _HI if fixed else numbers[24]
        MX = _MX if fixed else numbers[25]
        WX = _WX if fixed else numbers[26]
        N = n + nu + 1
        z = np.zeros(N)
        y = np.zeros(N)
        D = np.zeros((TERMS + 1, n))
        q = np.zeros(TERMS + 2)
        offsets = np.array([LO, HI, CU, MX, WX, C, S, F, PK])
        steps = len(length)
        nothing = np.int64(0)
        for b in range(begin, end):
            w = work[b]
            where = counts[b]
            step = clock[b, STEP]
            row = 0
            taken = 0
            running = True
            if mode[b, 0] < 0:
                for u in range(L):
                    leave(w, u, L, b * L + u, offsets, nothing, plant, t, mode[b], where, z, y,
                           D, q, tripped[b * L + u])  # fmt: skip
            while running:
                for a in range(first_action[step], first_action[step + 1]):
                    what = actions[a, 0]
                    k = actions[a, 1]
                    if what == 0:
                        if row == len(references):
                            running = False
                            break
                        for x in range(A):
                            ref = references[row, axis_controller[x]]
                            m = M + 5 * x
                            if not shared:
                                for u in range(L):
                                    load = w[(F + x * nb) * L + u] * w[u]
                                    for i in range(1, nb):
                                        load += w[(F + x * nb + i) * L + u] * w[i * L + u]
                                    worst = abs(ref * w[(m + SCALE) * L + u] - load)
                                    kept = w[(m + WORST) * L + u]
                                    w[(m + WORST) * L + u] = worst if worst > kept else kept
                            if clock[b, TICK] < window and row < len(references) - 1:
                                continue
                            for u in range(L):
                                load = w[(F + x * nb) * L + u] * w[u]
                                for i in range(1, nb):
                                    load += w[(F + x * nb + i) * L + u] * w[i * L + u]
                                w[(m + LAST) * L + u] = load
                                if clock[b, TICK] >= window:
                                    kept = w[(m + LOWEST) * L + u]
                                    w[(m + LOWEST) * L + u] = load if load < kept else kept
                                    kept = w[(m + HIGHEST) * L + u]
                                    w[(m + HIGHEST) * L + u] = load if load > kept else kept
                        clock[b, TICK] += 1
                        row += 1
                        if every > 0:
                            if clock[b, UNTIL_SAMPLE] == 0:
                                sample(w, L, b * L, offsets, K, nb, quantised, frame, tripped, nu,
                                        records[b, taken])  # fmt: skip
                                taken += 1
                                clock[b, UNTIL_SAMPLE] = every
                            clock[b, UNTIL_SAMPLE] -= 1
                    for c in range(K):
                        # Numbers that the compiler knows not to be negative: indices need no care.
                        if what == 0 or c != k:
                            continue
                        o = C + 18 * c
                        if what == 1:
                            ref = references[row - 1, c]
                            for u in range(L):
                                read = w[(S + c * nb) * L + u] * w[u]
                                for i in range(1, nb):
                                    read += w[(S + c * nb + i) * L + u] * w[i * L + u]
                                if shared:
                                    worst = abs(ref - read)
                                    kept = w[(M + 5 * c + WORST) * L + u]
                                    w[(M + 5 * c + WORST) * L + u] = worst if worst > kept else kept
                                if quantised:
                                    read = np.floor(read + w[(o + PHASE) * L + u])
                                e = ref - read
                                value = w[(o + B0) * L + u] * e
                                value += w[(o + B1) * L + u] * w[(o + E1) * L + u]
                                if feedback:
                                    value -= w[(o + A1) * L + u] * w[(o + O1) * L + u]
                                if second:
                                    value += w[(o + B2) * L + u] * w[(o + E2) * L + u]
                                    value -= w[(o + A2) * L + u] * w[(o + O2) * L + u]
                                    w[(o + E2) * L + u] = w[(o + E1) * L + u]
                                    w[(o + O2) * L + u] = w[(o + O1) * L + u]
                                w[(o + E1) * L + u] = e
                                low = w[(o + LOW) * L + u]
                                high = w[(o + HIGH) * L + u]
                                level = np.rint(value) if quantised else value
                                level = high if level > high else level
                                level = low if level < low else level
                                if feedback or second:
                                    value = high if value > high else value
                                    value = low if value < low else value
                                    w[(o + O1) * L + u] = value
                                if reversal:
                                    level = 0.0 if level * w[(o + LEVEL) * L + u] < 0.0 else level
                                else:
                                    turned = w[(o + ZERO) * L + u] * level * w[(o + LEVEL) * L + u]
                                    level = 0.0 if turned < 0.0 else level
                                w[(o + LEVEL) * L + u] = level
                            if delayed:
                                head = clock[b, HEADS + 2 * c]
                                for u in range(L):
                                    ring[b, c, head, u] = w[(o + LEVEL) * L + u]
                                clock[b, HEADS + 2 * c] = (head + 1) % ring.shape[2]
                        else:
                            if delayed:
                                head = clock[b, HEADS + 2 * c + 1]
                                for u in range(L):
                                    w[(o + HELD) * L + u] = ring[b, c, head, u]
                                clock[b, HEADS + 2 * c + 1] = (head + 1) % ring.shape[2]
                            for d in range(nu):
                                if d != drive[c]:
                                    continue
                                for u in range(L):
                                    held = w[(o + (HELD if delayed else LEVEL)) * L + u]
                                    held *= w[(o + GAIN) * L + u]
                                    if limited:
                                        limit = w[(o + LIMIT) * L + u]
                                        held = limit if held > limit else held
                                        held = -limit if held < -limit else held
                                    w[(n + d) * L + u] = held
                if not running:
                    break
                for x in range(T):
                    if x != length[step]:
                        continue
                    if peak:
                        if W > 0:
                            # Inputs may have jumped: the current belongs to the mode then in force.
                            jumped = np.int64(0)
                            for g in range(W):
                                for u in range(L):
                                    o = WX + (x * W + g) * P * N
                                    now = w[(o + N - 1) * L + u]
                                    for j in range(N - 1):
                                        now += w[(o + j) * L + u] * w[j * L + u]
                                    jumped += np.int64(now > w[(HI + g) * L + u])
                                    jumped += np.int64(now < w[(LO + g) * L + u])
                            if jumped > 0:
                                for u in range(L):
                                    leave(w, u, L, b * L + u, offsets, nothing, plant, t, mode[b],
                                           where, z, y, D, q, tripped[b * L + u])  # fmt: skip
                                    for i in range(n):
                                        w[i * L + u] = w[(Y + i) * L + u]
                        for d in range(nu):
                            for u in range(L):
                                now = w[(CU + d * N + N - 1) * L + u]
                                for j in range(N - 1):
                                    now += w[(CU + d * N + j) * L + u] * w[j * L + u]
                                kept = w[(PK + d) * L + u]
                                w[(PK + d) * L + u] = now if abs(now) > abs(kept) else kept
                    for u in range(L):
                        for i in range(n):
                            o = MX + (x * n + i) * N
                            total = w[(o + N - 1) * L + u]
                            for j in range(N - 1):
                                total += w[(o + j) * L + u] * w[j * L + u]
                            w[(Y + i) * L + u] = total
                    if W > 0:
                        outside = np.int64(0)
                        for g in range(W):
                            for p in range(P):
                                o = WX + ((x * W + g) * P + p) * N
                                for u in range(L):
                                    total = w[(o + N - 1) * L + u]
                                    for j in range(N - 1):
                                        total += w[(o + j) * L + u] * w[j * L + u]
                                    outside += np.int64(total > w[(HI + g) * L + u])
                                    outside += np.int64(total < w[(LO + g) * L + u])
                        if outside > 0:
                            for u in range(L):
                                if is_outside(w, u, L, t.sizes, offsets, x):
                                    where[SLOW] += 1
                                    v = b * L + u
                                    leave(w, u, L, v, offsets, t.sizes[AT_LENGTHS + x], plant, t,
                                           mode[b], where, z, y, D, q, tripped[v])  # fmt: skip
                for i in range(n * L):
                    w[i] = w[Y * L + i]
                if peak:
                    for d in range(nu):
                        for u in range(L):
                            now = w[(CU + d * N) * L + u] * w[u]
                            for j in range(1, N):
                                now += w[(CU + d * N + j) * L + u] * w[j * L + u]
                            kept = w[(PK + d) * L + u]
                            w[(PK + d) * L + u] = now if abs(now) > abs(kept) else kept
                step += 1
                if step == steps:
                    step = 0
            clock[b, STEP] = step

    return run
