"""The compiled inverse of the length along a curve, for millions of stitches."""

from __future__ import annotations

import math

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.compiled import njit

NODES, WEIGHTS = np.polynomial.legendre.leggauss(12)
_TOLERANCE_M = 1e-12
_MAX_ITERATIONS = 80

Curve = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
Spans = tuple[IntArray, FloatArray, FloatArray, FloatArray, np.ndarray]


def invert(curve: Curve, spans: Spans, span: IntArray, wanted_m: FloatArray) -> FloatArray:
    """Return the (m,) parameters at which the curve has the lengths ``wanted_m``.

    Parameters
    ----------
    curve
        ``top``, ``bottom``, ``begin_rad`` and ``sweep_rad`` of the pieces.
    spans
        ``piece``, ``begin_u``, ``end_u``, ``begin_m`` and ``even`` of the table.
    span
        (m,) int: the span that each length lies in.
    wanted_m
        (m,) lengths from the start of the curve.

    Notes
    -----
    The method is Newton's, inside a bracket that is halved where a step would leave it. The length
    up to a parameter is one quadrature of 12 nodes from the beginning of the span, which is exact
    to rounding.
    """
    result: FloatArray = _invert(*curve, *spans, span, wanted_m)
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
    top, bottom, begin_rad, sweep_rad, piece, begin_u, end_u, begin_m, even, span, wanted
):
    result = np.empty(len(wanted))
    for i in range(len(wanted)):
        k = span[i]
        p = piece[k]
        low, high = begin_u[k], end_u[k]
        rest, whole = wanted[i] - begin_m[k], begin_m[k + 1] - begin_m[k]
        share = min(1.0, max(0.0, rest / whole)) if whole > 0.0 else 0.0
        u = low + share * (high - low)
        if even[p]:
            result[i] = u
            continue
        start = low
        for _ in range(_MAX_ITERATIONS):
            half, middle = 0.5 * (u - start), 0.5 * (u + start)
            length = 0.0
            for n in range(len(NODES)):
                length += WEIGHTS[n] * _speed(
                    top[p], bottom[p], begin_rad[p], sweep_rad[p], middle + half * NODES[n]
                )
            error = half * length - rest
            if error > 0.0:
                high = u
            else:
                low = u
            if abs(error) <= _TOLERANCE_M or high - low <= 0.0:
                break
            speed = _speed(top[p], bottom[p], begin_rad[p], sweep_rad[p], u)
            fresh = u - error / speed if speed > 0.0 else low - 1.0
            if not low <= fresh <= high:
                fresh = 0.5 * (low + high)
            if fresh == u:
                break
            u = fresh
        result[i] = u
    return result
