"""The holes of a seam or a design: the moves at whose ends the needle enters the cloth."""

from __future__ import annotations

import numpy as np

from threadline.base.arrays import IntArray
from threadline.jobs.operations import Job, MoveRun, lacking, move_runs


def entering(item: MoveRun) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Return (n,) whether the needle enters the cloth at the end of each move of a run.

    A move of a seam has the number of its stitch; in a design the number 0 is a move with the
    needle up.
    """
    tag = item.columns.get("stitch")
    number = np.full(len(item), -1) if tag is None else np.where(lacking(tag), -1, tag)
    up = -1 if item.columns.get("block") is None else 0
    return np.asarray(number.astype(float) > up)


def hole_operations(job: Job) -> IntArray:
    """Return the (h,) operations of a job that end in a hole, in order; none without a needle."""
    holes: list[IntArray] = [np.zeros(0, dtype=np.int64)]
    first = 0
    for item in move_runs(job):
        if not isinstance(item, MoveRun):
            first += 1
            continue
        holes.append(first + np.flatnonzero(entering(item)))
        first += len(item)
    return np.concatenate(holes)
