"""Stability margins of loops, and stability decisions that do not depend on rounding.

A simple eigenvalue is accurate to a small multiple of the rounding error times the norm of its
matrix. An eigenvalue of a coinciding pair is accurate to the square root of the rounding error
times the norm. Further digits depend on the processor, so no decision may depend on them: an
eigenvalue that is nearer to a boundary than these errors counts as lying on the boundary. Norms are
taken after balancing, which gives states of different units equal weight.

Polynomial methods need a rational approximation of the dead time (Pade), and the polynomial of a
sampled loop has one power of z per tick of dead time. This module avoids both: it evaluates the
exact response on a grid that is refined until neighbours differ by less than 0.1 rad in phase and
0.2 in the logarithm of the magnitude, and then finds every crossing by bisection.

With ``n`` open-loop poles p_i, the phase of the closed loop's characteristic function ``prod(s -
p_i) (1 + L)`` changes by ``(n - 2 Z) pi / 2`` as ``s`` runs up the imaginary axis from 0. Z is the
number of zeros of this function in the right half plane (the argument principle in Mikhailov's
form). The dead time of a strictly proper loop adds no phase at infinity, and poles at 0 need no
detour.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from scipy.linalg import matrix_balance

from threadline.base.arrays import ComplexArray, FloatArray
from threadline.dynamics.loop import Loop, Model

SIMPLE = 1e-11
"""Accuracy of a simple eigenvalue, as a share of the norm: 5e4 times the rounding error."""
DOUBLE = 1e-7
"""Accuracy of a double eigenvalue, as a share of the norm: 7 times the square root of the rounding
error."""

_CIRCLE = 1e-9


def size_of(matrix: FloatArray) -> float:
    """Return the 1-norm of an (n, n) matrix after balancing, in the unit of its eigenvalues."""
    if not matrix.size:
        return 0.0
    balanced = matrix_balance(matrix, permute=False)[0]
    return float(np.abs(balanced).sum(axis=0).max())


def not_decaying(matrix: FloatArray) -> ComplexArray:
    """Return the eigenvalues of ``matrix`` on the imaginary axis or to its right.

    Parameters
    ----------
    matrix
        (n, n) of ``x' = matrix x``, 1/s.

    Returns
    -------
    ComplexArray
        (k,) rad/s, rightmost first: real parts above ``-SIMPLE`` times the norm.
    """
    if not matrix.size:
        return np.empty(0, dtype=np.complex128)
    eigenvalues = np.asarray(np.linalg.eigvals(matrix), dtype=np.complex128)
    undamped = eigenvalues[eigenvalues.real > -SIMPLE * size_of(matrix)]
    return undamped[np.argsort(-undamped.real, kind="stable")]


def swinging(matrix: FloatArray) -> ComplexArray:
    """Return the (k,) complex eigenvalues of an (n, n) matrix in the upper half plane.

    Rounding can give a critically damped pair a small imaginary part. A pair whose imaginary part
    is at most ``DOUBLE`` times the norm therefore counts as real.
    """
    if not matrix.size:
        return np.empty(0, dtype=np.complex128)
    eigenvalues = np.asarray(np.linalg.eigvals(matrix), dtype=np.complex128)
    return eigenvalues[eigenvalues.imag > DOUBLE * size_of(matrix)]


def unstable_eigenvalues(matrix: FloatArray) -> ComplexArray:
    """Return the (k,) eigenvalues of ``x[j+1] = matrix x[j]``, (n, n), outside the unit circle.

    The position in a velocity loop has the eigenvalue 1, which is not an instability. An eigenvalue
    that is outside the circle by at most 1e-9, or by at most ``SIMPLE`` times the norm, counts as
    lying on the circle.
    """
    eigenvalues = np.asarray(np.linalg.eigvals(matrix), dtype=np.complex128)
    return eigenvalues[np.abs(eigenvalues) > 1.0 + max(_CIRCLE, SIMPLE * size_of(matrix))]


Response: TypeAlias = Callable[[FloatArray], ComplexArray]

_MAX_STEP = 0.1
_REFINEMENTS = 14
_MOST_POINTS = 400_000
_START_POINTS = 600
_NEGLIGIBLE = 1e-3
_HALVINGS = 48  # number of halvings of a grid interval: down to the last digits of a double
_LEAST_MAGNITUDE = 1e-9  # a smaller gain is a rounding error, without a meaningful phase or slope


@dataclass(frozen=True, slots=True, kw_only=True)
class GainCrossover:
    """A frequency at which the loop gain is 1, and the phase margin there."""

    omega_rad_s: float
    phase_margin_deg: float


@dataclass(frozen=True, slots=True, kw_only=True)
class PhaseCrossover:
    """A frequency at which the phase of the loop is -180 degrees, and 1 / gain there."""

    omega_rad_s: float
    gain_factor: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Margins:
    """All crossovers of a loop, in order of frequency.

    Parameters
    ----------
    modulus_margin
        Smallest distance of the response from -1.
    """

    gain_crossovers: tuple[GainCrossover, ...]
    phase_crossovers: tuple[PhaseCrossover, ...]
    modulus_margin: float

    @property
    def worst_phase(self) -> GainCrossover | None:
        """The gain crossover with the phase nearest to -180 degrees; None if the gain is never 1.

        A conditionally stable loop may have a negative margin there: additional phase lead of this
        size, instead of lag, would then bring the loop to its stability limit.
        """
        return min(self.gain_crossovers, key=lambda c: abs(c.phase_margin_deg), default=None)

    @property
    def raise_to(self) -> float | None:
        """Smallest factor above 1 on the gain that gives a loop at its stability limit, or None."""
        return min(
            (c.gain_factor for c in self.phase_crossovers if c.gain_factor > 1), default=None
        )

    @property
    def lower_to(self) -> float | None:
        """Largest factor below 1 on the gain that gives a loop at its stability limit, or None."""
        return max(
            (c.gain_factor for c in self.phase_crossovers if c.gain_factor <= 1), default=None
        )

    def gain_margin(self, stable: bool) -> float | None:
        """Return the factor on the gain at which stability changes; None if it never changes.

        For a stable loop the factor is above 1 (a conditionally stable loop also has a limit below
        1, ``lower_to``). For an unstable loop that a lower gain stabilises it is below 1.
        """
        first, second = (self.raise_to, self.lower_to) if stable else (self.lower_to, self.raise_to)
        return first if first is not None or stable else second

    @property
    def delay_margin_s(self) -> float | None:
        """Smallest additional dead time, s, with which a stable loop is at its limit; or None."""
        return min(
            (np.radians(c.phase_margin_deg % 360.0) / c.omega_rad_s for c in self.gain_crossovers),
            default=None,
        )


def refined_grid(
    response: Response, low: float, high: float, also: Iterable[float] = ()
) -> FloatArray:
    """Return (n,) frequencies, rad/s, from ``low`` to ``high``, dense where ``response`` is steep.

    A response with a magnitude below 1e-9 is rounding noise, and the grid is not refined there.

    Parameters
    ----------
    response
        Function from (k,) rad/s to (k,) complex values.
    also
        Additional frequencies of the grid, such as resonances.
    """
    resonances = [w for w in also if low < w < high]
    grid = np.unique(np.concatenate([np.geomspace(low, high, _START_POINTS), resonances]))
    values = response(grid)
    for _ in range(_REFINEMENTS):
        magnitude = np.abs(values)
        unit = values / np.maximum(magnitude, _LEAST_MAGNITUDE)
        phase_step = np.abs(np.angle(unit[1:] * unit[:-1].conj()))
        log_step = np.abs(np.diff(_log(magnitude)))
        coarse = (phase_step > _MAX_STEP) | (log_step > 2 * _MAX_STEP)
        coarse &= np.maximum(magnitude[1:], magnitude[:-1]) > _LEAST_MAGNITUDE
        if not coarse.any() or len(grid) > _MOST_POINTS:
            break
        middle = np.sqrt(grid[:-1] * grid[1:])[coarse]
        grid = np.concatenate([grid, middle])
        values = np.concatenate([values, response(middle)])
        order = np.argsort(grid)
        grid, values = grid[order], values[order]
    return np.asarray(grid)


def margins_of(response: Response, grid: FloatArray) -> Margins:
    """Return every crossover of ``response`` on a (k,) grid, rad/s, each refined to 1e-12.

    A phase crossover with a gain below 1e-9 is rounding noise and is ignored.
    """
    values = response(grid)
    log_gain = _log(np.abs(values))
    crosses = (log_gain[:-1] * log_gain[1:] <= 0) & ((log_gain[:-1] != 0.0) | (log_gain[1:] != 0.0))
    omegas = _roots(lambda w: _log(np.abs(response(w))), grid[:-1][crosses], grid[1:][crosses])
    angle = np.degrees(np.angle(-response(omegas))) if len(omegas) else omegas
    gains = [
        GainCrossover(omega_rad_s=float(w), phase_margin_deg=float(p))
        for w, p in zip(omegas, angle, strict=True)
    ]
    crosses = (values.imag[:-1] * values.imag[1:] <= 0) & (values.real[:-1] + values.real[1:] < 0)
    omegas = _roots(lambda w: response(w).imag, grid[:-1][crosses], grid[1:][crosses])
    crossover_values = response(omegas) if len(omegas) else np.empty(0, dtype=np.complex128)
    phases = [
        PhaseCrossover(omega_rad_s=float(w), gain_factor=float(1.0 / abs(v)))
        for w, v in zip(omegas, crossover_values, strict=True)
        if v.real < -_LEAST_MAGNITUDE
    ]
    return Margins(
        gain_crossovers=tuple(gains),
        phase_crossovers=tuple(phases),
        modulus_margin=float(np.abs(1.0 + values).min()),
    )


def _log(size: FloatArray) -> FloatArray:
    """Return the logarithm of (n,) magnitudes, clamped to at least ``_LEAST_MAGNITUDE``."""
    return np.asarray(np.log(np.maximum(size, _LEAST_MAGNITUDE)))


def _roots(
    function: Callable[[FloatArray], FloatArray], low: FloatArray, high: FloatArray
) -> FloatArray:
    """Return a root of ``function`` between each pair of (n,) ``low`` and ``high``, by bisection.

    All intervals are halved together: a loop with dead time and a high gain has tens of thousands
    of crossings, which would take minutes one by one. If the function does not change its sign in
    an interval, its root is at an end, or within rounding of an end: ``low`` if the function is 0
    there, else ``high``.
    """
    if not len(low):
        return low
    first, last = function(low), function(high)
    bracketed = first * last < 0
    a, b = low[bracketed], high[bracketed]
    falling = first[bracketed] > 0
    for _ in range(_HALVINGS if len(a) else 0):
        middle = 0.5 * (a + b)
        above = (function(middle) > 0) == falling
        a, b = np.where(above, middle, a), np.where(above, b, middle)
    roots = np.where(first == 0.0, low, high)
    roots[bracketed] = 0.5 * (a + b)
    return roots


def loop_grid(loop: Loop, model: Model = "sampled") -> FloatArray:
    """Return (n,) frequencies in rad/s for the analysis of a loop.

    They begin a thousand times below the plant's slowest pole other than 0 (at most 10 rad/s). They
    end at the Nyquist frequency of the controller (sampled), or where the gain is below 1/1000
    (continuous).
    """
    response = loop.responder(model)
    poles = np.abs(loop.plant.poles())
    moving = poles[poles > 1e-6 * max(poles.max(), 1.0)]
    slowest = float(moving.min()) if len(moving) else 1.0
    low = 1e-3 * min(slowest, 10.0)
    if model == "sampled":
        high = np.pi / loop.period_s * (1 - 1e-9)
    else:
        high = max(10.0 * float(poles.max()), 100.0)
        while abs(response(np.array([high]))[0]) > _NEGLIGIBLE and high < 1e7:
            high *= 2.0
    resonances = [float(abs(p.imag)) for p in loop.plant.poles() if p.imag > 0]
    return refined_grid(response, low, high, resonances)


def loop_margins(loop: Loop, model: Model = "sampled") -> Margins:
    """Return the margins of a loop."""
    return margins_of(loop.responder(model), loop_grid(loop, model))


def bandwidth_rad_s(closed: Response, grid: FloatArray) -> float | None:
    """Return the lowest frequency, rad/s, at which ``closed`` is 3 dB below its value at grid[0].

    The result is None if it never falls so low.
    """
    values = np.abs(closed(grid))
    level = values[0] / np.sqrt(2.0)
    below = np.nonzero(values < level)[0]
    if not len(below):
        return None
    k = int(below[0])
    interval = grid[k - 1 : k + 1]
    return float(_roots(lambda w: np.abs(closed(w)) - level, interval[:1], interval[1:])[0])


_MAX_COUNT_ERROR = 0.25


def unstable_count(loop: Loop) -> int:
    """Return the number of unstable closed-loop poles of the continuous model, delay exact.

    Raises
    ------
    ValueError
        If the count is not near a whole number, because a pole lies on the imaginary axis.
    """
    poles = open_loop_poles(loop)
    # A zero of the filter at 0 (a controller of speed only) cancels a pole of the plant at 0.
    numerator = loop.filters[loop.index].continuous_numerator
    cancelled = len(numerator) - len(np.trim_zeros(numerator, "b"))
    poles = np.delete(poles, np.flatnonzero(poles == 0.0)[:cancelled])
    grid = loop_grid(loop, "continuous")
    return unstable_from(loop.responder("continuous")(grid), grid, poles)


def unstable_from(response: ComplexArray, omega_rad_s: FloatArray, poles: ComplexArray) -> int:
    """Return the number of unstable poles, from (k,) values of L and the (n,) open-loop poles.

    Raises
    ------
    ValueError
        If the count is not near a whole number.
    """
    # The phase of each factor changes from its value at the first frequency to pi/2 at infinity.
    turned_rad = float(np.angle(1j / (1j * omega_rad_s[0] - poles)).sum())
    closed_path = np.concatenate([1.0 + response, [1.0]])
    turned_rad += float(np.angle(closed_path[1:] / closed_path[:-1]).sum())
    count = (len(poles) - turned_rad * 2.0 / np.pi) / 2.0
    if abs(count - round(count)) > _MAX_COUNT_ERROR:
        raise ValueError(f"the response turns by {turned_rad:.4f} rad: a pole lies on the axis")
    return round(count)


def open_loop_poles(loop: Loop) -> ComplexArray:
    """Return the (n,) poles of plant and axis controller, rad/s; a pole near 0 is returned as 0."""
    filter_poles = np.roots(loop.filters[loop.index].continuous_denominator)
    poles = np.concatenate([loop.plant.poles(), filter_poles]).astype(np.complex128)
    size = max(1.0, float(np.abs(poles).max()))
    poles[np.abs(poles) < 1e-6 * size] = 0.0
    return poles
