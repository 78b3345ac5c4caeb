"""Samples of the channels of an on/off machine, kept in little memory."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from threadline.arrays import FloatArray

Samples: TypeAlias = NDArray[np.float64] | NDArray[np.int8]
"""Samples of a channel; those of a switch are int8, an eighth of the memory."""


def compact(values: FloatArray) -> Samples:
    """Return a switch's samples in an eighth of the memory; others as they are."""
    if ((values == 0.0) | (values == 1.0)).all():
        return values.astype(np.int8)
    return values


def joined(parts: list[Samples]) -> Samples:
    """Return the parts of a channel as one: in whole numbers where every part is."""
    if all(part.dtype == np.int8 for part in parts):
        return np.concatenate(parts, dtype=np.int8)
    return np.concatenate(parts, dtype=np.float64)


def whole(values: Samples) -> NDArray[np.int8]:
    """Return the nearest state of an output; what is far from 0 and 1 stays far from both."""
    return np.clip(np.rint(values), -100, 100).astype(np.int8)


def sample_at(times_s: FloatArray, end_s: float) -> int:
    """Return the last sample that is not behind an instant; the first where all are."""
    return max(int(np.searchsorted(times_s, end_s, side="right")) - 1, 0)
