"""The shapers of Klipper, Marlin and RepRapFirmware, and designs expressed in their settings.

A firmware can play a design if one of its own trains has the same V within ``MATCH`` over f (1 +-
25 %). Otherwise the nearest of its trains is named.

Klipper computes its types from frequency and damping ratio by its own formulas: zv, mzv and zvd
exactly, ei, 2hump_ei and 3hump_ei by published curve fits (Singhose et al.) at 5 %, valid to
damping ratios of 0.4, 0.3 and 0.2. Since 2026 ``mzv(n=,t=,tau=)`` and ``ei(v_tol=)`` take
parameters. This module computes Klipper's train and judges it on the mode, so that a coarse curve
fit does not count as a match.

Source: Marlin 2.1, ``Stepper::set_shaping_damping_ratio`` and ``set_shaping_frequency``. Marlin
adds an echo half a period of F after the move, with both shares in 128ths. So F is the damped
frequency.

Source: RepRapFirmware 3, ``AxisShaper::Configure``: mzv, zvd, zvdd, zvddd exactly, ei2 and ei3 by
published fits, their times in damped periods. F is the undamped frequency, S the damping ratio.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.errors import OptionError
from threadline.motion.shaping.closed import fitted_humps, modified_zv
from threadline.motion.shaping.designs import mzv_shape
from threadline.motion.shaping.response import (
    LEFT,
    largest_residual,
    residual_vibration,
    vibration_of,
)
from threadline.motion.shaping.types import FlexibleMode, Shaper

MATCH = 0.01
"""Largest difference of V over f (1 +- 25 %) with which a type counts as the same shaper."""

_MAX_DAMPING = {"zv": 0.99, "mzv": 0.99, "zvd": 0.99, "ei": 0.4, "2hump_ei": 0.3, "3hump_ei": 0.2}
_V_TOL = 0.05  # tolerance of Klipper's ei without parameters
_KLIPPER_HUMPS = {"2hump_ei": 2, "3hump_ei": 3}


def klipper_impulses(shaper_type: str, mode: FlexibleMode) -> Shaper:
    """Return the impulses that Klipper plays for a type, normalised to sum 1.

    Parameters
    ----------
    shaper_type
        A type, with or without parameters: ``zvd``, ``mzv(n=4,t=0.9)``, ``ei(v_tol=0.1)``.

    Raises
    ------
    OptionError
        If the type is unknown or the damping ratio is above Klipper's limit for it.
    """
    shape = mzv_shape(shaper_type)
    if shape is not None:
        weights, periods = modified_zv(mode.damping_ratio, *shape)
        return Shaper(
            amplitudes=weights, times_s=periods / mode.frequency_hz, name=f"klipper {shaper_type}"
        )
    tolerance = _V_TOL
    with_tolerance = re.fullmatch(r"ei\(v_tol=([\d.]+)\)", shaper_type)
    if with_tolerance is not None:
        shaper_type, tolerance = "ei", float(with_tolerance[1])
    if shaper_type not in _MAX_DAMPING:
        raise OptionError(
            f"Klipper type {shaper_type!r} is unknown", remedy=f"Types: {', '.join(_MAX_DAMPING)}."
        )
    zeta = mode.damping_ratio
    if zeta > _MAX_DAMPING[shaper_type]:
        raise OptionError(
            f"Klipper's {shaper_type} takes damping ratios up to {_MAX_DAMPING[shaper_type]:g}, "
            f"got {zeta:g}"
        )
    root = math.sqrt(1.0 - zeta**2)
    if shaper_type in _KLIPPER_HUMPS:
        periods, weights = fitted_humps(_KLIPPER_HUMPS[shaper_type], zeta)
        times = periods / mode.frequency_hz
    else:
        spacing = 0.375 if shaper_type == "mzv" else 0.5
        decay = math.exp(-2.0 * math.pi * zeta * spacing / root)
        by_type: dict[str, FloatArray] = {
            "zv": np.array([1.0, decay]),
            "mzv": np.array([1.0, math.sqrt(2.0) * decay, decay**2]),
            "zvd": np.array([1.0, 2.0 * decay, decay**2]),
            "ei": _ei_weights(zeta, tolerance),
        }
        weights = by_type[shaper_type]
        step_s = spacing / (root * mode.frequency_hz)
        times = np.array([k * step_s for k in range(len(weights))])
        if shaper_type == "ei":
            times[1] *= 2.0 * _ei_middle(zeta, tolerance)
    return Shaper(
        amplitudes=weights / float(weights.sum()), times_s=times, name=f"klipper {shaper_type}"
    )


def _ei_weights(zeta: float, v: float) -> FloatArray:
    first = (
        (0.24968 + 0.24961 * v) + (0.80008 + 1.23328 * v) * zeta + (0.49599 + 3.17316 * v) * zeta**2
    )
    last = (
        (0.25149 + 0.21474 * v)
        + (-0.83249 + 1.41498 * v) * zeta
        + (0.85181 - 4.90094 * v) * zeta**2
    )
    return np.array([first, 1.0 - first - last, last])


def _ei_middle(zeta: float, v: float) -> float:
    """Return the time of the middle impulse of ei, in damped periods."""
    return (
        0.4999
        + (0.46159 + 8.57843 * v) * v * zeta
        + (4.26169 - 108.644 * v) * v * zeta**2
        + (1.75601 + 336.989 * v) * v * zeta**3
    )


def shortest_type(mode: FlexibleMode) -> tuple[str, float] | None:
    """Return Klipper's shortest type that keeps a mode at rest over a band, and its residual V.

    The residual V is the result of ``largest_residual``, and is at most ``LEFT``. The result is
    None if no type achieves this; each type has its own limit of the damping ratio.
    """
    for name, most_damping in _MAX_DAMPING.items():
        if mode.damping_ratio <= most_damping:
            residual = largest_residual(klipper_impulses(name, mode), [mode])
            if residual <= LEFT:
                return name, residual
    return None


@dataclass(frozen=True, slots=True)
class FirmwareExport:
    """The settings to paste, or the reason why there are none.

    Parameters
    ----------
    section
        Text of ``[input_shaper]`` or ``M593``; empty if no type fits.
    shaper_type
        Name of the type in the firmware; empty if no type fits.
    difference
        Largest difference of V between the firmware's nearest train and ours over f (1 +- 25 %).
    explanation
        One sentence; if no type fits, it names the nearest type.
    """

    section: str
    shaper_type: str
    difference: float
    explanation: str


def klipper_export(shaper: Shaper, mode: FlexibleMode, *, axes: str = "xy") -> FirmwareExport:
    """Find Klipper's type that plays ``shaper``, which was made for ``mode``.

    Parameters
    ----------
    shaper
        Positive train; unit-magnitude and negative trains fit no type.
    mode
        Mode of the shaper; Klipper's frequency is the undamped frequency, too.
    axes
        Axes of the section: "x", "y" or "xy".

    Raises
    ------
    OptionError
        If ``axes`` names another axis.
    """
    if not axes or set(axes) - {"x", "y"}:
        raise OptionError(f"Klipper shapes axes x and y, got {axes!r}")
    types = [
        name for name, most_damping in _MAX_DAMPING.items() if mode.damping_ratio <= most_damping
    ]
    trains = {
        word: klipper_impulses(word, mode) for word in [*types, *_with_parameters(shaper, mode)]
    }
    export = _played("Klipper", shaper, mode, trains)
    if not export.shaper_type:
        return export
    lines = ["[input_shaper]"]
    for axis in axes:
        lines += [
            f"shaper_type_{axis}: {export.shaper_type}",
            f"shaper_freq_{axis}: {mode.frequency_hz:.6g}",
            f"damping_ratio_{axis}: {mode.damping_ratio:.6g}",
        ]
    return replace(export, section="\n".join(lines) + "\n")


def _with_parameters(shaper: Shaper, mode: FlexibleMode) -> list[str]:
    """Return types with parameters that have the shaper's number of impulses and duration."""
    n = len(shaper.times_s)
    types: list[str] = []
    if not 3 <= n <= 32 or bool(np.any(shaper.amplitudes < 0.0)):
        return types
    even_times_s = np.linspace(0.0, shaper.duration_s, n)
    periods = round(shaper.duration_s / mode.damped_period_s, 6)
    if np.allclose(shaper.times_s, even_times_s, rtol=0.0, atol=1e-6 * shaper.duration_s):
        with suppress(OptionError):
            modified_zv(mode.damping_ratio, n, periods)
            if (n, periods) != (3, 0.75):
                types.append(f"mzv(n={n},t={periods:g})")
    peak = vibration_of(shaper, mode)
    fits = n == 3 and mode.damping_ratio <= _MAX_DAMPING["ei"]
    if fits and 1e-4 < peak < 0.5 and abs(peak - _V_TOL) > 1e-4:
        types.append(f"ei(v_tol={peak:.4f})")
    return types


