"""The fastest turns of a shaft whose frame keeps ringing: a beam search over speed and swing.

Turn by turn, the state is the speed of the shaft, on a grid, and the complex swing of every mode.
The next speed decides how long the swing decays and turns before the next move ends, and how much
that move adds. The same swing is followed on several machines at once (damping, mode off by a
share); each of them must be within the tolerance when a needle enters.

A dynamic program over pairs of speeds gives the shortest time to go. It assumes the best swing
within the tolerance before each pair of turns, so it is a lower bound for every schedule on
the grid. The beam ranks its states by the time so far plus this bound. At each speed it keeps the
best of each cell of swings, because a long move later needs a slow turn before it, and a swing of
the right phase. Of two states of one speed and one cell, the later one is given up.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import log
from typing import Any

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import ComplexArray, FloatArray, IntArray
from threadline.base.compiled import njit

_COARSE = 0.03  # relative steps of the turn time beyond the fine grid
WIDTH, WIDER = 5, 20
"""States kept per turn at each speed, and in a second search."""
_COLUMNS = 100  # with more, fewer states are kept
_MISSING = 300  # states kept where none keeps the tolerance
_CELLS, _OUTER = 3.0, 12.0  # cells of the swing per tolerance, and cells to each side
_MOST_KEPT = 60_000_000  # states of all turns
_BUCKETS = 4096  # of ranks: states in one of them count as equal
_SLACK = 1.0 + 1e-12


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Speeds:
    """A grid of turn times and the pairs that may follow each other; N times, P pairs.

    Parameters
    ----------
    turn_s
        (N,) turn times, rising, s.
    first
        (N,) index of the shortest turn that may follow.
    begin
        (N + 1,) index of the first pair of each turn; its pairs follow by rising turn time.
    pair_s
        (P,) time from the end of a window to the end of the next window, s.
    """

    turn_s: FloatArray
    first: IntArray
    begin: IntArray
    pair_s: FloatArray

    @classmethod
    def between(
        cls, ends_s: tuple[float, float, float], step: float, share: float, most: float
    ) -> Speeds:
        """Return the grid.

        Parameters
        ----------
        ends_s
            Shortest turn, end of the fine grid, and longest turn, s.
        step
            Relative step of the turn time on the fine grid.
        share
            Share of the window in a turn.
        most
            Largest change of the square of the speed from turn to turn, 1/s^2.
        """
        shortest, fine, longest = ends_s
        fine = min(max(fine, shortest * (1.0 + step)), longest)
        count = max(2, 1 + round(log(fine / shortest) / step))
        turn_s = np.geomspace(shortest, fine, count)
        if turn_s[-1] < longest:
            beyond = max(2, 1 + round(log(longest / turn_s[-1]) / _COARSE))
            turn_s = np.concatenate((turn_s, np.geomspace(turn_s[-1], longest, beyond)[1:]))
        turn_s[0], turn_s[-1] = shortest, longest
        squares = turn_s**-2.0
        near = np.abs(squares[:, None] - squares[None, :]) <= most * _SLACK
        before, after = np.nonzero(near)
        rest = 2.0 * (1.0 - share) / (1.0 / turn_s[before] + 1.0 / turn_s[after])
        return cls(
            turn_s=turn_s,
            first=near.argmax(axis=1).astype(np.int64),
            begin=np.concatenate(([0], np.cumsum(near.sum(axis=1)))).astype(np.int64),
            pair_s=rest + share * turn_s[after],
        )

    @property
    def after(self) -> IntArray:
        """(P,) index of the following turn of each pair."""
        counts = np.diff(self.begin)
        number = np.arange(len(self.pair_s)) - np.repeat(self.begin[:-1], counts)
        return np.asarray(np.repeat(self.first, counts) + number)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Swings:
    """The effect of each turn on the swing; M columns: a mode of an axis of a machine.

    The modes of one axis of one machine follow each other; their amplitudes add up.

    Parameters
    ----------
    poles
        (M,) decay and frequency of each mode, rad/s.
    fresh
        (N, M) swing at the end of a move of 1 m.
    late
        (N, M) share of the swing that is left when the needle enters.
    axis, last
        (M,) axis, and whether the column is the last of its axis and machine.
    named
        (A,) the column of each axis that distinguishes states.
    """

    poles: ComplexArray
    fresh: ComplexArray
    late: FloatArray
    axis: IntArray
    last: IntArray
    named: IntArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FastestTurns:
    """The found turns.

    Parameters
    ----------
    turn_s
        (n,) time of each turn, s.
    missed
        (n,) 1 where no speed in reach kept the tolerance.
    bound_s
        No schedule on the grid takes less time, s.
    """

    turn_s: FloatArray
    missed: IntArray
    bound_s: float


def fastest_turns(
    speeds: Speeds,
    swings: Swings,
    moves: tuple[FloatArray, IntArray, FloatArray],
    tolerance_m: float,
    share: float,
    width: int = WIDTH,
) -> FastestTurns:
    """Return the fastest turns that the search finds.

    Parameters
    ----------
    moves
        (n, A) travel of each turn, m; (n,) 1 where the needle enters; (n,) shortest turns, s.
    tolerance_m
        Largest swing of an axis when the needle enters, m.
    share
        Share of the window in a turn.
    width
        States kept per turn at each speed; very long designs keep fewer.
    """
    ways_m, needle, _ = moves
    ends_s = (1.0 - share) * speeds.turn_s
    after = speeds.after
    kept = np.exp(-np.outer(speeds.pair_s, swings.poles))
    # Two turns in a row are judged where their needles enter, and the needle before them did.
    entered = np.concatenate(([True], needle == 1))
    judged = entered[:-1] & entered[1:] & np.append(entered[2:], False)
    for strict in (True, False):
        allowed = _allowed(speeds, swings, moves, tolerance_m if strict else np.inf)
        to_go = _time_to_go(
            allowed, ends_s, speeds.begin, after, speeds.pair_s, judged & strict, tolerance_m,
            ways_m, swings.fresh, kept, swings.axis, swings.late, _left(speeds, swings),
        )  # fmt: skip
        if np.isfinite(to_go[0]).any():
            break
    bound_s = float((to_go[0] + share * speeds.turn_s).min())
    # A wide band has many machines, and the swing of each state is followed on all of them.
    width = max(1, width * _COLUMNS // max(_COLUMNS, len(swings.poles)))
    width = min(width, max(1, _MOST_KEPT // (len(needle) * len(speeds.turn_s))))
    index, missed = _beam(
        ways_m, needle, to_go, speeds.first, speeds.begin, speeds.pair_s,
        swings.fresh, kept, swings.late, swings.axis, swings.last, swings.named,
        tolerance_m, width,
    )  # fmt: skip
    return FastestTurns(turn_s=speeds.turn_s[index], missed=missed, bound_s=bound_s)


def _left(speeds: Speeds, swings: Swings) -> FloatArray:
    """Return (N, M) the most that a swing within a tolerance of 1 m leaves at the next window."""
    least_s = np.full(len(speeds.turn_s), np.inf)
    np.minimum.at(least_s, speeds.after, speeds.pair_s)
    return np.asarray(np.exp(-np.outer(least_s, swings.poles.real)) / swings.late.min(axis=0))


def _allowed(
    speeds: Speeds,
    swings: Swings,
    moves: tuple[FloatArray, IntArray, FloatArray],
    tolerance_m: float,
) -> NDArray[np.bool_]:
    """Return (n, N) whether a turn may take a time, whatever swing within the tolerance it meets.

    The swing before a turn is at most the tolerance if a needle entered then, and decays at least
    over the window and the shortest rest.
    """
    ways_m, needle, shortest_s = moves
    allowed = speeds.turn_s[None, :] >= shortest_s[:, None] / _SLACK
    if not np.isfinite(tolerance_m):
        return np.asarray(allowed)
    left = _left(speeds, swings)
    entered = np.concatenate(([1], needle[:-1])) == 1
    judged = np.flatnonzero((needle == 1) & entered)
    for column in range(len(swings.poles)):
        # Before the first turn nothing swings, which this bound leaves out.
        most = tolerance_m * (1.0 / swings.late[:, column] + left[:, column])
        with np.errstate(divide="ignore"):
            longest_m = most / np.abs(swings.fresh[:, column])
        ways = np.abs(ways_m[judged, swings.axis[column]])
        allowed[judged] &= ways[:, None] <= longest_m[None, :] * _SLACK
    return np.asarray(allowed)


def _possible(
    k: int, i: int, j: int, pair: int, tolerance_m: float,
    ways_m: FloatArray, fresh: ComplexArray, kept: ComplexArray, axis: IntArray,
    late: FloatArray, left: FloatArray,
) -> bool:  # fmt: skip
    """Return whether some swing before turn ``k`` lets this turn and the next keep the tolerance.

    The swing at the end of the window of ``k`` is in three disks: around 0 for its needle, around
    the swing of its move for earlier swings, and around the swing that the next move cancels. If
    two of them do not meet, no swing is in all.
    """
    for c in range(len(axis)):
        z = kept[pair, c]
        share = np.sqrt(z.real * z.real + z.imag * z.imag)
        then = tolerance_m / late[j, c]
        own = ways_m[k + 1, axis[c]] * fresh[j, c]
        most = (then + share * tolerance_m / late[i, c]) * _SLACK
        if own.real * own.real + own.imag * own.imag > most * most:
            return False
        both = own + z * (ways_m[k, axis[c]] * fresh[i, c])
        most = (then + share * tolerance_m * left[i, c]) * _SLACK
        if k > 0 and both.real * both.real + both.imag * both.imag > most * most:
            return False
        if k == 0 and both.real * both.real + both.imag * both.imag > then * then * _SLACK:
            return False
    return True


def _to_go(
    allowed: NDArray[np.bool_], ends_s: FloatArray,
    begin: IntArray, after: IntArray, pair_s: FloatArray, judged: NDArray[np.bool_],
    tolerance_m: float, ways_m: FloatArray, fresh: ComplexArray, kept: ComplexArray,
    axis: IntArray, late: FloatArray, left: FloatArray,
) -> FloatArray:  # fmt: skip
    """Return (n, N) the shortest time from the window of each turn to the end; inf if none."""
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
                if time < best and (
                    not judged[k]
                    or _pair(k, i, j, pair, tolerance_m, ways_m, fresh, kept, axis, late, left)
                ):
                    best = time
            found[k, i] = best
    return found


def _value(
    k: int, h: int, j: int, c: int, pair: int,
    ways_m: FloatArray, fresh: ComplexArray, kept: ComplexArray, axis: IntArray,
    swing: ComplexArray,
) -> complex:  # fmt: skip
    """Return the swing of a column at the end of window ``k``."""
    value = ways_m[k, axis[c]] * fresh[j, c]
    if k > 0:
        value += swing[h, c] * kept[pair, c]
    return value  # type: ignore[no-any-return]


def _largest(
    k: int, h: int, j: int, pair: int, most_m: float,
    ways_m: FloatArray, fresh: ComplexArray, kept: ComplexArray, axis: IntArray,
    swing: ComplexArray, late: FloatArray, last: IntArray,
) -> float:  # fmt: skip
    """Return the largest swing of an axis when the needle enters; above ``most_m``, any above."""
    worst, total = 0.0, 0.0
    for c in range(len(axis)):
        value = _swung(k, h, j, c, pair, ways_m, fresh, kept, axis, swing)
        total += np.sqrt(value.real * value.real + value.imag * value.imag) * late[j, c]
        if last[c] == 1:
            worst = max(worst, total)
            total = 0.0
            if worst > most_m:
                break
    return worst


def _continued(
    k: int, states: int, at: IntArray, so_far: FloatArray,
    to_go: FloatArray, first: IntArray, begin: IntArray, pair_s: FloatArray,
    time: FloatArray, speed: IntArray, source: IntArray,
) -> int:  # fmt: skip
    """Fill ``time`` to ``source`` with the followers of each state; return their number."""
    found = 0
    for h in range(states):
        low, high = 0, to_go.shape[1]
        if k > 0:
            low = first[at[h]]
            high = low + begin[at[h] + 1] - begin[at[h]]
        for j in range(low, high):
            if to_go[k, j] < np.inf:
                pair = begin[at[h]] + j - low
                time[found] = so_far[h] + pair_s[pair] if k > 0 else 0.0
                speed[found], source[found] = j, h
                found += 1
    return found


def _sorted(rank: FloatArray, found: int, count: IntArray, order: IntArray) -> None:
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


def _selected(
    k: int, most_m: float, order: IntArray, at: IntArray, first: IntArray, begin: IntArray,
    needle: IntArray, ways_m: FloatArray, fresh: ComplexArray, kept: ComplexArray,
    axis: IntArray, swing: ComplexArray, late: FloatArray, last: IntArray, named: IntArray,
    tolerance_m: float, width: int, speed: IntArray, source: IntArray,
    seen: IntArray, stamp: IntArray, of_speed: IntArray, chosen: IntArray,
) -> int:  # fmt: skip
    """Fill ``chosen`` with the first of each speed and cell in ``order``; return their number.

    Swings are calculated only for states that still have a place at their speed.
    """
    of_speed[:] = 0
    states = 0
    for q in order:
        h, j = source[q], speed[q]
        if of_speed[j] >= width:
            continue
        pair = begin[at[h]] + j - first[at[h]]
        cell: Any = j
        for c in named:
            value = _swung(k, h, j, c, pair, ways_m, fresh, kept, axis, swing)
            # Swings far outside of the tolerance share the outer cells.
            for part in (value.real, value.imag):
                near = min(max(part * (_CELLS / tolerance_m), -_OUTER), _OUTER)
                cell = cell * 64 + np.int64(np.floor(near)) + 32
        slot = (cell * 2654435761) % len(seen)
        while stamp[slot] == k and seen[slot] != cell:
            slot = (slot + 1) % len(seen)
        if stamp[slot] == k:
            continue
        if needle[k] == 1 and most_m < np.inf:
            over = _most(k, h, j, pair, most_m, ways_m, fresh, kept, axis, swing, late, last)
            if over > most_m:
                continue
        stamp[slot], seen[slot] = k, cell
        of_speed[j] += 1
        chosen[states] = q
        states += 1
        if most_m == np.inf and states == _MISSING:
            break
    return states


def _search(
    ways_m: FloatArray, needle: IntArray, to_go: FloatArray,
    first: IntArray, begin: IntArray, pair_s: FloatArray,
    fresh: ComplexArray, kept: ComplexArray, late: FloatArray,
    axis: IntArray, last: IntArray, named: IntArray, tolerance_m: float, width: int,
) -> tuple[IntArray, IntArray]:  # fmt: skip
    """Return (n,) index of the turn time of each turn, and (n,) 1 where the tolerance is missed."""
    turns, count = to_go.shape
    most_states = width * count
    room = max(width * len(pair_s), count)
    time, rank, order = np.empty(room), np.empty(room), np.empty(room, np.int64)
    speed, source = np.empty(room, np.int64), np.empty(room, np.int64)
    buckets, chosen = np.empty(_BUCKETS, np.int64), np.empty(most_states, np.int64)
    back, taken = np.empty((turns, most_states), np.int32), np.empty((turns, most_states), np.int16)
    missed = np.zeros(turns, np.int64)
    at, so_far = np.zeros(most_states, np.int64), np.zeros(most_states)
    swing = np.zeros((most_states, len(axis)), np.complex128)
    places = 4 * most_states + 1
    seen, stamp = np.zeros(places, np.int64), np.full(places, -1, np.int64)
    of_speed = np.zeros(count, np.int64)
    states = 1
    for k in range(turns):
        found = _followers(k, states, at, so_far, to_go, first, begin, pair_s, time, speed, source)
        states_now = 0
        for most_m in (tolerance_m, np.inf):
            for q in range(found):
                rank[q] = time[q] + to_go[k, speed[q]]
                if most_m == np.inf and needle[k] == 1:
                    # The least swing goes first; the time decides among equals.
                    h, j = source[q], speed[q]
                    pair = begin[at[h]] + j - first[at[h]]
                    over = _most(
                        k, h, j, pair, most_m, ways_m, fresh, kept, axis, swing, late, last
                    )
                    rank[q] = over + 1e-9 * tolerance_m * rank[q]
            _by_rank(rank, found, buckets, order)
            states_now = _best_states(
                k, most_m, order[:found], at, first, begin, needle, ways_m, fresh, kept, axis,
                swing, late, last, named, tolerance_m, width, speed, source,
                seen, stamp, of_speed, chosen,
            )  # fmt: skip
            if states_now > 0:
                break
            missed[k] = 1
        states = states_now
        new_swing = np.empty((states, len(axis)), np.complex128)
        new_at, new_time = np.empty(states, np.int64), np.empty(states)
        for s in range(states):
            h, j = source[chosen[s]], speed[chosen[s]]
            pair = begin[at[h]] + j - first[at[h]]
            for c in range(len(axis)):
                new_swing[s, c] = _swung(k, h, j, c, pair, ways_m, fresh, kept, axis, swing)
            new_at[s], new_time[s] = j, time[chosen[s]]
            back[k, s], taken[k, s] = h, j
        at[:states], so_far[:states], swing[:states] = new_at, new_time, new_swing
    best = int(np.argmin(so_far[:states] + to_go[turns - 1][at[:states]]))
    index = np.empty(turns, np.int64)
    for k in range(turns - 1, -1, -1):
        index[k] = taken[k, best]
        best = back[k, best]
    return index, missed


_pair = njit(nogil=True)(_possible)
_time_to_go = njit(nogil=True)(_to_go)
_swung = njit(nogil=True)(_value)
_most = njit(nogil=True)(_largest)
_followers = njit(nogil=True)(_continued)
_by_rank = njit(nogil=True)(_sorted)
_best_states = njit(nogil=True)(_selected)
_beam = njit(nogil=True)(_search)
