"""The noise of a measured cam, and the start and the end of its rise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.errors import OptionError, Place
from threadline.motion.laws.cam import MeasuredCam
from threadline.motion.laws.fairing import Smoother

_ORDER = 4  # of the differences: for a smooth rise at a hundred rows they are far below its noise
_NEAR = 1.8  # five rows spanning more than this times the median have a gap and give no noise
_OUTLYING = 4.0
_FEWEST = 8
_FEW = 20  # rows: with so few, no median is taken
_FALL, _RISE = 7.0, 6.0  # times the noise
_DWELL = 3  # least number of rows of a dwell
_STIFF = 1e-9  # weight of the jerk per row: stiff enough that the ends matter more than the noise
_TRIED = 0.03  # first step of the search for an end, as a share of the rise's length


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
    said
        A sentence about the start and one about the end: where it is, and how it was found.
    """

    start_rad: float
    end_rad: float
    start_found: bool
    end_found: bool
    said: tuple[str, ...]


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
        usual = float(np.median(np.diff(x))) * _ORDER * _NEAR
        for k in np.flatnonzero(spans <= usual).tolist():
            at = x[k : k + _ORDER + 1]
            apart = at[:, None] - at[None, :]
            np.fill_diagonal(apart, 1.0)
            weights = 1.0 / apart.prod(axis=1)
            scaled.append(weights @ y[k : k + _ORDER + 1] / np.linalg.norm(weights))
    if len(scaled) < _FEWEST:
        raise OptionError(
            f"cam: the noise cannot be estimated, {len(scaled)} runs of five rows stand close "
            f"enough together and {_FEWEST} are needed",
            remedy='Give the measuring error: --noise "0.05 mm".',
        )
    found = np.abs(np.array(scaled))
    robust = 1.4826 * float(np.median(found))
    kept = found[found <= _OUTLYING * robust] if robust > 0.0 else found
    return float(np.sqrt(np.mean(kept**2)))