def _played(
    firmware: str, shaper: Shaper, mode: FlexibleMode, trains: Mapping[str, Shaper]
) -> FirmwareExport:
    """Return the type in ``trains`` that equals a shaper, or no type and the nearest one."""
    f = mode.frequency_hz * np.linspace(0.75, 1.25, 201)
    vibration = residual_vibration(shaper, f, mode.damping_ratio)

    def difference_from(train: Shaper) -> float:
        train_vibration = residual_vibration(train, f, mode.damping_ratio)
        return float(np.abs(train_vibration - vibration).max())

    positive = bool(np.all(shaper.amplitudes >= 0.0))
    same_length = {w: t for w, t in trains.items() if len(t.times_s) == len(shaper.times_s)}
    word = min(same_length or trains, key=lambda w: difference_from(trains[w]))
    difference = difference_from(trains[word])
    if same_length and positive and difference <= MATCH:
        return FirmwareExport(
            "",
            word,
            difference,
            f"{firmware}'s {word} plays it: V differs by at most {difference:.4f} within 25 %",
        )
    word = min(trains, key=lambda w: difference_from(trains[w]))
    difference = difference_from(trains[word])
    longer_s = trains[word].duration_s - shaper.duration_s
    return FirmwareExport(
        "",
        "",
        difference,
        f"no type of {firmware}'s plays shaper '{shaper.name}'; the nearest, {word}, is "
        f"{difference:.3f} of V off and takes {abs(longer_s) * 1e3:.4g} ms "
        f"{'more' if longer_s >= 0.0 else 'less'}",
    )


