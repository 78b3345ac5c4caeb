"""Contour and progress error of a single run, in a sweep without a loop over runs.

A loop over one run costs more than its content. The number of axes is not known at compile time:
one function serves all machines. The operations and their order are the same as in the loops over
many runs (``nearest``, ``boxes``, ``places``): a run gives the same bits alone or with others.
"""

from __future__ import annotations

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.verdict.bow import (
    Bows,
    Span,
    bow_across,
    deviation,
    may_be_farther,
    search_span,
)
from threadline.verdict.contour import ContourPart
from threadline.verdict.nearest import Candidates, Chords, Search, Shares, search_segment
from threadline.verdict.places import Command, ProgressPart, ahead


def _nearest_chords(
    points: FloatArray,
    candidates: Candidates,
    chords: Chords,
    share: FloatArray,
    squared: FloatArray,
    chord: IntArray,
) -> None:
    """Fill in the squared distance of each of (n, axes) points to its candidate chords.

    ``chord`` becomes the first of the nearest chords. ``share``, (n, axes), weighs the axes; empty
    means equal weights. As ``nearest.nearest_of_all``.
    """
    begin, end = candidates
    vertices, vector, length = chords
    axes, weighted = points.shape[1], len(share) > 0
    for i in range(len(points)):
        least, nearest = np.inf, begin[i]
        for c in range(begin[i], end[i] + 1):
            along, size, away = 0.0, length[c], 0.0
            if weighted:
                size = 0.0
                for a in range(axes):
                    part = share[i, a] * vector[c, a]
                    along += share[i, a] * (points[i, a] - vertices[c - 1, a]) * part
                    size += part * part
                size = size if size > 0.0 else 1.0
            else:
                for a in range(axes):
                    along += (points[i, a] - vertices[c - 1, a]) * vector[c, a]
            where = min(1.0, max(0.0, along / size))
            for a in range(axes):
                gap = points[i, a] - vertices[c - 1, a] - where * vector[c, a]
                if weighted:
                    gap *= share[i, a]
                away += gap * gap
            if away < least:
                least, nearest = away, c
        squared[i], chord[i] = least, nearest


nearest_of_one = njit(nogil=True)(_nearest_chords)


def _to_vertex(
    points: FloatArray,
    before: FloatArray,
    i: int,
    vertices: FloatArray,
    v: int,
    share: FloatArray,
    tangents: FloatArray,
) -> tuple[float, float]:
    """Return the squared distance of vertex v to the path into sample i, and its place (0..1)."""
    axes, weighted = points.shape[1], len(share) > 0
    bowed = len(tangents) > 0
    along, size, away = 0.0, 0.0, 0.0
    for a in range(axes):
        start = points[i - 1, a] if i else before[a, 0]
        weight = share[v, a] if weighted else 1.0
        step = weight * (points[i, a] - start)
        along += weight * (vertices[v, a] - start) * step
        size += step * step
    where = min(1.0, max(0.0, along / (size if size > 0.0 else 1.0)))
    for a in range(axes):
        start = points[i - 1, a] if i else before[a, 0]
        gap = vertices[v, a] - start - where * (points[i, a] - start)
        if bowed:
            m0, m1 = tangents[i, a, 0], tangents[i + 1, a, 0]
            gap -= deviation(where, points[i, a] - start, m0, m1)
        if weighted:
            gap *= share[v, a]
        away += gap * gap
    if bowed:
        last = 0.0
        for a in range(axes):
            gap = vertices[v, a] - points[i, a]
            if weighted:
                gap *= share[v, a]
            last += gap * gap
        where = 1.0 if last < away else where
        away = min(away, last)
    return away, where


_to_vertex_fast = njit(nogil=True)(_to_vertex)


