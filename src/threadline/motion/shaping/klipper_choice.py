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
    low = frequency_hz < _LOW_HZ
    weighted[low] *= np.exp(1.0 - (_LOW_HZ / (frequency_hz[low] + 0.1)) ** 2)
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
    seen = frequency_hz <= _SEEN_HZ
    f, power = frequency_hz[seen], power[seen]
    if not len(f) or float(power.max()) <= 0.0:
        raise OptionError("the spectrum has no power up to 200 Hz", remedy="Measure again.")
    chosen: KlipperFit | None = None
    best: list[KlipperFit] = []
    for name in TRIED:
        tried = _tried(name, f, power)
        one = _of_type(tried)
        if chosen is None or _better(one, chosen):
            chosen = one
        for other in tried:
            if other.vibration < chosen.vibration and other.smoothing_mm < chosen.smoothing_mm:
                chosen = one = other
        best.append(one)
    assert chosen is not None
    if chosen.shaper_type == "zv":
        others = (b for b in best[1:] if b.shaper_type != "zv")
        chosen = next((b for b in others if 1.1 * b.vibration < chosen.vibration), chosen)
    return chosen, tuple(best)


def _better(one: KlipperFit, than: KlipperFit) -> bool:
    return 1.2 * one.score < than.score or (
        1.05 * one.score < than.score and 1.1 * one.smoothing_mm < than.smoothing_mm
    )


def _tried(name: str, f: FloatArray, power: FloatArray) -> list[KlipperFit]:
    """Return the results of a type at all frequencies, the lowest first."""
    tried = np.arange(TRIED[name], _MOST_HZ, _STEP_HZ)
    # The train of a type at another frequency is the same train on another scale of time.
    train = klipper_impulses(name, FlexibleMode(1.0, _DAMPING))
    vibration = _remaining(train, f / tried[:, None], power)
    found = []
    for frequency, left_over in zip(tried.tolist(), vibration.tolist(), strict=True):
        smoothing, most = _smoothing(train, frequency)
        found.append(
            KlipperFit(
                shaper_type=name,
                frequency_hz=frequency,
                vibration=left_over,
                smoothing_mm=smoothing,
                score=smoothing * (left_over**1.5 + 0.2 * left_over + 0.01),
                max_accel_mm_s2=most,
            )
        )
    return found


def _remaining(train: Shaper, ratios: FloatArray, power: FloatArray) -> FloatArray:
    """Return (m,) shares of the power that remain with a train for 1 Hz, at (m, k) frequencies."""
    threshold = float(power.max()) * _IGNORED
    worst = np.zeros(len(ratios))
    for damping in _DAMPINGS:
        left = residual_vibration(train, ratios.ravel(), damping).reshape(ratios.shape)
        worst = np.maximum(worst, np.maximum(left * power - threshold, 0.0).sum(axis=1))
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
    seen = frequency_hz <= _SEEN_HZ
    left = _remaining(train, frequency_hz[None, seen], power[seen])
    return float(left[0]), _smoothing(train, 1.0)[1]


def _of_type(tried: list[KlipperFit]) -> KlipperFit:
    # Klipper starts at the highest frequency, so the highest of equal frequencies is its best.
    least = min(reversed(tried), key=lambda one: one.vibration)
    chosen = least
    for one in tried:
        if one.vibration < 1.1 * least.vibration + 0.0005 and one.score < chosen.score:
            chosen = one
    return chosen


def _smoothing(train: Shaper, frequency_hz: float) -> tuple[float, float]:
    """Return the cut of a shaped corner, mm, and the acceleration, mm/s^2, with a cut of 0.12 mm.

    Parameters
    ----------
    train
        Train for 1 Hz; its times are scaled to ``frequency_hz``.
    """
    late = (train.times_s - train.centroid_s) / frequency_hz
    after = late >= 0.0
    weights = train.amplitudes / train.amplitudes.sum()
    constant = math.sqrt(2.0) * _CORNER_MM_S * float((weights * late)[after].sum())
    squares = 0.5 * weights * late**2
    slope, back = math.sqrt(2.0) * float(squares[after].sum()), float(squares.sum())
    cut = max(constant + slope * _ACCELERATION_MM_S2, back * _ACCELERATION_MM_S2)
    most = min((_SMOOTHING_MM - constant) / slope, _SMOOTHING_MM / back)
    return cut, max(most, 0.0)
