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


def executed_moves(ends: FloatArray, begin: FloatArray, *, last: bool) -> NDArray[np.bool_]:
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
    whole_ends = np.rint(ends)
    is_kept = np.ones(len(ends), dtype=bool)
    displacement = np.diff(whole_ends, axis=0, prepend=np.rint(begin)[None])
    if np.all(np.abs(displacement).max(axis=1) >= _LEAST_STEPS):
        return is_kept
    last_end, last_kept = np.rint(begin), -1
    for row, end in enumerate(whole_ends):
        is_kept[row] = np.abs(end - last_end).max() >= _LEAST_STEPS
        if is_kept[row]:
            last_end, last_kept = end, row
    if last and not is_kept[-1]:
        is_kept[-1] = True
        if last_kept >= 0:
            is_kept[last_kept] = False
    return is_kept


def whole_steps(start: FloatArray, way: FloatArray, steps: FloatArray) -> FloatArray:
    """Return (n, axes) moves between whole steps; moves of less than one step are unchanged.

    Parameters
    ----------
    start, way
        (n, axes), mm or degrees.
    steps
        (axes,) steps per mm or degree.
    """
    step_count = np.rint((start + way) * steps) - np.rint(start * steps)
    # As Marlin computes, in 24-bit numbers.
    step_length = np.float32(1.0) / steps.astype(np.float32)
    rounded_way = (step_count.astype(np.float32) * step_length).astype(float)
    return np.where(np.any(rounded_way, axis=1)[:, None], rounded_way, way)


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
    buffered_count = np.arange(first, first + len(length))
    time_s = length / programmed
    is_short = (buffered_count >= _FEW[0]) & (buffered_count <= _FEW[1]) & (time_s < short_s)
    slowed_s = time_s + 2.0 * (short_s - time_s) / np.maximum(buffered_count, 1)
    return np.where(is_short, length / np.where(is_short, slowed_s, 1.0), programmed)


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
    step_count = np.rint(moves.length * _per_length(moves, steps)).astype(np.float32)
    inverse = one / moves.length.astype(np.float32)
    limits = np.stack([moves.speed, moves.acceleration])
    limited_rates = np.floor(limits * _per_length(moves, steps) * (1.0 + _EXACT))
    with np.errstate(over="ignore", invalid="ignore"):
        rate = np.ceil(step_count * (inverse * programmed.astype(np.float32)))
        gain = np.ceil(np.float32(most) * (step_count * inverse))
    goals = np.stack([programmed, np.full(len(moves), most)])
    is_limited = limits < goals * (1.0 - _ROUNDING)
    return np.maximum(
        np.where(is_limited, limited_rates, np.stack([rate, gain]).astype(float)), 1.0
    )


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
    first_rate, last_rate = (
        np.maximum(np.rint(np.sqrt(v) * per_length), 1.0) for v in (enter, leave)
    )
    # As Marlin computes: a step more or less at the end may take long.
    half_inverse = np.float32(0.5) * (np.float32(1.0) / rate.astype(np.float32))
    nominal2, *ends2 = (v.astype(np.float32) ** 2 for v in (nominal, first_rate, last_rate))
    rise_steps, fall_steps = (half_inverse * (nominal2 - v) for v in ends2)
    whole = count.astype(np.float32)
    steps_up, steps_down = np.maximum(np.ceil(rise_steps), 0.0), np.ceil(fall_steps)
    is_short = count < steps_up + steps_down
    steps_up = np.where(
        is_short, np.floor(np.float32(0.5) * ((whole + rise_steps) - fall_steps) + 0.5), steps_up
    )
    steps_up = np.clip(steps_up.astype(float), 0.0, count)
    steps_down = np.where(is_short, count - steps_up, np.clip(steps_down, 0.0, count - steps_up))
    steps_level = count - steps_up - steps_down
    top = np.minimum(np.sqrt(first_rate**2 + 2.0 * rate * steps_up), nominal)
    top = np.where(steps_level > 0.0, nominal, np.maximum(top, 1.0))
    first_rate = np.minimum(first_rate, top)
    rising = 0.5 * (top**2 - first_rate**2) / rate
    steps_level += np.maximum(steps_up - rising, 0.0)
    end = np.sqrt(np.maximum(top**2 - 2.0 * rate * steps_down, np.minimum(last_rate, top) ** 2))
    falling = 0.5 * (top**2 - end**2) / rate
    steps_left = np.maximum(steps_down - falling, 0.0)
    zero = np.zeros(len(moves))
    lengths = np.stack([rising, steps_level, falling, steps_left], axis=1)
    travelled = lengths.sum(axis=1)
    time_s = np.stack(
        [(top - first_rate) / rate, steps_level / top, (top - end) / rate, steps_left / end], axis=1
    )
    begin = np.concatenate((zero[:, None], np.cumsum(lengths, axis=1)[:, :-1]), axis=1)
    speed = np.stack([first_rate, top, top, end], axis=1)
    bend = np.stack([rate, zero, -rate, zero], axis=1)
    return time_s, *(one / travelled[:, None] for one in (begin, speed, bend))


def _per_length(moves: Moves, steps: FloatArray) -> FloatArray:
    """Return the (n,) steps per length of each move, for the axis with most steps."""
    return np.asarray((np.abs(moves.direction) * steps).max(axis=1))
