"""Path deviation: planned path against programmed, and shaped motion against planned."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.commands.plan import Plan
from threadline.verdict.contour import Contour
from threadline.verdict.finding import Finding
from threadline.verdict.samples import Block
from threadline.verdict.sweep import feed
from threadline.verdict.window import PathWindow

PER_PIECE = 16  # points on a curved piece: the chord error is at most 1/256 of its sagitta
CHORD_ERROR_M = 1e-9
"""Chord error below which a piece of a motion needs no more points."""
_SMOOTHED = 4  # neighbouring chords on either side that smoothing in time may reach


def measure_path_deviation(plan: Plan) -> list[Finding]:
    """Return the largest distance, at the tool, between planned and programmed path.

    Measured both ways, as the contour error: from the planned path to the chord of its operation
    and its two neighbours, and from each programmed vertex to the planned path there.

    This is the judge's own measure, built on its contour error. The planner measures its paths with
    separate code (``threadline.motion.path.deviation``), so that it does not mark its own work.
    """
    contour = Contour(plan.motion.programmed.radius_m)
    pieces = (_points(b.coefficients, b.operation, PER_PIECE) for b in plan.motion.path if len(b))
    for block in _blocks(pieces, PathWindow(plan.motion.programmed), 1):
        feed([contour], block)
    return [replace(found.worst(), time_s=None) for found in contour.finish()]


def measure_shaping_deviation(plan: Plan) -> list[Finding]:
    """Return the deviation of the shaped motion from the planned path, at the tool."""
    if plan.motion.of_loads is not None:
        return measure_motion_deviation(plan, curved=1)
    planned, text = plan.motion.timed, plan.options.get("shaper")
    if planned is None or text is None:
        return [Finding(value=0.0, note="the motion is not shaped")]
    from threadline.motion.shaping import longest_delay_s, parse_shaper, shaping_deviation

    longest = longest_delay_s(planned.axes, parse_shaper(text), centroid_shift=True)
    found = shaping_deviation(planned, plan.motion.trajectory, plan.machine, longest)
    return [
        Finding(
            value=found.at_tool_m,
            operation=found.operation,
            position=found.position,
            note="a planned place is missed" if found.missed else "",
        )
    ]


def measure_motion_deviation(plan: Plan, curved: int = PER_PIECE) -> list[Finding]:
    """Return the deviation of the intended motion from the programmed path, smoothing included.

    If the loads follow the motion, it is the motion of the loads. At most ``curved`` points are
    taken on a piece, and no more than a chord error of ``CHORD_ERROR_M`` needs: a motion of an hour
    has millions of pieces, most of them nearly straight.
    """
    contour = Contour(plan.motion.programmed.radius_m)
    machine, axes = plan.machine, plan.motion.trajectory.axes
    radius = machine.radius_m[[machine.axis_names.index(axis) for axis in axes]]
    pieces = (
        _few_points(b.coefficients, b.operation, curved, radius)
        for b in plan.motion.trajectory
        if len(b)
    )
    for block in _blocks(pieces, PathWindow(plan.motion.programmed), _SMOOTHED):
        feed([contour], block)
    return [replace(found.worst(), time_s=None) for found in contour.finish()]


def _blocks(
    pieces: Iterator[tuple[FloatArray, IntArray]], path: PathWindow, beside: int
) -> Iterator[Block]:
    """Yield points with the chord of their operation, and ``beside`` chords on either side."""
    previous: int | None = None
    for points, operation in pieces:
        path.reach(int(operation[-1]) + beside)
        first, last = path.chords(operation)
        begin, end = first - beside + path.first, last + beside + path.first
        path.drop(int(begin[0] if previous is None else previous))
        previous = int(begin[-1])
        end = np.minimum(end, path.first + len(path) - 1)
        yield Block(
            first=0,
            time_s=np.zeros(len(points)),
            commanded=points,
            actual=points[:, None],
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


def _points(
    coefficients: FloatArray, operation: IntArray, curved: int
) -> tuple[FloatArray, IntArray]:
    """Return (n, axes) points of the pieces, ends included, and (n,) their operations."""
    order = coefficients.shape[1]
    count = curved if order > 2 else 1
    places = np.arange(count + 1) / count
    powers = places[:, None] ** np.arange(order)
    points = np.einsum("uk,nka->nua", powers, coefficients)
    operation = np.maximum.accumulate(np.repeat(operation, count + 1))
    return points.reshape(-1, points.shape[2]), operation


def _few_points(
    coefficients: FloatArray, operation: IntArray, curved: int, radius: FloatArray
) -> tuple[FloatArray, IntArray]:
    """Return (n, axes) points of the pieces and (n,) their operations.

    A point where two pieces of an operation meet is taken once. The second derivative of a
    polynomial sum c_k u^k on [0, 1] is at most sum k (k - 1) |c_k|; an eighth of it bounds the
    sagitta.
    """
    powers = np.arange(coefficients.shape[1])
    bend = np.abs(coefficients * radius) * (powers * (powers - 1.0))[:, None]
    sagitta = np.sqrt((bend.sum(axis=1) ** 2).sum(axis=1)) / 8.0
    chord_count = np.sqrt(sagitta / CHORD_ERROR_M)
    count = np.minimum(2 ** np.ceil(np.log2(np.maximum(chord_count, 1.0))), curved).astype(np.int64)
    begins = np.append(True, operation[1:] != operation[:-1])
    behind = np.cumsum(count + begins)
    points = np.empty((int(behind[-1]), coefficients.shape[2]))
    points[behind[begins] - count[begins] - 1] = coefficients[begins, 0]
    for parts in np.unique(count).tolist():
        pieces = np.flatnonzero(count == parts)
        places = np.arange(1, parts + 1) / parts
        rows = (behind[pieces] - parts)[:, None] + np.arange(parts)
        points[rows] = (places[:, None] ** powers) @ coefficients[pieces]
    return points, np.maximum.accumulate(np.repeat(operation, count + begins))
