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
    controls: Controls, first: int, stop: int, *, begins: bool, ends: bool, dwell_s: float
) -> PieceBlock:
    """Return the pieces between control points ``first`` and ``stop``.

    Parameters
    ----------
    controls
        With at least two points more on either side, unless the run ``begins`` at the first or
        ``ends`` at the last; there the polygon goes on as its own mirror image, so that the
        spline starts in the point, straight and without curvature.
    dwell_s
        Pause at the end of the run.

    Notes
    -----
    Boehm's construction: leg k, from point k to k + 1 of length h[k], carries the two inner
    Bezier points of its span at the fractions h[k-1] / H and (h[k-1] + h[k]) / H,
    H = h[k-1] + h[k] + h[k+1]; the joint at point k divides the last of leg k - 1 and the first
    of leg k as h[k-1] : h[k].
    """
    even = (controls.turn[:-1] == 0.0) & (controls.turn[1:] == 0.0)
    knots = _knots(controls.length_m[1:], even)
    leg = np.diff(controls.positions, axis=0)
    d0, d1, d2 = _differences(leg, knots, begins, ends)
    t0, t1, t2 = _differences(controls.nominal_s[1:, None], knots, begins, ends)
    joints = controls.positions.copy()
    bent = np.flatnonzero(~(even[1:] & even[:-1])) + 1  # a vertex amid a straight line is met
    joints[bent] += (knots.lead[:, None] * leg - d0)[bent]
    d0, d1, d2, t0, t1, t2 = (part[first:stop] for part in (d0, d1, d2, t0, t1, t2))
    coefficients = np.stack(
        [joints[first:stop], 3.0 * d0, 3.0 * (d1 - d0), d0 - 2.0 * d1 + d2], axis=1
    )
    nominal = 3.0 * np.maximum(np.maximum(t0, t1), t2)[:, 0]
    straight = even[first:stop]
    chord = np.diff(joints[first : stop + 1], axis=0)[straight]
    coefficients[straight, 1] = chord
    coefficients[straight, 2:] = 0.0
    along = leg[first:stop][straight]
    share = (chord * along).sum(axis=1) / (along**2).sum(axis=1)
    nominal[straight] = share * controls.nominal_s[first + 1 : stop + 1][straight]
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
    """(n,) knot spans of each leg as its left and its right neighbour see it, and of these.

    ``lead`` and ``trail`` are the parts of a leg before its first and behind its second inner
    Bezier point.
    """

    left: FloatArray
    right: FloatArray
    before: FloatArray
    after: FloatArray
    lead: FloatArray
    trail: FloatArray


def _knots(h: FloatArray, even: BoolArray) -> _Knots:
    """Return the spans of the knots: the lengths of the legs, but for ``even`` legs.

    The span of an even leg is straight, whatever its knots, so that the splines on either side
    of it may each have their own: to its neighbour the leg counts as long as the neighbour
    itself, which keeps the parameter even up to where the curve ends.
    """
    left = np.where(even, np.concatenate([h[:1], h[:-1]]), h)
    right = np.where(even, np.concatenate([h[1:], h[-1:]]), h)
    before = np.concatenate([left[:1], right[:-1]])
    after = np.concatenate([left[1:], right[-1:]])
    total = before + h + after
    lead = np.where(even, left / h * before / (before + 2.0 * left), before / total)
    trail = np.where(even, right / h * after / (after + 2.0 * right), after / total)
    return _Knots(left, right, before, after, lead, trail)


def _differences(
    leg: FloatArray, knots: _Knots, begins: bool, ends: bool
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the three (n, axes) differences of the Bezier points of every span.

    ``leg`` may be any quantity that adds up along the polygon: with nominal times for vectors
    the differences bound the time at the feed.
    """
    lead, trail = knots.lead[:, None] * leg, knots.trail[:, None] * leg
    around = np.zeros((len(leg) + 1, leg.shape[1]))
    around[:-1] += lead
    around[1:] += trail
    d0 = around[:-1] * (knots.left / (knots.before + knots.left))[:, None]
    d2 = around[1:] * (knots.right / (knots.right + knots.after))[:, None]
    if begins:
        d0[0] *= 2.0  # the mirror image of the leg
    if ends:
        d2[-1] *= 2.0
    return d0, leg - lead - trail, d2
