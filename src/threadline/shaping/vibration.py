"""Residual vibration of an impulse train: one formula, compiled, for any number of cases."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike

from threadline.arrays import FloatArray
from threadline.compiled import njit
from threadline.errors import OptionError
from threadline.shaping.types import FlexibleMode, Shaper

_F = TypeVar("_F", bound=Callable[..., object])


def compiled(function: _F) -> _F:
    """Compile with numba, keeping the type that mypy knows."""
    return cast("_F", njit()(function))


@compiled
def _vibration_kernel(
    amplitudes: FloatArray,
    times_s: FloatArray,
    frequency_hz: FloatArray,
    damping_ratio: FloatArray,
    out: FloatArray,
) -> None:
    """Fill ``out`` (m,); row i of ``amplitudes`` and ``times_s`` (or row 0) is case i's train."""
    per_case = amplitudes.shape[0] > 1
    for i in range(frequency_hz.shape[0]):
        row = i if per_case else 0
        zeta = damping_ratio[i]
        omega = 2.0 * math.pi * frequency_hz[i]
        sigma = zeta * omega
        omega_d = omega * math.sqrt(1.0 - zeta * zeta)
        last = times_s[row, times_s.shape[1] - 1]
        c = 0.0
        s = 0.0
        for k in range(times_s.shape[1]):
            t = times_s[row, k]
            # The decay is taken from the last impulse back, so that nothing overflows.
            a = amplitudes[row, k] * math.exp(sigma * (t - last))
            c += a * math.cos(omega_d * t)
            s += a * math.sin(omega_d * t)
        out[i] = math.sqrt(c * c + s * s)


def residual_vibration(
    shaper: Shaper, frequency_hz: ArrayLike, damping_ratio: ArrayLike
) -> FloatArray:
    r"""Residual vibration V of ``shaper`` for modes of any frequency and damping.

    Parameters
    ----------
    shaper
        Impulse train of n impulses.
    frequency_hz, damping_ratio
        Undamped frequency, Hz, and damping ratio in [0, 1); broadcast against each other.

    Returns
    -------
    FloatArray
        V of the broadcast shape; 1 is what one unit impulse leaves.

    Raises
    ------
    OptionError
        If a frequency is negative or a damping ratio is outside [0, 1).

    Notes
    -----
    :math:`V = e^{-\zeta\omega t_n}\sqrt{C^2 + S^2}`,
    :math:`C = \sum A_i e^{\zeta\omega t_i}\cos\omega_d t_i`, S likewise with sin: Singer and
    Seering (1990), "Preshaping command inputs to reduce system vibration", ASME JDSMC 112(1).
    """
    f, z = np.broadcast_arrays(
        np.asarray(frequency_hz, dtype=np.float64), np.asarray(damping_ratio, dtype=np.float64)
    )
    flat = residual_vibration_batch(
        shaper.amplitudes[None, :], shaper.times_s[None, :], f.ravel(), z.ravel()
    )
    return flat.reshape(f.shape)


def residual_vibration_batch(
    amplitudes: FloatArray, times_s: FloatArray, frequency_hz: FloatArray, damping_ratio: FloatArray
) -> FloatArray:
    """Residual vibration of m trains on m modes, case by case.

    Parameters
    ----------
    amplitudes, times_s
        Shape ``(m, n)``, or ``(1, n)`` for one train on all the modes; times in s, increasing
        along a row. Pad a shorter train with zero amplitudes at its own last time.
    frequency_hz, damping_ratio
        Shape ``(m,)``; Hz, and in [0, 1).

    Returns
    -------
    FloatArray
        V, shape ``(m,)``, in the convention of :mod:`threadline.shaping.types`.

    Raises
    ------
    OptionError
        If shapes disagree, a frequency is negative or a damping ratio is outside [0, 1).
    """
    # Copies: locked arrays would have machine code of their own.
    a = np.array(amplitudes, dtype=np.float64, order="C")
    t = np.array(times_s, dtype=np.float64, order="C")
    f = np.ascontiguousarray(frequency_hz, dtype=np.float64)
    z = np.ascontiguousarray(damping_ratio, dtype=np.float64)
    if a.ndim != 2 or a.shape != t.shape or f.ndim != 1 or f.shape != z.shape:
        raise OptionError(
            f"residual vibration: shapes {a.shape}, {t.shape}, {f.shape}, {z.shape} do not fit; "
            "wanted (m, n), (m, n), (m,), (m,)"
        )
    if a.shape[0] not in (1, f.shape[0]) or a.shape[1] == 0:
        raise OptionError(f"residual vibration: {a.shape[0]} trains for {f.shape[0]} modes")
    if bool(np.any(~(f >= 0.0))) or bool(np.any(~((z >= 0.0) & (z < 1.0)))):
        raise OptionError(
            "residual vibration: frequencies must be >= 0 Hz and damping ratios in [0, 1)"
        )
    out = np.empty_like(f)
    _vibration_kernel(a, t, f, z, out)
    return out


def vibration_of(shaper: Shaper, mode: FlexibleMode) -> float:
    """Residual vibration V of ``shaper`` on one mode; see :func:`residual_vibration`."""
    return float(residual_vibration(shaper, mode.frequency_hz, mode.damping_ratio))
