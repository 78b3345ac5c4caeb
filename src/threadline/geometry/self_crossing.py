"""Curves as chords, and the crossings of a chain of chords with itself."""

from __future__ import annotations

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.geometry.curves import Pieces

_MAX_FOUND = 1 << 20
_MAX_PAIRS = 4_000_000_000  # about ten seconds


def flatten(pieces: Pieces, tolerance_m: float) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return chords within ``tolerance_m`` of the curve.

    Returns
    -------
    begin, end
        (m, 2) the ends of each chord, m.
    piece
        (m,) int: the piece that each chord belongs to.

    Notes
    -----
    A chord over a parameter interval h is at most ``h^2 max|p''| / 8`` away from its curve. The
    maximum is taken from 33 samples of each piece and increased by a tenth.
    """
    count = len(pieces)
    index = np.arange(count)
    parts = np.ones(count, dtype=np.int64)
    curved = np.flatnonzero(~pieces.is_line)
    if len(curved):
        u = np.linspace(0.0, 1.0, 33)
        second_derivative = pieces.evaluate(np.repeat(curved, len(u)), np.tile(u, len(curved)), 2)[
            2
        ]
        peak = np.hypot(*second_derivative.T).reshape(len(curved), -1).max(axis=1)
        parts[curved] = np.ceil(np.sqrt(1.1 * peak / (8.0 * tolerance_m))).clip(2, 1 << 20)
    piece = np.repeat(index, parts)
    first = np.repeat(np.cumsum(parts) - parts, parts)
    step = np.arange(len(piece)) - first
    begin = pieces.evaluate(piece, step / parts[piece])[0]
    end = pieces.evaluate(piece, (step + 1) / parts[piece])[0]
    return begin, end, piece


def crossings(
    begin: FloatArray, end: FloatArray, closed: bool
) -> tuple[IntArray, IntArray, FloatArray, FloatArray, bool]:
    """Return the pairs of chords of a chain that cross or touch, except neighbours.

    Parameters
    ----------
    begin, end
        (n, 2) ends of the chords in m; chord i + 1 begins where chord i ends.
    closed
        Whether the last chord is a neighbour of the first.

    Returns
    -------
    first, second
        (m,) int: indices of the two chords, ``first < second``.
    at_first, at_second
        (m,) positions of the crossings on both chords, 0 to 1.
    complete
        False if the search ended early because there were too many pairs.
    """
    # The sweep runs along the axis along which fewer chords overlap.
    overlap = np.abs(end - begin).sum(axis=0) / np.maximum(
        np.ptp(np.concatenate([begin, end]), axis=0), 1e-12
    )
    a, b = (begin, end) if overlap[0] <= overlap[1] else (begin[:, ::-1], end[:, ::-1])
    low = np.minimum(a[:, 0], b[:, 0])
    order = np.argsort(low, kind="stable")
    first, second, at_first, at_second, complete = _sweep(
        np.ascontiguousarray(a), np.ascontiguousarray(b), order, closed, _MAX_FOUND, _MAX_PAIRS
    )
    rank = np.lexsort((second, first))
    return first[rank], second[rank], at_first[rank], at_second[rank], bool(complete)


@njit()
def _sweep(a, b, order, closed, max_found, max_pairs):  # type: ignore[no-untyped-def]
    n = len(a)
    firsts = [0][:0]
    seconds = [0][:0]
    at_firsts = [0.0][:0]
    at_seconds = [0.0][:0]
    complete = True
    pairs = 0
    for k in range(n):
        i = order[k]
        right = max(a[i, 0], b[i, 0])
        bottom, top = min(a[i, 1], b[i, 1]), max(a[i, 1], b[i, 1])
        for m in range(k + 1, n):
            j = order[m]
            if min(a[j, 0], b[j, 0]) > right:
                break
            pairs += 1
            if max(a[j, 1], b[j, 1]) < bottom or min(a[j, 1], b[j, 1]) > top:
                continue
            p, q = min(i, j), max(i, j)
            if q - p <= 1 or (closed and p == 0 and q == n - 1):
                continue
            rx, ry = b[p, 0] - a[p, 0], b[p, 1] - a[p, 1]
            sx, sy = b[q, 0] - a[q, 0], b[q, 1] - a[q, 1]
            dx, dy = a[q, 0] - a[p, 0], a[q, 1] - a[p, 1]
            cross = rx * sy - ry * sx
            size = np.sqrt((rx * rx + ry * ry) * (sx * sx + sy * sy))
            if abs(cross) > 1e-12 * size:
                s = (dx * sy - dy * sx) / cross
                t = (dx * ry - dy * rx) / cross
                if 0.0 <= s <= 1.0 and 0.0 <= t <= 1.0:
                    firsts.append(p)
                    seconds.append(q)
                    at_firsts.append(s)
                    at_seconds.append(t)
            elif abs(dx * ry - dy * rx) <= 1e-12 * (rx * rx + ry * ry) > 0.0:
                # Both chords lie on one line: they overlap if an end of q lies within p. A chord p
                # without length, where a curve turns back on itself, is left to its neighbours,
                # which end there.
                length = rx * rx + ry * ry
                s0 = (dx * rx + dy * ry) / length
                s1 = s0 + (sx * rx + sy * ry) / length
                if max(s0, s1) >= 0.0 and min(s0, s1) <= 1.0:
                    s = min(max(min(s0, s1), 0.0), 1.0)
                    firsts.append(p)
                    seconds.append(q)
                    at_firsts.append(s)
                    at_seconds.append((s - s0) / (s1 - s0) if s1 != s0 else 0.0)
            if len(firsts) >= max_found:
                complete = False
                break
        if pairs > max_pairs:
            complete = False
        if not complete:
            break
    return np.array(firsts), np.array(seconds), np.array(at_firsts), np.array(at_seconds), complete
