"""Straight moves that are cut into parts: joined along one line, and judged as one move."""

from __future__ import annotations

import time

import numpy as np
import pytest

from threadline.files import ChannelKind
from threadline.motion.path.types import VertexBlock
from threadline.verdict import Criterion, judge
from threadline.verdict.straight_runs import straight_runs
from threadline.verdict.window import PathWindow

from .builders import TICK_S, follow, plan_through, record, spec_of

K = ChannelKind
NAMES = ("contour_error", "progress_error", "turning_point_error", "velocity_ripple")


def blocks_of(points, *, nominal_s=None, rest=(), per_block=1000):
    points = np.asarray(points, dtype=float)
    count = len(points)
    nominal = np.where(np.arange(count) > 0, 0.1, 0.0) if nominal_s is None else nominal_s
    resting = np.zeros(count, dtype=np.int64)
    resting[list(rest)] = 1
    for low in range(0, count, per_block):
        part = slice(low, low + per_block)
        yield VertexBlock(
            positions=points[part],
            operation=np.maximum(np.arange(count) - 1, 0)[part],
            nominal_s=np.asarray(nominal, dtype=float)[part],
            rest=resting[part],
            dwell_s=np.zeros(count)[part],
            line=10 * np.arange(count)[part],
        )


def joined(points, **options):
    """Return the vertices at which runs end, and first and last operation of each run."""
    radius = np.ones(np.shape(points)[1])
    runs = list(straight_runs(blocks_of(points, **options), radius))
    return (
        np.concatenate([one.vertices for one in runs]),
        np.concatenate([one.begun for one in runs]).tolist(),
        np.concatenate([one.operation for one in runs]).tolist(),
    )


@pytest.mark.parametrize("per_block", [1, 2, 3, 1000])
def test_runs_end_at_corners_and_reversals(per_block: int) -> None:
    points = [[0, 0], [1, 0], [2, 0], [5, 0], [5, 1], [5, 3], [5, 2], [5, 2], [6, 2]]
    vertices, begun, ended = joined(points, nominal_s=np.zeros(len(points)), per_block=per_block)
    assert vertices.tolist() == [[0, 0], [5, 0], [5, 3], [5, 2], [6, 2]]
    assert begun == [0, 0, 3, 5, 7]
    assert ended == [0, 2, 4, 6, 7]


def test_runs_end_where_the_machine_rests_or_its_speed_changes() -> None:
    line = [[0.0], [1.0], [2.0], [3.0], [4.0]]
    assert len(joined(line)[0]) == 2
    assert joined(line, rest=[2])[0].ravel().tolist() == [0, 2, 4]
    assert joined(line, rest=[0])[0].ravel().tolist() == [0, 4]
    for third in (0.2, 0.0):  # slower, and a rapid move
        found = joined(line, nominal_s=[0.0, 0.1, 0.1, third, third])
        assert found[0].ravel().tolist() == [0, 2, 4]


@pytest.mark.parametrize("seed", range(20))
def test_no_dropped_vertex_is_beside_its_run(seed: int) -> None:
    """Fine curves and noisy lines in three axes: every vertex is within 3 nm of a kept one's run.

    A run accepts a direction in which each of its vertices is within 1 nm. Its last vertex may be
    off in that direction by as much, and so may the vertex before.
    """
    draw = np.random.default_rng(seed)
    count = 4000
    step = 10.0 ** draw.uniform(-6, -2)
    turn = 10.0 ** draw.uniform(-10, -1) * draw.choice([0.0, 1.0], size=count, p=[0.3, 0.7])
    angle = np.cumsum(turn)
    moves = step * np.column_stack([np.cos(angle), np.sin(angle), 0.1 * np.cos(0.3 * angle)])
    moves[draw.random(count) < 0.05] *= -1.0
    moves[draw.random(count) < 0.05] = 0.0
    points = np.vstack([[0, 0, 0], np.cumsum(moves, axis=0)])
    points += draw.uniform(-1, 1, points.shape) * 10.0 ** draw.uniform(-16, -9)
    kept, begun, ended = joined(points, nominal_s=np.zeros(count + 1), per_block=333)
    assert ended[-1] == count - 1
    for run in range(1, len(kept)):
        between = points[begun[run] + 1 : ended[run] + 2]
        start, way = kept[run - 1], kept[run] - kept[run - 1]
        length = max(way @ way, 1e-300)
        along = np.clip((between - start) @ way / length, 0.0, 1.0)
        beside = np.linalg.norm(between - start - along[:, None] * way, axis=1)
        assert beside.max() < 3e-9


