"""The fastest rest-to-rest command: found by linear programming, polished, proved global.

On a grid of intervals the largest distance within a given time is a linear program, and it
grows with the time, so bisection finds the one optimum and not just a root. The
switch times are then solved exactly, and Pontryagin's condition, sufficient for a linear
machine, is checked: a combination of the end conditions whose sign is the command everywhere
proves that nothing is faster.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.motion.shaping.onoff.body_and_modes import (
    Command,
    RestToRest,
    conditions,
    simulate,
    travel_rows,
)
from threadline.motion.shaping.response import crossing
from threadline.motion.shaping.solvers import minimise, newton
from threadline.motion.shaping.types import ShaperError

_INTERVALS = 600
_PROOF_SAMPLES = 2000
_PROOF_TOLERANCE = 1e-9
_ROUNDING = 1e-11


@dataclass(frozen=True, slots=True)
class TimeOptimal:
    """The proved optimum.

    Parameters
    ----------
    command
        Alternating levels +1 and -1.
    certificate
        Smallest value of the switching function times the command's sign, relative to its largest;
        at least -1e-9, so that no command is faster.
    """

    command: Command
    certificate: float


def time_optimal(move: RestToRest) -> TimeOptimal:
    """Fastest command, |u| <= 1, that ends ``move`` with every mode at rest.

    Raises
    ------
    ShaperError
        If the polished command fails its simulation or its proof of optimality.
    """
    from scipy.optimize import brentq

    shortest = move.rigid_duration_s
    longest = shortest + sum(1.5 * m.damped_period_s for m in move.modes)

    def missing(duration: float) -> float:
        return _farthest(move, duration)[0] - move.distance_m

    duration = float(brentq(missing, shortest * (1.0 - 1e-3), longest, xtol=1e-6 * shortest))
    seed = _Costate(move, _farthest(move, duration)[1])
    command, weights = _polish(move, seed, duration)
    for mode in move.modes:
        end = simulate(command, mode, move.acceleration_m_s2)
        error = np.abs(end - np.array([move.distance_m, 0.0, 0.0]))
        # A slow mode makes the machine overshoot and return: distances are rounded by that.
        reach_m = move.acceleration_m_s2 * conditions(move)[0] ** 2
        if error.max() > _PROOF_TOLERANCE + _ROUNDING * reach_m:
            raise ShaperError(
                f"time-optimal move: the simulation ends {error[0]:.1e} m, {error[1]:.1e} m/s "
                f"and {error[2]:.1e} of a step away from rest at {mode.frequency_hz:g} Hz"
            )
    return TimeOptimal(command, _certificate(seed, weights, command))


def _farthest(move: RestToRest, duration: float) -> tuple[float, FloatArray]:
    """Largest distance within ``duration`` with every mode at rest, and the program's duals."""
    edges = np.linspace(0.0, duration, _INTERVALS + 1)
    speed, distance = travel_rows(edges)
    rest_rows = [speed / duration]
    for at_rest in conditions(move)[1]:
        rest_rows += list(np.diff(at_rest.integral(edges - duration)))
    solution = minimise(
        -distance / duration**2,
        equal=(np.array(rest_rows), np.zeros(len(rest_rows))),
        bounds=(-1.0, 1.0),
        what="time-optimal move",
    )
    return -solution.value * duration**2 * move.acceleration_m_s2, solution.duals


class _Costate:
    """The switching function: its sign is the optimal level.

    With v = t - T it is -v / T^2 + p0 / T + the sum of the modes' densities times their weights.
    """

    def __init__(self, move: RestToRest, duals: FloatArray) -> None:
        self._scale, self._modes = conditions(move)
        self.seed = duals

    def parts(self, before_end: FloatArray, derivative: int) -> tuple[FloatArray, FloatArray]:
        """Given part (n,) and weighted parts (k, n) of a derivative, at v = t - T <= 0."""
        v = before_end / self._scale
        given = np.array([-v, -np.ones_like(v) / self._scale][derivative])
        weighted = [np.ones_like(v) if derivative == 0 else np.zeros_like(v)]
        for at_rest in self._modes:
            weighted += list(at_rest.density(before_end, derivative) * self._scale)
        return given, np.array(weighted)

    def value(self, weights: FloatArray, before_end: FloatArray, derivative: int = 0) -> FloatArray:
        """The switching function or its derivative, shape of ``before_end``."""
        given, weighted = self.parts(before_end, derivative)
        return np.asarray(given + weights @ weighted, dtype=np.float64)

    def switches(self, weights: FloatArray, duration: float) -> tuple[FloatArray, float]:
        """Roots as times from the start, (n,), and the sign before the first."""

        def value_at(before_end: float) -> float:
            return float(self.value(weights, np.array([before_end]))[0])

        grid = np.linspace(-duration, 0.0, _PROOF_SAMPLES + 1)
        value = self.value(weights, grid)
        positive = value > 0.0
        roots = [
            crossing(value_at, float(grid[i]), float(grid[i + 1]), xtol=1e-15)
            for i in np.flatnonzero(positive[:-1] != positive[1:])
        ]
        return np.array(roots) + duration, 1.0 if value[0] > 0.0 else -1.0


