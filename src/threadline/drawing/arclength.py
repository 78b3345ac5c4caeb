"""Length along a curve: adaptive Gauss-Legendre tables and their inverse."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from threadline.arrays import FloatArray, IntArray
from threadline.drawing.arclength_inverse import NODES, WEIGHTS, invert
from threadline.drawing.curves import Pieces

TOLERANCE_M = 1e-12  # per span of a table; a table of 1000 spans is good to 1e-9 m
_MAX_HALVINGS = 48
_CHUNK = 1 << 15


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ArcTable:
    """A table that gives the piece and parameter at each length along a curve.

    Parameters
    ----------
    pieces
        The curve.
    piece
        (n,) int: the piece that each span belongs to.
    begin_u, end_u
        (n,) the part of the piece that the span covers.
    begin_m
        (n + 1,) length from the start of the curve to each span; the last is the whole length.
    even
        (pieces,) whether a piece is a chord or an arc of a circle, on which length and parameter
        are proportional.
    """

    pieces: Pieces
    piece: IntArray
    begin_u: FloatArray
    end_u: FloatArray
    begin_m: FloatArray
    even: NDArray[np.bool_]

    @property
    def length_m(self) -> float:
        """Length of the whole curve."""
        return float(self.begin_m[-1])

    def piece_begins_m(self) -> FloatArray:
        """Return (pieces + 1,) the length at which each piece begins, and the whole length."""
        first = np.searchsorted(self.piece, np.arange(len(self.pieces)))
        return np.append(self.begin_m[first], self.begin_m[-1])

    def locate(self, length_m: FloatArray) -> tuple[IntArray, FloatArray]:
        """Return the (m,) pieces and the (m,) parameters on them at (m,) lengths.

        The length at the parameter is exact to 1e-12 m or to the rounding of the parameter. Lengths
        outside the curve are clamped.
        """
        # Of a few lengths np.clip takes three times as long as both its halves.
        wanted = np.maximum(np.asarray(length_m, dtype=np.float64), 0.0)
        wanted = np.minimum(wanted, self.length_m)
        span = np.searchsorted(self.begin_m, wanted, side="right") - 1
        span = np.minimum(np.maximum(span, 0), len(self.piece) - 1)
        p = self.pieces
        u = invert(
            (p.top, p.bottom, p.begin_rad, p.sweep_rad),
            (self.piece, self.begin_u, self.end_u, self.begin_m, self.even),
            span,
            wanted,
        )
        return self.piece[span], u

    def points(self, length_m: FloatArray) -> FloatArray:
        """Return the (m, 2) points at ``length_m`` along the curve, m."""
        return self.pieces.evaluate(*self.locate(length_m))[0]

    def curvature(self, length_m: FloatArray) -> FloatArray:
        """Return the (m,) signed curvature at ``length_m``, 1/m; positive turns left."""
        _, first, second = self.pieces.evaluate(*self.locate(length_m), derivative=2)
        speed = np.hypot(*first.T)
        cross = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
        bend = np.zeros_like(cross)
        np.divide(cross, speed**3, out=bend, where=speed > 0.0)
        return bend


def span_lengths(
    pieces: Pieces, piece: IntArray, begin_u: FloatArray, end_u: FloatArray
) -> FloatArray:
    """Return the (m,) lengths of the pieces from ``begin_u`` to ``end_u`` by one quadrature."""
    half = 0.5 * (end_u - begin_u)
    nodes = (0.5 * (begin_u + end_u))[:, None] + half[:, None] * NODES
    flat = np.repeat(piece, len(NODES))
    tangent = pieces.evaluate(flat, nodes.ravel(), 1)[1]
    speed = np.hypot(*tangent.T).reshape(nodes.shape)
    return np.asarray(half * (speed @ WEIGHTS))


def arc_table(pieces: Pieces) -> ArcTable:
    """Return the table of lengths of ``pieces``, which in their order are one curve.

    Notes
    -----
    Lengths are by Gauss-Legendre quadrature with 12 nodes, on a span and on its two halves; a span
    is halved until both agree within 1e-12 m (or rounding). Those of chords and circles are exact.
    """
    found: list[tuple[IntArray, FloatArray, FloatArray, FloatArray]] = []
    even = pieces.is_line | pieces.is_circle
    flat, curved = np.flatnonzero(even), np.flatnonzero(~even)
    straight = np.hypot(*pieces.top[flat, 1].T)
    straight *= np.where(pieces.sweep_rad[flat] == 0.0, 1.0, np.abs(pieces.sweep_rad[flat]))
    found.append((flat, np.zeros(len(flat)), np.ones(len(flat)), straight))
    for start in range(0, len(curved), _CHUNK // 8):
        index = curved[start : start + _CHUNK // 8]
        found.extend(_refine(pieces, index))
    piece, begin, end, length = (np.concatenate(column) for column in zip(*found, strict=True))
    order = np.lexsort((begin, piece))
    total = np.cumsum(length[order].astype(np.longdouble)).astype(np.float64)
    if not pieces.top.flags.c_contiguous:  # as of a curve turned round
        # Parts of other arrays would have machine code of their own.
        pieces = pieces.take(np.arange(len(pieces)))
    return ArcTable(
        pieces=pieces,
        piece=piece[order],
        begin_u=begin[order],
        end_u=end[order],
        begin_m=np.concatenate([[0.0], total]),
        even=even,
    )


def _refine(
    pieces: Pieces, index: IntArray
) -> list[tuple[IntArray, FloatArray, FloatArray, FloatArray]]:
    begin, end = np.zeros(len(index)), np.ones(len(index))
    length = span_lengths(pieces, index, begin, end)
    done = []
    for depth in range(_MAX_HALVINGS + 1):
        middle = 0.5 * (begin + end)
        first = span_lengths(pieces, index, begin, middle)
        second = span_lengths(pieces, index, middle, end)
        error = np.abs(first + second - length)
        good = error <= np.maximum(TOLERANCE_M, 1e-15 * length)
        if depth == _MAX_HALVINGS:
            good[:] = True  # the span is shorter than 1e-14 of its piece: a cusp
        done.append((index[good], begin[good], end[good], (first + second)[good]))
        if good.all():
            break
        bad = ~good
        index = np.tile(index[bad], 2)
        length = np.concatenate([first[bad], second[bad]])
        begin, end = (
            np.concatenate([begin[bad], middle[bad]]),
            np.concatenate([middle[bad], end[bad]]),
        )
    return done
