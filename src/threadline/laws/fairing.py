"""Fairing of a measured cam: differences, the rebound of splines, and a smoothing spline.

The first two are those of the paper whose cam it is: Cheng Xiaoxiong, "Using numerical
approximation method to improvement movement regularity of the cloth frame of embroidery machines",
Journal of Textile Research 28 (2007) no. 7, pages 101 to 104. The third is the default.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from typing import Any

import numpy as np

from threadline.arrays import FloatArray

MOST_PASSES = 50
_INTERVALS = (16, 48)
_DEGREE = 3  # of the velocity
_STIFFEST, _LOOSEST, _STEP = 0.0, -16.0, 0.2


def differences(y: FloatArray, noise: float) -> FloatArray:
    """Return ``y`` (n,) corrected so that its differences vary evenly, by at most twice the noise.

    Each value goes to the cubic through its five neighbours by least squares, 3/35 of the fourth
    difference; the two at either end stay. Rows must be evenly spaced.
    """
    fourth = y[:-4] - 4.0 * y[1:-3] + 6.0 * y[2:-2] - 4.0 * y[3:-1] + y[4:]
    out = y.copy()
    out[2:-2] -= np.clip(3.0 / 35.0 * fourth, -2.0 * noise, 2.0 * noise)
    return out


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rebound:
    """What the rebound made of the distances.

    Parameters
    ----------
    values
        (n,) faired.
    passes
        How often it went there and back.
    moved
        Root mean square of all corrections.
    last
        Largest change of the last pass.
    stopped_by
        ``"noise"``, ``"passes"`` or ``"epsilon"``.
    """

    values: FloatArray
    passes: int
    moved: float
    last: float
    stopped_by: str


def rebound(
    x: FloatArray,
    y: FloatArray,
    noise: float,
    *,
    slopes: tuple[float, float] = (0.0, 0.0),
    epsilon: float | None = None,
    most_passes: int = MOST_PASSES,
) -> Rebound:
    """Return (n,) values faired by clamped cubic splines through nodes and mid-points by turns.

    Parameters
    ----------
    noise
        It ends when the corrections reach it: what goes beyond is shape and not error.
    slopes
        At the two ends.
    epsilon
        The paper's rule: it ends when a pass changes no value by more. That alone flattens the
        cam, since the passes have no end but a single cubic; then ``noise`` does not stop it.
    """
    from scipy.interpolate import CubicSpline

    ends: Any = ((1, slopes[0]), (1, slopes[1]))
    between = np.concatenate((x[:1], 0.5 * (x[1:] + x[:-1]), x[-1:]))
    values, last, moved, why = y, 0.0, 0.0, "passes"
    done = 0
    while done < most_passes:
        there = CubicSpline(x, values, bc_type=ends)(between)
        back = CubicSpline(between, there, bc_type=ends)(x)
        change = float(np.abs(back - values).max())
        farther = float(np.sqrt(np.mean((back - y) ** 2)))
        if epsilon is None and farther > noise:
            why = "noise"
            break
        values, last, moved, done = back, change, farther, done + 1
        if epsilon is not None and change < epsilon:
            why = "epsilon"
            break
    return Rebound(values=values, passes=done, moved=moved, last=last, stopped_by=why)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Smoothed:
    """A monotone rise fitted to a measured one.

    Parameters
    ----------
    knots, coefficients
        Of the velocity, a cubic spline on [0, 1]; no coefficient is below 0.
    base, rise
        Of the follower before and by it.
    values
        (n,) of the follower at the rows.
    freedom
        Number of parameters that the fit uses in effect.
    missed
        Root mean square of the misses over the noise, for the rows that are not used up.
    scaled
        (n,) misses over the noise, each with what the row itself pulls taken off.
    """

    knots: FloatArray
    coefficients: FloatArray
    base: float
    rise: float
    values: FloatArray
    freedom: float
    missed: float
    scaled: FloatArray


class Smoother:
    """The smoothing spline for rows at ``t``: monotone, from rest to rest.

    It minimises the squared misses over the noise plus a multiple of the squared jerk. Rows outside
    [0, 1] are of the dwells.

    Parameters
    ----------
    t
        (n,) time of the rise, 0 to 1 between its ends.
    noise
        (n,) standard deviations of the follower.
    gentle
        Whether the acceleration, too, is 0 at the start, and at the end: beside a dwell it is.
    """

    def __init__(
        self, t: FloatArray, noise: FloatArray, gentle: tuple[bool, bool] = (True, True)
    ) -> None:
        from scipy.interpolate import BSpline

        inside = int(((t > 0.0) & (t < 1.0)).sum())
        intervals = int(np.clip(inside, *_INTERVALS))
        self.t, self.noise = np.clip(t, 0.0, 1.0), noise
        inner = np.linspace(0.0, 1.0, intervals + 1)
        self.knots = np.concatenate((np.zeros(_DEGREE), inner, np.ones(_DEGREE)))
        count = intervals + _DEGREE
        # The first and the last coefficient are the velocities of the ends, the next to them add
        # the accelerations.
        self.free = np.arange(1 + gentle[0], count - 1 - gentle[1])
        basis = BSpline(self.knots, np.eye(count), _DEGREE)
        risen = basis.antiderivative()(self.t)[:, self.free]
        self.count = count
        self.rows = np.hstack((np.ones((len(t), 1)), risen)) / noise[:, None]
        # The integral of the squared jerk, exact: the jerk is linear between knots.
        at = inner[:-1, None] + np.array([0.5 - sqrt(1 / 12), 0.5 + sqrt(1 / 12)]) / intervals
        jerk = basis.derivative(2)(at.ravel())[:, self.free] / sqrt(2.0 * intervals)
        # By the noise, so that the weight has no unit.
        self.penalty = np.hstack((np.zeros((len(jerk), 1)), jerk)) / float(np.median(noise))
        self.total = (self.knots[_DEGREE + 1 :] - self.knots[:count])[self.free] / (_DEGREE + 1.0)
        looks = np.linspace(0.0, 1.0, 20 * intervals + 1)
        self.looks = [basis.derivative(d)(looks)[:, self.free] for d in range(3)]

    def solve(self, y: FloatArray, weight: float) -> FloatArray:
        """Return base and free coefficients for follower values (n,) and a weight of the jerk."""
        from scipy.optimize import nnls

        # The base may have any sign: it is counted from below everything that was measured.
        low = float(y.min()) - float(np.ptp(y)) - 1.0
        matrix = np.vstack((self.rows, sqrt(weight) * self.penalty))
        target = np.concatenate(((y - low) / self.noise, np.zeros(len(self.penalty))))
        # Columns of like size, without which the solver takes the base for the only one.
        size = np.linalg.norm(matrix, axis=0)
        found, _ = nnls(matrix / size, target)
        found = found / size
        found[0] += low
        return np.asarray(found)

    def freedom(self, weight: float) -> tuple[float, FloatArray]:
        """Return the effective number of parameters without the bounds, and each row's share."""
        inner = self.rows.T @ self.rows + weight * self.penalty.T @ self.penalty
        inner += 1e-12 * np.trace(inner) / len(inner) * np.eye(len(inner))
        pulls = np.einsum("ij,ji->i", self.rows, np.linalg.solve(inner, self.rows.T))
        return float(pulls.sum()), pulls

    def weight_for(self, y: FloatArray) -> float:
        """Return the weight of the jerk with the least expected error for the noise that is known.

        That is the one with the least sum of squared misses over the noise and twice the effective
        number of parameters: Mallows, "Some comments on Cp", Technometrics 15 (1973).
        """
        best, kept = np.inf, 1.0
        for exponent in np.arange(_STIFFEST, _LOOSEST, -_STEP).tolist():
            weight = 10.0**exponent
            missed = self.rows @ self.solve(y, weight) - y / self.noise
            squares, freedom = float(missed @ missed), self.freedom(weight)[0]
            if squares + 2.0 * freedom < best:
                best, kept = squares + 2.0 * freedom, weight
        return kept

    def fit(self, y: FloatArray, weight: float) -> Smoothed:
        """Return the fit to follower values (n,)."""
        found = self.solve(y, weight)
        freedom, pulls = self.freedom(weight)
        coefficients = np.zeros(self.count)
        coefficients[self.free] = found[1:]
        values = (self.rows @ found) * self.noise
        squares = float((((y - values) / self.noise) ** 2).sum())
        return Smoothed(
            knots=self.knots, coefficients=coefficients, base=float(found[0]),
            rise=float(self.total @ found[1:]), values=values, freedom=freedom,
            missed=sqrt(squares / max(len(y) - freedom, 1.0)),
            scaled=(y - values) / self.noise / np.sqrt(np.maximum(1.0 - pulls, 0.05)),
        )  # fmt: skip

    def peaks(self, found: FloatArray) -> FloatArray:
        """Return Cv, Ca and Cj of a solution, at 20 looks an interval."""
        rise = float(self.total @ found[1:])
        return np.array([np.abs(look @ found[1:]).max() / rise for look in self.looks])
