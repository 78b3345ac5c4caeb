"""A schedule of turns made shorter, or brought within its tolerance, by linear programs.

A search on a grid of speeds wastes the time between its speeds. On machines all over a wide band it
also misses passages that are narrower than its grid. Here the turns of a window of the schedule
change together, by a little: the swings are linear in that change, and the limit of the spindle is
linear in the square of the speed. Swing over the tolerance costs a price, so a start over the
tolerance is corrected. Windows overlap, and are solved one after the other until no window gains
time. Swings are not quite linear: if the exact sum of swings after a step exceeds the tolerance,
the program is solved again with a tolerance that is lower by the excess. A step without gain is not
taken, and the next step is smaller.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.base.linear_programs import solved
from threadline.commands.stitch_priced import PricedRequest, priced_turns
from threadline.commands.stitch_swings import (
    BEFORE,
    Limits,
    Sums,
    Swung,
    amplitudes,
    swings_of,
)

_WINDOW, _APART = 40, 20  # turns that change together, and from one window to the next
_AFTER = 12  # turns after a window that are watched
_FIRST, _MOST, _LEAST = 0.05, 0.1, 1e-3  # relative change of the square of a speed per step
_WIDER, _NARROWER = 1.6, 0.4
_STEPS, _SWEEPS = 3, 12
_CORRECTIONS = 2  # times that a program is solved again for the error of its step
_ENOUGH = 2e-5  # share of the time of a window: smaller gains do not count
_PRICES = (17.0, 100.0, 1000.0)  # for 100 % over the tolerance at a needle, in fastest turns
_GRID = 0.01  # relative step of the turn times of a search of all turns
# Price as above, share of the tolerance. At the lower price a search may pass with a needle over
# the tolerance. Which share leads to turns that the programs can correct depends on the design.
_SEARCHES = ((1000.0, 0.985), (100.0, 1.0), (100.0, 0.99), (100.0, 0.98))
_MUCH = 0.97  # share of the time of the found turns: after a shorter schedule the searches end
_REFUSED, _WIDTH, _CELLS = 0.1, 8, 3.0  # share over the tolerance, states at each time, cells
_EXCESS = 1.0 + 1e-6
_LOW, _HIGH = 0.6, 0.7  # shares of the tolerance: watched swings, in one and in three directions
_ASIDE = np.array([0.0, 0.45, -0.45])  # rad
# Share of tolerance and change of speed for the programs: swings are not linear within a step.
_INSIDE = 1.0 - 2.5e-3
_BETWEEN = 1.0 - 3.5e-3  # share of the tolerance at the end: modes between rows swing more


def shortest_turns(
    found_s: FloatArray, given: tuple[Limits, Swung], most_m: Callable[[FloatArray], float]
) -> FloatArray:
    """Return the shortest turns within the tolerance that several starts lead to, s.

    The starts are the found turns, then priced searches on a grid of speeds: most of them may
    exceed the tolerance where that saves much time, one hardly may. The first start that gains much
    is the last one. If no start leads to turns within the tolerance, the found turns are returned.

    Parameters
    ----------
    found_s
        (n,) turns that a search found, s.
    most_m
        Returns the largest swing that turns leave when a needle enters, m.
    """
    limits, swung = given
    grid = np.arange(np.log(limits.shortest_s.min()), np.log(limits.slowest_s), _GRID)
    starts: list[Callable[[], FloatArray | None]] = [lambda: found_s]
    for price, share in _SEARCHES:
        request = PricedRequest(
            tolerance_m=limits.tolerance_m * _INSIDE * share,
            price_s=price * float(limits.shortest_s.min()),
            most=_REFUSED,
            width=_WIDTH,
            cells=_CELLS,
        )
        lists = [np.exp(grid)] * len(found_s)
        starts.append(partial(priced_turns, lists, 0, found_s, given, request))
    best, is_within = found_s, most_m(found_s) <= limits.tolerance_m * _EXCESS
    enough_s = _MUCH * total_s(found_s, limits.share)
    for start in starts:
        if is_within and total_s(best, limits.share) < enough_s:
            break
        begin = start()
        if begin is None:
            continue
        turns = shortened(begin, limits, swung)
        shorter = total_s(turns, limits.share) < total_s(best, limits.share)
        if (shorter or not is_within) and most_m(turns) <= limits.tolerance_m * _EXCESS:
            best, is_within = turns, True
    return best


def shortened(turn_s: FloatArray, limits: Limits, swung: Swung) -> FloatArray:
    """Return (n,) turns that are shorter than ``turn_s``, or less over the tolerance, s."""
    turns = np.array(turn_s, dtype=np.float64)
    for price in _PRICES:
        _sweep(turns, (limits, swung), price)
    # Only at the end: fewer programs succeed from a start that is farther over its tolerance.
    tighter = limits._replace(tolerance_m=limits.tolerance_m * _BETWEEN)
    _sweep(turns, (tighter, swung), _PRICES[-1])
    return turns


def _sweep(turns: FloatArray, given: tuple[Limits, Swung], price: float) -> None:
    """Solve window after window, changing ``turns``, until no window gains time."""
    starts = list(range(0, max(1, len(turns) - _WINDOW + _APART), _APART))
    step = np.full(len(starts), _FIRST)
    restless = np.ones(len(starts), dtype=bool)
    for _ in range(_SWEEPS):
        if not restless.any():
            break
        for number, first in enumerate(starts):
            if not restless[number]:
                continue
            step[number] = max(float(step[number]), 2.0 * _LEAST)
            gained, step[number] = _change_window(turns, first, float(step[number]), given, price)
            restless[number] = gained
            if gained:
                restless[max(0, number - 1) : number + 2] = True


def total_s(turn_s: FloatArray, share: float) -> float:
    """Return the time of all turns; the speed changes evenly over each rest, s."""
    speed = 1.0 / turn_s
    rest = 2.0 * (1.0 - share) / (speed + np.append(speed[1:], speed[-1]))
    return float((share * turn_s + rest).sum())


def _slope(turn_s: FloatArray, share: float) -> FloatArray:
    """Return (n,) the derivative of the time of all turns with respect to each turn."""
    speed = 1.0 / turn_s
    pair = 2.0 * (1.0 - share) / (speed[:-1] + speed[1:]) ** 2
    slope = np.full(len(turn_s), share)
    slope[:-1] += pair * speed[:-1] ** 2
    slope[1:] += pair * speed[1:] ** 2
    slope[-1] += 1.0 - share
    return slope


def _cost_and_swings(
    turns: FloatArray, first: int, given: tuple[Limits, Swung], price: float
) -> tuple[float, Sums]:
    """Return the time around a window with the price of swings over the tolerance, and swings."""
    limits, swung = given
    count = len(turns)
    end, watched = min(count, first + _WINDOW), min(count, first + _WINDOW + _AFTER)
    before = max(0, first - BEFORE)
    swings = swings_of(before, watched, turns, limits, swung)
    price_s = price * float(limits.shortest_s.min())
    time_s = total_s(turns[max(0, first - 1) : min(count, end + 1)], limits.share)
    return time_s + price_s * float(_beyond(swings, turns, first, given).sum()), swings


def _change_window(
    turns: FloatArray, first: int, step: float, given: tuple[Limits, Swung], price: float
) -> tuple[bool, float]:
    """Change the turns of one window; return whether that gained time, and the next step."""
    count = len(turns)
    end, watched = min(count, first + _WINDOW), min(count, first + _WINDOW + _AFTER)
    price_s = price * float(given[0].shortest_s.min())
    worth, swings = _cost_and_swings(turns, first, given, price)
    gained = False
    for _ in range(_STEPS):
        back = np.zeros(watched - first)
        for _ in range(1 + (_CORRECTIONS if price == _PRICES[-1] else 0)):
            changed = _program(turns, (first, end, watched), step, given, swings, (price_s, back))
            if changed is None:
                break
            then = turns.copy()
            then[first:end] = changed
            worth_then, swings_then = _cost_and_swings(then, first, given, price)
            if worth - worth_then > _ENOUGH * worth:
                break
            # Swings are not linear: the limit of a needle is lowered by the excess of its swing.
            over = _beyond(swings_then, then, first, given)
            if not over.any():
                break
            back += over
        if changed is not None and worth - worth_then > _ENOUGH * worth:
            turns[:], worth, swings, gained = then, worth_then, swings_then, True
            step = min(_MOST, step * _WIDER)
        else:
            step *= _NARROWER
            if step < _LEAST:
                break
    return gained, step


def _beyond(swings: Sums, turns: FloatArray, first: int, given: tuple[Limits, Swung]) -> FloatArray:
    """Return by how much each watched needle of a window is over the tolerance, in shares."""
    limits, swung = given
    before = max(0, first - BEFORE)
    watched = before + len(swings.swing)
    over = amplitudes(swings.swing, turns[before:watched], swung)[first - before :].max(axis=1)
    beyond = np.maximum(0.0, over / (limits.tolerance_m * _INSIDE) - 1.0)
    return np.where(limits.needle[first:watched] == 1, beyond, 0.0)


def _program(
    turns: FloatArray, span: tuple[int, int, int], step: float, given: tuple[Limits, Swung],
    swings: Sums, cost: tuple[float, FloatArray],
) -> FloatArray | None:  # fmt: skip
    """Return the turns of a window by one linear program; None if it has no answer.

    The unknowns are the relative change of the square of each speed, and for each needle the
    share by which it is over the tolerance.
    """
    limits, swung = given
    price_s, back = cost
    first, end, watched = span
    before = max(0, first - BEFORE)
    unknown, needles = end - first, watched - first
    rows, room, of = _watched_rows((first, end, watched, before), turns, swings, limits, swung)
    square = turns**-2.0
    near = np.arange(max(0, first - 1), min(len(turns), end + 1))
    change = np.diff(square[near])
    spindle = np.zeros((len(change), unknown + needles))
    for k, turn in enumerate(near[:-1].tolist()):
        if first <= turn < end:
            spindle[k, turn - first] = -square[turn]
        if first <= turn + 1 < end:
            spindle[k, turn + 1 - first] = square[turn + 1]
    slack = np.zeros((len(of), needles))
    slack[np.arange(len(of)), of] = -1.0
    most = limits.change * _INSIDE
    scale = 1.0 / limits.change
    below = np.concatenate((np.hstack((rows, slack)), spindle * scale, -spindle * scale))
    values = np.concatenate(
        (
            room - back[of],
            np.maximum(most - change, 0.0) * scale,
            np.maximum(most + change, 0.0) * scale,
        )
    )
    slope = _slope(turns[near], limits.share)[first - near[0] :][:unknown]
    inside = square[first:end]
    highest = np.clip(limits.shortest_s[first:end] ** -2.0 / inside - 1.0, 0.0, step)
    lowest = np.clip(limits.slowest_s**-2.0 / inside - 1.0, -step, 0.0)
    costs = np.concatenate((-0.5 * slope * turns[first:end], np.full(needles, price_s)))
    ends = [*zip(lowest.tolist(), highest.tolist(), strict=True)] + [(0.0, None)] * needles
    found = solved(costs, below=(below, values), bounds=ends, seconds=5.0)
    if found.x is None:
        return None
    return np.asarray((inside * (1.0 + found.x[:unknown])) ** -0.5)


@njit(nogil=True)
def _watched_rows(
    span: tuple[int, int, int, int], turns: FloatArray, sums: Sums, limits: Limits, swung: Swung
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return (R, n) rows, (R,) room left and (R,) needle of each, in shares of the tolerance.

    Among neighbours in frequency, only the mode with the largest swing has a row.

    Parameters
    ----------
    span
        First turn that changes, end of the turns that change, end of the watched turns, and first
        turn of ``sums``.
    """
    first, end, watched, before = span
    swing, decay, own, last = sums
    needle, tolerance_m = limits.needle, limits.tolerance_m * _INSIDE
    poles, begin, row, late = swung.poles, swung.begin, swung.row, swung.late
    groups = len(row)
    most = 3 * groups * (watched - first)
    rows, room = np.zeros((most, end - first)), np.empty(most)
    of = np.empty(most, np.int64)
    size = np.empty(groups)
    found = 0
    for k in range(first, watched):
        if needle[k] != 1:
            continue
        q = k - before
        for g in range(groups):
            size[g] = 0.0
            for c in range(begin[g], begin[g + 1]):
                left = np.exp(-poles[c].real * late * turns[k])
                size[g] += np.abs(swing[q, c]) * left / tolerance_m
        for g in range(groups):
            if size[g] <= _LOW:
                continue
            if g > 0 and row[g - 1] == row[g] and size[g - 1] > size[g]:
                continue
            if g < groups - 1 and row[g + 1] == row[g] and size[g + 1] >= size[g]:
                continue
            for aside in _ASIDE:
                if aside != 0.0 and size[g] < _HIGH:
                    continue
                value = 0.0
                for c in range(begin[g], begin[g + 1]):
                    amplitude = np.abs(swing[q, c])
                    if amplitude == 0.0:
                        continue
                    left = np.exp(-poles[c].real * late * turns[k]) / tolerance_m
                    way = np.conj(swing[q, c]) / amplitude * np.exp(-1j * aside) * left
                    value += (way * swing[q, c]).real
                    if k < end:
                        rows[found, k - first] += (way * own[q, c]).real - (
                            poles[c].real * late * amplitude * left
                        )
                    share = 1.0 + 0.0j
                    for j in range(k - 1, first - 1, -1):
                        p = j - before
                        if j < end:
                            part = share * (decay[p + 1, c] * own[p, c] + last[p + 1, c])
                            rows[found, j - first] += (way * part).real
                        share = share * decay[p + 1, c]
                room[found] = 1.0 - value
                of[found] = k - first
                found += 1
    for r in range(found):
        for j in range(end - first):
            rows[r, j] *= -0.5 * turns[first + j]
    return rows[:found], room[:found], of[:found]
