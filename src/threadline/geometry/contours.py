"""Contours: arc segments, contours that are written in seam files, and joining of strokes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.wording import nearest
from threadline.errors import JobError, Place
from threadline.geometry.arclength import ArcTable
from threadline.geometry.curves import Pieces, bulges, ellipse_arc, join_pieces
from threadline.geometry.strokes import Stroke


@dataclass(frozen=True, slots=True, eq=False)
class DrawnLine:
    """A contour of a drawing.

    Parameters
    ----------
    table
        The curve.
    closed
        Whether it ends where it begins; lengths are then taken modulo its length.
    """

    table: ArcTable
    closed: bool

    def points(self, at_m: FloatArray) -> FloatArray:
        """Return the (n, 2) points at lengths along the line, m."""
        return self.table.points(np.mod(at_m, self.table.length_m) if self.closed else at_m)


RADIUS_SLACK_M = 1e-6
TURNS = ("ccw", "cw")


def bulge_segment(begin: FloatArray, end: FloatArray, bulge: float, line: int) -> Pieces:
    """Return the arc between two points with a bulge; a chord for the bulge 0.

    ``begin`` and ``end`` are (2,) m. The bulge is the tangent of a quarter of the arc's angle,
    positive counter-clockwise.
    """
    return bulges(np.array([begin, end]), np.array([bulge]), line)


def centre_segment(
    begin: FloatArray, end: FloatArray, centre: FloatArray, turn: str, line: int
) -> Pieces:
    """Return the arc around ``centre``, a full circle if ``begin`` and ``end`` are equal.

    The points are (2,) m; ``turn`` is ``ccw`` or ``cw``.

    Raises
    ------
    ValueError
        If the two ends lie at different distances from the centre, or ``turn`` is unknown.
    """
    if turn not in TURNS:
        raise ValueError(f"an arc around a centre turns 'ccw' or 'cw', got {turn!r}")
    a, b = begin - centre, end - centre
    radius, other = math.hypot(*a), math.hypot(*b)
    if radius == 0.0 or abs(radius - other) > RADIUS_SLACK_M:
        raise ValueError(
            f"the arc begins {radius * 1e3:.6g} mm and ends {other * 1e3:.6g} mm from its centre"
        )
    sweep = math.atan2(a[0] * b[1] - a[1] * b[0], float(a @ b))
    if turn == "ccw" and sweep <= 0.0:
        sweep += 2.0 * math.pi
    if turn == "cw" and sweep >= 0.0:
        sweep -= 2.0 * math.pi
    return ellipse_arc(centre, a, np.array([-a[1], a[0]]), 0.0, sweep, line)


def radius_segment(
    begin: FloatArray, end: FloatArray, radius_m: float, turn: str, large: bool, line: int
) -> Pieces:
    """Return the arc with ``radius_m``; with ``large`` the arc of more than half a turn.

    ``begin`` and ``end`` are (2,) m; ``turn`` is ``ccw`` or ``cw``.

    Raises
    ------
    ValueError
        If the ends are further apart than the diameter, or coincide.
    """
    chord = end - begin
    apart = math.hypot(*chord)
    if not 0.0 < apart <= 2.0 * radius_m * (1.0 + 1e-12):
        raise ValueError(
            f"ends {apart * 1e3:.6g} mm apart are not on a circle of radius {radius_m * 1e3:.6g} mm"
        )
    rise = math.sqrt(max(0.0, radius_m**2 - apart**2 / 4.0))
    left = np.array([-chord[1], chord[0]]) / apart
    side = 1.0 if (turn == "ccw") != large else -1.0
    return centre_segment(begin, end, begin + chord / 2.0 + side * rise * left, turn, line)


CONTOUR_KEYS = ("layer", "unit", "closed", "points")
_POINT = ("to", "bulge", "centre", "radius", "turn", "large")


def written_contour(table: dict[str, Any], factor: float, line: int) -> Pieces:
    """Return the pieces of a ``[[contour]]`` table.

    Parameters
    ----------
    table
        Its content.
    factor
        Metres in its unit.
    line
        Line of the file, for the pieces.

    Raises
    ------
    ValueError
        If a point or an arc is wrong.
    """
    points = table.get("points", [])
    if not isinstance(points, list) or len(points) < 2:
        raise ValueError("points needs two or more points, like [[0, 0], [10, 0]]")
    here = first = _pair(points[0]) * factor
    parts = []
    for point in points[1:]:
        if not isinstance(point, dict):
            point = {"to": point}  # noqa: PLW2901 - the short form of the same thing
        there = _pair(point.get("to")) * factor
        parts.append(_segment(here, there, point, factor, line))
        here = there
    closed = table.get("closed", False)
    if not isinstance(closed, bool):
        raise ValueError(f"closed is {closed!r}, not true or false")
    if closed and np.hypot(*(here - first)) > 0.0:
        parts.append(bulge_segment(here, first, 0.0, line))
    return join_pieces(parts)


def _pair(value: Any) -> FloatArray:
    good = isinstance(value, list) and len(value) == 2 and all(_is_number(part) for part in value)
    if not good:
        raise ValueError(f"{value!r} is not a point like [10, 20]")
    return np.array(value, dtype=np.float64)


def _is_number(value: Any) -> bool:
    return type(value) in (int, float) and math.isfinite(value)


def _number(point: dict[str, Any], key: str) -> float:
    value = point.get(key, 0.0)
    if not _is_number(value):
        raise ValueError(f"{key} is {value!r}, not a number")
    return float(value)


def _segment(
    here: FloatArray, there: FloatArray, point: dict[str, Any], factor: float, line: int
) -> Pieces:
    unknown = set(point) - set(_POINT)
    if unknown:
        key = sorted(unknown)[0]
        raise ValueError(f"unknown key {key!r} of a point. {nearest(key, _POINT)}")
    if len({"bulge", "centre", "radius"} & set(point)) > 1:
        raise ValueError("an arc is given by its bulge, its centre or its radius, not by two")
    turn = point.get("turn", "ccw")
    if "centre" in point:
        return centre_segment(here, there, _pair(point["centre"]) * factor, turn, line)
    if "radius" in point:
        radius = _number(point, "radius") * factor
        return radius_segment(here, there, radius, turn, bool(point.get("large", False)), line)
    return bulge_segment(here, there, _number(point, "bulge"), line)


ZERO_LENGTH_M = 1e-9
_SAID = 10
_NEAR = 100.0  # ends up to so many gaps apart are probably meant to meet


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Contour:
    """A curve without branches.

    The ends of neighbouring pieces are at most ``gap_m`` apart. Such a gap is not closed: it is a
    jump in position without length.
    """

    pieces: Pieces
    closed: bool
    layer: str = ""
    colour: str = ""


def drop_zero_lengths(strokes: Sequence[Stroke], file: str) -> tuple[list[Stroke], list[str]]:
    """Return the strokes without their pieces of length 0, and warnings about these pieces.

    A stroke without other pieces is omitted.
    """
    if not strokes:
        return [], []
    pieces = join_pieces([stroke.pieces for stroke in strokes])
    first, last = pieces.ends()
    middle = pieces.evaluate(np.arange(len(pieces)), np.full(len(pieces), 0.5))[0]
    reach = np.hypot(*(middle - first).T) + np.hypot(*(last - middle).T)
    bad = np.flatnonzero(~(reach > ZERO_LENGTH_M))
    if not len(bad):
        return list(strokes), []
    warnings = [
        f"{Place(file, int(pieces.line[k]))}: a segment of length zero at "
        f"{point_text(first[k])} was left out"
        for k in bad[:_SAID]
    ]
    if len(bad) > _SAID:
        warnings.append(f"{file}: {len(bad)} segments of length zero in all")
    counts = [len(stroke.pieces) for stroke in strokes]
    begins = np.concatenate([[0], np.cumsum(counts)])
    kept = list(strokes)
    owner = np.searchsorted(begins, bad, side="right") - 1
    for k in reversed(np.unique(owner).tolist()):
        own = np.setdiff1d(np.arange(counts[k]), bad[owner == k] - begins[k])
        if len(own):
            kept[k] = replace(strokes[k], pieces=strokes[k].pieces.take(own))
        else:
            del kept[k]
    return kept, warnings


def join_strokes(
    strokes: Sequence[Stroke], gap_m: float, file: str
) -> tuple[list[Contour], list[str]]:
    """Join ``strokes`` to contours, in the order of the file; return these and warnings.

    A contour starts at its first stroke in the file and has the direction of that stroke.

    Parameters
    ----------
    strokes
        Strokes of one seam.
    gap_m
        Ends at most this far apart are joined.
    file
        Name of the file, for messages.

    Raises
    ------
    JobError
        If three or more ends meet, so that the continuation is ambiguous, or if a stroke is shorter
        than ``gap_m``.
    """
    if not strokes:
        return [], []
    begin, end = join_pieces([s.pieces for s in strokes]).ends()
    after = np.cumsum([len(s.pieces) for s in strokes])
    first, last = begin[np.concatenate([[0], after[:-1]])], end[after - 1]
    loop = np.hypot(*(last - first).T) <= gap_m
    for k in np.flatnonzero(loop).tolist():
        _refuse_short(strokes[k], gap_m, file)
    ends = np.concatenate([first, last])  # end e belongs to stroke e % n; from n on last points
    count = len(strokes)
    partner = _partners(ends, np.tile(~loop, 2), gap_m, strokes, file)
    warnings = _gap_warnings(ends, partner, strokes, file)
    contours, used = [], np.zeros(count, dtype=bool)
    for k in range(count):
        if used[k]:
            continue
        chain, closed = _walk(k, partner, count)
        used[[index for index, _ in chain]] = True
        parts = [
            strokes[index].pieces.reverse() if backwards else strokes[index].pieces
            for index, backwards in chain
        ]
        contour = Contour(
            pieces=join_pieces(parts),
            closed=closed or bool(loop[k]),
            layer=strokes[k].layer,
            colour=strokes[k].colour,
        )
        contours.append(contour)
        if not contour.closed:
            warnings += _open_warning(contour, gap_m, file)
    return contours, warnings


def _partners(
    ends: FloatArray, free: np.ndarray, gap_m: float, strokes: Sequence[Stroke], file: str
) -> IntArray:
    """Return the (2 n,) index of the end that each end meets, -1 for none."""
    from scipy.spatial import cKDTree

    count = len(strokes)
    partner = np.full(2 * count, -1, dtype=np.int64)
    index = np.flatnonzero(free)
    if not len(index):
        return partner
    pairs = cKDTree(ends[index]).query_pairs(gap_m, output_type="ndarray")
    for i, j in index[pairs]:
        for one, other in ((i, j), (j, i)):
            if partner[one] >= 0:
                met = sorted({strokes[e % count].line for e in (one, other, partner[one])})
                which = f" (lines {', '.join(map(str, met))})" if met[0] else ""
                raise JobError(
                    f"three or more ends meet at {point_text(ends[one])}{which}",
                    place=Place(file, strokes[one % count].line),
                    remedy="Delete lines drawn twice, or put the branches on layers of their own.",
                )
            partner[one] = other
    return partner


def _walk(start: int, partner: IntArray, count: int) -> tuple[list[tuple[int, bool]], bool]:
    """Return the chain through stroke ``start`` as (stroke, backwards), and whether it closes."""
    chain = [(start, False)]
    end = start + count
    while partner[end] >= 0:
        entered = int(partner[end])
        if entered % count == start:
            return chain, True
        chain.append((entered % count, entered >= count))
        end = entered - count if entered >= count else entered + count
    before: list[tuple[int, bool]] = []
    end = start
    while partner[end] >= 0:
        entered = int(partner[end])
        before.append((entered % count, entered < count))
        end = entered - count if entered >= count else entered + count
    return before[::-1] + chain, False


def _gap_warnings(
    ends: FloatArray, partner: IntArray, strokes: Sequence[Stroke], file: str
) -> list[str]:
    met = np.flatnonzero(partner > np.arange(len(partner)))
    gaps = np.hypot(*(ends[met] - ends[partner[met]]).T)
    wide = met[gaps > ZERO_LENGTH_M]
    if not len(wide):
        return []
    worst = met[int(np.argmax(gaps))]
    place = Place(file, strokes[worst % len(strokes)].line)
    return [
        f"{place}: {len(wide)} gaps between strokes were passed over, the widest of "
        f"{gaps.max() * 1e3:.3g} mm at {point_text(ends[worst])}"
    ]


def _open_warning(contour: Contour, gap_m: float, file: str) -> list[str]:
    begin, end = contour.pieces.ends()[0][0], contour.pieces.ends()[1][-1]
    apart = float(np.hypot(*(end - begin)))
    if apart > _NEAR * gap_m:
        return []
    return [
        f"{Place(file, int(contour.pieces.line[0]))}: the contour is open by {apart * 1e3:.3g} mm "
        f"at {point_text(begin)}; a gap of {gap_m * 1e3:.3g} mm counts as closed"
    ]


def _refuse_short(stroke: Stroke, gap_m: float, file: str) -> None:
    first = stroke.pieces.ends()[0]
    inside = stroke.pieces.evaluate(np.arange(len(first)), np.full(len(first), 0.5))[0]
    spread = np.ptp(np.concatenate([first, inside]), axis=0)
    if np.hypot(*spread) <= gap_m:
        raise JobError(
            f"a stroke at {point_text(first[0])} is shorter than the gap of "
            f"{gap_m * 1e3:.3g} mm that counts as joined",
            place=Place(file, stroke.line),
            remedy="Delete the stroke, or set a smaller gap.",
        )


def point_text(point: FloatArray) -> str:
    """Return a (2,) point, m, as text in mm for a message."""
    return f"({point[0] * 1e3:.4g}, {point[1] * 1e3:.4g}) mm"
