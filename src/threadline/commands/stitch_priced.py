"""Turns of a stretch of a schedule by a beam search that puts a price on too large a swing.

A search that refuses each swing over the tolerance ends before a passage that is narrower than its
grid of speeds, and stays slow from there on. Here such a swing costs time, so the search passes
where the excess is smallest. Linear programs then bring the turns within the tolerance
(``stitch_shorten``). Each turn has its own list of times: a grid of all speeds for a whole design,
or times close to the times of a found schedule. The last turns may be fixed, with one time each;
their swings count as well.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from threadline.base.arrays import ComplexArray, FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.commands.stitch_swings import Limits, Swung, swings_before

_OUTER = 12.0  # cells to each side of a swing
_SLACK = 1.0 + 1e-12
_TO_RANK = 1e9  # costs are compared to 1 ns, so that the rounding of a processor never decides


class PricedRequest(NamedTuple):
    """The settings of a priced search.

    Parameters
    ----------
    tolerance_m
        Largest swing of an axis that costs nothing when the needle enters, m.
    price_s
        Price of 100 % over the tolerance at one needle, s.
    most
        Share over the tolerance at which a swing is refused.
    width
        States kept per turn at each time.
    cells
        Cells of the swing per tolerance, by which states are distinguished.
    """

    tolerance_m: float
    price_s: float
    most: float
    width: int
    cells: float


class _Stretch(NamedTuple):
    """The turns of a stretch and their possible times; K turns, at most C times each, M modes.

    Parameters
    ----------
    choice_s
        (K, C) times to choose from, rising, s; the last one is repeated.
    counts
        (K,) number of different times of each turn.
    travels_m
        (K, A) travel of each turn, m.
    needle
        (K,) 1 where the needle enters.
    fresh
        (K, C, M) swing at the end of a move of 1 m.
    is_last
        Whether the design ends with the stretch.
    """

    choice_s: FloatArray
    counts: IntArray
    travels_m: FloatArray
    needle: IntArray
    fresh: ComplexArray
    is_last: bool


class _Watched(NamedTuple):
    """The modes whose swings a search follows; M modes.

    Parameters
    ----------
    poles
        (M,) decay and frequency, rad/s.
    late
        Time from the end of a window until the needle enters, in turns.
    axis
        (M,) axis of each mode.
    last
        (M,) 1 at the last mode of each group; the amplitudes of a group add up.
    named
        Modes whose swings distinguish states: the middle of the band of each axis.
    bounding
        Modes for the lower bound of the cost: the ends of the band and its middle.
    """

    poles: ComplexArray
    late: float
    axis: IntArray
    last: IntArray
    named: IntArray
    bounding: IntArray


class _CostToGo(NamedTuple):
    """Least cost from each time of a turn to the end of the stretch.

    Parameters
    ----------
    cost_s
        (K, C) least cost, s; it assumes the best swing before each pair of turns.
    low, high
        (K, C) first index, and end, of the times of the next turn that the spindle can reach.
    """

    cost_s: FloatArray
    low: IntArray
    high: IntArray


class _Beam(NamedTuple):
    """The states kept at a turn; S states.

    Parameters
    ----------
    at
        (S,) index of the time of the turn.
    cost_s
        (S,) cost so far, s.
    swing
        (S, M) swing at the end of the window, m.
    """

    at: IntArray
    cost_s: FloatArray
    swing: ComplexArray


class _Step(NamedTuple):
    """The ways from the times of one turn to the times of the next; C times each.

    Parameters
    ----------
    before_s, turn_s
        Times of the turn and of the next turn, s; 0 before the first turn of a design.
    low, high
        First index, and end, of the next times that each time can reach.
    decay
        (C, C, M) factor on the swing from the end of one window to the end of the next.
    own
        (C, M) swing of the next move alone, m.
    late
        (C, M) share of the swing that is left when the needle of the next turn enters.
    cost_to_go_s
        (C,) least cost from the next time to the end, s.
    judged
        Whether the needle of the next turn enters.
    """

    before_s: FloatArray
    turn_s: FloatArray
    low: IntArray
    high: IntArray
    decay: ComplexArray
    own: ComplexArray
    late: FloatArray
    cost_to_go_s: FloatArray
    judged: bool


class _Candidates(NamedTuple):
    """The followers of all states of a beam.

    Parameters
    ----------
    cost_s
        Cost so far, s.
    rank
        Cost so far plus the least cost to the end, in ns.
    source
        Index of the state before.
    speed
        Index of the time of the turn.
    cell
        Cell of the time and the swing.
    """

    cost_s: FloatArray
    rank: FloatArray
    source: IntArray
    speed: IntArray
    cell: IntArray


class _Taken(NamedTuple):
    """The cells and times that states of a turn already have.

    Parameters
    ----------
    cell, turn
        Hash table of cells: the cell in each slot, and the turn that filled the slot.
    of_speed
        (C,) number of states at each time.
    """

    cell: IntArray
    turn: IntArray
    of_speed: IntArray


def priced_turns(
    lists_s: list[FloatArray], first: int, turns: FloatArray, given: tuple[Limits, Swung],
    request: PricedRequest,
) -> FloatArray | None:  # fmt: skip
    """Return the turns of a stretch with the lowest cost, s; None if the search finds none.

    The search follows half of the modes over the band, with the lowest and the highest damping.

    Parameters
    ----------
    lists_s
        For each turn of the stretch the times to choose from, s; clipped to the limits of the turn.
    first
        Number of the first turn of the stretch.
    turns
        (n,) a schedule, s; its turns before ``first`` stay.
    """
    limits, swung = given
    columns, watched = _watch(swung)
    lists = [
        np.unique(np.clip(one, limits.shortest_s[first + k] * (1.0 + 1e-9), limits.slowest_s))
        for k, one in enumerate(lists_s)
    ]
    counts = np.array([len(one) for one in lists])
    choice = np.array([np.pad(one, (0, counts.max() - len(one)), mode="edge") for one in lists])
    stop = first + len(lists)
    place = (np.log(choice) - swung.log_s[0]) / swung.log_s[1]
    lower = np.clip(place.astype(np.int64), 0, len(swung.fresh) - 2)
    fresh = swung.fresh[:, columns]
    part = (place - lower)[:, :, None]
    stretch = _Stretch(
        choice_s=choice,
        counts=counts,
        travels_m=limits.travels_m[first:stop],
        needle=limits.needle[first:stop],
        fresh=np.ascontiguousarray(fresh[lower] * (1.0 - part) + fresh[lower + 1] * part),
        is_last=stop == len(turns),
    )
    begin = swings_before(first, turns, limits, swung)[columns]
    before_s = float(turns[first - 1]) if first > 0 else 0.0
    found, cost = _search(stretch, watched, limits, request, begin, before_s)
    return found if np.isfinite(cost) else None


def _watch(swung: Swung) -> tuple[IntArray, _Watched]:
    """Return the columns of ``swung`` that a search follows, and the modes in these columns.

    Modes far from the middle of the band come first: with them a state over the tolerance is found
    early.
    """
    groups: list[tuple[int, int]] = []
    named = list[int]()
    for row in np.unique(swung.row).tolist():
        of = np.flatnonzero(swung.row == row)
        half = len(of) // 2
        if row % 3 == 1:
            named.append(int(of[half]))
        else:
            groups += [(-abs(k - half), int(of[k])) for k in range(0, len(of), 2)]
    order = [group for _, group in sorted(groups)] + named
    columns, last, place = list[int](), list[int](), dict[int, int]()
    for group in order:
        place[group] = len(columns)
        columns += range(int(swung.begin[group]), int(swung.begin[group + 1]))
        last += [0] * (len(columns) - len(last) - 1) + [1]
    ends = order[: 4 * len(named)]
    chosen = np.array(columns)
    return chosen, _Watched(
        poles=swung.poles[chosen],
        late=swung.late,
        axis=swung.axis[chosen],
        last=np.array(last),
        named=np.array([place[group] for group in named]),
        bounding=np.array([place[group] for group in ends + named]),
    )


@njit(nogil=True)
def _pair_time(before_s: float, turn_s: float, share: float) -> float:
    """Return the time from the end of one window to the end of the next, s."""
    return 2.0 * (1.0 - share) / (1.0 / before_s + 1.0 / turn_s) + share * turn_s


@njit(nogil=True)
def _cost_to_go(
    stretch: _Stretch, watched: _Watched, limits: Limits, request: PricedRequest
) -> _CostToGo:
    """Return the least cost from each time of each turn to the end of the stretch."""
    choice, counts, needle = stretch.choice_s, stretch.counts, stretch.needle
    travels_m, fresh, is_last = stretch.travels_m, stretch.fresh, stretch.is_last
    poles, late, axis, bounding = watched.poles, watched.late, watched.axis, watched.bounding
    share, tolerance_m, price_s = limits.share, request.tolerance_m, request.price_s
    turns = len(counts)
    low, high = np.zeros(choice.shape, np.int64), np.zeros(choice.shape, np.int64)
    to_go = np.full(choice.shape, np.inf)
    square, most = choice**-2.0, limits.change * _SLACK
    for i in range(counts[-1]):
        to_go[-1, i] = (1.0 - share) * choice[-1, i] if is_last else 0.0
    for k in range(turns - 2, -1, -1):
        judged = needle[k] == 1 and needle[k + 1] == 1
        for i in range(counts[k]):
            a = 0
            while a < counts[k + 1] and square[k + 1, a] > square[k, i] + most:
                a += 1
            b = a
            while b < counts[k + 1] and square[k + 1, b] >= square[k, i] - most:
                b += 1
            low[k, i], high[k, i] = a, b
            best = np.inf
            for j in range(a, b):
                time = _pair_time(choice[k, i], choice[k + 1, j], share)
                cost = time + to_go[k + 1, j]
                if judged and cost < best:
                    over = 0.0
                    for c in bounding:
                        decay = poles[c].real
                        then = np.exp(decay * late * choice[k + 1, j])
                        was = np.exp(decay * (late * choice[k, i] - time))
                        own = abs(travels_m[k + 1, axis[c]] * fresh[k + 1, j, c])
                        over = max(over, own / (tolerance_m * (then + was)))
                    cost += price_s * max(0.0, over - 1.0)
                best = min(best, cost)
            to_go[k, i] = best
    return _CostToGo(to_go, low, high)


@njit(nogil=True)
def _find_followers(
    beam: _Beam, step: _Step, watched: _Watched, limits: Limits, request: PricedRequest,
    found: _Candidates,
) -> int:  # fmt: skip
    """Fill ``found`` with the followers of each state; return their number."""
    at, so_far, swing = beam.at, beam.cost_s, beam.swing
    before_s, turn_s, low, high = step.before_s, step.turn_s, step.low, step.high
    decay, own, late, judged, to_go = (
        step.decay,
        step.own,
        step.late,
        step.judged,
        step.cost_to_go_s,
    )
    last, named, change, share = watched.last, watched.named, limits.change, limits.share
    tolerance_m, price_s, cells = request.tolerance_m, request.price_s, request.cells
    cost, rank, source, speed, cell_of = found
    columns = swing.shape[1]
    value = np.zeros(columns, np.complex128)
    most_m = tolerance_m * (1.0 + request.most)
    count = 0
    for h in range(len(at)):
        i = at[h]
        for j in range(low[i], high[i]):
            time = share * turn_s[j]  # nothing swings before the first turn of a design
            if before_s[i] > 0.0:
                if abs(before_s[i] ** -2.0 - turn_s[j] ** -2.0) > change * _SLACK:
                    continue
                time = _pair_time(before_s[i], turn_s[j], share)
            if to_go[j] == np.inf:
                continue
            worst, total = 0.0, 0.0
            for c in range(columns):
                value[c] = own[j, c] + swing[h, c] * decay[i, j, c]
                if judged:
                    total += abs(value[c]) * late[j, c]
                    if last[c] == 1:
                        worst = max(worst, total)
                        total = 0.0
                        if worst > most_m:
                            break
            if worst > most_m:
                continue
            cell = j
            for c in named:
                for part in (value[c].real, value[c].imag):
                    near = min(max(part * (cells / tolerance_m), -_OUTER), _OUTER)
                    cell = cell * 64 + int(np.floor(near)) + 32
            cost[count] = so_far[h] + time + price_s * max(0.0, worst / tolerance_m - 1.0)
            rank[count] = np.rint((cost[count] + to_go[j]) * _TO_RANK)
            source[count], speed[count], cell_of[count] = h, j, cell
            count += 1
    return count


@njit(nogil=True)
def _select(
    order: IntArray, width: int, turn: int, found: _Candidates, taken: _Taken, chosen: IntArray
) -> int:
    """Fill ``chosen`` with the first of each time and cell in ``order``; return their number."""
    speed, cell_of = found.speed, found.cell
    seen, stamp, of_speed = taken.cell, taken.turn, taken.of_speed
    of_speed[:] = 0
    states = 0
    for q in order:
        if of_speed[speed[q]] >= width:
            continue
        slot = (cell_of[q] * 2654435761) % len(seen)
        while stamp[slot] == turn and seen[slot] != cell_of[q]:
            slot = (slot + 1) % len(seen)
        if stamp[slot] == turn:
            continue
        stamp[slot], seen[slot] = turn, cell_of[q]
        of_speed[speed[q]] += 1
        chosen[states] = q
        states += 1
    return states


@njit(nogil=True)
def _search(
    stretch: _Stretch, watched: _Watched, limits: Limits, request: PricedRequest,
    begin: ComplexArray, before_s: float,
) -> tuple[FloatArray, float]:  # fmt: skip
    """Return (K,) the turns with the lowest cost, and the cost, s; infinite if there are none.

    Parameters
    ----------
    begin
        (M,) swing at the start of the stretch, m.
    before_s
        Time of the turn before the stretch, s; 0 before the first turn of a design.
    """
    choice, counts, travels_m, fresh = (
        stretch.choice_s,
        stretch.counts,
        stretch.travels_m,
        stretch.fresh,
    )
    poles, late, axis, share = watched.poles, watched.late, watched.axis, limits.share
    turns, count = choice.shape
    columns, room = len(poles), request.width * count
    to_go, low, high = _cost_to_go(stretch, watched, limits, request)
    found = _Candidates(
        np.empty(room * count), np.empty(room * count), np.empty(room * count, np.int64),
        np.empty(room * count, np.int64), np.empty(room * count, np.int64),
    )  # fmt: skip
    chosen = np.empty(room, np.int64)
    back, taken = np.zeros((turns, room), np.int32), np.zeros((turns, room), np.int32)
    places = _Taken(
        np.zeros(4 * room + 1, np.int64),
        np.full(4 * room + 1, -1, np.int64),
        np.zeros(count, np.int64),
    )
    decay = np.zeros((count, count, columns), np.complex128)
    late_of = np.zeros((count, columns))
    own = np.zeros((count, columns), np.complex128)
    swing = np.zeros((1, columns), np.complex128)
    swing[0] = begin
    beam = _Beam(np.zeros(1, np.int64), np.zeros(1), swing)
    for k in range(turns):
        before, low_now, high_now = np.full(1, before_s), np.zeros(1, np.int64), counts[:1]
        if k > 0:
            before, low_now, high_now = choice[k - 1, : counts[k - 1]], low[k - 1], high[k - 1]
        for j in range(counts[k]):
            for c in range(columns):
                late_of[j, c] = np.exp(-late * choice[k, j] * poles[c].real)
                own[j, c] = travels_m[k, axis[c]] * fresh[k, j, c]
        for i in range(len(before)):
            for j in range(low_now[i], high_now[i]):
                if before[i] > 0.0:
                    time = _pair_time(before[i], choice[k, j], share)
                    for c in range(columns):
                        decay[i, j, c] = np.exp(-poles[c] * time)
        judged = stretch.needle[k] == 1
        step = _Step(before, choice[k], low_now, high_now, decay, own, late_of, to_go[k], judged)
        followers = _find_followers(beam, step, watched, limits, request, found)
        if followers == 0:
            return np.zeros(turns), np.inf
        order = np.argsort(found.rank[:followers], kind="mergesort")
        states = _select(order, request.width, k, found, places, chosen)
        then = np.empty((states, columns), np.complex128)
        for s in range(states):
            h, j = found.source[chosen[s]], found.speed[chosen[s]]
            then[s] = own[j] + beam.swing[h] * decay[beam.at[h], j]
            back[k, s], taken[k, s] = h, j
        beam = _Beam(found.speed[chosen[:states]], found.cost_s[chosen[:states]], then)
    left = np.empty(len(beam.at))
    for s in range(len(beam.at)):
        left[s] = beam.cost_s[s] + to_go[-1, beam.at[s]]
    best = int(np.argmin(left))
    least = left[best]
    turn_s = np.empty(turns)
    for k in range(turns - 1, -1, -1):
        turn_s[k] = choice[k, taken[k, best]]
        best = back[k, best]
    return turn_s, least
