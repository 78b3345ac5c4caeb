"""The pieces of a B-spline of third or fourth degree with knots at the points of a polygon."""
# mypy: disable-error-code="no-untyped-def,untyped-decorator"

from __future__ import annotations

import numpy as np

from threadline.compiled import njit
from threadline.path.greville import quartic_spans
from threadline.path.polygon import CUBIC, Controls
from threadline.path.types import PieceBlock

_EVEN = 0.02
"""A piece is divided where its time per unit of u, by the feed, varies by more than this share."""
_MOST_PARTS = 16
_TINY = float(np.finfo(np.float64).tiny)


def pieces_of(
    controls: Controls,
    first: int,
    stop: int,
    *,
    ends: bool,
    dwell_s: float,
    degree: int = CUBIC,
) -> PieceBlock:
    """Return the pieces between points ``first`` and ``stop``.

    Parameters
    ----------
    controls
        Points, with at least two before ``first`` and two after ``stop``, three for a quartic,
        unless the run begins at the first or ends at the last.
    ends, dwell_s
        Whether the run ends at ``stop``, and the pause there.
    degree
        3, with the points as control points, or 4, with control points between them.
    """
    columns = controls.positions, controls.turn, controls.length_m, controls.nominal_s
    if degree == CUBIC:
        coefficients, pace, straight = _spans(*columns, first, stop)
    else:
        coefficients, pace, straight = quartic_spans(*columns, first, stop)
    own = slice(first + 1, stop + 1)
    operation, line = controls.operation[own], controls.line[own]
    parts = _parts(pace, straight)
    count = _count(parts, straight, operation)
    nominal_s = _nominal(pace, straight, controls.nominal_s[own])
    if count < len(parts) or parts.max() > 1:
        coefficients, nominal_s, operation, line = _cut_and_joined(
            coefficients, pace, nominal_s, straight, parts, operation, line, count
        )
    rest = np.zeros(count, dtype=np.int64)
    pause = np.zeros(count)
    if ends:
        rest[-1], pause[-1] = 1, dwell_s
    for fresh in (coefficients, nominal_s, rest, pause):
        fresh.flags.writeable = False  # so the block need not copy what nobody else holds
    return PieceBlock(
        coefficients=coefficients,
        operation=operation,
        nominal_s=nominal_s,
        rest_after=rest,
        dwell_s=pause,
        line=line,
    )


@njit()
def _spans(positions, turn, length_m, nominal_s, first, stop):
    """Return the pieces between two control points, their paces, and which of them are straight.

    Returns
    -------
    coefficients, pace, straight
        (m, 4, axes); (m, 3) Bezier values of the time at the feed per unit of u, s; (m,).

    Notes
    -----
    Boehm's construction: leg k, from point k to k + 1 of length h[k], carries the two inner
    Bezier points of its span at the fractions h[k-1] / H and (h[k-1] + h[k]) / H,
    H = h[k-1] + h[k] + h[k+1]; the joint at point k divides the last of leg k - 1 and the first
    of leg k as h[k-1] : h[k]. A leg between two points where the polygon does not turn is a line.
    The spline beside a line ends in their common point as at the end of a run: its polygon is
    mirrored there, so that it leaves straight, without curvature and evenly, whatever the length
    of the line. The time at the feed is a spline over the same knots as the path.
    """
    legs, axes = len(positions) - 1, positions.shape[1]
    line = np.empty(legs, dtype=np.bool_)
    for k in range(legs):
        line[k] = turn[k] == 0.0 and turn[k + 1] == 0.0
    # Shares of each leg before its first and after its second inner Bezier point.
    lead, trail = np.empty(legs), np.empty(legs)
    opens, closes = np.empty(legs, dtype=np.bool_), np.empty(legs, dtype=np.bool_)
    for k in range(legs):
        opens[k] = k == 0 or line[k - 1] or line[k]
        closes[k] = k == legs - 1 or line[k + 1] or line[k]
        h = length_m[k + 1]
        before = h if opens[k] else length_m[k]
        after = h if closes[k] else length_m[k + 2]
        total = before + h + after
        lead[k], trail[k] = before / total, after / total
    coefficients = np.empty((stop - first, 4, axes))
    pace = np.empty((stop - first, 3))
    for k in range(first, stop):
        i = k - first
        h = length_m[k + 1]
        here = 0.0 if opens[k] else h / (length_m[k] + h)
        there = 0.0 if closes[k] else h / (h + length_m[k + 2])
        for j in range(axes):
            leg = positions[k + 1, j] - positions[k, j]
            d0, d2 = lead[k] * leg, trail[k] * leg
            d1 = leg - d0 - d2
            joint = positions[k, j]
            if not opens[k]:
                start = d0
                d0 = (trail[k - 1] * (positions[k, j] - positions[k - 1, j]) + start) * here
                joint += start - d0
            if not closes[k]:
                d2 = (lead[k + 1] * (positions[k + 2, j] - positions[k + 1, j]) + d2) * there
            coefficients[i, 0, j] = joint
            if line[k]:
                coefficients[i, 1, j], coefficients[i, 2, j], coefficients[i, 3, j] = leg, 0.0, 0.0
            else:
                coefficients[i, 1, j] = 3.0 * d0
                coefficients[i, 2, j] = 3.0 * (d1 - d0)
                coefficients[i, 3, j] = d0 - 2.0 * d1 + d2
        d0, d2 = lead[k] * nominal_s[k + 1], trail[k] * nominal_s[k + 1]
        pace[i, 1] = 3.0 * (nominal_s[k + 1] - d0 - d2)
        if not opens[k]:
            d0 = (trail[k - 1] * nominal_s[k] + d0) * here
        if not closes[k]:
            d2 = (lead[k + 1] * nominal_s[k + 2] + d2) * there
        pace[i, 0], pace[i, 2] = 3.0 * d0, 3.0 * d2
    return coefficients, pace, line[first:stop]


