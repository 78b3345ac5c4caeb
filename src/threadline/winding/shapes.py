"""Shapes of mandrels: cylinder, cone, ellipse, isotensoid, nose, and a table of points."""

from __future__ import annotations

import itertools
import math

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.winding.surface import Stretch, line, stretch_of

_PIECE = math.radians(1.0)  # of an ellipse; the error of a piece is below 1e-12 of its radius
_TURN = math.radians(5.0)  # a smaller turn between two chords of a table is no corner
_CORNER_FACTOR = 4.0  # than the turns at both neighbours: then it is a corner of the table
_PIECES = 64  # of a dome that is not an ellipse
_BASE_RAD = 0.02  # rad before the base of a nose, where its parameter stands still


def ellipse(
    x_m: float, radius_m: float, height_m: float, opening_m: float, *, left: bool
) -> Stretch:
    """Return half an ellipse from its equator to a polar opening; a hemisphere if both axes agree.

    Parameters
    ----------
    x_m
        Place of the equator.
    radius_m, height_m
        Semi-axes across and along the mandrel.
    opening_m
        Radius at which it ends.
    left
        Whether the pole is left of the equator.
    """
    end = math.acos(opening_m / radius_m)
    angles = np.linspace(0.0, end, max(int(end / _PIECE), 8) + 1)

    def drawn(p: FloatArray) -> tuple[FloatArray, FloatArray]:
        cos, sin = np.cos(p), np.sin(p)
        x = np.array([x_m + height_m * sin, height_m * cos, -height_m * sin])
        return x, radius_m * np.array([cos, -sin, -cos])

    return _mirrored(stretch_of(drawn, angles), x_m) if left else stretch_of(drawn, angles)


def _mirrored(part: Stretch, about_m: float) -> Stretch:
    """Return a stretch mirrored at a plane across the axis."""
    x, r = part.x[::-1].copy(), part.r[::-1].copy()
    x[:, 0] = 2.0 * about_m - x[:, 0]
    x[:, 2] *= -1.0
    r[:, 1] *= -1.0
    return Stretch(u=part.u[-1] - part.u[::-1], x=x, r=r)


def isotensoid(x_m: float, radius_m: float, opening_m: float, *, left: bool) -> list[Stretch]:
    """Return a geodesic isotensoid from its equator to a polar opening, from left to right.

    The netting theory gives the sine of the meridian's angle with the plane of the equator as
    ``(r / R)^3 sqrt((R^2 - o^2) / (r^2 - o^2))``. Where its meridian would turn concave, at
    ``sqrt(3/2)`` of the opening, it goes on as a cone.
    """
    inflection = math.sqrt(1.5) * opening_m
    scale = math.sqrt(radius_m**2 - opening_m**2)
    # By q with r = R - (R - inflection) q^2 the slope is finite at the equator.
    depth = radius_m - inflection

    def slope(q: FloatArray) -> FloatArray:
        """Return dx/dq."""
        r = radius_m - depth * q * q
        upright = (r / radius_m) ** 3 * scale / np.sqrt(r * r - opening_m**2)
        # 1 - upright^2, without its factor q^2, and multiplied out: a difference would round to 0.
        a, b = (r / radius_m) ** 2, (opening_m / radius_m) ** 2
        of_radius = depth * (2.0 * radius_m - depth * q * q) / radius_m**2
        root = np.sqrt(of_radius * (a + a * a - b * (1.0 + a + a * a)) / (a - b))
        return np.asarray(2.0 * depth * upright / root)

    q = np.linspace(0.0, 1.0, _PIECES + 1)
    nodes, weights = np.polynomial.legendre.leggauss(12)
    q_nodes = q[:-1, None] + np.diff(q)[:, None] * (0.5 + 0.5 * nodes)
    x = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(q) * (slope(q_nodes) @ weights))])
    r = radius_m - depth * q * q
    sin = (r / radius_m) ** 3 * scale / np.sqrt(r * r - opening_m**2)
    cos = np.sqrt(np.maximum(1.0 - sin * sin, 0.0))
    # R2 / R1 = 2 - tan^2 of the fibre's angle.
    curvature = sin / r * (2.0 - opening_m**2 / (r * r - opening_m**2))
    speed = np.hypot(slope(q_nodes), 2.0 * depth * q_nodes)
    u = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(q) * (speed @ weights))])
    dome = Stretch(
        u=u,
        x=np.column_stack([x_m + x, sin, -cos * curvature]),
        r=np.column_stack([r, -cos, -sin * curvature]),
    )
    cone_m = (inflection - opening_m) * sin[-1] / cos[-1]
    cone = line(x_m + x[-1], inflection, x_m + x[-1] + cone_m, opening_m)
    return [_mirrored(cone, x_m), _mirrored(dome, x_m)] if left else [dome, cone]


