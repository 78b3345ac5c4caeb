"""Arcs of G2 and G3, found again among the chords that the reader made of them.

The chords of one block have its line, follow each other, are alike and turn alike, and their arc is
at most 2 um away from them. LinuxCNC runs such an arc as one move. As the ends of arcs are rounded
in programs, the radius may change a little on the way.
"""
# mypy: disable-error-code="no-untyped-def,untyped-decorator"

from __future__ import annotations

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.compiled import njit

_ALIKE = 2e-3  # share of a chord
_OFF_MM = 2e-3
_SAG_MM = 2.001e-3  # the reader's own 2 um


@njit()
def ends_of_bows(way, line, alone):
    """Return the (n,) first move of the arc or line that each of n moves is of.

    Parameters
    ----------
    way : (n, axes)
        Of the moves, mm.
    line : (n,)
        Of the file.
    alone : (n,) bool
        Whether X, Y and Z alone move.
    """
    count = len(way)
    found = np.arange(count)
    first, sure, cosine = 0, 0.0, 1.0
    for i in range(1, count):
        size, last, both, off = 0.0, 0.0, 0.0, 0.0
        for k in range(way.shape[1]):
            size += way[i, k] ** 2
            last += way[i - 1, k] ** 2
            both += way[i, k] * way[i - 1, k]
        size, last = np.sqrt(size), np.sqrt(last)
        goes = line[i] == line[i - 1] and alone[i] and alone[i - 1] and both > 0.0
        if not goes:
            first = found[i] = i
            continue
        if i - first == 1:
            sure, cosine = last, min(1.0, max(-1.0, both / (size * last)))
        else:
            for k in range(way.shape[1]):
                off = max(off, abs(way[i, k] - 2.0 * cosine * way[i - 1, k] + way[i - 2, k]))
        # From a chord c of the angle h an arc is c tan(h / 4) / 2 away.
        sag = 0.5 * size * np.tan(0.25 * np.arccos(cosine))
        goes = 0.0 < sag < _SAG_MM and max(abs(size - sure), off) <= _ALIKE * size
        if not goes:
            first = i
        found[i] = first
    return found


def circle(points: FloatArray) -> tuple[float, FloatArray, FloatArray, float] | None:
    """Return radius, first direction, direction to the centre and angle of an arc; None for none.

    Parameters
    ----------
    points
        (k, axes) ends of its chords, alike, k > 2; mm.
    """
    count = len(points) - 1
    a, b, c = points[0], points[max(1, count // 3)], points[max(2, 2 * count // 3)]
    u, v = b - a, c - a
    uu, vv, uv = u @ u, v @ v, u @ v
    down = 2.0 * (uu * vv - uv**2)
    centre = (vv * (uu - uv) * u + uu * (vv - uv) * v) / down
    radius = float(np.sqrt(centre @ centre))
    inward = centre / radius
    along = u - (u @ inward) * inward
    along /= np.sqrt(along @ along)
    away = points - a - centre
    if np.abs(np.sqrt((away**2).sum(axis=1)) - radius).max() > _OFF_MM:
        return None
    over = away[-1]
    angle = np.arctan2(over @ along, -(over @ inward)) % (2.0 * np.pi)
    chord = points[1] - a
    each = 2.0 * np.arcsin(min(1.0, float(np.sqrt(chord @ chord)) / (2.0 * radius)))
    turns = np.round((each * count - angle) / (2.0 * np.pi))
    # The curve ends where the last chord does: its radius changes a little.
    return radius, along, inward, float(angle + 2.0 * np.pi * turns)


def rows_of(first: IntArray) -> list[tuple[int, int]]:
    """Return first and last move of each run of two or more that have the same ``first``."""
    begins = np.flatnonzero(first == np.arange(len(first)))
    stops = np.append(begins[1:], len(first)) - 1
    return [(int(a), int(b)) for a, b in zip(begins, stops, strict=True) if b > a]
