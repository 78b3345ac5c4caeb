"""Pulling a uniform B-spline to its turning points, the three ways of the thesis (section 8.8)."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from threadline.arrays import FloatArray
from threadline.path.bspline import MULTIPLICITY, ControlPoints, Refine, join, repeat

Pull = Literal["repeat", "points", "spacing"]

NEARBY = 1.0 / 8.0  # of the chord: where the points near a turning point stand
CLOSE_KNOTS = 1.0 / 8.0  # of the others: the knot intervals on either side of a turning point


def by_repetition(
    points: ControlPoints, turning: FloatArray, before: ControlPoints | None, turned: float
) -> ControlPoints:
    """Triple the turning points: the curve meets them, at rest."""
    del before, turned
    return repeat(points, np.where((points.rest == 1) | (turning == 1), MULTIPLICITY, 1))


def by_points(
    points: ControlPoints, turning: FloatArray, before: ControlPoints | None, turned: float
) -> ControlPoints:
    """Add a point on either side of each turning point, at an eighth of the chords there.

    The curve misses the turning point by an eighth of what it would: |P0 - 2 P1 + P2| / 48.
    """
    chain = points if before is None else join([before, points])
    turns = turning if before is None else np.concatenate([[turned], turning])
    parts = [] if before is not None else [chain.take(slice(0, 1))]
    if len(chain) > 1:
        begin, end = chain.take(slice(0, -1)), chain.take(slice(1, None))
        near = _on_chords(begin, end, NEARBY)
        far = _on_chords(begin, end, 1.0 - NEARBY)
        rows, wanted = [], []
        for k in range(3):
            rows.append(3 * np.arange(len(end)) + k)
            wanted.append((turns[:-1] == 1, turns[1:] == 1, np.ones(len(end), dtype=bool))[k])
        order = np.argsort(np.concatenate(rows), kind="stable")
        kept = order[np.concatenate(wanted)[order]]
        fresh = join([near, far, end]).take(kept)
        # Each point takes the share of its chord's time that lies between it and the one before.
        share = np.concatenate(
            [np.full(len(end), NEARBY), np.full(len(end), 1.0 - NEARBY), np.ones(len(end))]
        )[kept]
        chord = np.concatenate([np.arange(len(end))] * 3)[kept]
        opens = np.diff(chord, prepend=-1) > 0
        passed = share - np.where(opens, 0.0, np.roll(share, 1))
        parts.append(replace(fresh, chord_s=passed * end.chord_s[chord]))
    out = join(parts)
    return repeat(out, np.where(out.rest == 1, MULTIPLICITY, 1))


def by_spacing(
    points: ControlPoints, turning: FloatArray, before: ControlPoints | None, turned: float
) -> ControlPoints:
    """Shorten the knot intervals on either side of each turning point to an eighth.

    The curve misses the turning point by |P0 - 2 P1 + P2| e / (2 (1 + 2 e)) with e = 1/8, and
    its peak velocity is 3 / (1 + 2 e) of that with even knots.
    """
    del before
    leaves = np.concatenate([[turned], turning[:-1]]) == 1
    short = (turning == 1) | leaves
    spaced = replace(points, span=np.where(short, CLOSE_KNOTS, 1.0))
    return repeat(spaced, np.where(points.rest == 1, MULTIPLICITY, 1))


def _on_chords(begin: ControlPoints, end: ControlPoints, fraction: float) -> ControlPoints:
    """Return a point of each chord that is no vertex; it belongs to the move along the chord."""
    return replace(
        end,
        positions=begin.positions + fraction * (end.positions - begin.positions),
        rest=np.zeros(len(end), dtype=np.int64),
        dwell_s=np.zeros(len(end)),
    )


PULLS: dict[Pull, Refine] = {
    "repeat": by_repetition,
    "points": by_points,
    "spacing": by_spacing,
}
