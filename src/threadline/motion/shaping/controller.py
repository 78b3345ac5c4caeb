"""A shaper as a real controller plays it, and the increase of vibration over the design band.

A PLC switches only at its scans, a valve needs time between two switchings, and a program has room
for a limited number of impulses. :mod:`threadline.motion.shaping.rounding` moves the impulses onto
whole ticks. If the machine can set amplitudes, they are solved again. The results are the worst V
over the design band for the exact train, for the train rounded to the nearest ticks, and for the
realised train.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.errors import OptionError
from threadline.motion.shaping.designs import DEFAULT_TOLERANCE
from threadline.motion.shaping.response import residual_vibration, vibration_of
from threadline.motion.shaping.robustness import insensitivity
from threadline.motion.shaping.rounding import Band, TickGrid, on_ticks, seconds, with_amplitudes
from threadline.motion.shaping.types import FlexibleMode, Shaper, ShaperError

_NONE = 1e-12  # largest amplitude that counts as 0
_ABOUT = 0.1  # share of the tolerance or of the least V: smaller differences of V count as equal
_WIDER = 0.01  # difference by which a band must be wider to be preferred
_LOOKED_AT = 24
_FINER = 4
_CHOICES = 400
_SILENT = 1e-6
_LONGEST = 100  # largest tick or dwell, in durations of train and slowest period
_MOST_TICKS = 1e12


@dataclass(frozen=True, slots=True)
class ControllerLimits:
    """Limits of the controller and its valves.

    Parameters
    ----------
    tick_s
        Tick of the controller, s; every impulse falls on a whole tick.
    dwell_s
        Shortest time between two switchings, s; 0 for none.
    max_impulses
        Largest number of impulses; None for no limit.
    amplitudes_free
        Whether the amplitudes may be changed (flow valves); False for on/off valves.
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
class OverBand:
    """Cost of the tick grid for one mode over the design band of the kind.

    Parameters
    ----------
    mode, low_hz, high_hz, tolerance
        The mode, the band, and the V that is allowed over it.
    designed, nearest, made
        Largest V over the band: of the designed train, of the train rounded to the nearest ticks,
        and of the realised train.
    designed_width, nearest_width, made_width
        Insensitivity of the three at the tolerance.
    """

    mode: FlexibleMode
    low_hz: float
    high_hz: float
    tolerance: float
    designed: float
    nearest: float
    made: float
    designed_width: float
    nearest_width: float
    made_width: float


@dataclass(frozen=True, slots=True)
class Realised:
    """The train that the controller can play, and the designed one.

    Parameters
    ----------
    shaper, designed
        Both trains.
    ticks
        Impulse times as whole ticks.
    vibration, designed_vibration
        Worst V over the modes at their modelled frequencies.
    bands
        Cost over the band of every mode.
    """

    shaper: Shaper
    designed: Shaper
    ticks: tuple[int, ...]
    vibration: float
    designed_vibration: float
    bands: tuple[OverBand, ...]

    @property
    def time_price_s(self) -> float:
        """Increase of the train's duration; negative if shorter."""
        return self.shaper.duration_s - self.designed.duration_s

    @property
    def vibration_price(self) -> float:
        """Increase of V at the modelled frequencies."""
        return self.vibration - self.designed_vibration


