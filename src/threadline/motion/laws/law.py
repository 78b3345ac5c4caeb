"""Closed forms for motion laws, accurate even where their rise is small.

A form is a rise that begins at rest. Near its beginning the rise is computed as a sum of small
terms and never as a difference of large ones, so that even a tiny rise is right to its last digits.
A law has this accuracy at both ends, because it is evaluated from the nearer end.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from math import comb, cos, factorial, pi, sin
from typing import Protocol

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.errors import OptionError
from threadline.motion.laws.extremes import extremes, refuse_descent, steps

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
    difference = np.asarray(x - np.sin(x))
    is_small = x * x < 1.0
    if is_small.any():
        small_x = x[is_small]
        square = small_x * small_x
        series = np.ones_like(square)
        for factor in reversed(_SERIES):
            series = 1.0 - factor * square * series
        difference[is_small] = small_x * square / 6.0 * series
    return difference


def less_cosine(x: FloatArray) -> FloatArray:
    """Return ``1 - cos x`` without cancellation near 0."""
    half_sine = np.sin(0.5 * x)
    return np.asarray(2.0 * half_sine * half_sine)


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
    """Return the phases with ``v0`` and ``s0`` taken from the end of the previous phase."""
    chained_phases: list[Phase] = []
    v0 = s0 = 0.0
    for phase in phases:
        placed = Phase(
            begin=phase.begin, end=phase.end, c0=phase.c0, c1=phase.c1, b=phase.b, w=phase.w,
            p=phase.p, v0=v0, s0=s0,
        )  # fmt: skip
        length = np.array(phase.end - phase.begin)
        v0, s0 = float(placed.value(length, 1)), float(placed.value(length, 0))
        chained_phases.append(placed)
    return tuple(chained_phases)


@dataclass(frozen=True, slots=True)
class Phases:
    """A rise made of phases."""

    phases: tuple[Phase, ...]

    @property
    def breaks(self) -> tuple[float, ...]:
        """Beginnings of all phases except the first."""
        return tuple(phase.begin for phase in self.phases[1:])

    def value(self, t: FloatArray, derivative: int) -> FloatArray:
        """Return the ``derivative``-th derivative at ``t``; the last phase has no end."""
        begins = np.array([phase.begin for phase in self.phases])
        phase_index = np.clip(np.searchsorted(begins, t, side="right") - 1, 0, len(self.phases) - 1)
        out = np.zeros_like(t)
        for i, phase in enumerate(self.phases):
            in_phase = phase_index == i
            out[in_phase] = phase.value(t[in_phase] - phase.begin, derivative)
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
        top, t_u = factorial(2 * n + 1) / factorial(n) ** 2, t * u
        if derivative == 1:
            return np.asarray(top * t_u**n)
        if derivative == 2:
            return np.asarray(top * n * t_u ** (n - 1) * (u - t))
        bend = (n - 1) * (u - t) ** 2 - 2.0 * t_u
        return np.asarray(top * n * t_u ** (n - 2) * bend)


@dataclass(frozen=True, slots=True)
class Harmonics:
    """A rise whose velocity is ``sum(shares[k] (1 - cos(2 pi orders[k] t)))``."""

    orders: tuple[int, ...]
    shares: tuple[float, ...]

    @property
    def breaks(self) -> tuple[float, ...]:
        """Quarters of the highest harmonic's period, which polynomials of low degree fit well."""
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
    """A piecewise polynomial rise, for a tabulated law or a spline.

    Parameters
    ----------
    begins
        (n,) start of each piece; the first is 0.
    powers
        (n, k) coefficients of each piece, by ascending powers of the time since its start. The
        first piece has no constant and no linear term, so that the rise starts at rest.
    """

    begins: FloatArray
    powers: FloatArray

    @property
    def breaks(self) -> tuple[float, ...]:
        """Beginnings of all pieces except the first."""
        return tuple(self.begins[1:].tolist())

    def value(self, t: FloatArray, derivative: int) -> FloatArray:
        """Return the ``derivative``-th derivative at ``t``."""
        piece = np.clip(np.searchsorted(self.begins, t, side="right") - 1, 0, len(self.begins) - 1)
        derivative_powers = self.powers[piece]
        for _ in range(derivative):
            derivative_powers = derivative_powers[..., 1:] * np.arange(
                1, derivative_powers.shape[-1]
            )
        piece_time = t - self.begins[piece]
        out = np.zeros_like(t)
        for column in range(derivative_powers.shape[-1] - 1, -1, -1):
            out = out * piece_time + derivative_powers[..., column]
        return out


_CELLS = 2048
_ENOUGH = 1e-9  # relative Newton step that ends the iteration; the error is about its square
_ROUNDS = 120


