"""Segments of a written contour: chords and arcs by bulge, by centre and by radius."""

from __future__ import annotations

import math

import numpy as np

from threadline.arrays import FloatArray
from threadline.drawing.curves import Pieces
from threadline.drawing.shapes import bulges, ellipse_arc

RADIUS_SLACK_M = 1e-6
TURNS = ("ccw", "cw")


def bulge_segment(begin: FloatArray, end: FloatArray, bulge: float, line: int) -> Pieces:
    """Return the arc of a bulge (tangent of a quarter of its angle), a chord for a bulge of 0."""
    return bulges(np.array([begin, end]), np.array([bulge]), line)


def centre_segment(
    begin: FloatArray, end: FloatArray, centre: FloatArray, turn: str, line: int
) -> Pieces:
    """Return the arc around ``centre``, a full circle where ``begin`` and ``end`` are equal.

    Raises
    ------
    ValueError
        If the two ends lie at different distances from the centre, or ``turn`` is unknown.
    """
    if turn not in TURNS:
        raise ValueError(f"an arc around a centre turns 'ccw' or 'cw', got {turn!r}")
    a, b = begin - centre, end - centre
    radius, other = math.hypot(*a), math.hypot(*b)
    if radius == 0.0 or abs(radius - other) > RADIUS_SLACK_M:
        raise ValueError(
            f"the arc begins {radius * 1e3:.6g} mm and ends {other * 1e3:.6g} mm from its centre"
        )
    sweep = math.atan2(a[0] * b[1] - a[1] * b[0], float(a @ b))
    if turn == "ccw" and sweep <= 0.0:
        sweep += 2.0 * math.pi
    if turn == "cw" and sweep >= 0.0:
        sweep -= 2.0 * math.pi
    return ellipse_arc(centre, a, np.array([-a[1], a[0]]), 0.0, sweep, line)


def radius_segment(
    begin: FloatArray, end: FloatArray, radius_m: float, turn: str, large: bool, line: int
) -> Pieces:
    """Return the arc of ``radius_m``; ``large`` chooses the one of more than half a turn.

    Raises
    ------
    ValueError
        If the ends are further apart than the diameter, or in one place.
    """
    chord = end - begin
    apart = math.hypot(*chord)
    if not 0.0 < apart <= 2.0 * radius_m * (1.0 + 1e-12):
        raise ValueError(
            f"ends {apart * 1e3:.6g} mm apart are not on a circle of radius {radius_m * 1e3:.6g} mm"
        )
    rise = math.sqrt(max(0.0, radius_m**2 - apart**2 / 4.0))
    left = np.array([-chord[1], chord[0]]) / apart
    side = 1.0 if (turn == "ccw") != large else -1.0
    return centre_segment(begin, end, begin + chord / 2.0 + side * rise * left, turn, line)
