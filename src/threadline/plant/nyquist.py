"""The number of unstable poles of a closed loop, counted from its frequency response.

With ``n`` open-loop poles, the closed loop's characteristic function ``prod(s - p_i) (1 + L)``
turns by ``(n - 2 Z) pi / 2`` as ``s`` runs up the imaginary axis from 0, where Z is the number of
its zeros in the right half plane (the argument principle in Mikhailov's form). The dead time of a
strictly proper loop adds no turn at infinity, and poles at 0 need no detour.
"""

from __future__ import annotations

import numpy as np

from threadline.arrays import ComplexArray, FloatArray
from threadline.plant.loop import Loop
from threadline.plant.margins import loop_grid

_FARTHEST = 0.25


def unstable_count(loop: Loop) -> int:
    """Return the number of closed-loop poles with positive real part, continuous, delay exact.

    Raises
    ------
    ValueError
        If the count is not near a whole number, because a pole lies on the imaginary axis.
    """
    poles = open_loop_poles(loop)
    # A zero of the filter at 0 (it acts on speed alone) cancels a pole of the plant at 0.
    numerator = loop.filters[loop.index].continuous_numerator
    hidden = len(numerator) - len(np.trim_zeros(numerator, "b"))
    poles = np.delete(poles, np.flatnonzero(poles == 0.0)[:hidden])
    grid = loop_grid(loop, "continuous")
    return unstable_from(loop.responder("continuous")(grid), grid, poles)


def unstable_from(response: ComplexArray, omega_rad_s: FloatArray, poles: ComplexArray) -> int:
    """Return the count from (k,) values of L on a fine grid and the open loop's (n,) poles.

    Raises
    ------
    ValueError
        If the count is not near a whole number.
    """
    # Each factor turns from its angle at the first frequency to straight up at infinity.
    turned = float(np.angle(1j / (1j * omega_rad_s[0] - poles)).sum())
    around = np.concatenate([1.0 + response, [1.0]])
    turned += float(np.angle(around[1:] / around[:-1]).sum())
    count = (len(poles) - turned * 2.0 / np.pi) / 2.0
    if abs(count - round(count)) > _FARTHEST:
        raise ValueError(f"the response turns by {turned:.4f} rad: a pole lies on the axis")
    return round(count)


def open_loop_poles(loop: Loop) -> ComplexArray:
    """Return the (n,) poles of the plant and of this axis' controller, rad/s; poles near 0 as 0."""
    own = np.roots(loop.filters[loop.index].continuous_denominator)
    found = np.concatenate([loop.plant.poles(), own]).astype(np.complex128)
    size = max(1.0, float(np.abs(found).max()))
    found[np.abs(found) < 1e-6 * size] = 0.0
    return found
