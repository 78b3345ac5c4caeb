"""Direct design of positive shapers: for a specified band, or for several modes at once.

The convolution of one shaper per mode adds the durations. A direct design is the shortest train
that meets all constraints together. With impulses on a grid of times, the least vibration within a
duration is the result of a linear program, and bisection over the duration gives a seed. Then
sequential quadratic programming finds the shortest duration with free times and amplitudes. Its
constraints are checked at the maxima of V, which are updated after each round. A final solution by
Newton's method meets the active constraints to 1e-11.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from threadline.base.arrays import ComplexArray, FloatArray
from threadline.errors import OptionError
from threadline.motion.shaping.closed import Train
from threadline.motion.shaping.designs import check_apart, convolve, groups, prove
from threadline.motion.shaping.response import (
    Rows,
    pole,
    response,
    response_gradient,
    responses,
    zero_rows,
)
from threadline.motion.shaping.solvers import minimise, newton
from threadline.motion.shaping.types import FlexibleMode, Shaper, ShaperError

FAR_APART, BANDS_FAR_APART = 50.0, 12.0
"""Largest ratio of two frequencies for a joint design, without and with bands: beyond it, the grids
below are too coarse for the faster mode."""
MOST_TOGETHER = 6  # largest number of modes designed together; six take seconds
_GRIDS = (160, 210, 120, 300)
_POLYGON = 16
_BAND_GRID = 13
_MERGE = 1.5
_SETTLED = 1e-7  # largest change of a settled solution, from which Newton's method starts


@dataclass(frozen=True, slots=True)
class Requirement:
    """Permitted vibration of one mode.

    Parameters
    ----------
    mode
        Undamped frequency, Hz, and damping ratio, held over the band.
    tolerance
        Largest V in the band; 0 demands exact zero and needs ``relative`` = 0.
    relative
        Half width of the band of frequency around the mode, in [0, 1).
    derivatives
        With tolerance 0: number of derivatives of V that are 0, too: 0 for ZV, 1 for ZVD, 2 for
        ZVDD.

    Raises
    ------
    OptionError
        If the numbers contradict each other or are out of range.
    """

    mode: FlexibleMode
    tolerance: float = 0.0
    relative: float = 0.0
    derivatives: int = 0

    def __post_init__(self) -> None:
        self.mode.refuse_much_damping(f"requirement at {self.mode.frequency_hz:g} Hz")
        if not 0.0 <= self.tolerance < 1.0 or not 0.0 <= self.relative < 1.0:
            raise OptionError(
                f"requirement at {self.mode.frequency_hz:g} Hz: tolerance {self.tolerance!r} and "
                f"band {self.relative!r} must be in [0, 1)"
            )
        if self.tolerance == 0.0 and self.relative > 0.0:
            raise OptionError(
                f"requirement at {self.mode.frequency_hz:g} Hz: no train is silent over a band",
                remedy="Give a tolerance, or ask for derivatives.",
            )
        if self.derivatives not in (0, 1, 2) or (self.tolerance > 0.0 and self.derivatives):
            raise OptionError(
                f"requirement at {self.mode.frequency_hz:g} Hz: derivatives must be 0, 1 or 2, "
                "and go with tolerance 0"
            )


def specified_insensitivity(mode: FlexibleMode, relative: float, tolerance: float = 0.05) -> Shaper:
    """Return the shortest positive shaper with V <= ``tolerance`` over f (1 +- ``relative``).

    The insensitivity, (f_hi - f_lo) / f, is at least 2 ``relative``.

    Raises
    ------
    OptionError, ShaperError
        As :func:`direct_shaper`.
    """
    return direct_shaper([Requirement(mode, tolerance, relative)], name="si")


def direct_shaper(requirements: Sequence[Requirement], *, name: str = "direct") -> Shaper:
    """Return the shortest train of positive impulses that meets every requirement.

    Modes farther apart than ``FAR_APART`` (``BANDS_FAR_APART`` if one has a band) get separate
    trains, which are convolved. No V is larger as a result, and the train exceeds the shortest
    possible one by at most the trains of the faster modes.

    Returns
    -------
    Shaper
        Amplitudes > 0 that sum to 1; constraints met to 1e-10 and proved by simulation.

    Raises
    ------
    OptionError
        If there is no requirement, or the modes are too far apart for any train.
    ShaperError
        If more than ``MOST_TOGETHER`` modes are near each other, a program fails, or the simulation
        disagrees.
    """
    if not requirements:
        raise OptionError("direct shaper: at least one requirement is needed")
    modes = [r.mode for r in requirements]
    check_apart(modes)
    ratio = BANDS_FAR_APART if any(r.relative for r in requirements) else FAR_APART
    trains = [_together([requirements[k] for k in group], name) for group in groups(modes, ratio)]
    shaper = convolve(*trains, name=name)
    for r in requirements:
        f = r.mode.frequency_hz * np.linspace(1.0 - r.relative, 1.0 + r.relative, 21)
        f = f if r.relative else f[:1]
        prove(shaper, f, r.mode.damping_ratio, np.full(len(f), r.tolerance), at_most=True)
    return shaper


def _together(requirements: Sequence[Requirement], name: str) -> Shaper:
    """Return the shortest train for modes that are near each other."""
    if len(requirements) > MOST_TOGETHER:
        raise ShaperError(
            f"direct shaper: {len(requirements)} modes near each other, and more than "
            f"{MOST_TOGETHER} take minutes",
            remedy="Leave out modes that hardly ring, or convolve: a kind made for one mode.",
        )
    unit = 1.0 / min(r.mode.frequency_hz for r in requirements)
    amplitudes, times = _solve(_Problem(requirements, unit))
    return Shaper(amplitudes=amplitudes, times_s=times * unit, name=name)


def _solve(problem: _Problem) -> Train:
    """Polish the seeds of several grids, until one succeeds; a grid can split an impulse badly."""
    failures = []
    for points in _GRIDS:
        try:
            return problem.polish(*problem.seed(points))
        except ShaperError as error:
            failures.append(error)
    raise failures[0]


def _pruned(x: FloatArray, n: int) -> tuple[FloatArray, int]:
    """Merge impulses at the same time, and drop impulses of amplitude zero."""
    t, a = np.concatenate(([0.0], x[: n - 1])), x[n - 1 :]
    order = np.argsort(t, kind="stable")
    t, a = t[order], a[order]
    starts = np.concatenate(([0], np.flatnonzero(np.diff(t) > 1e-5) + 1))
    a, t = np.add.reduceat(a, starts), t[starts]
    keep = a > 1e-9
    keep[0] = keep[-1] = True
    a, t = a[keep], t[keep]
    return np.concatenate((t[1:], a)), len(t)


class _Problem:
    """The constraints of a joint design; times are in undamped periods of the slowest mode."""

    def __init__(self, requirements: Sequence[Requirement], unit: float) -> None:
        self._zero = [
            (r.mode.frequency_hz * unit, pole(r.mode.damping_ratio), order)
            for r in dict.fromkeys(requirements)
            if r.tolerance == 0.0
            for order in range(r.derivatives + 1)
        ]
        self._bands = [
            (
                r.mode.frequency_hz * unit * (1.0 - r.relative),
                r.mode.frequency_hz * unit * (1.0 + r.relative),
                pole(r.mode.damping_ratio),
                r.tolerance,
            )
            for r in dict.fromkeys(requirements)
            if r.tolerance > 0.0
        ]
        self._longest = sum(
            (r.derivatives + 1 + 4.0 * r.relative) / (r.mode.frequency_hz * unit)
            for r in requirements
        )

    def _least(self, duration: float, points: int) -> tuple[float, FloatArray, FloatArray]:
        """Return the least violation within ``duration``, and (points,) amplitudes and times.

        The violation is V / tolerance - 1, or abs(H) for a tolerance of 0.
        """
        times = np.linspace(0.0, duration, points)
        directions = np.exp(2j * np.pi * np.arange(_POLYGON) / _POLYGON)
        rows, bounds, slack_weights = [], [], []
        for row in zero_rows(self._zero, times - duration):
            for d in directions[::4]:
                rows.append((row * d).real)
                bounds.append(0.0)
                slack_weights.append(1.0)
        for low, high, s, tolerance in self._bands:
            count = _BAND_GRID if high > low else 1
            for f in np.linspace(low, high, count):
                row = np.exp(s * f * (times - duration)) / tolerance
                for d in directions:
                    rows.append((row * d).real)
                    bounds.append(1.0)
                    slack_weights.append(1.0)
        solution = minimise(
            np.append(np.zeros(points), 1.0),
            equal=(np.append(np.ones(points), 0.0)[None, :], [1.0]),
            below=(np.hstack((np.array(rows), -np.array(slack_weights)[:, None])), bounds),
            bounds=[(0.0, None)] * points + [(None, None)],
            what="direct shaper",
        )
        return float(solution.x[-1]), solution.x[:-1], times

    def seed(self, points: int) -> tuple[FloatArray, FloatArray]:
        """Return amplitudes and times of the shortest train on a grid, with neighbours merged."""
        feasible_violation = 2e-3
        low, high = 0.0, self._longest
        for _ in range(6):
            if self._least(high, points)[0] <= feasible_violation:
                break
            low, high = high, 1.5 * high
        else:
            raise ShaperError(f"direct shaper: no positive train found within {high:.3g} periods")
        while high - low > 1e-2 * high:
            middle = 0.5 * (low + high)
            low, high = (
                (low, middle)
                if self._least(middle, points)[0] <= feasible_violation
                else (middle, high)
            )
        _, weights, times = self._least(high, points)
        used_points = np.flatnonzero(weights > 1e-5)
        starts = np.concatenate(([0], np.flatnonzero(np.diff(used_points) > _MERGE) + 1))
        amplitudes = np.add.reduceat(weights[used_points], starts)
        centres = np.add.reduceat(weights[used_points] * times[used_points], starts) / amplitudes
        centres[0] = 0.0
        return amplitudes / amplitudes.sum(), centres

    def polish(self, amplitudes: FloatArray, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return amplitudes and times of the shortest train near a seed, with exact constraints."""
        n = len(times)
        x = np.concatenate((times[1:], amplitudes))
        band_grids = [list(np.linspace(b[0], b[1], 9 if b[1] > b[0] else 1)) for b in self._bands]
        checked_frequencies = band_grids
        for _ in range(6):
            x_before = x
            x = self._shortest(x, n, checked_frequencies)
            x, n = _pruned(x, n)
            if x.shape == x_before.shape and float(np.abs(x - x_before).max()) < _SETTLED:
                break
            peaks = self._peaks(x, n)
            checked_frequencies = [
                [*grid, *tops] for grid, tops in zip(band_grids, peaks, strict=True)
            ]
        x = self._exact(x, n)
        t, a = np.concatenate(([0.0], x[: n - 1])), x[n - 1 : 2 * n - 1]
        is_valid = bool(np.all(np.diff(t) > 0.0)) and bool(np.all(a >= 0.0))
        worst = max(
            (
                abs(response(a, t, f, b[2], 0)) / b[3] - 1.0
                for b, tops in zip(self._bands, self._peaks(x, n), strict=True)
                for f in [*tops, b[0], b[1]]
            ),
            default=0.0,
        )
        if not is_valid or worst > 1e-10:
            raise ShaperError(
                f"direct shaper: the design did not converge (V exceeds its tolerance by "
                f"{worst:.1e} of it)",
                remedy="Change the band or the tolerance a little.",
            )
        return a, t

    def _shortest(self, x: FloatArray, n: int, checked: list[list[float]]) -> FloatArray:
        from scipy.optimize import minimize

        bounds: list[tuple[float, float | None]] = [(1e-4, None)] * (n - 1)
        bounds += [(0.0, 1.0)] * n
        # The type stubs of scipy do not allow a Jacobian together with constraints.
        sequential: Any = minimize
        solution = sequential(
            lambda y: float(y[n - 2]),
            x,
            jac=lambda y: np.asarray(np.arange(len(y)) == n - 2, dtype=np.float64),
            method="SLSQP",
            bounds=bounds,
            constraints=self._constraints(n, checked),
            options={"maxiter": 200, "ftol": 1e-12},
        )
        return np.asarray(solution.x, dtype=np.float64)

    def _constraints(self, n: int, checked: list[list[float]]) -> list[Any]:
        def split(y: FloatArray) -> tuple[FloatArray, FloatArray]:
            return np.concatenate(([0.0], y[: n - 1])), y[n - 1 :]

        def equal(y: FloatArray) -> FloatArray:
            t, a = split(y)
            values = [float(a.sum()) - 1.0]
            for f, s, order in self._zero:
                h = response(a, t, f, s, order)
                values += [h.real, h.imag]
            return np.array(values)

        def equal_jacobian(y: FloatArray) -> FloatArray:
            t, a = split(y)
            rows = [np.concatenate((np.zeros(n - 1), np.ones(n)))]
            for f, s, order in self._zero:
                g = np.concatenate(response_gradient(a, t, f, s, order))
                rows += [g.real, g.imag]
            return np.array(rows)

        def bands(y: FloatArray) -> Iterator[tuple[ComplexArray, ComplexArray, float]]:
            t, a = split(y)
            for (_, _, s, tolerance), grid in zip(self._bands, checked, strict=True):
                yield *responses(a, t, np.array(grid), s), tolerance

        def margin(y: FloatArray) -> FloatArray:
            return np.concatenate(
                [1.0 - np.abs(h / tolerance) ** 2 for h, _, tolerance in bands(y)]
            )

        def margin_jacobian(y: FloatArray) -> FloatArray:
            return np.concatenate(
                [
                    -2.0 * (h.conjugate()[:, None] * gradient).real / tolerance**2
                    for h, gradient, tolerance in bands(y)
                ]
            )

        constraints: list[Any] = [{"type": "eq", "fun": equal, "jac": equal_jacobian}]
        if self._bands:
            constraints.append({"type": "ineq", "fun": margin, "jac": margin_jacobian})
        return constraints

    def _peaks(self, x: FloatArray, n: int) -> list[list[float]]:
        """Return the interior maxima of V in every band, refined by Newton's method on dV^2/df."""
        t, a = np.concatenate(([0.0], x[: n - 1])), x[n - 1 : 2 * n - 1]
        peaks = []
        for low, high, s, _ in self._bands:
            f = np.linspace(low, high, 401)
            v = np.abs(np.exp(s * np.outer(f, t - t[-1])) @ a)
            sampled_peaks = f[np.flatnonzero((v[1:-1] > v[:-2]) & (v[1:-1] >= v[2:])) + 1]
            refined_peaks = []
            for sampled_peak in sampled_peaks:
                g = float(sampled_peak)
                for _ in range(8):
                    h = [response(a, t, g, s, k) for k in range(3)]
                    slope = (h[0].conjugate() * h[1]).real
                    bend = abs(h[1]) ** 2 + (h[0].conjugate() * h[2]).real
                    g -= float(np.clip(slope / bend, -0.01, 0.01))
                refined_peaks.append(min(max(g, low), high))
            peaks.append(refined_peaks)
        return peaks

    def _exact(self, x: FloatArray, n: int) -> FloatArray:
        """Return the solution near ``x`` that meets every active constraint exactly."""
        active: list[tuple[int, float, bool]] = []
        t, a = np.concatenate(([0.0], x[: n - 1])), x[n - 1 :]
        for i, (b, tops) in enumerate(zip(self._bands, self._peaks(x, n), strict=True)):
            ends = [b[0]] if b[1] == b[0] else [b[0], b[1]]
            for f, is_free in [(f, False) for f in ends] + [(f, True) for f in tops]:
                if abs(response(a, t, f, b[2], 0)) > b[3] * (1.0 - 1e-5):
                    active.append((i, f, is_free))
        free_frequencies = [f for _, f, is_free in active if is_free]

        def system(y: FloatArray) -> tuple[FloatArray, FloatArray]:
            times, weights = np.concatenate(([0.0], y[: n - 1])), y[n - 1 : 2 * n - 1]
            stacks = []
            slots = iter(range(len(free_frequencies)))
            frequency_slots = [next(slots) if is_free else None for _, _, is_free in active]
            for s in dict.fromkeys([z[1] for z in self._zero] + [b[2] for b in self._bands]):
                rows = Rows(
                    weights,
                    times,
                    s,
                    free_amplitudes=True,
                    unknown_frequencies=len(free_frequencies),
                )
                for f, zero_pole, order in self._zero:
                    if zero_pole == s:
                        rows.zero(f, order=order)
                for (i, f, _), slot in zip(active, frequency_slots, strict=True):
                    if self._bands[i][2] == s:
                        frequency = f if slot is None else float(y[2 * n - 1 + slot])
                        rows.level(frequency, self._bands[i][3], slot)
                        if slot is not None:
                            rows.flat(frequency, self._bands[i][3], slot)
                rows.unit_sum()
                stacks.append(rows.system())
            return (np.concatenate([r for r, _ in stacks]), np.concatenate([j for _, j in stacks]))

        return newton(system, np.concatenate((x, free_frequencies)), "direct shaper")
