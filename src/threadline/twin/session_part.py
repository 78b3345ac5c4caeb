"""Ticks of a session in one piece, and pieces put together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.twin.kernel import Reading


@dataclass(slots=True)
class Part:
    """Ticks in one piece: (n, axes) counts commanded, (n,) operations, what is read at them."""

    travelled: IntArray
    operation: IntArray
    read: Mapping[Any, FloatArray] = field(default_factory=dict)


def joined(parts: Sequence[Part], axes: int, runs: int, readings: Sequence[Reading]) -> Part:
    """Return parts that follow each other as one; without any, one of no ticks.

    Parameters
    ----------
    axes, runs
        How many axes and runs every part has.
    readings
        What every part holds.
    """
    nothing = np.zeros((0, axes), dtype=np.int64)
    unread = np.zeros((0, runs))
    return Part(
        np.concatenate([nothing, *(part.travelled for part in parts)]),
        np.concatenate([nothing[:, 0], *(part.operation for part in parts)]),
        {
            reading: np.concatenate([unread, *(part.read[reading] for part in parts)])
            for reading in readings
        },
    )
