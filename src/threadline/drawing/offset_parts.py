"""Parts of a chain of chords between its crossings, and the test whether they keep a distance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from threadline.arrays import FloatArray, IntArray
from threadline.compiled import njit


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Part:
    """A part of a chain between two crossings.

    ``begin`` and ``end`` are the indices of these crossings; -1 is the start and -2 the end of an
    open chain. ``probe`` is a point well inside the part.
    """

    points: FloatArray
    labels: IntArray
    begin: int
    end: int

    @property
    def probe(self) -> FloatArray:
        """(2,) the middle of the longest chord."""
        step = np.diff(self.points, axis=0)
        k = int(np.argmax(np.hypot(*step.T)))
        middle: FloatArray = self.points[k] + step[k] / 2.0
        return middle


def stitch_parts(
    chain: FloatArray,
    labels: IntArray,
    closed: bool,
    cuts: tuple[IntArray, IntArray, FloatArray, FloatArray],
) -> list[Part]:
    """Return the parts of ``chain`` between its crossings, in order.

    Parameters
    ----------
    chain, labels
        (n + 1, 2) points, and (n,) a number for each chord.
    closed
        Whether the chain ends where it begins.
    cuts
        First and second chord of each crossing, and the places on both, from 0 to 1.
    """
    first, second, at_first, at_second = cuts
    chord = np.concatenate([first, second]).astype(np.int64)
    at = np.concatenate([at_first, at_second])
    name = np.tile(np.arange(len(first)), 2)
    order = np.lexsort((at, chord))
    chord, at, name = chord[order], at[order], name[order]
    if not len(chord):
        ends = (0, 0) if closed else (-1, -2)
        return [Part(points=chain, labels=labels, begin=ends[0], end=ends[1])]
    places = chain[chord] + at[:, None] * (chain[chord + 1] - chain[chord])
    parts = []
    for k in range(len(chord) - 1):
        inner = slice(chord[k] + 1, chord[k + 1] + 1)
        points = np.concatenate([places[k : k + 1], chain[inner], places[k + 1 : k + 2]])
        names = labels[chord[k] : chord[k + 1] + 1]
        parts.append(Part(points=points, labels=names, begin=int(name[k]), end=int(name[k + 1])))
    head = np.concatenate([chain[: chord[0] + 1], places[:1]])
    tail = np.concatenate([places[-1:], chain[chord[-1] + 1 :]])
    head_labels, tail_labels = labels[: chord[0] + 1], labels[chord[-1] :]
    if closed:
        parts.append(
            Part(
                points=np.concatenate([tail, head[1:]]),
                labels=np.concatenate([tail_labels, head_labels]),
                begin=int(name[-1]),
                end=int(name[0]),
            )
        )
        return parts
    return [
        Part(points=head, labels=head_labels, begin=-1, end=int(name[0])),
        *parts,
        Part(points=tail, labels=tail_labels, begin=int(name[-1]), end=-2),
    ]


def clear_of(
    probes: FloatArray, begin: FloatArray, end: FloatArray, distance_m: float
) -> NDArray[np.bool_]:
    """Return (n,) whether each probe is at least ``distance_m`` from every chord."""
    result: NDArray[np.bool_] = _clear_of(probes, begin, end, distance_m)
    return result


@njit()
def _clear_of(probes, begin, end, distance_m):  # type: ignore[no-untyped-def]
    limit = distance_m * distance_m
    clear = np.ones(len(probes), dtype=np.bool_)
    for i in range(len(probes)):
        px, py = probes[i, 0], probes[i, 1]
        for j in range(len(begin)):
            dx, dy = end[j, 0] - begin[j, 0], end[j, 1] - begin[j, 1]
            qx, qy = px - begin[j, 0], py - begin[j, 1]
            along = (qx * dx + qy * dy) / (dx * dx + dy * dy)
            along = min(1.0, max(0.0, along))
            ex, ey = qx - along * dx, qy - along * dy
            if ex * ex + ey * ey < limit:
                clear[i] = False
                break
    return clear
