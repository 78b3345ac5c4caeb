"""Thinning of long traces that keeps their peaks."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from threadline.arrays import FloatArray, IntArray


def envelope(
    time_s: FloatArray, values: FloatArray, stretches: int = 800
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return starts of stretches of time, (k,), and their least and largest values, (k,) each.

    A stretch includes the first value of the next one, so that the drawn bands have no gap. The
    last entry of all three is that of the last sample; NaN is left out.

    Parameters
    ----------
    time_s, values
        (n,) each, times increasing.
    """
    width_s = max(float(time_s[-1] - time_s[0]), 1e-9) / stretches
    number = ((time_s - time_s[0]) / width_s).astype(np.int64)
    starts = np.flatnonzero(np.diff(number, prepend=-1))
    low, high = np.fmin.reduceat(values, starts), np.fmax.reduceat(values, starts)
    low[:-1] = np.fmin(low[:-1], values[starts[1:]])
    high[:-1] = np.fmax(high[:-1], values[starts[1:]])
    return (
        np.append(time_s[starts], time_s[-1]),
        np.append(low, low[-1]),
        np.append(high, high[-1]),
    )


def extremes(columns: FloatArray, stretch: IntArray) -> NDArray[np.bool_]:
    """Return (n,) True where one of the (n, m) ``columns`` is at an extreme of its stretch.

    ``stretch`` is the (n,) number of each row's stretch. The first and the last row are True.
    """
    keep = np.zeros(len(columns), dtype=bool)
    keep[[0, -1]] = True
    edges = [0, *(np.flatnonzero(np.diff(stretch)) + 1).tolist(), len(columns)]
    across = np.isfinite(columns).all(axis=0)
    for begin, end in pairwise(edges):
        part = columns[begin:end, across]
        if part.size:
            keep[begin + np.concatenate([part.argmin(axis=0), part.argmax(axis=0)])] = True
    return keep