def _polish(move: RestToRest, costate: _Costate, duration: float) -> tuple[Command, FloatArray]:
    """Solve the weights of the switching function and the duration by Newton's method."""
    scale, _ = conditions(move)

    def command_of(x: FloatArray) -> Command:
        end = float(x[-1]) * scale
        times, first_sign = costate.switches(x[:-1], end)
        levels = first_sign * np.where(np.arange(len(times) + 1) % 2 == 0, 1.0, -1.0)
        return Command(np.concatenate(([0.0], times, [end])), levels)

    def system(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        command = command_of(x)
        residuals, by_times = _end_conditions(move, command)
        inner = command.times_s[1:-1] - command.times_s[-1]
        _, weighted = costate.parts(inner, 0)
        slope = costate.value(x[:-1], inner, 1)
        # A root moves against its weight's part, and with the end.
        root_motion = np.hstack((-(weighted / slope).T, np.full((len(inner), 1), scale)))
        jacobian = by_times[:, :-1] @ root_motion
        jacobian[:, -1] += by_times[:, -1] * scale
        return residuals, jacobian

    # The program divided distance by T^2 and speed by T; the weights here use the scale.
    seed = costate.seed
    ratio = duration / scale
    weights = np.concatenate(([seed[0] * ratio], seed[1:] * ratio**2))
    x = newton(system, np.append(weights, ratio), "time-optimal move")
    return command_of(x), x[:-1]


def _end_conditions(move: RestToRest, command: Command) -> tuple[FloatArray, FloatArray]:
    """Scaled speed, distance and ringing left at the end, and their gradient by the edges."""
    edges, levels = command.times_s, command.levels
    scale, at_rests = conditions(move)
    end = edges[-1]
    jumps = np.append(-np.diff(levels), levels[-1])
    speed, distance = travel_rows(edges) @ levels
    by_distance = jumps * (end - edges[1:])
    by_distance[-1] += speed
    to_length = 4.0 / scale**2  # normalises the rigid move's distance
    reach = move.distance_m / move.acceleration_m_s2
    residuals = [speed / scale, (distance - reach) * to_length]
    rows = [jumps / scale, by_distance * to_length]
    before_end = edges - end
    for at_rest in at_rests:
        density = at_rest.density(before_end)
        by_times = jumps * density[:, 1:]
        # The last edge is the origin of the decay: it shifts all earlier edges relative to it.
        by_times[:, -1] = -by_times[:, :-1].sum(axis=1) + levels[0] * density[:, 0]
        residuals += list(np.diff(at_rest.integral(before_end)) @ levels)
        rows += list(by_times)
    return np.array(residuals), np.array(rows)


def _certificate(costate: _Costate, weights: FloatArray, command: Command) -> float:
    """Check the sign of the switching function against the command between all its edges."""
    cell_shares = (np.arange(_PROOF_SAMPLES) + 0.5) / _PROOF_SAMPLES
    edges = command.times_s
    samples = (edges[:-1, None] + np.diff(edges)[:, None] * cell_shares).ravel()
    signs = np.repeat(command.levels, _PROOF_SAMPLES)
    agreement = signs * costate.value(weights, samples - edges[-1])
    certificate = float(agreement.min() / agreement.max())
    if certificate < -_PROOF_TOLERANCE:
        raise ShaperError(
            "time-optimal move: no switching function proves that the command is the fastest",
            remedy="The modes may be too close to one another; drop one of them.",
        )
    return certificate
