"""Exact response of a rigid body with flexible modes to an acceleration command.

A command is piecewise constant, u in [-1, 1] of the machine's acceleration. Ringing is measured as
everywhere in this folder: normalised to one step of full acceleration, envelope at the end of the
command against envelope of the step at its own start, damping held while frequency sweeps.

A command u(t) that ends at T leaves a mode with the pole s at rest if the integral of u e^(s v) is
zero, v = t - T. For a mode much slower than the move, e^(s v) hardly differs from 1 + s v, so that
its real and imaginary parts repeat the conditions on speed and distance, and the remainder drowns
in rounding. With G = (e^(s v) - 1 - s v) / s^2, G2 its real part and G3 its imaginary part over the
imaginary part of s, the two conditions

    integral of u (v - |s|^2 G3) = 0,    integral of u (G2 + Re(s) G3) = 0

are equivalent together with an integral of u that is zero, and stay independent of it however slow
the mode is: they tend to the integrals of u v and u v^2 / 2.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from math import factorial
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from threadline.base.arrays import FloatArray, Locked, read_only
from threadline.errors import OptionError
from threadline.motion.shaping.response import pole
from threadline.motion.shaping.types import FlexibleMode, Shaper

PerMode: TypeAlias = float | Sequence[float]
"""One number for all modes, or one for each in their order."""


_MOST_PERIODS = 100  # beyond which a command is searched on too coarse a grid


@dataclass(frozen=True, slots=True)
class RestToRest:
    """A move from rest to rest.

    Parameters
    ----------
    distance_m, acceleration_m_s2
        Both positive.
    modes
        At least one.

    Raises
    ------
    OptionError
        If a number isn't positive, there is no mode, or the unshaped move lasts more than 100
        periods of the fastest mode.
    """

    distance_m: float
    acceleration_m_s2: float
    modes: tuple[FlexibleMode, ...]

    def __post_init__(self) -> None:
        for name, value in (
            ("distance_m", self.distance_m),
            ("acceleration_m_s2", self.acceleration_m_s2),
        ):
            if not (math.isfinite(value) and value > 0.0):
                raise OptionError(f"rest-to-rest move: {name} must be positive, got {value!r}")
        if not self.modes:
            raise OptionError("rest-to-rest move: at least one flexible mode is needed")
        fastest_hz = max(mode.frequency_hz for mode in self.modes)
        periods = self.rigid_duration_s * fastest_hz
        if periods > _MOST_PERIODS:
            raise OptionError(
                f"rest-to-rest move: unshaped it lasts {self.rigid_duration_s:.4g} s, "
                f"{periods:.4g} periods of the mode at {fastest_hz:g} Hz; limit {_MOST_PERIODS}",
                remedy="Give a shorter move or a higher acceleration: a long move rings as much.",
            )

    @property
    def rigid_duration_s(self) -> float:
        """Duration of the unshaped bang-bang command, 2 sqrt(L / a): no command is faster."""
        return 2.0 * math.sqrt(self.distance_m / self.acceleration_m_s2)


@dataclass(frozen=True, slots=True, eq=False)
class Command(Locked):
    """Piecewise constant acceleration, as a fraction of the full one.

    Parameters
    ----------
    times_s
        Edges, shape ``(n + 1,)``, s, from 0, increasing.
    levels
        Between them, shape ``(n,)``, in [-1, 1] for a command that the machine can follow.
    """

    times_s: FloatArray
    levels: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "times_s", read_only(self.times_s, "times_s", ndim=1))
        object.__setattr__(self, "levels", read_only(self.levels, "levels", ndim=1))
        if len(self.times_s) != len(self.levels) + 1 or bool(np.any(np.diff(self.times_s) <= 0)):
            raise OptionError(
                f"command: {len(self.levels)} levels need {len(self.levels) + 1} increasing edges"
            )

    @property
    def duration_s(self) -> float:
        """From the first edge to the last."""
        return float(self.times_s[-1] - self.times_s[0])

    @property
    def switches_s(self) -> FloatArray:
        """Edges between the first and the last at which the level changes."""
        changed: NDArray[np.bool_] = np.abs(np.diff(self.levels)) > 1e-12
        return self.times_s[1:-1][changed]


def shaped_command(move: RestToRest, shaper: Shaper) -> Command:
    """The unshaped bang-bang command of ``move`` convolved with ``shaper``."""
    half_s = 0.5 * move.rigid_duration_s
    times = np.add.outer(np.array([0.0, half_s, 2.0 * half_s]), shaper.times_s).ravel()
    steps = np.outer(np.array([1.0, -2.0, 1.0]), shaper.amplitudes).ravel()
    order = np.argsort(times, kind="stable")
    times, steps = times[order], steps[order]
    starts = np.concatenate(([0], np.flatnonzero(np.diff(times) > 1e-12) + 1))
    times, steps = times[starts], np.add.reduceat(steps, starts)
    return Command(times, np.cumsum(steps)[:-1])


def ringing(command: Command, frequency_hz: FloatArray, damping_ratio: float) -> FloatArray:
    """Ringing after ``command``, shape ``(m,)``, as a fraction of one full step's ringing.

    Parameters
    ----------
    command
        Acceleration command.
    frequency_hz
        Undamped, Hz, shape ``(m,)``.
    damping_ratio
        Held for all of them.
    """
    rows = ringing_rows(command.times_s, frequency_hz, damping_ratio)
    return np.abs(rows @ command.levels)


def ringing_rows(
    edges_s: FloatArray, frequency_hz: FloatArray, damping_ratio: float
) -> NDArray[np.complex128]:
    """Complex ringing per unit level of each interval, shape ``(m, n)``."""
    s = pole(damping_ratio) * np.asarray(frequency_hz, dtype=np.float64)
    grown: NDArray[np.complex128] = np.exp(np.outer(s, edges_s - edges_s[-1]))
    # A level is a step up at its start and a step down at its end.
    return grown[:, :-1] - grown[:, 1:]


def travel_rows(edges_s: FloatArray) -> FloatArray:
    """Final speed and distance per unit level of each interval and m/s2, shape ``(2, n)``."""
    to_go = edges_s[-1] - edges_s
    return np.array([np.diff(edges_s), -0.5 * np.diff(to_go**2)])


def per_mode(value: PerMode, modes: Sequence[FlexibleMode]) -> tuple[float, ...]:
    """Return a number for every mode: the same for all, or one each.

    Raises
    ------
    OptionError
        If their number is neither one nor the number of modes.
    """
    if isinstance(value, float | int):
        return (float(value),) * len(modes)
    if len(value) != len(modes):
        raise OptionError(f"{len(modes)} modes have {len(value)} numbers")
    return tuple(map(float, value))


def worst_of_each(
    command: Command, modes: Sequence[FlexibleMode], relative: PerMode
) -> list[float]:
    """Largest ringing of every mode over its frequency (1 +- ``relative``), on 201 points."""
    worsts = []
    for mode, half_width in zip(modes, per_mode(relative, modes), strict=True):
        sweep = (
            np.linspace(1.0 - half_width, 1.0 + half_width, 201) if half_width > 0.0 else np.ones(1)
        )
        worsts.append(float(ringing(command, mode.frequency_hz * sweep, mode.damping_ratio).max()))
    return worsts


def worst_ringing(command: Command, modes: Sequence[FlexibleMode], relative: PerMode) -> float:
    """Largest ringing of any mode over its frequency (1 +- ``relative``), on 201 points."""
    return max(worst_of_each(command, modes, relative))


def rings_within(
    command: Command, modes: Sequence[FlexibleMode], relative: PerMode, tolerance: PerMode
) -> bool:
    """Whether every mode rings at most as much as its own tolerance over its own band."""
    worst = worst_of_each(command, modes, relative)
    allowed = per_mode(tolerance, modes)
    return all(
        ringing_found <= most_allowed
        for ringing_found, most_allowed in zip(worst, allowed, strict=True)
    )


def simulate(command: Command, mode: FlexibleMode, acceleration_m_s2: float) -> FloatArray:
    """Distance, speed and relative ringing at the end, shape ``(3,)``, by matrix exponential.

    Independent of the rows above: rigid body and oscillator are integrated together from edge to
    edge.
    """
    w, z = 2.0 * math.pi * mode.frequency_hz, mode.damping_ratio
    # State: position, speed, oscillator q, q'/w, command u; q'' + 2 z w q' + w^2 q = w^2 u.
    matrix = np.zeros((5, 5))
    matrix[0, 1] = 1.0
    matrix[1, 4] = acceleration_m_s2
    matrix[2, 3] = w
    matrix[3, 2:5] = -w, -2.0 * z * w, w
    state = np.zeros(5)
    for (start, end), level in zip(
        itertools.pairwise(command.times_s), command.levels, strict=True
    ):
        state[4] = level
        state = expm(matrix * (end - start)) @ state
    # After the command u is 0: q itself is the deviation.
    damped = math.sqrt(1.0 - z * z)
    envelope = math.hypot(state[2], (state[3] + z * state[2]) / damped) * damped
    return np.array([state[0], state[1], envelope])


_SERIES_BELOW = 1.0
_TERMS = 20
"""Terms of the series for |z| <= 1: the first omitted one is 1 / 22!, 1e-21."""


def conditions(move: RestToRest) -> tuple[float, list[AtRest]]:
    """Return the approximate fastest time with every mode at rest, s, and the conditions."""
    rigid = move.rigid_duration_s
    poles = [pole(m.damping_ratio) * m.frequency_hz for m in move.modes]
    reach_s2 = move.distance_m / move.acceleration_m_s2
    # A slow mode requires an integral of u v^3 of 6 L / (a |s|^2), more than the rigid move has.
    # The best bang-bang command of a duration T reaches at most T^4 / 64.
    slow = [s for s in poles if abs(s) * rigid < _SERIES_BELOW]
    scale = max([rigid, *(float(384.0 * reach_s2 / abs(s) ** 2) ** 0.25 for s in slow)])
    return scale, [AtRest(s, scale, s in slow) for s in poles]


@dataclass(frozen=True, slots=True)
class AtRest:
    """The two conditions of one mode.

    Parameters
    ----------
    pole_1_s
        ``s`` above, 1/s: a pole of the mode times -1, since decay is counted back from the end.
    scale_s
        Approximate duration of the move, s. It makes integrals of the densities dimensionless.
    slow
        Whether the two conditions above are used instead of the ringing itself.
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
            # For a mode about as fast as the move the ringing itself, -s e^(s v), is independent.
            decayed = -(s ** (3 - order)) * np.exp(s * v) - (0.0 if order < 3 else -1.0)
            return np.array([decayed.real, decayed.imag])
        remainder = v**order * _phi(s * v, order)
        condition = remainder.imag / s.imag
        power = v ** (order - 1) / factorial(order - 1)
        return np.array(
            [
                (power - abs(s) ** 2 * condition) / scale**2,
                (remainder.real + s.real * condition) / scale**3,
            ]
        )


def _phi(argument: NDArray[np.complexfloating[Any, Any]], order: int) -> NDArray[np.complex128]:
    """(e^z - 1 - z ... - z^(k-1) / (k-1)!) / z^k for k = ``order``, without cancellation."""
    z = np.asarray(argument, dtype=np.complex128)
    coefficients = [1.0 / factorial(order + k) for k in reversed(range(_TERMS))]
    is_small = np.abs(z) <= _SERIES_BELOW
    series_value = np.polyval(coefficients, np.where(is_small, z, 0.0))
    large_z = np.where(is_small, 1.0, z)
    difference = np.exp(large_z) - sum(large_z**k / factorial(k) for k in range(order))
    return np.where(is_small, series_value, difference / large_z**order)