@njit()
def _parts(pace, straight):
    """Return into how many parts each of m pieces is divided so that its pace is even in each.

    A piece has a single nominal time. At the slowest of its paces (m, degree) it would take up to
    half as long again as programmed, and the needle of a stitcher would wait for the head.
    """
    out = np.ones(len(pace), dtype=np.int64)
    for i in range(len(pace)):
        total, least, most = 0.0, np.inf, -np.inf
        for k in range(pace.shape[1]):  # of a row, sum() and max() would make an array each
            total += pace[i, k]
            least, most = min(least, pace[i, k]), max(most, pace[i, k])
        uneven = (most - least) / max(total / pace.shape[1], _TINY)
        if not straight[i] and uneven > _EVEN:
            out[i] = min(int(np.ceil(uneven / _EVEN)), _MOST_PARTS)
    return out


@njit()
def _count(parts, straight, operation):
    """Return the number of pieces: parts, and straight spans of one move as one of them."""
    count = 0
    for i in range(len(parts)):
        count += parts[i]
        if i > 0 and straight[i] and straight[i - 1] and operation[i] == operation[i - 1]:
            count -= 1
    return count


@njit()
def _nominal(pace, straight, passed_s):
    """Return the (m,) times of whole pieces: at the slowest pace of those that are curved."""
    out = np.empty(len(pace))
    for i in range(len(pace)):
        most = -np.inf
        for k in range(pace.shape[1]):
            most = max(most, pace[i, k])
        out[i] = passed_s[i] if straight[i] else most
    return out


@njit()
def _cut_and_joined(coefficients, pace, nominal_s, straight, parts, operation, line, count):
    """Return ``count`` pieces: m cut into ``parts`` each, straight spans of one move joined.

    Returns
    -------
    coefficients, nominal_s, operation, line
        (count, degree + 1, axes) and (count,) of the pieces.
    """
    order, axes = coefficients.shape[1:]
    out = np.empty((count, order, axes))
    time_s = np.empty(count)
    own, row = np.empty(count, dtype=np.int64), np.empty(count, dtype=np.int64)
    part_s = np.empty(order - 1)
    n = 0
    for i in range(len(parts)):
        same = i > 0 and straight[i] and straight[i - 1] and operation[i] == operation[i - 1]
        if same:
            for j in range(axes):
                out[n - 1, 1, j] += coefficients[i, 1, j]
            time_s[n - 1] += nominal_s[i]
            continue
        own[n : n + parts[i]], row[n : n + parts[i]] = operation[i], line[i]
        if parts[i] == 1:
            for power in range(order):  # an assignment of the whole takes seconds to compile
                for j in range(axes):
                    out[n, power, j] = coefficients[i, power, j]
            time_s[n] = nominal_s[i]
            n += 1
            continue
        h = 1.0 / parts[i]
        for part in range(parts[i]):
            u = h * part
            for j in range(axes):
                for power in range(order):
                    out[n, power, j] = coefficients[i, power, j]
                # Horner's scheme in both directions is the shift of a polynomial.
                for low in range(order - 1):
                    for power in range(order - 2, low - 1, -1):
                        out[n, power, j] += u * out[n, power + 1, j]
                width = 1.0
                for power in range(1, order):
                    width *= h
                    out[n, power, j] *= width
            # The largest Bezier value of the part's time per u, so that no place is above its feed.
            most = 0.0
            for later in range(order - 1):
                for k in range(order - 1):
                    part_s[k] = pace[i, k]
                for level in range(order - 2):
                    at = u + h if level < later else u
                    for k in range(order - 2 - level):
                        part_s[k] += at * (part_s[k + 1] - part_s[k])
                most = max(most, part_s[0])
            time_s[n] = h * most
            n += 1
    return out, time_s, own, row
