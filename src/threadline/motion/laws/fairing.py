"""Fairing of a measured cam: differences, the rebound of splines, and a smoothing spline.

The first two are from the paper about the measured cam of the examples: Cheng Xiaoxiong, "Using
numerical approximation method to improvement movement regularity of the cloth frame of embroidery
machines", Journal of Textile Research 28 (2007) no. 7, pages 101 to 104. The third is the default.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from math import sqrt
from typing import Any

import numpy as np

from threadline.base.arrays import FloatArray

MOST_PASSES = 50
_INTERVALS = (16, 48)  # least and largest number of knot intervals of the smoothing spline
_AT_A_TIME = 256  # number of columns of a pass's matrix that are computed together
_DEGREE = 3  # degree of the spline of the velocity
_STIFFEST, _LOOSEST, _STEP = 0.0, -16.0, 0.2


def differences(y: FloatArray, noise: float) -> FloatArray:
    """Return ``y`` (n,) with each value replaced by a least-squares cubic through five rows.

    The five rows are the row itself and two neighbours on either side. For evenly spaced rows the
    correction is 3/35 of the fourth difference. No value changes by more than twice the noise, and
    the two values at either end stay.
    """
    fourth = y[:-4] - 4.0 * y[1:-3] + 6.0 * y[2:-2] - 4.0 * y[3:-1] + y[4:]
    corrected = y.copy()
    corrected[2:-2] -= np.clip(3.0 / 35.0 * fourth, -2.0 * noise, 2.0 * noise)
    return corrected


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rebound:
    """Values faired by the rebound method, and how it ended.

    Parameters
    ----------
    values
        (n,) faired values.
    passes
        Number of passes from the rows to the mid-points and back.
    moved
        Root mean square of the corrections of all passes together.
    last
        Largest correction of the last pass.
    stopped_by
        Rule that ended the passes: ``"noise"``, ``"passes"`` or ``"epsilon"``.
    """

    values: FloatArray
    passes: int
    moved: float
    last: float
    stopped_by: str


def one_pass(x: FloatArray, values: FloatArray) -> FloatArray:
    """Return (n,) or (n, columns) ``values`` at (n,) places ``x`` after a pass of ``rebound``."""
    from scipy.interpolate import CubicSpline

    end_slopes: Any = ((1, np.zeros(values.shape[1:])),) * 2
    mid_points = np.concatenate((x[:1], 0.5 * (x[1:] + x[:-1]), x[-1:]))
    mid_values = CubicSpline(x, values, bc_type=end_slopes)(mid_points)
    return np.asarray(CubicSpline(mid_points, mid_values, bc_type=end_slopes)(x))


def pass_matrix(x: FloatArray) -> FloatArray:
    """Return the (n, n) matrix of ``one_pass``, which is linear.

    Only some columns are computed at a time, because a spline needs four times their memory.
    """
    column_blocks = (
        one_pass(x, np.eye(len(x), min(_AT_A_TIME, len(x) - first_column), -first_column))
        for first_column in range(0, len(x), _AT_A_TIME)
    )
    return np.concatenate(list(column_blocks), axis=1)


def rebound(
    x: FloatArray,
    y: FloatArray,
    noise: float,
    *,
    epsilon: float | None = None,
    most_passes: int = MOST_PASSES,
) -> Rebound:
    """Return values faired by the paper's rebound method.

    A pass puts a clamped cubic spline through the rows, and a second spline through the values of
    the first one midway between rows. Its result is the values of the second spline at the rows.

    Parameters
    ----------
    x, y
        (n,) rising places of the rows, and their values.
    noise
        Standard deviation of the error of ``y``. The passes end before the root mean square of the
        corrections exceeds it, since larger corrections would change the shape.
    epsilon
        The paper's rule, used in place of ``noise`` if given: the passes end when a pass changes no
        value by more than this. With this rule the passes flatten the cam, because many passes
        converge to a single cubic.
    most_passes
        Largest number of passes.
    """
    # A pass is linear in the values, so its matrix is computed once for the thousands of passes.
    matrix = pass_matrix(x)
    values, last_change, last_rms_correction, stopped_by = y, 0.0, 0.0, "passes"
    passes = 0
    while passes < most_passes:
        passed_values = matrix @ values
        largest_change = float(np.abs(passed_values - values).max())
        rms_correction = float(np.sqrt(np.mean((passed_values - y) ** 2)))
        if epsilon is None and rms_correction > noise:
            stopped_by = "noise"
            break
        values, last_change, last_rms_correction, passes = (
            passed_values,
            largest_change,
            rms_correction,
            passes + 1,
        )
        if epsilon is not None and largest_change < epsilon:
            stopped_by = "epsilon"
            break
    return Rebound(
        values=values,
        passes=passes,
        moved=last_rms_correction,
        last=last_change,
        stopped_by=stopped_by,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Smoothed:
    """A monotone rise fitted to a measured one.

    Parameters
    ----------
    knots, coefficients
        Cubic B-spline of the velocity on [0, 1]; no coefficient is negative.
    base, rise
        Position of the follower before the rise, and the height of the rise.
    values
        (n,) fitted positions of the follower at the rows.
    freedom
        Effective number of parameters of the fit.
    missed
        Root mean square of the residuals over the noise, with n - ``freedom`` degrees of freedom;
        1 if the noise explains them.
    scaled
        (n,) residuals over the noise, scaled up for each row's influence on the fit (leverage).
    """

    knots: FloatArray
    coefficients: FloatArray
    base: float
    rise: float
    values: FloatArray
    freedom: float
    missed: float
    scaled: FloatArray


@cache
def _basis(
    intervals: int,
) -> tuple[FloatArray, Callable[[FloatArray], FloatArray], FloatArray, list[FloatArray]]:
    """Return the data that all smoothing splines with the same number of knot intervals share.

    The tuple holds the knots, the antiderivatives of the ``count`` B-splines of the velocity, the
    jerks of the B-splines, and their values and first two derivatives at 20 samples per interval.
    The jerks are weighted such that the sum of their squares is the integral of the squared jerk.
    Jerks and samples have a column for each B-spline.
    """
    from scipy.interpolate import BSpline

    inner_knots = np.linspace(0.0, 1.0, intervals + 1)
    knots = np.concatenate((np.zeros(_DEGREE), inner_knots, np.ones(_DEGREE)))
    basis = BSpline(knots, np.eye(intervals + _DEGREE), _DEGREE)
    # The integral of the squared jerk is exact, because the jerk is linear between knots.
    gauss_points = (
        inner_knots[:-1, None] + np.array([0.5 - sqrt(1 / 12), 0.5 + sqrt(1 / 12)]) / intervals
    )
    jerk = basis.derivative(2)(gauss_points.ravel()) / sqrt(2.0 * intervals)
    sample_times = np.linspace(0.0, 1.0, 20 * intervals + 1)
    return (
        knots,
        basis.antiderivative(),
        jerk,
        [basis.derivative(d)(sample_times) for d in range(3)],
    )


class Smoother:
    """The smoothing spline through rows at times ``t``: monotone, from rest to rest.

    It minimises the sum of the squared residuals over the noise plus a weight times the integral of
    the squared jerk. Rows before 0 and after 1 belong to the dwells.

    Parameters
    ----------
    t
        (n,) normalised times: 0 at the start of the rise, 1 at its end.
    noise
        (n,) standard deviations of the follower's position.
    smooth_ends
        Whether the acceleration, like the velocity, is 0 at the start and at the end of the rise,
        as it is beside a dwell.
    """

    def __init__(
        self, t: FloatArray, noise: FloatArray, smooth_ends: tuple[bool, bool] = (True, True)
    ) -> None:
        rows_in_rise = int(((t > 0.0) & (t < 1.0)).sum())
        intervals = int(np.clip(rows_in_rise, *_INTERVALS))
        self.t, self.noise = np.clip(t, 0.0, 1.0), noise
        self.knots, basis, jerk, sample_bases = _basis(intervals)
        count = intervals + _DEGREE
        # The first and the last coefficient are the velocities at the ends. Together with their
        # neighbours they determine the accelerations at the ends.
        self.free = np.arange(1 + smooth_ends[0], count - 1 - smooth_ends[1])
        risen = basis(self.t)[:, self.free]
        self.count = count
        self.rows = np.hstack((np.ones((len(t), 1)), risen)) / noise[:, None]
        jerk = jerk[:, self.free]
        # Divided by the noise, so that the weight is dimensionless.
        self.penalty = np.hstack((np.zeros((len(jerk), 1)), jerk)) / float(np.median(noise))
        self.total = (self.knots[_DEGREE + 1 :] - self.knots[:count])[self.free] / (_DEGREE + 1.0)
        self.looks = [sample_basis[:, self.free] for sample_basis in sample_bases]

    def solve(self, y: FloatArray, weight: float) -> FloatArray:
        """Return (k + 1,) the base and the k free coefficients that fit (n,) positions.

        ``weight`` is the weight of the jerk, as in ``weight_for``.
        """
        from scipy.optimize import nnls

        # nnls has no negative unknowns, so the base is counted from a value below all measurements.
        floor = float(y.min()) - float(np.ptp(y)) - 1.0
        matrix = np.vstack((self.rows, sqrt(weight) * self.penalty))
        target = np.concatenate(((y - floor) / self.noise, np.zeros(len(self.penalty))))
        # Columns are scaled to similar size, because otherwise the solver finds only the base.
        column_norms = np.linalg.norm(matrix, axis=0)
        solution, _ = nnls(matrix / column_norms, target)
        solution = solution / column_norms
        solution[0] += floor
        return np.asarray(solution)

    def freedom(self, weight: float) -> tuple[float, FloatArray]:
        """Return the effective number of parameters, bounds ignored, and (n,) leverages of rows."""
        normal_matrix = self.rows.T @ self.rows + weight * self.penalty.T @ self.penalty
        normal_matrix += (
            1e-12 * np.trace(normal_matrix) / len(normal_matrix) * np.eye(len(normal_matrix))
        )
        leverages = np.einsum("ij,ji->i", self.rows, np.linalg.solve(normal_matrix, self.rows.T))
        return float(leverages.sum()), leverages

    def weight_for(self, y: FloatArray) -> float:
        """Return the weight of the jerk with the least expected error at the given noise.

        It minimises the sum of the squared residuals over the noise plus twice the effective number
        of parameters: Mallows, "Some comments on Cp", Technometrics 15 (1973).
        """
        least_error, best_weight = np.inf, 1.0
        for exponent in np.arange(_STIFFEST, _LOOSEST, -_STEP).tolist():
            weight = 10.0**exponent
            residuals = self.rows @ self.solve(y, weight) - y / self.noise
            squares, freedom = float(residuals @ residuals), self.freedom(weight)[0]
            if squares + 2.0 * freedom < least_error:
                least_error, best_weight = squares + 2.0 * freedom, weight
        return best_weight

    def fit(self, y: FloatArray, weight: float) -> Smoothed:
        """Return the fit to (n,) positions of the follower with a given weight of the jerk."""
        solution = self.solve(y, weight)
        freedom, leverages = self.freedom(weight)
        coefficients = np.zeros(self.count)
        coefficients[self.free] = solution[1:]
        values = (self.rows @ solution) * self.noise
        squares = float((((y - values) / self.noise) ** 2).sum())
        return Smoothed(
            knots=self.knots, coefficients=coefficients, base=float(solution[0]),
            rise=float(self.total @ solution[1:]), values=values, freedom=freedom,
            missed=sqrt(squares / max(len(y) - freedom, 1.0)),
            scaled=(y - values) / self.noise / np.sqrt(np.maximum(1.0 - leverages, 0.05)),
        )  # fmt: skip

    def peaks(self, found: FloatArray) -> FloatArray:
        """Return Cv, Ca and Cj of a solution of ``solve``, from 20 samples a knot interval."""
        rise = float(self.total @ found[1:])
        return np.array([np.abs(look @ found[1:]).max() / rise for look in self.looks])
