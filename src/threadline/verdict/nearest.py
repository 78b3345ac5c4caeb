"""Distances between the actual paths of many runs and the programmed path, within a window.

Runs are adjacent in memory, (samples, axes, runs): the geometry of a chord is computed once, and
the innermost loop, over the runs, becomes vector instructions. Each run gets the same operations as
when it is alone, so its result does not depend on the other runs, to the bit.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit

_FINEST = 1.0 / 4096  # of a segment: the shortest part that is examined
_NOTHING_M2 = 1e-26  # a point this close to the path lies on it, up to rounding
_MOST_PARTS = 32  # parts of a segment that wait: one for each halving, down to the finest


class Chords(NamedTuple):
    """Chords of the programmed path: chord c leads from vertex c - 1 to vertex c.

    ``vertices`` and ``vector`` are (m, axes), ``squared``, (m,), is the squared length of each
    vector, or 1 for a chord without length. Row 0 of ``vector`` and ``squared`` is unused.
    """

    vertices: FloatArray
    vector: FloatArray
    squared: FloatArray


class Candidates(NamedTuple):
    """(n,) first and last chord that each sample is compared with."""

    begin: IntArray
    end: IntArray


class Nearest(NamedTuple):
    """The nearest chord of each sample.

    ``squared``, (n, runs), is the squared distance to it. ``chord``, (n, runs), is its number,
    unless ``common``, (n,), gives one number for all runs; ``common`` is -1 where the runs differ.
    """

    squared: FloatArray
    chord: IntArray
    common: IntArray


class Track(NamedTuple):
    """Samples of all runs, n of them, and in row 0 the sample before the first.

    ``points``, (n + 1, axes, runs), are lengths at the tool, ``time_s``, (n + 1,), their instants;
    ``begin`` and ``end``, (n + 1,), are the candidate chords of each. Row 1 is sample ``first`` of
    the block.
    """

    points: FloatArray
    time_s: FloatArray
    begin: IntArray
    end: IntArray
    first: int


class Shares(NamedTuple):
    """Weights of the axes where a mandrel's radius varies; empty means equal weights.

    ``samples`` is (n, axes), or (n, axes, runs) for many runs; ``vertices`` is (vertices, axes).
    """

    samples: FloatArray
    vertices: FloatArray


class Search(NamedTuple):
    """Chords to search for the nearest to a segment between two samples of one run.

    Candidates are ``low`` to ``high`` of the chords between ``vertices``. ``near_start`` and
    ``near_end`` are the nearest chords of the two samples.
    """

    vertices: FloatArray
    low: int
    high: int
    near_start: int
    near_end: int


class Farthest(NamedTuple):
    """The place of each run that is farthest from the programmed path so far; all are (runs,).

    ``squared`` is its squared distance, and ``chord`` the chord nearest to it. It lies on the
    segment that leads to sample ``at`` of the block, at the share ``part`` (0..1) of the segment.
    """

    squared: FloatArray
    at: IntArray
    part: FloatArray
    chord: IntArray


class Closest(NamedTuple):
    """The closest approach of each run to each vertex so far; both are (vertices, runs)."""

    squared: FloatArray
    time_s: FloatArray


def _weighted_to_segment(
    point: FloatArray, start: FloatArray, end: FloatArray, share: FloatArray
) -> float:
    """Return the squared distance of a point to a segment, each axis weighted with its share."""
    along = 0.0
    length = 0.0
    for k in range(len(point)):
        direction = share[k] * (end[k] - start[k])
        along += share[k] * (point[k] - start[k]) * direction
        length += direction * direction
    where = 0.0 if length <= 0.0 else min(max(along / length, 0.0), 1.0)
    squared = 0.0
    for k in range(len(point)):
        gap = share[k] * (point[k] - start[k] - where * (end[k] - start[k]))
        squared += gap * gap
    return squared


weighted_to_segment = njit(nogil=True)(_weighted_to_segment)


def chord_vectors(vertices: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the (m, axes) vector of each chord, and (m,) its squared length.

    Chord c ends at vertex c; row 0 is unused. If the squared length has lost digits, or its inverse
    is infinite, the chord counts as a point and the squared length is 1.
    """
    vector = np.diff(vertices, axis=0, prepend=vertices[:1])
    squared = lengths_squared(vector)
    return vector, np.where(squared > np.finfo(np.float64).tiny, squared, 1.0)


