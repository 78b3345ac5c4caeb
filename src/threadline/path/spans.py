"""The cubic pieces of a B-spline whose knots are spaced as its control points are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from threadline.arrays import FloatArray, IntArray
from threadline.path.polygon import Controls
from threadline.path.types import PieceBlock

BoolArray: TypeAlias = NDArray[np.bool_]
_EVEN = 0.02
"""A piece is divided where its time per unit of u, by the feed, varies by more than this share."""
_MOST_PARTS = 16


def pieces_of(
    controls: Controls, first: int, stop: int, *, ends: bool, dwell_s: float
) -> PieceBlock:
    """Return the pieces between control points ``first`` and ``stop``.

    Parameters
    ----------
    controls
        Control points, with at least two before ``first`` and two after ``stop`` unless the run
        begins at the first or ends at the last.
    ends, dwell_s
        Whether the run ends at ``stop``, and the pause there.

    Notes
    -----
    Boehm's construction: leg k, from point k to k + 1 of length h[k], carries the two inner
    Bezier points of its span at the fractions h[k-1] / H and (h[k-1] + h[k]) / H,
    H = h[k-1] + h[k] + h[k+1]; the joint at point k divides the last of leg k - 1 and the first
    of leg k as h[k-1] : h[k]. A leg between two points where the polygon does not turn is a line.
    The spline beside a line ends in their common point as at the end of a run: its polygon is
    mirrored there, so that it leaves straight, without curvature and evenly, whatever the length
    of the line.
    """
    line = (controls.turn[:-1] == 0.0) & (controls.turn[1:] == 0.0)
    leg = np.diff(controls.positions, axis=0)
    knots = _knots(controls.length_m[1:], line)
    d0, d1, d2 = _differences(leg, knots)
    t0, t1, t2 = _differences(controls.nominal_s[1:, None], knots)
    joints = controls.positions.copy()
    inner = np.flatnonzero(~(knots.opens[1:] | knots.closes[:-1]))
    joints[inner + 1] += (knots.lead[:, None] * leg - d0)[inner + 1]
    d0, d1, d2, t0, t1, t2 = (part[first:stop] for part in (d0, d1, d2, t0, t1, t2))
    coefficients = np.stack(
        [joints[first:stop], 3.0 * d0, 3.0 * (d1 - d0), d0 - 2.0 * d1 + d2], axis=1
    )
    straight = line[first:stop]
    coefficients[straight, 1] = leg[first:stop][straight]
    coefficients[straight, 2:] = 0.0
    owner, coefficients, nominal = _evenly_timed(coefficients, t0, t1, t2, straight)
    straight = straight[owner]
    passed = controls.nominal_s[first + 1 : stop + 1][owner]
    nominal[straight] = passed[straight]
    operation = controls.operation[first + 1 : stop + 1][owner]
    job_line = controls.line[first + 1 : stop + 1][owner]
    # Straight spans of one move are one piece.
    same = straight[1:] & straight[:-1] & (operation[1:] == operation[:-1])
    kept = np.flatnonzero(np.concatenate([[True], ~same]))
    merged = coefficients[kept]
    merged[:, 1] = np.add.reduceat(coefficients[:, 1], kept, axis=0)
    rest = np.zeros(len(kept), dtype=np.int64)
    pause = np.zeros(len(kept))
    if ends:
        rest[-1], pause[-1] = 1, dwell_s
    return PieceBlock(
        coefficients=merged,
        operation=operation[kept],
        nominal_s=np.add.reduceat(nominal, kept),
        rest_after=rest,
        dwell_s=pause,
        line=job_line[kept],
    )


def _evenly_timed(
    coefficients: FloatArray, t0: FloatArray, t1: FloatArray, t2: FloatArray, straight: BoolArray
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Divide curved pieces along which the programmed speed changes.

    The time at the feed is a spline over the same knots as the path, with the Bezier differences
    ``t0, t1, t2`` (m, 1) on each of m pieces. A piece has a single nominal time. At the slowest of
    its three differences it would take up to half as long again as programmed, and the needle of a
    stitcher would wait for the head.

    Returns
    -------
    owner, coefficients, nominal_s
        (k,) piece that each part belongs to, and the (k, 4, axes) coefficients and (k,) times of
        the parts.
    """
    pace = 3.0 * np.concatenate([t0, t1, t2], axis=1)
    mean = np.maximum(pace.mean(axis=1), np.finfo(np.float64).tiny)
    uneven = (pace.max(axis=1) - pace.min(axis=1)) / mean
    parts = np.clip(np.ceil(uneven / _EVEN), 1, _MOST_PARTS).astype(np.int64)
    parts[straight] = 1
    owner = np.repeat(np.arange(len(parts)), parts)
    share = 1.0 / parts[owner]
    begin = share * (np.arange(len(owner)) - np.repeat(np.cumsum(parts) - parts, parts))
    c = coefficients[owner]
    u, h = begin[:, None], share[:, None]
    cut = np.stack(
        [
            c[:, 0] + u * (c[:, 1] + u * (c[:, 2] + u * c[:, 3])),
            h * (c[:, 1] + u * (2.0 * c[:, 2] + 3.0 * u * c[:, 3])),
            h**2 * (c[:, 2] + 3.0 * u * c[:, 3]),
            h**3 * c[:, 3],
        ],
        axis=1,
    )
    whole = parts[owner] == 1
    cut[whole] = c[whole]
    a, b, d = pace[owner].T
    end = begin + share
    # The largest Bezier value of the part's time per u, so that no place is above its feed.
    first = a * (1.0 - begin) ** 2 + 2.0 * b * begin * (1.0 - begin) + d * begin**2
    last = a * (1.0 - end) ** 2 + 2.0 * b * end * (1.0 - end) + d * end**2
    middle = a * (1.0 - begin) * (1.0 - end) + d * begin * end
    middle += b * (begin * (1.0 - end) + end * (1.0 - begin))
    return owner, cut, share * np.maximum(np.maximum(first, middle), last)


