"""The instants at which a motion passes points, in order: closed forms, and a full search."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from threadline.base.arrays import FloatArray
from threadline.machine import load_machine
from threadline.motion.timing.types import Trajectory, TrajectoryBlock
from threadline.proof.options import Options
from threadline.proof.pipeline import open_job, plan_job
from threadline.verdict.needle import planned_stitches
from threadline.verdict.window import TrajectoryFollower

SEAM = """
[stitching]
stitch_length = "2.5 mm"
needle_speed = "40 stitch/s"

[[contour]]
unit = "mm"
points = [[10, 10], [60, 10], [60, 40], [30, 60]]
"""


def block(start_s, duration_s, coefficients) -> TrajectoryBlock:
    return TrajectoryBlock(
        start_s=np.array(start_s, dtype=np.float64),
        duration_s=np.array(duration_s, dtype=np.float64),
        coefficients=np.array(coefficients, dtype=np.float64),
        operation=np.zeros(len(start_s), dtype=np.int64),
    )


def chords(places, times_s, rests_s=()) -> TrajectoryBlock:
    """Return pieces at even speed from place to place; a rest before place k is left out."""
    ends = np.cumsum(np.array(times_s) + np.array(rests_s or [0.0] * len(times_s)))
    return block(
        ends - times_s, times_s, [[a, np.subtract(b, a)] for a, b in pairwise(np.array(places))]
    )


def every_time(blocks, points, start=(0.0, 0.0)) -> FloatArray:
    """Return the instants of all points, with any number of them known at a time."""
    follower = TrajectoryFollower(blocks, [0, 1], np.ones(2), np.array(start))
    found = np.empty(0)
    while len(found) < len(points):
        found = np.concatenate([found, follower.times(np.array(points)[len(found) :])])
    return found


@pytest.mark.parametrize("count", [3, 10, 500])
def test_many_points_in_one_piece_are_passed_at_the_roots_of_its_cubic(count: int) -> None:
    """From rest to rest, 3 u^2 - 2 u^3: no label of the piece tells where the points lie in it."""
    rise = block([2.0], [3.0], [[[0.0, 0.0], [0.0, 0.0], [3.0, 0.0], [-2.0, 0.0]]])
    x = np.arange(1, count + 1) / count
    roots = [np.roots([-2.0, 3.0, 0.0, -one]).real for one in x[:-1]]
    expected = [2.0 + 3.0 * float(r[(r > 0.0) & (r < 1.0)][0]) for r in roots] + [5.0]
    found = every_time([rise], np.column_stack([x, 0.0 * x]))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)
    assert found[-1] == 5.0


@pytest.mark.parametrize("parts", [1, 2, 5])
def test_a_way_that_is_retraced_is_passed_in_order(parts: int) -> None:
    """Forth and back over the same points: each is passed three times, by different stitches."""
    places = [[0, 0], [1, 0], [2, 0], [1, 0], [0, 0], [1, 0], [2, 0], [2, 0.1], [1, 0.1]]
    times = [0.5, 1.0, 1.0, 0.25, 1.0, 1.0, 1.0, 0.1]
    whole = chords(places, times)
    cuts = np.linspace(0, len(whole), parts + 1).astype(int)
    blocks = [
        block(whole.start_s[a:b], whole.duration_s[a:b], whole.coefficients[a:b])
        for a, b in pairwise(cuts)
    ]
    found = every_time(blocks, places[1:])
    np.testing.assert_allclose(found, np.cumsum(times), rtol=0, atol=1e-12)


def test_a_point_before_a_rest_is_passed_before_it() -> None:
    rested = chords([[0, 0], [1, 0], [1, 1], [0, 1]], [1.0, 1.0, 1.0], [0.0, 7.0, 0.5])
    assert every_time([rested], [[1, 0], [1, 1], [0, 1]]).tolist() == [1.0, 9.0, 10.5]


def test_points_without_a_way_and_points_beside_the_motion() -> None:
    """One equals the previous one, one lies beside, and two are never reached."""
    straight = chords([[0, 0], [1, 0], [2, 0]], [1.0, 1.0])
    points = [[1, 0], [1, 0], [1, 0.2], [1.5, 0.1], [9, 0], [9.5, 0]]
    np.testing.assert_allclose(
        every_time([straight], points), [1.0, 1.0, 1.0, 1.5, 2.0, 2.0], rtol=0, atol=1e-12
    )


def in_order(trajectory: Trajectory, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return instants, in order, with the least sum of squared distances; dynamic programming."""
    time_s = np.linspace(0.0, trajectory.duration_s, 20_001)
    at = trajectory(time_s)
    squared = [((at - point) ** 2).sum(axis=1) for point in points]
    best, moves = np.zeros(len(time_s)), []
    for row in squared:
        total = best + row
        best = np.minimum.accumulate(total)
        moves.append(np.maximum.accumulate(np.where(total == best, np.arange(len(total)), 0)))
    found, place = [], len(time_s) - 1
    for way in reversed(moves):
        place = int(way[place])
        found.append(place)
    rows = np.array(found[::-1])
    return time_s[rows], np.sqrt(np.array([s[r] for s, r in zip(squared, rows, strict=True)]))


@pytest.mark.parametrize("jerk", ["50 m/s^3", "2 m/s^3"])
def test_a_seam_slower_than_the_grid_of_its_timing_has_the_times_of_its_needle(
    jerk: str, tmp_path: Path
) -> None:
    """A piece has five to fifty stitches. The path keeps within 0.1 mm, so each pass is as near."""
    (tmp_path / "s.seam.toml").write_text(SEAM)
    (tmp_path / "m.toml").write_text(
        'base = "stitcher"\n'
        + "".join(f'axes.{axis}.jerk = "{jerk} exact, assumed"\n' for axis in "XY")
    )
    machine, options = load_machine(tmp_path / "m.toml"), Options()
    plan = plan_job(open_job(tmp_path / "s.seam.toml", machine, options), machine, options)
    trajectory = plan.motion.of_needle
    pieces = sum(len(part) for part in trajectory)
    runs = list(planned_stitches(plan))
    down = np.concatenate([run.down_s for run in runs])
    points = np.concatenate([run.point for run in runs])
    assert pieces < 3 * len(down)
    assert (np.diff(down) > 0.0).all()
    away = np.sqrt(((trajectory(down) - points) ** 2).sum(axis=1))
    expected, least = in_order(trajectory, points)
    step = trajectory.duration_s / 20_000
    fastest = np.abs(trajectory(np.linspace(0, trajectory.duration_s, 999), 1)).sum(axis=1).max()
    assert away.max() < 1e-4
    assert (away < least + 1e-9).all()
    # Nearest to within the motion in a step of the search, where the distance hardly changes.
    assert np.abs(trajectory(down) - trajectory(expected)).max() < 2.0 * fastest * step