def marlin_export(shaper: Shaper, mode: FlexibleMode) -> FirmwareExport:
    """Return Marlin's ``M593`` for ``shaper``, made for ``mode``, or how much its ZV differs."""
    command = f"M593 F{damped_frequency_hz(mode):.6g} D{mode.damping_ratio:.6g}"
    train = marlin_impulses(damped_frequency_hz(mode), mode.damping_ratio)
    export = _played("Marlin", shaper, mode, {command: train})
    return replace(export, section=f"{command}\n") if export.shaper_type else export


def reprap_export(shaper: Shaper, mode: FlexibleMode) -> FirmwareExport:
    """Return RepRapFirmware's ``M593`` for ``shaper``, made for ``mode``, or name the nearest.

    The custom type is not used, because ``H`` and ``T`` have other meanings in other versions of
    the firmware.
    """
    trains = {
        f'M593 P"{name}" F{mode.frequency_hz:.6g} S{mode.damping_ratio:.6g}': reprap_impulses(
            name, mode.frequency_hz, mode.damping_ratio
        )
        for name in TYPES
        if mode.damping_ratio <= _MOST_DAMPING.get(name, 0.99)
    }
    export = _played("RepRapFirmware", shaper, mode, trains)
    return replace(export, section=f"{export.shaper_type}\n") if export.shaper_type else export


_PARTS = 128.0


def damped_frequency_hz(mode: FlexibleMode) -> float:
    """Return the F of Marlin's ``M593`` for a mode: its damped frequency, Hz."""
    return mode.frequency_hz * math.sqrt(1.0 - mode.damping_ratio**2)


