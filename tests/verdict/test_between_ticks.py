"""Turning points, progress and stitches between samples, from the velocities of the loads.

The references are closed forms (a load with constant acceleration moves on a parabola, which the
cubic through places and velocities equals up to rounding), scipy's cubics on a fine grid, finer
recordings, and an independent integrator.
"""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from tests.twin.test_simulate import COUNTS, reference_winder
from threadline.files import ChannelKind, Clock, RecordingBlock, Stream
from threadline.machine import load_machine
from threadline.proof.options import options_of
from threadline.proof.pipeline import open_job, plan_job
from threadline.twin import simulate
from threadline.verdict import Criterion, Status, judge

from .builders import TICK_S, follow, move_s, plan_through, record, spec_of
from .test_stitches import LENGTH_M, PERIOD_S, SPEED_M_S, TIME_S, seam

TURNING = spec_of(Criterion(name="turning_point_error", limit=5e-4))
PROGRESS = spec_of(Criterion(name="progress_error", limit=5e-4))


def moved(points, axes, load, pace, operation, spec, per_block=64, command=None):
    """Return the result of the only criterion, with velocities if they are given."""
    channels = {ChannelKind.LOAD: load}
    if pace is not None:
        channels[ChannelKind.VELOCITY] = pace
    if command is not None:
        channels[ChannelKind.COMMANDED] = command
    plan = plan_through(points, axes, move_s=move_s(operation))
    recording = record(axes, channels, operation, per_block=per_block)
    return judge([recording], plan, spec).results[0]


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("per_block", [1, 7, 1000])
def test_a_load_that_turns_between_its_samples_is_measured_where_it_turns(side, per_block) -> None:
    """It turns half-way between two samples at 32 m/s^2: a T^2 / 8 = 0.1 mm beyond both."""
    points = [[0.0], [side * 0.1], [0.0]]
    command, operation = follow(points, 40)
    times = TICK_S * np.arange(len(command))
    since = np.clip(times - 40.5 * TICK_S, -0.03, 0.03)
    load = np.where(np.abs(since) < 0.03, side * (0.1 + 1e-4 - 16.0 * since**2), command[:, 0])
    pace = np.where(np.abs(since) < 0.03, -32.0 * side * since, 0.0)
    # At the join with the parabola the command only has to go on.
    pace[np.abs(since) >= 0.03] = (np.diff(command[:, 0], append=0.0) / TICK_S)[
        np.abs(since) >= 0.03
    ]
    unseen = moved(points, ("X",), load[:, None], None, operation, TURNING)
    assert unseen.measured == pytest.approx(0.0, abs=1e-12)
    seen = moved(points, ("X",), load[:, None], pace[:, None], operation, TURNING, per_block)
    assert seen.measured == pytest.approx(1e-4, rel=1e-9)
    assert seen.note == "past"
    assert seen.time_s == pytest.approx(40.5 * TICK_S, abs=1e-9)


def swinging(seed: int):
    """Return points of one axis, and places and velocities of a load that swings about them."""
    rng = np.random.default_rng(seed)
    points = np.array([[0.0], [0.1], [0.02], [0.08], [0.0]]) * rng.uniform(0.5, 1.0)
    places, operation = follow(points, 40)
    times = TICK_S * np.arange(len(places))
    size, rate, phase = rng.uniform(2e-4, 2e-3), rng.uniform(60, 250), rng.uniform(0, 6)
    sway = size * np.sin(rate * times + phase)[:, None]
    pace = np.diff(places, axis=0, append=places[-1:]) / TICK_S
    turned = size * rate * np.cos(rate * times + phase)[:, None]
    return points, places + sway, pace + turned, operation


def finest(points, load, pace, operation, lag):
    """Return the turning-point error of scipy's cubic at 500 places of every tick."""
    cubic = CubicHermiteSpline(np.arange(len(load)), load[:, 0], TICK_S * pace[:, 0])
    at = np.linspace(0.0, len(load) - 1, 500 * (len(load) - 1) + 1)
    way, worst = cubic(at), 0.0
    begin = 0.0
    for k, vertex in enumerate(points[1:, 0], start=1):
        last = k == len(points) - 1
        side = 1.0 if vertex > points[k - 1, 0] else -1.0
        # From the previous extreme until the command has been gone for the lag.
        leaves = len(load) - 1 if last else np.flatnonzero(operation >= k)[0] + lag
        own = (at >= begin) & (at <= leaves)
        places = side * way[own]
        worst = max(worst, abs(places.max() - side * vertex))
        begin = at[own][int(np.argmax(places))]
    return worst


