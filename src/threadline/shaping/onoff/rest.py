"""What it takes that a mode is at rest when a command ends, as two real integrals of the command.

A command u(t) that ends at T leaves a mode with the pole s at rest where the integral of
u e^(s v) is zero, v = t - T. For a mode much slower than the move, e^(s v) hardly differs from
1 + s v, so that its real and imaginary parts repeat the conditions on speed and distance and what
is theirs alone drowns in rounding. With G = (e^(s v) - 1 - s v) / s^2, G2 its real part and G3 its
imaginary part over that of s, the two conditions

    integral of u (v - |s|^2 G3) = 0,    integral of u (G2 + Re(s) G3) = 0

say the same together with an integral of u that is zero, and stay apart from it however slow the
mode is: they tend to those of v and v^2 / 2.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import factorial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from threadline.arrays import FloatArray
from threadline.shaping.onoff.body_and_modes import RestToRest
from threadline.shaping.response import pole

_SERIES_BELOW = 1.0
_TERMS = 20
"""Of the series where |z| <= 1: the first one left out is 1 / 22!, 1e-21."""


def conditions(move: RestToRest) -> tuple[float, list[AtRest]]:
    """Return about how long the fastest move with every mode at rest takes, s, and conditions."""
    rigid = move.rigid_duration_s
    poles = [pole(m.damping_ratio) * m.frequency_hz for m in move.modes]
    reach = move.distance_m / move.acceleration_m_s2
    # A slow mode asks for an integral of u v^3 that is 6 L / (a |s|^2): more than the rigid move
    # has. The best bang-bang command of a duration T has at most T^4 / 64 of it.
    slow = [s for s in poles if abs(s) * rigid < _SERIES_BELOW]
    scale = max([rigid, *(float(384.0 * reach / abs(s) ** 2) ** 0.25 for s in slow)])
    return scale, [AtRest(s, scale, s in slow) for s in poles]


@dataclass(frozen=True, slots=True)
class AtRest:
    """The two conditions of one mode.

    Parameters
    ----------
    pole_1_s
        ``s`` above, 1/s: a pole of the mode times -1, since decay is counted back from the end.
    scale_s
        About how long the move takes, s. It makes integrals of the densities dimensionless.
    slow
        Whether the two conditions above are used, and not the ringing itself.
    """

    pole_1_s: complex
    scale_s: float
    slow: bool

    def density(self, before_end_s: FloatArray, derivative: int = 0) -> FloatArray:
        """The factors of u under the two integrals, 1/s, or a derivative, shape ``(2, n)``.

        Parameters
        ----------
        before_end_s
            v = t - T, s, shape ``(n,)``, not above 0.
        derivative
            0 or 1.
        """
        return self._conditions(before_end_s, 2 - derivative)

    def integral(self, before_end_s: FloatArray) -> FloatArray:
        """Antiderivative of :meth:`density` that is 0 at v = 0, shape ``(2, n)``."""
        return self._conditions(before_end_s, 3)

    def _conditions(self, v: FloatArray, order: int) -> FloatArray:
        s, scale = self.pole_1_s, self.scale_s
        if not self.slow:
            # Of a mode about as fast as the move the ringing itself, -s e^(s v), is well apart.
            grown = -(s ** (3 - order)) * np.exp(s * v) - (0.0 if order < 3 else -1.0)
            return np.array([grown.real, grown.imag])
        rest = v**order * _phi(s * v, order)
        third = rest.imag / s.imag
        line = v ** (order - 1) / factorial(order - 1)
        return np.array(
            [(line - abs(s) ** 2 * third) / scale**2, (rest.real + s.real * third) / scale**3]
        )


def _phi(argument: NDArray[np.complexfloating[Any, Any]], order: int) -> NDArray[np.complex128]:
    """(e^z - 1 - z ... - z^(k-1) / (k-1)!) / z^k for k = ``order``, without cancellation."""
    z = np.asarray(argument, dtype=np.complex128)
    coefficients = [1.0 / factorial(order + k) for k in reversed(range(_TERMS))]
    small = np.abs(z) <= _SERIES_BELOW
    near = np.polyval(coefficients, np.where(small, z, 0.0))
    safe = np.where(small, 1.0, z)
    left = np.exp(safe) - sum(safe**k / factorial(k) for k in range(order))
    return np.where(small, near, left / safe**order)
