"""Poles and zeros of a loop with its exact dead time: root locus, Routh's array, Newton's method.

Routh's array applies to loops without dead time, or with a Pade approximation of the dead time, as
in textbooks and in the stitcher thesis. ``margins`` has the exact limits of a loop with dead time.

For closed-loop poles, a transport equation on Chebyshev nodes models each delayed signal (Breda,
Maset and Vermiglio, "Pseudospectral differencing methods for characteristic roots of delay
differential equations", SIAM J. Sci. Comput. 27 (2005)). The eigenvalues of this model converge
faster than any power of the number of nodes. Newton's method on ``det(s I - A + B exp(-s tau) K(s)
C) = 0`` then refines each eigenvalue to rounding; an eigenvalue without convergence is dropped.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from threadline.base.arrays import ComplexArray, FloatArray
from threadline.dynamics.loop import Loop
from threadline.dynamics.margins import loop_margins, open_loop_poles
from threadline.dynamics.sampled import DigitalFilter, StateSpace
from threadline.errors import MachineError

_TINY = 1e-12


def routh_array(coefficients: Sequence[float]) -> FloatArray:
    """Return the (n + 1, n // 2 + 1) Routh array of a polynomial, highest power first.

    A row of zeros is replaced by the derivative of the auxiliary polynomial of the row above it. A
    zero in the first column is replaced by a small number with the sign of the number above.

    Raises
    ------
    ValueError
        If the leading coefficient is zero.
    """
    a = np.asarray(coefficients, dtype=np.float64)
    if a.ndim != 1 or not len(a) or a[0] == 0:
        raise ValueError("the leading coefficient of a polynomial must not be zero")
    n = len(a) - 1
    width = n // 2 + 1
    table = np.zeros((n + 1, width))
    table[0, : len(a[0::2])] = a[0::2]
    if n:
        table[1, : len(a[1::2])] = a[1::2]
    size = np.abs(a).max()
    for row in range(1, n + 1):
        if row > 1:
            above, top = table[row - 1], table[row - 2]
            table[row, :-1] = top[1:] - top[0] * above[1:] / above[0]
        scale = _TINY * max(size if row == 1 else np.abs(table[row - 2]).max(), 1e-300)
        if np.all(np.abs(table[row]) <= scale):
            power = n - row + 1
            powers = power - 2 * np.arange(width)
            table[row] = table[row - 1] * np.maximum(powers, 0)
        elif abs(table[row, 0]) <= scale:
            table[row, 0] = np.copysign(scale, table[row - 1, 0])
    return table


def unstable_roots(coefficients: Sequence[float]) -> int:
    """Return the number of roots with positive real part: the sign changes in the first column."""
    first = routh_array(coefficients)[:, 0]
    return int(np.count_nonzero(first[1:] * first[:-1] < 0))


def stable_gains(numerator: FloatArray, denominator: FloatArray) -> tuple[tuple[float, float], ...]:
    """Return the intervals of K > 0 for which ``denominator + K numerator`` is stable.

    Parameters
    ----------
    numerator, denominator
        (n,) and (m,) coefficients of polynomials, highest power first.
    """
    numerator_coefficients, denominator_coefficients = (
        np.asarray(numerator),
        np.asarray(denominator),
    )
    even_top, odd_top = _even_and_odd(numerator_coefficients)
    even_bottom, odd_bottom = _even_and_odd(denominator_coefficients)
    # A root crosses the imaginary axis where bottom(jw) / top(jw) is real; w^2 is then the root of
    # a polynomial.
    crossing = np.polysub(np.polymul(odd_bottom, even_top), np.polymul(even_bottom, odd_top))
    squares = np.roots(np.trim_zeros(crossing, "f")) if np.any(crossing) else np.empty(0)
    limits = [0.0]
    crossing_squares = [s.real for s in squares if s.real > 0 and abs(s.imag) < 1e-6 * abs(s)]
    for omega in [0.0, *np.sqrt(crossing_squares)]:
        numerator_value = np.polyval(numerator_coefficients, 1j * omega)
        if numerator_value != 0:
            gain = -(np.polyval(denominator_coefficients, 1j * omega) / numerator_value).real
            if gain > 0:
                limits.append(float(gain))
    edges = [*sorted(limits), np.inf]
    intervals: list[tuple[float, float]] = []
    for low, high in pairwise(edges):
        if high <= low:
            continue
        if not np.isfinite(high):
            trial_gain = 2.0 * max(low, 0.5)
        else:
            trial_gain = float(np.sqrt(low * high)) if low > 0 else 0.5 * high
        if (
            unstable_roots(
                np.polyadd(denominator_coefficients, trial_gain * numerator_coefficients).tolist()
            )
            == 0
        ):
            if intervals and intervals[-1][1] == low:
                intervals[-1] = (intervals[-1][0], high)
            else:
                intervals.append((low, high))
    return tuple(intervals)


def _even_and_odd(polynomial: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return P, Q in x = w^2 with ``polynomial(jw) = P(x) + jw Q(x)``, highest power first."""
    ascending = polynomial[::-1]
    even = ascending[0::2] * (-1.0) ** np.arange(len(ascending[0::2]))
    odd = ascending[1::2] * (-1.0) ** np.arange(len(ascending[1::2]))
    return even[::-1], odd[::-1] if len(odd) else np.zeros(1)


_NODES = 32
_NEWTON = 25
_SAME_POLE = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Parts:
    """A continuous filter as ``q1 s + q0 + r / (s + p)``, V/count."""

    q1: float
    q0: float
    r: float
    p: float


def closed_poles(loop: Loop, gain: float = 1.0, within_rad_s: float | None = None) -> ComplexArray:
    """Return the (k,) poles of the continuous closed loop, rad/s, rightmost first.

    The dead time is exact.

    Parameters
    ----------
    gain
        Factor on this axis' controller; the other loops of the piece are unchanged.
    within_rad_s
        Largest magnitude of the returned poles. By default it is the resolution of the nodes,
        ``16 / dead time``; without dead time there is no limit.

    Raises
    ------
    MachineError
        If a controller differentiates the output of a plant of relative degree 1: the input would
        act on the derivative of the output without delay.
    """
    plant = loop.measured()
    gains = [1.0] * len(loop.filters)
    gains[loop.index] = gain
    parts = [_partial_fractions(f, g) for f, g in zip(loop.filters, gains, strict=True)]
    if any(p.q1 for p in parts) and np.abs(plant.C @ plant.B).max() > 0:
        raise MachineError(
            f"axis {loop.axis}: its controller differentiates a plant of relative degree 1",
            remedy="Give the driven body an inertia between drive and sensor.",
        )
    delays = loop.delays_s()
    generator = _generator(plant.A, plant.B, plant.C, parts, delays)
    guesses = np.linalg.eigvals(generator)
    longest = float(delays.max(initial=0.0))
    if within_rad_s is None:
        within_rad_s = 0.5 * _NODES / longest if longest > 0 else np.inf
    poles: list[complex] = []
    for guess in guesses[np.abs(guesses) <= within_rad_s]:
        root = _newton(complex(guess), plant.A, plant.B, plant.C, parts, delays)
        if root is None or abs(root) > 1.5 * within_rad_s:
            continue
        if all(abs(root - f) > _SAME_POLE * max(1.0, abs(root)) for f in poles):
            poles.append(root)
    for root in list(poles):
        mirrored = root.conjugate()
        if all(abs(mirrored - f) > _SAME_POLE * max(1.0, abs(root)) for f in poles):
            poles.append(mirrored)
    sorted_poles = sorted(poles, key=lambda s: (-round(s.real, 6), abs(s.imag), -s.imag))
    return np.array(sorted_poles, dtype=np.complex128)


def _partial_fractions(digital: DigitalFilter, gain: float) -> _Parts:
    numerator, denominator = gain * digital.continuous_numerator, digital.continuous_denominator
    quotient, remainder = np.polydiv(numerator, denominator)
    q = np.concatenate([np.zeros(max(0, 2 - len(quotient))), quotient])
    if len(denominator) == 1:
        return _Parts(q1=float(q[0]), q0=float(q[1]), r=0.0, p=0.0)
    return _Parts(
        q1=float(q[0]),
        q0=float(q[1]),
        r=float(remainder[-1] / denominator[0]),
        p=float(denominator[1] / denominator[0]),
    )


def _generator(
    A: FloatArray, B: FloatArray, C: FloatArray, parts: list[_Parts], delays: FloatArray
) -> FloatArray:
    """Return the matrix whose eigenvalues approximate the closed-loop poles."""
    n, m = B.shape
    with_state = [i for i, p in enumerate(parts) if p.r]
    D = _chebyshev(_NODES)
    size = n + len(with_state) + _NODES * int(np.count_nonzero(delays))
    rows = np.zeros((m, size))  # row of each controller's output
    for i, p in enumerate(parts):
        rows[i, :n] = -(p.q0 * C[i] + p.q1 * (C[i] @ A))
    generator = np.zeros((size, size))
    generator[:n, :n] = A
    for k, i in enumerate(with_state):
        row = n + k
        rows[i, row] = parts[i].r
        generator[row, :n] = -C[i]
        generator[row, row] = -parts[i].p
    row = n + len(with_state)
    for i in range(m):
        if delays[i] == 0.0:
            generator[:n] += np.outer(B[:, i], rows[i])
            continue
        scaled = D * (2.0 / delays[i])
        inner = slice(row, row + _NODES)
        generator[inner, inner] = scaled[1:, 1:]
        generator[inner] += np.outer(scaled[1:, 0], rows[i])
        generator[:n, row + _NODES - 1] += B[:, i]
        row += _NODES
    return generator


def _chebyshev(count: int) -> FloatArray:
    """Return the differentiation matrix on nodes from 1 down to -1 (Trefethen's ``cheb``)."""
    x = np.cos(np.pi * np.arange(count + 1) / count)
    c = np.concatenate([[2.0], np.ones(count - 1), [2.0]]) * (-1.0) ** np.arange(count + 1)
    difference = x[:, None] - x[None, :]
    D = np.outer(c, 1.0 / c) / (difference + np.eye(count + 1))
    return np.asarray(D - np.diag(D.sum(axis=1)))


def _newton(
    s: complex, A: FloatArray, B: FloatArray, C: FloatArray, parts: list[_Parts], delays: FloatArray
) -> complex | None:
    """Return the root of the characteristic equation near ``s``; None if Newton fails.

    ``det M`` is multiplied by the controllers' denominators, so that it has no poles.
    """
    eye = np.eye(len(A))
    # Start away from the poles of the controllers, where the equation is undefined.
    s *= 1.0 + 1e-7
    first_guess = s
    for _ in range(_NEWTON):
        delay_factor = np.exp(-s * delays)
        K = np.array([p.q1 * s + p.q0 + (p.r / (s + p.p) if p.r else 0.0) for p in parts])
        slope = np.array([p.q1 - (p.r / (s + p.p) ** 2 if p.r else 0.0) for p in parts])
        M = s * eye - A + (B * (delay_factor * K)) @ C
        M_slope = eye + (B * (delay_factor * (slope - delays * K))) @ C
        try:
            step = np.trace(np.linalg.solve(M, M_slope))
        except np.linalg.LinAlgError:
            return s
        step += sum(1.0 / (s + p.p) for p in parts if p.r)
        if step == 0 or not np.isfinite(step):
            return None
        change = 1.0 / step
        s = s - change
        if abs(change) <= 1e-12 * max(1.0, abs(s)):
            # Ignore a root far from this starting point; another starting point finds it.
            return s if abs(s - first_guess) < 0.3 * max(abs(first_guess), 10.0) else None
    return None


_ZERO = 1e-11


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Chain:
    """Integrations from an input u to an output y: ``y^(degree) = rows[-1] . x + gain u``.

    Parameters
    ----------
    degree
        Relative degree: the order of the lowest derivative of y on which u acts.
    rows
        (degree + 1, n): row k, ``C A^k``, gives the k-th derivative of y without u.
    gain
        ``C A^(degree - 1) B``.
    """

    degree: int
    rows: FloatArray
    gain: float


def chain_of(plant: StateSpace) -> Chain:
    """Return the chain of a plant with one input and one output.

    Raises
    ------
    MachineError
        If the input never reaches the output.
    """
    A, b, row = plant.A, plant.B[:, 0], plant.C[0]
    rows = [row]
    row_size = np.abs(row)
    for degree in range(1, len(A) + 1):
        input_gain = float(row @ b)
        if abs(input_gain) > _ZERO * float(row_size @ np.abs(b)):
            rows.append(row @ A)
            return Chain(degree=degree, rows=np.array(rows), gain=input_gain)
        row, row_size = row @ A, row_size @ np.abs(A)
        rows.append(row)
    raise MachineError(f"{plant.inputs[0]} does not move {plant.outputs[0]}")


def zeros_of(plant: StateSpace) -> ComplexArray:
    """Return the (k,) zeros of a plant with one input and one output, rad/s.

    If the input holds the output constant, the states have the matrix ``A - B C A^r / (C A^(r-1)
    B)``. Its eigenvalues are the zeros of the plant, and r times 0.
    """
    chain = chain_of(plant)
    closed_chain = plant.A - np.outer(plant.B[:, 0], chain.rows[chain.degree]) / chain.gain
    # In the null space of the chain the matrix has only the zeros as eigenvalues; rounding would
    # scatter an r-fold eigenvalue 0.
    scaled = chain.rows[: chain.degree]
    scaled = scaled / np.linalg.norm(scaled, axis=1)[:, None]
    units = np.maximum(np.abs(scaled).max(axis=0), _ZERO)
    _, values, vectors = np.linalg.svd(scaled / units)
    basis = vectors[len(values) :].T / units[:, None]
    if not basis.shape[1]:
        return np.empty(0, dtype=np.complex128)
    basis_inverse = np.linalg.pinv(basis)
    return np.asarray(np.linalg.eigvals(basis_inverse @ closed_chain @ basis), dtype=np.complex128)


_GAIN_COUNT = 160


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RootLocus:
    """Closed-loop poles over the gain of the continuous model.

    Parameters
    ----------
    gains
        (k,) factors on the controller's gain.
    poles
        For each gain, the poles with a magnitude of up to twice the larger of the plant's largest
        pole and five times the crossover; with dead time there are infinitely many further poles.
    now
        Poles at gain 1.
    open_poles, open_zeros
        Open-loop poles of plant and controller, at which the branches begin, and zeros, at which
        they end.
    critical
        Gain and frequency in rad/s of every crossing of the imaginary axis, in increasing gain.
    """

    gains: FloatArray
    poles: tuple[ComplexArray, ...]
    now: ComplexArray
    open_poles: ComplexArray
    open_zeros: ComplexArray
    critical: tuple[tuple[float, float], ...]


def root_locus(loop: Loop, gains: FloatArray | None = None) -> RootLocus:
    """Return the root locus of an axis, with the other loops of its piece closed.

    Parameters
    ----------
    gains
        (k,) factors on the controller's gain; by default from 1/1000 to three times the first
        critical factor (10 if there is none), at least to 3.
    """
    margins = loop_margins(loop, "continuous")
    critical = sorted((c.gain_factor, c.omega_rad_s) for c in margins.phase_crossovers)
    if gains is None:
        highest = max(3.0 * critical[0][0] if critical else 10.0, 3.0)
        gains = np.geomspace(1e-3, highest, _GAIN_COUNT)
    open_poles = open_loop_poles(loop)
    plant_zeros = zeros_of(loop.axis_plant())
    filter_zeros = np.roots(loop.filters[loop.index].continuous_numerator)
    crossing = margins.worst_phase
    fastest = 0.0 if crossing is None else 5.0 * crossing.omega_rad_s
    within_rad_s = 2.0 * max(float(np.abs(loop.plant.poles()).max()), fastest, 1.0)
    return RootLocus(
        gains=np.asarray(gains),
        poles=tuple(closed_poles(loop, float(g), within_rad_s) for g in gains),
        now=closed_poles(loop, 1.0, within_rad_s),
        open_poles=open_poles,
        open_zeros=np.concatenate([plant_zeros, filter_zeros]),
        critical=tuple(critical),
    )
