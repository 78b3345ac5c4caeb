"""From a measured cam to a law: noise, rise, fairing methods, and the uncertainty of the peaks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray
from threadline.errors import OptionError, Place
from threadline.motion.laws.cam import MeasuredCam
from threadline.motion.laws.fairing import (
    MOST_PASSES,
    Rebound,
    Smoothed,
    Smoother,
    differences,
    pass_matrix,
    rebound,
)
from threadline.motion.laws.law import Law
from threadline.motion.laws.law_table import law_of_velocity, law_through
from threadline.motion.laws.measured_rise import Rise, noise_of, refuse_no_rise, rise_of

DRAWS = 200
_SEED = 1954
_OUTLIER = 4.0
_DOUBT = 1e3
_MISSED = 2.0
_EVEN = 1e-4  # share of the mean spacing: largest difference of spacings that count as even
_EXACT = 1e-9  # share of the rise: smaller than the resolution of any gauge
_LOOKS = 16  # number of samples in each interval between rows


class Fairing(StrEnum):
    """Methods that remove the measuring error from a cam."""

    NONE = "none"
    DIFFERENCES = "differences"
    REBOUND = "rebound"
    SPLINE = "spline"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Faired:
    """A cam faired by one method.

    Parameters
    ----------
    fairing
        The fairing method.
    distances_m
        (n,) corrected distances of the rows.
    moved_m
        Root mean square of the corrections.
    second_m
        Largest second difference of neighbouring rows, scaled to the median spacing.
    peaks, spread
        (3,) Cv, Ca and Cj of the law, and their standard deviations over draws of the noise. If
        the law is a spline through the rows, the remaining noise makes Ca and Cj large.
    monotone
        Whether the rise never goes back.
    """

    fairing: Fairing
    distances_m: FloatArray
    moved_m: float
    second_m: float
    peaks: FloatArray
    spread: FloatArray
    monotone: bool


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CamStudy:
    """A cam, its fairings and its law.

    Parameters
    ----------
    cam
        The cam as it was measured.
    noise_m, noise_given
        Standard deviation of the distances, and whether it was given rather than estimated.
    rise
        Where the rise starts and ends.
    fairings
        One result for each method of :class:`Fairing`, in its order; none for differences if the
        rows are not evenly spaced.
    chosen
        The fairing that the law was made from.
    law
        The rise from its start to its end, normalised.
    outliers
        Indices of rows whose distance from a smoothing spline through the other rows is more than
        four times the noise. The law is nevertheless faired with these rows.
    scaled
        (n,) residuals of the rows from the smoothing spline, divided by the noise.
    rebounded
        The rebound, with its number of passes and the reason of its end.
    warnings
        Doubtful facts about the cam or the law, a line for each.
    """

    cam: MeasuredCam
    noise_m: float
    noise_given: bool
    rise: Rise
    fairings: tuple[Faired, ...]
    chosen: Fairing
    law: Law
    outliers: tuple[int, ...]
    scaled: FloatArray
    rebounded: Rebound
    warnings: tuple[str, ...]

    def faired(self, fairing: Fairing) -> Faired | None:
        """Return the cam faired by ``fairing``; None if its rows do not allow it."""
        return next((each for each in self.fairings if each.fairing is fairing), None)


def study_cam(
    cam: MeasuredCam,
    *,
    fairing: Fairing = Fairing.SPLINE,
    noise_m: float | None = None,
    rise_rad: tuple[float | None, float | None] = (None, None),
    epsilon_m: float | None = None,
    most_passes: int = MOST_PASSES,
    draws: int = DRAWS,
) -> CamStudy:
    """Return the law of a measured cam, together with every fairing.

    Parameters
    ----------
    noise_m
        Standard deviation of the measuring error; estimated from differences when None.
    rise_rad
        Cam angles at which the rise starts and ends; found from the dwells when None.
    epsilon_m, most_passes
        Parameters of the rebound: see :func:`threadline.motion.laws.fairing.rebound`.
    draws
        Number of noise draws for the spread of the peaks; every call uses the same draws.

    Raises
    ------
    OptionError
        If a number is not positive, the noise cannot be estimated, there is no rise or no row
        within it, or the law of the chosen fairing cannot be made.
    """
    start_rad, end_rad = rise_rad
    for what, value in (("noise", noise_m), ("epsilon", epsilon_m), ("passes", most_passes)):
        if value is not None and not 0.0 < value < np.inf:
            raise OptionError(f"cam: the {what} must be positive, got {value:g}")
    alpha, h = cam.alpha_rad, cam.h_m
    noise = max(noise_of(alpha, h), cam.rounding_m) if noise_m is None else noise_m
    if not noise > _EXACT * float(np.ptp(h)):
        raise OptionError(
            f"cam: the rows show no noise, {1e3 * noise:.2g} mm over {1e3 * float(np.ptp(h)):.4g} "
            "mm: they were computed and not measured",
            place=Place(cam.file),
            remedy='Say how far to trust them: --noise "0.001 mm".',
        )
    refuse_no_rise(cam, noise)
    follower_noise = noise * np.abs(cam.follower_slope)
    rise = rise_of(alpha, h, noise, cam.follower, follower_noise, start_rad, end_rad)
    t = (alpha - rise.start_rad) / (rise.end_rad - rise.start_rad)
    in_rise = (t >= -1e-12) & (t <= 1.0 + 1e-12)
    if not in_rise.any():
        raise OptionError(
            f"cam: no row lies within the rise, {np.degrees(rise.start_rad):.4g} to "
            f"{np.degrees(rise.end_rad):.4g} deg",
            place=Place(cam.file),
            remedy="Measure rows between the two dwells.",
        )
    smooth_ends = (rise.start_found or start_rad is not None, rise.end_found or end_rad is not None)
    smoother = Smoother(t, follower_noise, smooth_ends)
    weight = smoother.weight_for(cam.follower)
    smooth = smoother.fit(cam.follower, weight)
    bounced = rebound(alpha, h, noise, epsilon=epsilon_m, most_passes=most_passes)
    evenly_spaced = float(np.ptp(np.diff(alpha))) <= _EVEN * float(np.diff(alpha).mean())

    methods: dict[Fairing, Callable[[FloatArray], FloatArray]] = {Fairing.NONE: lambda y: y}
    if evenly_spaced:
        methods[Fairing.DIFFERENCES] = lambda y: differences(y, noise)
    # The rebound is linear, and its slopes at the ends are 0.
    rebound_matrix = np.linalg.matrix_power(pass_matrix(alpha), bounced.passes)
    methods[Fairing.REBOUND] = lambda y: rebound_matrix @ y
    random = np.random.default_rng(_SEED)
    smoothed_m = cam.distance_of(smooth.values)
    drawn_m = [smoothed_m + noise * random.standard_normal(len(h)) for _ in range(draws)]
    faired_cams = []
    for each, method in methods.items():
        followers = np.array([cam.follower_of(method(y)) for y in drawn_m])
        spread = _spline_peaks(t, followers.T, in_rise).T
        faired_cams.append(_faired(each, cam, method(h), t, in_rise, spread))
    spread = np.array([smoother.peaks(smoother.solve(cam.follower_of(y), weight)) for y in drawn_m])
    law = law_of_velocity("cam", smooth.knots, smooth.coefficients, 3)
    faired_cams.append(
        Faired(
            fairing=Fairing.SPLINE, distances_m=smoothed_m, moved_m=_rms(smoothed_m - h),
            second_m=_second(alpha, smoothed_m),
            peaks=np.array([law.velocity, law.acceleration, law.jerk or np.inf]),
            spread=spread.std(axis=0), monotone=True,
        )
    )  # fmt: skip
    chosen = next((each for each in faired_cams if each.fairing is fairing), None)
    if chosen is None:
        raise OptionError(
            "cam: differences need rows at even angles", remedy="Choose spline or rebound."
        )
    if fairing is not Fairing.SPLINE:
        law = _through(t, cam.follower_of(chosen.distances_m), in_rise)
    outliers, scaled = _outliers(t, follower_noise, smooth_ends, cam.follower, weight)
    return CamStudy(
        cam=cam, noise_m=noise, noise_given=noise_m is not None, rise=rise,
        fairings=tuple(faired_cams), chosen=fairing, law=law, outliers=outliers,
        scaled=scaled, rebounded=bounced,
        warnings=(
            *_warnings_of_rows(cam, rise, outliers),
            *_warnings_of_fit(chosen, bounced, epsilon_m, noise, smooth),
        ),
    )  # fmt: skip


def _outliers(
    t: FloatArray,
    noise: FloatArray,
    smooth_ends: tuple[bool, bool],
    follower: FloatArray,
    weight: float,
) -> tuple[tuple[int, ...], FloatArray]:
    """Return the outliers among the rows, and (n,) residuals divided by the noise.

    Outliers are found one by one, the worst first; they are at most a tenth of the rows. Each
    outlier loses its weight before the search for the next one, because it would pull the fit away
    from its neighbours.
    """
    outlier_rows: list[int] = []
    row_noise = noise.copy()
    scaled_residuals = np.zeros_like(noise)
    for _ in range(len(t) // 10 + 1):
        fit = Smoother(t, row_noise, smooth_ends).fit(follower, weight)
        magnitudes = np.abs(fit.scaled)
        magnitudes[outlier_rows] = 0.0
        scaled_residuals = np.where(row_noise > noise, (follower - fit.values) / noise, fit.scaled)
        worst = int(np.argmax(magnitudes))
        if magnitudes[worst] <= _OUTLIER or len(outlier_rows) >= len(t) // 10:
            break
        outlier_rows.append(worst)
        row_noise[worst] *= _DOUBT
    return tuple(sorted(outlier_rows)), scaled_residuals


def _normalised(
    t: FloatArray, follower: FloatArray, inside: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray]:
    """Return times and rises, from 0 to 1, of the rows ``inside``; missing ends are added.

    ``follower`` is (n,), or (n, draws) for the rises of many draws.
    """
    first, last = follower[inside][0], follower[inside][-1]
    before_rise, after_rise = follower[t < 0.0], follower[t > 1.0]
    low = before_rise.mean(axis=0) if len(before_rise) else first
    high = after_rise.mean(axis=0) if len(after_rise) else last
    u, s = t[inside], (follower[inside] - low) / (high - low)
    zero_row = np.zeros_like(s[:1])
    if u[0] > 1e-9:
        u, s = np.append(0.0, u), np.concatenate((zero_row, s))
    if u[-1] < 1.0 - 1e-9:
        u, s = np.append(u, 1.0), np.concatenate((s, zero_row + 1.0))
    u, s = u.copy(), s.copy()
    u[0], u[-1], s[0], s[-1] = 0.0, 1.0, 0.0, 1.0
    return u, s


def _spline_peaks(t: FloatArray, follower: FloatArray, inside: NDArray[np.bool_]) -> FloatArray:
    """Return Cv, Ca and Cj of the clamped cubic spline through rows; Cv is taken from samples.

    They are (3,) for a follower (n,), and (3, draws) for (n, draws).
    """
    from scipy.interpolate import CubicSpline

    u, s = _normalised(t, follower, inside)
    spline = CubicSpline(u, s, bc_type="clamped")
    sample_times = (u[:-1, None] + np.diff(u)[:, None] * np.arange(_LOOKS) / _LOOKS).ravel()
    knot_accelerations = spline(u, 2)
    jerks = (np.diff(knot_accelerations, axis=0).T / np.diff(u)).T
    return np.array(
        [
            np.abs(derivative).max(axis=0)
            for derivative in (spline(sample_times, 1), knot_accelerations, jerks)
        ]
    )


def _through(t: FloatArray, follower: FloatArray, inside: NDArray[np.bool_]) -> Law:
    u, s = _normalised(t, follower, inside)
    return law_through("cam", u, s, None, None)


def _faired(
    fairing: Fairing, cam: MeasuredCam, h: FloatArray, t: FloatArray, inside: NDArray[np.bool_],
    spread: FloatArray,
) -> Faired:  # fmt: skip
    from scipy.interpolate import CubicSpline

    u, s = _normalised(t, cam.follower_of(h), inside)
    slope = CubicSpline(u, s, bc_type="clamped")(np.linspace(0.0, 1.0, 2001), 1)
    return Faired(
        fairing=fairing, distances_m=h, moved_m=_rms(h - cam.h_m),
        second_m=_second(cam.alpha_rad, h), peaks=_spline_peaks(t, cam.follower_of(h), inside),
        spread=spread.std(axis=0), monotone=bool(slope.min() > -1e-9),
    )  # fmt: skip


def _rms(x: FloatArray) -> float:
    return float(np.sqrt(np.mean(x * x)))


def second_differences(x: FloatArray, y: FloatArray) -> FloatArray:
    """Return (n - 2,) second differences of ``y`` (n,), scaled to the median spacing of ``x``."""
    step = float(np.median(np.diff(x)))
    slopes = np.diff(y) / np.diff(x)
    return np.asarray(2.0 * np.diff(slopes) / (x[2:] - x[:-2]) * step**2)


def _second(x: FloatArray, y: FloatArray) -> float:
    return float(np.abs(second_differences(x, y)).max())


def _warnings_of_rows(cam: MeasuredCam, rise: Rise, outliers: tuple[int, ...]) -> list[str]:
    warnings = []
    if cam.flags:
        angles = ", ".join(f"{np.degrees(cam.alpha_rad[flag.row]):g}" for flag in cam.flags)
        warnings.append(
            f"{len(cam.flags)} printed {'angle does' if len(cam.flags) == 1 else 'angles do'} not "
            f"match the measured distance, at {angles} deg; the distance is trusted"
        )
    if outliers:
        angles = ", ".join(f"{np.degrees(cam.alpha_rad[row]):g}" for row in outliers)
        warnings.append(
            f"{len(outliers)} {'row lies' if len(outliers) == 1 else 'rows lie'} more than "
            f"{_OUTLIER:g} times the noise off the smooth rise, at {angles} deg; kept, and to be "
            "measured again"
        )
    if not (rise.start_found and rise.end_found):
        warnings += [line for line in rise.sentences if "no dwell" in line]
    return warnings


def _warnings_of_fit(
    chosen: Faired, bounced: Rebound, epsilon: float | None, noise: float, smooth: Smoothed
) -> list[str]:
    warnings = []
    if epsilon is not None:
        warnings.append(
            f"epsilon alone flattens the cam: the rebound goes on to a single cubic; after "
            f"{bounced.passes} passes it has moved the rows by {1e3 * bounced.moved:.3g} mm rms, "
            f"the noise is {1e3 * noise:.3g} mm"
        )
    if not chosen.monotone:
        warnings.append(f"the law of the fairing {chosen.fairing} goes back: it has no inverse")
    if smooth.missed > _MISSED:
        warnings.append(
            "the nearest monotone rise from rest to rest misses the rows by "
            f"{smooth.missed:.3g} times the noise: the noise is larger than given, rows are "
            "wrong, or the ends are not at rest"
        )
    rows = len(chosen.distances_m)
    if smooth.freedom > 0.7 * rows:
        warnings.append(
            f"{rows} rows are few: the fit uses {smooth.freedom:.3g} parameters for them, "
            "so that Ca and Cj are little more than the smoothing"
        )
    return warnings
