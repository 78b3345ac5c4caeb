"""How rough a program is: whether its turns are those of a curve, or of points beside one."""
# mypy: disable-error-code="no-untyped-def,untyped-decorator"

from __future__ import annotations

import numpy as np

from threadline.compiled import njit
from threadline.path.polygon import STRAIGHT

APART = 4  # legs between the directions that are compared
ALIKE = 0.28
"""A program is rough where directions change by less than this share of all turns between."""
LIKE = 0.3
"""It is uneven where a turn differs by more than this share from the one before."""
DENSE = 4.0
"""Vertices are dense where legs are shorter, on average, than as many tolerances."""
SMOOTH, UNEVEN, ROUGH = 0, 1, 2


@njit()
def roughness(positions, radius_m, cut_m, start, stop):
    """Return how the program is between two vertices, by what most of its legs are.

    Turns of a smooth curve are alike. Where they are not, the program is uneven; where most of
    them undo each other, it is rough. Where vertices are not dense it is taken as it stands.
    """
    axes, legs = positions.shape[1], stop - start
    if legs <= APART:
        return SMOOTH
    squared = 0.0
    for j in range(axes):
        squared += ((positions[stop, j] - positions[start, j]) * radius_m[j]) ** 2
    if squared > (DENSE * cut_m * legs) ** 2:
        return SMOOTH  # told without their turns: legs are no shorter than the way between
    # Axis after axis, so that no step of a loop hangs on the one before.
    sums = np.zeros((axes + 3, legs))  # one array: making it takes as long as using it
    t, size, turned, changed = sums[3:], sums[0], sums[1], sums[2]
    for j in range(axes):
        for i in range(legs):
            t[j, i] = (positions[start + i + 1, j] - positions[start + i, j]) * radius_m[j]
            size[i] += t[j, i] * t[j, i]
    for i in range(legs):
        size[i] = np.sqrt(size[i])
    length = 0.0
    for i in range(legs):
        length += size[i]
    for i in range(legs):
        size[i] = 1.0 / size[i]
    for j in range(axes):
        for i in range(legs):
            t[j, i] *= size[i]
        for i in range(1, legs):
            turned[i] += (t[j, i] - t[j, i - 1]) ** 2
        for i in range(2, legs):
            changed[i] += (t[j, i] - 2.0 * t[j, i - 1] + t[j, i - 2]) ** 2
    uneven = 0
    for i in range(1, legs):
        turned[i] = np.sqrt(turned[i])
        turned[i] = turned[i] if turned[i] > STRAIGHT else 0.0
        most = max(turned[i], turned[i - 1])
        uneven += (most > 0.0) & (changed[i] > (LIKE * most) ** 2)
    if 2 * uneven <= legs or length > DENSE * cut_m * legs:
        return SMOOTH
    rough, total = 0, 0.0
    size[:] = 0.0
    for j in range(axes):
        for i in range(APART, legs):
            size[i] += (t[j, i] - t[j, i - APART]) ** 2
    for i in range(APART, legs):
        total = turned[i - 3] + turned[i - 2] + turned[i - 1] + turned[i]
        rough += size[i] < (ALIKE * total) ** 2
    return ROUGH if 2 * rough >= legs - APART else UNEVEN


@njit()
def legs_kept(positions, radius_m, cut_m):
    """Return which legs, by the vertex where they begin, a corner at an end of theirs needs.

    A spline that follows the vertices there cuts the corner by more than ``cut_m``, as
    ``corner_spacing`` has it, so that points are added on the leg. Without rows where no leg is
    long enough for that.
    """
    count, axes = positions.shape
    least, square = 16.0 * cut_m * cut_m, 0.0
    if axes == 3:  # most are; no step hangs on another, so that it takes a fifth of the time
        r0, r1, r2 = radius_m[0], radius_m[1], radius_m[2]
        longer = 0
        for i in range(1, count):
            x = (positions[i, 0] - positions[i - 1, 0]) * r0
            y = (positions[i, 1] - positions[i - 1, 1]) * r1
            z = (positions[i, 2] - positions[i - 1, 2]) * r2
            longer += 4.0 * (x * x + y * y + z * z) > least
        if longer == 0:
            return np.zeros(0, dtype=np.bool_)
    kept = np.zeros(count, dtype=np.bool_)
    a, b = np.zeros(axes), np.zeros(axes)
    for i in range(count - 1):
        own = 0.0
        for j in range(axes):
            b[j] = (positions[i + 1, j] - positions[i, j]) * radius_m[j]
            own += b[j] * b[j]
        if i > 0 and 4.0 * max(own, square) > least:  # no turn is above 2
            q = np.sqrt(own / square)
            turned = 0.0  # square of the turn times the leg
            for j in range(axes):
                turned += (b[j] - q * a[j]) ** 2
            kept[i] = turned > least
            if turned > least * q * q:
                kept[i - 1] = True
        for j in range(axes):
            a[j] = b[j]
        square = own
    return kept