@pytest.mark.parametrize("seed", range(12))
def test_turning_points_are_those_of_scipys_cubics(seed: int) -> None:
    # At the corners of the command the cubic reaches 1000 m/s^2: the grid misses 12 nm of it.
    points, load, pace, operation = swinging(seed)
    expected = finest(points, load, pace, operation, 20)
    for per_block in (1, 7, 1000):
        found = moved(points, ("X",), load, pace, operation, TURNING, per_block).measured
        assert found == pytest.approx(expected, abs=1.5e-8)


@pytest.mark.parametrize("runs", [2, 9, 40])
@pytest.mark.parametrize("name", ["turning_point_error", "progress_error"])
def test_runs_side_by_side_have_the_figures_that_they_have_alone(runs: int, name: str) -> None:
    points, load, pace, operation = swinging(5)
    rng = np.random.default_rng(runs)
    spec = spec_of(Criterion(name=name, limit=5e-4))
    plan = plan_through(points, ("X",), move_s=move_s(operation))
    one_by_one = []
    for _ in range(runs):
        off = rng.normal(0.0, 2e-4) * np.sin(np.arange(len(load)) / 9.0)[:, None]
        channels = {
            ChannelKind.LOAD: load + off,
            ChannelKind.VELOCITY: pace * rng.uniform(0.9, 1.1),
        }
        one_by_one.append(record(("X",), channels, operation, per_block=50))
    blocks = []
    for parts in zip(*one_by_one, strict=True):
        samples = {
            n: values if n == "operation" else np.stack([part.samples[n] for part in parts], axis=1)
            for n, values in parts[0].samples.items()
        }
        blocks.append(RecordingBlock(first_tick=parts[0].first_tick, samples=samples))
    together = replace(one_by_one[0], blocks=Stream.of(blocks), runs=runs)
    each = [judge([one], plan, spec).results[0].measured for one in one_by_one]
    assert judge([together], plan, spec).results[0].measured == max(one or 0.0 for one in each)


def test_a_load_that_swings_along_its_path_between_samples_is_ahead_by_its_swing() -> None:
    """At the end of its path it swings between two samples: a T^2 / 8 = 0.1 mm."""
    points = [[0.0, 0.0], [0.1, 0.0]]
    load, operation = follow(points, 100)
    pace = np.diff(load, axis=0, append=load[-1:]) / TICK_S
    pace[120:130, 0] = 16.0 * TICK_S * np.where(np.arange(10) % 2, -1.0, 1.0)
    unseen = moved(points, ("X", "Y"), load, None, operation, PROGRESS, command=load)
    assert unseen.measured == pytest.approx(0.0, abs=1e-9)
    seen = moved(points, ("X", "Y"), load, pace, operation, PROGRESS, command=load)
    assert seen.measured == pytest.approx(1e-4, rel=1e-6)
    assert seen.status is Status.PASSED


def test_a_load_that_speeds_up_along_its_path_is_not_charged() -> None:
    """From rest with 8 m/s^2 it deviates by 0.025 mm along its own line in every tick."""
    points = [[0.0, 0.0], [0.1, 0.05]]
    _, operation = follow(points, 40)
    times = TICK_S * np.arange(len(operation))
    share = np.minimum(4.0 * times**2 / 0.1, 1.0)[:, None]
    speed = np.where(share < 1.0, 8.0 * times[:, None] / 0.1, 0.0)
    load, pace = share * np.array(points[1]), speed * np.array(points[1])
    last = int(np.flatnonzero(share[:, 0] >= 1.0)[0])
    operation[:] = 0.0
    load, pace, operation = (one[: last + 1] for one in (load, pace, operation))
    pace[-1] = (load[-1] - load[-2]) / TICK_S
    command = load.copy()
    result = moved(points, ("X", "Y"), load, pace, operation, PROGRESS, command=command)
    assert result.measured == pytest.approx(0.0, abs=1e-7)


@pytest.mark.parametrize("seed", range(8))
def test_the_progress_with_its_charge_bounds_that_of_a_finer_recording(seed: int) -> None:
    """The finer recording has eight samples of the same cubic per tick, with the tick's command."""
    points, load, pace, operation = swinging(seed)
    command, _ = follow(points, 40)
    coarse = moved(points, ("X",), load, pace, operation, PROGRESS, command=command).measured
    cubic = CubicHermiteSpline(np.arange(len(load)), load[:, 0], TICK_S * pace[:, 0])
    at = np.arange(8 * (len(load) - 1) + 1) / 8.0
    under_way = np.ceil(at).astype(int)
    clock = Clock("fine", Fraction(5, 8000))
    channels = {ChannelKind.LOAD: cubic(at)[:, None], ChannelKind.COMMANDED: command[under_way]}
    finer = record(("X",), channels, operation[under_way], clock=clock)
    plan = plan_through(points, ("X",), move_s=move_s(operation))
    fine = judge([finer], plan, PROGRESS).results[0].measured
    assert coarse is not None
    assert fine is not None
    # A step back is halved between two places: a recording may hide half a sample's way.
    assert fine <= coarse + 1e-9


