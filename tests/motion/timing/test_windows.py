"""Runs planned some pieces at a time: as fast as in one, and without a step in between.

The tests compare the motion with a plan of the whole run by the same solver without a window, and
with its limits at random instants.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from tools import points_growth

from threadline.motion.path.types import PieceBlock
from threadline.motion.timing.optimal import fastest_motion, windows
from threadline.motion.timing.optimal.elements import PiecesAhead, rows_of
from threadline.motion.timing.optimal.motion_limits import Limits
from threadline.motion.timing.retime import retime

TURN = np.linspace(0.0, 7.0, 75)
CURVE = np.stack([np.sin(TURN), np.cos(1.3 * TURN)], axis=1)
NOISY = CURVE + np.random.default_rng(2).uniform(-2e-4, 2e-4, CURVE.shape)
LIMITS = 1.0, 8.0, 200.0
FURTHER = {"deceleration": [3.0, 20.0], "centripetal": 2.0}


@pytest.fixture
def short(monkeypatch):
    """Make windows of few pieces, so that a short path has many."""
    for name in ("ADDED", "MOST_ADDED"):
        monkeypatch.setattr(windows, name, 45)
    monkeypatch.setattr(windows, "SEEN", 8)
    monkeypatch.setattr(windows, "LEAST_AHEAD", 10)
    monkeypatch.setattr(windows, "SLOW_PIECES", 5)

    def windowed(*given, **limits):
        with monkeypatch.context() as context:
            context.setattr(fastest_motion, "MOST_PIECES", 53)
            return retime(*given, **limits)

    return windowed


def seams(motion):
    """Yield the blocks before and after each place where two windows meet."""
    return pairwise(list(motion))


@pytest.mark.parametrize(
    ("points", "tolerance", "further"),
    [(CURVE, 1e-3, {}), (NOISY, 1e-3, {}), (CURVE, 1e-3, FURTHER)],
    ids=["smooth", "noisy", "all limits"],
)
def test_windows_are_as_fast_as_the_whole_and_go_on_smoothly(short, points, tolerance, further):
    whole = retime(points, *LIMITS, tolerance, **further)
    motion = short(points, *LIMITS, tolerance, **further)
    assert len(list(whole)) == 1 and len(list(motion)) >= 3
    assert motion.duration_s == pytest.approx(whole.duration_s, rel=1e-3)
    assert motion.bound <= 1.001
    for before, after in seams(motion):
        end, start = np.array([before.end_s]), after.start_s[:1]
        for order, size in enumerate((1.0, *LIMITS[:2])):
            step = before.evaluate(end, order) - after.evaluate(start, order)
            assert np.abs(step).max() <= 1e-9 * size
        assert np.abs(after.evaluate(start, 1)).max() > 0.05  # it does not rest there
    assert np.abs(motion(motion.duration_s)[0] - points[-1]).max() < 1e-12


def test_all_limits_hold_at_a_million_instants_of_windows(short):
    motion = short(NOISY, *LIMITS, 1e-3)
    times = np.random.default_rng(8).uniform(0.0, motion.duration_s, 1_000_000)
    for order, limit in enumerate(LIMITS, start=1):
        assert np.abs(motion(times, order)).max() <= 1.001 * limit


def test_window_without_a_continuation_ends_at_rest(short, monkeypatch):
    """No slow motion could continue any window: each ends at rest, and the next begins there."""
    whole = retime(CURVE, *LIMITS, 1e-3)
    elements = windows.run_elements
    monkeypatch.setattr(
        windows,
        "run_elements",
        lambda run, radius_m, limits, previous=None, **how: (
            None if previous is not None else elements(run, radius_m, limits, **how)
        ),
    )
    motion = short(CURVE, *LIMITS, 1e-3)
    rests = 0
    for before, after in seams(motion):
        start = after.start_s[:1]
        step = after.evaluate(start) - before.evaluate(start)
        assert np.abs(step).max() <= 1e-12
        rests += bool(np.abs(after.evaluate(start, 1)).max() < 1e-9)
    assert rests >= 2
    assert motion.bound <= 1.001
    assert motion.duration_s > 1.01 * whole.duration_s


def test_windows_along_rough_points_go_on_where_a_faster_way_would_not(monkeypatch):
    """Points 0.1 mm apart, 2 um beside a curve, at a low jerk: the continuation begins evenly.

    Otherwise a window in three came to rest, and the motion took 16 and 32 % more.
    """
    slow = Limits(velocity=np.full(3, 1.0), acceleration=np.full(3, 8.0), jerk=np.full(3, 200.0))
    monkeypatch.setattr(points_growth, "LIMITS", slow)
    _, whole_s = points_growth.planned(150, thin=False)
    monkeypatch.setattr(windows, "SEEN", 8)
    monkeypatch.setattr(windows, "LEAST_AHEAD", 10)
    monkeypatch.setattr(windows, "SLOW_PIECES", 5)
    for added in (45, 60):
        monkeypatch.setattr(windows, "ADDED", added)
        monkeypatch.setattr(windows, "MOST_ADDED", added)
        monkeypatch.setattr(fastest_motion, "MOST_PIECES", added + 8)
        _, windows_s = points_growth.planned(150, thin=False)
        assert windows_s == pytest.approx(whole_s, rel=2e-3)


def test_pieces_are_taken_in_order_up_to_each_rest():
    """However many are read and put back, all come, once, and none from beyond a rest."""
    random = np.random.default_rng(6)
    number = np.arange(200)
    rest = (random.random(200) < 0.04).astype(np.int64)
    rest[-1] = 1
    c = np.zeros((200, 2, 1))
    c[:, 0, 0] = number
    zero = np.zeros(200)
    every = PieceBlock(
        coefficients=c, operation=number, nominal_s=zero, rest_after=rest, dwell_s=zero, line=number
    )
    cuts = [0, 3, 4, 90, 91, 180, 200]
    ahead = PiecesAhead([rows_of(every, a, b) for a, b in pairwise(cuts)])
    seen: list[int] = []
    while (taken := ahead.take(most := int(random.integers(1, 40)))) is not None:
        assert len(taken) <= most
        assert not taken.rest_after[:-1].any()
        assert len(taken) == most or taken.rest_after[-1]
        keep = int(random.integers(1, len(taken) + 1))
        if keep < len(taken):
            ahead.put_back(rows_of(taken, keep, len(taken)))
        seen.extend(taken.operation[:keep].tolist())
    assert seen == number.tolist()
