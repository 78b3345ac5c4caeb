"""Shapers in closed form: zero vibration, and extra-insensitive ones with any number of humps.

With k humps, V is zero at k + 1 frequencies, and has a maximum at the tolerance between each two of
them. The modelled frequency is at the middle maximum for odd k, and at the middle zero for even k.
Positive trains have k + 2 impulses with unknown amplitudes and times. Unit-magnitude and negative
trains have 2 k + 3 impulses with given amplitudes and unknown times. In both cases there are as
many equations as unknowns. Undamped positive designs are Dolph-Chebyshev trains, which have a
closed form. All other designs are found from an undamped design, by continuation in the damping
ratio and the other parameters.

Source of the curve fits in ``fitted_humps``: Singhose, Seering and Singer, "Input shaping for
vibration reduction with specified insensitivity to modeling errors" (1996). The fits are valid to
damping ratios of 0.3 for two humps and 0.2 for three humps.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.errors import OptionError
from threadline.motion.shaping.response import Rows, pole
from threadline.motion.shaping.solvers import RESIDUAL, System, follow
from threadline.motion.shaping.types import ShaperError

SEED_TOLERANCE = 0.05
_DAMPING_STEP = 0.05
_LESS_DAMPED = (0.97, 0.94, 0.9, 0.8)
_LAST_ZERO = (1.0, 1.3, 1.7, 2.2, 3.0)
_MOST_ROUNDS = 300

# Undamped unit-magnitude trains with a tolerance of 5 %: times after the first, in periods, then
# the unknown zeros and maxima over the modelled frequency. Newton's method starts from these five
# digits. One hump: the shortest solution in a search from 1500 random symmetric starts. Two humps:
# the undamped train to which the published example of Pao and Singhose (3.04 Hz, damping 0.17)
# leads by continuation; there is no proof that it is the shortest.
_UNIT_MAGNITUDE_HUMPS_SEEDS = {
    1: (0.09408, 0.36837, 0.64266, 0.73673, 0.87037, 1.12276),
    2: (0.05996, 0.40099, 0.59323, 0.78546, 1.12649, 1.18645, 0.70318, 1.26911, 0.83556, 1.15593),
}


@dataclass(frozen=True, slots=True)
class Humps:
    """A solved design, in periods and relative frequencies.

    Parameters
    ----------
    amplitudes, times
        Shape ``(n,)``; times in undamped periods.
    zeros, peaks
        Relative frequencies of the zeros of V, shape ``(k + 1,)``, and of its maxima, ``(k,)``.
    """

    amplitudes: FloatArray
    times: FloatArray
    zeros: FloatArray
    peaks: FloatArray


def _unpack(x: FloatArray, humps: int, amplitudes: FloatArray | None) -> Humps:
    n = humps + 2 if amplitudes is None else 2 * humps + 3
    times = np.concatenate(([0.0], x[: n - 1]))
    other_unknowns = x[n - 1 :]
    if amplitudes is None:
        amplitudes, other_unknowns = other_unknowns[:n], other_unknowns[n:]
    # The middle zero (even k) or maximum (odd k) is at the modelled frequency, and no unknown.
    unknown_zeros = humps + humps % 2
    zeros, peaks = other_unknowns[:unknown_zeros], other_unknowns[unknown_zeros:]
    if humps % 2:
        peaks = np.insert(peaks, humps // 2, 1.0)
    else:
        zeros = np.insert(zeros, humps // 2, 1.0)
    return Humps(amplitudes, times, zeros, peaks)


def _system(humps: int, zeta: float, tolerance: float, amplitudes: FloatArray | None) -> System:
    def evaluate(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        train = _unpack(x, humps, amplitudes)
        rows = Rows(
            train.amplitudes,
            train.times,
            pole(zeta),
            free_amplitudes=amplitudes is None,
            unknown_frequencies=2 * humps,
        )
        slot = 0
        for i, f in enumerate(train.zeros):
            fixed = humps % 2 == 0 and i == humps // 2
            rows.zero(float(f), None if fixed else slot)
            slot += not fixed
        for i, f in enumerate(train.peaks):
            fixed = humps % 2 == 1 and i == humps // 2
            rows.level(float(f), tolerance, None if fixed else slot)
            rows.flat(float(f), tolerance, None if fixed else slot)
            slot += not fixed
        if amplitudes is None:
            rows.unit_sum()
        return rows.system()

    return evaluate


def chebyshev_seed(humps: int, tolerance: float) -> FloatArray:
    """Return the unknowns of the undamped positive design, exactly.

    With impulses every half period, V = tolerance |T_m(x0 cos(pi f / 2))|, where m = humps + 1 and
    T_m is the Chebyshev polynomial. V(0) = 1 gives T_m(x0) = 1 / tolerance. Source: Dolph (1946),
    for antennas; for one and two humps these are the closed forms of Singhose, Seering and Singer
    (1994).
    """
    m = humps + 1
    x0 = math.cosh(math.acosh(1.0 / tolerance) / m)
    roots = 2.0 * np.arccos(np.cos((2.0 * np.arange(1, m + 1) - 1.0) * np.pi / (2 * m)) / x0)
    amplitudes = np.real(np.poly(np.exp(1j * roots)))
    amplitudes /= amplitudes.sum()
    zeros = np.sort(roots / np.pi)
    peaks = np.sort(2.0 * np.arccos(np.cos(np.arange(1, m) * np.pi / m) / x0) / np.pi)
    if humps % 2:
        peaks = np.delete(peaks, humps // 2)
    else:
        zeros = np.delete(zeros, humps // 2)
    return np.concatenate((np.arange(1, m + 1) * 0.5, amplitudes, zeros, peaks))


def positive_humps(humps: int, zeta: float, tolerance: float) -> Humps:
    """Return the EI shaper with ``humps`` humps; the docstring of the module has the equations.

    Raises
    ------
    ShaperError
        If the continuation in the damping ratio loses the solution, and no other solution is found.
    """
    what = f"{humps}-hump EI shaper, damping {zeta:g}, tolerance {tolerance:g}"
    try:
        return _unpack(_damped(humps, zeta, tolerance, what), humps, None)
    except ShaperError:
        humps_found = _beyond(humps, zeta, tolerance, what)
        if humps_found is None:
            raise
        return humps_found


def _damped(humps: int, zeta: float, tolerance: float, what: str) -> FloatArray:
    return follow(
        lambda z: _system(humps, z, tolerance, None),
        chebyshev_seed(humps, tolerance),
        start=0.0,
        end=zeta,
        step=_DAMPING_STEP,
        what=what,
    )


def _beyond(humps: int, zeta: float, tolerance: float, what: str) -> Humps | None:
    """Return a design for a damping ratio at which the continuation fails; None if not found.

    With much damping, the last zero of V moves to high frequencies faster than the continuation can
    follow. So the search starts from a solution with less damping, whose last zero is multiplied by
    several factors.
    """
    from scipy.optimize import least_squares

    less_damped = None
    for share in _LESS_DAMPED:
        with suppress(ShaperError):
            less_damped = _damped(humps, share * zeta, tolerance, what)
            break
    if less_damped is None:
        return None
    # The last unknowns are the zeros, then the maxima, both without a fixed middle one.
    last_zero = len(less_damped) - (humps - humps % 2) - 1
    system = _system(humps, zeta, tolerance, None)

    def residual(y: FloatArray) -> FloatArray:
        return system(y)[0]

    def jacobian(y: FloatArray) -> FloatArray:
        return system(y)[1]

    for factor in _LAST_ZERO:
        seed = less_damped.copy()
        seed[last_zero] *= factor
        with np.errstate(over="ignore", invalid="ignore"), suppress(ValueError, OverflowError):
            x = least_squares(
                residual,
                seed,
                jac=jacobian,
                xtol=1e-15,
                ftol=1e-15,
                gtol=1e-15,
                max_nfev=_MOST_ROUNDS,
            ).x
            candidate = _unpack(np.asarray(x, dtype=np.float64), humps, None)
            # Zeros and maxima must alternate; a zero and a maximum at one frequency are no hump.
            zeros_and_peaks = np.empty(2 * humps + 1)
            zeros_and_peaks[::2], zeros_and_peaks[1::2] = candidate.zeros, candidate.peaks
            is_valid = (
                float(np.abs(system(x)[0]).max()) < RESIDUAL
                and bool(np.all(np.diff(candidate.times) > 0.0))
                and bool(np.all(candidate.amplitudes > 0.0))
                and bool(np.all(np.diff(zeros_and_peaks) > 1e-3))
            )
            if is_valid:
                return candidate
    return None


def switched_humps(humps: int, zeta: float, tolerance: float, amplitudes: FloatArray) -> Humps:
    """Return the design with (2 humps + 3,) given amplitudes of alternating sign and sum 1.

    The continuation goes from the unit-magnitude seed to the amplitudes, then to the tolerance,
    then to the damping ratio.

    Raises
    ------
    ShaperError
        If one of the continuations loses the solution.
    """
    unit = alternating(len(amplitudes))
    what = f"{humps}-hump shaper with given amplitudes, damping {zeta:g}, tolerance {tolerance:g}"
    x = np.array(_UNIT_MAGNITUDE_HUMPS_SEEDS[humps])
    x = follow(
        lambda c: _system(humps, 0.0, SEED_TOLERANCE, unit + c * (amplitudes - unit)),
        x,
        start=0.0,
        end=1.0 if bool(np.any(amplitudes != unit)) else 0.0,
        step=0.1,
        what=what,
    )
    x = follow(
        lambda c: _system(humps, 0.0, math.exp(c), amplitudes),
        x,
        start=math.log(SEED_TOLERANCE),
        end=math.log(tolerance),
        step=0.25,
        what=what,
    )
    x = follow(
        lambda z: _system(humps, z, tolerance, amplitudes),
        x,
        start=0.0,
        end=zeta,
        step=_DAMPING_STEP,
        what=what,
    )
    return _unpack(x, humps, amplitudes)


def alternating(n: int) -> FloatArray:
    """Return (n,) +1, -1, ... +1, n odd: the amplitudes of a unit-magnitude train."""
    return np.where(np.arange(n) % 2 == 0, 1.0, -1.0)


Train = tuple[FloatArray, FloatArray]
"""Amplitudes and times, (n,) each; times in undamped periods."""


def _damped_period(zeta: float) -> float:
    return 1.0 / math.sqrt(1.0 - zeta**2)


def _decay(zeta: float, damped_periods: float) -> float:
    return math.exp(-2.0 * math.pi * zeta * damped_periods / math.sqrt(1.0 - zeta**2))


def binomial(order: int, zeta: float) -> Train:
    """Return ZV (order 0), ZVD (1) or ZVDD (2): ZV convolved with itself ``order`` times.

    V and its first ``order`` derivatives are 0 at the mode. Source: Singer and Seering (1990).
    """
    n = order + 2
    k = _decay(zeta, 0.5)
    weights: FloatArray = np.array([math.comb(n - 1, i) * k**i for i in range(n)], dtype=np.float64)
    return weights / float(weights.sum()), np.arange(n, dtype=np.float64) * (
        0.5 * _damped_period(zeta)
    )


def modified_zv(zeta: float, n: int = 3, lasts: float = 0.75) -> Train:
    """Return MZV: ``n`` evenly spaced impulses over ``lasts`` damped periods; V is 0 at the mode.

    The undamped train is a polynomial in z. Its n - 1 roots lie on the unit circle, evenly spaced
    from the angle 2 pi ``lasts`` / (n - 1) to its conjugate. They are zeros of V at the mode and
    above it, in steps of (n - 1 - 2 ``lasts``) / (``lasts`` (n - 2)) times its frequency. For three
    impulses over 3/4 of a period the polynomial is 1 + sqrt(2) z + z^2.

    Raises
    ------
    OptionError
        If there are fewer than 3 impulses, if ``lasts`` is below 0.5, where some impulses would be
        negative, or if it is (n - 1) / 2 or more, where zeros of V coincide.
    """
    if n < 3:
        raise OptionError(f"mzv: n must be at least 3, got {n}")
    if not 0.5 <= lasts < 0.5 * (n - 1) - 1e-7:
        raise OptionError(
            f"mzv: {n} impulses over {lasts:.6g} damped periods; t must be at least 0.5 and below "
            f"(n - 1) / 2 = {0.5 * (n - 1):g}",
            remedy="Take more impulses, or less time.",
        )
    first_angle = 2.0 * math.pi * lasts / (n - 1)
    roots = np.exp(1j * np.linspace(first_angle, 2.0 * math.pi - first_angle, n - 1))
    undamped = np.real(np.poly(roots))
    periods = np.arange(n, dtype=np.float64) * lasts / (n - 1)
    nonzero = undamped > 1e-12
    weights: FloatArray = undamped[nonzero] * _decay(zeta, lasts / (n - 1)) ** np.flatnonzero(
        nonzero
    )
    return weights / float(weights.sum()), periods[nonzero] * _damped_period(zeta)


def _zero_system(order: int, zeta: float, amplitudes: FloatArray) -> System:
    def evaluate(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        times = np.concatenate(([0.0], x))
        rows = Rows(amplitudes, times, pole(zeta), free_amplitudes=False, unknown_frequencies=0)
        for derivative in range(order + 1):
            rows.zero(1.0, order=derivative)
        return rows.system()

    return evaluate


# Undamped unit-magnitude trains, times after the first in periods. ZV is exact: a sixth and a third
# of a period. ZVD has five digits: the limit of the one-hump train for a tolerance of 0.
_UNIT_MAGNITUDE_SEEDS = {0: (1.0 / 6.0, 1.0 / 3.0), 1: (0.08951, 0.36623, 0.64296, 0.73247)}


def switched_zero(order: int, zeta: float, amplitudes: FloatArray) -> Train:
    """Return ZV (order 0, 3 impulses) or ZVD (order 1, 5) with given amplitudes.

    The amplitudes alternate in sign and sum to 1. The continuation goes from the undamped
    unit-magnitude train to the amplitudes, then to the damping ratio.

    Raises
    ------
    ShaperError
        If a continuation loses the solution.
    """
    unit = alternating(len(amplitudes))
    what = f"zero-vibration shaper with given amplitudes, order {order}, damping {zeta:g}"
    stages: list[tuple[Callable[[float], System], float]] = [
        (
            lambda c: _zero_system(order, 0.0, unit + c * (amplitudes - unit)),
            1.0 if bool(np.any(amplitudes != unit)) else 0.0,
        ),
        (lambda z: _zero_system(order, z, amplitudes), zeta),
    ]
    x = np.array(_UNIT_MAGNITUDE_SEEDS[order])
    for system_at, end in stages:
        x = follow(system_at, x, start=0.0, end=end, step=0.1, what=what)
    return amplitudes, np.concatenate(([0.0], x))


# Times in periods and amplitudes as polynomials of the damping ratio, constant first.
_FITTED = {
    2: (
        (
            (0.0, 0.0, 0.0, 0.0),
            (0.49890, 0.16270, -0.54262, 6.16180),
            (0.99748, 0.18382, -1.58270, 8.17120),
            (1.49920, -0.09297, -0.28338, 1.85710),
        ),
        (
            (0.16054, 0.76699, 2.26560, -1.22750),
            (0.33911, 0.45081, -2.58080, 1.73650),
            (0.34089, -0.61533, -0.68765, 0.42261),
            (0.15997, -0.60246, 1.00280, -0.93145),
        ),
    ),
    3: (
        (
            (0.0, 0.0, 0.0, 0.0),
            (0.49974, 0.23834, 0.44559, 12.4720),
            (0.99849, 0.29808, -2.36460, 23.3990),
            (1.49870, 0.10306, -2.01390, 17.0320),
            (1.99960, -0.28231, 0.61536, 5.40450),
        ),
        (
            (0.11275, 0.76632, 3.29160, -1.44380),
            (0.23698, 0.61164, -2.57850, 4.85220),
            (0.30008, -0.19062, -2.14560, 0.13744),
            (0.23775, -0.73297, 0.46885, -2.08650),
            (0.11244, -0.45439, 0.96382, -1.46000),
        ),
    ),
}


def fitted_humps(humps: int, damping_ratio: float) -> tuple[FloatArray, FloatArray]:
    """Return (n,) times in undamped periods and (n,) amplitudes: n = 4 for 2 humps, 5 for 3.

    Source: the curve fits of Singhose, Seering and Singer (1996) at a tolerance of 5 %.
    """
    powers = damping_ratio ** np.arange(4)
    periods, weights = (np.array(table) @ powers for table in _FITTED[humps])
    return periods, weights
