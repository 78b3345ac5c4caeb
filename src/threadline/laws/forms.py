"""Closed forms of which motion laws are made, accurate where their rise is small.

A form is a rise that begins at rest. Near its beginning it is computed as a sum of small terms and
never as the difference of large ones, so that even a tiny rise is right to its last digits. A law
keeps that accuracy at both ends, since it is evaluated from the nearer one.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import comb, cos, factorial, pi, sin
from typing import Protocol

import numpy as np

from threadline.arrays import FloatArray

_SERIES = tuple(1.0 / ((2 * k + 2) * (2 * k + 3)) for k in range(1, 9))


class Form(Protocol):
    """A rise from rest."""

    @property
    def breaks(self) -> tuple[float, ...]:
        """Times at which one smooth stretch ends and the next begins, without 0 and the end."""
        ...

    def value(self, t: FloatArray, derivative: int) -> FloatArray:
        """Return the ``derivative``-th derivative (0 to 3) at ``t``, of any shape."""
        ...


def less_sine(x: FloatArray) -> FloatArray:
    """Return ``x - sin x`` without cancellation near 0."""
    found = np.asarray(x - np.sin(x))
    near = x * x < 1.0
    if near.any():
        small = x[near]
        square = small * small
        series = np.ones_like(square)
        for factor in reversed(_SERIES):
            series = 1.0 - factor * square * series
        found[near] = small * square / 6.0 * series
    return found


def less_cosine(x: FloatArray) -> FloatArray:
    """Return ``1 - cos x`` without cancellation near 0."""
    half = np.sin(0.5 * x)
    return np.asarray(2.0 * half * half)


@dataclass(frozen=True, slots=True, kw_only=True)
class Phase:
    """A stretch of the motion with the acceleration ``c0 + c1 t + b sin(w t + p)``.

    ``t`` counts from the start of the phase; ``v0`` and ``s0`` are the velocity and the rise at
    that start. The phase lasts from ``begin`` to ``end`` of the whole motion, which takes 1.
    """

    begin: float
    end: float
    c0: float = 0.0
    c1: float = 0.0
    b: float = 0.0
    w: float = 1.0
    p: float = 0.0
    v0: float = 0.0
    s0: float = 0.0

    def value(self, t: FloatArray, derivative: int) -> FloatArray:
        """Return the ``derivative``-th derivative of the rise at ``t`` from the phase's start."""
        angle = self.w * t
        # b sin(wt + p) = rising sin(wt) + standing cos(wt), each integrated without cancellation.
        rising, standing = self.b * cos(self.p), self.b * sin(self.p)
        if derivative == 0:
            power = (self.c0 / 2.0 + self.c1 / 6.0 * t) * t * t
            swing = (rising * less_sine(angle) + standing * less_cosine(angle)) / self.w**2
            return np.asarray(self.s0 + (self.v0 * t + (power + swing)))
        if derivative == 1:
            power = (self.c0 + self.c1 / 2.0 * t) * t
            swing = (rising * less_cosine(angle) + standing * np.sin(angle)) / self.w
            return np.asarray(self.v0 + (power + swing))
        if derivative == 2:
            return np.asarray(self.c0 + self.c1 * t + self.b * np.sin(angle + self.p))
        return np.asarray(self.c1 + self.b * self.w * np.cos(angle + self.p))


def chained(phases: list[Phase]) -> tuple[Phase, ...]:
    """Return the phases with ``v0`` and ``s0`` of each at the end of the one before."""
    done: list[Phase] = []
    v0 = s0 = 0.0
    for phase in phases:
        placed = Phase(
            begin=phase.begin, end=phase.end, c0=phase.c0, c1=phase.c1, b=phase.b, w=phase.w,
            p=phase.p, v0=v0, s0=s0,
        )  # fmt: skip
        length = np.array(phase.end - phase.begin)
        v0, s0 = float(placed.value(length, 1)), float(placed.value(length, 0))
        done.append(placed)
    return tuple(done)