def invert(form: Form, end: float, rise: FloatArray, *, latest: bool = False) -> FloatArray:
    """Return the times in [0, ``end``] at which ``form`` has risen to ``rise``.

    A table of the form brackets each root in at most a 2048th of the time. There Newton's method
    converges in two or three steps; a step that leaves its bracket is replaced by a bisection.

    Parameters
    ----------
    form
        A rise that never goes back.
    rise
        (n,) from 0 to the rise at ``end``.
    latest
        If the form dwells at a rise, return the last time of the dwell and not the first.
    """
    inner = [b for b in form.breaks if 0.0 < b < end]
    grid = np.union1d(np.linspace(0.0, end, _CELLS + 1), inner)
    table = np.maximum.accumulate(form.value(grid, 0))
    upper = np.searchsorted(table, rise, side="right" if latest else "left")
    upper = np.clip(upper, 1, len(grid) - 1)
    low_t, high_t = grid[upper - 1], grid[upper]
    low_rise, high_rise = table[upper - 1], table[upper]
    cell_rise = np.where(high_rise > low_rise, high_rise - low_rise, 1.0)
    share = np.clip((rise - low_rise) / cell_rise, 0.0, 1.0)
    # A rise from rest starts as a power of time; this gives the first guess in the first cell.
    in_first_cell = upper == 1
    if in_first_cell.any():
        half_rise = float(form.value(np.array([0.5 * grid[1]]), 0)[0])
        power = np.log2(table[1] / half_rise) if half_rise > 0.0 and table[1] > half_rise else 1.0
        share[in_first_cell] **= 1.0 / power
    t: FloatArray = np.clip(low_t + share * (high_t - low_t), low_t, high_t)
    active = np.flatnonzero((share > 0.0) & (share < 1.0))
    for _ in range(_ROUNDS):
        if not len(active):
            break
        active_t = t[active]
        residual = form.value(active_t, 0) - rise[active]
        slope = form.value(active_t, 1)
        is_below = residual < 0.0 if not latest else residual <= 0.0
        low_t[active[is_below]] = active_t[is_below]
        high_t[active[~is_below]] = active_t[~is_below]
        lowest, highest = low_t[active], high_t[active]
        with np.errstate(divide="ignore", invalid="ignore"):
            next_t = active_t - residual / slope
        inside = (next_t >= lowest) & (next_t <= highest) & (residual != 0.0)
        next_t = np.where(
            residual == 0.0, active_t, np.where(inside, next_t, 0.5 * (lowest + highest))
        )
        t[active] = next_t
        step = np.abs(next_t - active_t)
        done = (residual == 0.0) | (inside & (step <= _ENOUGH * next_t))
        done |= (highest - lowest) <= 1e-16 * highest
        active = active[~done]
    return t


LEAST_STRETCH = 1e-7
"""Share of the move's time; in a shorter stretch the derivatives are only rounding."""
_SAME = 1e-9  # share of the time: two ends that are closer are one end, computed in two ways
LEAST_HEAT = 12.0  # least integral of the squared acceleration: the cubic law


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Law:
    """A normalised motion from rest to rest: rise 1 in time 1.

    Parameters
    ----------
    name
        Name with hyphens, as on the command line.
    velocity, acceleration, jerk
        Peaks of the magnitudes of the derivatives (Cv, Ca, Cj); None if the jerk is infinite
        because the acceleration steps.
    form
        The rise on [0, ``meets``].
    closing
        The rest of the rise as a function of the rest of the time, on [0, 1 - ``meets``]: the
        motion seen backwards from its end. None if the second half of the motion mirrors the
        first; then ``meets`` is 1/2.
    meets
        Time at which ``form`` hands over to ``closing``.
    """

    name: str
    velocity: float
    acceleration: float
    jerk: float | None
    form: Form
    closing: Form | None = None
    meets: float = 0.5

    def __call__(self, t: FloatArray | float, derivative: int = 0) -> FloatArray:
        """Return the ``derivative``-th derivative (0 to 3) at (n,) times; at rest outside [0, 1].

        At a jump of a derivative, times up to ``meets`` give the value after the jump, and later
        times the value before it. The impulse of jerk at a jump of acceleration is left out.

        Raises
        ------
        ValueError
            If ``derivative`` is not from 0 to 3.
        """
        if not 0 <= derivative <= 3:
            raise ValueError(f"derivative must be 0 to 3, got {derivative}")
        times = np.atleast_1d(np.asarray(t, dtype=np.float64))
        late = times > self.meets
        value = np.empty_like(times)
        value[~late] = self.form.value(np.clip(times[~late], 0.0, self.meets), derivative)
        rest = self.left(np.clip(1.0 - times[late], 0.0, 1.0 - self.meets), derivative)
        if derivative == 0:
            value[late] = 1.0 - rest
            return value
        value[late] = rest if derivative % 2 else -rest
        value[(times < 0.0) | (times > 1.0)] = 0.0
        return value

    def left(self, before_end: FloatArray, derivative: int = 0) -> FloatArray:
        """Return the rest of the rise at (n,) times ``before_end``, counted back from the end.

        ``derivative`` counts derivatives with respect to that time. Close to the end the rest is
        accurate to its last digits, as ``1 - s`` would not be.
        """
        closing = self.form if self.closing is None else self.closing
        return closing.value(before_end, derivative)

    def inverse(self, rise: FloatArray | float) -> FloatArray:
        """Return the (n,) times at which the law has risen to ``rise``, in [0, 1]: s(t(x)) = x.

        If the law dwells at a rise, the earliest time of the dwell is returned.

        Raises
        ------
        ValueError
            If a rise is outside [0, 1].
        OptionError
            If the law goes back somewhere, and so meets a rise more than once.
        """
        refuse_descent(self)
        x = np.atleast_1d(np.asarray(rise, dtype=np.float64))
        if not bool(np.all((x >= 0.0) & (x <= 1.0))):
            first_outside = x[~((x >= 0.0) & (x <= 1.0))][0]
            raise ValueError(f"law {self.name}: a rise must be in [0, 1], got {first_outside}")
        is_early = x <= float(self.form.value(np.array([self.meets]), 0)[0])
        times = np.empty_like(x)
        times[is_early] = invert(self.form, self.meets, x[is_early])
        closing = self.form if self.closing is None else self.closing
        # From 1/2 on, 1 - x is exact, so that the equation is solved for the rest of the rise
        # there.
        times[~is_early] = 1.0 - invert(closing, 1.0 - self.meets, 1.0 - x[~is_early], latest=True)
        return times

    @property
    def edges(self) -> FloatArray:
        """(n,) ends of the stretches on which the law is smooth, from 0 to 1."""
        closing = self.form if self.closing is None else self.closing
        opening_breaks = [b for b in self.form.breaks if 0.0 < b < self.meets]
        closing_breaks = [1.0 - b for b in closing.breaks if 0.0 < b < 1.0 - self.meets]
        ends = [0.0]
        for end in sorted((self.meets, *opening_breaks, *closing_breaks)):
            if min(end - ends[-1], 1.0 - end) > _SAME:
                ends.append(end)
        return np.array([*ends, 1.0])

    @property
    def efficiency(self) -> float:
        """Motor heat with the cubic law, which heats least, divided by the heat with this law.

        Heat is the integral of the squared acceleration of a move over the same distance and time.
        """
        t, weights = gauss(self.edges)
        heat = float(self(t, 2) ** 2 @ weights)
        return LEAST_HEAT / heat


