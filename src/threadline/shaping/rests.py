"""Rests that a shaped motion must really come to: a dwell, an output, a wait or a stop follows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from threadline.arrays import FloatArray, IntArray
from threadline.trajectory.types import TrajectoryBlock

_AT_REST = 1e-9
"""Speed at a joint, in units of the piece's own way over its time, that counts as none."""


@dataclass(frozen=True, slots=True, eq=False)
class Pieces:
    """Pieces of a trajectory.

    Parameters
    ----------
    start_s, duration_s, coefficients, operation
        As for a trajectory block.
    run
        (n,) 1 where a piece begins after a rest that was made to last, else 0.
    """

    start_s: FloatArray
    duration_s: FloatArray
    coefficients: FloatArray
    operation: IntArray
    run: IntArray

    def __len__(self) -> int:
        return len(self.start_s)

    @property
    def end_s(self) -> float:
        """When the last piece ends."""
        return float(self.start_s[-1] + self.duration_s[-1])

    @property
    def still(self) -> NDArray[np.bool_]:
        """(n,) True where a piece stands still."""
        return np.asarray((self.coefficients[:, 1:] == 0.0).all(axis=(1, 2)))

    def rows(self, first: int, stop: int) -> Pieces:
        """Return some of the pieces."""
        part = slice(first, stop)
        return Pieces(
            self.start_s[part],
            self.duration_s[part],
            self.coefficients[part],
            self.operation[part],
            self.run[part],
        )


def joined(first: Pieces | None, second: Pieces) -> Pieces:
    """Return two runs of pieces as one, of the higher polynomial order."""
    if first is None or not len(first):
        return second
    order = max(first.coefficients.shape[1], second.coefficients.shape[1])
    return Pieces(
        np.concatenate([first.start_s, second.start_s]),
        np.concatenate([first.duration_s, second.duration_s]),
        np.concatenate([padded(first.coefficients, order), padded(second.coefficients, order)]),
        np.concatenate([first.operation, second.operation]),
        np.concatenate([first.run, second.run]),
    )


def padded(coefficients: FloatArray, order: int) -> FloatArray:
    """Return coefficients with zeros up to ``order``."""
    missing = order - coefficients.shape[1]
    return np.pad(coefficients, ((0, 0), (0, missing), (0, 0))) if missing > 0 else coefficients


def with_rests(blocks: Iterator[TrajectoryBlock], hold_s: float) -> Iterator[Pieces]:
    """Yield the pieces of a trajectory with ``hold_s`` more at every rest that something needs.

    Such a rest is a standstill where the numbers of the operations skip one or more: what is
    between two moves is no motion, and must find the machine at rest. A standing piece before it
    (a dwell) is made longer; else one is put in.
    """
    last: Pieces | None = None
    late_s = 0.0
    for block in blocks:
        if not len(block):
            continue
        fresh = Pieces(
            block.start_s + late_s,
            block.duration_s,
            block.coefficients,
            block.operation,
            np.zeros(len(block), dtype=np.int64),
        )
        pieces = joined(last, fresh)
        if hold_s > 0.0:
            pieces, added_s = _stretched(pieces, hold_s)
            late_s += added_s
        # The last piece waits: it may have to be made longer.
        if len(pieces) > 1:
            yield pieces.rows(0, len(pieces) - 1)
        last = pieces.rows(len(pieces) - 1, len(pieces))
    if last is not None:
        yield last


def _stretched(pieces: Pieces, hold_s: float) -> tuple[Pieces, float]:
    """Return the pieces with their rests made longer, and by how much in all."""
    after = np.flatnonzero(_rest_before(pieces))
    if not len(after):
        return pieces, 0.0
    duration = np.array(pieces.duration_s)
    run = np.array(pieces.run)
    run[after] = 1
    still = pieces.still
    longer = after[still[after - 1]]
    duration[longer - 1] += hold_s
    steps = np.zeros(len(pieces))
    steps[after] = hold_s
    start = pieces.start_s + np.cumsum(steps)
    new = after[~still[after - 1]]
    held = np.zeros((len(new), *pieces.coefficients.shape[1:]))
    held[:, 0] = pieces.coefficients[new - 1].sum(axis=1)
    stretched = Pieces(
        np.insert(start, new, start[new] - hold_s),
        np.insert(duration, new, hold_s),
        np.insert(pieces.coefficients, new, held, axis=0),
        np.insert(pieces.operation, new, pieces.operation[new - 1]),
        np.insert(run, new, 0),
    )
    return stretched, hold_s * len(after)


def _rest_before(pieces: Pieces) -> NDArray[np.bool_]:
    """(n,) True where the operations skip after a dwell, or where both pieces come to rest."""
    skips = np.diff(pieces.operation, prepend=pieces.operation[:1]) > 1
    if not skips.any():
        return np.asarray(skips)
    c = pieces.coefficients
    power = np.arange(c.shape[1])
    way = np.abs(c[:, 1:]).sum(axis=1) + 1e-300
    end = np.abs((c * power[None, :, None]).sum(axis=1)) <= _AT_REST * way
    begin = np.abs(c[:, 1]) <= _AT_REST * way if c.shape[1] > 1 else np.ones_like(end)
    comes_to_rest = np.concatenate([[False], end[:-1].all(axis=1)]) & begin.all(axis=1)
    # Historical motion steps into its speed: after a dwell that is a rest all the same.
    dwelt = np.concatenate([[False], pieces.still[:-1]])
    return np.asarray(skips & (dwelt | comes_to_rest))
