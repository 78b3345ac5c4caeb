"""Pieces of a run, or of a part of one, converted to elements for the solver."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray
from threadline.motion.path.runs import COINCIDENT_M
from threadline.motion.path.types import PieceBlock
from threadline.motion.timing.optimal.along_path import divided, with_length
from threadline.motion.timing.optimal.elements import Elements, RunPieces, elements_of
from threadline.motion.timing.optimal.motion_limits import Limits
from threadline.motion.timing.pieces import factors, slope

BoolArray: TypeAlias = NDArray[np.bool_]

_TURNED = 1e-8  # largest turn of a line at its joint
_AT_JERK = 0.87  # lead-in with room for twice the jerk, as a share of sqrt(speed / jerk)
_AT_SPEED = 0.1  # duration of a lead-in at speed, as a share of the run-up time of the axes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RunElements:
    """Elements of consecutive pieces, and the data needed to continue after them.

    Parameters
    ----------
    elements
        Elements of the pieces.
    length
        (n,) of each piece in the common parameter, without a lead-in's extra length.
    last
        (1, order, axes) the last piece.
    ending
        The last ``slow`` pieces again, to a rest at their end; None if the motion rests there
        anyway.
    slow
        Number of these pieces.
    """

    elements: Elements
    length: FloatArray
    last: FloatArray
    ending: Elements | None
    slow: int

    def __len__(self) -> int:
        return len(self.length)

    def in_units_of(self, unit: float) -> RunElements:
        """Return the same in a common parameter of another unit."""
        ending = self.ending
        return replace(
            self,
            elements=replace(self.elements, length=self.elements.length / unit),
            length=self.length / unit,
            ending=None if ending is None else replace(ending, length=ending.length / unit),
        )


def run_elements(
    run: PieceBlock,
    radius_m: FloatArray,
    limits: Limits,
    before: RunElements | None = None,
    *,
    to_rest: bool = True,
    dense: bool | None = None,
    slow: int = 1,
) -> RunElements | None:
    """Return the elements of pieces; with limits along the path, path length is their last axis.

    None if nothing moves.

    Parameters
    ----------
    limits
        Limits; limits along the path count as one more axis.
    before
        The preceding pieces; None: the motion begins at rest.
    to_rest
        Whether the motion rests after the last piece.
    dense
        Whether curved pieces need no cut; see ``elements_of``.
    slow
        Number of pieces at the end in which the motion can come to rest, unless it does anyway.
    """
    if limits.along is not None:
        run = divided(run)
    is_moving = np.abs(run.coefficients[:, 1:]).max(axis=(1, 2)) > 0.0
    is_moving = _beyond_rounding(run, is_moving, radius_m, before is None, to_rest)
    if not is_moving.any():
        return None
    c = run.coefficients[is_moving].copy()
    if c.shape[1] < 4:
        c = np.pad(c, ((0, 0), (0, 4 - c.shape[1]), (0, 0)))
    _reach_ends(
        c,
        run.coefficients[0, 0] if before is None else None,
        run.coefficients[-1].sum(axis=0) if to_rest else None,
    )
    first_length, slow = 1.0, min(slow, len(c))
    if before is not None:
        joint = np.concatenate([before.last, c[:1]])
        first_length = float(before.length[-1] / np.sqrt(factors(joint, radius_m)[0]))
    ratio, last_piece = 1.0 / np.sqrt(factors(c, radius_m)[:-1]), c[-1:]
    length = first_length * np.concatenate([[1.0], np.cumprod(ratio)])
    nominal_s, operation, last_rate = (
        run.nominal_s[is_moving],
        run.operation[is_moving],
        slope(last_piece)[0],
    )
    if limits.along is not None:
        c = with_length(c, limits.along.radius_m)
        last_rate = np.append(last_rate, c[-1, :, -1] @ np.arange(6.0))
    lead_shares = (
        _lead_share(c[0, 1], nominal_s[0], limits),
        _lead_share(last_rate, nominal_s[-1], limits),
    )
    return RunElements(
        elements=elements_of(
            RunPieces(c, ratio, nominal_s, operation, first_length),
            from_rest=before is None,
            to_rest=to_rest,
            lead_share=lead_shares,
            dense=dense,
        ),
        length=length,
        last=last_piece,
        ending=None
        if to_rest
        else elements_of(
            RunPieces(
                c[-slow:],
                ratio[len(c) - slow :],
                nominal_s[-slow:],
                operation[-slow:],
                float(length[-slow]),
            ),
            from_rest=False,
            to_rest=True,
            lead_share=lead_shares,
        ),
        slow=slow,
    )


def _beyond_rounding(
    run: PieceBlock, is_moving: BoolArray, radius_m: FloatArray, from_rest: bool, to_rest: bool
) -> BoolArray:
    """Return ``is_moving`` without the pieces of negligible length beside a rest.

    Beside a chord of nanometres a spline has spans of femtometres: less than the rounding of a
    position, so that a motion from rest along them has no valid digits.
    """
    is_long = np.abs(run.coefficients[:, 1:] * radius_m).sum(axis=1).max(axis=1) > COINCIDENT_M
    is_kept = is_moving.copy()
    if from_rest:
        is_kept &= np.logical_or.accumulate(is_long)
    if to_rest:
        is_kept &= np.logical_or.accumulate(is_long[::-1])[::-1]
    return is_kept if is_kept.any() else is_moving


def _reach_ends(c: FloatArray, start: FloatArray | None, end: FloatArray | None) -> None:
    """Move the start of the first piece and the end of the last, in place: by 0.1 nm at most.

    The highest power of a curved piece, counted from its other end, changes, so that the piece
    joins its neighbour as smoothly as before. A line that hardly turns stays a line with another
    end.
    """
    order, nothing = c.shape[1], np.zeros(c.shape[2])
    start_shift = nothing if start is None else start - c[0, 0]
    end_shift = nothing if end is None else end - c[-1].sum(axis=0)
    highest = np.eye(order)[-1]
    for k, shift, power in (
        (-1, end_shift, highest),
        (0, start_shift, np.polynomial.polynomial.polypow([1.0, -1.0], order - 1)),
    ):
        if not shift.any():
            continue
        line = not c[k, 2:].any()
        hardly_turns = len(c) == 1 or np.abs(shift).max() < _TURNED * np.abs(c[k, 1]).max()
        change = power
        if line and hardly_turns:
            change = np.zeros(order)
            change[:2] = power[0], 1.0 - 2.0 * power[0]
        c[k] += change[:, None] * shift


def _lead_share(rate: FloatArray, nominal_s: float, limits: Limits) -> float:
    """Return the share of a piece for a lead-in: the distance until the axes reach their speed.

    The speed is the feed, or the limit of an axis; neither binds before the axes reach it. In a
    much longer lead-in the elements approximate the speed badly.
    """
    least_s = max(nominal_s, float((np.abs(rate) / limits.velocity).max()))
    if least_s == 0.0:
        return 1.0  # the path turns back there, and its parameter does not give the speed
    speed = np.abs(rate) / least_s
    by_jerk_s = np.sqrt(speed / limits.jerk)
    rise_s = np.maximum(2.0 * by_jerk_s, speed / limits.acceleration)
    lead_s = _AT_SPEED * float(rise_s.max())
    # The bound on a lead-in's rate bounds the jerk at its start, by 1.5 of speed / lead_s^2.
    longest_jerk_s = float(by_jerk_s.max())
    return (min(lead_s, _AT_JERK * longest_jerk_s) if longest_jerk_s > 0.0 else lead_s) / least_s
