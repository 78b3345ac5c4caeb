"""Control polygon -> cubic pieces of the B-spline whose knots are spaced as its points are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from threadline.arrays import FloatArray
from threadline.path.polygon import Controls
from threadline.path.types import PieceBlock

BoolArray: TypeAlias = NDArray[np.bool_]


def pieces_of(
    controls: Controls, first: int, stop: int, *, ends: bool, dwell_s: float
) -> PieceBlock:
    """Return the pieces between control points ``first`` and ``stop``.

    Parameters
    ----------
    controls
        With at least two points more on either side, unless the run begins at the first or ends
        at the last.
    dwell_s
        Pause at the end of the run.

    Notes
    -----
    Boehm's construction: leg k, from point k to k + 1 of length h[k], carries the two inner
    Bezier points of its span at the fractions h[k-1] / H and (h[k-1] + h[k]) / H,
    H = h[k-1] + h[k] + h[k+1]; the joint at point k divides the last of leg k - 1 and the first
    of leg k as h[k-1] : h[k]. A leg between two points where the polygon does not turn is a
    line, and the spline beside it ends in their common point like a run: mirrored, so that it
    leaves straight, without curvature and evenly, however long the line is.
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
    nominal = 3.0 * np.maximum(np.maximum(t0, t1), t2)[:, 0]
    straight = line[first:stop]
    coefficients[straight, 1] = leg[first:stop][straight]
    coefficients[straight, 2:] = 0.0
    nominal[straight] = controls.nominal_s[first + 1 : stop + 1][straight]
    operation = controls.operation[first + 1 : stop + 1]
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
        line=controls.line[first + 1 : stop + 1][kept],
    )


@dataclass(frozen=True, slots=True)
class _Knots:
    """(n,) of each leg: its span, those before and after it, and where its spline begins and ends.

    ``lead`` and ``trail`` are the parts of a leg before its first and behind its second inner
    Bezier point.
    """

    h: FloatArray
    before: FloatArray
    after: FloatArray
    opens: BoolArray
    closes: BoolArray
    lead: FloatArray
    trail: FloatArray


def _knots(h: FloatArray, line: BoolArray) -> _Knots:
    """Return the knot spans, which are the lengths of the legs; beside a line their mirror."""
    opens = np.concatenate([[True], line[:-1]]) | line
    closes = np.concatenate([line[1:], [True]]) | line
    before = np.where(opens, h, np.concatenate([h[:1], h[:-1]]))
    after = np.where(closes, h, np.concatenate([h[1:], h[-1:]]))
    total = before + h + after
    return _Knots(h, before, after, opens, closes, before / total, after / total)


def _differences(leg: FloatArray, knots: _Knots) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the three (n, axes) differences of the Bezier points of every span.

    ``leg`` may be any quantity that adds up along the polygon: with nominal times for vectors
    the differences bound the time at the feed.
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
