"""Noise below the resolution of a commanded channel is no motion, and changes no verdict."""

from __future__ import annotations

import numpy as np
import pytest

from tests.verdict.builders import follow, move_s, plan_through, record, spec_of, winder
from threadline.base.arrays import FloatArray
from threadline.commands.plan import Plan
from threadline.files import ChannelKind, Recording
from threadline.verdict import Criterion, Status, Verdict, judge
from threadline.verdict.samples import Steady

AXES = ("X", "Y")
PER_MOVE, STANDSTILL, LATE = 40, 120, 100
SETTLED = 0.4e-3  # half of the load's swing after the end; the limit is 0.1 mm


def counted(values: FloatArray) -> FloatArray:
    """Return positions in whole counts of the winder, in m."""
    machine = winder()
    counts = [machine.axes[axis].counts.si for axis in AXES]
    return np.rint(values * counts) / counts


def run_of(
    noise: FloatArray | float, *, seed: int = 0, late_m: float = 0.0
) -> tuple[Plan, Recording]:
    """Return a run along X and back whose load rings at its end, and a plan; Y stands still.

    ``noise`` of the recorder is added to the commanded positions, which are whole counts. Y steps
    by ``late_m`` after the end.
    """
    points = [(0.0, 0.0), (0.1, 0.0), (0.02, 0.0)]
    at, operation = follow(points, PER_MOVE, STANDSTILL)
    commanded = counted(at)
    commanded[-LATE:, 1] += late_m
    end = 2 * PER_MOVE
    swing = np.zeros_like(at)
    phase = np.arange(len(at) - end)
    swing[end:, 0] = SETTLED * np.sin(phase * 0.5) * np.exp(-phase / 12.0)
    load = commanded + swing
    spread = np.random.default_rng(seed).uniform(-1.0, 1.0, at.shape) * noise
    channels = {ChannelKind.LOAD: load, ChannelKind.COMMANDED: commanded + spread}
    plan = plan_through(points, AXES, move_s=move_s(operation))
    return plan, record(AXES, channels, operation)


def verdict_of(noise: FloatArray | float, *, seed: int = 0, late_m: float = 0.0) -> Verdict:
    plan, run = run_of(noise, seed=seed, late_m=late_m)
    spec = spec_of(
        Criterion(name="residual_vibration", limit=1e-4, required=True),
        Criterion(name="settling_time", limit=0.02, options={"band": 1e-4}),
        Criterion(name="contour_error", limit=1e-3),
        Criterion(name="progress_error", limit=1e-3),
        Criterion(name="turning_point_error", limit=1e-3),
        Criterion(name="tracking_error"),
    )
    return judge([run], plan, spec)


def statuses(verdict: Verdict) -> list[tuple[str, str, Status]]:
    return [(r.name, r.axis, r.status) for r in verdict.results]


def test_one_float_that_changes_after_the_end_is_no_motion() -> None:
    """The load rings beyond its limit, whatever the last digit of an idle axis does."""
    plain = verdict_of(0.0)
    assert plain.result("residual_vibration", "X").status is Status.FAILED

    once = np.zeros((2 * PER_MOVE + 1 + STANDSTILL, 2))
    once[-60, 1] = 1e-300
    assert statuses(verdict_of(once)) == statuses(plain)


@pytest.mark.parametrize("share", [1e-12, 1e-3, 0.2, 0.45])
@pytest.mark.parametrize("seed", range(4))
def test_noise_below_a_count_changes_no_status(share: float, seed: int) -> None:
    """On the idle axis, noise that rounds to the same count changes no value."""
    plain = verdict_of(0.0)
    count_m = 1.0 / winder().axes["Y"].counts.si
    for noise in (np.array([0.0, share * count_m]), np.array([1e-3, share]) * count_m):
        noisy = verdict_of(noise, seed=seed)
        assert statuses(noisy) == statuses(plain)
        name = "residual_vibration"
        assert noisy.result(name, "X").measured == plain.result(name, "X").measured


def test_one_count_is_a_motion() -> None:
    """A command that steps by a count later ends later, when the load rings less."""
    late_m = 1.0 / winder().axes["Y"].counts.si

    later = verdict_of(0.0, late_m=late_m).result("residual_vibration", "X")

    plain = verdict_of(0.0).result("residual_vibration", "X")
    assert later.measured is not None and plain.measured is not None
    assert later.measured < 0.5 * plain.measured


def test_a_creeping_command_moves() -> None:
    """Steps far below the resolution add up: a drift is not taken for a rest."""
    creep = 1e-3 * np.arange(5000.0)[:, None]

    parts = [Steady(np.ones(1)), Steady(np.ones(1))]
    whole = parts[0].take(creep)
    halves = np.concatenate([parts[1].take(creep[:1234]), parts[1].take(creep[1234:])])

    assert np.abs(whole - creep).max() < 1.0
    assert len(np.unique(whole)) == 5
    np.testing.assert_array_equal(whole, halves)


def test_whole_counts_are_left_as_they_are() -> None:
    """No bit changes in a command whose steps the machine can tell apart."""
    plan, run = run_of(0.0)
    counts = np.array([plan.machine.axes[axis].counts.si for axis in AXES])
    rows = np.random.default_rng(7).integers(-3, 4, (10_000, 2)).cumsum(axis=0) / counts

    held = Steady((1.0 - 1e-6) / counts).take(rows)

    np.testing.assert_array_equal(held, rows)
    assert run.find(ChannelKind.COMMANDED, "X") is not None
