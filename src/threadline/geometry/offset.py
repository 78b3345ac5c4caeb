"""Offsets of contours, with round or mitred corners."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.errors import JobError, Place
from threadline.geometry.contours import Contour
from threadline.geometry.curves import chords
from threadline.geometry.self_crossing import crossings, flatten

_SAME_M = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mitre:
    """A rounded corner, and the mitre that may replace it.

    Parameters
    ----------
    first, last
        Indices of the first and last chord of the round in the raw chain.
    begin, apex, end
        (2,) beginning of the round, tip of the mitre, and end of the round.
    """

    first: int
    last: int
    begin: FloatArray
    apex: FloatArray
    end: FloatArray


def sharpen(
    points: FloatArray, labels: IntArray, closed: bool, mitres: Sequence[Mitre]
) -> tuple[FloatArray, IntArray]:
    """Replace every complete round of the chain by its mitre.

    Parts of an offset are valid if their distance from the contour is large enough. This distance
    is constant on a round, but not on a mitre. Mitres therefore replace rounds only after this
    check, and only if they do not cross another part of the chain.

    Parameters
    ----------
    points, labels
        (n + 1, 2) points of the offset, and (n,) the index in the raw chain of each of its chords.
    """
    rounds = _complete_rounds(points, labels, mitres)
    while True:
        sharp_points, sharp_labels, mitre_of_chord = _with_mitres(points, labels, rounds)
        first, second, *_ = crossings(sharp_points[:-1], sharp_points[1:], closed)
        crossing_mitres = set(mitre_of_chord[np.concatenate([first, second])].tolist()) - {-1}
        if not crossing_mitres:
            return sharp_points, sharp_labels
        rounds = [
            complete_round for k, complete_round in enumerate(rounds) if k not in crossing_mitres
        ]


def _complete_rounds(
    points: FloatArray, labels: IntArray, mitres: Sequence[Mitre]
) -> list[tuple[int, int, Mitre]]:
    """Return the first and last chord of every complete round, with its mitre."""
    chord_of_label = {int(label): k for k, label in enumerate(labels)}
    rounds = []
    for mitre in mitres:
        i, j = chord_of_label.get(mitre.first), chord_of_label.get(mitre.last)
        if i is None or j is None or j - i != mitre.last - mitre.first:
            continue
        gaps_m = np.hypot(*(points[i] - mitre.begin)), np.hypot(*(points[j + 1] - mitre.end))
        if max(gaps_m) < _SAME_M:
            rounds.append((i, j, mitre))
    return sorted(rounds, key=lambda item: item[0])


def _with_mitres(
    points: FloatArray, labels: IntArray, rounds: list[tuple[int, int, Mitre]]
) -> tuple[FloatArray, IntArray, IntArray]:
    """Return points, labels, and the index of the mitre of each chord, -1 for none."""
    point_parts, label_parts, mitre_parts = [], [], []
    last = 0
    for k, (i, j, mitre) in enumerate(rounds):
        point_parts += [points[last : i + 1], mitre.apex[None]]
        label_parts += [labels[last:i], labels[[i, j]]]
        mitre_parts += [np.full(i - last, -1), np.full(2, k)]
        last = j + 1
    point_parts.append(points[last:])
    label_parts.append(labels[last:])
    mitre_parts.append(np.full(len(labels) - last, -1))
    return (
        np.concatenate(point_parts),
        np.concatenate(label_parts),
        np.concatenate(mitre_parts).astype(np.int64),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Part:
    """A part of a chain between two crossings.

    ``begin`` and ``end`` are the indices of these crossings. Instead of a crossing, -1 stands for
    the start and -2 for the end of an open chain. ``probe`` is a point far from both ends.
    """

    points: FloatArray
    labels: IntArray
    begin: int
    end: int

    @property
    def probe(self) -> FloatArray:
        """(2,) middle of the longest chord of the part."""
        step = np.diff(self.points, axis=0)
        k = int(np.argmax(np.hypot(*step.T)))
        middle: FloatArray = self.points[k] + step[k] / 2.0
        return middle


def stitch_parts(
    chain: FloatArray,
    labels: IntArray,
    closed: bool,
    cuts: tuple[IntArray, IntArray, FloatArray, FloatArray],
) -> list[Part]:
    """Return the parts of ``chain`` between its crossings, in order.

    Parameters
    ----------
    chain, labels
        (n + 1, 2) points, and (n,) a number for each chord.
    closed
        Whether the chain ends where it begins.
    cuts
        First and second chord of each crossing, and the positions on both, from 0 to 1.
    """
    first, second, at_first, at_second = cuts
    chord = np.concatenate([first, second]).astype(np.int64)
    share = np.concatenate([at_first, at_second])
    crossing = np.tile(np.arange(len(first)), 2)
    order = np.lexsort((share, chord))
    chord, share, crossing = chord[order], share[order], crossing[order]
    if not len(chord):
        ends = (0, 0) if closed else (-1, -2)
        return [Part(points=chain, labels=labels, begin=ends[0], end=ends[1])]
    crossing_points = chain[chord] + share[:, None] * (chain[chord + 1] - chain[chord])
    parts = []
    for k in range(len(chord) - 1):
        inner = slice(chord[k] + 1, chord[k + 1] + 1)
        points = np.concatenate(
            [crossing_points[k : k + 1], chain[inner], crossing_points[k + 1 : k + 2]]
        )
        part_labels = labels[chord[k] : chord[k + 1] + 1]
        parts.append(
            Part(
                points=points, labels=part_labels, begin=int(crossing[k]), end=int(crossing[k + 1])
            )
        )
    head = np.concatenate([chain[: chord[0] + 1], crossing_points[:1]])
    tail = np.concatenate([crossing_points[-1:], chain[chord[-1] + 1 :]])
    head_labels, tail_labels = labels[: chord[0] + 1], labels[chord[-1] :]
    if closed:
        parts.append(
            Part(
                points=np.concatenate([tail, head[1:]]),
                labels=np.concatenate([tail_labels, head_labels]),
                begin=int(crossing[-1]),
                end=int(crossing[0]),
            )
        )
        return parts
    return [
        Part(points=head, labels=head_labels, begin=-1, end=int(crossing[0])),
        *parts,
        Part(points=tail, labels=tail_labels, begin=int(crossing[-1]), end=-2),
    ]


def clear_of(
    probes: FloatArray, begin: FloatArray, end: FloatArray, distance_m: float
) -> NDArray[np.bool_]:
    """Return (n,) whether each probe is at least ``distance_m`` from every chord."""
    result: NDArray[np.bool_] = _clear_of(probes, begin, end, distance_m)
    return result


@njit()
def _clear_of(probes, begin, end, distance_m):  # type: ignore[no-untyped-def]
    limit2_m2 = distance_m * distance_m
    clear = np.ones(len(probes), dtype=np.bool_)
    for i in range(len(probes)):
        px, py = probes[i, 0], probes[i, 1]
        for j in range(len(begin)):
            dx, dy = end[j, 0] - begin[j, 0], end[j, 1] - begin[j, 1]
            qx, qy = px - begin[j, 0], py - begin[j, 1]
            along = (qx * dx + qy * dy) / (dx * dx + dy * dy)
            along = min(1.0, max(0.0, along))
            ex, ey = qx - along * dx, qy - along * dy
            if ex * ex + ey * ey < limit2_m2:
                clear[i] = False
                break
    return clear


TOLERANCE_M = 1e-7  # largest deviation of chords from curves; the offset is exact to 1 um
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
        A corner whose mitre is longer than this multiple of the distance is rounded.
    """

    distance_m: float
    side: str = "inside"
    join: str = "mitre"
    mitre_limit: float = 4.0


