from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from threadline.jobs.operations import Dwell, Feed, FeedMode, Source
from threadline.machine import load_machine
from threadline.motion.path import interpolations, path_deviation, plan_path, programmed_path
from threadline.motion.path.auto import auto_pieces

from .builders import job_of, polylines, there_and_back

WINDER = load_machine("lathe-winder")
RAPID = Feed(FeedMode.RAPID, 0.0)


def planned(points, axes, tolerance_m, **given):
    programmed = programmed_path(job_of(points, axes, RAPID, **given), WINDER)
    return programmed, plan_path(programmed, WINDER, "auto", tolerance_m)


def pieces(path):
    blocks = [block.coefficients for block in path]
    return np.concatenate([np.zeros((0, 4, len(path.axes))), *blocks])


def gap_to_polyline(points, vertices):
    """Return the distance of each point from the nearest chord, by brute force."""
    columns = np.ascontiguousarray(np.transpose(points))
    squares = np.full(len(points), np.inf)
    for a, b in pairwise(vertices):
        way, away = b - a, columns - a[:, None]
        square = way @ way
        if square > 0:
            away -= np.multiply.outer(way, (way @ away / square).clip(0.0, 1.0))
        away *= away
        np.minimum(squares, away.sum(axis=0), out=squares)
    return np.sqrt(squares)


def sampled(path, count):
    u = np.linspace(0.0, 1.0, count)
    c = pieces(path)
    return np.einsum("ku,ika->iua", u ** np.arange(c.shape[1])[:, None], c).reshape(-1, c.shape[2])


@given(polylines(), st.sampled_from([1e-3, 1e-4, 1e-6]))
def test_never_farther_from_the_program_than_the_tolerance(line, tolerance_m):
    """Dense samples against all chords, and all vertices against the dense samples."""
    axes, points = line
    _, path = planned(points, axes, tolerance_m)
    if not len(pieces(path)):
        return  # nothing moves
    scaled = sampled(path, 65) * path.radius_m
    vertices = np.array(points) * path.radius_m
    # The vertices are compared with chords of the samples, whose sagitta is far below 1 %.
    assert gap_to_polyline(scaled, vertices).max() <= tolerance_m * 1.01
    assert gap_to_polyline(vertices, scaled).max() <= tolerance_m * 1.01
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    assert np.all(scaled >= low - 1e-12) and np.all(scaled <= high + 1e-12)


@given(polylines())
def test_continuous_second_derivative(line):
    """At every joint: position, unit tangent and curvature vector, at the tool."""
    axes, points = line
    _, path = planned(points, axes, 1e-4)
    c = pieces(path) * path.radius_m
    if len(c) < 2:
        return
    powers = np.arange(4)
    ends = c.sum(axis=1)[:-1]
    assert ends == pytest.approx(c[1:, 0], abs=1e-12 * (1 + np.abs(ends).max()))
    before = (c * powers[None, :, None]).sum(axis=1)[:-1]
    after = c[1:, 1]
    bend_before = (c * (powers * (powers - 1))[None, :, None]).sum(axis=1)[:-1]
    bend_after = 2 * c[1:, 2]
    fast = np.linalg.norm(before, axis=1), np.linalg.norm(after, axis=1)
    size = np.abs(c[:-1, 1:]).max(axis=(1, 2))
    # Tangents of pieces much shorter than the coordinates carry the coordinates' rounding.
    sound = (np.minimum(*fast) > 1e-3 * size) & (np.minimum(*fast) > 1e-8)
    tangents = before[sound] / fast[0][sound, None], after[sound] / fast[1][sound, None]
    assert tangents[0] == pytest.approx(tangents[1], abs=1e-5)
    curvature = []
    for tangent, bend, speed in zip(tangents, (bend_before, bend_after), fast, strict=True):
        across = bend[sound] - (bend[sound] * tangent).sum(axis=1, keepdims=True) * tangent
        curvature.append(across / speed[sound, None] ** 2)
    largest = np.abs(np.concatenate(curvature)).max(initial=0.0)
    assert np.abs(curvature[0] - curvature[1]).max(initial=0.0) <= 1e-4 * largest + 1e-9


def test_long_straight_sections_stay_lines():
    """A right angle of two 100 mm chords: all except the corner is two straight pieces."""
    _, path = planned([[0, 0], [0.1, 0], [0.1, 0.1]], ("X", "Y"), 1e-4)
    c = pieces(path)
    straight = np.all(c[:, 2:] == 0, axis=(1, 2))
    assert straight.tolist() == [True, False, False, True]
    assert np.linalg.norm(c[[0, -1], 1], axis=1).sum() > 0.199


@pytest.mark.parametrize("turn_deg", [20.0, 90.0, 170.0])
def test_a_corner_of_long_chords_is_cut_by_what_is_allowed(turn_deg: float) -> None:
    """No more and no less: with three even legs the spline passes |dt| l / 6 beside the vertex.

    ``auto`` keeps a part of the tolerance for its smoothing, which would hide a wider cut.
    """
    turn, cut_m = np.radians(turn_deg), 1e-4
    vertices = 0.1 * np.array([[0.0, 0.0], [1.0, 0.0], [1.0 + np.cos(turn), np.sin(turn)]])
    programmed = programmed_path(job_of(vertices.tolist(), ("X", "Y"), RAPID), WINDER)
    path = [block.coefficients for block in auto_pieces(programmed, cut_m)]
    u = np.linspace(0.0, 1.0, 2001)
    places = np.concatenate([u[:, None] ** np.arange(len(c)) @ c for c in np.concatenate(path)])
    near = np.linalg.norm(places - vertices[1], axis=1).min()
    assert near == pytest.approx(cut_m, rel=1e-6)


