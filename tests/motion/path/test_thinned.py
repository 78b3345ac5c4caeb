"""Chords in place of dense rough points: bounds, compared with independent sums."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.motion.path.test_auto import gap_to_polyline
from threadline.files import Stream
from threadline.motion.path.auto import auto_pieces
from threadline.motion.path.polygon import turns
from threadline.motion.path.runs import runs
from threadline.motion.path.thinned import SHARES, Thinner
from threadline.motion.path.types import ProgrammedPath, VertexBlock
from threadline.motion.timing.retime import retime

CUT_M = 1e-4


def programmed(points, radius_m=None, rests=(), block=5000, nominal_s=0.0):
    count, axes = points.shape
    rest = np.zeros(count, dtype=np.int64)
    rest[[*rests, -1]] = 1
    own = np.arange(count)
    blocks = [
        VertexBlock(
            positions=points[rows], operation=own[rows], nominal_s=np.full(count, nominal_s)[rows],
            rest=rest[rows], dwell_s=np.zeros(count)[rows], line=own[rows],
        )
        for rows in (slice(at, at + block) for at in range(0, count, block))
    ]  # fmt: skip
    return ProgrammedPath(
        axes=tuple(map(str, range(axes))),
        radius_m=np.ones(axes) if radius_m is None else radius_m,
        blocks=Stream.of(blocks),
    )


def thinned(path, cut_m=CUT_M):
    thinner = Thinner(path.radius_m, cut_m)
    found = [thinner.thinned(chunk) for chunk in runs(path)]
    return {
        name: np.concatenate([getattr(chunk.vertices, name) for chunk in found])
        for name in ("positions", "beside_m", "operation", "nominal_s")
    }


def near_in_order(program, chords, within_m):
    """Return whether the discrete Frechet distance of two dense polylines is within a bound.

    Eiter and Mannila, "Computing discrete Frechet distance" (1994): the reachable pairs of places,
    row after row.
    """
    free = ((program[:, None] - chords[None]) ** 2).sum(axis=2) <= within_m**2
    reached = np.logical_and.accumulate(free[0])
    for row in free[1:]:
        before = reached
        entered = row & (before | np.concatenate([[False], before[:-1]]))
        # Along the row from each place that is entered, as far as it is free.
        reached = np.zeros_like(row)
        on = False
        for k, (open_, enter) in enumerate(zip(row, entered, strict=True)):
            on = open_ and (on or enter)
            reached[k] = on
    return bool(reached[-1])


def filled(points, step_m):
    """Return a polyline with places no farther from each other than a step."""
    parts = [points[:1]]
    for a, b in pairwise(points):
        count = max(int(np.ceil(np.linalg.norm(b - a) / step_m)), 1)
        parts.append(a + np.arange(1, count + 1)[:, None] / count * (b - a))
    return np.concatenate(parts)


def noisy(count, beside_m, axes=2, seed=0, step_m=1e-4, radius=0.02):
    t = np.arange(count) * step_m / radius
    curve = radius * np.stack([np.sin((1 + 0.3 * k) * t + k) for k in range(axes)], axis=1)
    return curve + np.random.default_rng(seed).uniform(-beside_m, beside_m, curve.shape)


@st.composite
def rough_lines(draw):
    """Noise on curves, random walks, zigzags and reversals, in one to six axes, of any size."""
    axes = draw(st.integers(1, 6))
    random = np.random.default_rng(draw(st.integers(0, 10**6)))
    parts = [np.zeros((1, axes))]
    for _ in range(draw(st.integers(1, 3))):
        kind = draw(st.sampled_from(["noise", "walk", "zigzag", "back", "near", "long", "circle"]))
        count = draw(st.integers(2, 60))
        size = CUT_M * 10.0 ** draw(st.floats(-2.0, 0.7))
        way = np.eye(axes)[random.integers(axes)] * random.choice([-1.0, 1.0])
        steps = np.arange(1, count + 1)[:, None] * size * way
        if kind == "noise":
            steps = steps + random.normal(scale=0.3 * size, size=(count, axes))
        elif kind == "walk":
            steps = np.cumsum(random.normal(scale=size, size=(count, axes)), axis=0)
        elif kind == "zigzag":
            steps = steps + size * (np.arange(count) % 2)[:, None] * np.roll(way, 1)
        elif kind == "back":
            steps = np.concatenate([steps, steps[-2::-1]])
        elif kind == "near":
            steps = steps * 1e-6
        elif kind == "long":
            steps = random.normal(size=(3, axes)) * 10.0 ** random.uniform(-9, 6, (3, 1))
        else:
            t = np.arange(1, count + 1) * 0.2
            steps = np.zeros((count, axes))
            steps[:, 0], steps[:, -1] = 5 * size * np.sin(t), 5 * size * (1 - np.cos(t))
        parts.append(parts[-1][-1] + steps)
    return np.concatenate(parts)


@settings(max_examples=30, deadline=None)
@given(rough_lines(), st.sampled_from([7, 64, 5000]))
def test_chords_stay_within_what_they_say_and_their_share(points, block):
    path = programmed(points, block=block)
    found = thinned(path)
    assert np.isfinite(found["positions"]).all()
    assert found["beside_m"].max() <= SHARES[-1] * CUT_M
    assert np.all(np.diff(found["operation"]) >= 0)
    whole = thinned(programmed(points))
    assert np.array_equal(found["positions"], whole["positions"])  # in blocks of any size
    read = np.concatenate([chunk.vertices.positions for chunk in runs(path)])
    assert np.array_equal(found["positions"][[0, -1]], read[[0, -1]])
    rounding = 1e-14 * np.abs(points).max() + 2e-10
    if np.abs(np.diff(points, axis=0)).max() < 1e-2:
        worst = (
            gap_to_polyline(points, found["positions"]).max()
            if len(found["positions"]) > 1
            else 0.0
        )
        assert worst <= found["beside_m"].max() + rounding


@pytest.mark.parametrize("beside_m", [1e-6, 2e-5, 3e-5])
def test_the_bound_holds_in_the_order_of_the_points(beside_m):
    """The discrete Frechet distance uses no place of a vertex on a chord."""
    points = noisy(150, beside_m)
    found = thinned(programmed(points))
    assert len(found["positions"]) < 75
    step_m = 2e-5
    bound = found["beside_m"].max() + step_m
    assert near_in_order(filled(points, step_m), filled(found["positions"], step_m), bound)


@pytest.mark.parametrize("degree", [3, 4])
@pytest.mark.parametrize("beside_m", [1e-6, 2e-5])
def test_the_spline_stays_within_the_tolerance_of_rough_points(beside_m, degree):
    """At 10^5 places, and the points themselves from the spline."""
    points = noisy(200, beside_m, axes=3)
    path = auto_pieces(programmed(points), CUT_M, 0.0, degree=degree, thin=True)
    blocks = list(path)
    c = np.concatenate([block.coefficients for block in blocks])
    u = np.linspace(0.0, 1.0, 100_000 // len(c) + 1)
    places = (u[:, None] ** np.arange(degree + 1) @ c).reshape(-1, 3)
    assert gap_to_polyline(places, points).max() <= CUT_M
    assert gap_to_polyline(points, places[::20]).max() <= CUT_M * 1.001
    assert len(c) < 100


def test_thinning_leaves_smooth_paths_unchanged():
    """A circle, a polyline with long legs and corners, and a staircase beyond the tolerance."""
    turn = np.linspace(0.0, 2 * np.pi, 721)
    circle = 0.05 * np.stack([np.sin(turn), 1.0 - np.cos(turn)], axis=1)
    corners = np.random.default_rng(2).normal(size=(40, 2)) * 0.05
    stairs = np.repeat(np.arange(60) * 3e-4, 2)
    for points in (circle, corners, np.stack([stairs[1:], stairs[:-1]], axis=1)):
        plain, thin = (
            np.concatenate(
                [b.coefficients for b in auto_pieces(programmed(points), CUT_M, 0.0, thin=t)]
            )
            for t in (False, True)
        )
        assert np.array_equal(plain, thin)


def test_a_long_leg_and_its_corner_stay_beside_rough_points():
    """The corner's points are added on its legs, so these are the program's own."""
    rough = noisy(200, 5e-6)
    start = rough[0]
    points = np.concatenate(
        [start + np.array([[-0.02, 0.03], [-0.02, 0.0]]), rough, rough[-1] + [[0.0, 0.04]]]
    )
    found = thinned(programmed(points))
    assert len(found["positions"]) < 100
    for vertex in (points[0], points[1], points[2], points[-2], points[-1]):
        assert (found["positions"] == vertex).all(axis=1).any()


def test_thinned_path_keeps_the_rests_of_the_program():
    points = noisy(300, 5e-6)
    found = thinned(programmed(points, rests=(120,)))
    assert (found["positions"] == points[120]).all(axis=1).any()
    assert np.array_equal(found["positions"][-1], points[-1])


def test_blocks_change_nothing_and_times_are_kept():
    points = noisy(500, 1e-5)
    whole = thinned(programmed(points, nominal_s=0.25))
    for block in (1, 17, 100):
        parts = thinned(programmed(points, block=block, nominal_s=0.25))
        for name, column in whole.items():
            assert np.array_equal(parts[name], column), name
    assert whole["nominal_s"].sum() == pytest.approx(0.25 * len(points), rel=1e-12)


def test_lengths_are_those_at_the_tool():
    """Radians of an axis at 0.1 m are ten times the metres: the same path, the same chords."""
    points = noisy(300, 5e-6)
    turned = thinned(programmed(points / [1.0, 0.1], radius_m=np.array([1.0, 0.1])))
    plain = thinned(programmed(points))
    assert turned["positions"] * [1.0, 0.1] == pytest.approx(plain["positions"], abs=1e-12)


def test_an_axis_that_stands_changes_no_chord():
    """Three axes use other lines of the code than two."""
    points = noisy(400, 1e-5)
    flat = thinned(programmed(np.concatenate([points, np.zeros((400, 1))], axis=1)))
    plain = thinned(programmed(points))
    assert flat["positions"][:, :2] == pytest.approx(plain["positions"], abs=1e-12)
    assert flat["beside_m"] == pytest.approx(plain["beside_m"], abs=1e-12)


def test_the_polygon_of_rough_points_turns_less():
    """Points 1 um beside a circle turn by 0.02 rad each; the polygon turns by 0.002 rad."""
    t = np.arange(600) * 1e-4 / 0.05
    points = 0.05 * np.stack([np.cos(t), np.sin(t)], axis=1)
    points += np.random.default_rng(4).uniform(-1e-6, 1e-6, points.shape)
    found = thinned(programmed(points))["positions"]
    length, turn = turns(found, np.ones(2))
    bend = turn[1:-1] / (0.5 * (length[1:] + length[:-1]))
    assert bend.max() < 2.0 / 0.05  # the circle's own; for the points it exceeds 200 / m


def test_chords_beside_a_circle_are_alike_and_turn_as_it_does():
    """Alternately long and short, they would bend the path where the curve does not bend."""
    t = np.arange(2500) * 1e-4 / 0.1
    points = 0.1 * np.stack([np.cos(t), np.sin(t)], axis=1)
    points += np.random.default_rng(4).uniform(-2e-6, 2e-6, points.shape)
    found = thinned(programmed(points))["positions"]
    length, turn = turns(found, np.ones(2))
    ratio = length[1:-2] / length[2:-1]
    assert len(ratio) > 20 and max(ratio.max(), 1.0 / ratio.min()) < 1.15
    bend = turn[2:-2] / (0.5 * (length[2:-1] + length[1:-2]))
    assert bend == pytest.approx(1.0 / 0.1, rel=0.15)


def test_a_motion_along_rough_points_takes_as_long_as_along_their_curve():
    limits = 1.0, 10.0, 1000.0, CUT_M
    rough, smooth = (retime(noisy(600, b, radius=0.1), *limits).duration_s for b in (2e-6, 0.0))
    assert rough == pytest.approx(smooth, rel=0.01)