@dataclass(frozen=True, slots=True)
class Phases:
    """A rise made of phases."""

    phases: tuple[Phase, ...]

    @property
    def breaks(self) -> tuple[float, ...]:
        """Begins of all phases but the first."""
        return tuple(phase.begin for phase in self.phases[1:])

    def value(self, t: FloatArray, derivative: int) -> FloatArray:
        """Return the ``derivative``-th derivative at ``t``; the last phase has no end."""
        begins = np.array([phase.begin for phase in self.phases])
        which = np.clip(np.searchsorted(begins, t, side="right") - 1, 0, len(self.phases) - 1)
        out = np.zeros_like(t)
        for i, phase in enumerate(self.phases):
            here = which == i
            out[here] = phase.value(t[here] - phase.begin, derivative)
        return out


@dataclass(frozen=True, slots=True)
class Rest:
    """The polynomial of degree ``2 n + 1`` whose first ``n`` derivatives vanish at both ends.

    With u = 1 - t it is ``t**(n+1) sum(comb(n+k, k) u**k, k = 0 ... n)``, a sum of positive terms,
    and its velocity is ``(2n+1)! / n!**2 (t u)**n``.
    """

    n: int

    @property
    def breaks(self) -> tuple[float, ...]:
        """Empty: the polynomial is smooth throughout."""
        return ()

    def value(self, t: FloatArray, derivative: int) -> FloatArray:
        """Return the ``derivative``-th derivative at ``t``."""
        n, u = self.n, 1.0 - t
        if derivative == 0:
            total = np.zeros_like(t)
            for k in range(n, -1, -1):
                total = total * u + comb(n + k, k)
            return np.asarray(t ** (n + 1) * total)
        top, both = factorial(2 * n + 1) / factorial(n) ** 2, t * u
        if derivative == 1:
            return np.asarray(top * both**n)
        if derivative == 2:
            return np.asarray(top * n * both ** (n - 1) * (u - t))
        bend = (n - 1) * (u - t) ** 2 - 2.0 * both
        return np.asarray(top * n * both ** (n - 2) * bend)


@dataclass(frozen=True, slots=True)
class Harmonics:
    """A rise whose velocity is ``sum(shares[k] (1 - cos(2 pi orders[k] t)))``."""

    orders: tuple[int, ...]
    shares: tuple[float, ...]

    @property
    def breaks(self) -> tuple[float, ...]:
        """Quarters of the highest harmonic's period, within which low-degree polynomials fit it."""
        count = 2 * self.orders[-1]
        return tuple(k / (2.0 * count) for k in range(1, count))

    def value(self, t: FloatArray, derivative: int) -> FloatArray:
        """Return the ``derivative``-th derivative at ``t``."""
        out = np.zeros_like(t)
        for order, share in zip(self.orders, self.shares, strict=True):
            w = 2.0 * pi * order
            if derivative == 0:
                out = out + share / w * less_sine(w * t)
            elif derivative == 1:
                out = out + share * less_cosine(w * t)
            elif derivative == 2:
                out = out + share * w * np.sin(w * t)
            else:
                out = out + share * w * w * np.cos(w * t)
        return out


@dataclass(frozen=True, slots=True, eq=False)
class Pieces:
    """A piecewise polynomial rise, as of a tabulated law or a spline.

    Parameters
    ----------
    begins
        (n,) start of each piece; the first is 0.
    powers
        (n, k) coefficients of each piece, by rising powers of the time since its start. The first
        piece has no constant and no linear term, so that the rise starts at rest.
    """

    begins: FloatArray
    powers: FloatArray

    @property
    def breaks(self) -> tuple[float, ...]:
        """Begins of all pieces but the first."""
        return tuple(self.begins[1:].tolist())

    def value(self, t: FloatArray, derivative: int) -> FloatArray:
        """Return the ``derivative``-th derivative at ``t``."""
        which = np.clip(np.searchsorted(self.begins, t, side="right") - 1, 0, len(self.begins) - 1)
        kept = self.powers[which]
        for _ in range(derivative):
            kept = kept[..., 1:] * np.arange(1, kept.shape[-1])
        since = t - self.begins[which]
        out = np.zeros_like(t)
        for column in range(kept.shape[-1] - 1, -1, -1):
            out = out * since + kept[..., column]
        return out
