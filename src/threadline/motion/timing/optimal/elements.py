"""A path cut into elements: short polynomial pieces in one smooth parameter.

The planned path is smooth in a common parameter in which each piece has a length of its own; the
square of the rate of that parameter, x, is the unknown. At a rest that rate falls to zero with the
third power of the cube root of time, which no spline in the parameter can follow; so the first
element after a rest traverses the path as ``w^3 - w^4 / 2``: at an even rate of w, its motion
begins with constant jerk, and w joins the common parameter smoothly.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.motion.path.types import PieceBlock

DEGREE = 5
_LEAD_SHARE = 0.3  # share of the first piece, in its own parameter, for a lead-in
_LEAST_LEAD_SHARE = 1e-5
_PARTS_OF_STRAIGHT, _PARTS_OF_CURVE, _PARTS_OF_LEAD = 6, 2, 6
OF_QUARTIC = 5  # coefficients of a piece; such paths have twice as many pieces at a corner
DENSE = 5000
"""Number of pieces of a run above which curved pieces need no cut."""
_ROUNDING = 1e-13  # share of the largest coefficient of an axis: smaller ones are rounding


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Elements:
    """Consecutive elements of one run, n of them.

    Parameters
    ----------
    c
        (n, DEGREE + 1, axes) position in powers of u in [0, 1], m or rad.
    length
        (n,) lengths in the common parameter.
    cap
        (n,) largest u'^2 that the feed allows, infinite without one.
    operation
        (n,) operation under way.
    guard
        (n, DEGREE + 1, k) further polynomials in u, whose second time derivative must not exceed
        1; k may be 0.
    guard_cap
        (n,) largest u'^2 besides the feed's; infinite without one.
    """

    c: FloatArray
    length: FloatArray
    cap: FloatArray
    operation: IntArray
    guard: FloatArray
    guard_cap: FloatArray

    def __len__(self) -> int:
        return len(self.c)

    @property
    def top(self) -> FloatArray:
        """(n,) largest u'^2 by feed and guards."""
        return np.minimum(self.cap, self.guard_cap)

    def take(self, rows: slice) -> Elements:
        """Return the elements at ``rows``."""
        return Elements(
            c=self.c[rows],
            length=self.length[rows],
            cap=self.cap[rows],
            operation=self.operation[rows],
            guard=self.guard[rows],
            guard_cap=self.guard_cap[rows],
        )

    def split(self, parts: IntArray) -> Elements:
        """Return the elements with each cut into (n,) ``parts`` equal parts."""
        element = np.repeat(np.arange(len(self)), parts)
        count = parts[element].astype(np.float64)
        part = np.arange(len(element)) - np.repeat(np.cumsum(parts) - parts, parts)
        begin, width = part / count, 1.0 / count
        return Elements(
            c=restricted(self.c[element], begin, width),
            length=self.length[element] / count,
            cap=self.cap[element] * count**2,
            operation=self.operation[element],
            guard=restricted(self.guard[element], begin, width),
            guard_cap=self.guard_cap[element] * count**2,
        )


def join(parts: list[Elements]) -> Elements:
    """Return the elements of all ``parts`` in a row."""
    return Elements(
        c=np.concatenate([part.c for part in parts]),
        length=np.concatenate([part.length for part in parts]),
        cap=np.concatenate([part.cap for part in parts]),
        operation=np.concatenate([part.operation for part in parts]),
        guard=np.concatenate([part.guard for part in parts]),
        guard_cap=np.concatenate([part.guard_cap for part in parts]),
    )


def restricted(c: FloatArray, begin: FloatArray, width: FloatArray) -> FloatArray:
    """Return (n, order, axes) polynomials on [begin, begin + width] of each, again over [0, 1]."""
    parts = c.astype(np.float64, copy=True)
    nothing = c == 0.0
    order = c.shape[1]
    # Horner's scheme in both directions shifts a polynomial.
    for low in range(order - 1):
        for k in range(order - 2, low - 1, -1):
            parts[:, k] += begin[:, None] * parts[:, k + 1]
    scale = np.ones(len(c))
    for k in range(1, order):
        scale = scale * width
        parts[:, k] *= scale[:, None]
    # Powers that are zero on the whole are zero on a part of it.
    parts[:, 1:][np.logical_and.accumulate(nothing[:, :0:-1], axis=1)[:, ::-1]] = 0.0
    return parts


class RunPieces(NamedTuple):
    """Consecutive pieces of one run.

    Parameters
    ----------
    c
        (n, order, axes) pieces of the planned path.
    ratio
        (n - 1,) rate of u before each joint over the rate after it, which keeps the velocity.
    nominal_s
        (n,) least time of each piece, 0 for none.
    operation
        (n,) operation of each piece.
    length
        Parameter length of the first piece.
    """

    c: FloatArray
    ratio: FloatArray
    nominal_s: FloatArray
    operation: IntArray
    length: float