def refuse_no_rise(cam: MeasuredCam, noise_m: float) -> None:
    """Refuse a cam whose distance does not rise, or falls by more than its noise explains.

    With many rows each is replaced by the median of itself and its neighbours, so that an outlier
    does not count as a fall. Such medians differ by less than seven standard deviations.

    Raises
    ------
    OptionError
        Names the first row that falls: a law that goes back has no inverse.
    """
    h = cam.h_m
    if len(h) > _FEW:
        triples = np.sort(np.stack((h[:-2], h[1:-1], h[2:])), axis=0)[1]
        h = np.concatenate((triples[:1], triples, triples[-1:]))
    highest = np.maximum.accumulate(h)
    fallen = np.flatnonzero(highest - h > _FALL * noise_m)
    if not len(fallen):
        rise_m = cam.h_m[-1] - cam.h_m[0]
        if not rise_m > _RISE * noise_m:
            raise OptionError(
                f"cam: the distances rise by {1e3 * rise_m:g} mm from the first row to the last, "
                f"which the noise of {1e3 * noise_m:.3g} mm explains",
                place=Place(cam.file, cam.lines[-1]),
                remedy="Give the rows of one rise, in the direction in which the distance grows.",
            )
        return
    low = int(fallen[0])
    top = int(np.flatnonzero(h[:low] >= highest[low] - 0.5 * _FALL * noise_m)[-1])
    near = cam.h_m[max(top - 1, 0) : low]  # a median would flatten the peak
    top = low - 1 - int(np.argmax(near[::-1] >= near.max() - 0.5 * _FALL * noise_m))
    degrees = np.degrees(cam.alpha_rad)
    raise OptionError(
        f"cam: the distance falls from {1e3 * cam.h_m[top]:.6g} mm at {degrees[top]:g} deg to "
        f"{1e3 * cam.h_m[low]:.6g} mm at {degrees[low]:g} deg, which the noise of "
        f"{1e3 * noise_m:.3g} mm does not explain: a law that goes back has no inverse",
        place=Place(cam.file, cam.lines[top + 1]),
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
    therefore fitted: the stiff monotone rise with velocity and acceleration 0 at these ends comes
    nearest to all rows. Without a dwell the table begins or ends within the rise; then the end of
    the table is taken, and ``said`` reports it.

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
    first, early = _foot(alpha_rad, h_m, noise_m)
    mirrored, late = _foot(-alpha_rad[::-1], -h_m[::-1], noise_m)
    start = first if start_rad is None else start_rad
    end = -mirrored if end_rad is None else end_rad
    if not alpha_rad[0] - 1e-12 <= start < end <= alpha_rad[-1] + 1e-12:
        raise OptionError(
            f"cam: a rise from {np.degrees(start):g} to {np.degrees(end):g} deg is not within the "
            f"table, {np.degrees(alpha_rad[0]):g} to {np.degrees(alpha_rad[-1]):g} deg"
        )
    free = (early and start_rad is None, late and end_rad is None)
    start, end = _nearest(alpha_rad, follower, follower_noise, (start, end), free)
    said = []
    for which, given, found, at in (
        ("starts", start_rad, early, start),
        ("ends", end_rad, late, end),
    ):
        how = (
            "as given"
            if given is not None
            else "where a stiff rise between the dwells comes nearest to the rows"
            if found
            else "at the end of the table, where it still moves: no dwell of "
            f"{_DWELL} rows shows the true end"
            if which == "ends"
            else "at the beginning of the table, where it already moves: no dwell of "
            f"{_DWELL} rows shows the true start"
        )
        said.append(f"the rise {which} at {np.degrees(at):.4g} deg, {how}")
    return Rise(
        start_rad=start, end_rad=end, start_found=early and start_rad is None,
        end_found=late and end_rad is None, said=tuple(said),
    )  # fmt: skip


def _nearest(
    alpha: FloatArray,
    follower: FloatArray,
    noise: FloatArray,
    ends: tuple[float, float],
    free: tuple[bool, bool],
) -> tuple[float, float]:
    """Return the ends with which a stiff rise fits the rows best; ends that are not free stay."""
    from scipy.optimize import minimize

    if not any(free):
        return ends
    which = np.flatnonzero(free)
    scale = _TRIED * (ends[1] - ends[0])

    def placed(moved: FloatArray) -> FloatArray:
        both = np.array(ends)
        both[which] += scale * moved
        return np.asarray(np.clip(both, alpha[0], alpha[-1]))

    def missed(moved: FloatArray) -> float:
        start, end = placed(moved).tolist()
        if not end > start:
            return np.inf
        smoother = Smoother((alpha - start) / (end - start), noise)
        weight = _STIFF * len(alpha)
        found = smoother.solve(follower, weight)
        rest = smoother.rows @ found - follower / noise
        jerk = smoother.penalty @ found
        return float(rest @ rest + weight * (jerk @ jerk))

    # The search goes inwards from the last rows of the dwells: the rise starts there or later.
    inwards = np.array([1.0, -1.0])[which]
    simplex = np.vstack((np.zeros(len(which)), np.diag(inwards)))
    found = minimize(
        missed, np.zeros(len(which)), method="Nelder-Mead",
        options={"initial_simplex": simplex, "xatol": 0.01, "fatol": 0.01, "maxfev": 200},
    )  # fmt: skip
    start, end = placed(found.x).tolist()
    return start, end


def _foot(x: FloatArray, y: FloatArray, noise: float) -> tuple[float, bool]:
    """Return ``x`` of the last row of the dwell at the beginning, and True.

    Where the rows begin without a dwell it is ``x`` of the first row, and False.
    """
    count = 0
    for k in range(_DWELL, len(x) + 1):
        level = float(y[:k].mean())
        slope = np.polynomial.polynomial.polyfit(x[:k] - x[:k].mean(), y[:k], 1)[1]
        drift = abs(float(slope)) * float(x[k - 1] - x[0])
        if np.abs(y[:k] - level).max() > 3.5 * noise or drift > 3.5 * noise * np.sqrt(12.0 / k):
            break
        count = k
    if count < _DWELL:
        return float(x[0]), False
    return float(x[count - 1]), True