def realise(
    shaper: Shaper,
    modes: Sequence[FlexibleMode],
    limits: ControllerLimits,
    *,
    relative: float | Sequence[float | None] | None = None,
    tolerance: float | Sequence[float] = DEFAULT_TOLERANCE,
) -> Realised:
    """Fit ``shaper`` to a controller with the least worst V over the band of every mode.

    Over the bands the result is never worse than the train rounded to the nearest ticks. It keeps
    the tolerance over a narrower band only if the worst V shrinks by a larger share. If there are
    more than ``max_impulses``, a positive train loses its smallest impulse, and any other train its
    closest pair of opposite impulses, until the number is reached. Impulses that round to the same
    tick are merged.

    Parameters
    ----------
    shaper
        Designed train.
    modes
        At least one; the worst counts.
    limits
        Limits of the controller.
    relative
        Half width of the band of frequency that counts, in [0, 1), one for all modes or one each;
        0 for the frequency alone, None for the band in which the designed train stays within the
        tolerance.
    tolerance
        Tolerance over the band, in (0, 1); likewise.

    Raises
    ------
    OptionError
        If there is no mode, or a time of the controller is far too long or too short for the train.
    ShaperError
        If the train cannot be reduced to ``max_impulses`` impulses.
    """
    if not modes:
        raise OptionError("controller: at least one mode is needed to judge the train by")
    _check_times(shaper, modes, limits)
    amplitudes, times = _thinned(shaper, limits)
    gap = max(1, math.ceil(limits.dwell_s / limits.tick_s - 1e-9))
    half_widths = relative if isinstance(relative, Sequence) else (relative,) * len(modes)
    mode_settings = zip(modes, half_widths, _each(tolerance, modes), strict=True)
    bands = [_band(shaper, *settings) for settings in mode_settings]
    exact = times / limits.tick_s
    nearest = _merged(amplitudes, np.rint(exact).astype(np.int64), gap)
    spaced_ticks = _spaced(np.rint(exact).astype(np.int64), gap)
    grid = TickGrid(bands, limits.tick_s, int(nearest[1][-1]))

    def train(weights: FloatArray, ticks: IntArray) -> Shaper:
        return Shaper(amplitudes=weights, times_s=seconds(ticks, limits.tick_s), name=shaper.name)

    if limits.amplitudes_free:
        silent_modes = [m for m in modes if vibration_of(shaper, m) < _SILENT]
        start_ticks = [nearest[1], *_fewer(shaper, limits, gap)]
        positive = bool(np.all(shaper.amplitudes >= 0.0))
        candidates = [
            with_amplitudes(start_ticks, gap, grid, silent_modes, limits.tick_s, positive=positive)
        ]
    else:
        merged_exact = (
            exact if len(spaced_ticks) == len(nearest[1]) else nearest[1].astype(np.float64)
        )
        candidates = [(nearest[0], t) for t in on_ticks(*nearest, merged_exact, gap, grid)]
        if len(spaced_ticks) > len(nearest[1]):
            # If nearest ticks coincide, trains with merged and with separated impulses are tried.
            candidates += [
                (amplitudes, t) for t in on_ticks(amplitudes, spaced_ticks, exact, gap, grid)
            ]
    best_train = _widest(train(*nearest), [train(*pair) for pair in candidates], bands)
    return _priced(shaper, train(*nearest), best_train, bands, limits)


def _check_times(shaper: Shaper, modes: Sequence[FlexibleMode], limits: ControllerLimits) -> None:
    slowest_s = max(mode.damped_period_s for mode in modes)
    longest_s = _LONGEST * (shaper.duration_s + slowest_s)
    for name, value in (("tick_s", limits.tick_s), ("dwell_s", limits.dwell_s)):
        if value > longest_s:
            raise OptionError(
                f"controller: {name} {value:g} is beyond {longest_s:.4g}, {_LONGEST} times "
                "the train and the slowest period",
                remedy="Check its unit: no train for this mode can be played so slowly.",
            )
    if len(shaper.times_s) > 1 and limits.dwell_s > shaper.duration_s:
        raise OptionError(
            f"controller: the valves need {limits.dwell_s:g} s between two switchings, and the "
            f"whole shaper takes {shaper.duration_s:.4g} s",
            remedy="So far apart its impulses add to the vibration: take quicker valves (a shorter "
            "dwell) or a longer shaper.",
        )
    if longest_s / limits.tick_s > _MOST_TICKS:
        raise OptionError(
            f"controller: tick_s {limits.tick_s:g} divides the train into more than "
            f"{_MOST_TICKS:g} ticks",
            remedy="Check its unit.",
        )


def _band(shaper: Shaper, mode: FlexibleMode, relative: float | None, tolerance: float) -> Band:
    if relative is not None:
        f = mode.frequency_hz
        return Band(mode, f * (1.0 - relative), f * (1.0 + relative), tolerance)
    band_range = insensitivity(shaper, mode, tolerance)
    return Band(mode, band_range.low_hz, band_range.high_hz, tolerance)


