"""Exact poles of a loop with dead time: a spectral guess, then Newton's method.

Each delayed signal is carried by a transport equation on Chebyshev nodes (Breda, Maset and
Vermiglio, "Pseudospectral differencing methods for characteristic roots of delay differential
equations", SIAM J. Sci. Comput. 27 (2005)); its eigenvalues converge faster than any power of the
number of nodes. Newton's method on ``det(s I - A + B exp(-s tau) K(s) C) = 0`` then refines each of
them to rounding; a guess from which it does not converge is dropped.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from threadline.arrays import ComplexArray, FloatArray
from threadline.errors import MachineError
from threadline.plant.controllers import DigitalFilter
from threadline.plant.loop import Loop

_NODES = 32
_NEWTON = 25
_SAME = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Parts:
    """A continuous filter as ``q1 s + q0 + r / (s + p)``, V/count."""

    q1: float
    q0: float
    r: float
    p: float


def closed_poles(loop: Loop, gain: float = 1.0, within_rad_s: float | None = None) -> ComplexArray:
    """Return the poles of the continuous closed loop, dead time exact, the rightmost first.

    Parameters
    ----------
    gain
        Factor on this axis' controller; the other loops of the piece stay as they are.
    within_rad_s
        Largest magnitude of the poles; by default what the nodes resolve, ``16 / dead time``, or
        no limit where there is no dead time.

    Raises
    ------
    MachineError
        If a controller differentiates the output of a plant whose input moves it at once (of
        relative degree 1).
    """
    plant = loop.measured()
    gains = [1.0] * len(loop.filters)
    gains[loop.index] = gain
    parts = [_split(f, g) for f, g in zip(loop.filters, gains, strict=True)]
    if any(p.q1 for p in parts) and np.abs(plant.C @ plant.B).max() > 0:
        raise MachineError(
            f"axis {loop.axis}: its controller differentiates a plant that answers at once",
            remedy="Give the driven body an inertia between drive and sensor.",
        )
    delays = loop.delays_s()
    generator = _generator(plant.A, plant.B, plant.C, parts, delays)
    guesses = np.linalg.eigvals(generator)
    longest = float(delays.max(initial=0.0))
    if within_rad_s is None:
        within_rad_s = 0.5 * _NODES / longest if longest > 0 else np.inf
    found: list[complex] = []
    for guess in guesses[np.abs(guesses) <= within_rad_s]:
        root = _newton(complex(guess), plant.A, plant.B, plant.C, parts, delays)
        if root is None or abs(root) > 1.5 * within_rad_s:
            continue
        if all(abs(root - f) > _SAME * max(1.0, abs(root)) for f in found):
            found.append(root)
    for root in list(found):
        mirrored = root.conjugate()
        if all(abs(mirrored - f) > _SAME * max(1.0, abs(root)) for f in found):
            found.append(mirrored)
    ordered = sorted(found, key=lambda s: (-round(s.real, 6), abs(s.imag), -s.imag))
    return np.array(ordered, dtype=np.complex128)


def _split(digital: DigitalFilter, gain: float) -> _Parts:
    top, bottom = gain * digital.continuous_numerator, digital.continuous_denominator
    quotient, rest = np.polydiv(top, bottom)
    q = np.concatenate([np.zeros(max(0, 2 - len(quotient))), quotient])
    if len(bottom) == 1:
        return _Parts(q1=float(q[0]), q0=float(q[1]), r=0.0, p=0.0)
    return _Parts(
        q1=float(q[0]),
        q0=float(q[1]),
        r=float(rest[-1] / bottom[0]),
        p=float(bottom[1] / bottom[0]),
    )


def _generator(
    A: FloatArray, B: FloatArray, C: FloatArray, parts: list[_Parts], delays: FloatArray
) -> FloatArray:
    """Return the matrix whose eigenvalues approximate the poles."""
    n, m = B.shape
    with_state = [i for i, p in enumerate(parts) if p.r]
    D = _chebyshev(_NODES)
    size = n + len(with_state) + _NODES * int(np.count_nonzero(delays))
    rows = np.zeros((m, size))  # output of each controller from the whole state
    for i, p in enumerate(parts):
        rows[i, :n] = -(p.q0 * C[i] + p.q1 * (C[i] @ A))
    generator = np.zeros((size, size))
    generator[:n, :n] = A
    for k, i in enumerate(with_state):
        at = n + k
        rows[i, at] = parts[i].r
        generator[at, :n] = -C[i]
        generator[at, at] = -parts[i].p
    at = n + len(with_state)
    for i in range(m):
        if delays[i] == 0.0:
            generator[:n] += np.outer(B[:, i], rows[i])
            continue
        scaled = D * (2.0 / delays[i])
        inner = slice(at, at + _NODES)
        generator[inner, inner] = scaled[1:, 1:]
        generator[inner] += np.outer(scaled[1:, 0], rows[i])
        generator[:n, at + _NODES - 1] += B[:, i]
        at += _NODES
    return generator


def _chebyshev(count: int) -> FloatArray:
    """Return the differentiation matrix on nodes from 1 down to -1 (Trefethen's ``cheb``)."""
    x = np.cos(np.pi * np.arange(count + 1) / count)
    c = np.concatenate([[2.0], np.ones(count - 1), [2.0]]) * (-1.0) ** np.arange(count + 1)
    difference = x[:, None] - x[None, :]
    D = np.outer(c, 1.0 / c) / (difference + np.eye(count + 1))
    return np.asarray(D - np.diag(D.sum(axis=1)))


def _newton(
    s: complex,
    A: FloatArray,
    B: FloatArray,
    C: FloatArray,
    parts: list[_Parts],
    delays: FloatArray,
) -> complex | None:
    """Return the root of the characteristic equation next to ``s``; None if there is none.

    ``det M`` is multiplied by the controllers' own denominators, so that it has no poles.
    """
    eye = np.eye(len(A))
    # Away from the controllers' own poles, at which the equation is not defined.
    s *= 1.0 + 1e-7
    start = s
    for _ in range(_NEWTON):
        lag = np.exp(-s * delays)
        K = np.array([p.q1 * s + p.q0 + (p.r / (s + p.p) if p.r else 0.0) for p in parts])
        slope = np.array([p.q1 - (p.r / (s + p.p) ** 2 if p.r else 0.0) for p in parts])
        M = s * eye - A + (B * (lag * K)) @ C
        M_slope = eye + (B * (lag * (slope - delays * K))) @ C
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
            # A root far from its guess is found from another guess.
            return s if abs(s - start) < 0.3 * max(abs(start), 10.0) else None
    return None
