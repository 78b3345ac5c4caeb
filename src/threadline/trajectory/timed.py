"""Trajectory of a path whose pieces already have their times."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from threadline.path.types import PieceBlock, PlannedPath
from threadline.trajectory.types import TrajectoryBlock


def timed_blocks(path: PlannedPath) -> Iterator[TrajectoryBlock]:
    """Yield the pieces of ``path`` with their own times, and a constant piece per dwell."""
    end_s = 0.0
    for pieces in path:
        block = _block(pieces, end_s)
        if block is not None:
            end_s = block.end_s
            yield block


def _block(pieces: PieceBlock, begin_s: float) -> TrajectoryBlock | None:
    count, order, axes = pieces.coefficients.shape
    # Row 2i is piece i, row 2i + 1 the dwell after it; rows without duration fall away.
    duration = np.stack([pieces.nominal_s, pieces.dwell_s], axis=1).reshape(-1)
    coefficients = np.zeros((count, 2, order, axes))
    coefficients[:, 0] = pieces.coefficients
    coefficients[:, 1, 0] = pieces.coefficients.sum(axis=1)
    kept = duration > 0
    if not kept.any():
        return None
    duration = duration[kept]
    start = begin_s + np.concatenate([[0.0], np.cumsum(duration)[:-1]])
    return TrajectoryBlock(
        start_s=start,
        duration_s=duration,
        coefficients=coefficients.reshape(2 * count, order, axes)[kept],
        operation=np.repeat(pieces.operation, 2)[kept],
    )
