"""Trajectory of a path whose pieces already have their times."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.motion.path.durations import smoothing_for
from threadline.motion.path.types import PieceBlock, PlannedPath
from threadline.motion.timing.averaged import Smoother
from threadline.motion.timing.types import TrajectoryBlock, held_block

if TYPE_CHECKING:
    from threadline.machine import Machine

SAMPLES = 8192  # buffered at once: larger arrays are paged in anew each time


def timed_blocks(path: PlannedPath) -> Iterator[TrajectoryBlock]:
    """Yield the pieces of ``path`` with their own times, and a constant piece per dwell."""
    end_s = 0.0
    for pieces in path:
        block = _block(pieces, end_s)
        if block is not None:
            end_s = block.end_s
            yield block


def smoothed_blocks(path: PlannedPath, machine: Machine) -> Iterator[TrajectoryBlock]:
    """Yield the timed pieces of ``path`` smoothed as far as the jerk limits require.

    The pieces must keep the limits of velocity and acceleration.
    """
    smoothing = smoothing_for(machine, path.axes)
    smoother: Smoother | None = None
    now_s, phase, piece_count = 0.0, 0.0, 0  # start of the run, time to the next sample, pieces out
    for pieces in path:
        stops = np.flatnonzero(pieces.rest_after)
        edges = [0, *(int(stop) + 1 for stop in stops)]
        if edges[-1] < len(pieces):
            edges.append(len(pieces))
        for first, stop in pairwise(edges):
            for part in _pieces_by_samples(pieces, first, stop, smoothing.step_s):
                block = _block(part, 0.0)
                if block is None:
                    continue
                if smoother is None:
                    smoother = Smoother(smoothing, part.coefficients[0, 0], int(part.operation[0]))
                count = max(0, int(np.ceil((block.end_s - phase) / smoothing.step_s)))
                # A slow piece has up to a billion samples; equal parts leave no short one over.
                part_count = -(-count // SAMPLES) or 1
                for k in range(part_count):
                    sample_numbers = np.arange(
                        k * count // part_count, (k + 1) * count // part_count
                    )
                    times = np.asarray(phase + sample_numbers * smoothing.step_s, dtype=np.float64)
                    piece = np.searchsorted(block.start_s, times, side="right") - 1
                    spline_pieces = smoother.extend(block.evaluate(times), block.operation[piece])
                    yield from _placed(spline_pieces, now_s, piece_count, smoothing.step_s)
                    piece_count += len(spline_pieces[0])
                phase += count * smoothing.step_s - block.end_s
            if not pieces.rest_after[stop - 1]:
                continue
            end = pieces.coefficients[stop - 1].sum(axis=0)
            operation = int(pieces.operation[stop - 1])
            if smoother is not None:
                spline_pieces = smoother.finish(end, operation)
                yield from _placed(spline_pieces, now_s, piece_count, smoothing.step_s)
                now_s += (piece_count + len(spline_pieces[0])) * smoothing.step_s
            dwell = float(pieces.dwell_s[stop - 1])
            if dwell > 0:
                yield held_block(end, now_s, dwell, operation)
                now_s += dwell
            smoother, phase, piece_count = None, 0.0, 0


def _placed(
    spline_pieces: tuple[FloatArray, object], begin_s: float, first_piece: int, step_s: float
) -> Iterator[TrajectoryBlock]:
    count = len(spline_pieces[0])
    if count:
        yield TrajectoryBlock(
            start_s=np.asarray(begin_s + (first_piece + np.arange(count)) * step_s),
            duration_s=np.full(count, step_s),
            coefficients=spline_pieces[0],
            operation=np.asarray(spline_pieces[1]),
        )


def _pieces_by_samples(
    pieces: PieceBlock, first: int, stop: int, step_s: float
) -> Iterator[PieceBlock]:
    """Yield pieces ``first`` to ``stop`` without their dwells, in parts with few samples."""
    sample_chunks = np.cumsum(pieces.nominal_s[first:stop]) // (SAMPLES * step_s)
    edges = first + np.flatnonzero(np.diff(sample_chunks, prepend=-1.0))
    for begin, end in zip(edges, [*edges[1:], stop], strict=True):
        rows = slice(int(begin), int(end))
        yield PieceBlock(
            coefficients=pieces.coefficients[rows],
            operation=pieces.operation[rows],
            nominal_s=pieces.nominal_s[rows],
            rest_after=pieces.rest_after[rows],
            dwell_s=np.zeros(int(end - begin)),
            line=pieces.line[rows],
        )


def _block(pieces: PieceBlock, begin_s: float) -> TrajectoryBlock | None:
    if (pieces.nominal_s > 0).all() and not (pieces.dwell_s > 0).any():
        return TrajectoryBlock(
            start_s=begin_s + np.concatenate([[0.0], np.cumsum(pieces.nominal_s)[:-1]]),
            duration_s=pieces.nominal_s,
            coefficients=pieces.coefficients,
            operation=pieces.operation,
        )
    count, order, axes = pieces.coefficients.shape
    # Row 2i is piece i, row 2i + 1 its dwell; rows of zero duration are dropped.
    duration = np.stack([pieces.nominal_s, pieces.dwell_s], axis=1).reshape(-1)
    coefficients = np.zeros((count, 2, order, axes))
    coefficients[:, 0] = pieces.coefficients
    coefficients[:, 1, 0] = pieces.coefficients.sum(axis=1)
    is_kept = duration > 0
    if not is_kept.any():
        return None
    duration = duration[is_kept]
    start = begin_s + np.concatenate([[0.0], np.cumsum(duration)[:-1]])
    return TrajectoryBlock(
        start_s=start,
        duration_s=duration,
        coefficients=coefficients.reshape(2 * count, order, axes)[is_kept],
        operation=np.repeat(pieces.operation, 2)[is_kept],
    )
