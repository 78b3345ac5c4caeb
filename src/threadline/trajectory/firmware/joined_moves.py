"""LinuxCNC's naive cam detector: moves at one feed that it takes as a single one.

With Q of G64 (P where Q is not given) a move of X, Y and Z alone goes on from those before it when
each of their ends is within Q of the straight way from the start of the first to its own end
(LinuxCNC 2.9, documents, "G64 Path Blending"; ``emccanon.cc``). At most 101 become one.
"""
# mypy: disable-error-code="no-untyped-def,untyped-decorator"

from __future__ import annotations

import numpy as np

from threadline.compiled import njit

_MOST = 101
_SAME = 1e-9  # share of a feed


@njit()
def joined(start, way, feed, alone, tolerance):
    """Return which of n moves end a single one, (n,) 1 or 0.

    Parameters
    ----------
    start, way : (n, axes)
        Of the moves, mm.
    feed : (n,)
        Speed that F asks for; 0 of a rapid move.
    alone : (n,) bool
        Whether X, Y and Z alone move.
    tolerance : float
        Q.
    """
    count, axes = way.shape
    found = np.ones(count, np.int64)
    first = 0
    for i in range(1, count):
        goes = i - first < _MOST and alone[i] and alone[first] and feed[i] > 0.0
        goes = goes and abs(feed[i] - feed[first]) <= _SAME * feed[first]
        if goes:
            size = 0.0
            for k in range(axes):
                size += (start[i, k] + way[i, k] - start[first, k]) ** 2
            goes = size > 0.0
        j = first
        while goes and j < i:
            share, off = 0.0, 0.0
            for k in range(axes):
                over = start[i, k] + way[i, k] - start[first, k]
                share += over * (start[j, k] + way[j, k] - start[first, k])
            share = min(1.0, max(0.0, share / size))
            for k in range(axes):
                over = start[i, k] + way[i, k] - start[first, k]
                off += (start[j, k] + way[j, k] - start[first, k] - share * over) ** 2
            goes = off <= tolerance * tolerance
            j += 1
        if goes:
            found[i - 1] = 0
        else:
            first = i
    return found
