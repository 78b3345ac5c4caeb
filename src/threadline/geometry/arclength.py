"""Arc length of curves: tables of lengths and their fast inverse, for millions of stitches."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.geometry.curves import Pieces

NODES, WEIGHTS = np.polynomial.legendre.leggauss(12)
_TOLERANCE_M = 1e-12
_MAX_ITERATIONS = 80

Curve = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
Spans = tuple[IntArray, FloatArray, FloatArray, FloatArray, np.ndarray]


def invert(curve: Curve, spans: Spans, span: IntArray, target_m: FloatArray) -> FloatArray:
    """Return the (m,) parameters of the points at the lengths ``target_m`` along the curve.

    Parameters
    ----------
    curve
        ``top``, ``bottom``, ``begin_rad`` and ``sweep_rad`` of the pieces.
    spans
        ``piece``, ``begin_u``, ``end_u``, ``begin_m`` and ``even`` of the table.
    span
        (m,) int: the span of each length.
    target_m
        (m,) lengths from the start of the curve.

    Notes
    -----
    Newton's method is used within a bracket, which is halved if a step would leave it. The length
    up to a parameter is computed by quadrature with 12 nodes from the beginning of the span; it is
    exact to rounding.
    """
    result: FloatArray = _invert(*curve, *spans, span, target_m)
    return result


@njit()
def _speed(top, bottom, begin, sweep, u):  # type: ignore[no-untyped-def]
    if sweep != 0.0:
        angle = begin + sweep * u
        c, s = math.cos(angle), math.sin(angle)
        x = top[2, 0] * c - top[1, 0] * s
        y = top[2, 1] * c - top[1, 1] * s
        return abs(sweep) * math.hypot(x, y)
    px = py = qx = qy = w = dw = 0.0
    for k in range(top.shape[0] - 1, -1, -1):  # Horner, values and derivatives together
        qx, qy, dw = qx * u + px, qy * u + py, dw * u + w
        px, py, w = px * u + top[k, 0], py * u + top[k, 1], w * u + bottom[k]
    return math.hypot((qx - px / w * dw) / w, (qy - py / w * dw) / w)


@njit()
def _invert(  # type: ignore[no-untyped-def]
    top, bottom, begin_rad, sweep_rad, piece, begin_u, end_u, begin_m, even, span, target_m
):
    result = np.empty(len(target_m))
    for i in range(len(target_m)):
        k = span[i]
        p = piece[k]
        low, high = begin_u[k], end_u[k]
        in_span_m, span_m = target_m[i] - begin_m[k], begin_m[k + 1] - begin_m[k]
        span_share = min(1.0, max(0.0, in_span_m / span_m)) if span_m > 0.0 else 0.0
        u = low + span_share * (high - low)
        if even[p]:
            result[i] = u
            continue
        start = low
        for _ in range(_MAX_ITERATIONS):
            half_u, middle_u = 0.5 * (u - start), 0.5 * (u + start)
            length = 0.0
            for n in range(len(NODES)):
                length += WEIGHTS[n] * _speed(
                    top[p], bottom[p], begin_rad[p], sweep_rad[p], middle_u + half_u * NODES[n]
                )
            error = half_u * length - in_span_m
            if error > 0.0:
                high = u
            else:
                low = u
            if abs(error) <= _TOLERANCE_M or high - low <= 0.0:
                break
            speed = _speed(top[p], bottom[p], begin_rad[p], sweep_rad[p], u)
            next_u = u - error / speed if speed > 0.0 else low - 1.0
            if not low <= next_u <= high:
                next_u = 0.5 * (low + high)
            if next_u == u:
                break
            u = next_u
        result[i] = u
    return result


TOLERANCE_M = 1e-12  # error per span of a table; a table of 1000 spans is accurate to 1e-9 m
_MAX_HALVINGS = 48
_CHUNK = 1 << 15


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ArcTable:
    """A table for finding the piece and parameter at a length along a curve.

    Parameters
    ----------
    pieces
        The curve.
    piece
        (n,) int: the piece of each span.
    begin_u, end_u
        (n,) parameter range of the span on its piece.
    begin_m
        (n + 1,) length from the start of the curve to each span; the last value is the total
        length.
    even
        (pieces,) whether length and parameter are proportional: chords and circular arcs.
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
        """Return (pieces + 1,) the length at which each piece begins, and the total length."""
        first = np.searchsorted(self.piece, np.arange(len(self.pieces)))
        return np.append(self.begin_m[first], self.begin_m[-1])

    def locate(self, length_m: FloatArray) -> tuple[IntArray, FloatArray]:
        """Return the (m,) pieces and (m,) parameters at (m,) lengths.

        The length at the returned parameter is exact to 1e-12 m, or to the rounding of the
        parameter. Lengths outside of the curve are clamped to its ends.
        """
        # For a few lengths np.clip takes three times as long as both of these calls.
        clipped_m = np.maximum(np.asarray(length_m, dtype=np.float64), 0.0)
        clipped_m = np.minimum(clipped_m, self.length_m)
        span_index = np.searchsorted(self.begin_m, clipped_m, side="right") - 1
        span_index = np.minimum(np.maximum(span_index, 0), len(self.piece) - 1)
        p = self.pieces
        u = invert(
            (p.top, p.bottom, p.begin_rad, p.sweep_rad),
            (self.piece, self.begin_u, self.end_u, self.begin_m, self.even),
            span_index,
            clipped_m,
        )
        return self.piece[span_index], u

    def points(self, length_m: FloatArray) -> FloatArray:
        """Return the (m, 2) points at ``length_m`` along the curve, m."""
        return self.pieces.evaluate(*self.locate(length_m))[0]

    def curvature(self, length_m: FloatArray) -> FloatArray:
        """Return the (m,) signed curvature at ``length_m``, 1/m; positive turns left."""
        _, first, second = self.pieces.evaluate(*self.locate(length_m), derivative=2)
        speed = np.hypot(*first.T)
        cross = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
        curvature = np.zeros_like(cross)
        np.divide(cross, speed**3, out=curvature, where=speed > 0.0)
        return curvature