def _each(value: float | Sequence[float], modes: Sequence[FlexibleMode]) -> Sequence[float]:
    return (value,) * len(modes) if isinstance(value, float | int) else value


def _width(train: Shaper, band: Band) -> float:
    return insensitivity(train, band.mode, band.tolerance).value


def _widest(nearest: Shaper, trains: Sequence[Shaper], bands: Sequence[Band]) -> Shaper:
    """Return the train with the widest band among the trains with nearly the least V.

    Over a band, V of a train must not exceed both the tolerance and V of ``nearest``, the train on
    the nearest ticks. The band over which a train keeps the tolerance may be narrower than the band
    of ``nearest``, but only by a smaller share than V shrinks. ``trains`` are in order of their
    cost, the best first.
    """

    def worst_by_band(train: Shaper) -> FloatArray:
        return np.array([_over(train, band, nearest.duration_s).max() for band in bands])

    allowed = np.array([band.tolerance for band in bands])
    ceiling = np.maximum(worst_by_band(nearest), allowed) * (1.0 + 1e-12)
    worsts = [worst_by_band(train) for train in trains]
    nearest_share = float((worst_by_band(nearest) / allowed).max())
    shares = {
        k: float((worst / allowed).max())
        for k, worst in enumerate(worsts)
        if np.all(worst <= ceiling) and (worst / allowed).max() <= nearest_share * (1.0 + 1e-12)
    }
    nearest_widths = np.array([_width(nearest, band) for band in bands])

    def wide_enough(widths: FloatArray, share: float, slack: float) -> bool:
        # If V is within the tolerance, a smaller V does not justify a narrower band.
        needed = nearest_widths * min(1.0, max(share, 1.0) / max(nearest_share, 1.0))
        return bool(np.all(widths >= needed * (1.0 - slack)))

    sampled_widths = {
        k: np.array([_width_on_samples(trains[k], band, nearest) for band in bands]) for k in shares
    }
    # A width from samples is accurate to one sample distance; the decision below uses exact widths.
    likely = [
        k
        for k in shares
        if wide_enough(np.minimum(sampled_widths[k], nearest_widths), shares[k], 0.1)
    ]
    if not likely:
        return nearest
    widths = {}
    for k in sorted(likely, key=lambda k: shares[k]):
        widths[k] = np.array([_width(trains[k], band) for band in bands])
        if wide_enough(widths[k], shares[k], 1e-9):
            break
    else:
        return nearest
    share_limit = min(nearest_share * (1.0 + 1e-12), shares[k] + _ABOUT * max(1.0, shares[k]))
    examined = [k for k in likely if shares[k] <= share_limit]
    if len(examined) > _LOOKED_AT:
        examined = sorted(sorted(examined, key=lambda k: -sampled_widths[k].min())[:_LOOKED_AT])
    best_train, best_width = nearest, 0.0
    for k in examined:
        if k not in widths:
            widths[k] = np.array([_width(trains[k], band) for band in bands])
        if wide_enough(widths[k], shares[k], 1e-9) and (
            best_train is nearest or widths[k].min() > best_width + _WIDER
        ):
            best_train, best_width = trains[k], float(widths[k].min())
    return best_train


def _width_on_samples(train: Shaper, band: Band, nearest: Shaper) -> float:
    """Return about the width of the band in which V keeps the tolerance, over the frequency."""
    f = band.samples_hz(nearest.duration_s, finer=_FINER)
    loud_hz = f[_over(train, band, nearest.duration_s) > band.tolerance]
    mode_hz = band.mode.frequency_hz
    return (
        float(
            min(loud_hz[loud_hz >= mode_hz], default=f[-1])
            - max(loud_hz[loud_hz <= mode_hz], default=f[0])
        )
        / mode_hz
    )


