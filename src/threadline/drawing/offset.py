"""Offsets: curves at a distance from a contour, such as a seam allowance."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.drawing.contours import Contour
from threadline.drawing.offset_mitre import Mitre, sharpen
from threadline.drawing.offset_parts import clear_of, stitch_parts
from threadline.drawing.self_crossing import crossings, flatten
from threadline.drawing.shapes import chords
from threadline.errors import JobError, Place

TOLERANCE_M = 1e-7  # of the chords of curves; the offset is exact to 1 um
_ROUND_M = 5e-7
_MAX_CHORDS = 300_000
_SLIGHT_RAD = math.radians(5.0)


@dataclass(frozen=True, slots=True)
class Allowance:
    """Distance and form of an offset.

    Parameters
    ----------
    distance_m
        Distance from the contour.
    side
        ``inside`` or ``outside`` a closed contour, ``left`` or ``right`` of an open one.
    join
        Form of corners, ``mitre`` or ``round``.
    mitre_limit
        A mitre longer than this multiple of the distance is rounded.
    """

    distance_m: float
    side: str = "inside"
    join: str = "mitre"
    mitre_limit: float = 4.0


def offset_contour(contour: Contour, allowance: Allowance, file: str) -> list[Contour]:
    """Return the contours at ``allowance`` from ``contour``; itself for a distance of 0.

    An inside offset may consist of several contours, and narrow parts have none.

    Raises
    ------
    JobError
        If an open contour has no such side, the contour crosses itself, or nothing is left.

    Notes
    -----
    Every chord is moved sideways; outer corners are rounded, inner corners overlap. The chain is
    cut wherever it crosses itself, and parts that are nearer to the contour than the distance are
    removed. Last, rounds are replaced by mitres where these are wanted and fit.
    """
    distance_m = allowance.distance_m
    if distance_m == 0.0:
        return [contour]
    place = Place(file, int(contour.pieces.line[0]))
    begin, end, piece = flatten(contour.pieces, TOLERANCE_M)
    if len(begin) > _MAX_CHORDS:
        raise JobError(
            f"an allowance on a contour of {len(begin)} chords, limit {_MAX_CHORDS}", place=place
        )
    points, lines = _chain(begin, end, contour.pieces.line[piece], contour.closed)
    if len(crossings(points[:-1], points[1:], contour.closed)[0]):
        raise JobError(
            "a contour that crosses itself has no inside for the allowance",
            place=place,
            remedy="Mend the drawing, or set allowance to 0 mm.",
        )
    signed_m = _side(points, contour.closed, allowance, place) * distance_m
    first, last = contour.pieces.end_directions()
    tangents = None if contour.closed else (first[0], last[-1])
    raw, chord, mitres = _raw_offset(points, tangents, signed_m, allowance)
    parts = [
        (*sharpen(line, labels, closed, mitres), closed)
        for line, labels, closed in _valid_parts(raw, points, contour.closed, distance_m)
    ]
    if not parts:
        raise JobError(
            f"an allowance of {distance_m * 1e3:g} mm leaves nothing of the contour",
            place=place,
            remedy="Lower the allowance.",
        )
    return [
        Contour(
            pieces=chords(line, lines[chord[labels]]),
            closed=closed,
            layer=contour.layer,
            colour=contour.colour,
        )
        for line, labels, closed in parts
    ]


def _chain(
    begin: FloatArray, end: FloatArray, lines: IntArray, closed: bool
) -> tuple[FloatArray, IntArray]:
    """Return (n + 1, 2) points without doubled ones; a closed chain ends in its first point."""
    last = begin[:1] if closed else end[-1:]
    points = np.concatenate([begin, last])
    keep = np.hypot(*np.diff(points, axis=0).T) > 1e-10
    return np.concatenate([points[:-1][keep], last]), lines[keep]


def _side(points: FloatArray, closed: bool, allowance: Allowance, place: Place) -> float:
    """Return 1 when the offset lies to the left of the contour's direction, -1 to the right."""
    if allowance.side in ("left", "right"):
        return 1.0 if allowance.side == "left" else -1.0
    if not closed:
        raise JobError(
            f"an open contour has no {allowance.side}",
            place=place,
            remedy="Close it in the drawing, or set side to left or right.",
        )
    x, y = points.T
    area = float((x[:-1] * y[1:] - x[1:] * y[:-1]).sum())
    return 1.0 if (area > 0.0) == (allowance.side == "inside") else -1.0