def offset_contour(contour: Contour, allowance: Allowance, file: str) -> list[Contour]:
    """Return the offset of ``contour`` by ``allowance``; the contour itself for a distance of 0.

    An inside offset may consist of several contours; narrow parts vanish.

    Raises
    ------
    JobError
        If an open contour has no such side, the contour crosses itself, or nothing remains.

    Notes
    -----
    Every chord is moved sideways. Chords overlap at inner corners, and rounds join them at outer
    corners. The chain is cut at its crossings with itself, and parts that are closer to the contour
    than the distance are removed. Finally mitres replace rounds, if ``join`` asks for mitres and
    they fit.
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
    raw_points, source_chord, mitres = _raw_offset(points, tangents, signed_m, allowance)
    parts = [
        (*sharpen(part_points, labels, closed, mitres), closed)
        for part_points, labels, closed in _valid_parts(
            raw_points, points, contour.closed, distance_m
        )
    ]
    if not parts:
        raise JobError(
            f"an allowance of {distance_m * 1e3:g} mm leaves nothing of the contour",
            place=place,
            remedy="Lower the allowance.",
        )
    return [
        Contour(
            pieces=chords(part_points, lines[source_chord[labels]]),
            closed=closed,
            layer=contour.layer,
            colour=contour.colour,
        )
        for part_points, labels, closed in parts
    ]


def _chain(
    begin: FloatArray, end: FloatArray, lines: IntArray, closed: bool
) -> tuple[FloatArray, IntArray]:
    """Return (n + 1, 2) points without duplicates; a closed chain ends at its first point."""
    last = begin[:1] if closed else end[-1:]
    points = np.concatenate([begin, last])
    keep = np.hypot(*np.diff(points, axis=0).T) > 1e-10
    return np.concatenate([points[:-1][keep], last]), lines[keep]


def _side(points: FloatArray, closed: bool, allowance: Allowance, place: Place) -> float:
    """Return 1 if the offset lies to the left of the contour's direction, -1 to the right."""
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

    ``tangents`` are the tangents of the curve at the ends of an open chain; None for a closed
    chain. The second result has, for each chord of the chain, the index of its chord of the
    contour. The third result has the rounds that mitres may replace.
    """
    closed = tangents is None
    direction = np.diff(points, axis=0)
    direction /= np.hypot(*direction.T)[:, None]
    shift = signed_m * np.column_stack([-direction[:, 1], direction[:, 0]])
    count = len(direction)
    chain: list[FloatArray] = []
    source_chord: list[int] = []
    mitres: list[Mitre] = []

    def add(point: FloatArray, chord: int) -> None:
        chain.append(point)
        source_chord.append(chord)

    def open_end(point: FloatArray, tangent: FloatArray, chord: FloatArray) -> FloatArray:
        # The end lies on the moved chord, perpendicular to the curve, whose tangent differs from
        # the direction of the chord.
        normal = signed_m * np.array([-tangent[1], tangent[0]])
        return np.asarray(point + normal * signed_m**2 / float(normal @ chord))

    if tangents is not None:
        add(open_end(points[0], tangents[0], shift[0]), 0)
    for k in range(0 if closed else 1, count):
        previous, corner = (k - 1) % count, points[k]
        d1, d2 = direction[previous], direction[k]
        turn = math.atan2(d1[0] * d2[1] - d1[1] * d2[0], float(d1 @ d2))
        corner_points = _corner(corner, shift[previous], shift[k], turn, signed_m)
        is_mitred = (
            allowance.join == "mitre" and allowance.mitre_limit * math.cos(turn / 2.0) >= 1.0
        )
        if len(corner_points) > 1 and turn * signed_m < 0.0 and is_mitred:
            first = len(chain)
            mitres.append(
                Mitre(
                    first=first,
                    last=first + len(corner_points) - 2,
                    begin=corner_points[0],
                    apex=corner + (shift[previous] + shift[k]) / 2.0 / math.cos(turn / 2.0) ** 2,
                    end=corner_points[-1],
                )
            )
        for point in corner_points:
            add(point, k)
    if tangents is None:
        add(chain[0], 0)
    else:
        add(open_end(points[-1], tangents[1], shift[-1]), count - 1)
    return np.array(chain), np.array(source_chord[:-1]), mitres


def _corner(
    corner: FloatArray,
    shift_before: FloatArray,
    shift_after: FloatArray,
    turn: float,
    signed_m: float,
) -> list[FloatArray]:
    """Return the points of the chain at a vertex between two shifted chords."""
    is_inner = turn * signed_m > 0.0
    mitre = 1.0 / max(math.cos(turn / 2.0), 1e-9)
    if is_inner and abs(turn) > _SLIGHT_RAD:
        # An inner corner goes through the vertex, so that the overlap is too close and is removed.
        return [corner + shift_before, corner, corner + shift_after]
    if is_inner or abs(signed_m) * (mitre - 1.0) <= _ROUND_M:
        return [corner + (shift_before + shift_after) / 2.0 * mitre**2]
    radius = abs(signed_m)
    step = 2.0 * math.acos(radius / (radius + _ROUND_M))
    parts = math.ceil(abs(turn) / step)
    angles = turn * (np.arange(parts) + 0.5) / parts  # corners of a circumscribed polygon
    scale = 1.0 / math.cos(turn / parts / 2.0)
    cosine, sine = np.cos(angles) * scale, np.sin(angles) * scale
    x = corner[0] + shift_before[0] * cosine - shift_before[1] * sine
    y = corner[1] + shift_before[0] * sine + shift_before[1] * cosine
    return [corner + shift_before, *np.column_stack([x, y]), corner + shift_after]


def _valid_parts(
    raw: FloatArray, points: FloatArray, closed: bool, distance_m: float
) -> list[tuple[FloatArray, IntArray, bool]]:
    """Return the parts of the raw chain that are far enough from the contour, joined to chains.

    Each chain consists of its points, the index in the raw chain of each of its chords, and whether
    it is closed.
    """
    first, second, at_first, at_second, _ = crossings(raw[:-1], raw[1:], closed)
    parts = stitch_parts(raw, np.arange(len(raw) - 1), closed, (first, second, at_first, at_second))
    probes = np.array([part.probe for part in parts])
    is_clear = clear_of(probes, points[:-1], points[1:], distance_m - 1e-9)
    kept = [part for part, clear in zip(parts, is_clear, strict=True) if clear]
    outlines = []
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
        has_length = np.hypot(*np.diff(joined, axis=0).T) > 1e-10
        joined = np.concatenate([joined[:1], joined[1:][has_length]])
        is_loop = bool(np.hypot(*(joined[-1] - joined[0])) < 1e-9) and len(joined) > 3
        if len(joined) > 1 and (is_loop or not closed):
            outlines.append((joined, labels[has_length], is_loop))
    return outlines
