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


@njit(error_model="numpy")
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
    t, turned = np.empty((legs, axes)), np.zeros(legs)
    uneven, length = 0, 0.0
    for i in range(legs):
        squared = 0.0
        for j in range(axes):
            t[i, j] = (positions[start + i + 1, j] - positions[start + i, j]) * radius_m[j]
            squared += t[i, j] ** 2
        size = np.sqrt(squared)
        length += size
        per, squared, changed = 1.0 / size, 0.0, 0.0
        for j in range(axes):
            t[i, j] *= per
            if i > 0:
                squared += (t[i, j] - t[i - 1, j]) ** 2
            if i > 1:
                changed += (t[i, j] - 2.0 * t[i - 1, j] + t[i - 2, j]) ** 2
        turned[i] = np.sqrt(squared)
        if turned[i] <= STRAIGHT:
            turned[i] = 0.0
        if (
            changed > (LIKE * max(turned[i], turned[i - 1])) ** 2
            and turned[i] + turned[i - 1] > 0.0
        ):
            uneven += 1
    if 2 * uneven <= legs or length > DENSE * cut_m * legs:
        return SMOOTH
    rough = 0
    for i in range(APART, legs):
        squared, total = 0.0, 0.0
        for j in range(axes):
            squared += (t[i, j] - t[i - APART, j]) ** 2
        for k in range(i - APART, i):
            total += turned[k + 1]
        if squared < (ALIKE * total) ** 2:
            rough += 1
    return ROUGH if 2 * rough >= legs - APART else UNEVEN


@njit(error_model="numpy")
def legs_kept(positions, radius_m, cut_m):
    """Return which legs, by the vertex where they begin, a corner at an end of theirs needs.

    A spline that follows the vertices there cuts the corner by more than ``cut_m``, as
    ``corner_spacing`` has it, so that points are added on the leg.
    """
    count, axes = positions.shape
    kept = np.zeros(count, dtype=np.bool_)
    a, b = np.zeros(axes), np.zeros(axes)
    least, square = 16.0 * cut_m * cut_m, 0.0
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