def chords_of(vertices: FloatArray) -> Chords:
    """Return the chords between (m, axes) vertices."""
    return Chords(vertices, *chord_vectors(vertices))


def lengths_squared(vectors: FloatArray) -> FloatArray:
    """Return (m,) squared lengths of (m, axes) vectors, faster than numpy's sum over axes."""
    squared = vectors[:, 0] ** 2
    for axis in range(1, vectors.shape[1]):
        squared += vectors[:, axis] ** 2
    return squared


def _nearest_of_all(
    point: FloatArray,
    begin: int,
    end: int,
    chords: Chords,
    axes: tuple[int, ...],
    share: FloatArray | None,
    squared: FloatArray,
    chord: IntArray,
) -> None:
    """Fill in the squared distance of a point of each run to the chords ``begin`` to ``end``.

    ``chord`` becomes the first of the nearest chords. ``axes`` is a tuple with one entry per axis:
    its length is known at compile time, so the compiler unrolls loops over axes. It also removes
    the tests of ``share``.
    """
    vertices, vector, length = chords
    runs = len(squared)
    for r in range(runs):
        squared[r] = np.inf
        chord[r] = begin
    for c in range(begin, end + 1):
        for r in range(runs):
            along = 0.0
            size = length[c]
            if share is None:
                for a in range(len(axes)):
                    along += (point[a, r] - vertices[c - 1, a]) * vector[c, a]
            else:
                size = 0.0
                for a in range(len(axes)):
                    weighted = share[a, r] * vector[c, a]
                    along += share[a, r] * (point[a, r] - vertices[c - 1, a]) * weighted
                    size += weighted * weighted
                size = size if size > 0.0 else 1.0
            where = min(1.0, max(0.0, along / size))
            away = 0.0
            for a in range(len(axes)):
                gap = point[a, r] - vertices[c - 1, a] - where * vector[c, a]
                if share is not None:
                    gap *= share[a, r]
                away += gap * gap
            nearer = away < squared[r]
            squared[r] = away if nearer else squared[r]
            chord[r] = c if nearer else chord[r]


nearest_of_all = njit(nogil=True)(_nearest_of_all)


def _nearest_chords(
    points: FloatArray,
    candidates: Candidates,
    chords: Chords,
    axes: tuple[int, ...],
    share: FloatArray | None,
    squared: FloatArray,
    chord: IntArray,
) -> None:
    """Fill in the squared distance of each of (n, axes, runs) points to its candidate chords.

    ``chord`` becomes the first of the nearest chords. ``share`` has the shape of the points; None
    means equal weights of the axes.
    """
    begin, end = candidates
    for i in range(len(points)):
        if share is None:
            nearest_of_all(points[i], begin[i], end[i], chords, axes, None, squared[i], chord[i])
        else:
            nearest_of_all(
                points[i], begin[i], end[i], chords, axes, share[i], squared[i], chord[i]
            )


def _most_between(
    first: float, second: float, start: FloatArray, end: FloatArray, share: FloatArray
) -> float:
    """Return an upper bound of squared distances on a segment, given the distances of its ends."""
    squared = 0.0
    for k in range(len(start)):
        squared += (share[k] * (end[k] - start[k])) ** 2
    return float((0.5 * (np.sqrt(first) + np.sqrt(second) + np.sqrt(squared))) ** 2)


_most_between_fast = njit(nogil=True)(_most_between)


