"""The fastest turns of a shaft whose frame keeps ringing: a beam search over speed and swing.

Turn by turn, the state is the speed of the shaft, on a grid, and the complex swing of every mode.
The next speed decides how far the swing decays and rotates until the next move ends, and how much
the next move adds. The search follows the swing on several machines at once (different dampings,
modes off by a share); on each of them it must be within the tolerance when a needle enters.

A dynamic program over pairs of speeds gives the shortest time to go. It assumes the best swing
within the tolerance before each pair of turns, so it is a lower bound for every schedule on
the grid. The beam ranks its states by the time so far plus this bound. At each speed it keeps one
state for each cell of swings, because a later long move needs a slow turn before it, and a swing
with the right phase. If two states have the same speed and cell, the one with the lower rank stays.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import ComplexArray, FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.commands.stitch_speeds import SLACK, Speeds, Swings, TurnMoves

WIDTH, WIDER = 5, 20
"""States kept per turn at each speed, and in a second search."""
_COLUMNS = 100  # with more, fewer states are kept
_MISSING = 300  # states kept at a turn where every state is over the tolerance
_CELLS, _OUTER = 3.0, 12.0  # cells of the swing per tolerance, and cells to each side
_MOST_CACHED = 60_000_000  # states of all turns
_BUCKETS = 4096  # buckets of ranks; states in one bucket count as equal


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FastestTurns:
    """The found turns.

    Parameters
    ----------
    turn_s
        (n,) time of each turn, s.
    missed
        (n,) 1 where every speed in reach is over the tolerance.
    bound_s
        No schedule on the grid takes less time, s.
    """

    turn_s: FloatArray
    missed: IntArray
    bound_s: float


class _Frame(NamedTuple):
    """The frame under the moves of a design, and its swing; see ``TurnMoves`` and ``Swings``.

    Parameters
    ----------
    decay
        (P, M) factor on the swing from the end of one window to the end of the next.
    tolerance_m
        Largest swing of an axis when the needle enters, m.
    """

    travels_m: FloatArray
    needle: IntArray
    fresh: ComplexArray
    decay: ComplexArray
    late: FloatArray
    axis: IntArray
    last: IntArray
    named: IntArray
    tolerance_m: float


class _Bounds(NamedTuple):
    """Which turn times may keep the tolerance, for the shortest time to go.

    Parameters
    ----------
    allowed
        (n, N) whether a turn may take a time.
    judged
        (n,) whether the pair of this turn and the next must keep the tolerance.
    left
        (N, M) the most that a swing within a tolerance of 1 m leaves at the next window, m.
    ends_s
        (N,) rest after the window of the last turn, s.
    """

    allowed: NDArray[np.bool_]
    judged: NDArray[np.bool_]
    left: FloatArray
    ends_s: FloatArray


class _Beam(NamedTuple):
    """The states kept at a turn.

    Parameters
    ----------
    at
        (S,) index of the turn time.
    time_s
        (S,) time so far, s.
    swing
        (S, M) swing at the end of the window, m.
    """

    at: IntArray
    time_s: FloatArray
    swing: ComplexArray


class _Candidates(NamedTuple):
    """The followers of all states of a beam.

    Parameters
    ----------
    time_s
        Time so far, s.
    speed
        Index of the turn time.
    source
        Index of the state before.
    pair
        Index of the pair of turn times; meaningless at the first turn.
    """

    time_s: FloatArray
    speed: IntArray
    source: IntArray
    pair: IntArray


class _Taken(NamedTuple):
    """The cells and speeds that states of a turn already have.

    Parameters
    ----------
    width
        Most states at each speed.
    cell, turn
        Hash table of cells: the cell in each slot, and the turn that filled the slot.
    of_speed
        (N,) number of states at each speed.
    chosen
        Candidates that became states.
    """

    width: int
    cell: IntArray
    turn: IntArray
    of_speed: IntArray
    chosen: IntArray


def fastest_turns(
    speeds: Speeds,
    swings: Swings,
    moves: TurnMoves,
    tolerance_m: float,
    share: float,
    width: int = WIDTH,
) -> FastestTurns:
    """Return the fastest turns that the search finds.

    Parameters
    ----------
    tolerance_m
        Largest swing of an axis when the needle enters, m.
    share
        Share of the window in a turn.
    width
        States kept per turn at each speed; very long designs keep fewer.
    """
    needle = moves.needle
    frame = _Frame(
        travels_m=moves.travels_m,
        needle=needle,
        fresh=swings.fresh,
        decay=np.exp(-np.outer(speeds.pair_s, swings.poles)),
        late=swings.late,
        axis=swings.axis,
        last=swings.last,
        named=swings.named,
        tolerance_m=tolerance_m,
    )
    # A pair of turns is judged if both needles enter, and the needle before them did.
    entered = np.concatenate(([True], needle == 1))
    judged = entered[:-1] & entered[1:] & np.append(entered[2:], False)
    for strict in (True, False):
        bounds = _Bounds(
            allowed=_allowed(speeds, swings, moves, tolerance_m if strict else np.inf),
            judged=judged & strict,
            left=_left(speeds, swings),
            ends_s=(1.0 - share) * speeds.turn_s,
        )
        to_go = _time_to_go(speeds, speeds.after, frame, bounds)
        if np.isfinite(to_go[0]).any():
            break
    bound_s = float((to_go[0] + share * speeds.turn_s).min())
    # A wide band has many machines, and the search follows each state on all of them.
    width = max(1, width * _COLUMNS // max(_COLUMNS, len(swings.poles)))
    width = min(width, max(1, _MOST_CACHED // (len(needle) * len(speeds.turn_s))))
    index, missed = _search(to_go, speeds, frame, width)
    return FastestTurns(turn_s=speeds.turn_s[index], missed=missed, bound_s=bound_s)


def _left(speeds: Speeds, swings: Swings) -> FloatArray:
    """Return (N, M) the most that a swing within a tolerance of 1 m leaves at the next window."""
    least_s = np.full(len(speeds.turn_s), np.inf)
    np.minimum.at(least_s, speeds.after, speeds.pair_s)
    return np.asarray(np.exp(-np.outer(least_s, swings.poles.real)) / swings.late.min(axis=0))


def _allowed(
    speeds: Speeds,
    swings: Swings,
    moves: TurnMoves,
    tolerance_m: float,
) -> NDArray[np.bool_]:
    """Return (n, N) whether a turn may take a time: some earlier swing lets it keep the tolerance.

    If the needle of the turn before entered, its swing was at most the tolerance then. It decays at
    least over the window and the shortest rest.
    """
    travels_m, needle, shortest_s = moves
    allowed = speeds.turn_s[None, :] >= shortest_s[:, None] / SLACK
    if not np.isfinite(tolerance_m):
        return np.asarray(allowed)
    left = _left(speeds, swings)
    entered = np.concatenate(([1], needle[:-1])) == 1
    judged = np.flatnonzero((needle == 1) & entered)
    for column in range(len(swings.poles)):
        # This bound does not use that nothing swings before the first turn.
        most = tolerance_m * (1.0 / swings.late[:, column] + left[:, column])
        with np.errstate(divide="ignore"):
            longest_m = most / np.abs(swings.fresh[:, column])
        travels = np.abs(travels_m[judged, swings.axis[column]])
        allowed[judged] &= travels[:, None] <= longest_m[None, :] * SLACK
    return np.asarray(allowed)


@njit(nogil=True)
def _pair_possible(k: int, i: int, j: int, pair: int, frame: _Frame, left: FloatArray) -> bool:
    """Return whether some swing before turn ``k`` lets this turn and the next keep the tolerance.

    Three disks bound the swing at the end of the window of ``k``: one around 0 (the needle of
    ``k``), one around the swing of the move of ``k`` (earlier swings), and one around the swing
    that the next move cancels. If two of them do not meet, no swing is in all three.
    """
    travels_m, fresh, decay, axis, late = (
        frame.travels_m,
        frame.fresh,
        frame.decay,
        frame.axis,
        frame.late,
    )
    tolerance_m = frame.tolerance_m
    for c in range(len(axis)):
        z = decay[pair, c]
        share = np.sqrt(z.real * z.real + z.imag * z.imag)
        then = tolerance_m / late[j, c]
        own = travels_m[k + 1, axis[c]] * fresh[j, c]
        most = (then + share * tolerance_m / late[i, c]) * SLACK
        if own.real * own.real + own.imag * own.imag > most * most:
            return False
        both = own + z * (travels_m[k, axis[c]] * fresh[i, c])
        most = (then + share * tolerance_m * left[i, c]) * SLACK
        if k > 0 and both.real * both.real + both.imag * both.imag > most * most:
            return False
        if k == 0 and both.real * both.real + both.imag * both.imag > then * then * SLACK:
            return False
    return True


@njit(nogil=True)
def _time_to_go(speeds: Speeds, after: IntArray, frame: _Frame, bounds: _Bounds) -> FloatArray:
    """Return (n, N) the shortest time from the window of each turn to the end; inf if none."""
    allowed, judged, left, ends_s = bounds
    begin, pair_s = speeds.begin, speeds.pair_s
    turns, count = allowed.shape
    found = np.full((turns, count), np.inf)
    for j in range(count):
        if allowed[turns - 1, j]:
            found[turns - 1, j] = ends_s[j]
    for k in range(turns - 2, -1, -1):
        for i in range(count):
            if not allowed[k, i]:
                continue
            best = np.inf
            for pair in range(begin[i], begin[i + 1]):
                j = after[pair]
                time = pair_s[pair] + found[k + 1, j]
                if time < best and (not judged[k] or _pair_possible(k, i, j, pair, frame, left)):
                    best = time
            found[k, i] = best
    return found


@njit(nogil=True)
def _swing(turn: int, way_m: float, fresh: complex, before: complex, decay: complex) -> complex:
    """Return the swing at the end of a window; ``before`` is the swing at the end of the last."""
    own = way_m * fresh
    return own + before * decay if turn > 0 else own


@njit(nogil=True)
def _largest_swing(
    k: int, h: int, j: int, pair: int, most_m: float, frame: _Frame, swing: ComplexArray
) -> float:
    """Return the largest swing of an axis when the needle enters; any value above ``most_m``."""
    travels_m, fresh, decay, axis = frame.travels_m, frame.fresh, frame.decay, frame.axis
    late, last = frame.late, frame.last
    worst, total = 0.0, 0.0
    for c in range(len(last)):
        value = _swing(k, travels_m[k, axis[c]], fresh[j, c], swing[h, c], decay[pair, c])
        total += np.sqrt(value.real * value.real + value.imag * value.imag) * late[j, c]
        if last[c] == 1:
            worst = max(worst, total)
            total = 0.0
            if worst > most_m:
                break
    return worst


@njit(nogil=True)
def _find_followers(
    k: int, states: int, beam: _Beam, to_go: FloatArray, speeds: Speeds, found: _Candidates
) -> int:
    """Fill ``found`` with the followers of each state; return their number."""
    at, so_far, first, begin, pair_s = (
        beam.at,
        beam.time_s,
        speeds.first,
        speeds.begin,
        speeds.pair_s,
    )
    time, speed, source, pair = found
    count = 0
    for h in range(states):
        low, high = 0, to_go.shape[1]
        if k > 0:
            low = first[at[h]]
            high = low + begin[at[h] + 1] - begin[at[h]]
        for j in range(low, high):
            if to_go[k, j] < np.inf:
                pair[count] = begin[at[h]] + j - low
                time[count] = so_far[h] + pair_s[pair[count]] if k > 0 else 0.0
                speed[count], source[count] = j, h
                count += 1
    return count


@njit(nogil=True)
def _sort(rank: FloatArray, found: int, count: IntArray, order: IntArray) -> None:
    """Fill ``order`` with the places of ``rank`` by rising value, to a share of their range."""
    least, most = np.inf, -np.inf
    for q in range(found):
        least, most = min(least, rank[q]), max(most, rank[q])
    scale = (len(count) - 2) / (most - least) if most > least else 0.0
    count[:] = 0
    for q in range(found):
        count[int((rank[q] - least) * scale) + 1] += 1
    for b in range(1, len(count)):
        count[b] += count[b - 1]
    for q in range(found):
        b = int((rank[q] - least) * scale)
        order[count[b]] = q
        count[b] += 1


@njit(nogil=True)
def _select(
    k: int, most_m: float, order: IntArray, frame: _Frame, swing: ComplexArray,
    found: _Candidates, taken: _Taken,
) -> int:  # fmt: skip
    """Choose the first of each speed and cell in ``order``; return their number.

    The swing is calculated only while its speed has a place left.
    """
    travels_m, fresh, decay, axis = frame.travels_m, frame.fresh, frame.decay, frame.axis
    needle, named, tolerance_m = frame.needle, frame.named, frame.tolerance_m
    speed, source, pairs = found.speed, found.source, found.pair
    width, seen, stamp, of_speed, chosen = taken
    of_speed[:] = 0
    states = 0
    for q in order:
        h, j, pair = source[q], speed[q], pairs[q]
        if of_speed[j] >= width:
            continue
        cell: Any = j
        for c in named:
            value = _swing(k, travels_m[k, axis[c]], fresh[j, c], swing[h, c], decay[pair, c])
            # Swings far outside of the tolerance share the outer cells.
            for part in (value.real, value.imag):
                near = min(max(part * (_CELLS / tolerance_m), -_OUTER), _OUTER)
                cell = cell * 64 + np.int64(np.floor(near)) + 32
        slot = (cell * 2654435761) % len(seen)
        while stamp[slot] == k and seen[slot] != cell:
            slot = (slot + 1) % len(seen)
        if stamp[slot] == k:
            continue
        over_is_refused = needle[k] == 1 and most_m < np.inf
        if over_is_refused and _largest_swing(k, h, j, pair, most_m, frame, swing) > most_m:
            continue
        stamp[slot], seen[slot] = k, cell
        of_speed[j] += 1
        chosen[states] = q
        states += 1
        if most_m == np.inf and states == _MISSING:
            break
    return states


@njit(nogil=True)
def _search(
    to_go: FloatArray, speeds: Speeds, frame: _Frame, width: int
) -> tuple[IntArray, IntArray]:
    """Return (n,) index of the turn time of each turn, and (n,) 1 where the tolerance is missed."""
    travels_m, fresh, decay, axis = frame.travels_m, frame.fresh, frame.decay, frame.axis
    needle, tolerance_m, columns = frame.needle, frame.tolerance_m, len(axis)
    turns, count = to_go.shape
    most_states = width * count
    room = max(width * len(speeds.pair_s), count)
    rank, order, buckets = np.empty(room), np.empty(room, np.int64), np.empty(_BUCKETS, np.int64)
    found = _Candidates(
        np.empty(room), np.empty(room, np.int64), np.empty(room, np.int64), np.empty(room, np.int64)
    )
    places = 4 * most_states + 1
    taken = _Taken(
        width,
        np.zeros(places, np.int64),
        np.full(places, -1, np.int64),
        np.zeros(count, np.int64),
        np.empty(most_states, np.int64),
    )
    beam = _Beam(
        np.zeros(most_states, np.int64),
        np.zeros(most_states),
        np.zeros((most_states, columns), np.complex128),
    )
    back = np.empty((turns, most_states), np.int32)
    speed_of = np.empty((turns, most_states), np.int16)
    missed = np.zeros(turns, np.int64)
    states = 1
    for k in range(turns):
        followers = _find_followers(k, states, beam, to_go, speeds, found)
        states = 0
        for most_m in (tolerance_m, np.inf):
            for q in range(followers):
                j = found.speed[q]
                rank[q] = found.time_s[q] + to_go[k, j]
                if most_m == np.inf and needle[k] == 1:
                    # The least swing goes first; the time decides among equals.
                    h, pair = found.source[q], found.pair[q]
                    over = _largest_swing(k, h, j, pair, most_m, frame, beam.swing)
                    rank[q] = over + 1e-9 * tolerance_m * rank[q]
            _sort(rank, followers, buckets, order)
            states = _select(k, most_m, order[:followers], frame, beam.swing, found, taken)
            if states > 0:
                break
            missed[k] = 1
        new_swing = np.empty((states, columns), np.complex128)
        new_at, new_time = np.empty(states, np.int64), np.empty(states)
        for s in range(states):
            q = taken.chosen[s]
            h, j, pair = found.source[q], found.speed[q], found.pair[q]
            for c in range(columns):
                new_swing[s, c] = _swing(
                    k, travels_m[k, axis[c]], fresh[j, c], beam.swing[h, c], decay[pair, c]
                )
            new_at[s], new_time[s] = j, found.time_s[q]
            back[k, s], speed_of[k, s] = h, j
        beam.at[:states], beam.time_s[:states], beam.swing[:states] = new_at, new_time, new_swing
    best = int(np.argmin(beam.time_s[:states] + to_go[turns - 1][beam.at[:states]]))
    index = np.empty(turns, np.int64)
    for k in range(turns - 1, -1, -1):
        index[k] = speed_of[k, best]
        best = back[k, best]
    return index, missed