def test_dense_curve_becomes_a_b_spline_without_added_points():
    """A circle of 720 chords, each cut by far less than the tolerance: one piece per chord."""
    turn = np.linspace(0, 2 * np.pi, 721)
    points = np.stack([0.1 * np.sin(turn), 0.1 - 0.1 * np.cos(turn)], axis=1)
    _, path = planned(points.tolist(), ("X", "Y"), 1e-4)
    c = pieces(path)
    assert len(c) == 720
    assert not np.all(c[:, 2:] == 0, axis=(1, 2)).any()
    assert path.summary["points_added"] == 0


def test_tolerance_is_used_and_held_as_it_shrinks():
    """Nearer points pull the spline to the corner, and it is never given up: it scales."""
    for tolerance_m in (1e-3, 1e-4, 1e-5, 1e-6):
        programmed, path = planned(there_and_back(), ("X",), tolerance_m)
        deviation = path_deviation(programmed, path)
        assert 0.3 * tolerance_m < deviation.at_tool_m <= tolerance_m
        assert deviation.line == 7  # the reversal
        assert sum(int(block.rest_after.sum()) for block in path) == 1
    # If no representable curve is left, the corner is passed at rest.
    programmed, path = planned(there_and_back(), ("X",), 1e-9)
    assert path_deviation(programmed, path).at_tool_m <= 1e-9
    assert sum(int(block.rest_after.sum()) for block in path) == 2


def test_summary_tells_points_added_and_the_worst_place():
    programmed, path = planned([[0, 0], [0.1, 0], [0.1, 0.1], [0.2, 0.1]], ("X", "Y"), 1e-4)
    measured = path_deviation(programmed, path)
    assert path.summary["points_added"] == 4  # one on either side of both corners
    assert path.summary["largest_deviation_m"] == pytest.approx(measured.at_tool_m)
    assert path.summary["largest_deviation_line"] == measured.line


def test_the_points_added_are_counted_without_measuring_the_deviation(monkeypatch):
    _, path = planned([[0, 0], [0.1, 0], [0.1, 0.1], [0.2, 0.1]], ("X", "Y"), 1e-4)
    monkeypatch.setattr(interpolations, "path_deviation", None)
    assert path.summary["points_added"] == 4
    assert next(iter(path.summary)) == "points_added"
    assert len(path.summary) == 3


def test_rests_and_dwells_are_kept():
    extra = {1: Dwell(0.5, Source("job.prg", 1)), 3: Dwell(0.25, Source("job.prg", 3))}
    points = [[0, 0], [0.1, 0], [0.1, 0.1], [0.1, 0.1], [0.2, 0.1]]
    _, path = planned(points, ("X", "Y"), 1e-4, extra=extra)
    rest = np.concatenate([block.rest_after for block in path]) == 1
    dwell = np.concatenate([block.dwell_s for block in path])
    ends = pieces(path).sum(axis=1)
    assert dwell[rest].tolist() == [0.5, 0.25, 0.0]
    assert ends[rest] == pytest.approx(np.array([[0.1, 0], [0.1, 0.1], [0.2, 0.1]]), abs=1e-14)


@settings(max_examples=3)
@given(st.integers(0, 2**32 - 1))
def test_blocks_leave_no_seam(seed):
    """9000 moves in three blocks give the pieces that one block would."""
    rng = np.random.default_rng(seed)
    points = np.cumsum(rng.normal(size=(9_000, 2)) * 2e-5, axis=0) + 0.02
    programmed, path = planned(points.tolist(), ("X", "Y"), 1e-4)
    c = pieces(path)
    assert c.sum(axis=1)[:-1] == pytest.approx(c[1:, 0], abs=1e-13)
    assert sum(int(block.rest_after.sum()) for block in path) == 1
    assert path_deviation(programmed, path).at_tool_m <= 1e-4


@pytest.mark.parametrize("seed", [246, 276, 433, 453, 548, 579])
def test_moves_of_very_different_lengths_keep_the_tolerance(seed: int) -> None:
    """From 0.3 to 20 mm one after the other: a corner between a short and a long leg.

    A corner with uneven neighbours is cut by a quarter of its longer leg's value; with an eighth
    these polylines exceed the tolerance by 3 to 28 %.
    """
    rng = np.random.default_rng(seed)
    count = int(rng.integers(3, 9))
    size = 10.0 ** rng.uniform(-3.5, -1.7, (count, 1))
    points = np.cumsum(rng.uniform(-1, 1, (count, 2)) * size, axis=0) + np.array([0.0, 0.1])
    programmed, path = planned(points.tolist(), ("X", "Y"), 5e-4)
    assert path_deviation(programmed, path).at_tool_m <= 5e-4
