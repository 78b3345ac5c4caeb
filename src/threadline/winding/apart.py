"""Compiled distances of eye, arm and free fibre from all turning parts, sample by sample.

Every turning part is a body of revolution, so that the distance of a point in space is exactly its
distance in the plane through the axis. Along the arm and along the fibre the least distance is
found by bounds: from one point of the line to another, the distance changes by no more than the
points are apart.
"""

from __future__ import annotations

import math

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.winding.eye import ahead, centre, turned
from threadline.winding.surface import meridian

LEAF = 16
"""Number of chords of an outline that share a bounding box."""
_EXACT_M = 1e-6  # tolerance of the least distance along a line


@njit(nogil=True)
def _to_outline(x: float, r: float, line: FloatArray, boxes: FloatArray, most: float) -> float:
    """Return the signed distance of a point in the plane to a closed outline, or above ``most``.

    ``line`` is (n, 2) places and radii, from the axis back to the axis; ``boxes`` holds least and
    largest place and radius of every ``LEAF`` chords. Inside, the distance is negative.
    """
    best, inside, found = most * most, False, False
    for box in range(len(boxes)):
        dx = max(boxes[box, 0] - x, x - boxes[box, 1], 0.0)
        dr = max(boxes[box, 2] - r, r - boxes[box, 3], 0.0)
        across = boxes[box, 0] <= x <= boxes[box, 1]
        if dx * dx + dr * dr >= best and not across:
            continue
        for k in range(box * LEAF, min((box + 1) * LEAF, len(line) - 1)):
            ax, ar = line[k, 0], line[k, 1]
            bx, br = line[k + 1, 0] - ax, line[k + 1, 1] - ar
            px, pr = x - ax, r - ar
            if (ax <= x) != (line[k + 1, 0] <= x) and pr < px / bx * br:
                inside = not inside
            square = bx * bx + br * br
            share = min(max((px * bx + pr * br) / square, 0.0), 1.0) if square > 0.0 else 0.0
            gx, gr = px - share * bx, pr - share * br
            away = gx * gx + gr * gr
            if away < best:
                best, found = away, True
    if not found:
        return -math.inf if inside else math.inf
    return -math.sqrt(best) if inside else math.sqrt(best)


@njit(nogil=True)
def _to_ring(x: float, r: float, ring: FloatArray) -> float:
    """Return the signed distance of a point in the plane to a solid cylinder."""
    dx, dr = max(float(ring[0]) - x, x - float(ring[1])), r - float(ring[2])
    if dx <= 0.0 and dr <= 0.0:
        return max(dx, dr)
    return math.hypot(max(dx, 0.0), max(dr, 0.0))


@njit(nogil=True)
def _distance(
    a: FloatArray, b: FloatArray, share: float, which: int,
    line: FloatArray, boxes: FloatArray, rings: FloatArray, most: float,
) -> float:  # fmt: skip
    x = a[0] + share * (b[0] - a[0])
    across, up = a[1] + share * (b[1] - a[1]), a[2] + share * (b[2] - a[2])
    r = math.sqrt(across * across + up * up)
    if which == 0:
        return float(_to_outline(x, r, line, boxes, most))
    return float(_to_ring(x, r, rings[which - 1]))