def _raise_and_lower(
    points: FloatArray,
    squared: FloatArray,
    chord: IntArray,
    vertices: FloatArray,
    shares: Shares,
    bows: Bows,
    part: ContourPart,
) -> None:
    """Raise the farthest place by the samples and the paths between; lower vertex distances.

    ``squared`` and ``chord``, (n,), belong to the nearest chord of each sample. A vertex that is
    already as near as the farthest place is skipped.
    """
    bowed, tangents, most = bows
    # Each tuple access would count references.
    share, vertex_share = shares
    (
        begin, end, time_s, before, chord_before, fresh, farthest, closest, _, _, off,
        tangent_before,
    ) = part  # fmt: skip
    worst, at, place, nearest = farthest
    best, best_time_s = closest
    samples, axes = points.shape
    here, there, weights = np.empty(axes), np.empty(axes), np.ones(axes)
    if fresh:
        for a in range(axes):
            before[a, 0] = points[0, a]
        chord_before[0], off[0] = chord[0], squared[0]
    m0, m1 = np.empty(axes), np.empty(axes)
    run = len(worst) - 1  # 0: a literal would be compiled once more
    for i in range(samples):
        if squared[i] > worst[0]:
            worst[0], at[0], place[0], nearest[0] = squared[i], i, 1.0, chord[i]
        near_start = chord[i - 1] if i else chord_before[0]
        if bowed or chord[i] != near_start:
            for a in range(axes):
                here[a] = points[i - 1, a] if i else before[a, 0]
                there[a] = points[i, a]
                if len(share):
                    weights[a] = share[i, a]
        low, high = min(begin[i], begin[i + 1]), max(end[i], end[i + 1])
        if chord[i] != near_start:
            search = Search(vertices, low, high, near_start, chord[i])
            search_segment(here, there, weights, search, farthest, run, i)
        if bowed:
            long = 0.0
            if chord[i] != near_start:
                for a in range(axes):
                    long += (weights[a] * (there[a] - here[a])) ** 2
                long = np.sqrt(long)
            first = squared[i - 1] if i else off[0]
            bow = most[i, 0, 0]
            if may_be_farther(first, squared[i], long, bow, worst[0]):
                for a in range(axes):
                    m0[a], m1[a] = tangents[i, a, 0], tangents[i + 1, a, 0]
                span = Span(here, there, m0, m1)
                search = Search(vertices, low, high, near_start, chord[i])
                if long == 0.0:
                    bow = bow_across(span, weights, search, bow)
                if may_be_farther(first, squared[i], long, bow, worst[0]):
                    search_span(span, weights, search, farthest, run, i)
        least = worst[0]
        for v in range(begin[i] - 1, end[i + 1] + 1):
            if best[v, 0] > least:
                away, where = _to_vertex_fast(
                    points, before, i, vertices, v, vertex_share, tangents
                )
                if away < best[v, 0]:
                    best[v, 0] = away
                    best_time_s[v, 0] = time_s[i] + where * (time_s[i + 1] - time_s[i])
    for a in range(axes):
        before[a, 0] = points[samples - 1, a]
    chord_before[0], off[0] = chord[samples - 1], squared[samples - 1]
    for a in range(axes if bowed else 0):
        tangent_before[a, 0] = tangents[samples, a, 0]


contour_of_one = njit(nogil=True)(_raise_and_lower)


def _advance(
    points: FloatArray,
    off: FloatArray,
    command: Command,
    counts: tuple[int, int, int],
    places: IntArray,
    value: FloatArray,
    worst: FloatArray,
    at: IntArray,
    side: FloatArray,
) -> None:
    """Advance the places of the command by (n, axes) samples: ``places.move_on`` for one run.

    ``counts`` are ``first``, ``number`` and ``lag`` of the ``ProgressPart``.
    """
    first, number, lag = counts
    commanded, vector, inverse, length, heading = command
    samples, axes = points.shape
    rows, origin = len(value), number - first
    low, high, most = places[0], places[1], worst[0]
    for i in range(samples):
        last = first + i
        begin = max(last - lag, 0)
        carry, least = 0.0 if number + i == 0 else np.inf, np.inf
        if low < begin:  # beyond the lag: the tool must have passed these
            carry = value[(origin + min(begin - 1, high)) % rows, 0]
            low = begin
        k, row = low, (origin + low) % rows
        while True:
            # Only the end of the first place is within the lag.
            start, per_square, long = (k - 1, inverse[k], length[k]) if k > begin else (k, 0.0, 0.0)
            left, held = carry, value[row, 0] if k <= high else carry
            along, away = 0.0, 0.0
            for a in range(axes):
                along += (points[i, a] - commanded[start, a]) * vector[k, a]
            place = along * per_square
            where = min(1.0, max(0.0, place))
            for a in range(axes):
                gap = points[i, a] - commanded[start, a] - where * vector[k, a]
                away += gap * gap
            error = away - off[i]
            behind = np.sqrt(left) - where * long
            if behind > 0.0 and behind * behind > error:
                beside, room = (where - place) * long, (1.0 - where) * long
                on = (behind * behind - error) / (2.0 * (behind + beside))
                on = min(room, on)
                on = max(0.0, on)
                error += on * (2.0 * beside + on)
            error = max(held, error)
            least = min(least, error)
            value[row, 0] = least
            carry = held
            if k == last or not least > most:  # good enough: no later place is better
                break
            k, row = k + 1, row + 1 if row + 1 < rows else 0
        high = k
        if least > most:
            most, at[0] = least, number + i
            k = low
            while value[(origin + k) % rows, 0] > least:
                k += 1
            within = k > begin
            start, per_square = (k - 1, inverse[k]) if within else (k, 0.0)
            side[0] = ahead(points[i], commanded[start], vector[k], per_square, heading[k])
    places[0], places[1], worst[0] = low, high, most


_advance_fast = njit(nogil=True)(_advance)


def progress_of_one(points: FloatArray, off: FloatArray, part: ProgressPart) -> None:
    """Advance the places of the command by (n, axes) samples at ``off``, squared, from the path."""
    # Compiled code would unpack all of ``part``.
    counts = part.first, part.number, part.lag
    _advance_fast(
        points, off, part.command, counts, part.places, part.value, part.worst, part.at, part.side
    )
