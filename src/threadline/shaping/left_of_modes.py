"""What a train leaves of modes that are not quite where they are said to be."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from threadline.shaping.types import FlexibleMode, Shaper
from threadline.shaping.vibration import residual_vibration

BAND = 0.1
"""Share by which a frequency may be off where the shortest of a firmware's types is chosen."""
LEFT = 0.05
"""Largest V that such a type may leave: the tolerance of the firmwares' own EI types."""


def most_left(shaper: Shaper, modes: Sequence[FlexibleMode], *, band: float = BAND) -> float:
    """Return the largest V that ``shaper`` leaves of ``modes`` over f (1 +- ``band``) of each."""
    return max(
        float(
            residual_vibration(
                shaper,
                mode.frequency_hz * np.linspace(1.0 - band, 1.0 + band, 201),
                mode.damping_ratio,
            ).max()
        )
        for mode in modes
    )
