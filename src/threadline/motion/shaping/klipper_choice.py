"""The shaper that Klipper itself would choose from a spectrum, to stand beside another design.

Source of the method: Klipper (2026), ``klippy/extras/shaper_calibrate.py``. Each type is tried at
frequencies 0.2 Hz apart with damping ratio 0.1. Its remaining vibration is the share of the power
above 1/20 of the peak that it leaves, at the worst of the damping ratios 0.075, 0.1 and 0.15. Its
smoothing is the distance by which it cuts a corner at 5000 mm/s^2. Within a type, of all
frequencies whose vibration is within 10 % and 0.0005 of the least, the one with the least score
wins. Between types a clearly lower score wins.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.errors import OptionError
from threadline.motion.shaping.firmwares import klipper_impulses
from threadline.motion.shaping.response import residual_vibration
from threadline.motion.shaping.types import FlexibleMode, Shaper

TRIED = {"zv": 21.0, "mzv": 23.0, "ei": 29.0, "2hump_ei": 39.0, "3hump_ei": 48.0}
"""Types that Klipper tries, and the lowest frequency of each."""
_DAMPING, _DAMPINGS = 0.1, (0.075, 0.1, 0.15)
_MOST_HZ, _STEP_HZ, _SEEN_HZ = 150.0, 0.2, 200.0
_IGNORED = 1.0 / 20.0
_CORNER_MM_S, _ACCELERATION_MM_S2, _SMOOTHING_MM = 5.0, 5000.0, 0.12
_LOW_HZ = 10.0  # below this frequency Klipper reduces the power


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class KlipperFit:
    """A type of shaper at one frequency, with Klipper's measures.

    Parameters
    ----------
    shaper_type, frequency_hz
        Values of ``shaper_type`` and ``shaper_freq``.
    vibration
        Share of the power that remains, by Klipper's measure.
    smoothing_mm
        Distance by which a corner is cut at 5000 mm/s^2.
    score
        Klipper's score of vibration and smoothing together; lower is better.
    max_accel_mm_s2
        Acceleration at which a corner is cut by 0.12 mm.
    """

    shaper_type: str
    frequency_hz: float
    vibration: float
    smoothing_mm: float
    score: float
    max_accel_mm_s2: float

    @property
    def train(self) -> Shaper:
        """The impulses that Klipper plays for this type and frequency."""
        return klipper_impulses(self.shaper_type, FlexibleMode(self.frequency_hz, _DAMPING))


def klipper_weighted(frequency_hz: FloatArray, power: FloatArray) -> FloatArray:
    """Return power over frequency, faded below 10 Hz, as Klipper weighs a run's spectrum."""
    weighted = power / (frequency_hz + 0.1)
    is_low = frequency_hz < _LOW_HZ
    weighted[is_low] *= np.exp(1.0 - (_LOW_HZ / (frequency_hz[is_low] + 0.1)) ** 2)
    return weighted


def klipper_choice(
    frequency_hz: FloatArray, power: FloatArray
) -> tuple[KlipperFit, tuple[KlipperFit, ...]]:
    """Return Klipper's choice, and its best of each type.

    Parameters
    ----------
    frequency_hz
        (k,) lines of the spectrum.
    power
        (k,) power of x, y and z together, weighted by ``klipper_weighted``.

    Raises
    ------
    OptionError
        If there is no power up to 200 Hz.
    """
    in_range = frequency_hz <= _SEEN_HZ
    f, power = frequency_hz[in_range], power[in_range]
    if not len(f) or float(power.max()) <= 0.0:
        raise OptionError("the spectrum has no power up to 200 Hz", remedy="Measure again.")
    chosen: KlipperFit | None = None
    best_of_types: list[KlipperFit] = []
    for name in TRIED:
        fits = _tried(name, f, power)
        best_fit = _of_type(fits)
        if chosen is None or _better(best_fit, chosen):
            chosen = best_fit
        for fit in fits:
            if fit.vibration < chosen.vibration and fit.smoothing_mm < chosen.smoothing_mm:
                chosen = best_fit = fit
        best_of_types.append(best_fit)
    assert chosen is not None
    if chosen.shaper_type == "zv":
        other_types = (b for b in best_of_types[1:] if b.shaper_type != "zv")
        chosen = next((b for b in other_types if 1.1 * b.vibration < chosen.vibration), chosen)
    return chosen, tuple(best_of_types)


