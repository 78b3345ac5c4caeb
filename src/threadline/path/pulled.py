"""Three ways to pull a uniform B-spline to its turning points: winding thesis, section 8.8."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from threadline.arrays import FloatArray
from threadline.path.bspline import MULTIPLICITY, ControlPoints, Refine, join, repeat

Pull = Literal["repeat", "points", "spacing"]

NEARBY = 1.0 / 8.0  # distance of added points from a turning point, as a share of the chord
CLOSE_KNOTS = 1.0 / 8.0  # knot intervals beside a turning point, in units of the others


def by_repetition(
    points: ControlPoints, turning: FloatArray, before: ControlPoints | None, turned: float
) -> ControlPoints:
    """Repeat each turning point three times: the curve meets it, and rests there (a ``Refine``)."""
    del before, turned
    return repeat(points, np.where((points.rest == 1) | (turning == 1), MULTIPLICITY, 1))


def by_points(
    points: ControlPoints, turning: FloatArray, before: ControlPoints | None, turned: float
) -> ControlPoints:
    """Add a point on either side of each turning point, at an eighth of its chord (a ``Refine``).

    The curve misses the turning point by |P0 - 2 P1 + P2| / 48, an eighth of the distance without
    the added points.
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
        # The time of a chord is divided among its points in proportion to their distances.
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
    """Shorten the knot intervals on either side of each turning point to an eighth (a ``Refine``).

    The curve misses the turning point by |P0 - 2 P1 + P2| e / (2 (1 + 2 e)) with e = 1/8, and
    its peak velocity is 3 / (1 + 2 e) of that with even knots.
    """
    del before
    leaves = np.concatenate([[turned], turning[:-1]]) == 1
    short = (turning == 1) | leaves
    spaced = replace(points, span=np.where(short, CLOSE_KNOTS, 1.0))
    return repeat(spaced, np.where(points.rest == 1, MULTIPLICITY, 1))


def _on_chords(begin: ControlPoints, end: ControlPoints, fraction: float) -> ControlPoints:
    """Return an added point at ``fraction`` of each chord; it belongs to the move along it."""
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
