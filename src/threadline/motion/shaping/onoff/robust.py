"""The fastest command for a machine whose frequency is known only within a band.

Levels are free within [-1, 1]: the bound for any valve, switched or proportional. For a given time
the largest distance with |ringing| <= tolerance over the band is a convex program; circles and band
are met by cutting planes, to 1e-4 of the tolerance, and the time is found by bisection, so that the
optimum is the global one for the grid of intervals.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.errors import OptionError
from threadline.motion.shaping.onoff.body_and_modes import (
    Command,
    PerMode,
    RestToRest,
    per_mode,
    ringing_rows,
    shaped_command,
    travel_rows,
    worst_of_each,
    worst_ringing,
)
from threadline.motion.shaping.solvers import InfeasibleError, minimise
from threadline.motion.shaping.types import Shaper, ShaperError

_ACCURACY = 1e-4
_ROUNDS = 60
_SWEEP = 201
_ROUNDING = 1e-9
_APART = 80.0
"""Largest ratio of two frequencies. The grid grows by half a period of the slowest mode and has
160 intervals: four in a period of a mode that is 80 times as fast."""


class _Band:
    """Half planes Re(exp(-j phase) ringing) <= tolerance that have been needed so far.

    If modes have different tolerances, ringing is scaled to the largest of them: a mode's ringing
    is divided by its tolerance's share of it.
    """

    def __init__(self, move: RestToRest, relative: PerMode, tolerance: PerMode) -> None:
        self._move, self._relative = move, per_mode(relative, move.modes)
        for half_width in self._relative:
            if not 0.0 <= half_width < 1.0:
                raise OptionError(f"robust move: the band must be in [0, 1), got {half_width!r}")
        allowed = per_mode(tolerance, move.modes)
        self._share = [mode_tolerance / max(allowed) for mode_tolerance in allowed]
        phases = np.arange(4) * 0.5 * np.pi
        self._cuts = []
        for i, half_width in enumerate(self._relative):
            first_ratios = (
                np.linspace(1.0 - half_width, 1.0 + half_width, 7) if half_width else np.ones(1)
            )
            self._cuts += [(i, float(r), float(p)) for r in first_ratios for p in phases]

    def rows(self, edges: FloatArray) -> FloatArray:
        """One row per cut, shape ``(cuts, n)``."""
        table = np.empty((len(self._cuts), len(edges) - 1))
        for i, mode in enumerate(self._move.modes):
            mode_cuts = [k for k, cut in enumerate(self._cuts) if cut[0] == i]
            ratio = np.array([self._cuts[k][1] for k in mode_cuts])
            phase = np.array([self._cuts[k][2] for k in mode_cuts])
            complex_rows = ringing_rows(edges, mode.frequency_hz * ratio, mode.damping_ratio)
            turned_rows = (complex_rows * np.exp(-1j * phase)[:, None]).real
            table[mode_cuts] = turned_rows / self._share[i]
        return table

    def worst(self, command: Command) -> float:
        """Return the worst ringing over the bands, scaled to the largest tolerance."""
        worsts = worst_of_each(command, self._move.modes, self._relative)
        return max(
            worst_of_mode / share for worst_of_mode, share in zip(worsts, self._share, strict=True)
        )

    def cut(self, command: Command, tolerance: float) -> bool:
        """Add the half planes that ``command`` violates; False if it violates none."""
        violated = False
        for i, mode in enumerate(self._move.modes):
            sweep = np.linspace(1.0 - self._relative[i], 1.0 + self._relative[i], _SWEEP)
            rows = ringing_rows(command.times_s, mode.frequency_hz * sweep, mode.damping_ratio)
            value = rows @ command.levels
            height = np.abs(value) / self._share[i]
            padded = np.concatenate(([-1.0], height, [-1.0]))
            is_maximum = (height >= padded[:-2]) & (height >= padded[2:])
            for k in np.flatnonzero(is_maximum & (height > tolerance * (1.0 + _ACCURACY) + 1e-12)):
                self._cuts.append((i, float(sweep[k]), float(np.angle(value[k]))))
                violated = True
        return violated


def farthest(
    move: RestToRest, duration_s: float, tolerance: float, band: _Band, intervals: int
) -> tuple[float, Command]:
    """Largest distance, m, within ``duration_s``, and its command."""
    edges = np.linspace(0.0, duration_s, intervals + 1)
    speed, distance = travel_rows(edges)
    for _ in range(_ROUNDS):
        rows = band.rows(edges)
        solution = minimise(
            -distance / duration_s**2,
            equal=(speed[None, :] / duration_s, np.zeros(1)),
            # In units of the tolerance: the solver keeps a row to 1e-7, and would ignore one of
            # 1e-9.
            below=(rows / tolerance, np.ones(len(rows))),
            bounds=(-1.0, 1.0),
            what="robust move",
        )
        command = Command(edges, solution.x)
        if not band.cut(command, tolerance):
            return float(distance @ solution.x) * move.acceleration_m_s2, command
    raise ShaperError(
        f"robust move: no command that keeps the ringing below {tolerance:g} is found in {_ROUNDS} "
        "rounds of cutting planes",
        remedy="Narrow the band or allow more ringing.",
    )


def robust_optimum(
    move: RestToRest, *, relative: PerMode, tolerance: PerMode, intervals: int = 160
) -> Command:
    """Fastest command with ringing <= ``tolerance`` over every mode's f (1 +- ``relative``).

    Parameters
    ----------
    move
        The move.
    relative
        Half width of the band, in [0, 1); one for all modes, or one each.
    tolerance
        Ringing allowed, as a fraction of one full acceleration step's ringing; likewise.
    intervals
        Number of intervals of constant level; with more of them the bound gets tighter.

    Returns
    -------
    Command
        Levels free within [-1, 1].

    Raises
    ------
    OptionError
        If a tolerance is not positive, or modes that both ring are too far apart for the grid.
    ShaperError
        If a linear program fails.
    """
    from scipy.optimize import brentq

    for mode_tolerance in per_mode(tolerance, move.modes):
        if not (math.isfinite(mode_tolerance) and mode_tolerance > 0.0):
            raise OptionError(
                f"robust move: tolerance must be positive and finite, got {mode_tolerance!r}",
                remedy="Give the ringing allowed, of one full step's: 0.01.",
            )
    band, largest_tolerance = _Band(move, relative, tolerance), max(per_mode(tolerance, move.modes))
    low = move.rigid_duration_s

    def missing(duration: float) -> float:
        return farthest(move, duration, largest_tolerance, band, intervals)[0] - move.distance_m

    rigid_distance_m, command = farthest(move, low, largest_tolerance, band, intervals)
    if rigid_distance_m >= move.distance_m * (1.0 - _ROUNDING):
        return command  # a slow mode that the rigid move hardly excites
    frequencies = [mode.frequency_hz for mode in move.modes]
    if max(frequencies) > _APART * min(frequencies):
        raise OptionError(
            f"robust move: modes at {min(frequencies):g} Hz and {max(frequencies):g} Hz, and a "
            f"grid for the slower follows no mode more than {_APART:g} times as fast",
            remedy="Leave out --move, or the slower mode, or the faster.",
        )
    # Nothing is faster than the rigid body; from there on, try half a slowest period at a time.
    stride = max(0.5 * m.damped_period_s for m in move.modes)
    high = low + stride
    for _ in range(40):
        if missing(high) >= 0.0:
            break
        low, high = high, high + stride
    else:
        raise ShaperError(
            f"robust move: no command within {high:.4g} s keeps the ringing below "
            f"{largest_tolerance:g} over "
            f"{max(per_mode(relative, move.modes)) * 100:.4g}% of the frequency",
            remedy="Narrow the band or allow more ringing.",
        )
    duration = float(brentq(missing, low, high, xtol=2e-6, rtol=2e-6))
    return farthest(move, duration, largest_tolerance, band, intervals)[1]


def least_ringing(
    move: RestToRest, *, relative: PerMode, tick_s: float, ticks: int, tolerance: PerMode = 1.0
) -> tuple[float, Command] | None:
    """Command on a controller's tick, free levels, that covers the distance and rings least.

    If modes have different tolerances, ringing is scaled to the largest of them, and so is the
    returned worst ringing.

    Returns
    -------
    tuple of float and Command, or None
        The worst ringing over the band; None if the distance cannot be covered in that time.
    """
    edges = np.arange(ticks + 1, dtype=np.float64) * tick_s
    speed, distance = travel_rows(edges)
    reach = move.distance_m / move.acceleration_m_s2
    band = _Band(move, relative, tolerance)
    cost = np.append(np.zeros(ticks), 1.0)
    for _ in range(_ROUNDS):
        rows = band.rows(edges)
        try:
            solution = minimise(
                cost,
                equal=(
                    np.pad(np.array([speed / edges[-1], distance / reach]), ((0, 0), (0, 1))),
                    [0.0, 1.0],
                ),
                below=(np.hstack((rows, -np.ones((len(rows), 1)))), np.zeros(len(rows))),
                bounds=[(-1.0, 1.0)] * ticks + [(0.0, None)],
                what="robust move",
            )
        except InfeasibleError:
            return None
        command = Command(edges, solution.x[:-1])
        if not band.cut(command, max(float(solution.x[-1]), 1e-9)):
            return band.worst(command), command
    raise ShaperError(
        f"robust move: the command that rings least is not found in {_ROUNDS} rounds of cutting "
        "planes",
        remedy="Narrow the band.",
    )


@dataclass(frozen=True, slots=True)
class ShapedMove:
    """One shaped move, compared with the bounds.

    Parameters
    ----------
    name
        Name of the shaper.
    duration_s
        Duration of the whole move.
    over_optimal, over_robust
        Duration divided by the time-optimal one (no robustness) and by the robust optimum (free
        levels).
    worst_step, worst_unshaped
        Worst ringing over the band: as a fraction of one full step's, and of the unshaped
        move's own worst over the same band.
    """

    name: str
    duration_s: float
    over_optimal: float
    over_robust: float
    worst_step: float
    worst_unshaped: float


def beside(
    move: RestToRest, shapers: list[Shaper], *, relative: PerMode, optimal_s: float, robust_s: float
) -> list[ShapedMove]:
    """Return every shaped move compared with optima of known durations, s."""
    unshaped = worst_ringing(
        shaped_command(move, Shaper(amplitudes=np.ones(1), times_s=np.zeros(1))),
        move.modes,
        relative,
    )
    rows = []
    for shaper in shapers:
        command = shaped_command(move, shaper)
        worst = worst_ringing(command, move.modes, relative)
        time = command.duration_s
        rows.append(
            ShapedMove(
                shaper.name, time, time / optimal_s, time / robust_s, worst, worst / unshaped
            )
        )
    return rows
