"""What an acceleration command does to a rigid body with flexible modes, exactly.

A command is piecewise constant, u in [-1, 1] of the machine's acceleration. Ringing is measured
as everywhere in this folder: normalised to one step of full acceleration, envelope at the end of
the command against envelope of the step at its own start, damping held while frequency sweeps.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from threadline.arrays import FloatArray, Locked, read_only
from threadline.errors import OptionError
from threadline.shaping.response import pole
from threadline.shaping.types import FlexibleMode, Shaper

PerMode: TypeAlias = float | Sequence[float]
"""One number for all modes, or one for each in their order."""


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
        If a number isn't positive or there is no mode.
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
    half = 0.5 * move.rigid_duration_s
    times = np.add.outer(np.array([0.0, half, 2.0 * half]), shaper.times_s).ravel()
    steps = np.outer(np.array([1.0, -2.0, 1.0]), shaper.amplitudes).ravel()
    order = np.argsort(times, kind="stable")
    times, steps = times[order], steps[order]
    starts = np.concatenate(([0], np.flatnonzero(np.diff(times) > 1e-12) + 1))
    times, steps = times[starts], np.add.reduceat(steps, starts)
    return Command(times, np.cumsum(steps)[:-1])


def ringing(command: Command, frequency_hz: FloatArray, damping_ratio: float) -> FloatArray:
    """Ringing after ``command``, shape ``(m,)``, as a fraction of that of one full step.

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
    """Return a number for every mode: the same for all, or one each as they were given.

    Raises
    ------
    OptionError
        If there are neither one nor as many as modes.
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
    found = []
    for mode, half in zip(modes, per_mode(relative, modes), strict=True):
        sweep = np.linspace(1.0 - half, 1.0 + half, 201) if half > 0.0 else np.ones(1)
        found.append(float(ringing(command, mode.frequency_hz * sweep, mode.damping_ratio).max()))
    return found


def worst_ringing(command: Command, modes: Sequence[FlexibleMode], relative: PerMode) -> float:
    """Largest ringing of any mode over its frequency (1 +- ``relative``), on 201 points."""
    return max(worst_of_each(command, modes, relative))


def rings_within(
    command: Command, modes: Sequence[FlexibleMode], relative: PerMode, tolerance: PerMode
) -> bool:
    """Whether every mode rings at most as much as its own tolerance over its own band."""
    worst = worst_of_each(command, modes, relative)
    allowed = per_mode(tolerance, modes)
    return all(found <= most for found, most in zip(worst, allowed, strict=True))


def simulate(command: Command, mode: FlexibleMode, acceleration_m_s2: float) -> FloatArray:
    """Distance, speed and relative ringing at the end, shape ``(3,)``, by matrix exponential.

    Shares nothing with the rows above: rigid body and oscillator are carried together from edge
    to edge.
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
