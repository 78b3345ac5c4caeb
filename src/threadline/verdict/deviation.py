"""Path deviation: planned path against programmed, and shaped motion against planned."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from threadline.arrays import IntArray
from threadline.path.types import PieceBlock
from threadline.plan import Plan
from threadline.shaping import longest_delay_s, parse_shaper, shaping_deviation
from threadline.verdict.contour import Contour
from threadline.verdict.measure import Block, Finding
from threadline.verdict.window import PathWindow

PER_PIECE = 16  # points on a curved piece: between them it bows out by 1/256 of its own bow at most


def measure_path_deviation(plan: Plan) -> list[Finding]:
    """Return the largest distance, at the tool, between planned and programmed path.

    Both ways, as for the contour error: from the planned path to the chords of its operation and
    the two beside them, and from each programmed vertex to the planned path there.
    """
    contour = Contour(plan.programmed.radius_m)
    for block in _blocks(plan, PathWindow(plan.programmed)):
        contour.feed(block)
    return [replace(finding, time_s=None) for finding in contour.finish()]


def measure_shaping_deviation(plan: Plan) -> list[Finding]:
    """Return how far the shaper takes the motion from the planned path, at the tool."""
    planned, text = plan.unshaped, plan.options.get("shaper")
    if planned is None or text is None:
        return [Finding(value=0.0, note="the motion is not shaped")]
    longest = longest_delay_s(planned.axes, parse_shaper(text), centroid_shift=True)
    found = shaping_deviation(planned, plan.trajectory, plan.machine, longest)
    return [
        Finding(
            value=found.at_tool_m,
            operation=found.operation,
            position=found.position,
            note="a planned place is missed" if found.missed else "",
        )
    ]


def _blocks(plan: Plan, path: PathWindow) -> Iterator[Block]:
    previous: int | None = None
    for pieces in plan.path:
        if not len(pieces):
            continue
        points, operation = _points(pieces)
        path.reach(int(operation[-1]) + 1)
        begin = path.chord_from(operation) - 1 + path.first
        end = path.chord_to(operation) + 1 + path.first
        path.drop(int(begin[0] if previous is None else previous))
        previous = int(begin[-1])
        end = np.minimum(end, path.first + len(path) - 1)
        yield Block(
            first=0,
            time_s=np.zeros(len(points)),
            commanded=points,
            actual=points,
            own=None,
            voltage=None,
            current=None,
            current_peak=None,
            operation=operation,
            chord=None,
            begin=begin,
            end=end,
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
