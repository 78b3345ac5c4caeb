"""Divide rows of counts into runs; each run is one line of a trajectory array.

``trajectory_array.py`` explains how a line of ``n`` ticks spreads its remainder. This module is
separate because it loads numba, and few processes write trajectory arrays.
"""

from __future__ import annotations

import numpy as np

from threadline.base.arrays import IntArray
from threadline.base.compiled import njit


@njit()
def _phase(counts: IntArray, begin: int, n: int, axis: int) -> int:
    """Return a phase with which one line gives ``counts[begin:begin + n, axis]``, or -1."""
    total = 0
    for k in range(n):
        total += counts[begin + k, axis]
    remainder = total % n
    speed = (total - remainder) // n
    lowest, highest = 0, n - 1
    travelled = 0
    for k in range(1, n):
        # floor((h + k r) / n) must equal the travel minus k times the speed.
        travelled += counts[begin + k - 1, axis] - speed
        low = n * travelled - k * remainder
        lowest = max(lowest, low)
        highest = min(highest, low + n - 1)
        if lowest > highest:
            return -1
    return lowest


@njit()
def _fits(counts: IntArray, begin: int, n: int, phases: IntArray) -> bool:
    for axis in range(counts.shape[1]):
        phase = _phase(counts, begin, n, axis)
        if phase < 0:
            return False
        phases[axis] = phase
    return True


@njit()
def runs(counts: IntArray, marks: IntArray) -> tuple[IntArray, IntArray, IntArray]:
    """Divide rows into runs for one line each; no run extends across a mark.

    A run extends to the next mark if one line can represent it. Otherwise it is lengthened by steps
    that double as long as one line can represent it, and then by smaller and smaller steps.

    Parameters
    ----------
    counts
        (n, axes) counts to travel in each row.
    marks
        (m,) increasing numbers of rows, from 0 to n, at which a run must end.

    Returns
    -------
    tuple
        (k,) first row and (k,) number of rows of each run, and (k, axes) phases.
    """
    rows, axes = counts.shape
    run_begins = np.empty(rows, np.int64)
    run_lengths = np.empty(rows, np.int64)
    phases = np.empty((rows, axes), np.int64)
    trial_phases = np.empty(axes, np.int64)
    run_count = 0
    for m in range(len(marks) - 1):
        begin, end = marks[m], marks[m + 1]
        try_whole = True
        while begin < end:
            length = end - begin
            if not (try_whole and _fits(counts, begin, length, trial_phases)):
                try_whole = False
                length = 1
                step = 1
                while begin + length + step <= end and _fits(
                    counts, begin, length + step, trial_phases
                ):
                    length += step
                    step *= 2
                while step > 0:
                    if begin + length + step <= end and _fits(
                        counts, begin, length + step, trial_phases
                    ):
                        length += step
                    step //= 2
                _fits(counts, begin, length, trial_phases)
            run_begins[run_count], run_lengths[run_count] = begin, length
            for axis in range(axes):  # numba takes seconds to compile an assignment of a row
                phases[run_count, axis] = trial_phases[axis]
            run_count += 1
            begin += length
    return run_begins[:run_count], run_lengths[:run_count], phases[:run_count]
