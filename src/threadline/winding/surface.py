"""The surface of a mandrel: a smooth meridian, turned about the axis, as tables for compiled code.

A meridian goes from left to right, as places ``x`` along the axis and radii ``r``. It is a chain of
short pieces. Each piece is a polynomial of fifth order in ``u`` for ``x`` and one for ``r``; at
both ends of the piece they agree with the drawn meridian in place, tangent and curvature. ``u`` is
approximately the length along the meridian.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.base.compiled import njit
from threadline.errors import JobError

Drawn = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""Function from (n,) parameters to x and r with their first two derivatives: two (3, n) arrays."""

_JOINED_M = 1e-6  # two pieces of a meridian meet within this
_CORNER = math.radians(0.5)  # a smaller turn between two pieces is no corner
_STEEPEST = math.radians(89.9)  # a meridian that goes more steeply doubles back
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)


@dataclass(frozen=True, slots=True, eq=False)
class Stretch:
    """Nodes along a smooth stretch of a meridian.

    Parameters
    ----------
    u
        (n,) length along the stretch from its left end, m.
    x, r
        (n, 3) place and radius, m, with their first and second derivatives by the length.
    """

    u: FloatArray
    x: FloatArray
    r: FloatArray

    @property
    def angle(self) -> FloatArray:
        """(n,) angle of the meridian with the axis, rad."""
        return np.arctan2(self.r[:, 1], self.x[:, 1])


def stretch_of(drawn: Drawn, parameters: FloatArray) -> Stretch:
    """Return the nodes of a drawn stretch at increasing ``parameters``, (n,)."""
    low, high = parameters[:-1, None], parameters[1:, None]
    nodes = low + (high - low) * (0.5 + 0.5 * _NODES)
    x, r = drawn(nodes.ravel())
    speed = np.hypot(x[1], r[1]).reshape(nodes.shape)
    lengths = ((high - low)[:, 0] * 0.5) * (speed @ _WEIGHTS)
    x, r = drawn(parameters)
    speed = np.hypot(x[1], r[1])
    curvature = (x[1] * r[2] - r[1] * x[2]) / speed**3
    cos, sin = x[1] / speed, r[1] / speed
    return Stretch(
        u=np.concatenate([[0.0], np.cumsum(lengths)]),
        x=np.column_stack([x[0], cos, -sin * curvature]),
        r=np.column_stack([r[0], sin, cos * curvature]),
    )


def line(x0: float, r0: float, x1: float, r1: float) -> Stretch:
    """Return a straight stretch between two points, m."""
    length = math.hypot(x1 - x0, r1 - r0)
    cos, sin = (x1 - x0) / length, (r1 - r0) / length
    return Stretch(
        u=np.array([0.0, length]),
        x=np.array([[x0, cos, 0.0], [x1, cos, 0.0]]),
        r=np.array([[r0, sin, 0.0], [r1, sin, 0.0]]),
    )


def _trimmed(part: Stretch, begin: float, end: float) -> Stretch:
    """Return the stretch without the lengths ``begin`` and ``end`` at its ends."""
    if begin <= 0.0 and end <= 0.0:
        return part
    low, high = begin, part.u[-1] - end
    inner_u = part.u[(part.u > low) & (part.u < high)]
    u = np.concatenate([[low], inner_u, [high]])
    x, r = _tables([part])[1:]
    tables = [_evaluated(value, part.u, u) for value in (x, r)]
    return Stretch(u=u - low, x=tables[0], r=tables[1])


def _evaluated(coefficients: FloatArray, nodes: FloatArray, u: FloatArray) -> FloatArray:
    piece = np.clip(np.searchsorted(nodes, u, side="right") - 1, 0, len(nodes) - 2)
    offset = u - nodes[piece]
    rows = [coefficients[piece]]
    for _ in range(2):
        rows.append(rows[-1][:, 1:] * np.arange(1, rows[-1].shape[1]))
    return np.column_stack(
        [(row * offset[:, None] ** np.arange(row.shape[1])).sum(1) for row in rows]
    )