@dataclass(frozen=True, slots=True)
class _Knots:
    """Knot spans of n legs: ``h`` of each, and those of the legs ``before`` and ``after`` it.

    ``opens`` and ``closes`` tell whether the spline begins or ends with the leg; ``lead`` and
    ``trail`` are the shares of the leg before its first and after its second inner Bezier point.
    """

    h: FloatArray
    before: FloatArray
    after: FloatArray
    opens: BoolArray
    closes: BoolArray
    lead: FloatArray
    trail: FloatArray


def _knots(h: FloatArray, line: BoolArray) -> _Knots:
    """Return the knot spans: the (n,) lengths of the legs, mirrored at lines and at run ends."""
    opens = np.concatenate([[True], line[:-1]]) | line
    closes = np.concatenate([line[1:], [True]]) | line
    before = np.where(opens, h, np.concatenate([h[:1], h[:-1]]))
    after = np.where(closes, h, np.concatenate([h[1:], h[-1:]]))
    total = before + h + after
    return _Knots(h, before, after, opens, closes, before / total, after / total)


def _differences(leg: FloatArray, knots: _Knots) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the three (n, axes) differences of the Bezier points of every span.

    ``leg`` (n, axes) holds differences along the polygon: of positions, or of the time at the feed,
    whose Bezier differences bound the time that a span needs.
    """
    lead, trail = knots.lead[:, None] * leg, knots.trail[:, None] * leg
    around = np.zeros((len(leg) + 1, leg.shape[1]))
    around[:-1] += lead
    around[1:] += trail
    d0 = around[:-1] * (knots.h / (knots.before + knots.h))[:, None]
    d2 = around[1:] * (knots.h / (knots.h + knots.after))[:, None]
    d0 = np.where(knots.opens[:, None], lead, d0)
    d2 = np.where(knots.closes[:, None], trail, d2)
    return d0, leg - lead - trail, d2