def nose(
    x_m: float, radius_m: float, height_m: float, opening_m: float, *, left: bool
) -> list[Stretch]:
    """Return a Von Karman nose from its base to a polar opening at its tip.

    ``r = R sqrt((p - sin(2 p) / 2) / pi)`` at ``h (1 - cos(p)) / 2`` from the tip.
    """

    def radius(p: float) -> float:
        return radius_m * math.sqrt((p - 0.5 * math.sin(2.0 * p)) / math.pi)

    low, high = 0.0, math.pi
    for _ in range(80):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if radius(middle) < opening_m else (low, middle)
    parameters = np.linspace(high, math.pi - _BASE_RAD, 2 * _PIECES + 1)

    def drawn(p: FloatArray) -> tuple[FloatArray, FloatArray]:
        x = 0.5 * height_m * np.array([-np.cos(p), np.sin(p), np.cos(p)])
        x[0] += x_m - 0.5 * height_m
        area_share = (p - 0.5 * np.sin(2.0 * p)) / math.pi
        first = 2.0 * np.sin(p) ** 2 / math.pi
        second = 2.0 * np.sin(2.0 * p) / math.pi
        root = np.sqrt(area_share)
        r = radius_m * np.array(
            [root, 0.5 * first / root, 0.5 * second / root - 0.25 * first**2 / root**3]
        )
        return x, r

    # At the base the curvature is infinite: the last 1e-4 of the height is nearly a cylinder.
    dome = stretch_of(drawn, parameters)
    base = line(float(dome.x[-1, 0]), float(dome.r[-1, 0]), x_m, radius_m)
    parts = [dome, base]
    return parts if left else [_mirrored(part, x_m) for part in reversed(parts)]


def table(points_m: FloatArray) -> list[Stretch]:
    """Return smooth stretches through (n, 2) points: places along the axis and radii, m.

    A cubic spline goes through all points between two corners. A point is a corner where the
    chords turn by more than 5 degrees and by four times as much as at the points beside it.
    """
    chords = np.diff(points_m, axis=0)
    turns = np.abs(np.diff(np.arctan2(chords[:, 1], chords[:, 0])))
    neighbour_turns = np.maximum(np.append(turns[1:], 0.0), np.insert(turns[:-1], 0, 0.0))
    corners = np.flatnonzero((turns > _TURN) & (turns > _CORNER_FACTOR * neighbour_turns)) + 1
    ends = [0, *corners.tolist(), len(points_m) - 1]
    return [_spline(points_m[a : b + 1]) for a, b in itertools.pairwise(ends)]


def _spline(points_m: FloatArray) -> Stretch:
    if len(points_m) == 2:
        (x0, r0), (x1, r1) = points_m.tolist()
        return line(x0, r0, x1, r1)
    chord_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points_m, axis=0).T))])
    # Imported only here: few mandrels have a table, and the library takes long to load.
    from scipy.interpolate import CubicSpline

    curve = CubicSpline(chord_m, points_m, bc_type="natural")

    def drawn(p: FloatArray) -> tuple[FloatArray, FloatArray]:
        values = np.array([curve(p, k) for k in range(3)])
        return values[:, :, 0], values[:, :, 1]

    return stretch_of(drawn, chord_m)
