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
    tick_s: float | None = None,
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
    tick_s
        Put the impulses on whole ticks with :func:`on_tick_grid`, so that a controller that holds
        its reference for a tick still plays the exact convolution of the held reference; None
        keeps the exact times.

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
    trains = _trains(trajectory.axes, shaper, tick_s, centroid_shift=centroid_shift)
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
    tick_s: float | None = None,
) -> float:
    """Return the time that :func:`shape_trajectory` adds at the end, and at every rest, s."""
    return float(_trains(axes, shaper, tick_s, centroid_shift=centroid_shift).delay_s[-1])


def on_tick_grid(shaper: Shaper, tick_s: float) -> Shaper:
    """Return the train with every impulse shared between the two ticks beside it.

    The shares follow from linear interpolation, so that sum and centroid are unchanged. V changes
    by at most (2 pi f tick)^2 / 8 times the impulse. :func:`threadline.motion.shaping.realise`
    moves the impulses, and can solve their amplitudes again for the modes.

    Raises
    ------
    OptionError
        If ``tick_s`` is not positive.
    """
    if not (np.isfinite(tick_s) and tick_s > 0.0):
        raise OptionError(f"shaper '{shaper.name}': tick_s must be positive, got {tick_s!r}")
    ticks = shaper.times_s / tick_s
    whole = np.rint(ticks)
    ticks = np.where(np.abs(ticks - whole) < 1e-9, whole, ticks)
    below = np.floor(ticks)
    share = ticks - below
    at = np.concatenate([below, below + 1.0]).astype(np.int64)
    weight = np.concatenate([shaper.amplitudes * (1.0 - share), shaper.amplitudes * share])
    amplitudes = np.zeros(int(at.max()) + 1)
    np.add.at(amplitudes, at, weight)
    used = np.flatnonzero(np.abs(amplitudes) > 1e-15)
    return Shaper(
        amplitudes=amplitudes[used],
        times_s=np.asarray(used * tick_s, dtype=np.float64),
        name=f"{shaper.name} on ticks",
    )


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
    tick_s: float | None,
    *,
    centroid_shift: bool,
) -> _Trains:
    if isinstance(shaper, Shaper):
        own = [shaper] * len(axes)
    else:
        for name in shaper:
            if name not in axes:
                raise OptionError(
                    f"shaper of axis {name!r}: the trajectory has axes {', '.join(axes)}",
                    remedy="Name one of them.",
                )
        own = [shaper.get(axis, UNSHAPED) for axis in axes]
    if tick_s is not None:
        own = [on_tick_grid(one, tick_s) for one in own]
    for one in own:
        if abs(float(one.amplitudes.sum()) - 1.0) > _UNIT_SUM:
            raise OptionError(
                f"shaper '{one.name}': amplitudes sum to {one.amplitudes.sum():.12g}; a shaped "
                "move ends where it was planned only if they sum to 1"
            )
    latest = max(one.centroid_s for one in own)
    shift = [latest - one.centroid_s if centroid_shift else 0.0 for one in own]
    delays = np.concatenate([one.times_s + late for one, late in zip(own, shift, strict=True)])
    ordered = np.sort(delays)
    distinct = ordered[np.diff(ordered, prepend=-1.0) > _COINCIDENT_S]
    amplitudes = np.zeros((len(distinct), len(axes)))
    for column, (one, late) in enumerate(zip(own, shift, strict=True)):
        nearest = np.abs(distinct[None, :] - (one.times_s + late)[:, None]).argmin(axis=1)
        np.add.at(amplitudes[:, column], nearest, one.amplitudes)
    centroid_s = float((distinct @ amplitudes).mean())
    # The centroid of a train with negative impulses may lie outside the buffered pieces.
    inside = min(max(0.0, centroid_s), float(distinct[-1]))
    return _Trains(distinct, amplitudes, inside)


def _convolved(trajectory: Trajectory, trains: _Trains) -> Iterator[TrajectoryBlock]:
    """Yield the shaped pieces; only pieces within the longest delay are buffered."""
    longest = float(trains.delay_s[-1])
    held: Pieces | None = None
    done = _Done()
    for fresh in with_rests(iter(trajectory), longest):
        if held is None:
            held = _standing(fresh, begin=True, longest=longest)
        held = joined(held, fresh)
        yield from _pieces_until(held, trains, done, held.end_s, final=False)
        first = int(np.searchsorted(held.start_s + held.duration_s, done.time_s - longest - 1e-9))
        # One more piece is kept: the piece before the first breakpoint that is not finished.
        held = held.rows(max(0, first - 1), len(held))
    if held is not None:
        end_s = held.end_s
        held = joined(held, _standing(held, begin=False, longest=longest))
        yield from _pieces_until(held, trains, done, end_s + longest, final=True)