def elements_of(
    pieces: RunPieces,
    *,
    from_rest: bool,
    to_rest: bool,
    lead_share: tuple[float, float] = (_LEAD_SHARE, _LEAD_SHARE),
    dense: bool | None = None,
) -> Elements:
    """Return the elements of pieces.

    Parameters
    ----------
    from_rest, to_rest
        Whether the run starts, or ends, here.
    lead_share
        Largest share of a piece for the lead-in at its start, and the lead-out at its end. There
        feed and velocity bound the rate of the parameter, which equals the speed only at one end.
    dense
        Whether curved pieces need no cut. By default true for quartics, and for very many pieces.
    """
    c, ratio, nominal_s, operation, length = pieces
    count, order, axes = c.shape
    padded = np.zeros((count, DEGREE + 1, axes))
    padded[:, :order] = c
    with np.errstate(divide="ignore", over="ignore"):
        cap = np.where(nominal_s > 0.0, 1.0 / nominal_s**2, np.inf)
    uncut = Elements(
        c=padded,
        length=length * np.concatenate([[1.0], np.cumprod(ratio)]),
        cap=cap,
        operation=operation,
        guard=np.zeros((count, DEGREE + 1, 0)),
        guard_cap=np.full(count, np.inf),
    )
    if from_rest:
        uncut = _with_lead_in(uncut, lead_share[0])
    if to_rest:
        reversed_last = reverse(uncut.take(slice(-1, None)))
        lead_out = reverse(_with_lead_in(reversed_last, lead_share[1]))
        uncut = join([uncut.take(slice(None, -1)), lead_out])
    straight = ~uncut.c[:, 2:].any(axis=(1, 2))
    if dense is None:
        dense = order == OF_QUARTIC or count > DENSE
    parts_of_curve = 1 if dense else _PARTS_OF_CURVE
    parts = np.where(straight, _PARTS_OF_STRAIGHT, parts_of_curve)
    if from_rest:
        parts[0] = _PARTS_OF_LEAD
    if to_rest:
        parts[-1] = _PARTS_OF_LEAD
    return uncut.split(parts.astype(np.int64))


def reverse(elements: Elements) -> Elements:
    """Return the elements traversed from their end to their start."""
    c = elements.c[::-1]
    ones = np.ones(len(c))
    return Elements(
        c=restricted(c, ones, -ones),
        length=elements.length[::-1],
        cap=elements.cap[::-1],
        operation=elements.operation[::-1],
        guard=restricted(elements.guard[::-1], ones, -ones),
        guard_cap=elements.guard_cap[::-1],
    )


def _with_lead_in(elements: Elements, largest_share: float) -> Elements:
    """Replace the first part of the first element by one that starts from rest.

    Its ends have the position, velocity and acceleration of the path traversed as
    ``w^3 - w^4 / 2`` of its parameter; on a straight piece it is exactly that.
    """
    first = elements.take(slice(0, 1))
    share = np.clip(np.full(1, largest_share), _LEAST_LEAD_SHARE, _LEAD_SHARE)
    head_c = restricted(first.c, np.zeros(1), share)[0]
    rest = Elements(
        c=restricted(first.c, share, 1.0 - share),
        length=first.length * (1.0 - share),
        cap=first.cap / (1.0 - share) ** 2,
        operation=first.operation,
        guard=first.guard,
        guard_cap=first.guard_cap,
    )
    # In u of the head, w runs twice as far: at w = 1 its slope is 1 and g = 1/2.
    powers = np.arange(DEGREE + 1.0)[:, None]
    displacement, slope = head_c[1:].sum(axis=0), (powers * head_c).sum(axis=0)
    second_derivative = (powers * (powers - 1.0) * head_c).sum(axis=0)
    lead = Elements(
        c=_from_rest(head_c[0], displacement, 2.0 * slope, 4.0 * second_derivative)[None],
        length=2.0 * first.length * share,
        cap=first.cap / (2.0 * share) ** 2,
        operation=first.operation,
        guard=first.guard,
        guard_cap=first.guard_cap,
    )
    return join([lead, rest, elements.take(slice(1, None))])


def _from_rest(
    start: FloatArray, displacement: FloatArray, slope: FloatArray, second_derivative: FloatArray
) -> FloatArray:
    """Return (6, axes): the quintic from rest at ``start`` to these derivatives at its end."""
    c = np.zeros((DEGREE + 1, len(start)))
    c[0] = start
    c[3] = 10.0 * displacement - 4.0 * slope + 0.5 * second_derivative
    c[4] = -15.0 * displacement + 7.0 * slope - second_derivative
    c[5] = 6.0 * displacement - 3.0 * slope + 0.5 * second_derivative
    # On a straight piece c[5] vanishes but for rounding: g has fourth degree.
    size = np.abs(c[1:]).max(axis=0)
    c[1:][np.abs(c[1:]) < _ROUNDING * size] = 0.0
    return c


class PiecesAhead:
    """The pieces that are still ahead, taken from the front.

    Parameters
    ----------
    path
        Blocks of pieces; they are read on demand.
    """

    def __init__(self, path: Iterable[PieceBlock]) -> None:
        self._blocks = iter(path)
        self._front: list[tuple[PieceBlock, int]] = []  # blocks, and the used part of each

    def take(self, most: int) -> PieceBlock | None:
        """Return the next pieces up to a rest, at most ``most``; None after the last."""
        taken: list[PieceBlock] = []
        count = 0
        while count < most:
            if not self._front:
                new_block = next(self._blocks, None)
                if new_block is None:
                    break
                self._front.append((new_block, 0))
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
        """Put ``block`` back in front of the pieces ahead."""
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
