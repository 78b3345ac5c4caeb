"""The beam search that prices swings over the tolerance, against all schedules of a small case."""

from __future__ import annotations

from functools import cache
from itertools import product

import numpy as np
import pytest
from tools.second_stitches import frames, fresh_swings, total_s

from threadline.commands.stitch_priced import PricedRequest, priced_turns
from threadline.commands.stitch_shorten import shortened
from threadline.commands.stitch_swings import Limits, Swung
from threadline.machine import load_machine

MACHINE = load_machine("schiffli-frame")
SHARE, PARTS, DAMPINGS = 1.0 / 3.0, 5, (0.7, 1.0, 1.3)
PRICE_S, MOST = 20.0, 1.0
ALONE = PricedRequest(tolerance_m=1e-4, price_s=PRICE_S, most=MOST, width=10_000, cells=1e6)
CHANGE = 4.0 / 3.0 * 3.0 / (2.0 * np.pi)  # by the spindle, of 1 / turn^2, 1/s^2
FIRST_S, STEP = 0.4, 1e-3  # shortest turn of the table of swings, and the step of its logarithm
CHOICE_S = [FIRST_S * np.exp(STEP * np.arange(5, 200, 60)) for _ in range(6)]
WAYS_M = 1e-4 * np.array([[9, 0], [-9, 12], [5, -12], [16, 7], [14, -16], [-12, 3]], dtype=float)


FRAME = frames(MACHINE, 0.25, 0.026, DAMPINGS)


@cache
def fresh_of(turn_s: float) -> np.ndarray:
    """Return the swing of each mode after a move of 1 m in such a turn; schedules share turns."""
    return fresh_swings(FRAME, np.array([SHARE * turn_s]))[0]


def swung() -> Swung:
    """Return the swings of five modes over +-5 % of each axis, with three dampings each."""
    frame = FRAME
    order = np.arange(len(frame.poles)).reshape(2, PARTS, 3).transpose(0, 2, 1).ravel()
    log_s = np.log(FIRST_S) + STEP * np.arange(402)
    fresh = fresh_swings(frame, SHARE * np.exp(log_s))
    return Swung(
        poles=-frame.poles[order],
        axis=frame.axis[order],
        begin=np.arange(len(order) + 1),
        row=np.repeat(np.arange(6), PARTS),
        log_s=np.array([log_s[0], STEP]),
        fresh=np.ascontiguousarray(fresh[:, order]),
        late=0.0,
    )


def limits(turns: int, needle: tuple[int, ...] | None = None) -> Limits:
    return Limits(
        travels_m=WAYS_M[:turns],
        needle=np.array(needle or (1,) * turns, dtype=np.int64),
        shortest_s=np.full(turns, 0.36),
        slowest_s=0.59,
        share=SHARE,
        change=CHANGE,
        tolerance_m=1e-4,
    )


def cost_s(turn_s: np.ndarray, asked: Limits, all_modes: bool) -> float:
    """Return the cost of a schedule, s, by the modes that the search watches, or by all of them."""
    frame = FRAME
    grid = np.arange(len(frame.poles)).reshape(2, PARTS, 3)
    which = np.concatenate((grid[:, ::2, ::2].ravel(), grid[:, PARTS // 2, 1]))
    if all_modes:
        which = np.arange(len(frame.poles))
    poles, axis = frame.poles[which], frame.axis[which]
    fresh = np.array([fresh_of(time) for time in turn_s.tolist()])[:, which]
    if (np.abs(np.diff(turn_s**-2.0)) > CHANGE).any():
        return np.inf
    now, over = np.zeros(len(poles), complex), 0.0
    for k, time in enumerate(turn_s):
        if k:
            rest = 2.0 * (1.0 - SHARE) / (1.0 / turn_s[k - 1] + 1.0 / time)
            now = now * np.exp(poles * (rest + SHARE * time))
        now = now + asked.travels_m[k, axis] * fresh[k]
        worst = float(np.abs(now).max()) / 1e-4 - 1.0
        if asked.needle[k]:
            if worst > MOST:
                return np.inf
            over += max(0.0, worst)
    return total_s(turn_s, SHARE) + PRICE_S * over


@pytest.mark.long(but="needle1")
@pytest.mark.parametrize("needle", [(1, 1, 1, 1, 1), (1, 0, 1, 0, 1)])
def test_no_schedule_of_a_small_case_costs_less(needle: tuple[int, ...]) -> None:
    asked = limits(5, needle)
    found = priced_turns(CHOICE_S[:5], 0, np.ones(5), (asked, swung()), ALONE)
    assert found is not None
    all_of = [cost_s(np.array(one), asked, False) for one in product(*CHOICE_S[:5])]
    least = min(all_of)
    assert least < total_s(np.full(5, 1.0), SHARE)  # the search does not refuse every schedule
    assert cost_s(found, asked, False) == pytest.approx(least, rel=1e-9)


def test_a_stretch_goes_on_from_the_swing_and_speed_before_it_and_into_turns_that_stay() -> None:
    asked = limits(6)
    turns = np.array([one[1] for one in CHOICE_S])
    lists = [*CHOICE_S[2:4], turns[4:5], turns[5:6]]
    found = priced_turns(lists, 2, turns, (asked, swung()), ALONE)
    assert found is not None
    of = [
        cost_s(np.array([*turns[:2], *one]), asked, False)
        for one in product(*[row.tolist() for row in lists])
    ]
    least = min(of)
    assert cost_s(np.array([*turns[:2], *found]), asked, False) == pytest.approx(least, rel=1e-9)


def test_schedule_search_returns_none_if_no_turn_is_allowed() -> None:
    strict = PricedRequest(tolerance_m=1e-7, price_s=PRICE_S, most=MOST, width=10, cells=3.0)
    assert priced_turns(CHOICE_S[:5], 0, np.ones(5), (limits(5), swung()), strict) is None


def test_programs_lower_the_cost_of_a_start_that_is_over_the_tolerance() -> None:
    asked = limits(6)
    found = priced_turns(CHOICE_S, 0, np.ones(6), (asked, swung()), ALONE)
    assert found is not None
    start, end = (
        cost_s(found, asked, True),
        cost_s(shortened(found, asked, swung()), asked, True),
    )
    assert end < start
