"""Robust nonlinear least squares from several starts, and the uncertainty of each fitted number.

The fit varies the logarithm of each number's factor on the first guess. So a number keeps its sign,
and a step has the same meaning for a mass and for a stiffness. Residuals are grouped by their
source (a file, a channel); the noise of each source is estimated from its own residuals.

Deviations are computed for an M-estimator with Huber's function (Huber and Ronchetti, *Robust
Statistics*, 2009, section 7.6), and for least squares if no residual is beyond the threshold. The
least deviation is the Cramer-Rao bound for normal noise, ``s^2 (J^T J)^-1``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.errors import OptionError

Residuals = Callable[[FloatArray], FloatArray]
"""Function from (variants, numbers) logarithms of factors to (variants, m) residuals."""

START_FACTOR = 3.0
"""Factor by which a first guess may be too small or too large: starts are drawn within it."""
FARTHEST_FACTOR = 20.0
"""Largest factor between a first guess and the fitted number."""
_STARTS, _SIMULATED_STARTS = 48, 12  # a simulated run costs a hundred times as much as a response
_REFINED = 3
_HUBER = 2.0  # in deviations of the noise; 98 % as efficient as least squares for normal noise
_ROUNDS = 3
_OUTLIER_DEVIATIONS = 4.0
_ROUGH_STEP = 0.01  # from this step of the derivatives on, residuals count as rough
_WIDEST, _FINEST = 0.08, 0.002
UNKNOWN = 0.5
"""Deviation of a logarithm from which a combination counts as unknown."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Problem:
    """A fit: names, residuals, and the sources of the residuals.

    Parameters
    ----------
    names
        (p,) dotted names of the numbers, or other labels.
    residuals
        See ``Residuals``; unweighted, so that a residual has the unit of its source.
    source
        (m,) index of the source of each residual.
    floor
        (m,) least deviation of the noise of each residual: the rounding of its source.
    step
        Relative step of the derivatives.
    robust
        Whether the fit limits the weight of outliers; False where residuals are mostly errors of
        the model.
    """

    names: tuple[str, ...]
    residuals: Residuals
    source: IntArray
    floor: FloatArray
    step: float = 1e-5
    robust: bool = True


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Estimate:
    """The result of a fit.

    Parameters
    ----------
    names
        (p,) names of the numbers.
    log_factor
        (p,) logarithms of the fitted factors on the first guesses.
    covariance
        (p, p) covariance of the logarithms.
    least_deviation
        (p,) Cramer-Rao bound of the deviation of each logarithm.
    jacobian
        (m, p) derivatives of the residuals, in deviations of the noise.
    residual
        (m,) residuals in the unit of their source.
    noise
        (m,) deviation of the noise of each residual, as estimated.
    outliers
        Number of residuals beyond four deviations of the noise.
    """

    names: tuple[str, ...]
    log_factor: FloatArray
    covariance: FloatArray
    least_deviation: FloatArray
    jacobian: FloatArray
    residual: FloatArray
    noise: FloatArray
    outliers: int

    @property
    def deviation(self) -> FloatArray:
        """(p,) deviation of each logarithm: nearly the relative deviation of the number."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def correlation(self) -> FloatArray:
        """(p, p) correlations of the logarithms."""
        deviation = self.deviation
        return self.covariance / np.outer(deviation, deviation)


def estimate(problem: Problem, starts: int | None = None) -> Estimate:
    """Fit the numbers of a problem.

    Parameters
    ----------
    starts
        Number of starts to try besides the first guess, within ``START_FACTOR``; the best are
        refined. By default 48, or 12 if the problem is not robust (recordings).

    Raises
    ------
    OptionError
        If there are more numbers than residuals, or no start gives a finite residual.
    """
    _check_count(problem)
    usual_starts = _STARTS if problem.robust else _SIMULATED_STARTS
    start_points = _starts(problem, usual_starts if starts is None else starts)
    # Scaled by the misfit of one start: sources have different units.
    noise = _noise(problem, problem.residuals(start_points[-1][None])[0])
    best, cost = start_points[0], np.inf
    for start in start_points:
        refined, refined_cost = _refined(problem, start, noise, final=False)
        if refined_cost < cost:
            best, cost = refined, refined_cost
    for _ in range(_ROUNDS):
        residual = problem.residuals(best[None])[0]
        new_noise = _noise(problem, residual)
        settled = np.allclose(new_noise, noise, rtol=0.01)
        noise = new_noise
        best, _ = _refined(problem, best, noise, final=True)
        if settled:
            break
    if problem.step >= _ROUGH_STEP:
        best = _compass_search(problem, best)
    return _estimate_at(problem, best)


def _check_count(problem: Problem) -> None:
    count, known = len(problem.names), len(problem.source)
    if known <= count:
        raise OptionError(
            f"{count} numbers cannot be fitted to {known} values",
            remedy="Measure more points, or name fewer numbers.",
        )


def check_range(found: Estimate) -> None:
    """Refuse numbers at the end of their range, ``FARTHEST_FACTOR`` from the first guess.

    Call ``known_combinations`` first: along a combination that the data leaves free, rounding may
    carry the fit to the end of the range.

    Raises
    ------
    OptionError
        If a number is at the end of its range.
    """
    largest_log = np.log(FARTHEST_FACTOR)
    for name, value in zip(found.names, found.log_factor, strict=True):
        if abs(value) > 0.999 * largest_log:
            raise OptionError(
                f"{name} ends at {np.exp(value):.3g} times its first guess, the end of its range",
                remedy="Correct the guess in the machine file, or name fewer numbers.",
            )


def _starts(problem: Problem, count: int) -> list[FloatArray]:
    """Return the first guess and the best of ``count`` drawn starts."""
    from scipy.stats import qmc

    first = np.zeros((1, len(problem.names)))
    drawn_starts = np.empty((0, len(problem.names)))
    if count:
        unit = qmc.Halton(len(problem.names), seed=1).random(count)
        drawn_starts = (2.0 * unit - 1.0) * np.log(START_FACTOR)
    candidates = np.concatenate((first, drawn_starts))
    residual = problem.residuals(candidates)
    cost = np.log1p(residual**2).sum(axis=1)
    finite = np.isfinite(cost)
    if not finite.any():
        raise OptionError(
            "the model has no finite answer near the first guesses",
            remedy="Correct the guesses in the machine file.",
        )
    cost[~finite] = np.inf
    order = [int(k) for k in np.argsort(cost[1:])[: _REFINED - 1] + 1 if finite[k]]
    return [candidates[k] for k in ([0] if finite[0] else []) + order]


def _refined(
    problem: Problem, start: FloatArray, noise: FloatArray, *, final: bool
) -> tuple[FloatArray, float]:
    from scipy.optimize import least_squares

    largest_log = np.log(FARTHEST_FACTOR)
    tolerance = 1e-8 if final else 1e-3
    loss: Literal["huber", "soft_l1", "linear"] = "linear"
    if problem.robust:
        loss = "huber" if final else "soft_l1"

    def residual(x: FloatArray) -> FloatArray:
        return np.asarray(np.nan_to_num(problem.residuals(x[None])[0] / noise, nan=1e6))

    def slope(x: FloatArray) -> FloatArray:
        return np.asarray(np.nan_to_num(jacobian(problem, x) / noise[:, None]))

    result = least_squares(
        residual,
        np.clip(start, -0.99 * largest_log, 0.99 * largest_log),
        jac=slope,
        bounds=(-largest_log, largest_log),
        loss=loss,
        f_scale=_HUBER if loss == "huber" else 1.0,
        xtol=tolerance,
        ftol=tolerance,
        gtol=1e-8,
        max_nfev=200,
    )
    return np.asarray(result.x), float(result.cost)


def _compass_search(problem: Problem, numbers: FloatArray) -> FloatArray:
    """Return the best numbers that a compass search finds where rounding misleads derivatives.

    Each round tries every number one step up and one step down, in one call. If none is better, the
    step is halved (Kolda, Lewis and Torczon, "Optimization by direct search", SIAM Review 45,
    2003).
    """
    noise = _noise(problem, problem.residuals(numbers[None])[0])
    axes = np.concatenate((np.eye(len(numbers)), -np.eye(len(numbers))))
    step = _WIDEST
    while step > _FINEST:
        candidates = np.concatenate((numbers[None], numbers + step * axes))
        squares = np.mean((problem.residuals(candidates) / noise) ** 2, axis=1)
        best = int(np.nanargmin(squares))
        if best == 0:
            step /= 2.0
        else:
            numbers = candidates[best]
    return numbers


def jacobian(problem: Problem, at: FloatArray) -> FloatArray:
    """Return the (m, p) derivatives of the residuals by central differences, all at once."""
    count = len(at)
    steps = problem.step * np.eye(count)
    values = problem.residuals(np.concatenate((at + steps, at - steps)))
    return np.asarray((values[:count] - values[count:]).T / (2.0 * problem.step))


def _noise(problem: Problem, residual: FloatArray) -> FloatArray:
    """Return the (m,) deviations of the noise, estimated for each source from its residuals.

    A robust problem takes the scaled median, refined by Huber's proposal 2; any other takes the
    root mean square. Both are divided by ``sqrt(1 - p/m)``, by which a fit of p numbers shrinks m
    residuals.
    """
    noise = np.empty(len(residual))
    freedom_share = np.sqrt(1.0 - len(problem.names) / len(residual))
    for source in np.unique(problem.source):
        of_source = problem.source == source
        magnitude = np.abs(residual[of_source])
        least_deviation = float(np.median(problem.floor[of_source]))
        if not problem.robust:
            noise[of_source] = max(
                float(np.sqrt(np.mean(magnitude**2))) / freedom_share, least_deviation
            )
            continue
        spread = max(1.4826 * float(np.median(magnitude)), least_deviation)
        # Huber's proposal 2: efficient for normal noise, and bounded for outliers.
        for _ in range(30):
            clipped = np.minimum(magnitude / spread, _HUBER)
            spread *= float(np.sqrt(np.mean(clipped**2) / _CLIPPED_VARIANCE))
        noise[of_source] = max(spread / freedom_share, least_deviation)
    return noise


def _clipped_variance(most: float) -> float:
    """Return the mean of ``min(|z|, most)^2`` for a standard normal z."""
    from math import erf, exp, pi, sqrt

    probability = erf(most / sqrt(2.0))
    return (
        probability - most * sqrt(2.0 / pi) * exp(-(most**2) / 2.0) + most**2 * (1.0 - probability)
    )


_CLIPPED_VARIANCE = _clipped_variance(_HUBER)


def _estimate_at(problem: Problem, at: FloatArray) -> Estimate:
    """Return the estimate at the fitted numbers, with its covariance."""
    residual = problem.residuals(at[None])[0]
    noise = _noise(problem, residual)
    J = jacobian(problem, at) / noise[:, None]
    scaled = residual / noise
    is_inside = np.abs(scaled) <= _HUBER
    # E[psi^2] / E[psi']^2: 1 for least squares of normal noise.
    psi = np.clip(scaled, -_HUBER, _HUBER)
    variance_factor = np.sum(psi**2) / max(len(scaled) - len(at), 1) / np.mean(is_inside) ** 2
    inverse = np.linalg.pinv(J.T @ J, hermitian=True)
    covariance = inverse * max(variance_factor, 1.0 / np.mean(is_inside))
    if not problem.robust:
        # Residuals of a recording are correlated: an axis that rests, or moves a whole number of
        # counts each tick, is rounded alike at every sample. The largest effect that residuals of
        # their size can have is added as if it were one more deviation.
        shift = np.abs(inverse @ J.T).sum(axis=1)
        widening = np.sqrt(1.0 + shift**2 / np.maximum(np.diag(covariance), 1e-300))
        covariance = covariance * np.outer(widening, widening)
    return Estimate(
        names=problem.names,
        log_factor=at,
        covariance=covariance,
        least_deviation=np.sqrt(np.diag(inverse)),
        jacobian=J,
        residual=residual,
        noise=noise,
        outliers=int(np.sum(np.abs(scaled) > _OUTLIER_DEVIATIONS)),
    )


def profile(problem: Problem, found: Estimate, number: int) -> tuple[float, float]:
    """Return the ends of the 95 % interval of a number's logarithm, from its likelihood profile.

    The number is held at a value and the others are fitted again; the interval ends where the sum
    of squares has grown by the 95 % quantile of F (Seber and Wild, *Nonlinear Regression*, 1989,
    section 5.4).
    """
    from scipy.optimize import brentq
    from scipy.stats import t as student

    free = [k for k in range(len(found.names)) if k != number]
    limit = float(student.ppf(0.975, len(found.residual) - len(found.names)))
    fitted = found.log_factor
    least = _squares(found.residual / found.noise)

    def excess(value: float) -> float:
        def residuals_at(free_values: FloatArray) -> FloatArray:
            numbers = np.empty((len(free_values), len(fitted)))
            numbers[:, number], numbers[:, free] = value, free_values
            return problem.residuals(numbers)

        reduced = replace(
            problem, names=tuple(found.names[k] for k in free), residuals=residuals_at
        )
        if free:
            best, _ = _refined(reduced, fitted[free], found.noise, final=True)
        else:
            best = fitted[free]
        squares = _squares(residuals_at(best[None])[0] / found.noise)
        return float(np.sqrt(max(squares - least, 0.0))) - limit

    ends = []
    for sign in (-1.0, 1.0):
        reach = 2.0 * float(found.deviation[number])
        while excess(fitted[number] + sign * reach) < 0.0 and reach < np.log(FARTHEST_FACTOR):
            reach *= 1.6
        span = float(fitted[number]), float(fitted[number] + sign * reach)
        if reach >= np.log(FARTHEST_FACTOR):
            ends.append(span[1])
        else:
            ends.append(float(brentq(excess, *span, xtol=1e-3 * found.deviation[number])))
    return ends[0], ends[1]


def _squares(share: FloatArray) -> float:
    magnitude = np.abs(share)
    return float(
        np.sum(np.where(magnitude <= _HUBER, magnitude**2, 2.0 * _HUBER * magnitude - _HUBER**2))
    )


def known_combinations(found: Estimate) -> list[FloatArray] | None:
    """Return the exponents of the combinations of numbers that the data determines.

    Returns None if the data determines each number by itself. A combination is a product of the
    numbers, each to its exponent. Directions whose deviation exceeds ``UNKNOWN`` are left out.
    """
    left_vectors, singular_values, rows = np.linalg.svd(found.jacobian, full_matrices=False)
    del left_vectors
    known = singular_values > 1.0 / UNKNOWN
    if known.all():
        return None
    return [_simple(row) for row in _reduced(rows[known])]


def _reduced(rows: FloatArray) -> FloatArray:
    """Return a basis of the same space in reduced row echelon form, pivots by size."""
    basis = rows.copy()
    for k in range(len(basis)):
        free = np.abs(basis[k:])
        # An earlier column is preferred: the names are in the order in which they were asked for.
        row, column = divmod(int(np.argmax(free > 0.5 * free.max())), free.shape[1])
        basis[[k, k + row]] = basis[[k + row, k]]
        basis[k] /= basis[k, column]
        for other_row in range(len(basis)):
            if other_row != k:
                basis[other_row] -= basis[other_row, column] * basis[k]
    return basis


def _simple(row: FloatArray) -> FloatArray:
    """Return exponents, each rounded to a multiple of 1/2 if it is within 0.03 of one."""
    halves = np.round(2.0 * row) / 2.0
    return np.where(np.abs(row - halves) < 0.03, halves, row)


def combination_text(names: Sequence[str], exponents: FloatArray) -> str:
    """Return a combination as a product of powers, such as ``a * b^2 / c``."""
    numerator = [_power(n, e) for n, e in zip(names, exponents, strict=True) if e > 0]
    denominator = [_power(n, -e) for n, e in zip(names, exponents, strict=True) if e < 0]
    text = " * ".join(numerator) or "1"
    return text + "".join(f" / {part}" for part in denominator)


def _power(name: str, exponent: float) -> str:
    return name if exponent == 1.0 else f"{name}^{exponent:.3g}"
