"""The response of impulse trains, and their residual vibration.

Frequencies are in units of the modelled one and times in its periods. With s = 2 pi (zeta +
j sqrt(1 - zeta^2)) and d_k = t_k - t_n the response is H(f) = sum A_k exp(s f d_k), and
V = |H|: the decay is counted back from the last impulse.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TypeAlias, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike

from threadline.base.arrays import ComplexArray, FloatArray
from threadline.base.compiled import njit
from threadline.errors import OptionError
from threadline.motion.shaping.types import FlexibleMode, Shaper


def crossing(function: Callable[[float], float], start: float, end: float, *, xtol: float) -> float:
    """Return a root between ``start`` and ``end``, of which one has a positive value.

    Values that are computed in an array have another rounding than single values. If a root is
    close to ``start`` or ``end``, the array may show a change of sign that ``function`` does not
    show. Then the end with the smaller value is returned; it is the root but for rounding.

    >>> round(crossing(lambda x: x * x - 2.0, 1.0, 2.0, xtol=1e-12), 9)
    1.414213562
    >>> crossing(lambda x: x + 1e-17, 0.0, 1.0, xtol=1e-12)
    0.0
    """
    from scipy.optimize import brentq

    start_value, end_value = function(start), function(end)
    if (start_value > 0.0) == (end_value > 0.0):
        return start if abs(start_value) <= abs(end_value) else end
    return float(brentq(function, start, end, xtol=xtol, rtol=1e-15))


ZeroOf: TypeAlias = tuple[float, complex, int]
"""A constraint H = 0: relative frequency, pole, order of the derivative."""


def pole(damping_ratio: float) -> complex:
    """Return 2 pi (zeta + j sqrt(1 - zeta^2)), the negative of a pole of a mode with 1 Hz."""
    return 2.0 * math.pi * complex(damping_ratio, math.sqrt(1.0 - damping_ratio**2))


def response(
    amplitudes: FloatArray, times: FloatArray, frequency: float, s: complex, order: int
) -> complex:
    """Return the derivative of ``order`` of H with respect to the frequency."""
    delay = times - times[-1]
    return complex(np.sum(amplitudes * (s * delay) ** order * np.exp(s * frequency * delay)))


def response_gradient(
    amplitudes: FloatArray, times: FloatArray, frequency: float, s: complex, order: int
) -> tuple[ComplexArray, ComplexArray]:
    """Return the gradients of ``response`` by (n - 1,) later times and by (n,) amplitudes."""
    delay = times - times[-1]
    decay = np.exp(s * frequency * delay)
    power = (s * delay) ** order
    by_delay = amplitudes * s * frequency * power * decay
    if order:
        by_delay = by_delay + amplitudes * order * s * (s * delay) ** (order - 1) * decay
    # A later last time decreases every d_k but the last, which stays 0.
    by_times = by_delay.copy()
    by_times[-1] = -by_delay[:-1].sum()
    return by_times[1:], power * decay


def responses(
    amplitudes: FloatArray, times: FloatArray, frequencies: FloatArray, s: complex
) -> tuple[ComplexArray, ComplexArray]:
    """Return (m,) H at m frequencies, and (m, 2 n - 1) gradients by later times and amplitudes."""
    delay = times - times[-1]
    decay: ComplexArray = np.exp(s * np.outer(frequencies, delay))
    values: ComplexArray = decay @ amplitudes
    by_delay = amplitudes * (s * frequencies)[:, None] * decay
    by_times = np.column_stack([by_delay[:, 1:-1], -by_delay[:, :-1].sum(axis=1)])
    return values, np.hstack((by_times, decay))


def zero_rows(zeros: Sequence[ZeroOf], delay: FloatArray) -> list[ComplexArray]:
    """Return, for each constraint, the (n,) responses to a unit impulse at the (n,) ``delay``.

    A delay is 0 or negative: the time of the impulse minus the time of the last impulse.
    Constraints of modes that nearly coincide are replaced by their divided differences, because a
    program would meet only one of two almost equal rows.
    """
    rows: list[ComplexArray] = []
    previous: tuple[complex, ComplexArray] | None = None
    for f, s, order in sorted(zeros, key=lambda zero: (zero[2], zero[0], zero[1].real)):
        row: ComplexArray = (s * delay) ** order * np.exp(s * f * delay) / (2.0 * np.pi) ** order
        undivided = (s * f, row)
        if order == 0 and previous is not None and 0.0 < abs(previous[0] - s * f) < 1.0:
            row = (row - previous[1]) / abs(previous[0] - s * f)
        previous = undivided if order == 0 else None
        rows.append(row)
    return rows


class Rows:
    """Collects residuals and Jacobian rows of one system of design equations.

    The unknowns are, in this order: the times after the first, the amplitudes if they are free, and
    the frequencies that the design determines.
    """

    def __init__(
        self,
        amplitudes: FloatArray,
        times: FloatArray,
        s: complex,
        *,
        free_amplitudes: bool,
        unknown_frequencies: int,
    ) -> None:
        self._a, self._t, self._s = amplitudes, times, s
        self._free = free_amplitudes
        self._fixed = len(times) - 1 + (len(amplitudes) if free_amplitudes else 0)
        self._columns = self._fixed + unknown_frequencies
        self._residuals: list[float] = []
        self._rows: list[FloatArray] = []

    def _value(
        self, frequency: float, order: int, slot: int | None
    ) -> tuple[complex, ComplexArray]:
        value = response(self._a, self._t, frequency, self._s, order)
        by_times, by_amplitudes = response_gradient(self._a, self._t, frequency, self._s, order)
        row = np.zeros(self._columns, dtype=np.complex128)
        row[: len(by_times)] = by_times
        if self._free:
            row[len(by_times) : self._fixed] = by_amplitudes
        if slot is not None:
            row[self._fixed + slot] = response(self._a, self._t, frequency, self._s, order + 1)
        return value, row

    def _add(self, residual: float, row: FloatArray) -> None:
        self._residuals.append(residual)
        self._rows.append(row)

    def zero(self, frequency: float, slot: int | None = None, *, order: int = 0) -> None:
        """Demand that the derivative of ``order`` of H be 0, real and imaginary part."""
        value, row = self._value(frequency, order, slot)
        self._add(value.real, row.real)
        self._add(value.imag, row.imag)

    def level(self, frequency: float, tolerance: float, slot: int | None = None) -> None:
        """Demand V = tolerance at a frequency."""
        value, row = self._value(frequency, 0, slot)
        self._add(
            abs(value) ** 2 / tolerance - tolerance,
            2.0 * np.real(np.conj(value) * row) / tolerance,
        )

    def flat(self, frequency: float, tolerance: float, slot: int | None = None) -> None:
        """Demand dV/df = 0 at a frequency."""
        value, row = self._value(frequency, 0, slot)
        slope, slope_row = self._value(frequency, 1, slot)
        self._add(
            (value.conjugate() * slope).real / tolerance,
            np.real(np.conj(row) * slope + np.conj(value) * slope_row) / tolerance,
        )

    def unit_sum(self) -> None:
        """Demand that the amplitudes sum to 1."""
        row = np.zeros(self._columns)
        row[len(self._t) - 1 : self._fixed] = 1.0
        self._add(float(self._a.sum()) - 1.0, row)

    def system(self) -> tuple[FloatArray, FloatArray]:
        """Return the (m,) residuals and the (m, n) Jacobian."""
        return np.array(self._residuals), np.array(self._rows)


_F = TypeVar("_F", bound=Callable[..., object])


def compiled(function: _F) -> _F:
    """Compile a function with numba, without a change of its type for mypy."""
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
            # The decay is counted back from the last impulse, so that nothing overflows.
            a = amplitudes[row, k] * math.exp(sigma * (t - last))
            c += a * math.cos(omega_d * t)
            s += a * math.sin(omega_d * t)
        out[i] = math.sqrt(c * c + s * s)


def residual_vibration(
    shaper: Shaper, frequency_hz: ArrayLike, damping_ratio: ArrayLike
) -> FloatArray:
    r"""Return the residual vibration V of ``shaper`` for modes of any frequency and damping.

    Parameters
    ----------
    shaper
        Impulse train of n impulses.
    frequency_hz, damping_ratio
        Undamped frequency, Hz, and damping ratio in [0, 1); broadcast against each other.

    Returns
    -------
    FloatArray
        V of the broadcast shape; 1 is the vibration of one unit impulse.

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
    """Return the residual vibration of m trains on m modes, case by case.

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
        V, shape ``(m,)``, in the convention of :mod:`threadline.motion.shaping.types`.

    Raises
    ------
    OptionError
        If shapes disagree, a frequency is negative or a damping ratio is outside [0, 1).
    """
    # Read-only arrays are copied, because numba would compile a separate version for them.
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
    """Return the residual vibration V of ``shaper`` on one mode; see :func:`residual_vibration`."""
    return float(residual_vibration(shaper, mode.frequency_hz, mode.damping_ratio))


BAND = 0.1
"""Half width of the band over which the shortest type of a firmware must keep ``LEFT``."""
LEFT = 0.05
"""Largest residual V of a firmware's shortest type: the tolerance of the firmwares' EI types."""


def largest_residual(shaper: Shaper, modes: Sequence[FlexibleMode], *, band: float = BAND) -> float:
    """Return the largest residual V of ``shaper`` on ``modes`` over f (1 +- ``band``) of each."""
    return max(
        float(
            residual_vibration(
                shaper,
                mode.frequency_hz * np.linspace(1.0 - band, 1.0 + band, 201),
                mode.damping_ratio,
            ).max()
        )
        for mode in modes
    )