def _over(train: Shaper, band: Band, duration_s: float) -> FloatArray:
    """Return V over a band, with samples so fine that its largest value is accurate to 0.1 %."""
    f = band.samples_hz(duration_s, finer=_FINER)
    return residual_vibration(train, f, band.mode.damping_ratio)


def _priced(
    designed: Shaper, nearest: Shaper, made: Shaper, bands: Sequence[Band], limits: ControllerLimits
) -> Realised:
    modes = [band.mode for band in bands]

    def worst(train: Shaper, band: Band) -> float:
        return float(_over(train, band, designed.duration_s).max())

    return Realised(
        shaper=made,
        designed=designed,
        ticks=tuple(int(k) for k in np.rint(made.times_s / limits.tick_s)),
        vibration=max(vibration_of(made, mode) for mode in modes),
        designed_vibration=max(vibration_of(designed, mode) for mode in modes),
        bands=tuple(
            OverBand(
                band.mode,
                band.low_hz,
                band.high_hz,
                band.tolerance,
                worst(designed, band),
                worst(nearest, band),
                worst(made, band),
                _width(designed, band),
                _width(nearest, band),
                _width(made, band),
            )
            for band in bands
        ),
    )


def _fewer(shaper: Shaper, limits: ControllerLimits, gap: int) -> list[IntArray]:
    """Return the ticks of every choice of ``max_impulses`` impulses; empty if all may stay."""
    impulse_limit, n = limits.max_impulses, len(shaper.times_s)
    if (
        impulse_limit is None
        or impulse_limit >= n
        or math.comb(n - 1, impulse_limit - 1) > _CHOICES
    ):
        return []
    ticks = np.rint(shaper.times_s / limits.tick_s).astype(np.int64)
    choices = (ticks[[0, *rest]] for rest in itertools.combinations(range(1, n), impulse_limit - 1))
    return [choice for choice in choices if np.diff(choice).min() >= gap]


def _merged(amplitudes: FloatArray, ticks: IntArray, gap: int) -> tuple[FloatArray, IntArray]:
    """Merge impulses on one tick; with a ``gap`` above 1, shift impulses to later ticks instead."""
    if gap > 1:
        return amplitudes, _spaced(ticks, gap)
    starts = np.concatenate(([0], np.flatnonzero(np.diff(ticks)) + 1))
    sums, kept_ticks = np.add.reduceat(amplitudes, starts), ticks[starts]
    nonzero = np.abs(sums) > _NONE
    nonzero[0] = True
    return sums[nonzero], kept_ticks[nonzero]


def _thinned(shaper: Shaper, limits: ControllerLimits) -> tuple[FloatArray, FloatArray]:
    a, t = shaper.amplitudes.copy(), shaper.times_s.copy()
    impulse_limit = limits.max_impulses
    while impulse_limit is not None and len(a) > impulse_limit:
        if bool(np.all(a >= 0.0)):
            # The neighbours share an inner impulse, such that the centroid stays unchanged.
            i = 1 + int(np.argmin(a[1:-1]))
            share = (t[i + 1] - t[i]) / (t[i + 1] - t[i - 1])
            a[i - 1] += share * a[i]
            a[i + 1] += (1.0 - share) * a[i]
            a, t = np.delete(a, i), np.delete(t, i)
            continue
        opposite_pairs = [i for i in range(1, len(a) - 1) if abs(a[i] + a[i + 1]) < 1e-12]
        if len(a) - 2 < 2 or not opposite_pairs:
            raise ShaperError(
                f"shaper '{shaper.name}': {len(a)} impulses can't be cut to {impulse_limit}",
                remedy="Choose a kind with fewer impulses.",
            )
        i = min(opposite_pairs, key=lambda k: float(t[k + 1] - t[k]))
        a, t = np.delete(a, [i, i + 1]), np.delete(t, [i, i + 1])
    return a, t


def _spaced(ticks: IntArray, gap: int) -> IntArray:
    """Shift impulses to later ticks until neighbours are at least ``gap`` ticks apart."""
    ramp = np.arange(len(ticks)) * gap
    spaced: IntArray = np.maximum.accumulate(ticks - ramp) + ramp
    return spaced
