"""Samples far finer than a measure needs: read in part, or refused, and never all kept."""

from __future__ import annotations

import numpy as np
import pytest

from threadline.errors import BudgetError
from threadline.files import ChannelKind
from threadline.verdict import Criterion, judge, samples
from threadline.verdict.samples import PARTS_OF_MEAN, enough_of

from .builders import TICK_S, plan_through, record, spec_of
from .test_stitches import PERIOD_S, SPEED_M_S, TIME_S, sewn

SAMPLES = 400
POINTS = [[0.0, 0.0], [1.0, 0.0]]


def run(per_block: int = 64):
    """A speed of v (1 + e cos wt) on one chord, e = 0.05 and w = 2 pi / s."""
    time_s = TICK_S * np.arange(SAMPLES + 1)
    speed, w = 1.0 / (SAMPLES * TICK_S), 2 * np.pi
    x = speed * (time_s + 0.05 / w * np.sin(w * time_s))
    load = np.column_stack([x, np.zeros_like(x)])
    channels = {ChannelKind.LOAD: load}
    recording = record(("X", "Y"), channels, np.zeros(SAMPLES + 1), per_block=per_block)
    return [recording], plan_through(POINTS, move_s=SAMPLES * TICK_S)


@pytest.mark.parametrize("interval_s", [1e-9, 1e-7, 1e-6, 4.9e-6, 1e-3, 1.0])
def test_a_mean_holds_so_many_samples_at_most(interval_s: float) -> None:
    """20 ms hold twenty million ticks of 1 ns; with coarser ticks each sample counts."""
    every = enough_of(0.02, interval_s)
    assert 0.02 / (every * interval_s) < 2 * PARTS_OF_MEAN
    assert every == 1 or 0.02 / (every * interval_s) >= PARTS_OF_MEAN


@pytest.mark.parametrize("per_block", [1, 3, 64, 1000])
def test_ripple_of_one_sample_in_four_is_that_of_all(
    per_block: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A mean over 32 samples in 8 parts: e sin(x)/x, x = w T / 2, as with all samples.

    No sample that is read falls on the crest: the result is off by half of four samples at most.
    """
    monkeypatch.setattr(samples, "PARTS_OF_MEAN", 8)
    criterion = Criterion(name="velocity_ripple", options={"over": 32 * TICK_S})
    found = judge(*run(per_block), spec_of(criterion)).result("velocity_ripple")
    x = np.pi * 32 * TICK_S
    expected = 0.05 * np.sin(x) / x
    assert found.measured == pytest.approx(expected, rel=1 - np.cos(np.pi * 4 * TICK_S))


@pytest.mark.parametrize("per_block", [1, 3, 1000])
def test_stitches_to_speed_of_one_sample_in_two_are_those_of_all(
    per_block: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One acceleration for 0.06 s; its start and 95 % are seen at most one sample off."""
    rising = np.clip(TIME_S, 0.0, 0.06)
    x = SPEED_M_S * (rising**2 / 0.12 + np.maximum(TIME_S - 0.06, 0.0))

    def turns() -> float:
        found = sewn(
            x, names=("stitches_to_speed",), options={"over": 8 * TICK_S}, per_block=per_block,
            commanded=x,
        )  # fmt: skip
        return found.result("stitches_to_speed").measured

    of_all = turns()
    monkeypatch.setattr(samples, "PARTS_OF_MEAN", 4)
    assert turns() == pytest.approx(of_all, abs=2.001 * TICK_S / PERIOD_S)


def test_a_lag_of_more_samples_than_can_be_held_is_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """With ticks of a nanosecond a lag of 100 ms has a hundred million. Here it has 20 samples."""
    criterion = Criterion(name="tracking_error")
    monkeypatch.setattr(samples, "MOST_HELD", 20)
    judge(*run(), spec_of(criterion))
    monkeypatch.setattr(samples, "MOST_HELD", 19)
    with pytest.raises(BudgetError, match=r"100 ms has 20 samples.*holds 19 at most.*longer clock"):
        judge(*run(), spec_of(criterion))
