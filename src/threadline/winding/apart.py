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
def _distance_to_outline(
    x: float, r: float, outline: FloatArray, boxes: FloatArray, limit_m: float
) -> float:
    """Return the signed distance of a point to a closed outline, or more than ``limit_m``.

    ``outline`` is (n, 2) places and radii, from the axis back to the axis; ``boxes`` holds least
    and largest place and radius of every ``LEAF`` chords. Inside, the distance is negative.
    """
    least2_m2, inside, any_chord = limit_m * limit_m, False, False
    for box in range(len(boxes)):
        dx = max(boxes[box, 0] - x, x - boxes[box, 1], 0.0)
        dr = max(boxes[box, 2] - r, r - boxes[box, 3], 0.0)
        beside = boxes[box, 0] <= x <= boxes[box, 1]
        if dx * dx + dr * dr >= least2_m2 and not beside:
            continue
        for k in range(box * LEAF, min((box + 1) * LEAF, len(outline) - 1)):
            ax, ar = outline[k, 0], outline[k, 1]
            bx, br = outline[k + 1, 0] - ax, outline[k + 1, 1] - ar
            px, pr = x - ax, r - ar
            if (ax <= x) != (outline[k + 1, 0] <= x) and pr < px / bx * br:
                inside = not inside
            chord2 = bx * bx + br * br
            share = min(max((px * bx + pr * br) / chord2, 0.0), 1.0) if chord2 > 0.0 else 0.0
            gx, gr = px - share * bx, pr - share * br
            distance2_m2 = gx * gx + gr * gr
            if distance2_m2 < least2_m2:
                least2_m2, any_chord = distance2_m2, True
    if not any_chord:
        return -math.inf if inside else math.inf
    return -math.sqrt(least2_m2) if inside else math.sqrt(least2_m2)


@njit(nogil=True)
def _distance_to_ring(x: float, r: float, ring: FloatArray) -> float:
    """Return the signed distance of a point in the plane to a solid cylinder."""
    dx, dr = max(float(ring[0]) - x, x - float(ring[1])), r - float(ring[2])
    if dx <= 0.0 and dr <= 0.0:
        return max(dx, dr)
    return math.hypot(max(dx, 0.0), max(dr, 0.0))


@njit(nogil=True)
def _distance(
    a: FloatArray, b: FloatArray, share: float, body: int,
    outline: FloatArray, boxes: FloatArray, rings: FloatArray, limit_m: float,
) -> float:  # fmt: skip
    x = a[0] + share * (b[0] - a[0])
    across, up = a[1] + share * (b[1] - a[1]), a[2] + share * (b[2] - a[2])
    r = math.sqrt(across * across + up * up)
    if body == 0:
        return float(_distance_to_outline(x, r, outline, boxes, limit_m))
    return float(_distance_to_ring(x, r, rings[body - 1]))


@njit(nogil=True)
def _least_along(
    a: FloatArray, b: FloatArray, body: int,
    outline: FloatArray, boxes: FloatArray, rings: FloatArray, limit_m: float,
) -> float:  # fmt: skip
    """Return the least signed distance along a line in space, within 1 um, at most ``limit_m``.

    ``body`` is 0 for the mandrel, else the number of the ring plus 1.
    """
    length_m = math.sqrt((b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2 + (b[2] - a[2]) ** 2)
    least_m = limit_m
    for k in range(2):
        distance_m = _distance(a, b, float(k), body, outline, boxes, rings, limit_m)
        if distance_m == -math.inf:  # deeper inside than the limit of the search
            distance_m = _distance(a, b, float(k), body, outline, boxes, rings, math.inf)
        least_m = min(least_m, distance_m)
    if length_m == 0.0:
        return least_m
    # Intervals whose middles are to be tried. One that cannot hold a smaller distance is dropped.
    low, high = np.empty(64), np.empty(64)
    low[0], high[0], count = 0.0, 1.0, 1
    while count:
        count -= 1
        begin, end = low[count], high[count]
        reach_m = 0.5 * (end - begin) * length_m
        middle = 0.5 * (begin + end)
        distance_m = _distance(a, b, middle, body, outline, boxes, rings, least_m + reach_m)
        if distance_m == -math.inf:
            distance_m = _distance(a, b, middle, body, outline, boxes, rings, math.inf)
        least_m = min(least_m, distance_m)
        if reach_m > _EXACT_M and distance_m - reach_m < least_m - _EXACT_M and count < 62:
            low[count], high[count] = begin, middle
            low[count + 1], high[count + 1] = middle, end
            count += 2
    return least_m


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
def _least_room(
    ends: FloatArray, leaves: FloatArray, known: bool, sizes: FloatArray,
    outline: FloatArray, boxes: FloatArray, rings: FloatArray,
) -> tuple[float, int]:  # fmt: skip
    """Return the least room of a sample, at most 1 m, and its pair; see ``walk``."""
    room_m, pair = 1.0, 0
    for body in range(len(rings) + 1):
        for part in range(3):
            if (part == 1 and sizes[2] == 0.0) or (part == 2 and (not known or body == 0)):
                continue
            size_m = 0.0 if part == 2 else sizes[part] + sizes[3]
            # What is further needs no search; below 0 the depth counts.
            limit_m = size_m + max(room_m, 0.0)
            if part == 0:
                distance_m = _least_along(ends[0], ends[0], body, outline, boxes, rings, limit_m)
            elif part == 1:
                distance_m = _least_along(ends[0], ends[1], body, outline, boxes, rings, limit_m)
            else:
                distance_m = _least_along(ends[2], leaves, body, outline, boxes, rings, limit_m)
            if distance_m - size_m < room_m:
                room_m, pair = distance_m - size_m, 3 * body + part
    return room_m, pair


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
    no_rates = np.zeros(6)
    across_vector = np.array([0.0, 1.0, 0.0])
    ends = np.empty((3, 3))  # the centre of the eye, the end of the arm, the laid point
    leaves = np.empty(3)
    points_before = np.full((4, 3), math.inf)
    room_m, hint = -math.inf, 0
    for i in range(len(eyes)):
        q = eyes[i]
        ends[0, 0], ends[0, 1], ends[0, 2], _, _, _ = centre(q, no_rates, payout)
        ends[1, 0], ends[1, 1], ends[1, 2], _, _, _ = turned(across_vector, q, no_rates)
        for j in range(3):
            ends[1, j] = ends[0, j] + sizes[2] * ends[1, j]
        known = math.isfinite(laid[i, 0])
        if known:
            hint = free_fibre(laid[i], q, table, payout, hint, ends[2], leaves)
        moved_m = 0.0
        for k in range(4 if known else 2):
            point = leaves if k == 3 else ends[k]
            moved2_m2 = 0.0
            for j in range(3):
                moved2_m2 += (point[j] - points_before[k, j]) ** 2
                points_before[k, j] = point[j]
            moved_m = max(moved_m, math.sqrt(moved2_m2))
        if not known:
            points_before[2, 0] = math.inf
        room_m -= moved_m
        limit = min(least, 0.0)
        if room_m >= limit:
            continue
        room_m, closest = _least_room(ends, leaves, known, sizes, line, boxes, rings)
        if room_m < limit:
            found[i], pair[i] = -room_m, closest
        least = min(least, room_m)
    return least
