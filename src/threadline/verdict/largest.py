"""The largest of many samples, of every axis and run in one pass."""

from __future__ import annotations

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.compiled import njit
from threadline.verdict.samples import lanes


def _largest(
    values: FloatArray, reference: FloatArray, best: FloatArray, at: IntArray, begin: int
) -> None:
    """Raise ``best`` to the largest |values - reference|, ``at`` to the first sample that has it.

    The first of the samples has the number ``begin``; NaN is passed over.
    """
    samples, axes, runs = values.shape
    for i in range(samples):
        for a in range(axes):
            larger = 0
            for r in range(runs):
                larger += abs(values[i, a, r] - reference[i, a]) > best[a, r]
            if larger:  # seldom, once the first few are behind
                for r in range(runs):
                    size = abs(values[i, a, r] - reference[i, a])
                    larger = size > best[a, r]
                    best[a, r] = size if larger else best[a, r]
                    at[a, r] = begin + i if larger else at[a, r]


def _add_squares(values: FloatArray, total: FloatArray) -> None:
    """Add the squares of all samples to ``total``, one after the other."""
    samples, axes, runs = values.shape
    for i in range(samples):
        for a in range(axes):
            for r in range(runs):
                total[a, r] += values[i, a, r] * values[i, a, r]


def _count_beyond(
    values: FloatArray, limit: FloatArray, count: IntArray, first: IntArray, begin: int
) -> None:
    """Count samples of at least ``limit``; ``first`` becomes the first one's number."""
    samples, axes, runs = values.shape
    for i in range(samples):
        for a in range(axes):
            some = 0
            for r in range(runs):
                some += abs(values[i, a, r]) >= limit[a]
            if some:
                for r in range(runs):
                    beyond = abs(values[i, a, r]) >= limit[a]
                    fresh = beyond and count[a, r] == 0
                    first[a, r] = begin + i if fresh else first[a, r]
                    count[a, r] += 1 if beyond else 0


raise_to_farthest = njit(nogil=True)(_largest)
add_squares = njit(nogil=True)(_add_squares)
count_beyond = njit(nogil=True)(_count_beyond)


def largest(values: FloatArray, reference: FloatArray | None = None) -> tuple[FloatArray, IntArray]:
    """Return (axes, runs) largest sizes of (n, runs, axes) values, and the first sample of each.

    Parameters
    ----------
    reference
        (n, axes) that the values are held against; None is 0. Samples that are no number on either
        side are left out; of nothing else the size is minus infinity and the sample -1.
    """
    rows = lanes(values)
    samples, axes, runs = rows.shape
    best, at = np.full((axes, runs), -np.inf), np.full((axes, runs), -1, dtype=np.int64)
    against = np.zeros((samples, axes)) if reference is None else np.ascontiguousarray(reference)
    raise_to_farthest(rows, against, best, at, 0)
    return best, at
