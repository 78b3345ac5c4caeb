"""What a real controller makes of a shaper, and what that costs.

A PLC switches on its scan, a valve needs time between two switchings, a program has room for so
many impulses. The train is moved onto the tick by a local search over whole ticks, with the
amplitudes solved again where the machine can set them, and the price is reported.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.errors import OptionError
from threadline.shaping.response import pole
from threadline.shaping.types import FlexibleMode, Shaper, ShaperError
from threadline.shaping.vibration import residual_vibration

_BAND_SAMPLES = 9
_ROUNDS = 40
_LONGEST = 100  # ticks or dwells beyond this many trains leave nothing of the shaping
_MOST_TICKS = 1e12


@dataclass(frozen=True, slots=True)
class ControllerLimits:
    """What the controller and its valves can do.

    Parameters
    ----------
    tick_s
        Every impulse falls on a whole number of these, s.
    dwell_s
        Shortest time between two switchings, s; 0 for none.
    max_impulses
        Longest train, or None.
    amplitudes_free
        True where amplitudes can be set anew (flow valves); False keeps them (on/off valves).
    """

    tick_s: float
    dwell_s: float = 0.0
    max_impulses: int | None = None
    amplitudes_free: bool = False

    def __post_init__(self) -> None:
        if not (math.isfinite(self.tick_s) and self.tick_s > 0.0):
            raise OptionError(
                f"controller: tick_s must be positive, got {self.tick_s!r}",
                remedy="Give the period of its scan.",
            )
        if not (math.isfinite(self.dwell_s) and self.dwell_s >= 0.0):
            raise OptionError(
                f"controller: dwell_s must be >= 0, got {self.dwell_s!r}",
                remedy="Give the shortest time between two switchings.",
            )
        if self.max_impulses is not None and self.max_impulses < 2:
            raise OptionError(
                f"controller: max_impulses must be >= 2, got {self.max_impulses!r}",
                remedy="A train of one impulse shapes nothing.",
            )


@dataclass(frozen=True, slots=True)
class Realised:
    """The train that the controller can play, beside the one that was designed.

    Parameters
    ----------
    shaper, designed
        Both trains.
    ticks
        Impulse times as whole ticks.
    vibration, designed_vibration
        Worst V over the modes at their modelled frequencies.
    """

    shaper: Shaper
    designed: Shaper
    ticks: tuple[int, ...]
    vibration: float
    designed_vibration: float

    @property
    def time_price_s(self) -> float:
        """How much longer the train became; negative if shorter."""
        return self.shaper.duration_s - self.designed.duration_s

    @property
    def vibration_price(self) -> float:
        """How much V at the modelled frequencies rose."""
        return self.vibration - self.designed_vibration


def realise(
    shaper: Shaper,
    modes: Sequence[FlexibleMode],
    limits: ControllerLimits,
    *,
    relative: float = 0.0,
) -> Realised:
    """Fit ``shaper`` to a controller with the least worst V over the modes and their bands.

    The search is local: coordinates and pairs of neighbours by one or two ticks, from the
    rounded times. With ``max_impulses``, positive trains lose their smallest impulse, others
    the closest pair of opposite ones, one at a time.

    Parameters
    ----------
    shaper
        Designed train.
    modes
        At least one; the worst counts.
    limits
        The controller's.
    relative
        Half width of the band of frequency that counts, in [0, 1).

    Raises
    ------
    OptionError
        If there is no mode, or a time of the controller is out of all proportion to them.
    ShaperError
        If no train of that many impulses is left.
    """
    if not modes:
        raise OptionError("controller: at least one mode is needed to judge the train by")
    amplitudes, times = _thinned(shaper, limits)
    slowest_s = max(mode.damped_period_s for mode in modes)
    longest_s = _LONGEST * (shaper.duration_s + slowest_s)
    for name, value in (("tick_s", limits.tick_s), ("dwell_s", limits.dwell_s)):
        if value > longest_s:
            raise OptionError(
                f"controller: {name} {value:g} is beyond {longest_s:.4g}, {_LONGEST} times "
                "the train and the slowest period",
                remedy="Check its unit: no train for this mode can be played so slowly.",
            )
    if longest_s / limits.tick_s > _MOST_TICKS:
        raise OptionError(
            f"controller: tick_s {limits.tick_s:g} divides the train into more than "
            f"{_MOST_TICKS:g} ticks",
            remedy="Check its unit.",
        )
    gap = max(1, math.ceil(limits.dwell_s / limits.tick_s - 1e-9))
    spread = np.linspace(1.0 - relative, 1.0 + relative, _BAND_SAMPLES) if relative else np.ones(1)
    f = np.concatenate([m.frequency_hz * spread for m in modes])
    z = np.concatenate([np.full(len(spread), m.damping_ratio) for m in modes])

    def fit(ticks: IntArray) -> FloatArray:
        if not limits.amplitudes_free:
            return amplitudes
        return _amplitudes(
            _seconds(ticks, limits.tick_s), f, z, positive=bool(np.all(amplitudes >= 0.0))
        )

    def cost(ticks: IntArray) -> float:
        train = Shaper(amplitudes=fit(ticks), times_s=_seconds(ticks, limits.tick_s))
        return float(residual_vibration(train, f, z).max())

    ticks = _search(_spaced(np.rint(times / limits.tick_s).astype(np.int64), gap), gap, cost)
    made = Shaper(amplitudes=fit(ticks), times_s=_seconds(ticks, limits.tick_s), name=shaper.name)
    f0 = np.array([m.frequency_hz for m in modes])
    z0 = np.array([m.damping_ratio for m in modes])
    return Realised(
        shaper=made,
        designed=shaper,
        ticks=tuple(int(k) for k in ticks),
        vibration=float(residual_vibration(made, f0, z0).max()),
        designed_vibration=float(residual_vibration(shaper, f0, z0).max()),
    )


def _seconds(ticks: IntArray, tick_s: float) -> FloatArray:
    return ticks.astype(np.float64) * tick_s


def _thinned(shaper: Shaper, limits: ControllerLimits) -> tuple[FloatArray, FloatArray]:
    a, t = shaper.amplitudes.copy(), shaper.times_s.copy()
    most = limits.max_impulses
    while most is not None and len(a) > most:
        if bool(np.all(a >= 0.0)):
            # An inner impulse is shared by its neighbours about its own time.
            i = 1 + int(np.argmin(a[1:-1]))
            share = (t[i + 1] - t[i]) / (t[i + 1] - t[i - 1])
            a[i - 1] += share * a[i]
            a[i + 1] += (1.0 - share) * a[i]
            a, t = np.delete(a, i), np.delete(t, i)
            continue
        opposite = [i for i in range(1, len(a) - 1) if abs(a[i] + a[i + 1]) < 1e-12]
        if len(a) - 2 < 2 or not opposite:
            raise ShaperError(
                f"shaper '{shaper.name}': {len(a)} impulses can't be cut to {most}",
                remedy="Choose a kind with fewer impulses.",
            )
        i = min(opposite, key=lambda k: float(t[k + 1] - t[k]))
        a, t = np.delete(a, [i, i + 1]), np.delete(t, [i, i + 1])
    return a, t


def _spaced(ticks: IntArray, gap: int) -> IntArray:
    """Push impulses later until they keep their distance; a cumulative maximum does it."""
    ramp = np.arange(len(ticks)) * gap
    spaced: IntArray = np.maximum.accumulate(ticks - ramp) + ramp
    return spaced


def _search(ticks: IntArray, gap: int, cost: Callable[[IntArray], float]) -> IntArray:
    best, value = ticks, cost(ticks)
    singles = [(i,) for i in range(1, len(ticks))]
    pairs = list(itertools.combinations(range(1, len(ticks)), 2))
    for _ in range(_ROUNDS):
        found = None
        for moved in [*singles, *pairs]:
            for shift in itertools.product((-2, -1, 1, 2), repeat=len(moved)):
                trial = best.copy()
                trial[list(moved)] += shift
                if np.diff(trial).min() < gap:
                    continue
                tried = cost(trial)
                if tried < value * (1.0 - 1e-12):
                    found, value = trial, tried
        if found is None:
            break
        best = found
    return best


def _amplitudes(
    times_s: FloatArray, frequency_hz: FloatArray, damping_ratio: FloatArray, *, positive: bool
) -> FloatArray:
    """Amplitudes of sum 1 with the least sum of V squared for given times."""
    from scipy.optimize import lsq_linear

    delay = times_s - times_s[-1]
    rows = np.array(
        [
            np.exp(pole(float(z)) * f * delay)
            for f, z in zip(frequency_hz, damping_ratio, strict=True)
        ]
    )
    weight = 1e4
    matrix = np.vstack((rows.real, rows.imag, weight * np.ones((1, len(times_s)))))
    target = np.append(np.zeros(2 * len(rows)), weight)
    low = 0.0 if positive else -np.inf
    found = lsq_linear(matrix, target, bounds=(low, np.inf), tol=1e-14).x
    solved: FloatArray = found / found.sum()
    return solved
