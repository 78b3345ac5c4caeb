"""The thickness of a layer along the meridian, and the surface that it makes.

A circuit passes every parallel twice with a band of cross-section A, so a layer of n circuits has
the thickness ``t = 2 n A / (2 pi r cos(a))``, which is ``t_cyl R cos(a_R) / (r cos(a))``. At the
turn this formula has no limit. There one band holds a tenth of a dome's fibre, so over the last two
band widths a cubic in the radius replaces the formula. The cubic continues value and slope, is
level at the edge of the opening, and keeps the volume of the fibre.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.jobs.winding.circuit import Circuit, Site, Turn
from threadline.winding.shapes import table
from threadline.winding.surface import Surface, surface_of

_GRID = 2049
_CUBIC_BANDS = 2.0  # band widths before the turn in which the thickness is a cubic
_MERIDIAN_POINTS = 513  # points of a grown meridian
_MOST_SHARE = 0.9  # largest share of the way from the joint to the turn for the cubic
_DRAWN_OUT = 3.0
_STEEPEST = 0.003  # cosine of the steepest angle of a grown meridian
_EDGE_M = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Thickness:
    """Thickness of a layer along the meridian.

    Parameters
    ----------
    u
        (n,) places along the meridian, m, increasing.
    t
        (n,) thickness, m; 0 where nothing lies.
    """

    u: FloatArray
    t: FloatArray

    def at(self, u: FloatArray) -> FloatArray:
        """Return (n,) thicknesses, m."""
        return np.asarray(np.interp(u, self.u, self.t, left=0.0, right=0.0))

    def volume_m3(self, surface: Surface) -> float:
        """Return the volume between a surface and the layer on it, to first order in t."""
        return _integral(surface, self.u, self.t)


def _integral(surface: Surface, u: FloatArray, t: FloatArray) -> float:
    """Return the integral of t over the surface between the ends of ``u``."""
    x, r = surface.at(u)
    rim = 2.0 * math.pi * r[:, 0] * np.hypot(x[:, 1], r[:, 1]) * t
    return float((0.5 * (rim[1:] + rim[:-1]) * np.diff(u)).sum())


def thickness(
    circuit: Circuit, sites: tuple[Site, Site], width_m: float, fibre_m2: float
) -> Thickness:
    """Return the thickness of a layer.

    Parameters
    ----------
    circuit
        A circuit of the layer.
    sites
        Sites of its turns.
    width_m
        Width of the band.
    fibre_m2
        Cross-section of all bands on a parallel: twice the circuits times width and thickness of
        the band, m^2.
    """
    surface = circuit.surface
    parts = [_thickness_at_turn(surface, sites[0], circuit.left, width_m, fibre_m2)]
    middle = np.linspace(sites[0].joint, sites[1].joint, _GRID)[1:-1]
    angle = np.interp(middle, circuit.middle[:, 1], circuit.middle[:, 3])
    radius = surface.at(middle)[1][:, 0]
    parts.append((middle, fibre_m2 / (2.0 * math.pi * radius * np.cos(angle))))
    parts.append(_thickness_at_turn(surface, sites[1], circuit.right, width_m, fibre_m2))
    u = np.concatenate([part[0] for part in parts])
    t = np.concatenate([part[1] for part in parts])
    keep = np.concatenate([[True], np.diff(u) > 1e-12])
    return Thickness(u[keep], t[keep])


def hoops(
    surface: Surface, ends: tuple[float, float], width_m: float, fibre_m3: float
) -> Thickness:
    """Return the thickness, everywhere the same, of hoops between the u of two turns.

    Parameters
    ----------
    fibre_m3
        Volume of all bands.
    """
    low, high = max(ends[0] - 0.5 * width_m, 0.0), min(ends[1] + 0.5 * width_m, surface.length_m)
    u = np.linspace(low, high, _GRID)
    return Thickness(u, np.full(len(u), fibre_m3 / _integral(surface, u, np.ones(len(u)))))


def _thickness_at_turn(
    surface: Surface, site: Site, turn: Turn, width_m: float, fibre_m2: float
) -> tuple[FloatArray, FloatArray]:
    """Return places, increasing, and thicknesses from the edge at a turn to the joint."""
    rows = turn.rows
    turn_u = float(rows[-1, 1])
    inside = np.linspace(site.joint, turn_u, _GRID)
    radius = surface.at(inside)[1][:, 0]
    along_m = np.abs(inside - site.joint)
    # Band widths are counted in radius on a dome, and along the meridian on a cylinder.
    by_radius = abs(radius[0] - radius[-1]) > 2.0 * _CUBIC_BANDS * width_m
    inside_measure = radius[0] - radius if by_radius else along_m
    total = float(inside_measure[-1])
    begin = max(total - _CUBIC_BANDS * width_m, (1.0 - _MOST_SHARE) * total)
    end_u = surface.length_m if site.side > 0 else 0.0
    edge = _edge(surface, turn_u, end_u, 0.5 * width_m, by_radius=by_radius)
    beyond = np.linspace(turn_u, edge, 129)[1:] if edge != turn_u else np.empty(0)
    u = np.concatenate([inside, beyond])
    r = np.concatenate([radius, surface.at(beyond)[1][:, 0]]) if len(beyond) else radius
    measure_of_u = (radius[0] - r) if by_radius else np.abs(u - site.joint)
    order = np.argsort(rows[:, 1])
    angle = np.interp(u, rows[order, 1], rows[order, 3])
    with np.errstate(divide="ignore", over="ignore"):
        t = fibre_m2 / (2.0 * math.pi * r * np.maximum(np.cos(angle), 1e-9))
    in_zone = measure_of_u >= begin
    zone_begin = int(np.argmax(in_zone))
    if zone_begin < 2 or in_zone.sum() < 4:
        return (u, t) if site.side > 0 else (u[::-1], t[::-1])
    # Volume of the fibre in the zone: cross-section of all passes times the length to the turn.
    start = float(u[zone_begin])
    passed_m = float(np.interp(start * site.side, site.side * rows[:, 1], rows[:, 0]))
    volume = fibre_m2 * (turn.length_m - passed_m)
    slope = float(
        (t[zone_begin] - t[zone_begin - 1])
        / (measure_of_u[zone_begin] - measure_of_u[zone_begin - 1])
    )
    edge_measure = float(measure_of_u[-1])
    q = (edge_measure - measure_of_u[zone_begin:]) / (
        edge_measure - measure_of_u[zone_begin]
    )  # 0 at the edge, 1 where the zone begins
    rise = -slope * (edge_measure - measure_of_u[zone_begin])
    # a + c q^2 + d q^3: level at the edge; value and slope at 1.
    ends_u = u[zone_begin:] if site.side > 0 else u[zone_begin:][::-1]

    def volume_of(values: FloatArray) -> float:
        return _integral(surface, ends_u, values if site.side > 0 else values[::-1])

    basis = [volume_of(q**k) for k in (0, 2, 3)]
    system = np.array([[1.0, 1.0, 1.0], [0.0, 2.0, 3.0], basis])
    a, c, d = np.linalg.solve(system, np.array([float(t[zone_begin]), rise, volume]))
    t = t.copy()
    t[zone_begin:] = a + c * q**2 + d * q**3
    return (u, t) if site.side > 0 else (u[::-1], t[::-1])


def _edge(
    surface: Surface, turn_u: float, end_u: float, half_m: float, *, by_radius: bool
) -> float:
    """Return u half a band beyond a turn, or the end of the mandrel."""
    if not by_radius:
        return min(turn_u + half_m, end_u) if end_u > turn_u else max(turn_u - half_m, end_u)
    u = np.linspace(turn_u, end_u, 513)
    r = surface.at(u)[1][:, 0]
    beyond = np.flatnonzero(r <= r[0] - half_m)
    return float(u[beyond[0]]) if len(beyond) else end_u


def grown(surface: Surface, by: Thickness) -> Surface:
    """Return the surface with a layer on it: every point moves along its normal.

    Beyond the edges of the layer the step down is drawn out over three times its height. Where the
    meridian would double back there, the surface ends.

    Parameters
    ----------
    by
        Thickness of the layer.
    """
    edges = float(by.u[0]), float(by.u[-1])
    u = np.linspace(0.0, surface.length_m, _MERIDIAN_POINTS)
    edge_distance = np.abs(u[:, None] - np.array(edges)).min(axis=1)
    u = np.sort(np.concatenate([u[edge_distance > 0.3 * (u[1] - u[0])], edges]))
    x, r = surface.at(u)
    speed = np.hypot(x[:, 1], r[:, 1])
    beyond_m = np.maximum(np.maximum(edges[0] - u, u - edges[1]), 0.0)
    edge_t = np.where(u < edges[0], by.t[0], by.t[-1])
    t = np.where(beyond_m > 0.0, np.maximum(edge_t - beyond_m / _DRAWN_OUT, 0.0), by.at(u))
    points = np.column_stack([x[:, 0] - t * r[:, 1] / speed, r[:, 0] + t * x[:, 1] / speed])
    forward = np.diff(points[:, 0]) > _STEEPEST * np.hypot(*np.diff(points, axis=0).T)
    middle = len(u) // 2
    not_forward_left = np.flatnonzero(~forward[:middle])
    not_forward_right = np.flatnonzero(~forward[middle:])
    low = int(not_forward_left[-1]) + 1 if len(not_forward_left) else 0
    high_at = middle + int(not_forward_right[0]) + 1 if len(not_forward_right) else len(u)
    return surface_of(table(points[low:high_at]), _EDGE_M)