def _none_farther(
    start: FloatArray, end: FloatArray, share: FloatArray, search: Search, least: float
) -> bool:
    """Return whether no place of a segment is farther than ``least``, squared, by three bounds."""
    vertices, low, _, near_start, near_end = search
    first_chord, chord = max(near_start, low), near_end
    # One chord near both ends is enough: no place of the segment is farther from it than an end.
    second = weighted_to_segment(end, vertices[chord - 1], vertices[chord], share)
    other = weighted_to_segment(start, vertices[chord - 1], vertices[chord], share)
    if max(other, second) <= least:
        return True
    # Nor can a place be farther than half of the segment plus the distances of both ends.
    first = weighted_to_segment(start, vertices[first_chord - 1], vertices[first_chord], share)
    if _most_between_fast(first, second, start, end, share) <= least:
        return True
    if abs(chord - first_chord) != 1:
        return False
    # The vertex between the chords splits the segment: each part is near its own chord.
    joint = weighted_to_segment(vertices[min(first_chord, chord)], start, end, share)
    return max(first, second, joint) <= least


def _same_chord(first: IntArray, first_common: int, second: IntArray, second_common: int) -> bool:
    """Return whether all chord numbers are equal; a ``common`` number counts unless it is < 0."""
    if first_common >= 0 and second_common >= 0:
        return first_common == second_common
    others = 0
    for r in range(len(first)):
        one = first_common if first_common >= 0 else first[r]
        others += one != (second_common if second_common >= 0 else second[r])
    return others == 0


_none_farther_fast = njit(nogil=True)(_none_farther)
_same_chord_fast = njit(nogil=True)(_same_chord)


def _search_segment(
    start: FloatArray,
    end: FloatArray,
    share: FloatArray,
    search: Search,
    farthest: Farthest,
    r: int,
    number: int,
) -> None:
    """Raise the farthest place of run ``r`` where a straight segment is farther than its ends.

    ``start`` and ``end``, (axes,), are two successive samples, the second of them ``number``;
    ``share``, (axes,), weights the axes. The segment is halved until a bound settles each part.
    """
    worst, at, part, worst_chord = farthest
    least = max(worst[r], _NOTHING_M2)
    if _none_farther_fast(start, end, share, search, least):
        return
    vertices, low, high, _, _ = search
    axes = len(start)
    lows, highs = np.empty(_MOST_PARTS), np.empty(_MOST_PARTS)
    here, there = np.empty(axes), np.empty(axes)
    left = 1
    lows[0], highs[0] = 0.0, 1.0
    while left:
        left -= 1
        a, b = lows[left], highs[left]
        for n in range(axes):
            here[n] = start[n] + a * (end[n] - start[n])
            there[n] = start[n] + b * (end[n] - start[n])
        # No place of this part is farther than its ends from any single chord.
        bound = np.inf
        for c in range(low, high + 1):
            first = weighted_to_segment(here, vertices[c - 1], vertices[c], share)
            second = weighted_to_segment(there, vertices[c - 1], vertices[c], share)
            bound = min(bound, max(first, second))
        if bound <= max(worst[r], _NOTHING_M2) or b - a < _FINEST:
            continue
        middle = 0.5 * (a + b)
        for n in range(axes):
            here[n] = 0.5 * (here[n] + there[n])
        best, nearest = np.inf, -1
        for c in range(low, high + 1):
            away = weighted_to_segment(here, vertices[c - 1], vertices[c], share)
            if away < best:
                best, nearest = away, c
        if best > worst[r]:
            worst[r], at[r], part[r], worst_chord[r] = best, number, middle, nearest
        if left + 2 <= _MOST_PARTS:
            lows[left], highs[left] = a, middle
            lows[left + 1], highs[left + 1] = middle, b
            left += 2


search_segment = njit(nogil=True)(_search_segment)


