"""Exact pieces of curves, made from points, bulges, centres and knots.

A few arrays hold all pieces of a drawing, because a million chords as objects would be slow. Affine
maps of pieces (for an inserted block or an SVG transform) are exact.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from math import comb, prod

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray, IntArray

MAX_DEGREE = 12


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pieces:
    """Consecutive pieces of curves, each with its parameter u in [0, 1].

    A piece with ``sweep_rad`` 0 is ``sum(top[k] u^k) / sum(bottom[k] u^k)``; any other piece is
    ``top[0] + top[1] cos(w) + top[2] sin(w)`` with ``w = begin_rad + u sweep_rad``: the affine
    image of a circular arc.

    Parameters
    ----------
    top
        (n, order, 2) coefficients, m.
    bottom
        (n, order) coefficients of the denominator; ``[1, 0, ...]`` unless the piece is rational.
    begin_rad, sweep_rad
        (n,) angle at the beginning, and signed sweep, rad; 0 for polynomial pieces.
    line
        (n,) int: line of the file, 0 if it is unknown.
    """

    top: FloatArray
    bottom: FloatArray
    begin_rad: FloatArray
    sweep_rad: FloatArray
    line: IntArray

    def __len__(self) -> int:
        return len(self.top)

    @property
    def is_line(self) -> NDArray[np.bool_]:
        """(n,) bool: whether a piece is straight, with length proportional to the parameter."""
        higher = (self.top[:, 2:] != 0).any(axis=(1, 2)) | (self.bottom[:, 1:] != 0).any(axis=1)
        return np.asarray(~higher & (self.sweep_rad == 0.0), dtype=np.bool_)

    @property
    def is_circle(self) -> NDArray[np.bool_]:
        """(n,) bool: whether a piece is an arc of a circle, within rounding."""
        a, b = self.top[:, 1], self.top[:, 2]
        size = (a**2).sum(axis=1) + (b**2).sum(axis=1)
        skew = np.abs((a * b).sum(axis=1)) + np.abs((a**2 - b**2).sum(axis=1))
        return np.asarray((self.sweep_rad != 0.0) & (skew <= 4e-15 * size), dtype=np.bool_)

    def evaluate(
        self, piece: IntArray, u: FloatArray, derivative: int = 0
    ) -> tuple[FloatArray, ...]:
        """Return positions and their derivatives with respect to u, up to ``derivative``.

        Parameters
        ----------
        piece, u
            (m,) indices of pieces, and parameters on them.
        derivative
            Highest order of the derivatives, at most 2.

        Returns
        -------
        tuple of FloatArray
            ``derivative + 1`` arrays (m, 2), m.
        """
        is_arc = self.sweep_rad[piece] != 0.0
        if not is_arc.any():
            return tuple(self._polynomial(piece, u, derivative))
        result = [np.empty((len(piece), 2)) for _ in range(derivative + 1)]
        for target, part in zip(result, self._arc(piece[is_arc], u[is_arc]), strict=False):
            target[is_arc] = part
        if not is_arc.all():
            is_polynomial = ~is_arc
            parts = self._polynomial(piece[is_polynomial], u[is_polynomial], derivative)
            for target, part in zip(result, parts, strict=True):
                target[is_polynomial] = part
        return tuple(result)

    def _arc(self, piece: IntArray, u: FloatArray) -> tuple[FloatArray, ...]:
        sweep = self.sweep_rad[piece][:, None]
        angle = self.begin_rad[piece][:, None] + u[:, None] * sweep
        centre, a, b = (self.top[piece, k] for k in range(3))
        cosine, sine = np.cos(angle), np.sin(angle)
        radial = a * cosine + b * sine
        return centre + radial, sweep * (b * cosine - a * sine), -(sweep**2) * radial

    def _polynomial(self, piece: IntArray, u: FloatArray, derivative: int) -> list[FloatArray]:
        top, bottom = self.top[piece], self.bottom[piece]
        w = u[:, None]
        p = [_horner(top, w, d) for d in range(derivative + 1)]
        if not (bottom[:, 1:] != 0).any():
            return p
        q = [_horner(bottom[:, :, None], w, d) for d in range(derivative + 1)]
        result = [p[0] / q[0]]
        if derivative >= 1:
            result.append((p[1] - result[0] * q[1]) / q[0])
        if derivative >= 2:
            result.append((p[2] - 2.0 * result[1] * q[1] - result[0] * q[2]) / q[0])
        return result

    def ends(self) -> tuple[FloatArray, FloatArray]:
        """Return the (n, 2) first and the (n, 2) last point of every piece."""
        index = np.arange(len(self))
        if self.is_line.all():
            return self.top[:, 0], self.top[:, 0] + self.top[:, 1]
        first = self.evaluate(index, np.zeros(len(self)))[0]
        return first, self.evaluate(index, np.ones(len(self)))[0]

    def end_directions(self) -> tuple[FloatArray, FloatArray]:
        """Return the (n, 2) unit tangents at the first and at the last point of every piece.

        If the derivative is 0 (a Bezier curve with two equal control points), the tangent is its
        limit, approximated at a point slightly inside the piece.
        """
        if self.is_line.all():
            tangent = self.top[:, 1] / np.maximum(np.hypot(*self.top[:, 1].T), 1e-300)[:, None]
            return tangent, tangent
        index = np.arange(len(self))
        directions = []
        for end, sign in ((0.0, 1.0), (1.0, -1.0)):
            u = np.full(len(self), end)
            point, tangent = self.evaluate(index, u, 1)
            norm = np.hypot(*tangent.T)
            inside = self.evaluate(index, u + sign * 1e-4)[0]
            step = sign * (inside - point)
            is_degenerate = norm * 1e-4 < 1e-3 * np.hypot(*step.T)
            tangent[is_degenerate], norm[is_degenerate] = (
                step[is_degenerate],
                np.hypot(*step[is_degenerate].T),
            )
            directions.append(tangent / np.maximum(norm, 1e-300)[:, None])
        return directions[0], directions[1]

    def take(self, index: IntArray) -> Pieces:
        """Return the pieces at ``index``, in that order."""
        return Pieces(
            top=self.top[index],
            bottom=self.bottom[index],
            begin_rad=self.begin_rad[index],
            sweep_rad=self.sweep_rad[index],
            line=self.line[index],
        )

    def transform(self, matrix: FloatArray, offset: FloatArray) -> Pieces:
        """Return the pieces mapped by ``matrix @ point + offset``, shapes (2, 2) and (2,)."""
        top = self.top @ np.asarray(matrix).T
        is_arc = self.sweep_rad != 0.0
        top[is_arc, 0] += offset
        top[~is_arc] += self.bottom[~is_arc][:, :, None] * offset
        return Pieces(
            top=top,
            bottom=self.bottom,
            begin_rad=self.begin_rad,
            sweep_rad=self.sweep_rad,
            line=self.line,
        )

    def reverse(self) -> Pieces:
        """Return the pieces in the opposite order and direction."""
        mirror = _mirror(self.top.shape[1])
        is_arc = self.sweep_rad != 0.0
        top = np.einsum("nkd,kj->njd", self.top, mirror)
        top[is_arc] = self.top[is_arc]
        return Pieces(
            top=top[::-1],
            bottom=np.where(is_arc[:, None], self.bottom, self.bottom @ mirror)[::-1],
            begin_rad=(self.begin_rad + self.sweep_rad)[::-1],
            sweep_rad=-self.sweep_rad[::-1],
            line=self.line[::-1],
        )


@cache
def _mirror(order: int) -> FloatArray:
    """Return the matrix that maps the coefficients of a polynomial p(u) to those of p(1 - u)."""
    mirror = np.zeros((order, order))
    for k in range(order):
        mirror[k, : k + 1] = polynomial.polypow([1.0, -1.0], k) if k else [1.0]
    return mirror


def _horner(coefficients: FloatArray, u: FloatArray, derivative: int) -> FloatArray:
    """Return the ``derivative``-th derivative at u, (m, 1), of (m, order, d) coefficients."""
    order = coefficients.shape[1]
    value = np.zeros((len(coefficients), coefficients.shape[2]))
    for k in range(order - 1, derivative - 1, -1):
        factor = float(prod(range(k - derivative + 1, k + 1)))
        value = value * u + factor * coefficients[:, k]
    return value


def join_pieces(parts: Sequence[Pieces]) -> Pieces:
    """Return the pieces of all ``parts`` in sequence."""
    if len(parts) == 1:
        return parts[0]
    order = max((part.top.shape[1] for part in parts), default=3)

    def widen(array: FloatArray) -> FloatArray:
        missing = order - array.shape[1]
        return (
            array
            if not missing
            else np.pad(array, [(0, 0), (0, missing)] + [(0, 0)] * (array.ndim - 2))
        )

    empty = np.empty((0, order, 2))
    return Pieces(
        top=np.concatenate([empty, *(widen(p.top) for p in parts)]),
        bottom=np.concatenate([empty[:, :, 0], *(widen(p.bottom) for p in parts)]),
        begin_rad=np.concatenate([np.empty(0), *(p.begin_rad for p in parts)]),
        sweep_rad=np.concatenate([np.empty(0), *(p.sweep_rad for p in parts)]),
        line=np.concatenate([np.empty(0, dtype=np.int64), *(p.line for p in parts)]),
    )


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
    """Return the chords between consecutive ``points``, (n + 1, 2) m.

    ``lines`` has the (n,) lines of the file, or one line for all chords.
    """
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
    """Return ``centre + a cos(w) + b sin(w)`` for w from ``begin_rad`` over ``sweep_rad``.

    ``centre``, ``a`` and ``b`` are (2,) m; for a circle a and b are perpendicular and of equal
    length.
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
        (n + 1, 2) points, m.
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
    """Return the Bezier curve with (degree + 1, 2) control points, m.

    With (degree + 1,) ``weights`` the curve is rational.

    Raises
    ------
    ValueError
        If the degree is above ``MAX_DEGREE``.
    """
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
        (n, 2) control points, m.
    knots
        (n + degree + 1,) knots, not decreasing.
    degree
        Degree of the spline, at most 12.
    weights
        (n,) weights above 0; all 1 by default.

    Raises
    ------
    ValueError
        If the number of knots, the degree, the order of the knots or a weight is wrong.

    Notes
    -----
    Knots are inserted until the multiplicity of each is ``degree`` (Boehm's algorithm, in
    homogeneous coordinates). The control points are then the control points of the Bezier curves.
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
    """Return control points and knots after inserting the knot ``value``."""
    span = int(np.searchsorted(knots, value, side="right")) - 1
    span = min(span, len(points) - 1)
    new_points = np.empty((len(points) + 1, points.shape[1]))
    new_points[: span - degree + 1] = points[: span - degree + 1]
    new_points[span + 1 :] = points[span:]
    for i in range(span - degree + 1, span + 1):
        width = knots[i + degree] - knots[i]
        share = (value - knots[i]) / width if width > 0.0 else 0.0
        new_points[i] = share * points[i] + (1.0 - share) * points[i - 1]
    return new_points, np.insert(knots, span + 1, value)