def _tables(parts: Sequence[Stretch]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return (n + 1,) nodes and (n, 6) coefficients of x and r of a chain of stretches."""
    nodes, rows = [np.zeros(1)], ([], [])  # type: tuple[list[FloatArray], tuple[list[FloatArray], list[FloatArray]]]
    for part in parts:
        nodes.append(nodes[-1][-1] + part.u[1:])
        h = np.diff(part.u)[:, None]
        for values, coefficients in ((part.x, rows[0]), (part.r, rows[1])):
            before, after = values[:-1], values[1:]
            y0, d0, c0 = (before[:, k, None] * h**k for k in range(3))
            y1, d1, c1 = (after[:, k, None] * h**k for k in range(3))
            difference = y1 - y0
            scaled = np.hstack(
                [
                    y0,
                    d0,
                    0.5 * c0,
                    10.0 * difference - 6.0 * d0 - 4.0 * d1 - 1.5 * c0 + 0.5 * c1,
                    -15.0 * difference + 8.0 * d0 + 7.0 * d1 + 1.5 * c0 - c1,
                    6.0 * difference - 3.0 * (d0 + d1) - 0.5 * (c0 - c1),
                ]
            )
            coefficients.append(scaled / h ** np.arange(6))
    return np.concatenate(nodes), np.vstack(rows[0]), np.vstack(rows[1])


def _blend(before: Stretch, after: Stretch) -> Stretch:
    """Return a short stretch that joins two others smoothly, in place of a corner."""
    x = np.vstack([before.x[-1], after.x[0]])
    r = np.vstack([before.r[-1], after.r[0]])
    length = math.hypot(x[1, 0] - x[0, 0], r[1, 0] - r[0, 0])
    turn = float(after.angle[0] - before.angle[-1])
    # An arc of this turn is longer than its chord.
    length *= 0.5 * turn / math.sin(0.5 * turn)
    curvature = turn / length
    for values, other_values, sign in ((x, r, -1.0), (r, x, 1.0)):
        values[:, 2] = sign * other_values[:, 1] * curvature
    return Stretch(u=np.array([0.0, length]), x=x, r=r)


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """A surface of revolution.

    Parameters
    ----------
    nodes
        (n + 1,) ``u`` at the ends of the pieces, m; the first is 0.
    x, r
        (n, 6) coefficients of the place and of the radius by ``u`` minus the piece's first ``u``.
    convex
        Whether no straight line touches it in two places.
    """

    nodes: FloatArray
    x: FloatArray
    r: FloatArray
    convex: bool

    @property
    def length_m(self) -> float:
        """Length of the meridian, m."""
        return float(self.nodes[-1])

    @property
    def least_radius_m(self) -> float:
        """Smallest radius, at the ends of the pieces, m."""
        return float(self.at(self.nodes)[1][:, 0].min())

    def at(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return (n, 3) places and radii, m, with their first two derivatives by ``u``."""
        return _evaluated(self.x, self.nodes, u), _evaluated(self.r, self.nodes, u)

    def points_at(self, u: FloatArray) -> FloatArray:
        """Return (n, 2) places along the axis and radii, m: as ``at``, without derivatives."""
        piece = np.clip(np.searchsorted(self.nodes, u, side="right") - 1, 0, len(self.x) - 1)
        powers = (u - self.nodes[piece])[:, None] ** np.arange(self.x.shape[1])
        return np.column_stack([(table[piece] * powers).sum(1) for table in (self.x, self.r)])

    def grown(self, by_m: float) -> Surface:
        """Return the surface with its radius larger by a length, m."""
        r = self.r.copy()
        r[:, 0] += by_m
        return Surface(self.nodes, self.x, r, self.convex)

    def place_of(self, along_m: FloatArray) -> FloatArray:
        """Return (n,) ``u`` of places along the axis, m; the ends for places beyond them."""
        grid = np.unique(np.concatenate([np.linspace(0.0, self.length_m, 4097), self.nodes]))
        x = self.at(grid)[0][:, 0]
        return np.asarray(np.interp(along_m, x, grid), dtype=np.float64)


def surface_of(parts: Sequence[Stretch], edge_m: float, file: str = "") -> Surface:
    """Return the surface of a chain of stretches, with corners rounded.

    Parameters
    ----------
    parts
        The stretches from left to right; each begins where the one before it ends.
    edge_m
        Radius of the rounding of corners, m.
    file
        Name of the file, for messages.

    Raises
    ------
    JobError
        If the meridian is open, doubles back or reaches the axis.
    """
    name = f"{file}: " if file else ""
    for before, after in itertools.pairwise(parts):
        gap = math.hypot(after.x[0, 0] - before.x[-1, 0], after.r[0, 0] - before.r[-1, 0])
        if gap > _JOINED_M:
            raise JobError(
                f"{name}the mandrel is open: a part ends at x = {1e3 * before.x[-1, 0]:.6g} mm "
                f"with radius {1e3 * before.r[-1, 0]:.6g} mm, and the next begins at x = "
                f"{1e3 * after.x[0, 0]:.6g} mm with radius {1e3 * after.r[0, 0]:.6g} mm",
                remedy="Let each part begin where the one before it ends.",
            )
    chain = _with_rounded_corners(parts, edge_m)
    nodes, x, r = _tables(chain)
    surface = Surface(nodes, x, r, convex=True)
    u = np.unique(np.concatenate([np.linspace(0.0, nodes[-1], 4097), nodes]))
    along, radius = surface.at(u)
    angle = np.abs(np.arctan2(radius[:, 1], along[:, 1]))
    if (angle > _STEEPEST).any():
        worst = int(np.argmax(angle > _STEEPEST))
        raise JobError(
            f"{name}the mandrel doubles back at x = {1e3 * along[worst, 0]:.6g} mm, radius "
            f"{1e3 * radius[worst, 0]:.6g} mm",
            remedy="Its meridian must go from left to right; end it at the polar opening.",
        )
    if (radius[:, 0] <= 0.0).any():
        worst = int(np.argmax(radius[:, 0] <= 0.0))
        raise JobError(
            f"{name}the mandrel crosses its axis at x = {1e3 * along[worst, 0]:.6g} mm",
            remedy="End it at a polar opening with a radius above 0.",
        )
    second_order = along[:, 1] * radius[:, 2] - radius[:, 1] * along[:, 2]
    scale = radius[:, 0].max()
    return Surface(nodes, x, r, convex=bool((second_order * scale < 1e-6).all()))


def _with_rounded_corners(parts: Sequence[Stretch], edge_m: float) -> list[Stretch]:
    turns = [
        float(after.angle[0] - before.angle[-1]) for before, after in itertools.pairwise(parts)
    ]
    cut_m = [0.0] * (len(parts) + 1)
    for index, turn in enumerate(turns, start=1):
        if abs(turn) > _CORNER:
            shorter = min(parts[index - 1].u[-1], parts[index].u[-1])
            cut_m[index] = min(edge_m * math.tan(0.5 * abs(turn)), 0.4 * float(shorter))
    chain: list[Stretch] = []
    for index, part in enumerate(parts):
        trimmed = _trimmed(part, cut_m[index], cut_m[index + 1])
        if index and cut_m[index]:
            chain.append(_blend(chain[-1], trimmed))
        chain.append(trimmed)
    return chain


@njit(nogil=True)
def meridian(
    nodes: FloatArray, x: FloatArray, r: FloatArray, u: float, hint: int
) -> tuple[int, float, float, float, float, float, float]:
    """Return the piece at ``u``, x, r, cosine and sine of its angle, its bend and its speed.

    The bend is the curvature of the meridian towards the axis, 1/m; the speed is the length along
    the meridian per ``u``, nearly 1. ``hint`` is a piece nearby.
    """
    last = len(x) - 1
    while hint > 0 and u < nodes[hint]:
        hint -= 1
    while hint < last and u >= nodes[hint + 1]:
        hint += 1
    h = u - nodes[hint]
    a, b = x[hint], r[hint]
    px = ((((a[5] * h + a[4]) * h + a[3]) * h + a[2]) * h + a[1]) * h + a[0]
    pr = ((((b[5] * h + b[4]) * h + b[3]) * h + b[2]) * h + b[1]) * h + b[0]
    dx = (((5.0 * a[5] * h + 4.0 * a[4]) * h + 3.0 * a[3]) * h + 2.0 * a[2]) * h + a[1]
    dr = (((5.0 * b[5] * h + 4.0 * b[4]) * h + 3.0 * b[3]) * h + 2.0 * b[2]) * h + b[1]
    ddx = ((20.0 * a[5] * h + 12.0 * a[4]) * h + 6.0 * a[3]) * h + 2.0 * a[2]
    ddr = ((20.0 * b[5] * h + 12.0 * b[4]) * h + 6.0 * b[3]) * h + 2.0 * b[2]
    speed = math.sqrt(dx * dx + dr * dr)
    bend = -(dx * ddr - dr * ddx) / (speed * speed * speed)
    return hint, px, pr, dx / speed, dr / speed, bend, speed
