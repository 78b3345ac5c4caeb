"""The shaper that Klipper itself would choose from a spectrum, to stand beside another design.

Source: Klipper (2026), ``klippy/extras/shaper_calibrate.py``, read for its method: each type is
tried at frequencies 0.2 Hz apart with damping ratio 0.1. Its remaining vibration is the worst over
damping ratios 0.075, 0.1 and 0.15 of the power above 1/20 of the peak that it leaves; its smoothing
is the distance by which it cuts a corner at 5000 mm/s^2. The least vibration within 10 % (and
0.0005) with the least score wins within a type, and a clearly lower score between types.
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
_LOW_HZ = 10.0  # below it Klipper fades the power


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class KlipperFit:
    """One type at the frequency that Klipper would give it.

    Parameters
    ----------
    shaper_type, frequency_hz
        Values of ``shaper_type`` and ``shaper_freq``.
    vibration
        Share of the power that remains, by Klipper's measure.
    smoothing_mm
        Distance by which a corner is cut at 5000 mm/s^2.
    score
        Klipper's weight of both; low is good.
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
        """The impulses that Klipper plays for it."""
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
        (k,) of x, y and z together, weighted by ``klipper_weighted``.

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
    """Return a type at all frequencies, the lowest first."""
    tried = np.arange(TRIED[name], _MOST_HZ, _STEP_HZ)
    # A type is the same train at every frequency, on another scale of time.
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
    """Return (m,) share of the power that a train for 1 Hz leaves, at (m, k) frequencies."""
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
    # Klipper goes down from the highest frequency, so of equals the highest is its best.
    least = min(reversed(tried), key=lambda one: one.vibration)
    chosen = least
    for one in tried:
        if one.vibration < 1.1 * least.vibration + 0.0005 and one.score < chosen.score:
            chosen = one
    return chosen


def _smoothing(train: Shaper, frequency_hz: float) -> tuple[float, float]:
    """Return mm by which a shaped corner is cut, and the acceleration that cuts 0.12 mm.

    Parameters
    ----------
    train
        Made for 1 Hz, and played for ``frequency_hz``.
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
