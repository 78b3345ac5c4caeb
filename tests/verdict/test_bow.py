"""The way between samples: closed forms, scipy's cubics on a fine grid, and single runs.

A way is checked at eight places: the largest deviation is underestimated by a 64th at most.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from threadline.files import ChannelKind, RecordingBlock, Stream
from threadline.verdict import Criterion, Status, judge

from .builders import TICK_S, follow, move_s, plan_through, record, spec_of

XY = ("X", "Y")
CONTOUR = spec_of(Criterion(name="contour_error", limit=5e-4))


def a_swing(most: float):
    """Return samples on a line, and velocities of a load that swings across it between them."""
    points = [[0, 0], [0.1, 0]]
    places, operation = follow(points, 100)
    pace = np.diff(places, axis=0, append=places[-1:]) / TICK_S
    # y = (a / 2) t (t - T) in one tick, and the negative in the next: samples never leave 0.
    pace[:90, 1] = 0.5 * most * TICK_S * np.where(np.arange(90) % 2, 1.0, -1.0)
    return points, places, pace, operation


def test_a_load_that_swings_between_its_samples_is_as_far_off_as_it_swings() -> None:
    """200 m/s^2 over 5 ms: a T^2 / 8 = 0.625 mm, and every sample is on the line."""
    points, places, pace, operation = a_swing(200.0)
    plan = plan_through(points, XY, move_s=move_s(operation))
    channels = {ChannelKind.LOAD: places}
    unseen = judge([record(XY, channels, operation)], plan, CONTOUR).result("contour_error")
    assert unseen.measured == pytest.approx(0.0, abs=1e-12)

    recording = record(XY, channels | {ChannelKind.VELOCITY: pace}, operation)
    seen = judge([recording], plan, CONTOUR).result("contour_error")
    assert seen.measured == pytest.approx(200.0 * TICK_S**2 / 8, rel=1e-9)
    assert seen.status is Status.FAILED


def test_without_velocities_a_recording_from_outside_is_charged() -> None:
    """X and Y of the winder reach 10.5 m/s^2 each: 0.046 mm between two samples a tick apart."""
    points, places, pace, operation = a_swing(4.0)
    places += [0.0, 4.7e-4]
    plan = plan_through(points, XY, move_s=move_s(operation))
    channels = {ChannelKind.LOAD: places}
    recording = record(XY, channels, operation, simulated=False)
    result = judge([recording], plan, CONTOUR).result("contour_error")
    assert result.status is Status.NOT_MEASURED
    assert "X.velocity, Y.velocity at each tick" in result.note

    recorded = record(XY, channels | {ChannelKind.VELOCITY: pace}, operation, simulated=False)
    result = judge([recorded], plan, CONTOUR).result("contour_error")
    assert result.status is Status.PASSED
    # Where the command stops at once the load also overshoots the end: 1.4 um more.
    assert result.measured == pytest.approx(4.7e-4 + 4.0 * TICK_S**2 / 8, abs=2e-6)

    short = replace(recorded, blocks=Stream(_without_the_last, recorded.blocks))
    result = judge([short], plan, CONTOUR).result("contour_error")
    assert result.status is Status.NOT_MEASURED
    assert "fewer samples" in result.note


def _without_the_last(blocks):
    for block in blocks:
        samples = {n: v[:-1] if n == "Y.velocity" else v for n, v in block.samples.items()}
        yield replace(block, samples=samples)


def swaying(seed: int):
    """Return corners, and places and velocities of a load that swings about them."""
    rng = np.random.default_rng(seed)
    points = np.cumsum(rng.uniform(-0.02, 0.02, (7, 2)), axis=0)
    places, operation = follow(points, 12)
    times = TICK_S * np.arange(len(places))
    phase, rate = rng.uniform(0, 6, 2), rng.uniform(60, 200, 2)
    size = 2e-3 * rng.uniform(0.2, 1.0)
    sway = size * np.sin(rate * times[:, None] + phase)
    # The command is straight: its velocity at a corner is the velocity of the next move.
    pace = np.diff(places, axis=0, append=places[-1:]) / TICK_S
    return (
        points,
        places + sway,
        pace + size * rate * np.cos(rate * times[:, None] + phase),
        operation,
    )


def fine(points, places, pace, operation, lag):
    """Return the contour error of scipy's cubics at 400 places of a tick, and the largest bow."""
    count = len(places)
    cubic = CubicHermiteSpline(TICK_S * np.arange(count), places, pace)
    s = np.linspace(0.0, 1.0, 401)
    worst, bow = 0.0, 0.0
    near = np.full(len(points), np.inf)
    for i in range(count - 1):
        way = cubic(TICK_S * (i + s))
        chord = places[i] + s[:, None] * (places[i + 1] - places[i])
        bow = max(bow, np.linalg.norm(way - chord, axis=1).max())
        early, late = operation[max(i - lag, 0)], operation[min(i + 1 + lag, count - 1)]
        away = np.full(len(way), np.inf)
        for c in range(int(early), int(late) + 1):
            d = points[c + 1] - points[c]
            u = np.clip((way - points[c]) @ d / (d @ d), 0.0, 1.0)
            away = np.minimum(away, np.linalg.norm(way - points[c] - u[:, None] * d, axis=1))
        worst = max(worst, away.max())
        for v in range(int(early), int(late) + 2):
            near[v] = min(near[v], np.linalg.norm(way - points[v], axis=1).min())
    return max(worst, near.max()), bow


