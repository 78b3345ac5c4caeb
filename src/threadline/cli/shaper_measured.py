"""``threadline shaper --measured``: an accelerometer's mode, and Klipper's own choice."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.cli.shaper_text import ModeOption
from threadline.errors import OptionError
from threadline.identify.accelerometer import AXES, Spectrum, read_accelerometer
from threadline.identify.modes import MeasuredMode, klipper_spectrum, measured_mode
from threadline.motion.shaping import Shaper, residual_vibration
from threadline.motion.shaping.klipper_choice import (
    KlipperFit,
    klipper_choice,
    klipper_measures,
    klipper_weighted,
)
from threadline.report.document import Table
from threadline.report.shaper import MeasuredPower
from threadline.units import without_noise

LEAST_BAND = 0.05
"""Least half width of a measured mode's band: its frequency varies with position and load."""
_MINOR = 0.5  # the user is warned if the axis has a smaller share of the power
_GRID = 11
_MOST_DAMPED = 0.9


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Measured:
    """The mode measured in a file, and the shaper that Klipper would choose.

    Parameters
    ----------
    found
        The mode.
    frequency_hz, power
        (k,) Klipper's weighted spectrum of all axes together.
    choice, best
        Klipper's choice, and its best of each type.
    """

    found: MeasuredMode
    frequency_hz: FloatArray
    power: FloatArray
    choice: KlipperFit
    best: tuple[KlipperFit, ...]

    @property
    def band(self) -> float:
        """Half width of the band to design for, as a share of the frequency."""
        frequency = self.found.frequency_hz
        return min(max(frequency.half_width / frequency.value, LEAST_BAND), 0.99)

    def as_option(self, *, banded: bool) -> ModeOption:
        """Return the mode as ``--mode`` would give it."""
        return ModeOption(self.found.mode, self.band if banded else None)

    def worst(self, train: Shaper) -> float:
        """Return the largest vibration over the intervals of frequency and damping."""
        frequency, ratio = self.found.frequency_hz, self.found.damping_ratio
        frequencies_hz = np.linspace(frequency.low, frequency.high, _GRID)
        ratios = np.linspace(max(ratio.low, 0.0), min(ratio.high, _MOST_DAMPED), _GRID)
        return max(
            float(residual_vibration(train, frequencies_hz, one).max()) for one in ratios.tolist()
        )


def read_measured(path: Path, axis: str | None, damping: Sequence[float] | None) -> Measured:
    """Read a file and find its mode.

    Raises
    ------
    OptionError, RecordingError
        If it cannot be used.
    """
    if damping is not None and len(damping) > 1:
        raise OptionError("--measured gives one mode", remedy="Give --damping once.")
    data = read_accelerometer(path)
    found = measured_mode(data, axis, None if damping is None else damping[0])
    spectrum = data if isinstance(data, Spectrum) else klipper_spectrum(data)
    f, power = spectrum.frequency_hz, spectrum.psd.sum(axis=1)
    power = power if spectrum.normalised else klipper_weighted(f, power)
    choice, best = klipper_choice(f, power)
    return Measured(found=found, frequency_hz=f, power=power, choice=choice, best=best)


def measured_warnings(measured: Measured, train: Shaper, *, chosen: bool) -> Iterator[str]:
    """Yield the other findings in the file: power along other axes, and other peaks.

    Parameters
    ----------
    chosen
        Whether the user named the axis.
    """
    found = measured.found
    own = found.shares[AXES.index(found.axis)]
    most = AXES[int(np.argmax(found.shares))]
    mode_hz = found.frequency_hz.value
    if own < _MINOR and most != found.axis:
        yield (
            f"at {mode_hz:.4g} Hz {found.axis} has {own * 100:.2g} % of the power and {most} has "
            f"{max(found.shares) * 100:.2g} %: the mode swings along {most}, or the sensor is "
            "turned"
        )
    if not chosen:
        yield f"the axis shaken is taken to be {found.axis}; name it with --axis"
    for hz, height in found.others:
        residual = float(residual_vibration(train, np.array([hz]), found.damping_ratio.value)[0])
        yield (
            f"{found.axis} has another peak at {hz:.4g} Hz, {height * 100:.2g} % as high; shaper "
            f"{train.name!r} leaves {residual * 100:.2g} % there"
        )