def _raise_to_segments(
    track: Track,
    nearest: Nearest,
    vertices: FloatArray,
    share: FloatArray | None,
    farthest: Farthest,
) -> None:
    """Raise the farthest places where a segment between two samples is farther than its ends.

    The distance to one chord is largest at an end of the segment; the distance to the nearer of two
    chords may be larger in between. ``nearest`` has a row for each row of ``track``. Axes are
    weighted with the shares at the end of the segment, ``share``, (n, axes, runs); None means
    equal weights.
    """
    points, _, begin, end, number = track
    _, chord, common = nearest
    axes = points.shape[1]
    here, there, weights = np.empty(axes), np.empty(axes), np.ones(axes)
    for i in range(len(points) - 1):
        if _same_chord_fast(chord[i + 1], common[i + 1], chord[i], common[i]):
            continue
        low, high = min(begin[i], begin[i + 1]), max(end[i], end[i + 1])
        for r in range(points.shape[2]):
            near_start = common[i] if common[i] >= 0 else chord[i, r]
            near_end = common[i + 1] if common[i + 1] >= 0 else chord[i + 1, r]
            if near_end == near_start:
                continue
            for a in range(axes):
                here[a] = points[i, a, r]
                there[a] = points[i + 1, a, r]
                if share is not None:
                    weights[a] = share[i, a, r]
            search = Search(vertices, low, high, near_start, near_end)
            search_segment(here, there, weights, search, farthest, r, number + i)


def _charge_trailing(
    points: FloatArray,
    candidates: Candidates,
    left: FloatArray,
    vertices: FloatArray,
    share: FloatArray | None,
    nearest: Nearest,
) -> None:
    """Raise the squared distance of a sample that is nearest to a place it should have left.

    ``left`` is the share of chord ``begin[i]`` that the command had left behind by the lag before
    sample i. ``share``, (n, axes, runs), weights the axes; None means equal weights.
    """
    begin, end = candidates
    squared, chord, common = nearest
    axes = points.shape[1]
    point, weights, start = np.empty(axes), np.ones(axes), np.empty(axes)
    for i in range(len(points)):
        first = begin[i]
        if left[i] <= 0.0 or common[i] > first:
            continue
        for r in range(points.shape[2]):
            if common[i] < 0 and chord[i, r] != first:
                continue
            along, length = 0.0, 0.0
            for a in range(axes):
                if share is not None:
                    weights[a] = share[i, a, r]
                step = weights[a] * (vertices[first, a] - vertices[first - 1, a])
                along += weights[a] * (points[i, a, r] - vertices[first - 1, a]) * step
                length += step * step
            if along >= left[i] * length:
                continue
            for a in range(axes):
                point[a] = points[i, a, r]
                step = vertices[first, a] - vertices[first - 1, a]
                start[a] = vertices[first - 1, a] + left[i] * step
            least = weighted_to_segment(point, start, vertices[first], weights)
            for c in range(first + 1, end[i] + 1):
                away = weighted_to_segment(point, vertices[c - 1], vertices[c], weights)
                least = min(least, away)
            squared[i, r] = max(least, squared[i, r])


nearest_chords_each = njit(nogil=True)(_nearest_chords)
charge_trailing = njit(nogil=True)(_charge_trailing)
raise_to_segments = njit(nogil=True)(_raise_to_segments)


def nearest_chords(
    points: FloatArray,
    begin: IntArray,
    end: IntArray,
    vertices: FloatArray,
    share: FloatArray | None = None,
) -> tuple[FloatArray, IntArray]:
    """Return (n, runs) squared distances to the chords ``begin[i]`` to ``end[i]``, and the nearest.

    Parameters
    ----------
    points
        (n, axes, runs).
    vertices
        (m, axes).
    share
        (n, axes, runs) weights of the axes at each point; None for equal weights.
    """
    samples, axes, runs = points.shape
    squared = np.empty((samples, runs))
    chord = np.empty((samples, runs), dtype=np.int64)
    candidates, chords = Candidates(begin, end), chords_of(vertices)
    nearest_chords_each(points, candidates, chords, (0,) * axes, share, squared, chord)
    return squared, chord
