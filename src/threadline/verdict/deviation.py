"""Path deviation: the planned path against the programmed one, geometry only."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from threadline.arrays import IntArray
from threadline.path.types import PieceBlock
from threadline.plan import Plan
from threadline.verdict.contour import Contour
from threadline.verdict.measure import Block, Finding
from threadline.verdict.window import PathWindow

PER_PIECE = 16  # points on a curved piece: between them it bows out by 1/256 of its own bow at most


def measure_path_deviation(plan: Plan) -> list[Finding]:
    """Return the largest distance, at the tool, between planned and programmed path.

    Both ways, as for the contour error: from the planned path to the chords of its operation and
    the two beside it, and from each programmed vertex to the planned path there.
    """
    contour = Contour(plan.programmed.radius_m)
    for block in _blocks(plan, PathWindow(plan.programmed)):
        contour.feed(block)
    return [replace(finding, time_s=None) for finding in contour.finish()]


def _blocks(plan: Plan, path: PathWindow) -> Iterator[Block]:
    previous: int | None = None
    for pieces in plan.path:
        if not len(pieces):
            continue
        points, operation = _points(pieces)
        earliest, latest = operation - 1, operation + 1
        path.move(int(earliest[0] if previous is None else previous), int(latest[-1]))
        previous = int(earliest[-1])
        yield Block(
            first=0,
            time_s=np.zeros(len(points)),
            commanded=points,
            actual=points,
            own=None,
            voltage=None,
            current=None,
            operation=operation,
            earliest=earliest,
            latest=latest,
            path=path,
        )


def _points(pieces: PieceBlock) -> tuple[np.ndarray, IntArray]:
    """Return (n, axes) points of the pieces, ends included, and (n,) their operations."""
    order = pieces.coefficients.shape[1]
    count = PER_PIECE if order > 2 else 1
    places = np.arange(count + 1) / count
    powers = places[:, None] ** np.arange(order)
    points = np.einsum("uk,nka->nua", powers, pieces.coefficients)
    operation = np.maximum.accumulate(np.repeat(pieces.operation, count + 1))
    return points.reshape(-1, points.shape[2]), operation