@njit(nogil=True)
def _along(
    a: FloatArray, b: FloatArray, which: int,
    line: FloatArray, boxes: FloatArray, rings: FloatArray, most: float,
) -> float:  # fmt: skip
    """Return the least signed distance along a line in space, within 1 um; ``most`` if it is more.

    ``which`` is 0 for the mandrel, else the number of the ring plus 1.
    """
    length = math.sqrt((b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2 + (b[2] - a[2]) ** 2)
    best = most
    for k in range(2):
        found = _distance(a, b, float(k), which, line, boxes, rings, most)
        if found == -math.inf:  # deeper inside than the limit of the search
            found = _distance(a, b, float(k), which, line, boxes, rings, math.inf)
        best = min(best, found)
    if length == 0.0:
        return best
    # Intervals whose middles are to be tried. One that cannot hold a smaller distance is dropped.
    low, high = np.empty(64), np.empty(64)
    low[0], high[0], count = 0.0, 1.0, 1
    while count:
        count -= 1
        begin, end = low[count], high[count]
        reach = 0.5 * (end - begin) * length
        middle = 0.5 * (begin + end)
        found = _distance(a, b, middle, which, line, boxes, rings, best + reach)
        if found == -math.inf:
            found = _distance(a, b, middle, which, line, boxes, rings, math.inf)
        best = min(best, found)
        if reach > _EXACT_M and found - reach < best - _EXACT_M and count < 62:
            low[count], high[count] = begin, middle
            low[count + 1], high[count + 1] = middle, end
            count += 2
    return best


@njit(nogil=True)
def free_fibre(
    laid: FloatArray, q: FloatArray, table: tuple[FloatArray, FloatArray, FloatArray],
    payout: FloatArray, hint: int, at: FloatArray, to: FloatArray,
) -> int:  # fmt: skip
    """Write the (3,) ends of the free fibre in machine coordinates; return the meridian's piece.

    ``laid`` begins with u and angle of the laid point; ``q`` is (6,) of the eye.
    """
    hint, x, r, _, _, _, _ = meridian(table[0], table[1], table[2], laid[0], hint)
    psi = laid[1] + q[0]
    cos, sin = math.cos(psi), math.sin(psi)
    dx, dr, dc, _, _, _, _ = ahead(x, r, psi, q, np.zeros(6), payout)
    at[0], at[1], at[2] = x, r * cos, r * sin
    to[0], to[1], to[2] = x + dx, (r + dr) * cos - dc * sin, (r + dr) * sin + dc * cos
    return int(hint)


@njit(nogil=True)
def _room(
    ends: FloatArray, leaves: FloatArray, known: bool, sizes: FloatArray,
    line: FloatArray, boxes: FloatArray, rings: FloatArray,
) -> tuple[float, int]:  # fmt: skip
    """Return the least room of a sample, at most 1 m, and its pair; see ``walk``."""
    room, pair = 1.0, 0
    for which in range(len(rings) + 1):
        for part in range(3):
            if (part == 1 and sizes[2] == 0.0) or (part == 2 and (not known or which == 0)):
                continue
            taken = 0.0 if part == 2 else sizes[part] + sizes[3]
            # What is further needs no search; below 0 the depth counts.
            most = taken + max(room, 0.0)
            if part == 0:
                away = _along(ends[0], ends[0], which, line, boxes, rings, most)
            elif part == 1:
                away = _along(ends[0], ends[1], which, line, boxes, rings, most)
            else:
                away = _along(ends[2], leaves, which, line, boxes, rings, most)
            if away - taken < room:
                room, pair = away - taken, 3 * which + part
    return room, pair


@njit(nogil=True)
def walk(
    eyes: FloatArray, laid: FloatArray, table: tuple[FloatArray, FloatArray, FloatArray],
    payout: FloatArray, sizes: FloatArray, line: FloatArray, boxes: FloatArray,
    rings: FloatArray, least: float, found: FloatArray, pair: IntArray,
) -> float:  # fmt: skip
    """Write by how much each sample is too near, and the pair; return the least room so far.

    Parameters
    ----------
    eyes
        (n, 6) coordinates of the eye from the mandrel's left end.
    laid
        (n, 3) u, angle and laid length of the fibre; NaN where it is not known.
    sizes
        Radius of the eye's body, radius and length of its arm, and the distance wanted.
    least
        Least room of the samples before: rooms above it are of no interest.
    found
        (n,) written: lengths by which a sample is too near, m; 0 where a sample was passed over.
    pair
        (n,) written: three times the body, 0 for the mandrel, plus 0 for the eye, 1 for the arm, 2
        for the free fibre.
    """
    still = np.zeros(6)
    across = np.array([0.0, 1.0, 0.0])
    ends = np.empty((3, 3))  # the centre of the eye, the end of the arm, the laid point
    leaves = np.empty(3)
    before = np.full((4, 3), math.inf)
    room, hint = -math.inf, 0
    for i in range(len(eyes)):
        q = eyes[i]
        ends[0, 0], ends[0, 1], ends[0, 2], _, _, _ = centre(q, still, payout)
        ends[1, 0], ends[1, 1], ends[1, 2], _, _, _ = turned(across, q, still)
        for j in range(3):
            ends[1, j] = ends[0, j] + sizes[2] * ends[1, j]
        known = math.isfinite(laid[i, 0])
        if known:
            hint = free_fibre(laid[i], q, table, payout, hint, ends[2], leaves)
        moved = 0.0
        for k in range(4 if known else 2):
            point = leaves if k == 3 else ends[k]
            way = 0.0
            for j in range(3):
                way += (point[j] - before[k, j]) ** 2
                before[k, j] = point[j]
            moved = max(moved, math.sqrt(way))
        if not known:
            before[2, 0] = math.inf
        room -= moved
        limit = min(least, 0.0)
        if room >= limit:
            continue
        room, closest = _room(ends, leaves, known, sizes, line, boxes, rings)
        if room < limit:
            found[i], pair[i] = -room, closest
        least = min(least, room)
    return least
