"""Where a path turns back, and programs that rest there."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.path.types import ProgrammedPath, VertexBlock

_BACK = -0.85  # cosine of a corner (148 degrees) at which the motion rests: speed has a kink there


def reversals(places: FloatArray) -> IntArray:
    """Return (n,) 1 for each of (n, axes) places at which the path turns back, else 0."""
    way = np.diff(places, axis=0)
    size = np.linalg.norm(way, axis=1)
    out = np.zeros(len(places), dtype=np.int64)
    moved = np.flatnonzero(size > 0.0)
    tangent = way[moved] / size[moved, None]
    turned = (tangent[1:] * tangent[:-1]).sum(axis=1) < _BACK
    out[moved[1:][turned]] = 1
    return out


def resting_at_reversals(programmed: ProgrammedPath) -> Iterator[VertexBlock]:
    """Yield the vertices of ``programmed``, with a rest wherever the path turns back."""
    radius_m = programmed.radius_m
    held: VertexBlock | None = None
    before = np.zeros((0, len(radius_m)))  # the vertex before those in hand, from where one came
    for block in programmed:
        if held is not None and (block.positions == held.positions[-1]).all():
            held = _joined(held, block)  # nothing moves: what comes tells whether it turns back
            continue
        if held is not None:
            yield _rested(held, before, block.positions, radius_m)
            before = _came_from(np.concatenate([before, held.positions]))
        held = block
    if held is not None:
        yield _rested(held, before, held.positions[-1:], radius_m)


def _rested(
    block: VertexBlock, before: FloatArray, after: FloatArray, radius_m: FloatArray
) -> VertexBlock:
    places = np.concatenate([before, block.positions, after]) * radius_m
    turned = reversals(places)[len(before) : len(before) + len(block)]
    return replace(block, rest=np.maximum(block.rest, turned))


def _came_from(places: FloatArray) -> FloatArray:
    """Return the last two of (n, axes) places that differ, or all there are."""
    moved = np.flatnonzero((places != places[-1]).any(axis=1))
    return places[-1:] if not len(moved) else places[[moved[-1], -1]]


def _joined(first: VertexBlock, then: VertexBlock) -> VertexBlock:
    return VertexBlock(
        positions=np.concatenate([first.positions, then.positions]),
        operation=np.concatenate([first.operation, then.operation]),
        nominal_s=np.concatenate([first.nominal_s, then.nominal_s]),
        rest=np.concatenate([first.rest, then.rest]),
        dwell_s=np.concatenate([first.dwell_s, then.dwell_s]),
        line=np.concatenate([first.line, then.line]),
    )
