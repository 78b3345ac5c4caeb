r"""Shapers on trajectories: the exact convolution of piecewise polynomials with impulses.

The shaped position is :math:`y(t) = \sum_k A_k\, q(t - t_k)`, where q(t) is the planned position,
constant before its start and after its end. It is piecewise polynomial, too, with a breakpoint for
each planned breakpoint and each impulse. So nothing is sampled, and the limits can be checked
exactly.

For a positive train that sums to 1, y and each of its derivatives are weighted means of q and its
derivatives. Limits of travel, velocity, acceleration and jerk are intervals, and an interval
contains every mean of its members, so a positive shaper breaks no limit. Unit-magnitude and
negative trains may break limits. The limits are checked again in either case.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import comb

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.errors import OptionError
from threadline.files import Stream
from threadline.machine import Machine
from threadline.motion.shaping.deviation import Pieces, joined, with_rests
from threadline.motion.shaping.types import UNSHAPED, Shaper
from threadline.motion.timing import Trajectory, TrajectoryBlock, check_limits

_UNIT_SUM = 1e-9
_PIECES = 2048
"""Number of shaped pieces in a block; it does not depend on the blocks of the trajectory."""

_COINCIDENT_S = 1e-12
"""Breakpoints closer than this, or than four roundings of the time, are merged."""


def shape_trajectory(
    trajectory: Trajectory,
    shaper: Shaper | Mapping[str, Shaper],
    machine: Machine | None,
    *,
    centroid_shift: bool = False,
) -> Trajectory:
    """Convolve a trajectory with a shaper, or each axis with its own.

    At a standstill for an operation other than a move (dwell, output, wait, stop), the train is
    played to its end before the next move begins, so that the operation finds the machine at rest.
    All other moves run into each other. The shaped trajectory is longer by the duration of the
    train, and by the same duration for each of these rests.

    Parameters
    ----------
    trajectory
        The planned trajectory.
    shaper
        One for all axes, which keeps straight lines straight, or one per axis by name; other axes
        are not shaped. Amplitudes must sum to 1.
    machine
        Its limits are checked on the shaped trajectory; None checks nothing.
    centroid_shift
        Delay each axis so that the centroids sum(A t) of all trains coincide: moves at constant
        speed then stay exactly on their line although axes have different shapers. With one
        shaper for all, the centroid is a common delay and nothing has to be shifted.

    Returns
    -------
    Trajectory
        Made block by block while it is read; a piece carries the operation at the centroid of the
        train, after a rest the operation of the move that has begun.

    Raises
    ------
    OptionError
        If an axis is unknown or the amplitudes of a train don't sum to 1.
    LimitError
        If the shaped trajectory breaks a limit of the machine and is not historical.
    """
    trains = _trains(trajectory.axes, shaper, centroid_shift=centroid_shift)
    shaped = Trajectory(
        axes=trajectory.axes,
        historical=trajectory.historical,
        blocks=Stream(_convolved, trajectory, trains),
    )
    if machine is not None:
        check_limits(shaped, machine)
    return shaped


def longest_delay_s(
    axes: tuple[str, ...],
    shaper: Shaper | Mapping[str, Shaper],
    *,
    centroid_shift: bool = False,
) -> float:
    """Return the time that :func:`shape_trajectory` adds at the end, and at every rest, s."""
    return float(_trains(axes, shaper, centroid_shift=centroid_shift).delay_s[-1])


@dataclass(frozen=True, slots=True, eq=False)
class _Trains:
    """Amplitudes of each axis on the merged delays of all axes.

    Parameters
    ----------
    delay_s
        (k,) increasing, the first 0.
    amplitudes
        (k, axes), 0 if an axis has no impulse.
    centroid_s
        Mean over the axes of the trains' centroids, limited to the delays.
    """

    delay_s: FloatArray
    amplitudes: FloatArray
    centroid_s: float


def _trains(
    axes: tuple[str, ...],
    shaper: Shaper | Mapping[str, Shaper],
    *,
    centroid_shift: bool,
) -> _Trains:
    if isinstance(shaper, Shaper):
        trains = [shaper] * len(axes)
    else:
        for name in shaper:
            if name not in axes:
                raise OptionError(
                    f"shaper of axis {name!r}: the trajectory has axes {', '.join(axes)}",
                    remedy="Name one of them.",
                )
        trains = [shaper.get(axis, UNSHAPED) for axis in axes]
    for train in trains:
        if abs(float(train.amplitudes.sum()) - 1.0) > _UNIT_SUM:
            raise OptionError(
                f"shaper '{train.name}': amplitudes sum to {train.amplitudes.sum():.12g}; a shaped "
                "move ends where it was planned only if they sum to 1"
            )
    latest_centroid_s = max(train.centroid_s for train in trains)
    shifts_s = [latest_centroid_s - train.centroid_s if centroid_shift else 0.0 for train in trains]
    delays = np.concatenate(
        [train.times_s + shift_s for train, shift_s in zip(trains, shifts_s, strict=True)]
    )
    sorted_delays = np.sort(delays)
    distinct = sorted_delays[np.diff(sorted_delays, prepend=-1.0) > _COINCIDENT_S]
    amplitudes = np.zeros((len(distinct), len(axes)))
    for column, (train, shift_s) in enumerate(zip(trains, shifts_s, strict=True)):
        nearest_delay = np.abs(distinct[None, :] - (train.times_s + shift_s)[:, None]).argmin(
            axis=1
        )
        np.add.at(amplitudes[:, column], nearest_delay, train.amplitudes)
    centroid_s = float((distinct @ amplitudes).mean())
    # The centroid of a train with negative impulses may lie outside the buffered pieces.
    centroid_within_s = min(max(0.0, centroid_s), float(distinct[-1]))
    return _Trains(distinct, amplitudes, centroid_within_s)


def _convolved(trajectory: Trajectory, trains: _Trains) -> Iterator[TrajectoryBlock]:
    """Yield the shaped pieces; only pieces within the longest delay are buffered."""
    longest_s = float(trains.delay_s[-1])
    buffered: Pieces | None = None
    done = _Done()
    for new_pieces in with_rests(iter(trajectory), longest_s):
        if buffered is None:
            buffered = _standing(new_pieces, begin=True, longest=longest_s)
        buffered = joined(buffered, new_pieces)
        yield from _pieces_until(buffered, trains, done, buffered.end_s, final=False)
        first = int(
            np.searchsorted(buffered.start_s + buffered.duration_s, done.time_s - longest_s - 1e-9)
        )
        # One more piece is kept: the piece before the first breakpoint that is not finished.
        buffered = buffered.rows(max(0, first - 1), len(buffered))
    if buffered is not None:
        end_s = buffered.end_s
        buffered = joined(buffered, _standing(buffered, begin=False, longest=longest_s))
        yield from _pieces_until(buffered, trains, done, end_s + longest_s, final=True)


def _standing(pieces: Pieces, *, begin: bool, longest: float) -> Pieces:
    """Return one piece at rest at the start or at the end of the trajectory."""
    length_s = longest + 1.0
    coefficients = np.zeros((1, 1, pieces.coefficients.shape[2]))
    coefficients[0, 0] = pieces.coefficients[0, 0] if begin else pieces.coefficients[-1].sum(axis=0)
    start_s = float(pieces.start_s[0]) - length_s if begin else pieces.end_s
    row = 0 if begin else -1
    return Pieces(
        np.array([start_s]),
        np.array([length_s]),
        coefficients,
        pieces.operation[[row]],
        np.zeros(1, dtype=np.int64),
    )


@dataclass(slots=True)
class _Done:
    """Instants up to which the shaped trajectory is finished, s."""

    time_s: float = 0.0
    edge_s: float = 0.0
    run_s: float = 0.0


def _pieces_until(
    buffered: Pieces, trains: _Trains, done: _Done, until_s: float, *, final: bool
) -> Iterator[TrajectoryBlock]:
    edges = _edges(buffered, trains.delay_s, done, until_s, final=final)
    for first in range(0, len(edges) - 1, _PIECES):
        yield _block(buffered, trains, done, edges[first : first + _PIECES + 1])
    done.time_s = float(edges[-1])


def _edges(
    buffered: Pieces, delay_s: FloatArray, done: _Done, until_s: float, *, final: bool
) -> FloatArray:
    """Return (n,) breakpoints, s: the last one of the finished part, and those after it.

    Of breakpoints that coincide only the first is kept. All breakpoints up to ``until_s`` are
    known, so the result does not depend on the blocks of the trajectory.
    """
    still = buffered.still
    # The joint of two pieces at rest is no breakpoint.
    breakpoints = np.concatenate([[False], ~(still[1:] & still[:-1])])
    source_s = buffered.start_s[breakpoints]
    edges = np.add.outer(source_s, delay_s).ravel()
    edges = np.sort(edges[(edges > done.edge_s) & (edges <= until_s)])
    merge_distance_s = np.maximum(_COINCIDENT_S, 4.0 * np.spacing(edges))
    kept_edges = edges[np.diff(edges, prepend=done.edge_s) > merge_distance_s]
    if len(edges):
        done.edge_s = float(edges[-1])
    kept_edges = np.concatenate([[done.time_s], kept_edges])
    if final and kept_edges[-1] < until_s:
        if len(kept_edges) > 1 and until_s - kept_edges[-1] <= max(
            _COINCIDENT_S, 4.0 * np.spacing(until_s)
        ):
            kept_edges[-1] = until_s
        else:
            kept_edges = np.append(kept_edges, until_s)
    return np.asarray(kept_edges)


def _block(buffered: Pieces, trains: _Trains, done: _Done, edges: FloatArray) -> TrajectoryBlock:
    start, duration = edges[:-1], np.diff(edges)
    middle = start + 0.5 * duration
    order = buffered.coefficients.shape[1]
    coefficients = np.zeros((len(start), order, buffered.coefficients.shape[2]))
    for delay, weights in zip(trains.delay_s, trains.amplitudes, strict=True):
        piece = _piece_at(buffered, middle - delay)
        begin_share = ((start - delay) - buffered.start_s[piece]) / buffered.duration_s[piece]
        scale = duration / buffered.duration_s[piece]
        coefficients += weights * _shifted(buffered.coefficients[piece], begin_share, scale)
    return TrajectoryBlock(
        start_s=start,
        duration_s=duration,
        coefficients=coefficients,
        operation=_operations(buffered, trains.centroid_s, done, middle),
    )


def _piece_at(buffered: Pieces, time_s: FloatArray) -> IntArray:
    piece = np.searchsorted(buffered.start_s, time_s, side="right") - 1
    return np.asarray(np.clip(piece, 0, len(buffered) - 1), dtype=np.int64)


def _shifted(coefficients: FloatArray, begin: FloatArray, scale: FloatArray) -> FloatArray:
    """Return (n, order, axes) the polynomials in v, where u = begin + scale v.

    Each coefficient keeps its relative accuracy even for a very short new piece, because powers of
    ``scale`` are factors of the coefficients.
    """
    order = coefficients.shape[1]
    result = np.zeros_like(coefficients)
    powers = begin[:, None] ** np.arange(order)
    for j in range(order):
        for m in range(j, order):
            factor = comb(m, j) * powers[:, m - j] * scale**j
            result[:, j] += factor[:, None] * coefficients[:, m]
    return result


def _operations(buffered: Pieces, centroid_s: float, done: _Done, middle: FloatArray) -> IntArray:
    """Return (n,) operations: at the centroid of the train, but not before the latest rest."""
    run_starts_s = np.concatenate([[done.run_s], buffered.start_s[buffered.run == 1]])
    run_starts_s = np.sort(run_starts_s)
    run_start_s = run_starts_s[
        np.maximum(np.searchsorted(run_starts_s, middle, side="right") - 1, 0)
    ]
    done.run_s = max(done.run_s, float(run_start_s[-1]))
    # A rounding is added, so that the instant falls into the piece that starts there.
    earliest_s = run_start_s + 4.0 * np.spacing(np.abs(run_start_s))
    return buffered.operation[_piece_at(buffered, np.maximum(middle - centroid_s, earliest_s))]