def _standing(pieces: Pieces, *, begin: bool, longest: float) -> Pieces:
    """Return one piece at rest at the start or at the end of the trajectory."""
    length = longest + 1.0
    coefficients = np.zeros((1, 1, pieces.coefficients.shape[2]))
    coefficients[0, 0] = pieces.coefficients[0, 0] if begin else pieces.coefficients[-1].sum(axis=0)
    at_s = float(pieces.start_s[0]) - length if begin else pieces.end_s
    row = 0 if begin else -1
    return Pieces(
        np.array([at_s]),
        np.array([length]),
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
    held: Pieces, trains: _Trains, done: _Done, until_s: float, *, final: bool
) -> Iterator[TrajectoryBlock]:
    edges = _edges(held, trains.delay_s, done, until_s, final=final)
    for first in range(0, len(edges) - 1, _PIECES):
        yield _block(held, trains, done, edges[first : first + _PIECES + 1])
    done.time_s = float(edges[-1])


def _edges(
    held: Pieces, delay_s: FloatArray, done: _Done, until_s: float, *, final: bool
) -> FloatArray:
    """Return (n,) breakpoints, s: the last one of the finished part, and those after it.

    Of breakpoints that coincide only the first is kept. All breakpoints up to ``until_s`` are
    known, so the result does not depend on the blocks of the trajectory.
    """
    still = held.still
    # The joint of two pieces at rest is no breakpoint.
    bends = np.concatenate([[False], ~(still[1:] & still[:-1])])
    source = held.start_s[bends]
    edges = np.add.outer(source, delay_s).ravel()
    edges = np.sort(edges[(edges > done.edge_s) & (edges <= until_s)])
    close = np.maximum(_COINCIDENT_S, 4.0 * np.spacing(edges))
    kept = edges[np.diff(edges, prepend=done.edge_s) > close]
    if len(edges):
        done.edge_s = float(edges[-1])
    kept = np.concatenate([[done.time_s], kept])
    if final and kept[-1] < until_s:
        if len(kept) > 1 and until_s - kept[-1] <= max(_COINCIDENT_S, 4.0 * np.spacing(until_s)):
            kept[-1] = until_s
        else:
            kept = np.append(kept, until_s)
    return np.asarray(kept)


def _block(held: Pieces, trains: _Trains, done: _Done, edges: FloatArray) -> TrajectoryBlock:
    start, duration = edges[:-1], np.diff(edges)
    middle = start + 0.5 * duration
    order = held.coefficients.shape[1]
    coefficients = np.zeros((len(start), order, held.coefficients.shape[2]))
    for delay, weights in zip(trains.delay_s, trains.amplitudes, strict=True):
        at = _piece_at(held, middle - delay)
        begin = ((start - delay) - held.start_s[at]) / held.duration_s[at]
        scale = duration / held.duration_s[at]
        coefficients += weights * _shifted(held.coefficients[at], begin, scale)
    return TrajectoryBlock(
        start_s=start,
        duration_s=duration,
        coefficients=coefficients,
        operation=_operations(held, trains.centroid_s, done, middle),
    )


def _piece_at(held: Pieces, time_s: FloatArray) -> IntArray:
    at = np.searchsorted(held.start_s, time_s, side="right") - 1
    return np.asarray(np.clip(at, 0, len(held) - 1), dtype=np.int64)


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


def _operations(held: Pieces, centroid_s: float, done: _Done, middle: FloatArray) -> IntArray:
    """Return (n,) operations: at the centroid of the train, but not before the latest rest."""
    runs = np.concatenate([[done.run_s], held.start_s[held.run == 1]])
    runs = np.sort(runs)
    begun = runs[np.maximum(np.searchsorted(runs, middle, side="right") - 1, 0)]
    done.run_s = max(done.run_s, float(begun[-1]))
    # A rounding is added, so that the instant falls into the piece that starts there.
    inside = begun + 4.0 * np.spacing(np.abs(begun))
    return held.operation[_piece_at(held, np.maximum(middle - centroid_s, inside))]
