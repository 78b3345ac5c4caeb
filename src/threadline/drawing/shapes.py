"""Pieces from points, bulges, centres, control points and knots."""

from __future__ import annotations

from math import comb

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.drawing.curves import MAX_DEGREE, Pieces


def _bundle(top: FloatArray, bottom: FloatArray, lines: IntArray | int) -> Pieces:
    count = len(top)
    return Pieces(
        top=top,
        bottom=bottom,
        begin_rad=np.zeros(count),
        sweep_rad=np.zeros(count),
        line=np.broadcast_to(np.asarray(lines, dtype=np.int64), (count,)).copy(),
    )


def chords(points: FloatArray, lines: IntArray | int = 0) -> Pieces:
    """Return the chords that join ``points``, (n + 1, 2) m; ``lines`` (n,) or one number."""
    top = np.zeros((len(points) - 1, 3, 2))
    top[:, 0], top[:, 1] = points[:-1], np.diff(points, axis=0)
    bottom = np.zeros((len(top), 3))
    bottom[:, 0] = 1.0
    return _bundle(top, bottom, lines)


def ellipse_arc(
    centre: FloatArray,
    a: FloatArray,
    b: FloatArray,
    begin_rad: float,
    sweep_rad: float,
    line: int = 0,
) -> Pieces:
    """Return ``centre + a cos(w) + b sin(w)`` for w from ``begin_rad`` on, through ``sweep_rad``.

    ``centre``, ``a`` and ``b`` are (2,) m; for a circle a and b are at right angles and alike.
    """
    top = np.array([[centre, a, b]], dtype=np.float64)
    piece = _bundle(top, np.array([[1.0, 0.0, 0.0]]), line)
    piece.begin_rad[0], piece.sweep_rad[0] = begin_rad, sweep_rad
    return piece


def bulges(points: FloatArray, bulge: FloatArray, lines: IntArray | int = 0) -> Pieces:
    r"""Return the segments of a polyline with bulges.

    Parameters
    ----------
    points
        (n + 1, 2) m.
    bulge
        (n,) tangent of a quarter of the angle of the arc from point i to point i + 1, positive
        counter-clockwise, 0 for a chord: the DXF convention.

    Notes
    -----
    With chord c and bulge b the centre lies at ``middle + c_left (1 - b^2) / (4 b)``, where
    c_left is the chord turned a quarter to the left.
    """
    pieces = chords(points, lines)
    arc = np.flatnonzero(bulge)
    chord = points[arc + 1] - points[arc]
    left = np.column_stack([-chord[:, 1], chord[:, 0]])
    b = bulge[arc][:, None]
    centre = points[arc] + chord / 2.0 + left * (1.0 - b**2) / (4.0 * b)
    a = points[arc] - centre
    pieces.top[arc, 0], pieces.top[arc, 1] = centre, a
    pieces.top[arc, 2] = np.column_stack([-a[:, 1], a[:, 0]])
    pieces.sweep_rad[arc] = 4.0 * np.arctan(bulge[arc])
    return pieces


def bezier(control: FloatArray, weights: FloatArray | None = None, line: int = 0) -> Pieces:
    """Return a Bezier curve through (degree + 1, 2) control points, rational with ``weights``."""
    degree = len(control) - 1
    if degree > MAX_DEGREE:
        raise ValueError(f"a curve of degree {degree}, the highest supported is {MAX_DEGREE}")
    weights = np.ones(degree + 1) if weights is None else weights
    basis = np.zeros((max(degree + 1, 3), degree + 1))  # power basis from Bernstein
    for i in range(degree + 1):
        for k in range(i, degree + 1):
            basis[k, i] = comb(degree, k) * comb(k, i) * (-1.0) ** (k - i)
    top = basis @ (control * weights[:, None])
    bottom = basis @ weights
    if np.all(weights == weights[0]):
        top, bottom = top / weights[0], np.eye(len(basis))[0]
    return _bundle(top[None], bottom[None], line)


def spline(
    control: FloatArray,
    knots: FloatArray,
    degree: int,
    weights: FloatArray | None = None,
    line: int = 0,
) -> list[Pieces]:
    """Return the spans of a (rational) B-spline as exact Bezier curves.

    Parameters
    ----------
    control
        (n, 2) m.
    knots
        (n + degree + 1,) not decreasing.
    degree
        At most 12.
    weights
        (n,) > 0; all 1 by default.

    Notes
    -----
    Knots are inserted until each has multiplicity ``degree`` (Boehm's algorithm, in homogeneous
    coordinates); the control points are then those of the spans.
    """
    if len(knots) != len(control) + degree + 1:
        raise ValueError(
            f"a spline of degree {degree} with {len(control)} control points has "
            f"{len(control) + degree + 1} knots, got {len(knots)}"
        )
    if degree < 1 or degree > MAX_DEGREE:
        raise ValueError(f"a spline of degree {degree}, supported are 1 to {MAX_DEGREE}")
    if (np.diff(knots) < 0).any():
        raise ValueError("the knots of a spline must not decrease")
    weights = np.ones(len(control)) if weights is None else weights
    if (weights <= 0).any():
        raise ValueError("the weights of a spline must be greater than 0")
    points = np.column_stack([control * weights[:, None], weights])
    knots = knots.astype(np.float64)
    low, high = knots[degree], knots[len(control)]
    for value in np.unique(knots[(knots >= low) & (knots <= high)]):
        while np.count_nonzero(knots == value) < degree:
            points, knots = _insert(points, knots, degree, float(value))
    spans = []
    inner = np.unique(knots[(knots >= low) & (knots <= high)])
    for begin in inner[:-1]:
        first = int(np.searchsorted(knots, begin, side="right")) - 1 - degree
        part = points[first : first + degree + 1]
        spans.append(bezier(part[:, :2] / part[:, 2:], part[:, 2], line))
    return spans


def _insert(
    points: FloatArray, knots: FloatArray, degree: int, value: float
) -> tuple[FloatArray, FloatArray]:
    """Return control points and knots with ``value`` once more among the knots."""
    span = int(np.searchsorted(knots, value, side="right")) - 1
    span = min(span, len(points) - 1)
    fresh = np.empty((len(points) + 1, points.shape[1]))
    fresh[: span - degree + 1] = points[: span - degree + 1]
    fresh[span + 1 :] = points[span:]
    for i in range(span - degree + 1, span + 1):
        width = knots[i + degree] - knots[i]
        share = (value - knots[i]) / width if width > 0.0 else 0.0
        fresh[i] = share * points[i] + (1.0 - share) * points[i - 1]
    return fresh, np.insert(knots, span + 1, value)
