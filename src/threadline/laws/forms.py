"""Closed forms that motion laws are made of, on the first half of the motion."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, sin

import numpy as np

from threadline.arrays import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Phase:
    """A stretch of the motion with the acceleration ``c0 + c1 t + b sin(w t + p)``.

    ``t`` counts from the start of the phase; ``v0`` and ``s0`` are velocity and rise there.
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
        angle = self.w * t + self.p
        swing = self.b / self.w
        if derivative == 0:
            ramp = self.s0 + (self.v0 + swing * cos(self.p)) * t
            power = (self.c0 / 2.0 + self.c1 / 6.0 * t) * t * t
            return np.asarray(ramp + power - swing / self.w * (np.sin(angle) - sin(self.p)))
        if derivative == 1:
            power = (self.c0 + self.c1 / 2.0 * t) * t
            return np.asarray(self.v0 + power + swing * (cos(self.p) - np.cos(angle)))
        if derivative == 2:
            return np.asarray(self.c0 + self.c1 * t + self.b * np.sin(angle))
        return np.asarray(self.c1 + self.b * self.w * np.cos(angle))


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

    def value(self, t: FloatArray, derivative: int) -> FloatArray:
        """Return the ``derivative``-th derivative at ``t`` in [0, 1/2]."""
        begins = np.array([phase.begin for phase in self.phases])
        which = np.clip(np.searchsorted(begins, t, side="right") - 1, 0, len(self.phases) - 1)
        out = np.zeros_like(t)
        for i, phase in enumerate(self.phases):
            here = which == i
            out[here] = phase.value(t[here] - phase.begin, derivative)
        return out


@dataclass(frozen=True, slots=True)
class Power:
    """A rise that is one polynomial, ``sum(coefficients[k] t**k)``."""

    coefficients: tuple[float, ...]

    def value(self, t: FloatArray, derivative: int) -> FloatArray:
        """Return the ``derivative``-th derivative at ``t``."""
        kept = np.polynomial.polynomial.polyder(np.array(self.coefficients), derivative)
        return np.asarray(np.polynomial.polynomial.polyval(t, kept))