def test_a_needle_between_two_samples_finds_the_head_on_its_parabola() -> None:
    """At 16 m/s^2 the head is a T^2 / 8 = 0.05 mm off the straight line, 2.5 % of a stitch."""
    plan = seam()
    x = SPEED_M_S * (TIME_S - 0.013)
    speed = np.full(len(x), SPEED_M_S)
    # Within one tick it runs ahead of its even motion and back again.
    speed[50] += 8.0 * TICK_S
    speed[51] -= 8.0 * TICK_S
    operation = np.minimum(np.floor(TIME_S / PERIOD_S + 1e-9), 39)
    still = np.zeros_like(x)
    channels = {ChannelKind.LOAD: np.column_stack([x, still])}
    spec = spec_of(Criterion(name="stitch_length_error", limit=0.05, options={"delay": 0.0125}))
    unseen = judge([record(("X", "Y"), channels, operation)], plan, spec).results[0]
    assert unseen.measured == pytest.approx(0.0, abs=1e-9)
    channels[ChannelKind.VELOCITY] = np.column_stack([speed, still])
    for per_block in (3, 13, 1000):
        recording = record(("X", "Y"), channels, operation, per_block=per_block)
        seen = judge([recording], plan, spec).results[0]
        assert seen.measured == pytest.approx(16.0 * TICK_S**2 / 8.0 / LENGTH_M, rel=1e-6)


@pytest.mark.long(but="lathe-winder-4.0")
@pytest.mark.parametrize(
    ("reference", "limit_a"), [("lathe-winder", 4.0), ("lathe-winder+8A", 8.0)]
)
def test_the_turning_point_of_the_winder_is_that_of_an_integrator(reference, limit_a) -> None:
    """X of x-180 at several feeds: within 2 um of DOP853 at 20 places of a tick.

    Between two of these places the load is off by a 400th of the deviation, 0.2 um at most. The
    samples alone are off by 9 to 28 um at 4 A.
    """
    machine, missed = load_machine(reference), []
    spec = spec_of(Criterion(name="turning_point_error", axis="X", limit=5e-4))
    for feed in ("34 count/tick", "55 count/tick", "80 count/tick"):
        options = options_of(interpolation="linear", feed=feed)
        job = open_job(Path("examples/x-180.prg"), machine, options)
        plan = plan_job(job, machine, options)
        recording = simulate(plan.commands, machine, settle_s=0.2)
        found = next(r for r in judge([recording], plan, spec).results if r.axis == "X")
        _, load = recording.samples("X.load")
        column = plan.commands.axes.index("X")
        rows = np.concatenate([block.counts[:, column] for block in plan.commands.blocks])
        padded = np.concatenate((rows, np.zeros(len(load) - len(rows), dtype=np.int64)))
        angles, _, between = reference_winder(padded, 3.606e-4, limit_a, True, parts=20)
        fine = np.column_stack([angles, between]) * COUNTS / 55.358e3
        assert found.measured == pytest.approx(abs(fine.max() - 0.18), abs=2e-6)
        missed.append(fine.max() - load.max())
    assert max(missed) > 5e-6


@pytest.mark.parametrize("name", ["turning_point_error", "progress_error"])
def test_without_velocities_a_recording_from_outside_is_charged(name: str) -> None:
    """X of the winder reaches 10.5 m/s^2: 0.033 mm between two samples a tick apart."""
    points = [[0.0], [0.1], [0.0]]
    load, operation = follow(points, 40)
    load[40:] -= 4.8e-4
    load = np.minimum(load, 0.1 - 4.8e-4)
    plan = plan_through(points, ("X",), move_s=move_s(operation))
    spec = spec_of(Criterion(name=name, limit=5e-4))
    channels = {ChannelKind.LOAD: load, ChannelKind.COMMANDED: follow(points, 40)[0]}
    result = judge([record(("X",), channels, operation, simulated=False)], plan, spec).results[0]
    assert result.status is Status.NOT_MEASURED
    assert "X.velocity at each tick" in result.note


def test_a_load_that_jumps_between_two_samples_with_no_more_speed_is_not_charged_its_jump() -> None:
    """It turns back a little before it jumps by 0.6 mm: the cubic overshoots its line by 0.1 um.

    The part beyond the end of the path is a contour error. In the tick before, between two equal
    places, the way deviates by v T / 4 = 7.5 um.
    """
    points = [[0.0], [0.1]]
    load, operation = follow(points, 100)
    command = load.copy()
    pace = np.diff(load, axis=0, append=load[-1:]) / TICK_S
    load[120:] += 6e-4
    pace[119] = -6e-3
    seen = moved(points, ("X",), load, pace, operation, PROGRESS, command=command)
    assert seen.measured == pytest.approx(7.5e-6, abs=1e-9)
