"""Axes that a written program moves on the way to the place where its job first moves them.

A job that goes over a place and then down leaves Z where the operator has put it until then. The
rounded corner before the descent moves Z earlier, and so from the zero of the program.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.jobs.operations import Job, MoveRun, move_runs
from threadline.machine import Machine


class _First(NamedTuple):
    """Line of the first move of an axis, and the (axes,) position before it."""

    line: int
    before: FloatArray


def early_moves(job: Job, ways: Iterable[FloatArray], machine: Machine) -> Iterator[str]:
    """Yield a sentence for each linear axis that moves too early.

    Parameters
    ----------
    ways
        (n, axes) points of each move of the written program, the place before it included.
    """
    start = np.array(job.start)
    waiting = {
        k: first
        for k, first in _first_moves(job).items()
        if machine.axes[job.axes[k]].kind == "linear" and np.any(first.before != start)
    }
    for points in ways:
        if not waiting:
            return
        for k in [k for k in waiting if points[-1][k] != start[k]]:
            first = waiting.pop(k)
            if np.any(np.delete(points[0] - first.before, k) != 0.0):
                name = job.axes[k]
                yield (
                    f"{name} moves before line {first.line}, where {job.name} first moves it: the "
                    f"corner there is rounded. Begin with {name} at the zero of the program, or "
                    "write its position into the first move"
                )


def _first_moves(job: Job) -> dict[int, _First]:
    """Return the first move of each axis that moves, by the index of the axis."""
    found: dict[int, _First] = {}
    start = at = np.array(job.start)
    for run in move_runs(job):
        if not isinstance(run, MoveRun):
            continue
        targets = run.targets
        moved = targets != start
        for k in np.flatnonzero(moved.any(axis=0)).tolist():
            if k not in found:
                row = int(np.argmax(moved[:, k]))
                found[k] = _First(int(run.line[row]), targets[row - 1] if row else at)
        if len(found) == len(start):
            break
        at = targets[-1]
    return found
