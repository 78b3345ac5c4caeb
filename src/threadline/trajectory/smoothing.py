"""Motion within the limits of velocity and acceleration -> trajectory within that of jerk too.

The motion is sampled every ``step_s``; every sample is averaged with those before it over
``count`` samples; the averages are the control points of a uniform cubic B-spline in time.
Means of means: where the motion keeps |v| <= V and |a| <= A, so do its averages and the spline,
and the jerk, which is the change of the acceleration over the width of the average, is at most
2 A / (count step_s). No sampling enters these bounds.
"""

from __future__ import annotations

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.durations.smoothing import Smoothing
from threadline.path.bspline import bspline_coefficients


class Smoother:
    """Turns the samples of one motion from rest to rest, in pieces, into spline pieces."""

    def __init__(self, smoothing: Smoothing, start: FloatArray, operation: int) -> None:
        self._count = smoothing.count
        self._lag = (smoothing.count - 1) // 2
        # Before the first sample the axes stand still.
        self._raw = np.tile(start, (self._count - 1, 1))
        self._controls = np.tile(start, (2, 1))
        self._labels = np.full(self._lag + 2, operation, dtype=np.int64)

    def extend(self, samples: FloatArray, operation: IntArray) -> tuple[FloatArray, IntArray]:
        """Return the (n, 4, axes) coefficients and (n,) operations that ``samples`` settle."""
        raw = np.concatenate([self._raw, samples])
        fresh = len(samples)
        mean = np.zeros_like(samples)
        for shift in range(self._count):
            mean += raw[shift : shift + fresh]
        controls = np.concatenate([self._controls, mean / self._count])
        labels = np.concatenate([self._labels, operation])
        self._raw = raw[len(raw) - (self._count - 1) :]
        pieces = len(controls) - 3
        if pieces <= 0:
            self._controls, self._labels = controls, labels
            return np.zeros((0, 4, samples.shape[1])), np.zeros(0, dtype=np.int64)
        self._controls = controls[-3:]
        # Control j averages samples that lie half the width earlier; piece j is between controls
        # j + 1 and j + 2.
        out = labels[2 : 2 + pieces]
        self._labels = labels[pieces:]
        return bspline_coefficients(controls), out

    def finish(self, end: FloatArray, operation: int) -> tuple[FloatArray, IntArray]:
        """Return what is left once the axes stand still at ``end``."""
        count = self._count + 2
        return self.extend(np.tile(end, (count, 1)), np.full(count, operation, dtype=np.int64))
