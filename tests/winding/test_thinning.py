"""Thinned samples of a replay: the motion between them is straight, wherever a run is cut."""

from __future__ import annotations

import numpy as np
import pytest

from threadline.base.arrays import FloatArray, IntArray
from threadline.machine import load_machine
from threadline.winding.replay import LONGEST_M, STRAIGHT_M, Thinning, moves_of

AXES, REACH_M = ("A", "X", "Y"), 0.05


def _run(samples: int, swing: float = 1.1) -> tuple[FloatArray, IntArray, FloatArray]:
    """Return times, operations and positions of a winder that swings (rad/s) and hunts by 2 um."""
    random = np.random.default_rng(42)
    time = 0.005 * np.arange(samples)
    turn = 0.35 * time + random.uniform(-1.0, 1.0, samples) * 2e-6 / REACH_M
    along, across = 0.05 * np.sin(0.2 * time), 0.06 + 0.01 * np.sin(swing * time)
    return time, np.arange(samples) // 33, np.column_stack([turn, along, across])


def _thinning() -> Thinning:
    tool = load_machine("lathe-winder").tool
    assert tool is not None
    return Thinning(tool, AXES, REACH_M)


def _scale() -> FloatArray:
    tool = load_machine("lathe-winder").tool
    assert tool is not None
    return moves_of(tool, AXES, REACH_M)


def test_dropped_samples_lie_on_the_line_between_kept_samples() -> None:
    time, operation, places = _run(20_000)
    thinning = _thinning()
    is_kept = thinning.kept(time, operation, places)
    assert thinning.waits
    is_kept[-1] = True
    assert is_kept[0] and is_kept.mean() < 0.25
    # The last sample of each operation is kept: its steering is a mean up to there.
    assert is_kept[:-1][np.diff(operation) > 0].all()
    size = places * _scale()
    between = [np.interp(time, time[is_kept], column[is_kept]) for column in size.T]
    away = np.abs(np.column_stack(between) - size)
    assert 1e-6 < away.max() <= STRAIGHT_M * (1.0 + 1e-6)
    steps = np.diff(np.flatnonzero(is_kept))
    moves = np.linalg.norm(np.diff(size[is_kept], axis=0), axis=1)
    assert moves[steps > 1].max() <= LONGEST_M * (1.0 + 1e-6)
    # The fibre begins where the mandrel begins to turn: there the error is 0.
    first = np.abs(size[:, 0] - size[0, 0]) < 0.9 * LONGEST_M
    assert away[: int(np.argmin(first))].max() < 2e-7


def test_a_fast_swing_is_kept_to_five_micrometres_and_a_millimetre() -> None:
    """Over a millimetre of the mandrel it leaves a line by 90 um: only the distance limits it."""
    time, operation, places = _run(20_000, swing=5.0)
    is_kept = _thinning().kept(time, 0 * operation, places)
    is_kept[-1] = True
    size = places * _scale()
    between = [np.interp(time, time[is_kept], column[is_kept]) for column in size.T]
    away = np.column_stack(between) - size
    assert 0.1 < is_kept.mean() < 0.9
    assert -5e-6 * (1.0 + 1e-6) <= away.min() < -3e-6
    assert 3e-6 < away.max() <= 5e-6 * (1.0 + 1e-6)
    slow = _run(20_000, swing=0.1)[2] * _scale()
    few = _thinning().kept(time, 0 * operation, slow / _scale())
    few[-1] = True
    moves = np.linalg.norm(np.diff(slow[few], axis=0), axis=1)
    assert 0.8e-3 < moves.max() <= 1e-3 * (1.0 + 1e-6)


@pytest.mark.parametrize("length", [1, 2, 7, 4096])
def test_the_same_samples_are_kept_wherever_a_run_is_cut(length: int) -> None:
    time, operation, places = _run(5000)
    whole = _thinning().kept(time, operation, places)
    thinning, found = _thinning(), np.zeros(len(time), dtype=np.bool_)
    for first in range(0, len(time), length):
        rows = slice(max(first - 1, 0), first + length)
        found[rows] |= thinning.kept(time[rows], operation[rows], places[rows])
    np.testing.assert_array_equal(found, whole)


def test_samples_that_are_no_numbers_are_kept() -> None:
    time, operation, places = _run(100)
    places[40:43, 1] = np.nan
    is_kept = _thinning().kept(time, 0 * operation, places)
    assert is_kept[39:43].all()
