"""Marlin's changes of moves before planning: whole steps, no moves of a few steps, least speeds.

Sources: Marlin 2.1 (bugfix-2.1.x, planned for 2.1.3), marlinfw.org/docs/configuration,
``MIN_STEPS_PER_SEGMENT``, ``SLOWDOWN`` and ``MINIMUM_PLANNER_SPEED``, and the behaviour of its
``planner.cpp``, described here in other words.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray
from threadline.motion.timing.firmware.rules import Moves

_LEAST_STEPS = 6  # of the axis with most: a shorter move waits for the next
_FEW = (2, 7)  # buffered moves: up to half of the ring
_ROUNDING, _EXACT = 1e-6, 1e-12  # of its 24-bit numbers, and of ours


def kept_moves(ends: FloatArray, begin: FloatArray, *, last: bool) -> NDArray[np.bool_]:
    """Return (n,) whether a move is executed at its end, and not merged with the next.

    Parameters
    ----------
    ends
        (n, axes) ends of the moves, steps.
    begin
        (axes,) end of the last executed move.
    last
        Whether the machine rests after these moves: it then ends exactly where the program says, if
        necessary by skipping the previous end.
    """
    whole = np.rint(ends)
    found = np.ones(len(ends), dtype=bool)
    way = np.diff(whole, axis=0, prepend=np.rint(begin)[None])
    if np.all(np.abs(way).max(axis=1) >= _LEAST_STEPS):
        return found
    at, kept = np.rint(begin), -1
    for row, end in enumerate(whole):
        found[row] = np.abs(end - at).max() >= _LEAST_STEPS
        if found[row]:
            at, kept = end, row
    if last and not found[-1]:
        found[-1] = True
        if kept >= 0:
            found[kept] = False
    return found


def whole_steps(start: FloatArray, way: FloatArray, steps: FloatArray) -> FloatArray:
    """Return (n, axes) moves between whole steps; moves of less than one step are unchanged.

    Parameters
    ----------
    start, way
        (n, axes), mm or degrees.
    steps
        (axes,) steps per mm or degree.
    """
    count = np.rint((start + way) * steps) - np.rint(start * steps)
    # As Marlin computes, in 24-bit numbers.
    size = np.float32(1.0) / steps.astype(np.float32)
    rounded = (count.astype(np.float32) * size).astype(float)
    return np.where(np.any(rounded, axis=1)[:, None], rounded, way)


def least_squares(moves: Moves, steps: FloatArray) -> FloatArray:
    """Return the (n,) least v^2 of each move: half of its gain over its first step.

    The speed of the move itself is never below this.
    """
    per_length = _per_length(moves, steps)
    return np.asarray(np.minimum(0.5 * moves.acceleration / per_length, moves.speed**2))


def held_back(length: FloatArray, programmed: FloatArray, first: int, short_s: float) -> FloatArray:
    """Return the (n,) speeds of moves, slowed while few of them are buffered.

    Parameters
    ----------
    length
        (n,) lengths of the moves.
    programmed
        (n,) speed that F asks for, infinite for rapid moves without.
    first
        Number of earlier moves since the machine rested.
    short_s
        Time (``M205 B``) below which a move is slowed while few are buffered.
    """
    ahead = np.arange(first, first + len(length))
    takes_s = length / programmed
    short = (ahead >= _FEW[0]) & (ahead <= _FEW[1]) & (takes_s < short_s)
    slow_s = takes_s + 2.0 * (short_s - takes_s) / np.maximum(ahead, 1)
    return np.where(short, length / np.where(short, slow_s, 1.0), programmed)


def whole_rates(moves: Moves, programmed: FloatArray, most: float, steps: FloatArray) -> FloatArray:
    """Return (2, n) whole steps per second, and per second squared, of moves at their own speed.

    Requested values are rounded upwards, limits of the axes downwards.

    Parameters
    ----------
    moves
        The moves, with the speed and the acceleration limits of their axes.
    programmed
        (n,) requested speed.
    most
        Requested acceleration, infinite for none.
    steps
        (axes,) steps per mm or degree.
    """
    # As Marlin computes: a product that is a whole number may become one more.
    one = np.float32(1.0)
    count = np.rint(moves.length * _per_length(moves, steps)).astype(np.float32)
    inverse = one / moves.length.astype(np.float32)
    allowed = np.stack([moves.speed, moves.acceleration])
    slower = np.floor(allowed * _per_length(moves, steps) * (1.0 + _EXACT))
    with np.errstate(over="ignore", invalid="ignore"):
        rate = np.ceil(count * (inverse * programmed.astype(np.float32)))
        gain = np.ceil(np.float32(most) * (count * inverse))
    goals = np.stack([programmed, np.full(len(moves), most)])
    limited = allowed < goals * (1.0 - _ROUNDING)
    return np.maximum(np.where(limited, slower, np.stack([rate, gain]).astype(float)), 1.0)


def in_steps(
    moves: Moves, rates: FloatArray, enter: FloatArray, leave: FloatArray, steps: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return (n, 4) times in s, beginnings, speeds and accelerations of the parts of n moves.

    A move speeds up for a number of whole steps, keeps its speed, slows down for a number of steps,
    and continues at the final speed for the rest of a step. All but the times are shares of the
    move.

    Parameters
    ----------
    rates
        (2, n) as from ``whole_rates``.
    enter, leave
        (n,) v^2 at both ends.
    steps
        (axes,) steps per mm or degree.
    """
    per_length = _per_length(moves, steps)
    count = np.maximum(np.rint(moves.length * per_length), 1.0)
    nominal, rate = rates
    first, last = (np.maximum(np.rint(np.sqrt(v) * per_length), 1.0) for v in (enter, leave))
    # As Marlin computes: a step more or less at the end may take long.
    half = np.float32(0.5) * (np.float32(1.0) / rate.astype(np.float32))
    square, *ends = (v.astype(np.float32) ** 2 for v in (nominal, first, last))
    rises, falls = (half * (square - v) for v in ends)
    whole = count.astype(np.float32)
    up, down = np.maximum(np.ceil(rises), 0.0), np.ceil(falls)
    short = count < up + down
    up = np.where(short, np.floor(np.float32(0.5) * ((whole + rises) - falls) + 0.5), up)
    up = np.clip(up.astype(float), 0.0, count)
    down = np.where(short, count - up, np.clip(down, 0.0, count - up))
    level = count - up - down
    top = np.minimum(np.sqrt(first**2 + 2.0 * rate * up), nominal)
    top = np.where(level > 0.0, nominal, np.maximum(top, 1.0))
    first = np.minimum(first, top)
    rising = 0.5 * (top**2 - first**2) / rate
    level += np.maximum(up - rising, 0.0)
    end = np.sqrt(np.maximum(top**2 - 2.0 * rate * down, np.minimum(last, top) ** 2))
    falling = 0.5 * (top**2 - end**2) / rate
    left = np.maximum(down - falling, 0.0)
    zero = np.zeros(len(moves))
    lengths = np.stack([rising, level, falling, left], axis=1)
    way = lengths.sum(axis=1)
    time_s = np.stack([(top - first) / rate, level / top, (top - end) / rate, left / end], axis=1)
    begin = np.concatenate((zero[:, None], np.cumsum(lengths, axis=1)[:, :-1]), axis=1)
    speed = np.stack([first, top, top, end], axis=1)
    bend = np.stack([rate, zero, -rate, zero], axis=1)
    return time_s, *(one / way[:, None] for one in (begin, speed, bend))


def _per_length(moves: Moves, steps: FloatArray) -> FloatArray:
    """Return the (n,) steps per length of each move, for the axis with most steps."""
    return np.asarray((np.abs(moves.direction) * steps).max(axis=1))
