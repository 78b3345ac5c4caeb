"""Turns of a stretch of a schedule by a beam search that puts a price on too large a swing.

A search that refuses each swing over the tolerance ends before a passage that is narrower than its
grid of speeds, and stays slow from there on. Here such a swing costs time, so the search goes
through where it is least over; linear programs then move the turns to be within the tolerance
(``stitch_shorten``). Each turn has a list of times of its own: a grid of all speeds for a whole
design, or times close to the times of a found schedule. Behind the stretch the turns may be fixed,
with one time each; their swings count as well.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from threadline.base.arrays import ComplexArray, FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.commands.stitch_swings import Limits, Swung, swings_before

_OUTER = 12.0  # cells to each side of a swing
_SLACK = 1.0 + 1e-12
_TO_RANK = 1e9  # times of states are compared to 1 ns: not by the rounding of a processor


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PricedRequest:
    """The question of a priced search.

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


def priced_turns(
    lists_s: list[FloatArray], first: int, turns: FloatArray, given: tuple[Limits, Swung],
    request: PricedRequest,
) -> FloatArray | None:  # fmt: skip
    """Return the turns of a stretch that cost least; None if none is found.

    Half of the modes over the band are watched, with the lowest and the highest damping.

    Parameters
    ----------
    lists_s
        For each turn of the stretch the times to choose from, s. They are kept within its limits.
    first
        Number of the first turn of the stretch.
    turns
        (n,) a schedule, s; the turns before ``first`` are taken from it.
    """
    limits, swung = given
    columns, last, named, bounding = _watched(swung)
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
    begin = swings_before(first, turns, limits, swung)[columns]
    found, cost = _stretch(
        choice, counts, limits.ways_m[first:stop], limits.needle[first:stop],
        np.ascontiguousarray(fresh[lower] * (1.0 - part) + fresh[lower + 1] * part),
        swung.poles[columns], swung.late, swung.axis[columns], last, named, bounding,
        begin, float(turns[first - 1]) if first > 0 else 0.0, limits.change, limits.share,
        request.tolerance_m, request.price_s, stop == len(turns), request.width, request.most,
        request.cells,
    )  # fmt: skip
    return found if np.isfinite(cost) else None