def measured_law(name: str, form: Form, closing: Form | None = None, meets: float = 0.5) -> Law:
    """Return the law of the given forms, with peaks computed from them.

    The arguments are as in ``Law``. The jerk of the law is None if the acceleration jumps.
    """
    unmeasured = Law(
        name=name, velocity=0.0, acceleration=0.0, jerk=None, form=form, closing=closing,
        meets=meets,
    )  # fmt: skip
    peaks = []
    for derivative in (1, 2, 3):
        low, _, high, _ = extremes(unmeasured, derivative)
        peaks.append(max(-low, high))
    return Law(
        name=name, velocity=peaks[0], acceleration=peaks[1],
        jerk=None if steps(unmeasured) else peaks[2], form=form, closing=closing, meets=meets,
    )  # fmt: skip


def gauss(edges: FloatArray, panels: int = 1, points: int = 16) -> tuple[FloatArray, FloatArray]:
    """Return nodes and weights of Gauss-Legendre quadrature between (n,) edges.

    Each stretch between two edges is divided into ``panels`` of ``points`` nodes.
    """
    nodes, weights = _of_one(points)
    parts = np.arange(panels) / panels
    begins = (edges[:-1, None] + np.diff(edges)[:, None] * parts).ravel()
    half = 0.5 * np.diff(np.append(begins, edges[-1]))
    t: FloatArray = ((begins + half)[:, None] + half[:, None] * nodes).ravel()
    return t, (half[:, None] * weights).ravel()


@cache
def _of_one(points: int) -> tuple[FloatArray, FloatArray]:
    """Return nodes and weights on [-1, 1]; cached, because their eigenvalue problem is slow."""
    nodes, weights = np.polynomial.legendre.leggauss(points)
    nodes.flags.writeable = weights.flags.writeable = False
    return nodes, weights


def check_stretches(name: str, ends: Iterable[float]) -> None:
    """Refuse a law with a stretch shorter than ``LEAST_STRETCH``.

    Parameters
    ----------
    ends
        End of each stretch, counted from the beginning of the move or back from its end.

    Raises
    ------
    OptionError
        If a stretch is shorter than ``LEAST_STRETCH``.
    """
    shortest = min((end - begin for begin, end in pairwise((0.0, *ends)) if end > begin), default=1)
    if shortest < LEAST_STRETCH:
        raise OptionError(
            f"motion law {name!r}: a stretch takes {shortest:.3g} of the time, the least is "
            f"{LEAST_STRETCH:g}",
            remedy="Give its stretches lengths that are closer to each other.",
        )
