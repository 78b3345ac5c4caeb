"""The complex response of an impulse train and its derivatives: what designs are solved with.

Frequencies are in units of the modelled one and times in its periods. With s = 2 pi (zeta +
j sqrt(1 - zeta^2)) and d_k = t_k - t_n the response is H(f) = sum A_k exp(s f d_k), and
V = |H|: the decay is counted back from the last impulse.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np

from threadline.arrays import ComplexArray, FloatArray

ZeroOf: TypeAlias = tuple[float, complex, int]
"""A constraint H = 0: relative frequency, pole, order of the derivative."""


def pole(damping_ratio: float) -> complex:
    """Return 2 pi (zeta + j sqrt(1 - zeta^2)): -1 times a pole of a mode of 1 Hz."""
    return 2.0 * math.pi * complex(damping_ratio, math.sqrt(1.0 - damping_ratio**2))


def response(
    amplitudes: FloatArray, times: FloatArray, frequency: float, s: complex, order: int
) -> complex:
    """Derivative of ``order`` of H with respect to the frequency."""
    delay = times - times[-1]
    return complex(np.sum(amplitudes * (s * delay) ** order * np.exp(s * frequency * delay)))


def response_gradient(
    amplitudes: FloatArray, times: FloatArray, frequency: float, s: complex, order: int
) -> tuple[ComplexArray, ComplexArray]:
    """Gradient of that derivative: by the times after the first (n-1,), by the amplitudes (n,)."""
    delay = times - times[-1]
    decay = np.exp(s * frequency * delay)
    power = (s * delay) ** order
    by_delay = amplitudes * s * frequency * power * decay
    if order:
        by_delay = by_delay + amplitudes * order * s * (s * delay) ** (order - 1) * decay
    # d_k falls with the last time for every k but the last, which stays 0.
    by_times = by_delay.copy()
    by_times[-1] = -by_delay[:-1].sum()
    return by_times[1:], power * decay


def responses(
    amplitudes: FloatArray, times: FloatArray, frequencies: FloatArray, s: complex
) -> tuple[ComplexArray, ComplexArray]:
    """H (m,) at many frequencies, and its gradients (m, 2 n - 1) by later times and amplitudes."""
    delay = times - times[-1]
    decay: ComplexArray = np.exp(s * np.outer(frequencies, delay))
    values: ComplexArray = decay @ amplitudes
    by_delay = amplitudes * (s * frequencies)[:, None] * decay
    by_times = np.column_stack([by_delay[:, 1:-1], -by_delay[:, :-1].sum(axis=1)])
    return values, np.hstack((by_times, decay))


def zero_rows(zeros: Sequence[ZeroOf], delay: FloatArray) -> list[ComplexArray]:
    """Return what an impulse at each ``delay`` before the end, (n,), adds to every constraint.

    Constraints of modes that nearly coincide are replaced by their divided differences: two
    small numbers would say the same thing twice, and a program would meet only one of them.
    """
    rows: list[ComplexArray] = []
    before: tuple[complex, ComplexArray] | None = None
    for f, s, order in sorted(zeros, key=lambda zero: (zero[2], zero[0], zero[1].real)):
        row: ComplexArray = (s * delay) ** order * np.exp(s * f * delay) / (2.0 * np.pi) ** order
        plain = (s * f, row)
        if order == 0 and before is not None and 0.0 < abs(before[0] - s * f) < 1.0:
            row = (row - before[1]) / abs(before[0] - s * f)
        before = plain if order == 0 else None
        rows.append(row)
    return rows


class Rows:
    """Collects residuals and Jacobian rows of one system of design equations.

    The unknowns are, in this order: the times after the first, the amplitudes where they are
    free, and the frequencies that the design finds by itself.
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
        """Residuals (m,) and Jacobian (m, n)."""
        return np.array(self._residuals), np.array(self._rows)