def span_lengths(
    pieces: Pieces, piece: IntArray, begin_u: FloatArray, end_u: FloatArray
) -> FloatArray:
    """Return the (m,) lengths of pieces from ``begin_u`` to ``end_u``, by one quadrature each."""
    half_u = 0.5 * (end_u - begin_u)
    node_u = (0.5 * (begin_u + end_u))[:, None] + half_u[:, None] * NODES
    node_piece = np.repeat(piece, len(NODES))
    tangent = pieces.evaluate(node_piece, node_u.ravel(), 1)[1]
    speed = np.hypot(*tangent.T).reshape(node_u.shape)
    return np.asarray(half_u * (speed @ WEIGHTS))


def arc_table(pieces: Pieces) -> ArcTable:
    """Return the table of lengths of the curve that ``pieces`` form in their order.

    Notes
    -----
    Lengths are computed by Gauss-Legendre quadrature with 12 nodes, on a span and on its two
    halves; a span is halved until both agree within 1e-12 m (or rounding). Lengths of chords and
    circles are exact.
    """
    columns: list[tuple[IntArray, FloatArray, FloatArray, FloatArray]] = []
    even = pieces.is_line | pieces.is_circle
    even_pieces, curved_pieces = np.flatnonzero(even), np.flatnonzero(~even)
    even_length_m = np.hypot(*pieces.top[even_pieces, 1].T)
    even_length_m *= np.where(
        pieces.sweep_rad[even_pieces] == 0.0, 1.0, np.abs(pieces.sweep_rad[even_pieces])
    )
    columns.append(
        (even_pieces, np.zeros(len(even_pieces)), np.ones(len(even_pieces)), even_length_m)
    )
    for start in range(0, len(curved_pieces), _CHUNK // 8):
        index = curved_pieces[start : start + _CHUNK // 8]
        columns.extend(_refine(pieces, index))
    piece, begin, end, length = (np.concatenate(column) for column in zip(*columns, strict=True))
    order = np.lexsort((begin, piece))
    total = np.cumsum(length[order].astype(np.longdouble)).astype(np.float64)
    if not pieces.top.flags.c_contiguous:  # for instance for a reversed curve
        # numba would compile another version of ``invert`` for another memory layout.
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
    pieces: Pieces, piece: IntArray
) -> list[tuple[IntArray, FloatArray, FloatArray, FloatArray]]:
    begin, end = np.zeros(len(piece)), np.ones(len(piece))
    length = span_lengths(pieces, piece, begin, end)
    accepted = []
    for depth in range(_MAX_HALVINGS + 1):
        middle_u = 0.5 * (begin + end)
        first = span_lengths(pieces, piece, begin, middle_u)
        second = span_lengths(pieces, piece, middle_u, end)
        error = np.abs(first + second - length)
        accurate = error <= np.maximum(TOLERANCE_M, 1e-15 * length)
        if depth == _MAX_HALVINGS:
            accurate[:] = True  # the span is shorter than 1e-14 of its piece: a cusp
        accepted.append(
            (piece[accurate], begin[accurate], end[accurate], (first + second)[accurate])
        )
        if accurate.all():
            break
        inaccurate = ~accurate
        piece = np.tile(piece[inaccurate], 2)
        length = np.concatenate([first[inaccurate], second[inaccurate]])
        begin, end = (
            np.concatenate([begin[inaccurate], middle_u[inaccurate]]),
            np.concatenate([middle_u[inaccurate], end[inaccurate]]),
        )
    return accepted
