"""Unit-magnitude shapers for several modes at once, the shortest possible.

A step shaped by such a train is a level that is 0 or 1 at every instant, and 1 in the end. The
shortest train for given constraints is therefore a time-optimal switching. With a level in [0, 1]
on a grid of cells, the least violation within a duration is the result of a linear program, in
which the circles abs(H) <= tolerance are replaced by polygons. The violation falls as the duration
grows. The optimal level is 0 or 1 except in the cells in which it switches, because the switching
function of an optimum is a sum of a few decaying waves, one for each active frequency, and is zero
only at isolated instants. Bisection over the duration gives the number of switchings and their
approximate times. For exact zeros, Newton's method solves for the times. For tolerances over bands,
sequential quadratic programming finds the shortest duration with exact circles. Its constraints are
checked at the maxima of V, which are updated after each round. Convolved unit-magnitude trains are
longer, or their levels leave [0, 1] where pulses overlap.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from threadline.base.arrays import ComplexArray, FloatArray
from threadline.errors import OptionError
from threadline.motion.shaping.designs import check_apart, prove
from threadline.motion.shaping.direct import Requirement
from threadline.motion.shaping.response import Rows, ZeroOf, pole, residual_vibration, zero_rows
from threadline.motion.shaping.solvers import minimise, newton
from threadline.motion.shaping.types import Shaper, ShaperError

_GRID_SIZES = (240, 330, 170, 480)
_SMALL = 1e-8


def direct_unit_magnitude(requirements: Sequence[Requirement]) -> Shaper:
    """Return the shortest train of amplitudes +1, -1, ... +1 that leaves no vibration of any mode.

    Parameters
    ----------
    requirements
        Modes with tolerance 0; ``derivatives`` above 0 make the train robust, as in UM-ZVD.

    Returns
    -------
    Shaper
        Levels 0 and 1 only; constraints met to 1e-10 and proved by simulation.

    Raises
    ------
    OptionError
        If there is no requirement, one has a tolerance, or the modes are too far apart.
    ShaperError
        If a program fails, or the simulation disagrees.
    """
    if not requirements:
        raise OptionError("unit-magnitude shaper: at least one requirement is needed")
    for r in requirements:
        if r.tolerance > 0.0:
            raise OptionError(
                f"unit-magnitude shaper: the requirement at {r.mode.frequency_hz:g} Hz has a "
                "tolerance, only exact zeros are solved directly",
                remedy="Ask for derivatives instead, or take um-ei or um-2ei for one mode.",
            )
    check_apart([r.mode for r in requirements])
    unit = 1.0 / min(r.mode.frequency_hz for r in requirements)
    zeros: list[ZeroOf] = [
        (r.mode.frequency_hz * unit, pole(r.mode.damping_ratio), order)
        for r in dict.fromkeys(requirements)
        for order in range(r.derivatives + 1)
    ]
    failures = []
    for points in _GRID_SIZES:
        try:
            times = _polish(_seed(zeros, points), zeros)
            break
        except ShaperError as error:
            failures.append(error)
    else:
        raise failures[0]
    amplitudes = np.where(np.arange(len(times)) % 2 == 0, 1.0, -1.0)
    shaper = Shaper(amplitudes=amplitudes, times_s=times * unit, name="um-direct")
    for r in requirements:
        mode_hz = np.array([r.mode.frequency_hz])
        prove(shaper, mode_hz, r.mode.damping_ratio, np.zeros(1), at_most=True)
    return shaper


def _least(zeros: Sequence[ZeroOf], duration: float, points: int) -> tuple[float, FloatArray]:
    """Return the least violation within ``duration``, in periods, and the (points,) levels."""
    edges = np.linspace(0.0, duration, points + 1)
    rows, bounds = [], []
    for by_impulse in zero_rows(zeros, edges - duration):
        by_level = by_impulse[:-1] - by_impulse[1:]
        final_level = by_impulse[-1]
        for level_row, constant in (
            (by_level.real, final_level.real),
            (by_level.imag, final_level.imag),
        ):
            rows += [level_row, -level_row]
            bounds += [-constant, constant]
    solution = minimise(
        np.append(np.zeros(points), 1.0),
        equal=(np.zeros((1, points + 1)), np.zeros(1)),
        below=(np.hstack((np.array(rows), -np.ones((len(rows), 1)))), np.array(bounds)),
        bounds=[(0.0, 1.0)] * points + [(0.0, None)],
        what="unit-magnitude shaper",
    )
    return float(solution.x[-1]), solution.x[:-1]


def _seed(zeros: Sequence[ZeroOf], points: int) -> FloatArray:
    """Switching times of the shortest feasible duration on a grid, from 0."""
    low, high = 0.0, 0.5 * len(zeros)
    for _ in range(6):
        if _least(zeros, high, points)[0] <= _SMALL:
            break
        low, high = high, 1.5 * high
    else:
        raise ShaperError(f"unit-magnitude shaper: no train within {high:.3g} periods")
    while high - low > 1e-4 * high:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if _least(zeros, middle, points)[0] <= _SMALL else (middle, high)
    _, levels = _least(zeros, high, points)
    times = switchings_of(levels, high / points)
    # There are as many times as equations; further ones are on/off pairs within a cell.
    while len(times) - 1 > 2 * len(zeros):
        narrowest = int(np.argmin(np.diff(times)))
        times = np.delete(times, [narrowest, narrowest + 1])
    shifted: FloatArray = times - times[0]
    return shifted


def switchings_of(levels: FloatArray, cell: float) -> FloatArray:
    """Return (k,) the times, from the first, at which levels in equal cells switch.

    Parameters
    ----------
    levels
        (n,) levels in [0, 1]; the level is 0 before the cells and 1 after them.
    cell
        Duration of a cell.
    """
    padded = np.concatenate(([0.0], levels, [1.0]))
    rounded = np.rint(padded)
    switchings = []
    for k in np.flatnonzero(np.diff(rounded)):
        # A level between 0 and 1 shifts the switching within its cell.
        a, b = padded[k], padded[k + 1]
        share = (1.0 - b) - a if rounded[k + 1] > rounded[k] else b - (1.0 - a)
        switchings.append((k + share) * cell)
    times = np.array(switchings)
    shifted: FloatArray = times - times[0]
    return shifted


def _polish(seed: FloatArray, zeros: Sequence[ZeroOf]) -> FloatArray:
    """Return the switching times that meet the constraints exactly, from a seed."""
    amplitudes = np.where(np.arange(len(seed)) % 2 == 0, 1.0, -1.0)

    def system(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        times = np.concatenate(([0.0], x))
        stacks = []
        for s in dict.fromkeys(zero[1] for zero in zeros):
            rows = Rows(amplitudes, times, s, free_amplitudes=False, unknown_frequencies=0)
            for f, zero_pole, order in zeros:
                if zero_pole == s:
                    rows.zero(f, order=order)
            stacks.append(rows.system())
        return np.concatenate([r for r, _ in stacks]), np.concatenate([j for _, j in stacks])

    switching_times = np.concatenate(([0.0], newton(system, seed[1:], "unit-magnitude shaper")))
    if len(switching_times) % 2 == 0 or bool(np.any(np.diff(switching_times) <= 0.0)):
        raise ShaperError(
            "unit-magnitude shaper: the design did not converge (its switchings changed order)",
            remedy="Change a mode a little.",
        )
    if float(np.abs(switching_times - seed).max()) > 0.05:
        raise ShaperError("unit-magnitude shaper: the design left the optimum that was found")
    return switching_times


_BAND_GRID_SIZES = (200, 260, 150, 340)
_POLYGON = 16
_BAND_GRID = 11
_SWEEP = 201
_ROUNDS = 12
_MARGIN = 1e-8  # share of the tolerance that is left for rounding
_MOST_SWITCHINGS = 40
_APART = 1e-4  # least distance of two switchings, in periods
_SETTLED = 1e-6


def unit_magnitude_over_bands(requirements: Sequence[Requirement]) -> Shaper:
    """Return the shortest found train of amplitudes +1, -1, ... +1 within every tolerance.

    V of each mode stays within the tolerance over the mode's band.

    Parameters
    ----------
    requirements
        Modes with a tolerance above 0, and the band of each.

    Returns
    -------
    Shaper
        Levels 0 and 1 only; every band confirmed by simulation at 21 frequencies.

    Raises
    ------
    OptionError
        If there is no requirement, or one has no tolerance.
    ShaperError
        If no train was found.
    """
    if not requirements or any(r.tolerance <= 0.0 for r in requirements):
        raise OptionError(
            "unit-magnitude shaper over bands: every mode needs a tolerance above 0",
            remedy="For exact zeros take um-direct.",
        )
    problem = _Problem(requirements)
    failures = []
    for points in _BAND_GRID_SIZES:
        try:
            times = problem.polished(problem.seed(points))
            break
        except ShaperError as error:
            failures.append(error)
    else:
        raise failures[0]
    shaper = Shaper(amplitudes=_signs(len(times)), times_s=times * problem.unit_s, name="um-si")
    for r in requirements:
        f = r.mode.frequency_hz * np.linspace(1.0 - r.relative, 1.0 + r.relative, 21)
        f = f if r.relative else f[:1]
        prove(shaper, f, r.mode.damping_ratio, np.full(len(f), r.tolerance), at_most=True)
    return shaper


def _signs(n: int) -> FloatArray:
    return np.where(np.arange(n) % 2 == 0, 1.0, -1.0)


class _Problem:
    """The bands of a joint design, in units of the lowest frequency; times in its periods."""

    def __init__(self, requirements: Sequence[Requirement]) -> None:
        self._asked = tuple(dict.fromkeys(requirements))
        self.unit_s = 1.0 / min(r.mode.frequency_hz for r in requirements)

    def _edges(self, r: Requirement) -> tuple[float, float]:
        f = r.mode.frequency_hz * self.unit_s
        return f * (1.0 - r.relative), f * (1.0 + r.relative)

    def _least(self, duration: float, points: int) -> tuple[float, FloatArray]:
        """Return the least V over its tolerance within ``duration``, and the (points,) levels."""
        edges = np.linspace(0.0, duration, points + 1)
        directions = np.exp(2j * np.pi * np.arange(_POLYGON) / _POLYGON)
        rows, bounds = [], []
        for r in self._asked:
            low, high = self._edges(r)
            for f in np.linspace(low, high, _BAND_GRID if high > low else 1):
                by_impulse = np.exp(pole(r.mode.damping_ratio) * f * (edges - duration))
                by_level = (by_impulse[:-1] - by_impulse[1:]) / r.tolerance
                final_level = by_impulse[-1] / r.tolerance
                rows.append((by_level[None, :] * directions[:, None]).real)
                bounds.append(-(final_level * directions).real)
        rows_of_bands = np.vstack(rows)
        solution = minimise(
            np.append(np.zeros(points), 1.0),
            equal=(np.zeros((1, points + 1)), np.zeros(1)),
            below=(
                np.hstack((rows_of_bands, -np.ones((len(rows_of_bands), 1)))),
                np.concatenate(bounds),
            ),
            bounds=[(0.0, 1.0)] * points + [(0.0, None)],
            what="unit-magnitude shaper over bands",
            seconds=60.0,
        )
        return float(solution.x[-1]), solution.x[:-1]

    def seed(self, points: int) -> FloatArray:
        """Switching times of the shortest feasible duration on a grid, from 0."""
        low, high = 0.0, 0.75 * len(self._asked)
        for _ in range(8):
            if self._least(high, points)[0] <= 1.0:
                break
            low, high = high, 1.4 * high
        else:
            raise ShaperError(
                f"unit-magnitude shaper over bands: no train within {high:.3g} periods",
                remedy="Narrow the bands, or allow more vibration.",
            )
        while high - low > 2e-3 * high:
            middle = 0.5 * (low + high)
            low, high = (low, middle) if self._least(middle, points)[0] <= 1.0 else (middle, high)
        times = switchings_of(self._least(high, points)[1], high / points)
        if len(times) % 2 == 0 or len(times) > _MOST_SWITCHINGS:
            raise ShaperError("unit-magnitude shaper over bands: the levels are not 0 and 1")
        return times

    def _tops(self, times: FloatArray) -> list[FloatArray]:
        """Return, for every band, its ends and the frequencies of the inner maxima of V."""
        peaks = []
        train = Shaper(amplitudes=_signs(len(times)), times_s=times)
        for r in self._asked:
            low, high = self._edges(r)
            if high == low:
                peaks.append(np.array([low]))
                continue
            f = np.linspace(low, high, _SWEEP)
            v = residual_vibration(train, f, r.mode.damping_ratio)
            inner_maxima = np.flatnonzero((v[1:-1] >= v[:-2]) & (v[1:-1] >= v[2:])) + 1
            # The maximum is at the vertex of the parabola through three samples.
            a, b, c = v[inner_maxima - 1], v[inner_maxima], v[inner_maxima + 1]
            curvature = a - 2.0 * b + c
            shift = np.where(
                np.abs(curvature) > 0.0,
                0.5 * (a - c) / np.where(curvature == 0.0, 1.0, curvature),
                0.0,
            )
            peaks.append(np.concatenate(([low, high], f[inner_maxima] + shift * (f[1] - f[0]))))
        return peaks

    def polished(self, seed: FloatArray) -> FloatArray:
        """Return the times of the shortest train with the seed's number of switchings.

        Raises
        ------
        ShaperError
            If the design does not converge.
        """
        times = seed
        checked_frequencies = [
            np.linspace(*self._edges(r), _BAND_GRID if r.relative else 1) for r in self._asked
        ]
        for _ in range(_ROUNDS):
            checked_frequencies = [
                np.unique(np.concatenate((old, tops)))
                for old, tops in zip(checked_frequencies, self._tops(times), strict=True)
            ]
            times_before, times = times, self._shortest(times, checked_frequencies)
            if np.any(np.diff(times) <= 0.0):
                break
            if self._excess(times) <= 1.0 and float(np.abs(times - times_before).max()) < _SETTLED:
                return times
        if np.all(np.diff(times) > 0.0) and self._excess(times) <= 1.0:
            return times
        raise ShaperError(
            "unit-magnitude shaper over bands: the design did not converge",
            remedy="Change a band or a tolerance a little.",
        )

    def _shortest(self, times: FloatArray, checked: Sequence[FloatArray]) -> FloatArray:
        """Return the shortest train near ``times`` with V in tolerance at all ``checked``."""
        from scipy.optimize import minimize

        n, signs = len(times), _signs(len(times))
        differences = np.eye(n - 1) - np.eye(n - 1, k=-1)

        def waves(x: FloatArray) -> list[tuple[Requirement, ComplexArray, ComplexArray]]:
            t = np.concatenate(([0.0], x))
            waves_found = []
            for r, f in zip(self._asked, checked, strict=True):
                exponents: ComplexArray = np.asarray(pole(r.mode.damping_ratio) * f, np.complex128)
                wave = np.exp(exponents[:, None] * (t - t[-1])) * signs
                waves_found.append((r, exponents, np.asarray(wave, np.complex128)))
            return waves_found

        def margin(x: FloatArray) -> FloatArray:
            parts = [
                (1.0 - _MARGIN) - np.abs(wave.sum(axis=1)) ** 2 / r.tolerance**2
                for r, _, wave in waves(x)
            ]
            return np.concatenate(parts)

        def margin_jacobian(x: FloatArray) -> FloatArray:
            parts = []
            for r, exponents, wave in waves(x):
                by_delay = exponents[:, None] * wave
                by_times = by_delay[:, 1:].copy()
                by_times[:, -1] = -by_delay[:, :-1].sum(axis=1)
                response = wave.sum(axis=1).conjugate()[:, None]
                parts.append(-2.0 * (response * by_times).real / r.tolerance**2)
            return np.vstack(parts)

        # scipy's stubs do not know a Jacobian beside constraints.
        sequential: Any = minimize
        solution = sequential(
            lambda x: float(x[-1]),
            times[1:],
            jac=lambda x: np.asarray(np.arange(len(x)) == len(x) - 1, dtype=np.float64),
            method="SLSQP",
            constraints=[
                {"type": "ineq", "fun": margin, "jac": margin_jacobian},
                {
                    "type": "ineq",
                    "fun": lambda x: differences @ x - _APART,
                    "jac": lambda _: differences,
                },
            ],
            options={"maxiter": 300, "ftol": 1e-12},
        )
        return np.concatenate(([0.0], np.asarray(solution.x, dtype=np.float64)))

    def _excess(self, times: FloatArray) -> float:
        """Return the largest ratio of V to its tolerance over the bands."""
        train = Shaper(amplitudes=_signs(len(times)), times_s=times)
        return max(
            float(residual_vibration(train, tops, r.mode.damping_ratio).max()) / r.tolerance
            for r, tops in zip(self._asked, self._tops(times), strict=True)
        )
