"""Long traces with fewer samples, and none of their peaks lost."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from threadline.arrays import FloatArray, IntArray


def extremes(columns: FloatArray, stretch: IntArray) -> NDArray[np.bool_]:
    """Return, (n,), where a column of (n, m) is largest or least in its stretch; and both ends."""
    keep = np.zeros(len(columns), dtype=bool)
    keep[[0, -1]] = True
    edges = [0, *(np.flatnonzero(np.diff(stretch)) + 1).tolist(), len(columns)]
    across = np.isfinite(columns).all(axis=0)
    for begin, end in pairwise(edges):
        part = columns[begin:end, across]
        if part.size:
            keep[begin + np.concatenate([part.argmin(axis=0), part.argmax(axis=0)])] = True
    return keep