def _better(fit: KlipperFit, other_fit: KlipperFit) -> bool:
    return 1.2 * fit.score < other_fit.score or (
        1.05 * fit.score < other_fit.score and 1.1 * fit.smoothing_mm < other_fit.smoothing_mm
    )


def _tried(name: str, f: FloatArray, power: FloatArray) -> list[KlipperFit]:
    """Return the results of a type at all frequencies, the lowest first."""
    frequencies = np.arange(TRIED[name], _MOST_HZ, _STEP_HZ)
    # The train of a type at another frequency is the same train on another scale of time.
    train = klipper_impulses(name, FlexibleMode(1.0, _DAMPING))
    vibration = _remaining(train, f / frequencies[:, None], power)
    fits = []
    for frequency, remaining in zip(frequencies.tolist(), vibration.tolist(), strict=True):
        smoothing, max_accel = _smoothing(train, frequency)
        fits.append(
            KlipperFit(
                shaper_type=name,
                frequency_hz=frequency,
                vibration=remaining,
                smoothing_mm=smoothing,
                score=smoothing * (remaining**1.5 + 0.2 * remaining + 0.01),
                max_accel_mm_s2=max_accel,
            )
        )
    return fits


def _remaining(train: Shaper, ratios: FloatArray, power: FloatArray) -> FloatArray:
    """Return (m,) shares of the power that remain with a train for 1 Hz, at (m, k) frequencies."""
    threshold = float(power.max()) * _IGNORED
    worst = np.zeros(len(ratios))
    for damping in _DAMPINGS:
        residual = residual_vibration(train, ratios.ravel(), damping).reshape(ratios.shape)
        worst = np.maximum(worst, np.maximum(residual * power - threshold, 0.0).sum(axis=1))
    return worst / float(np.maximum(power - threshold, 0.0).sum())


def klipper_measures(
    train: Shaper, frequency_hz: FloatArray, power: FloatArray
) -> tuple[float, float]:
    """Return any train's remaining vibration and ``max_accel`` (mm/s^2) by Klipper's measures.

    Parameters
    ----------
    frequency_hz, power
        As for ``klipper_choice``.
    """
    in_range = frequency_hz <= _SEEN_HZ
    remaining = _remaining(train, frequency_hz[None, in_range], power[in_range])
    return float(remaining[0]), _smoothing(train, 1.0)[1]


def _of_type(fits: list[KlipperFit]) -> KlipperFit:
    # Klipper starts at the highest frequency, so the highest of equal frequencies is its best.
    quietest = min(reversed(fits), key=lambda fit: fit.vibration)
    chosen = quietest
    for fit in fits:
        if fit.vibration < 1.1 * quietest.vibration + 0.0005 and fit.score < chosen.score:
            chosen = fit
    return chosen


def _smoothing(train: Shaper, frequency_hz: float) -> tuple[float, float]:
    """Return the cut of a shaped corner, mm, and the acceleration, mm/s^2, with a cut of 0.12 mm.

    Parameters
    ----------
    train
        Train for 1 Hz; its times are scaled to ``frequency_hz``.
    """
    delays_s = (train.times_s - train.centroid_s) / frequency_hz
    is_late = delays_s >= 0.0
    weights = train.amplitudes / train.amplitudes.sum()
    constant = math.sqrt(2.0) * _CORNER_MM_S * float((weights * delays_s)[is_late].sum())
    squares = 0.5 * weights * delays_s**2
    slope, total_slope = math.sqrt(2.0) * float(squares[is_late].sum()), float(squares.sum())
    cut = max(constant + slope * _ACCELERATION_MM_S2, total_slope * _ACCELERATION_MM_S2)
    max_accel = min((_SMOOTHING_MM - constant) / slope, _SMOOTHING_MM / total_slope)
    return cut, max(max_accel, 0.0)
