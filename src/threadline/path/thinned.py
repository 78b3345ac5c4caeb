"""Fewer vertices where a program is rough: one chord for many that lie beside it.

Points that were measured, or rounded by the program that wrote them, stand a little beside the
curve that is meant. A path that follows each of them turns at every one. Here one chord takes the
place of all legs whose vertices lie within a share of the tolerance of it, in order; its ends need
not be vertices. Where the program is smooth, and at corners that the tolerance rounds on the legs
beside them, the vertices stay as they are, bit for bit.
"""
# mypy: disable-error-code="no-untyped-def,untyped-decorator"

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from threadline.arrays import FloatArray
from threadline.compiled import njit
from threadline.path.roughness import ROUGH, SMOOTH, UNEVEN, legs_kept, roughness
from threadline.path.runs import Chunk, Vertices, join_vertices

SHARES = np.array([0.2, 0.36, 0.49, 0.59])
"""Of the tolerance, what vertices may be beside a chord: the first at which it passes enough.

On a curve chords of the share e turn by so much that the spline cuts four times as much; what
is added from share to share is a quarter of what the share leaves for that.
"""
MOST = 512  # vertices of a chord
LEAST = 4  # legs of a chord: fewer are not worth the tolerance
MANY = 12  # legs of a chord where the program is uneven, but not rough: there it gains less
WINDOW = 28  # legs, on which is decided how the program is
VALID = 40  # legs, for which it is then taken to be so
BENDS = 0.25
"""What an uneven program may turn beside its first chord: tighter curves gain too little."""
GROWS = 2.0  # a chord is no longer than as many of what is before it: the knots are spaced so


@dataclass(slots=True)
class Thinner:
    """Vertices of a path, chunk after chunk, with chords in place of legs where it is rough.

    Parameters
    ----------
    radius_m
        (axes,) radii of the axes.
    cut_m
        The tolerance that is shared with the spline, at the tool. ``Vertices.beside_m`` says what
        is used of it.

    Notes
    -----
    Each vertex that is left out has a place on the chord, no farther away than ``beside_m``, and
    the places are in the order of the vertices. Between two vertices the distance of both paths is
    convex. So ``beside_m`` is a bound of the Frechet distance of leg and program.
    """

    radius_m: FloatArray
    cut_m: float
    held: Vertices | None = None  # from one before the next chord's start on
    start: int = 0  # row of ``held`` where the next chord begins
    place: FloatArray = field(default_factory=lambda: np.zeros(0))  # (axes,) m, where it does
    known: tuple[int, int, int, float] = (0, SMOOTH, 0, np.inf)
    """Up to which row it is known how the program is, how it is; share and length of the last."""

    def thinned(self, chunk: Chunk) -> Chunk:
        """Return the vertices that no later one can change."""
        begun = self.held is not None
        held = self.held = join_vertices(self.held, chunk.vertices)
        if not len(held):
            return chunk
        if not begun:
            self.place = held.positions[0] * self.radius_m
        positions, beside_m, nominal_s, row, start, place, until, rough, level, before_m = _thin(
            held.positions,
            held.nominal_s,
            self.radius_m,
            self.cut_m,
            SHARES,
            chunk.ends,
            self.start,
            self.place,
            *self.known,
        )
        found = Vertices(
            positions=positions,
            nominal_s=nominal_s,
            operation=held.operation[row],
            line=held.line[row],
            beside_m=beside_m,
        )
        if not begun:
            found = join_vertices(held.take(slice(0, 1)), found)
        if chunk.ends:
            self.held, self.start = held.take(slice(-1, None)), 0
            self.place, self.known = held.positions[-1] * self.radius_m, (0, SMOOTH, 0, np.inf)
        else:
            gone = max(start - 1, 0)
            self.held, self.start = held.take(slice(gone, None)), start - gone
            self.place, self.known = place, (until - gone, rough, level, before_m)
        return Chunk(vertices=found, ends=chunk.ends, dwell_s=chunk.dwell_s)


