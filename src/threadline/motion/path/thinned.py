"""Fewer vertices where a program is rough: one chord replaces many legs that lie beside it.

Measured points, and points rounded by a CAM program, scatter about the intended curve. A path
through all of them turns at every point. Here one chord replaces all legs whose vertices lie
within a share of the tolerance of the chord, in order; its ends need not be vertices. Where the
program is smooth, and at corners that the tolerance rounds, the vertices stay unchanged, bit for
bit.
"""
# mypy: disable-error-code="no-untyped-def,untyped-decorator"

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.base.compiled import njit
from threadline.motion.path.chords import (
    AHEAD,
    LEAST,
    ROUGH,
    SHARES,
    SMOOTH,
    UNEVEN,
    Before,
    Legs,
    Program,
    ToolChord,
    chord,
    from_vertex,
    needed_legs,
    roughness,
    squared_of,
    towards,
)
from threadline.motion.path.runs import Chunk, Vertices, join_vertices, runs
from threadline.motion.path.types import ProgrammedPath

WINDOW = 28  # legs over which the roughness is tested
VALID = 40  # legs for which the result then holds
LONGEST = 320  # largest such number: it doubles each time the program is found rough again
BEGIN = (0, SMOOTH, VALID, 0, np.inf, 0)

ENOUGH = 1024  # vertices of a chunk after chords: for fewer, a call costs more than its work


def thinned_runs(programmed: ProgrammedPath, near_m: float, cut_m: float) -> Iterator[Chunk]:
    """Yield the same as ``runs``, with chords in place of legs where the program is rough."""
    thinner = Thinner(programmed.radius_m, cut_m)
    held_parts: list[Vertices] = []
    for chunk in runs(programmed, near_m):
        new_chunk = thinner.thinned(chunk)
        held_parts += new_chunk.parts
        if new_chunk.is_last or sum(map(len, held_parts)) >= ENOUGH:
            yield replace(new_chunk, parts=tuple(held_parts))
            held_parts = []
    if any(map(len, held_parts)):
        yield Chunk(parts=tuple(held_parts), is_last=False, dwell_s=0.0)


@dataclass(slots=True)
class Thinner:
    """Replaces legs by chords where a path is rough, chunk after chunk.

    Parameters
    ----------
    radius_m
        (axes,) radii of the axes.
    cut_m
        The tolerance shared with the spline, at the tool. ``Vertices.beside_m`` is the used part.

    Notes
    -----
    Each left-out vertex is matched to a point on the chord, at a distance of at most ``beside_m``,
    and the points are in the order of the vertices. Between two vertices the distance of both paths
    is convex. So ``beside_m`` bounds the Frechet distance of leg and program.
    """

    radius_m: FloatArray
    cut_m: float
    held: Vertices | None = None  # from one vertex before the next chord's start on
    start: int = 0  # row of ``held`` where the next chord begins
    place: FloatArray = field(default_factory=lambda: np.zeros(0))  # (axes,) m, its start
    known: tuple[int, int, int, int, float, int] = BEGIN
    """Row up to which the roughness is known, the roughness, and the legs for which it holds; share
    and length of the last chord, and number of legs to try for the next one."""

    def thinned(self, chunk: Chunk) -> Chunk:
        """Return the vertices that no later vertex can change."""
        begun = self.held is not None
        held = self.held = join_vertices(self.held, *chunk.parts)
        if not len(held):
            return chunk
        if not begun:
            self.place = held.positions[0] * self.radius_m
        positions, beside_m, nominal_s, row, start, place, known = _thin(
            (held.positions, held.nominal_s, self.radius_m),
            self.cut_m,
            SHARES * self.cut_m,
            chunk.is_last,
            self.start,
            self.place,
            self.known,
        )
        vertices = Vertices(
            positions=positions,
            nominal_s=nominal_s,
            operation=held.operation[row],
            line=held.line[row],
            beside_m=beside_m,
            more_m=np.zeros(len(row)),
        )
        if not begun:
            vertices = join_vertices(held.take(slice(0, 1)), vertices)
        if chunk.is_last:
            self.held, self.start = held.take(slice(-1, None)), 0
            self.place, self.known = held.positions[-1] * self.radius_m, BEGIN
        else:
            dropped = max(start - 1, 0)
            self.held, self.start = held.take(slice(dropped, None)), start - dropped
            self.place, self.known = place, (known[0] - dropped, *known[1:])
        return Chunk(parts=(vertices,), is_last=chunk.is_last, dwell_s=chunk.dwell_s)