def measured_tables(measured: Measured, train: Shaper) -> list[Table]:
    """Return tables of the mode, and of Klipper's choice beside ``train``."""
    found = measured.found
    f, ratio = found.frequency_hz, found.damping_ratio
    interval_text = "given" if ratio.half_width == 0.0 else f"{ratio.low:.4g} to {ratio.high:.4g}"
    mode = [
        ["undamped frequency, Hz", f"{f.value:.5g}", f"{f.low:.5g} to {f.high:.5g}"],
        ["damping ratio", f"{ratio.value:.4g}", interval_text],
    ]
    rows = [
        [
            ("Klipper's choice: " if one is measured.choice else "") + one.shaper_type,
            f"{one.frequency_hz:.1f}",
            f"{without_noise(one.vibration) * 100:.2f} %",
            f"{without_noise(measured.worst(one.train)) * 100:.2f} %",
            f"{one.train.duration_s * 1e3:.2f}",
            f"{round(one.max_accel_mm_s2, -2):.0f}",
        ]
        for one in dict.fromkeys((*measured.best, measured.choice))
        if one is measured.choice or one.shaper_type != measured.choice.shaper_type
    ]
    vibration, max_accel = klipper_measures(train, measured.frequency_hz, measured.power)
    own_row = [
        f"this design: {train.name}",
        f"{f.value:.2f}",
        f"{without_noise(vibration) * 100:.2f} %",
        f"{without_noise(measured.worst(train)) * 100:.2f} %",
        f"{train.duration_s * 1e3:.2f}",
        f"{round(max_accel, -2):.0f}",
    ]
    x, y, z = (f"{share * 100:.3g} %" for share in found.shares)
    return [
        Table(
            title=f"Mode measured along {found.axis}",
            header=("what", "is", "95 % interval"),
            rows=mode,
            note=f"Power around it: x {x}, y {y}, z {z}.",
        ),
        Table(
            title="Beside Klipper's own shapers",
            header=("shaper", "Hz", "left, Klipper", "left, worst", "ms", "max_accel mm/s^2"),
            rows=[own_row, *rows],
            note="'left, Klipper' is by its own measure, over the whole spectrum at damping "
            "ratios 0.075 to 0.15; 'left, worst' is the vibration over the intervals above.",
        ),
    ]


def measured_content(measured: Measured, train: Shaper) -> dict[str, Any]:
    """Return the mode and Klipper's choice as JSON content."""
    found = measured.found
    choice = measured.choice
    vibration, max_accel = klipper_measures(train, measured.frequency_hz, measured.power)
    return {
        "axis": found.axis,
        "frequency_hz": found.frequency_hz.value,
        "frequency_half_width_hz": found.frequency_hz.half_width,
        "damping_ratio": found.damping_ratio.value,
        "damping_half_width": found.damping_ratio.half_width,
        "power_shares": dict(zip(AXES, found.shares, strict=True)),
        "other_peaks": [{"frequency_hz": f, "height": h} for f, h in found.others],
        "worst_vibration": measured.worst(train),
        "klipper_vibration": vibration,
        "klipper_max_accel_mm_s2": max_accel,
        "klipper_choice": _fit_content(measured, choice),
        "klipper_tried": [_fit_content(measured, one) for one in measured.best],
    }


def _fit_content(measured: Measured, one: KlipperFit) -> dict[str, Any]:
    return {
        "type": one.shaper_type,
        "frequency_hz": one.frequency_hz,
        "vibration": one.vibration,
        "worst_vibration": measured.worst(one.train),
        "score": one.score,
        "smoothing_mm": one.smoothing_mm,
        "max_accel_mm_s2": one.max_accel_mm_s2,
    }


def measured_power(measured: Measured, train: Shaper) -> MeasuredPower:
    """Return the contents of the figure of a measurement in the report."""
    found, choice = measured.found, measured.choice
    train_name = f"Klipper's {choice.shaper_type} at {choice.frequency_hz:.1f} Hz"
    return MeasuredPower(
        axis=found.axis,
        lines_hz=found.lines_hz,
        power=found.power,
        fitted=found.fitted,
        spectrum_hz=measured.frequency_hz,
        spectrum=measured.power,
        trains=(train, replace(choice.train, name=train_name)),
        damping_ratio=found.damping_ratio.value,
    )