@njit(error_model="numpy")
def _thin(
    positions, nominal_s, radius_m, cut_m, shares, ends, start, place, until, rough, level, before_m
):
    """Return the ends of the chords from row ``start`` on, and where the next one begins.

    Returns
    -------
    out, beside, time_s, row
        (n, axes) and (n,) ends, distances of what is left out, times, and rows of the vertices.
    start, place, until, rough, level, before_m
        Row and place of the last end, what is known of the rows behind it, and of the last chord.
    """
    count, axes = positions.shape
    out, beside = np.empty((count, axes)), np.empty(count)
    time_s, row = np.zeros(count), np.empty(count, dtype=np.int64)
    kept = legs_kept(positions, radius_m, cut_m)
    centre, radius, reach = np.empty((MOST, axes)), np.empty(MOST), np.empty(MOST)
    here, d = place.copy(), np.empty(axes)
    # Of what is behind the last two rows nothing is known before more vertices come.
    last = count - 1 if ends else count - 2
    n, next_kept = 0, start
    while start < last:
        if not ends and last - start < WINDOW:
            break
        if start >= until:
            rough = roughness(positions, radius_m, cut_m, start, min(last, start + WINDOW))
            until = start + (VALID if rough != SMOOTH else WINDOW)
        # Back from where a chord ended to the next vertex would be a turn where none is meant.
        aside = _from_vertex(positions, radius_m, here, start) > 0.0
        limit = start + 1
        if (aside or rough != SMOOTH) and not kept[start]:
            next_kept = max(next_kept, start)
            while next_kept < last and not kept[next_kept]:
                next_kept += 1
            limit = min(start + MOST, next_kept)
        if limit - start < LEAST:  # told here: a call with so many arrays takes longer than this
            k, met, strayed = start + 1, True, _from_vertex(positions, radius_m, here, start)
            _towards(positions, radius_m, here, k, d)
        else:
            k, met, strayed, level = _chord(
                positions, radius_m, cut_m, shares, rough, aside, level, before_m, start, limit,
                limit == last or kept[limit], not ends and limit == last and limit - start < MOST,
                here, d, centre, radius, reach,
            )  # fmt: skip
        if k < 0:
            break  # where it ends is not known yet
        if k == start + 1 and rough == UNEVEN:
            rough, until = SMOOTH, start + WINDOW  # the tube of a chord is too short for its gain
        squared = 0.0
        for j in range(axes):
            squared += d[j] * d[j]
        before_m = np.sqrt(squared)
        for j in range(axes):
            if met:  # a vertex is met bit for bit
                here[j] = positions[k, j] * radius_m[j]
                out[n, j] = positions[k, j]
            else:
                here[j] += d[j]
                out[n, j] = here[j] / radius_m[j]
        for i in range(start, k):
            time_s[n] += nominal_s[i + 1]
        row[n], beside[n] = k, strayed
        n += 1
        start = k
    return out[:n], beside[:n], time_s[:n], row[:n], start, here, until, rough, level, before_m


@njit(error_model="numpy")
def _chord(
    positions,
    radius_m,
    cut_m,
    shares,
    rough,
    aside,
    first,
    before_m,
    start,
    limit,
    meets,
    waits,
    here,
    d,
    centre,
    radius,
    reach,
):
    """Write the way ``d`` along the next chord; return the row of its end, and how it lies.

    Returns
    -------
    k
        The last vertex that the chord passes; -1 where it ``waits`` for more of them.
    met
        Whether it ends in that vertex. Where it ``meets``, it has to end so at ``limit``.
    strayed
        How far the vertices are beside it.
    """
    if limit - start >= LEAST:
        begin, end, least = max(first - 1, 0), len(shares), LEAST
        if rough != ROUGH:
            begin, end, least = 0, 1, LEAST if aside else MANY
        for level in range(begin, end):
            thin_m = shares[level] * cut_m
            k = _walked(positions, radius_m, here, start, limit, thin_m, centre, radius, reach)
            if k == limit and waits:
                return -1, False, 0.0, first
            if k - start < (LEAST if k == limit and aside else least):
                continue
            if rough != ROUGH and not aside and _turned(positions, radius_m, start, k) > BENDS:
                continue
            while k > start + 2 and reach[k - start - 1] > GROWS * before_m:
                k -= 1
            if k == limit and meets:
                _towards(positions, radius_m, here, k, d)
                strayed = _strayed(positions, radius_m, here, d, start, k)
                if strayed <= thin_m:
                    return k, True, strayed, level
                k = (start + k + 1) // 2  # two chords of like length, and no short one at the end
            squared = 0.0
            for j in range(len(d)):
                d[j] = centre[k - start - 1, j]
                squared += d[j] * d[j]
            size = reach[k - start - 1] / np.sqrt(squared)
            for j in range(len(d)):
                d[j] *= size
            strayed = _strayed(positions, radius_m, here, d, start, k)
            if strayed <= thin_m:
                return k, False, strayed, level
    _towards(positions, radius_m, here, start + 1, d)
    return start + 1, True, _from_vertex(positions, radius_m, here, start), first