@pytest.mark.parametrize("seed", range(12))
def test_ways_between_samples_are_those_of_scipy(seed: int) -> None:
    points, places, pace, operation = swaying(seed)
    plan = plan_through(points, XY, move_s=move_s(operation))
    channels = {ChannelKind.LOAD: places, ChannelKind.VELOCITY: pace}
    for per_block in (1, 7, 1000):
        recording = record(XY, channels, operation, per_block=per_block)
        found = judge([recording], plan, CONTOUR).result("contour_error").measured
        expected, bow = fine(points, places, pace, operation, 20)
        assert bow > 5e-5
        assert found == pytest.approx(expected, abs=bow / 32)
        assert found is not None
        assert found > expected - bow / 64 - 1e-12


@pytest.mark.parametrize("runs", [2, 9, 40])
@pytest.mark.parametrize("per_block", [1, 7, 1000])
def test_runs_side_by_side_have_the_figures_that_they_have_alone(runs: int, per_block: int) -> None:
    points, places, pace, operation = swaying(3)
    rng = np.random.default_rng(runs)
    many = (
        places[:, None]
        + rng.normal(0.0, 2e-4, (1, runs, 2)) * np.sin(np.arange(len(places)) / 9.0)[:, None, None]
    )
    paces = pace[:, None] * rng.uniform(0.9, 1.1, (1, runs, 1))
    plan = plan_through(points, XY, move_s=move_s(operation))
    one_by_one = [
        record(
            XY, {ChannelKind.LOAD: many[:, r], ChannelKind.VELOCITY: paces[:, r]}, operation,
            per_block=per_block,
        )
        for r in range(runs)
    ]  # fmt: skip
    blocks = []
    for parts in zip(*one_by_one, strict=True):
        samples = {
            name: values
            if name == "operation"
            else np.stack([part.samples[name] for part in parts], axis=1)
            for name, values in parts[0].samples.items()
        }
        blocks.append(RecordingBlock(first_tick=parts[0].first_tick, samples=samples))
    together = replace(one_by_one[0], blocks=Stream.of(blocks), runs=runs)
    errors = [judge([one], plan, CONTOUR).result("contour_error").measured for one in one_by_one]
    found = judge([together], plan, CONTOUR).result("contour_error").measured
    assert found == max(one or 0.0 for one in errors)