@njit(fastmath={"reassoc"})
def _passed(nominal_s, start, stop):
    """Return the time from one row to another, summed in any order."""
    passed_s = 0.0
    for i in range(start + 1, stop + 1):
        passed_s += nominal_s[i]
    return passed_s


@njit()
def _thin(vertices, cut_m, shares_m, is_last, start, place, known):
    """Return the ends of the chords from row ``start`` on, and the start of the next one.

    Parameters
    ----------
    vertices : tuple
        (n, axes) positions, (n,) nominal times, and (axes,) radii.
    cut_m : float
        The tolerance.
    shares_m : (shares,)
        Permitted deviations of vertices from a chord, tried in this order.
    is_last : bool
        Whether the run ends with the last vertex.
    place : (axes,)
        Start of the next chord at the tool, m.
    known : tuple
        As in ``Thinner``.

    Returns
    -------
    out, beside, time_s, row
        (n, axes) and (n,) ends, deviations of left-out vertices, times, and rows of the vertices.
    start, place, known
        Row and position of the last end; state of roughness and of the last chord, as in
        ``Thinner``.
    """
    positions, nominal_s, radius_m = vertices
    until, rough, valid, level, before_m, guess = known
    count, axes = positions.shape
    out, beside = np.empty((count, axes)), np.empty(count)
    time_s, row = np.empty(count), np.empty(count, dtype=np.int64)
    kept = needed_legs(positions, radius_m, cut_m)
    chord_start, d = place.copy(), np.empty(axes)
    program, tool_chord = Program(positions, radius_m), ToolChord(chord_start, d, np.empty(axes))
    # The roughness at the last two rows is unknown before more vertices come.
    last_row = count - 1 if is_last else count - 2
    n, next_kept = 0, start
    while start < last_row:
        if not is_last and last_row - start < WINDOW:
            break
        if start >= until:
            roughness_found = roughness(
                positions, radius_m, cut_m, start, min(last_row, start + WINDOW)
            )
            valid = (
                min(2 * valid, LONGEST) if roughness_found == ROUGH and rough == ROUGH else VALID
            )
            rough = roughness_found
            until = start + (valid if rough != SMOOTH else WINDOW)
        # Going back from a chord's end to the next vertex would add an unintended turn.
        aside = from_vertex(positions, radius_m, chord_start, start) > 0.0
        limit = start + 1
        if (aside or rough != SMOOTH) and not len(kept):
            limit = min(last_row, start + AHEAD)
        elif (aside or rough != SMOOTH) and not kept[start]:
            next_kept = max(next_kept, start)
            while next_kept < min(last_row, start + AHEAD) and not kept[next_kept]:
                next_kept += 1
            limit = next_kept
        if limit - start < LEAST:  # tested here: a call with so many arrays costs more
            k, met, strayed, guess = (
                start + 1,
                True,
                from_vertex(positions, radius_m, chord_start, start),
                0,
            )
            towards(positions, radius_m, chord_start, k, d)
        else:
            corner = (len(kept) > 0 and kept[limit]) or (is_last and limit == last_row)
            k, met, strayed, level, guess = chord(
                program,
                shares_m,
                rough,
                aside,
                Before(level, before_m, guess),
                Legs(start, limit, corner, not is_last and not corner and limit == last_row),
                tool_chord,
            )
        if k < 0:
            break  # where it ends is not known yet
        if k == start + 1 and rough == UNEVEN:
            rough, until = SMOOTH, start + WINDOW  # the chord is too short to gain time
        before_m = np.sqrt(squared_of(d))
        for j in range(axes):
            if met:  # a vertex is met bit for bit
                chord_start[j] = positions[k, j] * radius_m[j]
                out[n, j] = positions[k, j]
            else:
                chord_start[j] += d[j]
                out[n, j] = chord_start[j] / radius_m[j]
        time_s[n] = _passed(nominal_s, start, k)
        row[n], beside[n] = k, strayed
        n += 1
        start = k
    # These arrays are longer than their used part.
    used_parts = out[:n].copy(), beside[:n].copy(), time_s[:n].copy(), row[:n].copy()
    return *used_parts, start, chord_start, (until, rough, valid, level, before_m, guess)