@njit(error_model="numpy")
def _from_vertex(positions, radius_m, here, k):
    """Return the distance of vertex ``k`` from a place."""
    squared = 0.0
    for j in range(len(here)):
        squared += (positions[k, j] * radius_m[j] - here[j]) ** 2
    return np.sqrt(squared)


@njit(error_model="numpy")
def _turned(positions, radius_m, start, stop):
    """Return the difference of the directions of the first leg and the last between vertices."""
    axes = positions.shape[1]
    first, last, squared = 0.0, 0.0, 0.0
    for j in range(axes):
        first += ((positions[start + 1, j] - positions[start, j]) * radius_m[j]) ** 2
        last += ((positions[stop, j] - positions[stop - 1, j]) * radius_m[j]) ** 2
    first, last = np.sqrt(first), np.sqrt(last)
    for j in range(axes):
        before = (positions[start + 1, j] - positions[start, j]) / first
        after = (positions[stop, j] - positions[stop - 1, j]) / last
        squared += ((after - before) * radius_m[j]) ** 2
    return np.sqrt(squared)


@njit(error_model="numpy")
def _towards(positions, radius_m, here, k, d):
    """Write the way from ``here`` to vertex ``k``."""
    for j in range(len(d)):
        d[j] = positions[k, j] * radius_m[j] - here[j]


@njit(error_model="numpy")
def _walked(positions, radius_m, here, start, limit, thin_m, centre, radius, reach):
    """Return the last vertex up to ``limit`` that one chord from ``here`` can pass.

    Written for each vertex: of the directions of chords that pass all up to it within ``thin_m``,
    a ball (a centre and a radius), and how far the place of the vertex is along the chord.

    Notes
    -----
    A vertex at w, whose place is at the distance f, permits the directions c with |f c - w| <= e:
    a ball about w / f of the radius e / f. Of two balls that overlap, the largest one within both
    is kept. Distances do not decrease along the chord.
    """
    axes = positions.shape[1]
    w = np.empty(axes)
    far, squared = 0.0, 0.0
    for j in range(axes):
        w[j] = positions[start + 1, j] * radius_m[j] - here[j]
        squared += w[j] * w[j]
    far = np.sqrt(squared)
    if not far > 0.0:
        return start
    for j in range(axes):
        centre[0, j] = w[j] / far
    radius[0], reach[0] = thin_m / far, far
    k = start + 1
    while k < limit:
        n = k - start
        squared = 0.0
        for j in range(axes):
            w[j] = positions[k + 1, j] * radius_m[j] - here[j]
            squared += w[j] * w[j]
        far = max(far, np.sqrt(squared))
        per, gap = 1.0 / far, 0.0
        for j in range(axes):
            w[j] = w[j] * per - centre[n - 1, j]
            gap += w[j] * w[j]
        before, own = radius[n - 1], thin_m * per
        if gap <= (before - own) * (before - own):  # one ball lies within the other
            move, left = (1.0, own) if own < before else (0.0, before)
        else:
            gap = np.sqrt(gap)
            left = 0.5 * (before + own - gap)
            if not left > 0.0:
                break
            move = 0.5 * (gap + before - own) / gap
        for j in range(axes):
            centre[n, j] = centre[n - 1, j] + move * w[j]
        radius[n], reach[n] = left, far
        k += 1
    return k


@njit(error_model="numpy")
def _strayed(positions, radius_m, here, d, start, stop):
    """Return the largest distance of vertices ``start`` to ``stop`` from their places on a chord.

    The first and the last stand for its ends, the others for the nearest place behind the last.
    """
    axes = len(d)
    square = 0.0
    for j in range(axes):
        square += d[j] * d[j]
    if not square > 0.0:
        return np.inf
    per, share, worst = 1.0 / square, 0.0, 0.0
    for i in range(start, stop + 1):
        along = 0.0
        for j in range(axes):
            along += (positions[i, j] * radius_m[j] - here[j]) * d[j]
        share = min(max(share, along * per), 1.0)
        if i == start:
            share = 0.0
        elif i == stop:
            share = 1.0
        squared = 0.0
        for j in range(axes):
            squared += (positions[i, j] * radius_m[j] - here[j] - share * d[j]) ** 2
        worst = max(worst, squared)
    return np.sqrt(worst)
