"""The pieces of a path some at a time, no further than the next rest."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from threadline.path.types import PieceBlock


class PiecesAhead:
    """The pieces that are still to be gone, taken from the front.

    Parameters
    ----------
    path
        Blocks of pieces; they are read when they are asked for.
    """

    def __init__(self, path: Iterable[PieceBlock]) -> None:
        self._blocks = iter(path)
        self._front: list[tuple[PieceBlock, int]] = []  # blocks, and how much of each is gone

    def take(self, most: int) -> PieceBlock | None:
        """Return the next pieces up to a rest, ``most`` of them at most; None behind the last."""
        taken: list[PieceBlock] = []
        count = 0
        while count < most:
            if not self._front:
                fresh = next(self._blocks, None)
                if fresh is None:
                    break
                self._front.append((fresh, 0))
            block, first = self._front.pop()
            stop = min(len(block), first + most - count)
            rests = np.flatnonzero(block.rest_after[first:stop])
            if len(rests):
                stop = first + int(rests[0]) + 1
            if stop < len(block):
                self._front.append((block, stop))
            if stop > first:
                taken.append(rows_of(block, first, stop))
                count += stop - first
            if len(rests):
                break
        return _joined(taken) if taken else None

    def put_back(self, block: PieceBlock) -> None:
        """Make ``block`` the first of the pieces that are still to be gone."""
        self._front.append((block, 0))


def rows_of(block: PieceBlock, first: int, stop: int) -> PieceBlock:
    """Return the pieces from ``first`` to before ``stop``."""
    rows = slice(first, stop)
    return PieceBlock(
        coefficients=block.coefficients[rows],
        operation=block.operation[rows],
        nominal_s=block.nominal_s[rows],
        rest_after=block.rest_after[rows],
        dwell_s=block.dwell_s[rows],
        line=block.line[rows],
    )


def _joined(parts: list[PieceBlock]) -> PieceBlock:
    order = max(part.coefficients.shape[1] for part in parts)
    padded = [
        np.pad(p.coefficients, ((0, 0), (0, order - p.coefficients.shape[1]), (0, 0)))
        for p in parts
    ]
    return PieceBlock(
        coefficients=np.concatenate(padded),
        operation=np.concatenate([p.operation for p in parts]),
        nominal_s=np.concatenate([p.nominal_s for p in parts]),
        rest_after=np.concatenate([p.rest_after for p in parts]),
        dwell_s=np.concatenate([p.dwell_s for p in parts]),
        line=np.concatenate([p.line for p in parts]),
    )
