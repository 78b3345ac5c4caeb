"""The tension of the fibre that a job asks for, move by move: the tag ``tension_N``.

A planned winding gives every move the tension of its layer. A part program has it in comments,
``; tension_N=7.5``, and a table of axes in a column.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from threadline.jobs.operations import Job, Move, MoveRun

TAG = "tension_N"


@lru_cache(maxsize=8)
def tensions_of(job: Job) -> tuple[tuple[int, float], ...]:
    """Return each operation from which on a job asks for another tension, and the tension, N.

    A move without the tag keeps the tension of the move before it. Empty for a job without tags.

    >>> from threadline.jobs.operations import Job, Move, Source
    >>> from threadline.files import Stream
    >>> tags = ({}, {"tension_N": 8.0}, {}, {"tension_N": 7.6})
    >>> moves = [Move((float(k),), None, Source("a.prg", k), tag) for k, tag in enumerate(tags)]
    >>> job = Job(name="a", file="a.prg", sha256="", axes=("A",), start=(0.0,),
    ...           operations=Stream(iter, tuple(moves)))
    >>> tensions_of(job)
    ((1, 8.0), (3, 7.6))
    """
    changes: list[tuple[int, float]] = []
    number = 0
    for item in job.runs():
        count = len(item) if isinstance(item, MoveRun) else 1
        for index, tension_n in _tension_changes(item, count):
            if not changes or tension_n != changes[-1][1]:
                changes.append((number + index, tension_n))
        number += count
    return tuple(changes)


def _tension_changes(item: object, count: int) -> list[tuple[int, float]]:
    """Return where in an operation or a run the tension changes, and to what."""
    if isinstance(item, MoveRun):
        tags = item.columns
    elif isinstance(item, Move):
        tags = {name: np.array([value]) for name, value in item.tags.items()}
    else:
        return []
    column = next((values for name, values in tags.items() if _is_tension(name)), None)
    if column is None:
        return []
    values = np.asarray(column, dtype=np.float64)[:count]
    rows = np.flatnonzero(np.isfinite(values))
    values = values[rows]
    changed = np.flatnonzero(np.diff(values, prepend=np.nan) != 0.0)
    return list(zip(rows[changed].tolist(), values[changed].tolist(), strict=True))


def _is_tension(name: str) -> bool:
    return name.casefold() == TAG.casefold()