def _raw_offset(
    points: FloatArray,
    tangents: tuple[FloatArray, FloatArray] | None,
    signed_m: float,
    allowance: Allowance,
) -> tuple[FloatArray, IntArray, list[Mitre]]:
    """Return the chain of moved chords, joined but not cut.

    ``tangents`` are those of the curve at the ends of an open chain, None for a closed one. The
    second result is the chord of the contour that each chord of the chain belongs to; the third are
    the rounds that may be replaced by mitres.
    """
    closed = tangents is None
    direction = np.diff(points, axis=0)
    direction /= np.hypot(*direction.T)[:, None]
    shift = signed_m * np.column_stack([-direction[:, 1], direction[:, 0]])
    count = len(direction)
    chain: list[FloatArray] = []
    owner: list[int] = []
    mitres: list[Mitre] = []

    def add(point: FloatArray, chord: int) -> None:
        chain.append(point)
        owner.append(chord)

    def end(point: FloatArray, tangent: FloatArray, chord: FloatArray) -> FloatArray:
        # On the moved chord, square to the curve: chords lean a little at their ends.
        normal = signed_m * np.array([-tangent[1], tangent[0]])
        return np.asarray(point + normal * signed_m**2 / float(normal @ chord))

    if tangents is not None:
        add(end(points[0], tangents[0], shift[0]), 0)
    for k in range(0 if closed else 1, count):
        before, corner = (k - 1) % count, points[k]
        d1, d2 = direction[before], direction[k]
        turn = math.atan2(d1[0] * d2[1] - d1[1] * d2[0], float(d1 @ d2))
        found = _corner(corner, shift[before], shift[k], turn, signed_m)
        sharp = allowance.join == "mitre" and allowance.mitre_limit * math.cos(turn / 2.0) >= 1.0
        if len(found) > 1 and turn * signed_m < 0.0 and sharp:
            first = len(chain)
            mitres.append(
                Mitre(
                    first=first,
                    last=first + len(found) - 2,
                    begin=found[0],
                    apex=corner + (shift[before] + shift[k]) / 2.0 / math.cos(turn / 2.0) ** 2,
                    end=found[-1],
                )
            )
        for point in found:
            add(point, k)
    if tangents is None:
        add(chain[0], 0)
    else:
        add(end(points[-1], tangents[1], shift[-1]), count - 1)
    return np.array(chain), np.array(owner[:-1]), mitres


def _corner(
    corner: FloatArray,
    before: FloatArray,
    after: FloatArray,
    turn: float,
    signed_m: float,
) -> list[FloatArray]:
    """Return the points of the chain at a vertex; ``before`` and ``after`` are the two shifts."""
    inner = turn * signed_m > 0.0
    mitre = 1.0 / max(math.cos(turn / 2.0), 1e-9)
    if inner and abs(turn) > _SLIGHT_RAD:
        # Through the vertex itself, so that the overlap is certainly too near and is removed.
        return [corner + before, corner, corner + after]
    if inner or abs(signed_m) * (mitre - 1.0) <= _ROUND_M:
        return [corner + (before + after) / 2.0 * mitre**2]
    radius = abs(signed_m)
    step = 2.0 * math.acos(radius / (radius + _ROUND_M))
    parts = math.ceil(abs(turn) / step)
    angles = turn * (np.arange(parts) + 0.5) / parts  # a polygon around the arc, never nearer
    grow = 1.0 / math.cos(turn / parts / 2.0)
    cosine, sine = np.cos(angles) * grow, np.sin(angles) * grow
    x = corner[0] + before[0] * cosine - before[1] * sine
    y = corner[1] + before[0] * sine + before[1] * cosine
    return [corner + before, *np.column_stack([x, y]), corner + after]


def _valid_parts(
    raw: FloatArray, points: FloatArray, closed: bool, distance_m: float
) -> list[tuple[FloatArray, IntArray, bool]]:
    """Return the parts of the raw chain that keep the distance, joined to chains.

    Each chain is given by its points, the chord of the raw chain that each of its chords is part
    of, and whether it is closed.
    """
    first, second, at_first, at_second, _ = crossings(raw[:-1], raw[1:], closed)
    parts = stitch_parts(raw, np.arange(len(raw) - 1), closed, (first, second, at_first, at_second))
    probes = np.array([part.probe for part in parts])
    good = clear_of(probes, points[:-1], points[1:], distance_m - 1e-9)
    kept = [part for part, ok in zip(parts, good, strict=True) if ok]
    found = []
    unused = dict(enumerate(kept))
    starts: dict[int, list[int]] = {}
    for k, part in unused.items():
        starts.setdefault(part.begin, []).append(k)
    order = sorted(unused, key=lambda k: kept[k].begin >= 0)  # the start of an open chain first
    for k in order:
        if k not in unused:
            continue
        chain = [unused.pop(k)]
        while True:
            following = [j for j in starts.get(chain[-1].end, []) if j in unused]
            if chain[-1].end < 0 or not following:
                break
            chain.append(unused.pop(following[0]))
        joined = np.concatenate([chain[0].points, *(part.points[1:] for part in chain[1:])])
        labels = np.concatenate([part.labels for part in chain])
        step = np.hypot(*np.diff(joined, axis=0).T) > 1e-10
        joined = np.concatenate([joined[:1], joined[1:][step]])
        loops = bool(np.hypot(*(joined[-1] - joined[0])) < 1e-9) and len(joined) > 3
        if len(joined) > 1 and (loops or not closed):
            found.append((joined, labels[step], loops))
    return found
