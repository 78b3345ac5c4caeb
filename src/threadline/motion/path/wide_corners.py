"""Corners that are entered and left on their outside, so that they are rounded more widely.

A path that may leave the program by a tolerance uses it on the inside of a corner only, where the
corner is cut. A vertex that is moved to the outside of its corner can be cut by as much more: the
path passes the programmed vertex on the inside as before, and the legs on the outside, as drivers
take a bend. The radius of the bend grows with the cut, and the speed through it with its root.

Notes
-----
A vertex moves against the change of direction ``t2 - t1`` of the unit tangents, by ``s``. At a
corner of its own the spline cuts the moved vertex by ``d``, between 0 and the tolerance plus ``s``,
towards the inside; so it is at most the tolerance from the program on the inside. On the outside
the legs are moved by ``s`` times the cosine of half the angle between their directions. Between
vertices both polygons are straight, so their distance is largest at a vertex. Where corners stand
so close that each reaches into the next the cuts add up, and the distance may be more;
``path_deviation`` measures it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.motion.path.greville import CUT
from threadline.motion.path.polygon import turns
from threadline.motion.path.runs import Chunk, Vertices, join_vertices
from threadline.motion.path.types import ProgrammedPath

_BACK = 1.8
"""Turn (|t2 - t1|, 128 degrees) from which a path turns back: beyond the end it only loses time."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Corners:
    """How a path goes round corners, at the tool.

    Parameters
    ----------
    outside_m
        Largest distance of the path from the program on the outside of a corner.
    narrow
        Lines of the program, and how far the corner at the end of the move of each may be cut, if
        that is less than at others; it is left on its outside by less in the same ratio.
    """

    outside_m: float = 0.0
    narrow: tuple[tuple[int, float], ...] = ()


EVEN = Corners()
"""All corners alike, and cut on their inside only."""


_LEAST_COSINE = 0.5


def moved_outside(
    chunks: Iterator[Chunk], programmed: ProgrammedPath, cut_m: float, corners: Corners
) -> Iterator[Chunk]:
    """Yield the same runs with their vertices moved to the outside of their corners.

    A vertex is moved only as far as its corner can be cut more widely: knots reach at most half a
    leg away. Rests, and vertices where the path turns back, stay.

    Parameters
    ----------
    chunks
        The runs of ``programmed``.
    cut_m
        Largest distance of the path from the program on the inside of a corner, at the tool.
    corners
        Allowances of single corners.
    """
    previous: Vertices | None = None  # the programmed vertex before the held one
    held_back: Vertices | None = None  # the last vertex, whose next one is not yet known
    for chunk in chunks:
        new_vertices = chunk.vertices
        if not len(new_vertices):
            if chunk.is_last and held_back is not None:
                previous, held_back = held_back, None
                yield replace(chunk, parts=(previous,))
            else:
                yield chunk
            continue
        known = join_vertices(
            previous, *(part for part in (held_back, new_vertices) if part is not None)
        )
        first_new = 0 if previous is None else 1
        if first_new == 0 and len(known) == 1 and not chunk.is_last:
            held_back = known
            continue
        moved = _moved(known, programmed, cut_m, corners)
        if chunk.is_last:
            yield replace(chunk, parts=(moved.take(slice(first_new, None)),))
            previous, held_back = known.take(slice(-1, None)), None
            continue
        # The first vertex of a path has no corner; the last one's is not known yet.
        if len(known) - 1 > first_new:
            yield replace(chunk, parts=(moved.take(slice(first_new, -1)),))
        held_back = known.take(slice(-1, None))
        previous = known.take(slice(-2, -1)) if len(known) > 1 else previous
    if held_back is not None:
        yield Chunk(parts=(held_back,), is_last=False, dwell_s=0.0)


def _moved(known: Vertices, programmed: ProgrammedPath, cut_m: float, corners: Corners) -> Vertices:
    """Return vertices with all but the first and the last moved to the outside of their corners."""
    if len(known) < 3:
        return known
    radius_m = programmed.radius_m
    length_m, turn = turns(known.positions, radius_m, programmed.local)
    shorter_m = np.minimum(length_m[:-1], length_m[1:])
    usable_m = CUT * turn[1:-1] * 0.5 * shorter_m
    share = np.ones(len(turn) - 2)
    for line, width_m in corners.narrow:
        share[known.line[1:-1] == line] = min(width_m / cut_m, 1.0)
    inside_m = share * cut_m
    # A leg moves by less than its vertex, by the cosine of half the angle between the legs.
    half_angle_cosine = np.sqrt(np.maximum(1.0 - 0.25 * turn[1:-1] ** 2, _LEAST_COSINE**2))
    limit_m = share * min(corners.outside_m, cut_m) / half_angle_cosine
    outer_m = np.clip(usable_m - inside_m, 0.0, limit_m)
    outer_m[turn[1:-1] >= _BACK] = 0.0
    tangents = np.diff(known.positions * radius_m, axis=0) / length_m[:, None]
    inward = np.diff(tangents, axis=0)
    norm = np.linalg.norm(inward, axis=1)
    shift_per_inward_m: FloatArray = np.divide(
        outer_m, norm, out=np.zeros_like(norm), where=(norm > 0.0) & (outer_m > 0.0)
    )
    positions = known.positions.copy()
    positions[1:-1] -= shift_per_inward_m[:, None] * inward / radius_m
    more_m = np.zeros(len(known))
    more_m[1:-1] = outer_m + inside_m - cut_m
    return replace(known, positions=positions, more_m=more_m)
