"""The trains that RepRapFirmware plays for the types of ``M593``, one for all axes.

Source: RepRapFirmware 3, ``AxisShaper::Configure``: mzv, zvd, zvdd, zvddd exactly, ei2 and ei3 by
published fits, their times in damped periods. F is the undamped frequency, S the damping ratio.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from threadline.errors import OptionError
from threadline.shaping.fitted_humps import fitted_humps
from threadline.shaping.left_of_modes import LEFT, most_left
from threadline.shaping.types import FlexibleMode, Shaper

_DERIVATIVES = {"zvd": 2, "zvdd": 3, "zvddd": 4}
_HUMPS = {"ei2": 2, "ei3": 3}
_MOST_DAMPING = {"ei2": 0.3, "ei3": 0.2}  # of the fits
TYPES = ("mzv", *_DERIVATIVES, *_HUMPS)
"""The words of ``M593 P``, without the train of one's own."""
_FREQUENCIES = 41  # tried from the slowest mode to the fastest


class Chosen(NamedTuple):
    """Values of ``M593 P F S``, and the largest V that their train leaves of the modes."""

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
    if shaper_type in _HUMPS:
        periods, weights = fitted_humps(_HUMPS[shaper_type], damping_ratio)
        weights[-1] = 1.0 - weights[:-1].sum()  # what is left over for the last
    else:
        spacing = 0.375 if shaper_type == "mzv" else 0.5
        decay = math.exp(-2.0 * math.pi * damping_ratio * spacing / root)
        order = _DERIVATIVES.get(shaper_type)
        plain = (
            [1.0, math.sqrt(2.0), 1.0]
            if order is None
            else [float(math.comb(order, k)) for k in range(order + 1)]
        )
        weights = np.array([share * decay**k for k, share in enumerate(plain)])
        periods = np.array([k * spacing for k in range(len(plain))])
    return Shaper(
        amplitudes=weights / weights.sum(),
        times_s=periods * period_s,
        name=f"reprapfirmware {shaper_type}",
    )


def shortest_for_all(modes: Sequence[FlexibleMode]) -> Chosen | None:
    """Return the shortest train of RepRapFirmware that keeps all ``modes`` at rest over a band.

    It leaves at most ``LEFT`` of each over its band, by ``most_left``; None where no type does. Of
    several modes the frequency lies between the slowest and the fastest, and the damping ratio is
    their mean.
    """
    found: tuple[float, Chosen] | None = None
    slowest, fastest = (end(mode.frequency_hz for mode in modes) for end in (min, max))
    damping = float(np.mean([mode.damping_ratio for mode in modes]))
    for name in TYPES:
        if damping > _MOST_DAMPING.get(name, 0.99):
            continue
        for f in np.unique(np.linspace(slowest, fastest, _FREQUENCIES)):
            train = reprap_impulses(name, float(f), damping)
            length_s = float(train.times_s[-1])
            if found is not None and length_s >= found[0]:
                continue
            left = most_left(train, modes)
            if left <= LEFT:
                found = length_s, Chosen(name, float(f), damping, left)
    return None if found is None else found[1]
