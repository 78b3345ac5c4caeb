"""Extra-insensitive shapers: k humps of vibration as high as the tolerance, exactly.

V is zero at k + 1 frequencies and reaches the tolerance, flat, between each two of them; for
odd k the modelled frequency is the middle peak, for even k the middle zero. Positive trains
have k + 2 impulses, amplitudes and times both unknown; unit-magnitude and negative trains have
2 k + 3 impulses of given amplitudes. Either way there are as many equations as unknowns.
Undamped positive designs are Dolph-Chebyshev trains and known in closed form; everything else
is followed from an undamped seed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from threadline.arrays import FloatArray
from threadline.shaping.newton import System, follow
from threadline.shaping.response import Rows, pole

SEED_TOLERANCE = 0.05
_DAMPING_STEP = 0.05

# Undamped unit-magnitude trains at 5 %: times after the first, in periods, then the unknown
# zeros and peaks relative to the modelled frequency. Five digits, to be finished by Newton.
# One hump: the shortest root that a search from 1500 random symmetric starts found. Two humps:
# the train that Pao and Singhose's published example (3.04 Hz, damping 0.17) leads back to; that
# it is the shortest is not proved.
_UM_SEEDS = {
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
        Relative frequencies where V is 0, shape ``(k + 1,)``, and where it peaks, ``(k,)``.
    """

    amplitudes: FloatArray
    times: FloatArray
    zeros: FloatArray
    peaks: FloatArray


def _unpack(x: FloatArray, humps: int, amplitudes: FloatArray | None) -> Humps:
    n = humps + 2 if amplitudes is None else 2 * humps + 3
    times = np.concatenate(([0.0], x[: n - 1]))
    rest = x[n - 1 :]
    if amplitudes is None:
        amplitudes, rest = rest[:n], rest[n:]
    # The middle zero (even k) or peak (odd k) is the modelled frequency: no unknown.
    unknown_zeros = humps + humps % 2
    zeros, peaks = rest[:unknown_zeros], rest[unknown_zeros:]
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
    """Unknowns of the undamped positive design, exact.

    Impulses every half period make V = tolerance |T_m(x0 cos(pi f / 2))|, m = humps + 1, with
    T_m(x0) = 1 / tolerance because V(0) = 1 (Dolph 1946, for antennas; the one- and two-hump
    cases are the closed forms of Singhose, Seering and Singer 1994).
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
    """EI shaper of ``humps`` humps; see the module for the equations.

    Raises
    ------
    ShaperError
        If the continuation in the damping ratio loses the solution.
    """
    x = follow(
        lambda z: _system(humps, z, tolerance, None),
        chebyshev_seed(humps, tolerance),
        start=0.0,
        end=zeta,
        step=_DAMPING_STEP,
        what=f"{humps}-hump EI shaper, damping {zeta:g}, tolerance {tolerance:g}",
    )
    return _unpack(x, humps, None)


def switched_humps(humps: int, zeta: float, tolerance: float, amplitudes: FloatArray) -> Humps:
    """Hump design with given amplitudes, 2 humps + 3 of them, alternating in sign, sum 1.

    The unit-magnitude seed is led to the amplitudes, then to the tolerance, then to the damping.

    Raises
    ------
    ShaperError
        If one of the continuations loses the solution.
    """
    unit = alternating(len(amplitudes))
    what = f"{humps}-hump shaper with given amplitudes, damping {zeta:g}, tolerance {tolerance:g}"
    x = np.array(_UM_SEEDS[humps])
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
    """+1 -1 +1 ... of odd length: the amplitudes of a unit-magnitude train."""
    return np.where(np.arange(n) % 2 == 0, 1.0, -1.0)
