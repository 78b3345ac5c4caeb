"""Every kind of shaper by name: designed exactly, then proved on a simulated oscillator.

``frequency_hz`` is undamped, V is normalised to one unit impulse; see
:mod:`threadline.shaping.types`.
"""

from __future__ import annotations

from enum import StrEnum

import numpy as np

from threadline.arrays import FloatArray
from threadline.errors import OptionError
from threadline.shaping.closed import Train, binomial, modified_zv, switched_zero
from threadline.shaping.humps import Humps, alternating, positive_humps, switched_humps
from threadline.shaping.oscillator import prove
from threadline.shaping.types import FlexibleMode, Shaper

DEFAULT_TOLERANCE = 0.05
_BAND_SAMPLES = 15


class ShaperKind(StrEnum):
    """Kinds made for one mode; the words of the command line."""

    ZV = "zv"
    MZV = "mzv"
    ZVD = "zvd"
    ZVDD = "zvdd"
    EI = "ei"
    EI2 = "2hump-ei"
    EI3 = "3hump-ei"
    UM_ZV = "um-zv"
    UM_ZVD = "um-zvd"
    UM_EI = "um-ei"
    UM_2EI = "um-2ei"
    NEGATIVE_ZV = "negative-zv"
    NEGATIVE_ZVD = "negative-zvd"
    NEGATIVE_EI = "negative-ei"
    NEGATIVE_2EI = "negative-2ei"


_POSITIVE_ORDER = {ShaperKind.ZV: 0, ShaperKind.ZVD: 1, ShaperKind.ZVDD: 2}
_POSITIVE_HUMPS = {ShaperKind.EI: 1, ShaperKind.EI2: 2, ShaperKind.EI3: 3}
_SWITCHED_ORDER = {
    ShaperKind.UM_ZV: 0,
    ShaperKind.UM_ZVD: 1,
    ShaperKind.NEGATIVE_ZV: 0,
    ShaperKind.NEGATIVE_ZVD: 1,
}
_SWITCHED_HUMPS = {
    ShaperKind.UM_EI: 1,
    ShaperKind.UM_2EI: 2,
    ShaperKind.NEGATIVE_EI: 1,
    ShaperKind.NEGATIVE_2EI: 2,
}
UNIT_MAGNITUDE = (ShaperKind.UM_ZV, ShaperKind.UM_ZVD, ShaperKind.UM_EI, ShaperKind.UM_2EI)
"""Kinds whose step is only ever 0 or 1: for valves."""


def design(
    kind: ShaperKind | str,
    mode: FlexibleMode,
    *,
    tolerance: float = DEFAULT_TOLERANCE,
    over_level: float = 1.0,
) -> Shaper:
    """Design a shaper of ``kind`` for one mode.

    Parameters
    ----------
    kind
        See :class:`ShaperKind`. Negative (over-pressure) kinds are for comparison: their step
        leaves [0, 1].
    mode
        Undamped frequency, Hz, and damping ratio in [0, 0.3).
    tolerance
        Height of the humps of the EI kinds, in (0, 0.5); the others ignore it.
    over_level
        Bound P of the partial sums of the negative kinds, amplitudes P, -2P, 2P ... 1 + P:
        Singhose, Singer and Seering (1997), "Time-optimal negative input shapers", JDSMC 119.

    Returns
    -------
    Shaper
        Constraints solved to 1e-10 and confirmed to 1e-9 by a simulation.

    Raises
    ------
    OptionError
        If the kind is unknown or a number is outside its range.
    ShaperError
        If the design does not converge or its simulation disagrees.
    """
    try:
        chosen = ShaperKind(kind)
    except ValueError:
        raise OptionError(
            f"shaper kind {str(kind)!r} is unknown",
            remedy=f"Kinds: {', '.join(ShaperKind)}.",
        ) from None
    if not 0.0 < tolerance < 0.5:
        raise OptionError(f"shaper tolerance must be in (0, 0.5), got {tolerance!r}")
    zeta = mode.damping_ratio
    if chosen in _POSITIVE_HUMPS:
        return _proved_humps(
            chosen, mode, positive_humps(_POSITIVE_HUMPS[chosen], zeta, tolerance), tolerance
        )
    if chosen in _SWITCHED_HUMPS:
        humps = _SWITCHED_HUMPS[chosen]
        amplitudes = _switched_amplitudes(chosen, 2 * humps + 3, over_level)
        return _proved_humps(
            chosen, mode, switched_humps(humps, zeta, tolerance, amplitudes), tolerance
        )
    if chosen in _SWITCHED_ORDER:
        order = _SWITCHED_ORDER[chosen]
        train = switched_zero(order, zeta, _switched_amplitudes(chosen, 2 * order + 3, over_level))
    elif chosen in _POSITIVE_ORDER:
        train = binomial(_POSITIVE_ORDER[chosen], zeta)
    else:
        train = modified_zv(zeta)
    return _proved_zero(chosen, mode, train)


def _switched_amplitudes(kind: ShaperKind, n: int, over_level: float) -> FloatArray:
    if kind in UNIT_MAGNITUDE:
        return alternating(n)
    if not 0.5 < over_level <= 10.0:
        raise OptionError(
            f"shaper '{kind}': over_level must be in (0.5, 10], got {over_level!r}",
            remedy="At 0.5 the impulses can just cancel; below it they can't.",
        )
    amplitudes = 2.0 * over_level * alternating(n)
    amplitudes[0], amplitudes[-1] = over_level, 1.0 + over_level
    return amplitudes


def _shaper(kind: ShaperKind, mode: FlexibleMode, train: Train) -> Shaper:
    amplitudes, times = train
    return Shaper(amplitudes=amplitudes, times_s=times / mode.frequency_hz, name=str(kind))


def _proved_zero(kind: ShaperKind, mode: FlexibleMode, train: Train) -> Shaper:
    at = np.array([mode.frequency_hz])
    return prove(_shaper(kind, mode, train), at, mode.damping_ratio, np.zeros(1))


def _proved_humps(kind: ShaperKind, mode: FlexibleMode, humps: Humps, tolerance: float) -> Shaper:
    shaper = _shaper(kind, mode, (humps.amplitudes, humps.times))
    named = np.concatenate((humps.zeros, humps.peaks))
    claims = np.concatenate((np.zeros(len(humps.zeros)), np.full(len(humps.peaks), tolerance)))
    prove(shaper, named * mode.frequency_hz, mode.damping_ratio, claims)
    # Between the zeros nothing may stand above the humps that were asked for.
    band = np.linspace(humps.zeros[0], humps.zeros[-1], _BAND_SAMPLES) * mode.frequency_hz
    return prove(shaper, band, mode.damping_ratio, np.full(_BAND_SAMPLES, tolerance), at_most=True)
