"""Contours: arc segments, the ``[[contour]]`` tables of seam files, and contours from strokes."""

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
        Whether the curve ends where it begins; a length beyond its end then continues from the
        beginning.
    """

    table: ArcTable
    closed: bool

    def points(self, at_m: FloatArray) -> FloatArray:
        """Return the (n, 2) points at lengths along the line, m."""
        return self.table.points(np.mod(at_m, self.table.length_m) if self.closed else at_m)


RADIUS_SLACK_M = 1e-6
TURNS = ("ccw", "cw")


def bulge_segment(begin: FloatArray, end: FloatArray, bulge: float, line: int) -> Pieces:
    """Return the arc between two points, given by its bulge; a straight line for the bulge 0.

    ``begin`` and ``end`` are (2,) m. The bulge is the tangent of a quarter of the arc's angle,
    positive for an arc that turns counter-clockwise.
    """
    return bulges(np.array([begin, end]), np.array([bulge]), line)


def centre_segment(
    begin: FloatArray, end: FloatArray, centre: FloatArray, turn: str, line: int
) -> Pieces:
    """Return the arc around ``centre``: a full circle if ``begin`` and ``end`` are equal.

    The points are (2,) m; ``turn`` is ``ccw`` or ``cw``.

    Raises
    ------
    ValueError
        If the two ends are not equally far from the centre, ``begin`` is the centre, or ``turn`` is
        unknown.
    """
    if turn not in TURNS:
        raise ValueError(f"an arc around a centre turns 'ccw' or 'cw', got {turn!r}")
    a, b = begin - centre, end - centre
    radius, end_radius = math.hypot(*a), math.hypot(*b)
    if radius == 0.0 or abs(radius - end_radius) > RADIUS_SLACK_M:
        raise ValueError(
            f"the arc begins {radius * 1e3:.6g} mm and ends {end_radius * 1e3:.6g} mm from its "
            "centre"
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
    """Return the arc of radius ``radius_m``; with ``large`` the one of more than half a turn.

    ``begin`` and ``end`` are (2,) m; ``turn`` is ``ccw`` or ``cw``.

    Raises
    ------
    ValueError
        If the ends are further apart than the diameter, or coincide.
    """
    chord = end - begin
    chord_m = math.hypot(*chord)
    if not 0.0 < chord_m <= 2.0 * radius_m * (1.0 + 1e-12):
        raise ValueError(
            f"ends {chord_m * 1e3:.6g} mm apart are not on a circle of radius "
            f"{radius_m * 1e3:.6g} mm"
        )
    rise_m = math.sqrt(max(0.0, radius_m**2 - chord_m**2 / 4.0))
    left_normal = np.array([-chord[1], chord[0]]) / chord_m
    side = 1.0 if (turn == "ccw") != large else -1.0
    return centre_segment(begin, end, begin + chord / 2.0 + side * rise_m * left_normal, turn, line)


CONTOUR_KEYS = ("layer", "unit", "closed", "points")
POINT_KEYS = ("to", "bulge", "centre", "radius", "turn", "large")
"""Keys of a contour, and of one of its points, in a file."""


def written_contour(table: dict[str, Any], factor: float, line: int) -> Pieces:
    """Return the pieces of a ``[[contour]]`` table.

    Parameters
    ----------
    table
        Content of the table.
    factor
        Length of the table's unit, m.
    line
        Line of the file to which messages about these pieces refer.

    Raises
    ------
    ValueError
        If a point or an arc is wrong.
    """
    points = table.get("points", [])
    if not isinstance(points, list) or len(points) < 2:
        raise ValueError("points needs two or more points, like [[0, 0], [10, 0]]")
    begin = start = _pair(points[0]) * factor
    parts = []
    for point in points[1:]:
        if not isinstance(point, dict):
            point = {"to": point}  # noqa: PLW2901 - [x, y] is short for {to = [x, y]}
        end = _pair(point.get("to")) * factor
        parts.append(_segment(begin, end, point, factor, line))
        begin = end
    closed = table.get("closed", False)
    if not isinstance(closed, bool):
        raise ValueError(f"closed is {closed!r}, not true or false")
    if closed and np.hypot(*(begin - start)) > 0.0:
        parts.append(bulge_segment(begin, start, 0.0, line))
    return join_pieces(parts)


def _pair(value: Any) -> FloatArray:
    is_pair = (
        isinstance(value, list) and len(value) == 2 and all(_is_number(part) for part in value)
    )
    if not is_pair:
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
    begin: FloatArray, end: FloatArray, point: dict[str, Any], factor: float, line: int
) -> Pieces:
    unknown = set(point) - set(POINT_KEYS)
    if unknown:
        key = sorted(unknown)[0]
        raise ValueError(f"unknown key {key!r} of a point. {nearest(key, POINT_KEYS)}")
    if len({"bulge", "centre", "radius"} & set(point)) > 1:
        raise ValueError("an arc is given by its bulge, its centre or its radius, not by two")
    turn = point.get("turn", "ccw")
    if "centre" in point:
        return centre_segment(begin, end, _pair(point["centre"]) * factor, turn, line)
    if "radius" in point:
        radius = _number(point, "radius") * factor
        return radius_segment(begin, end, radius, turn, bool(point.get("large", False)), line)
    return bulge_segment(begin, end, _number(point, "bulge"), line)


ZERO_LENGTH_M = 1e-9
_MAX_WARNINGS = 10
_NEAR_GAPS = 100.0  # ends at most this many times gap_m apart were probably meant to meet


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Contour:
    """A curve without branches, made of strokes.

    Neighbouring strokes may be apart by the ``gap_m`` of ``join_strokes``. No line bridges such a
    gap: the position jumps there, and the gap adds nothing to the length.
    """

    pieces: Pieces
    closed: bool
    layer: str = ""
    colour: str = ""


def drop_zero_lengths(strokes: Sequence[Stroke], file: str) -> tuple[list[Stroke], list[str]]:
    """Return the strokes without pieces of length 0, and warnings about the pieces left out.

    A stroke of which no piece remains is left out.
    """
    if not strokes:
        return [], []
    pieces = join_pieces([stroke.pieces for stroke in strokes])
    first, last = pieces.ends()
    middle = pieces.evaluate(np.arange(len(pieces)), np.full(len(pieces), 0.5))[0]
    reach_m = np.hypot(*(middle - first).T) + np.hypot(*(last - middle).T)
    empty = np.flatnonzero(~(reach_m > ZERO_LENGTH_M))
    if not len(empty):
        return list(strokes), []
    warnings = [
        f"{Place(file, int(pieces.line[k]))}: a segment of length zero at "
        f"{point_text(first[k])} was left out"
        for k in empty[:_MAX_WARNINGS]
    ]
    if len(empty) > _MAX_WARNINGS:
        warnings.append(f"{file}: {len(empty)} segments of length zero in all")
    counts = [len(stroke.pieces) for stroke in strokes]
    begins = np.concatenate([[0], np.cumsum(counts)])
    kept = list(strokes)
    stroke_index = np.searchsorted(begins, empty, side="right") - 1
    for k in reversed(np.unique(stroke_index).tolist()):
        kept_pieces = np.setdiff1d(np.arange(counts[k]), empty[stroke_index == k] - begins[k])
        if len(kept_pieces):
            kept[k] = replace(strokes[k], pieces=strokes[k].pieces.take(kept_pieces))
        else:
            del kept[k]
    return kept, warnings


def join_strokes(
    strokes: Sequence[Stroke], gap_m: float, file: str
) -> tuple[list[Contour], list[str]]:
    """Join ``strokes`` to contours; return the contours, in the order of the file, and warnings.

    A contour has the direction of its first stroke in the file. A closed contour also begins there.

    Parameters
    ----------
    strokes
        Strokes of one seam.
    gap_m
        Ends at most this far apart are joined, m.
    file
        Name of the file, for messages.

    Raises
    ------
    JobError
        If three or more ends meet, so that the continuation is ambiguous, or if a whole stroke is
        not larger than ``gap_m``.
    """
    if not strokes:
        return [], []
    begin, end = join_pieces([s.pieces for s in strokes]).ends()
    end_index = np.cumsum([len(s.pieces) for s in strokes])
    first, last = begin[np.concatenate([[0], end_index[:-1]])], end[end_index - 1]
    is_loop = np.hypot(*(last - first).T) <= gap_m
    for k in np.flatnonzero(is_loop).tolist():
        _refuse_short(strokes[k], gap_m, file)
    ends = np.concatenate([first, last])  # first points, then last points; end e is of stroke e % n
    count = len(strokes)
    partner = _partners(ends, np.tile(~is_loop, 2), gap_m, strokes, file)
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
            closed=closed or bool(is_loop[k]),
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
    """Return (2 n,) for each end the index of the end that it is joined to; -1 for none."""
    from scipy.spatial import cKDTree

    count = len(strokes)
    partner = np.full(2 * count, -1, dtype=np.int64)
    index = np.flatnonzero(free)
    if not len(index):
        return partner
    pairs = cKDTree(ends[index]).query_pairs(gap_m, output_type="ndarray")
    for i, j in index[pairs]:
        for this_end, other_end in ((i, j), (j, i)):
            if partner[this_end] >= 0:
                meeting_lines = sorted(
                    {strokes[e % count].line for e in (this_end, other_end, partner[this_end])}
                )
                where = f" (lines {', '.join(map(str, meeting_lines))})" if meeting_lines[0] else ""
                raise JobError(
                    f"three or more ends meet at {point_text(ends[this_end])}{where}",
                    place=Place(file, strokes[this_end % count].line),
                    remedy="Delete lines drawn twice, or put the branches on layers of their own.",
                )
            partner[this_end] = other_end
    return partner


def _walk(start: int, partner: IntArray, count: int) -> tuple[list[tuple[int, bool]], bool]:
    """Return the chain of strokes through ``start``, and whether it is a loop.

    Each stroke of the chain is (index, whether it is passed backwards).
    """
    chain = [(start, False)]
    end = start + count
    while partner[end] >= 0:
        met_end = int(partner[end])
        if met_end % count == start:
            return chain, True
        chain.append((met_end % count, met_end >= count))
        end = met_end - count if met_end >= count else met_end + count
    chain_before: list[tuple[int, bool]] = []
    end = start
    while partner[end] >= 0:
        met_end = int(partner[end])
        chain_before.append((met_end % count, met_end < count))
        end = met_end - count if met_end >= count else met_end + count
    return chain_before[::-1] + chain, False


def _gap_warnings(
    ends: FloatArray, partner: IntArray, strokes: Sequence[Stroke], file: str
) -> list[str]:
    joined_ends = np.flatnonzero(partner > np.arange(len(partner)))
    gaps_m = np.hypot(*(ends[joined_ends] - ends[partner[joined_ends]]).T)
    wide = joined_ends[gaps_m > ZERO_LENGTH_M]
    if not len(wide):
        return []
    widest = joined_ends[int(np.argmax(gaps_m))]
    place = Place(file, strokes[widest % len(strokes)].line)
    return [
        f"{place}: {len(wide)} gaps between strokes were passed over, the widest of "
        f"{gaps_m.max() * 1e3:.3g} mm at {point_text(ends[widest])}"
    ]


def _open_warning(contour: Contour, gap_m: float, file: str) -> list[str]:
    begin, end = contour.pieces.ends()[0][0], contour.pieces.ends()[1][-1]
    opening_m = float(np.hypot(*(end - begin)))
    if opening_m > _NEAR_GAPS * gap_m:
        return []
    return [
        f"{Place(file, int(contour.pieces.line[0]))}: the contour is open by "
        f"{opening_m * 1e3:.3g} mm "
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