def cut(points, parts: int):
    """Return the points, with every move cut into a number of equal parts."""
    points = np.asarray(points, dtype=float)
    at = np.arange(parts * (len(points) - 1) + 1) / parts
    return np.column_stack([np.interp(at, np.arange(len(points)), p) for p in points.T])


@pytest.mark.parametrize("seed", range(12))
def test_a_verdict_does_not_depend_on_how_its_moves_are_cut(seed: int) -> None:
    """Random paths of two axes, cut into 1, 2, 5 and 30 parts; the load trails, rings and strays.

    The samples and the commands are the same; only the text of the program differs.
    """
    draw = np.random.default_rng(seed)
    points = np.cumsum(draw.uniform(-0.1, 0.1, (int(draw.integers(2, 7)), 2)), axis=0)
    per_move = 60
    commanded, _ = follow(points, per_move, 60)
    late = int(draw.choice([2, 8, 30]))
    load = np.vstack([np.repeat(commanded[:1], late, axis=0), commanded[:-late]])
    wave = np.sin(np.outer(np.arange(len(load)), draw.uniform(0.02, 0.5, 2)))
    load = load + 10.0 ** draw.uniform(-4, -2) * wave
    criteria = [Criterion(name=name) for name in NAMES]
    found = []
    for parts in (1, 2, 5, 30):
        program = cut(points, parts)
        operation = follow(program, per_move // parts, 60)[1]
        plan = plan_through(program, move_s=TICK_S * per_move / parts, vertices_per_block=7)
        recording = record(("X", "Y"), {K.COMMANDED: commanded, K.LOAD: load}, operation)
        verdict = judge([recording], plan, spec_of(*criteria))
        found.append({(r.name, r.axis): r.measured for r in verdict.results})
    for other in found[1:]:
        assert other.keys() == found[0].keys()
        for key, value in found[0].items():
            assert other[key] == pytest.approx(value, rel=1e-9, abs=1e-12), key


def test_a_load_that_trails_by_more_than_the_lag_is_charged_within_a_move() -> None:
    """1.25 mm in each sample, 20 samples late, 10 of them free: 12.5 mm, in one move or in many.

    The whole motion lies on the line.
    """
    for parts in (1, 2, 80):
        program = cut([[0.0, 0.0], [0.1, 0.0]], parts)
        commanded, _ = follow([[0.0, 0.0], [0.1, 0.0]], 80)
        late = np.vstack([np.repeat(commanded[:1], 20, axis=0), commanded[:-20]])
        operation = follow(program, 80 // parts)[1]
        recording = record(("X", "Y"), {K.COMMANDED: commanded, K.LOAD: late}, operation)
        plan = plan_through(program, move_s=TICK_S * 80 / parts)
        spec = spec_of(Criterion(name="contour_error"), lag_s=10 * TICK_S)
        found = judge([recording], plan, spec).result("contour_error")
        assert found.measured == pytest.approx(10 * 1.25e-3, abs=1e-12)


def test_the_worst_place_is_told_with_the_line_of_its_move() -> None:
    """The load strays in the 7th of ten parts of one straight line, which is in line 70."""
    program = cut([[0.0, 0.0], [0.1, 0.0]], 10)
    commanded, operation = follow(program, 10)
    load = commanded.copy()
    load[65, 1] += 1e-3
    recording = record(("X", "Y"), {K.COMMANDED: commanded, K.LOAD: load}, operation)
    found = judge([recording], plan_through(program), spec_of(Criterion(name="contour_error")))
    assert found.result("contour_error").measured == pytest.approx(1e-3, abs=1e-12)
    assert found.result("contour_error").job_line == 70


def test_a_line_of_many_moves_is_one_chord_and_read_in_little_time() -> None:
    """300 000 moves along one line: two vertices are kept, and reading them takes seconds.

    The lines of the moves are right to within eight moves.
    """
    count = 300_000
    program = 1e-6 * np.arange(count + 1)[:, None]
    plan = plan_through(program, ("X",), move_s=1e-3)
    window = PathWindow(plan.motion.programmed)
    begun_s = time.process_time()
    window.reach(0)
    assert time.process_time() - begun_s < 10.0
    assert len(window) == 2
    for place in (0, 1, 1234, count - 1):
        line = window.lines_at(np.array([1]), np.array([[1e-6 * (place + 0.5)]]))[0] // 10
        assert 0 <= line - (place + 1) <= 8
