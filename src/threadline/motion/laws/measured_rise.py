"""The noise of a measured cam, and the start and the end of its rise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from itertools import product

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray
from threadline.errors import OptionError, Place
from threadline.motion.laws.cam import MeasuredCam
from threadline.motion.laws.catalogue import LAWS
from threadline.motion.laws.law import Law

_ORDER = 4  # order of the differences: a smooth rise of a hundred rows hardly contributes to them
_NEAR = 1.8  # five rows that span more than this times the median have a gap, and are left out
_OUTLYING = 4.0
_FEWEST = 8
_FEW = 20  # with at most so many rows, no medians are taken
_FALL, _RISE = 7.0, 6.0  # least fall and least rise, in standard deviations of the noise
_DWELL = 3  # least number of rows of a dwell
CONFIDENCE = 0.9  # confidence of the intervals of start and end
_TAIL = 0.025  # outside an interval at either end; below 0.05, as the true shape is unknown
_FREE = 0.5  # least weight in an interval of the shapes that are no law by name
_POWERS = (1, 2, 3, 4)  # powers of the time near an end to which the velocity may be proportional
_DEGREES = (0, 6)  # degrees of the polynomials between the ends
_BACK = 0.02  # share of the peak velocity; a shape with a larger backward velocity is no rise
_DOUBT = 1e3
_LOOKS = 4  # number of fits, each after a search for outliers, which lose their weight
_MOST_ROWS = 400  # a longer table is averaged over runs of rows

Within = tuple[float, float] | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Rise:
    """Start and end of the rise.

    Parameters
    ----------
    start_rad, end_rad
        Angles of the cam at the start and at the end of the rise.
    start_found, end_found
        Whether the end was found from a dwell beside it. Otherwise it was given, or it is the end
        of the table.
    start_within_rad, end_within_rad
        Interval of each end at ``CONFIDENCE``; None unless the end was found.
    sentences
        A sentence about the start and one about the end: where it is, and how it was found.
    """

    start_rad: float
    end_rad: float
    start_found: bool
    end_found: bool
    start_within_rad: Within
    end_within_rad: Within
    sentences: tuple[str, ...]


def noise_of(x: FloatArray, y: FloatArray) -> float:
    """Return the standard deviation of the noise of ``y`` (n,) at rising ``x``, from differences.

    It is the root mean square of the fourth divided differences, each scaled so that noise of unit
    variance gives it unit variance. Differences of more than four times the robust spread (from the
    median) are outliers and left out.

    Raises
    ------
    OptionError
        If too few rows stand close enough together.
    """
    count = len(x) - _ORDER
    scaled = []
    if count > 0:
        spans = x[_ORDER:] - x[:-_ORDER]
        longest_span = float(np.median(np.diff(x))) * _ORDER * _NEAR
        for k in np.flatnonzero(spans <= longest_span).tolist():
            places = x[k : k + _ORDER + 1]
            distances = places[:, None] - places[None, :]
            np.fill_diagonal(distances, 1.0)
            weights = 1.0 / distances.prod(axis=1)
            scaled.append(weights @ y[k : k + _ORDER + 1] / np.linalg.norm(weights))
    if len(scaled) < _FEWEST:
        raise OptionError(
            f"cam: the noise cannot be estimated, {len(scaled)} runs of five rows stand close "
            f"enough together and {_FEWEST} are needed",
            remedy='Give the measuring error: --noise "0.05 mm".',
        )
    magnitudes = np.abs(np.array(scaled))
    robust_spread = 1.4826 * float(np.median(magnitudes))
    kept = (
        magnitudes[magnitudes <= _OUTLYING * robust_spread] if robust_spread > 0.0 else magnitudes
    )
    return float(np.sqrt(np.mean(kept**2)))


def refuse_no_rise(cam: MeasuredCam, noise_m: float) -> None:
    """Refuse a cam whose distance does not rise, or falls by more than its noise explains.

    With many rows each is replaced by the median of itself and its neighbours, so that an outlier
    does not count as a fall. Such medians differ by less than seven standard deviations.

    Raises
    ------
    OptionError
        If a row falls, because a law that goes back has no inverse; the error names the first one.
    """
    h = cam.h_m
    if len(h) > _FEW:
        medians = np.sort(np.stack((h[:-2], h[1:-1], h[2:])), axis=0)[1]
        h = np.concatenate((medians[:1], medians, medians[-1:]))
    highest = np.maximum.accumulate(h)
    fallen_rows = np.flatnonzero(highest - h > _FALL * noise_m)
    if not len(fallen_rows):
        rise_m = cam.h_m[-1] - cam.h_m[0]
        if not rise_m > _RISE * noise_m:
            raise OptionError(
                f"cam: the distances rise by {1e3 * rise_m:g} mm from the first row to the last, "
                f"which the noise of {1e3 * noise_m:.3g} mm explains",
                place=Place(cam.file, cam.lines[-1]),
                remedy="Give the rows of one rise, in the direction in which the distance grows.",
            )
        return
    low_row = int(fallen_rows[0])
    peak_row = int(np.flatnonzero(h[:low_row] >= highest[low_row] - 0.5 * _FALL * noise_m)[-1])
    # No medians near the peak, which they would flatten.
    unsmoothed = cam.h_m[max(peak_row - 1, 0) : low_row]
    peak_row = (
        low_row - 1 - int(np.argmax(unsmoothed[::-1] >= unsmoothed.max() - 0.5 * _FALL * noise_m))
    )
    degrees = np.degrees(cam.alpha_rad)
    raise OptionError(
        f"cam: the distance falls from {1e3 * cam.h_m[peak_row]:.6g} mm at {degrees[peak_row]:g} "
        f"deg to {1e3 * cam.h_m[low_row]:.6g} mm at {degrees[low_row]:g} deg, which the noise of "
        f"{1e3 * noise_m:.3g} mm does not explain: a law that goes back has no inverse",
        place=Place(cam.file, cam.lines[peak_row + 1]),
        remedy="Give the rows of one rise alone, in the direction in which the distance grows, or "
        "the measuring error: --noise.",
    )


def rise_of(
    alpha_rad: FloatArray,
    h_m: FloatArray,
    noise_m: float,
    follower: FloatArray,
    follower_noise: FloatArray,
    start_rad: float | None = None,
    end_rad: float | None = None,
) -> Rise:
    """Return the start and end of the rise.

    A dwell is a run of at least three rows, at an end of the table, that are equal within the
    noise. Beside a dwell the rise is too flat for its end to be visible in the rows. Both ends are
    therefore fitted, together with the shape of the rise, to all rows: each of the laws by name,
    and rises of free shape that leave their ends with the second to the fifth power of the time.
    The weight of a shape is its probability given the rows. Without a dwell the table begins or
    ends within the rise. Then the end of the table is taken as the end of the rise, and
    ``sentences`` reports it.

    Parameters
    ----------
    alpha_rad, h_m
        (n,) angles and distances of the rows.
    noise_m
        Standard deviation of the distances.
    follower, follower_noise
        (n,) positions of the follower at the rows, and their standard deviations.
    start_rad, end_rad
        Given start and end; found when None.

    Raises
    ------
    OptionError
        If a given angle leaves no rise, or the distances do not rise.
    """
    dwell_end, starts_in_dwell = _foot(alpha_rad, h_m, noise_m)
    mirrored_dwell_end, ends_in_dwell = _foot(-alpha_rad[::-1], -h_m[::-1], noise_m)
    start = dwell_end if start_rad is None else start_rad
    end = -mirrored_dwell_end if end_rad is None else end_rad
    if not alpha_rad[0] - 1e-12 <= start < end <= alpha_rad[-1] + 1e-12:
        raise OptionError(
            f"cam: a rise from {np.degrees(start):g} to {np.degrees(end):g} deg is not within the "
            f"table, {np.degrees(alpha_rad[0]):g} to {np.degrees(alpha_rad[-1]):g} deg"
        )
    free = (starts_in_dwell and start_rad is None, ends_in_dwell and end_rad is None)
    (start, end), within = _ends(alpha_rad, follower, follower_noise, (start, end), free)
    sentences = []
    for verb, given_rad, angle_rad, interval_rad in (
        ("starts", start_rad, start, within[0]),
        ("ends", end_rad, end, within[1]),
    ):
        explanation = (
            "as given"
            if given_rad is not None
            else f"{np.degrees(interval_rad[0]):.5g} to {np.degrees(interval_rad[1]):.5g} deg at "
            f"{100 * CONFIDENCE:g} %, from the shapes of rise that explain the rows"
            if interval_rad is not None
            else "at the end of the table, where it still moves: no dwell of "
            f"{_DWELL} rows shows the true end"
            if verb == "ends"
            else "at the beginning of the table, where it already moves: no dwell of "
            f"{_DWELL} rows shows the true start"
        )
        sentences.append(f"the rise {verb} at {np.degrees(angle_rad):.4g} deg, {explanation}")
    return Rise(
        start_rad=start, end_rad=end, start_found=starts_in_dwell and start_rad is None,
        end_found=ends_in_dwell and end_rad is None, start_within_rad=within[0],
        end_within_rad=within[1], sentences=tuple(sentences),
    )  # fmt: skip


def _ends(
    alpha: FloatArray,
    follower: FloatArray,
    noise: FloatArray,
    ends: tuple[float, float],
    free: tuple[bool, bool],
) -> tuple[tuple[float, float], tuple[Within, Within]]:
    """Return the two ends of the rise, and an interval for each end; only ``free`` ends are fitted.

    Each shape of rise (:func:`_shapes`) is fitted to the rows together with its ends. Its weight is
    the probability of the rows under it, with the integral over ends and coefficients by Laplace's
    method: MacKay, "Bayesian interpolation", Neural Computation 4 (1992). Each end is the median of
    the weighted sum of the shapes' normal distributions, and its interval is given by quantiles of
    that sum. For the intervals, the shapes that are no law by name get a weight of at least a half,
    because a law by name may explain the rows by chance.
    """
    if not any(free):
        return ends, (None, None)
    rows = np.arange(len(alpha))
    runs = np.array_split(rows, min(len(rows), _MOST_ROWS))
    x, y = (np.array([column[run].mean() for run in runs]) for column in (alpha, follower))
    deviation = np.array([noise[run].mean() / np.sqrt(len(run)) for run in runs])
    free_ends = np.flatnonzero(free)
    for _ in range(_LOOKS):
        fits = [_fitted(shape, x, y, deviation, ends, free_ends) for shape in _shapes()]
        rising = [fit for fit in fits if fit.rises]
        if not rising:
            raise OptionError(
                "cam: no rise between two dwells explains the rows",
                remedy='Say where it is: --start "7.5 deg" --end "127.5 deg".',
            )
        nearest = min(rising, key=lambda fit: float(fit.rest @ fit.rest))
        residuals = np.abs(nearest.rest)
        residual_scale = max(1.0, 1.4826 * float(np.median(residuals)))
        outlying = (residuals > _OUTLYING * residual_scale) & (
            deviation < _DOUBT * np.median(deviation)
        )
        if not outlying.any() or outlying.sum() > len(x) // 10:
            break
        deviation = np.where(outlying, 10.0 * _DOUBT * deviation, deviation)
    # If no shape explains the rows within the noise, the noise must be larger than given.
    scale = max(1.0, float(nearest.rest @ nearest.rest) / max(len(x) - 4, 1))
    log_weight = np.array([fit.likely - 0.5 * fit.squares / scale for fit in fits])
    log_weight[[not fit.rises for fit in fits]] = -np.inf
    weight = np.exp(log_weight - log_weight.max())
    # The true rise may have another shape, even if a law by name explains it.
    interval_weight, named_count = weight / weight.sum(), len(LAWS)
    free_share = interval_weight[named_count:].sum()
    if 0.0 < free_share < _FREE:
        interval_weight[:named_count] *= (1.0 - _FREE) / (1.0 - free_share)
        interval_weight[named_count:] *= _FREE / free_share
    found_ends = list(ends)
    within: list[Within] = [None, None]
    for k, end in enumerate(free_ends.tolist()):
        means = np.array([fit.ends[end] for fit in fits])
        deviations = np.sqrt([scale * fit.covariance[k, k] for fit in fits])
        (median,) = _quantiles(weight, means, deviations, [0.5])
        bounds = _quantiles(interval_weight, means, deviations, [_TAIL, 1.0 - _TAIL])
        low, found_ends[end], high = np.clip(
            [bounds[0], median, bounds[1]], alpha[0], alpha[-1]
        ).tolist()
        within[end] = (low, high)
    return (found_ends[0], found_ends[1]), (within[0], within[1])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Shape:
    """A shape of rise: a law by name, or the velocity t^p (1 - t)^q times a polynomial.

    ``centre`` and ``spread`` are the mean and the standard deviation of the time, weighted with the
    velocity. ``risen`` returns (n, k) rises at (n,) times, one column for each coefficient; with
    equal coefficients the polynomial is a constant. ``velocity`` holds the (m, k) differences of
    these rises at even times.
    """

    risen: Callable[[FloatArray], FloatArray]
    velocity: FloatArray
    centre: float
    spread: float


@cache
def _shapes() -> tuple[_Shape, ...]:
    """Return the shapes of rise that are fitted to a measured rise."""
    t = np.linspace(0.0, 1.0, 201)
    rises: list[Callable[[FloatArray], FloatArray]] = [
        *(partial(_named, each) for each in LAWS.values()),
        *(
            partial(_polynomial, *powers_and_degree)
            for powers_and_degree in product(_POWERS, _POWERS, _DEGREES)
        ),
    ]
    shapes = []
    middles = 0.5 * (t[1:] + t[:-1])
    for risen in rises:
        velocity = np.diff(risen(t), axis=0)
        share = velocity.sum(axis=1) / velocity.sum()
        centre = float(share @ middles)
        spread = float(np.sqrt(share @ (middles - centre) ** 2))
        shapes.append(_Shape(risen=risen, velocity=velocity, centre=centre, spread=spread))
    return tuple(shapes)


def _named(law: Law, t: FloatArray) -> FloatArray:
    return np.asarray(law(t))[:, None]


def _polynomial(p: int, q: int, degree: int, t: FloatArray) -> FloatArray:
    """Return (n, degree + 1) rises whose velocities are t^p (1 - t)^q times Bernstein polynomials.

    Their sum is a rise from 0 to 1; each is an incomplete beta function.
    """
    from scipy.special import beta, betainc, comb

    j = np.arange(degree + 1)
    scale = comb(degree, j) * beta(p + 1 + j, q + 1 + degree - j) / beta(p + 1, q + 1)
    return np.asarray(scale * betainc(p + 1 + j, q + 1 + degree - j, t[:, None]))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Fit:
    """A shape fitted to rows: its ends, their covariance, and how well it explains the rows.

    ``rest`` holds the (n,) residuals divided by the noise. ``squares`` is the sum of their squares
    and of the squared deviations of the coefficients. ``likely`` is the logarithm of the volume of
    ends and coefficients.
    """

    ends: tuple[float, float]
    covariance: FloatArray
    rest: FloatArray
    squares: float
    likely: float
    rises: bool


def _fitted(
    shape: _Shape, x: FloatArray, y: FloatArray, noise: FloatArray, ends: tuple[float, float],
    which: NDArray[np.int_],
) -> _Fit:  # fmt: skip
    """Return the fit of a shape to (n,) rows, with the ends ``which`` free.

    The prior of each coefficient is normal, with the height of the rise as mean and deviation.
    """
    from scipy.optimize import least_squares

    low, high = float(np.median(y[:_DWELL])), float(np.median(y[-_DWELL:]))
    height, count = max(high - low, float(noise.min())), shape.velocity.shape[1]
    share = np.diff(np.clip((y - low) / height, 0.0, 1.0))
    middles = 0.5 * (x[1:] + x[:-1])
    start_guess, end_guess = ends
    centre = float(
        np.clip(
            share @ middles,
            0.9 * start_guess + 0.1 * end_guess,
            0.1 * start_guess + 0.9 * end_guess,
        )
    )
    length = np.sqrt(max(float(share @ (middles - centre) ** 2), (x[1] - x[0]) ** 2)) / shape.spread
    target = np.concatenate((y / noise, np.ones(count)))
    coefficients = np.hstack((np.zeros((count, 1)), np.eye(count) / height))

    def placed(free: FloatArray) -> FloatArray:
        """Return both ends, from the free ends in lengths of the rise from its centre."""
        both = np.array(ends)
        both[which] = centre + length * free
        return both

    def matrix(free: FloatArray) -> FloatArray:
        start, end = placed(free).tolist()
        t = np.clip((x - start) / (end - start), 0.0, 1.0)
        rows = np.hstack((np.ones((len(x), 1)), shape.risen(t))) / noise[:, None]
        return np.vstack((rows, coefficients))

    def missed(free: FloatArray) -> FloatArray:
        q, _ = np.linalg.qr(matrix(free))
        return np.asarray(target - q @ (q.T @ target))

    lowest = np.array([min((x[0] - centre) / length, -0.02), 0.01])[which]
    highest = np.array([-0.01, max((x[-1] - centre) / length, 0.02)])[which]
    guess = np.array([-shape.centre, 1.0 - shape.centre])[which]
    solution = least_squares(
        missed, np.clip(guess, 0.999 * lowest + 0.001 * highest, 0.001 * lowest + 0.999 * highest),
        bounds=(lowest, highest), x_scale=0.02, xtol=1e-3, ftol=1e-3, max_nfev=15,
        diff_step=np.full(len(which), 2e-3),
    )  # fmt: skip
    q, r = np.linalg.qr(matrix(solution.x))
    fitted_coefficients = np.linalg.solve(r, q.T @ target)
    slopes = np.asarray(solution.jac)
    curvature = slopes.T @ slopes
    # The prior of an end is uniform over the table.
    curvature += 12.0 * (length / (x[-1] - x[0])) ** 2 * np.eye(len(which))
    covariance = length**2 * np.linalg.inv(curvature)
    residuals = missed(solution.x)
    velocity = shape.velocity @ fitted_coefficients[1:]
    start, end = placed(solution.x).tolist()
    return _Fit(
        ends=(start, end), covariance=covariance, rest=residuals[: len(x)],
        squares=float(residuals @ residuals),
        likely=float(
            0.5 * np.linalg.slogdet(covariance)[1]
            - np.log(np.abs(np.diag(r))).sum() - count * np.log(height)
        ),
        rises=bool(velocity.min() >= -_BACK * abs(velocity.max())),
    )  # fmt: skip


def _quantiles(
    weight: FloatArray, middle: FloatArray, spread: FloatArray, shares: list[float]
) -> FloatArray:
    """Return the quantiles at ``shares`` of a weighted sum of normal distributions."""
    from scipy.special import ndtr

    kept = weight > 1e-6 * weight.max()
    weight, middle, spread = weight[kept] / weight[kept].sum(), middle[kept], spread[kept]
    # Every distribution adds its own samples, so that a narrow one among wide ones is seen.
    standard_steps = np.linspace(-6.0, 6.0, 241)
    places = np.unique(middle[:, None] + spread[:, None] * standard_steps)
    distribution = ndtr((places[:, None] - middle) / spread) @ weight
    return np.asarray(np.interp(shares, distribution, places))


def _foot(x: FloatArray, y: FloatArray, noise: float) -> tuple[float, bool]:
    """Return ``x`` of the last row of the dwell at the beginning, and True.

    If the rows begin without a dwell, return ``x`` of the first row, and False.
    """
    dwell_rows = 0
    for k in range(_DWELL, len(x) + 1):
        mean = float(y[:k].mean())
        slope = np.polynomial.polynomial.polyfit(x[:k] - x[:k].mean(), y[:k], 1)[1]
        drift = abs(float(slope)) * float(x[k - 1] - x[0])
        if np.abs(y[:k] - mean).max() > 3.5 * noise or drift > 3.5 * noise * np.sqrt(12.0 / k):
            break
        dwell_rows = k
    if dwell_rows < _DWELL:
        return float(x[0]), False
    return float(x[dwell_rows - 1]), True
