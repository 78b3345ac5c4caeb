"""Exact pieces of curves: lines, Bezier and spline spans, circular and elliptic arcs.

All pieces of a drawing are kept in a few arrays, so that a million chords need no million objects.
Every affine map of them (an inserted block, an SVG transform) is exact, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from math import prod

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import NDArray

from threadline.arrays import FloatArray, IntArray

MAX_DEGREE = 12


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pieces:
    """Consecutive pieces of curves, each with its parameter u in [0, 1].

    A piece with ``sweep_rad`` 0 is ``sum(top[k] u^k) / sum(bottom[k] u^k)``; another one is
    ``top[0] + top[1] cos(w) + top[2] sin(w)`` with ``w = begin_rad + u sweep_rad``: the affine
    image of a circular arc.

    Parameters
    ----------
    top
        (n, order, 2) m.
    bottom
        (n, order) weights; ``[1, 0, ...]`` unless the piece is rational.
    begin_rad, sweep_rad
        (n,) rad.
    line
        (n,) int: line of the file, 0 where it is unknown.
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
        """(n,) bool: straight and of even speed, so that length and parameter are proportional."""
        higher = (self.top[:, 2:] != 0).any(axis=(1, 2)) | (self.bottom[:, 1:] != 0).any(axis=1)
        return np.asarray(~higher & (self.sweep_rad == 0.0), dtype=np.bool_)

    @property
    def is_circle(self) -> NDArray[np.bool_]:
        """(n,) bool: an arc of a circle, to rounding."""
        a, b = self.top[:, 1], self.top[:, 2]
        size = (a**2).sum(axis=1) + (b**2).sum(axis=1)
        skew = np.abs((a * b).sum(axis=1)) + np.abs((a**2 - b**2).sum(axis=1))
        return np.asarray((self.sweep_rad != 0.0) & (skew <= 4e-15 * size), dtype=np.bool_)

    def evaluate(
        self, piece: IntArray, u: FloatArray, derivative: int = 0
    ) -> tuple[FloatArray, ...]:
        """Return positions and their derivatives by u up to ``derivative`` (at most 2).

        Parameters
        ----------
        piece, u
            (m,) which piece, and where on it.

        Returns
        -------
        tuple of FloatArray
            ``derivative + 1`` arrays (m, 2), m.
        """
        trig = self.sweep_rad[piece] != 0.0
        if not trig.any():
            return tuple(self._polynomial(piece, u, derivative))
        result = [np.empty((len(piece), 2)) for _ in range(derivative + 1)]
        for out, part in zip(result, self._arc(piece[trig], u[trig]), strict=False):
            out[trig] = part
        if not trig.all():
            plain = ~trig
            parts = self._polynomial(piece[plain], u[plain], derivative)
            for out, part in zip(result, parts, strict=True):
                out[plain] = part
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

        Where the derivative vanishes (a Bezier curve with two control points in one place) the
        tangent is the limit, taken from a step inside.
        """
        if self.is_line.all():
            tangent = self.top[:, 1] / np.maximum(np.hypot(*self.top[:, 1].T), 1e-300)[:, None]
            return tangent, tangent
        index = np.arange(len(self))
        found = []
        for end, sign in ((0.0, 1.0), (1.0, -1.0)):
            u = np.full(len(self), end)
            here, tangent = self.evaluate(index, u, 1)
            size = np.hypot(*tangent.T)
            inside = self.evaluate(index, u + sign * 1e-4)[0]
            step = sign * (inside - here)
            weak = size * 1e-4 < 1e-3 * np.hypot(*step.T)
            tangent[weak], size[weak] = step[weak], np.hypot(*step[weak].T)
            found.append(tangent / np.maximum(size, 1e-300)[:, None])
        return found[0], found[1]

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
        arc = self.sweep_rad != 0.0
        top[arc, 0] += offset
        top[~arc] += self.bottom[~arc][:, :, None] * offset
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
        arc = self.sweep_rad != 0.0
        top = np.einsum("nkd,kj->njd", self.top, mirror)
        top[arc] = self.top[arc]
        return Pieces(
            top=top[::-1],
            bottom=np.where(arc[:, None], self.bottom, self.bottom @ mirror)[::-1],
            begin_rad=(self.begin_rad + self.sweep_rad)[::-1],
            sweep_rad=-self.sweep_rad[::-1],
            line=self.line[::-1],
        )


@cache
def _mirror(order: int) -> FloatArray:
    """Return the matrix of the coefficients of p(1 - u): sum over k of top[k] (1 - u)^k."""
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
    """Return the pieces of all ``parts``, one after the other."""
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