def _watched(swung: Swung) -> tuple[IntArray, IntArray, IntArray, IntArray]:
    """Return the columns of a search, 1 at the last of each group, and places among them.

    The places are of the columns whose swings distinguish states (the middle of the band of
    each axis), and of those for a lower bound (ends and middle). Modes far from the middle of the
    band come first: with them a state over the tolerance is found early.
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
    return (
        np.array(columns),
        np.array(last),
        np.array([place[group] for group in named]),
        np.array([place[group] for group in ends + named]),
    )


def _pair_time(before_s: float, turn_s: float, share: float) -> float:
    """Return the time from the end of one window to the end of the next, s."""
    return 2.0 * (1.0 - share) / (1.0 / before_s + 1.0 / turn_s) + share * turn_s


def _ahead(
    choice: FloatArray, counts: IntArray, ways_m: FloatArray, needle: IntArray,
    fresh: ComplexArray, poles: ComplexArray, late: float, axis: IntArray, bounding: IntArray,
    change: float, share: float, tolerance_m: float, price_s: float, ends: bool,
    low: IntArray, high: IntArray,
) -> FloatArray:  # fmt: skip
    """Return (K, C) the least cost to the end of the stretch, and fill the followers of each time.

    It assumes the best swing before each pair of turns.
    """
    turns = len(counts)
    to_go = np.full(choice.shape, np.inf)
    square, most = choice**-2.0, change * _SLACK
    for i in range(counts[-1]):
        to_go[-1, i] = (1.0 - share) * choice[-1, i] if ends else 0.0
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
                time = _time(choice[k, i], choice[k + 1, j], share)
                cost = time + to_go[k + 1, j]
                if judged and cost < best:
                    over = 0.0
                    for c in bounding:
                        decay = poles[c].real
                        then = np.exp(decay * late * choice[k + 1, j])
                        was = np.exp(decay * (late * choice[k, i] - time))
                        own = abs(ways_m[k + 1, axis[c]] * fresh[k + 1, j, c])
                        over = max(over, own / (tolerance_m * (then + was)))
                    cost += price_s * max(0.0, over - 1.0)
                best = min(best, cost)
            to_go[k, i] = best
    return to_go


def _continued(
    states: int, at: IntArray, so_far: FloatArray, swing: ComplexArray,
    before_s: FloatArray, turn_s: FloatArray, low: IntArray, high: IntArray, kept: ComplexArray,
    to_go: FloatArray, own: ComplexArray, judged: bool, late: FloatArray, last: IntArray,
    named: IntArray, change: float, share: float, tolerance_m: float, price_s: float,
    most_over: float, cells: float,
    cost: FloatArray, rank: FloatArray, source: IntArray, speed: IntArray, cell_of: IntArray,
) -> int:  # fmt: skip
    """Fill ``cost`` to ``cell_of`` with the followers of each state; return their number."""
    columns = swing.shape[1]
    value = np.zeros(columns, np.complex128)
    most_m = tolerance_m * (1.0 + most_over)
    found = 0
    for h in range(states):
        i = at[h]
        for j in range(low[i], high[i]):
            time = share * turn_s[j]  # nothing swings before the first turn of a design
            if before_s[i] > 0.0:
                if abs(before_s[i] ** -2.0 - turn_s[j] ** -2.0) > change * _SLACK:
                    continue
                time = _time(before_s[i], turn_s[j], share)
            if to_go[j] == np.inf:
                continue
            worst, total = 0.0, 0.0
            for c in range(columns):
                value[c] = own[j, c] + swing[h, c] * kept[i, j, c]
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
            cost[found] = so_far[h] + time + price_s * max(0.0, worst / tolerance_m - 1.0)
            rank[found] = np.rint((cost[found] + to_go[j]) * _TO_RANK)
            source[found], speed[found], cell_of[found] = h, j, cell
            found += 1
    return found


def _selected(
    order: IntArray, width: int, mark: int, speed: IntArray, cell_of: IntArray,
    seen: IntArray, stamp: IntArray, of_speed: IntArray, chosen: IntArray,
) -> int:  # fmt: skip
    """Fill ``chosen`` with the first of each time and cell in ``order``; return their number."""
    of_speed[:] = 0
    states = 0
    for q in order:
        if of_speed[speed[q]] >= width:
            continue
        slot = (cell_of[q] * 2654435761) % len(seen)
        while stamp[slot] == mark and seen[slot] != cell_of[q]:
            slot = (slot + 1) % len(seen)
        if stamp[slot] == mark:
            continue
        stamp[slot], seen[slot] = mark, cell_of[q]
        of_speed[speed[q]] += 1
        chosen[states] = q
        states += 1
    return states


def _searched(
    choice: FloatArray, counts: IntArray, ways_m: FloatArray, needle: IntArray,
    fresh: ComplexArray, poles: ComplexArray, late: float, axis: IntArray, last: IntArray,
    named: IntArray, bounding: IntArray, begin: ComplexArray, before_s: float,
    change: float, share: float, tolerance_m: float, price_s: float, ends: bool,
    width: int, most_over: float, cells: float,
) -> tuple[FloatArray, float]:  # fmt: skip
    """Return (K,) the turns that cost least and their cost, s; infinite if none is found."""
    turns, count = choice.shape
    columns, room = len(poles), width * count
    low, high = np.zeros((turns, count), np.int64), np.zeros((turns, count), np.int64)
    to_go = _to_end(
        choice, counts, ways_m, needle, fresh, poles, late, axis, bounding, change, share,
        tolerance_m, price_s, ends, low, high,
    )  # fmt: skip
    cost, rank = np.empty(room * count), np.empty(room * count)
    source, speed = np.empty(room * count, np.int64), np.empty(room * count, np.int64)
    cell_of, chosen = np.empty(room * count, np.int64), np.empty(room, np.int64)
    back, taken = np.zeros((turns, room), np.int32), np.zeros((turns, room), np.int32)
    seen, stamp = np.zeros(4 * room + 1, np.int64), np.full(4 * room + 1, -1, np.int64)
    of_speed = np.zeros(count, np.int64)
    kept = np.zeros((count, count, columns), np.complex128)
    late_of = np.zeros((count, columns))
    own = np.zeros((count, columns), np.complex128)
    at, so_far = np.zeros(1, np.int64), np.zeros(1)
    swing = np.zeros((1, columns), np.complex128)
    swing[0] = begin
    for k in range(turns):
        before, low_now, high_now = np.full(1, before_s), np.zeros(1, np.int64), counts[:1]
        if k > 0:
            before, low_now, high_now = choice[k - 1, : counts[k - 1]], low[k - 1], high[k - 1]
        for j in range(counts[k]):
            for c in range(columns):
                late_of[j, c] = np.exp(-late * choice[k, j] * poles[c].real)
                own[j, c] = ways_m[k, axis[c]] * fresh[k, j, c]
        for i in range(len(before)):
            for j in range(low_now[i], high_now[i]):
                if before[i] > 0.0:
                    time = _time(before[i], choice[k, j], share)
                    for c in range(columns):
                        kept[i, j, c] = np.exp(-poles[c] * time)
        found = _followers(
            len(at), at, so_far, swing, before, choice[k], low_now, high_now, kept, to_go[k], own,
            needle[k] == 1, late_of, last, named, change, share, tolerance_m, price_s, most_over,
            cells, cost, rank, source, speed, cell_of,
        )  # fmt: skip
        if found == 0:
            return np.zeros(turns), np.inf
        order = np.argsort(rank[:found], kind="mergesort")
        states = _best_states(order, width, k, speed, cell_of, seen, stamp, of_speed, chosen)
        then = np.empty((states, columns), np.complex128)
        for s in range(states):
            h, j = source[chosen[s]], speed[chosen[s]]
            then[s] = own[j] + swing[h] * kept[at[h], j]
            back[k, s], taken[k, s] = h, j
        swing, at, so_far = then, speed[chosen[:states]], cost[chosen[:states]]
    left = np.empty(len(at))
    for s in range(len(at)):
        left[s] = so_far[s] + to_go[-1, at[s]]
    best = int(np.argmin(left))
    least = left[best]
    turn_s = np.empty(turns)
    for k in range(turns - 1, -1, -1):
        turn_s[k] = choice[k, taken[k, best]]
        best = back[k, best]
    return turn_s, least


_time = njit(nogil=True)(_pair_time)
_to_end = njit(nogil=True)(_ahead)
_followers = njit(nogil=True)(_continued)
_best_states = njit(nogil=True)(_selected)
_stretch = njit(nogil=True)(_searched)
