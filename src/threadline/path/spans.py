"""Control polygon -> cubic pieces of the B-spline whose knots are spaced as its points are."""

from __future__ import annotations

import numpy as np

from threadline.arrays import FloatArray
from threadline.path.polygon import Controls
from threadline.path.types import PieceBlock


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
    h = controls.length_m[1:]
    d0, d1, d2 = _differences(np.diff(controls.positions, axis=0), h, begins, ends)
    t0, t1, t2 = _differences(controls.nominal_s[1:, None], h, begins, ends)
    lead = (np.concatenate([h[:1], h[:-1]]) / _reach(h))[:, None] * np.diff(
        controls.positions, axis=0
    )
    joints = (controls.positions[:-1] + (lead - d0))[first:stop]
    if begins:
        joints[0] = controls.positions[0]
    d0, d1, d2, t0, t1, t2 = (part[first:stop] for part in (d0, d1, d2, t0, t1, t2))
    coefficients = np.stack([joints, 3.0 * d0, 3.0 * (d1 - d0), d0 - 2.0 * d1 + d2], axis=1)
    nominal = 3.0 * np.maximum(np.maximum(t0, t1), t2)[:, 0]
    straight = (controls.turn[first:stop] == 0.0) & (controls.turn[first + 1 : stop + 1] == 0.0)
    chord = d0 + d1 + d2
    coefficients[straight, 1] = chord[straight]
    coefficients[straight, 2:] = 0.0
    nominal = np.where(straight, (t0 + t1 + t2)[:, 0], nominal)
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


def _reach(h: FloatArray) -> FloatArray:
    return np.asarray(np.concatenate([h[:1], h[:-1]]) + h + np.concatenate([h[1:], h[-1:]]))


def _differences(
    leg: FloatArray, h: FloatArray, begins: bool, ends: bool
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the three (n, axes) differences of the Bezier points of every span.

    ``leg`` may be any quantity that adds up along the polygon: with nominal times for vectors
    the differences bound the time at the feed.
    """
    before = np.concatenate([h[:1], h[:-1]])
    after = np.concatenate([h[1:], h[-1:]])
    total = before + h + after
    lead = (before / total)[:, None] * leg
    trail = (after / total)[:, None] * leg
    around = np.zeros((len(leg) + 1, leg.shape[1]))
    around[:-1] += lead
    around[1:] += trail
    d0 = around[:-1] * (h / (before + h))[:, None]
    d2 = around[1:] * (h / (h + after))[:, None]
    if begins:
        d0[0] *= 2.0  # the mirror image of the leg
    if ends:
        d2[-1] *= 2.0
    return d0, (h / total)[:, None] * leg, d2