def marlin_impulses(frequency_hz: float, damping_ratio: float) -> Shaper:
    """Return the impulses of ``M593 F D``; ``damping_ratio`` lies in [0, 1)."""
    powers = damping_ratio ** np.arange(4)
    fitted = np.array([64.44056192, -99.02008832, -7.58095488, 43.073216]) @ powers
    echo = 64.0 if damping_ratio <= 0.0 else math.floor(fitted)
    return Shaper(
        amplitudes=np.array([_PARTS - echo, echo]) / _PARTS,
        times_s=np.array([0.0, 0.5 / frequency_hz]),
        name="marlin zv",
    )


_DERIVATIVES = {"zvd": 2, "zvdd": 3, "zvddd": 4}
_HUMPS_OF_TYPE = {"ei2": 2, "ei3": 3}
_MOST_DAMPING = {"ei2": 0.3, "ei3": 0.2}  # largest damping ratios for which the fits are valid
TYPES = ("mzv", *_DERIVATIVES, *_HUMPS_OF_TYPE)
"""Types of ``M593 P``, without the custom type."""
_FREQUENCIES = 41  # number of frequencies tried, from the slowest mode to the fastest


class Chosen(NamedTuple):
    """Values of ``M593 P F S``, and the largest residual V of their train over the modes."""

    type: str
    frequency_hz: float
    damping_ratio: float
    left: float


def reprap_impulses(shaper_type: str, frequency_hz: float, damping_ratio: float) -> Shaper:
    """Return the impulses of ``M593 P F S``.

    Raises
    ------
    OptionError
        If the type is unknown.
    """
    if shaper_type not in TYPES:
        raise OptionError(
            f"RepRapFirmware type {shaper_type!r} is unknown", remedy=f"Types: {', '.join(TYPES)}."
        )
    root = math.sqrt(1.0 - damping_ratio**2)
    period_s = 1.0 / (frequency_hz * root)
    if shaper_type in _HUMPS_OF_TYPE:
        periods, weights = fitted_humps(_HUMPS_OF_TYPE[shaper_type], damping_ratio)
        weights[-1] = 1.0 - weights[:-1].sum()  # so that the sum is 1
    else:
        spacing = 0.375 if shaper_type == "mzv" else 0.5
        decay = math.exp(-2.0 * math.pi * damping_ratio * spacing / root)
        order = _DERIVATIVES.get(shaper_type)
        undamped = (
            [1.0, math.sqrt(2.0), 1.0]
            if order is None
            else [float(math.comb(order, k)) for k in range(order + 1)]
        )
        weights = np.array([share * decay**k for k, share in enumerate(undamped)])
        periods = np.array([k * spacing for k in range(len(undamped))])
    return Shaper(
        amplitudes=weights / weights.sum(),
        times_s=periods * period_s,
        name=f"reprapfirmware {shaper_type}",
    )


def shortest_for_all(modes: Sequence[FlexibleMode]) -> Chosen | None:
    """Return the shortest train of RepRapFirmware that keeps all ``modes`` at rest over a band.

    Its residual V is at most ``LEFT`` over the band of each mode, by ``largest_residual``; None if
    no type achieves that. With several modes the frequency lies between the slowest and the
    fastest, and the damping ratio is their mean.
    """
    shortest: tuple[float, Chosen] | None = None
    slowest, fastest = (pick(mode.frequency_hz for mode in modes) for pick in (min, max))
    damping = float(np.mean([mode.damping_ratio for mode in modes]))
    for name in TYPES:
        if damping > _MOST_DAMPING.get(name, 0.99):
            continue
        for f in np.unique(np.linspace(slowest, fastest, _FREQUENCIES)):
            train = reprap_impulses(name, float(f), damping)
            length_s = float(train.times_s[-1])
            if shortest is not None and length_s >= shortest[0]:
                continue
            residual = largest_residual(train, modes)
            if residual <= LEFT:
                shortest = length_s, Chosen(name, float(f), damping, residual)
    return None if shortest is None else shortest[1]
