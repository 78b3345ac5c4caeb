"""The contour error, compared with closed forms, and with every chord for every sample.

Distances are computed in float64 from coordinates below 1 m: 1e-12 m covers the rounding.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from threadline.files import ChannelKind
from threadline.verdict import Criterion, Status, judge
from threadline.verdict.bow import NO_BOWS
from threadline.verdict.boxes import NO_BOXES, vertices_to_path
from threadline.verdict.nearest import Closest, Track

from .builders import TICK_S, follow, move_s, plan_through, record, spec_of

CONTOUR = spec_of(Criterion(name="contour_error", limit=5e-4))
XY = ("X", "Y")


def contour(
    points, actual, operation, *, commanded=None, spec=CONTOUR, axes=XY, per_block=64, **plan
):
    made = plan_through(points, axes, **{"move_s": move_s(operation), **plan})
    channels = {ChannelKind.LOAD: actual}
    if commanded is not None:
        channels[ChannelKind.COMMANDED] = commanded
    recording = record(axes, channels, operation, per_block=per_block)
    return judge([recording], made, spec).result("contour_error")


def brute_force(points, actual, operation, lag, axes=XY, radius=None):
    """Compare every sample with every chord of its operations, every vertex with every segment."""
    radius = np.ones(len(axes)) if radius is None else radius
    v = np.asarray(points, dtype=float) * radius
    q = actual * radius
    n = len(q)
    early = np.array([operation[max(i - lag, 0)] for i in range(n)])
    late = np.array([operation[min(i + lag, n - 1)] for i in range(n)])

    def distance(p, a, b):
        d = b - a
        u = np.clip((p - a) @ d / (d @ d), 0, 1) if d @ d > 0 else 0.0
        return np.linalg.norm(p - a - u * d)

    worst = 0.0
    for i in range(n):
        chords = [c for c in range(len(v) - 1) if early[i] <= c <= late[i]]
        worst = max(worst, min(distance(q[i], v[c], v[c + 1]) for c in chords))
    for k in range(len(v)):
        near = [distance(v[k], q[0], q[0])] if early[0] <= k <= late[0] + 1 else []
        near += [
            distance(v[k], q[i], q[i + 1]) for i in range(n - 1) if early[i] <= k <= late[i + 1] + 1
        ]
        worst = max(worst, min(near))
    return worst


def brute_between(points, actual, operation, lag, parts=64):
    """Return the largest of many distances between samples, and how much larger one may be."""
    v, n = np.asarray(points, dtype=float), len(actual)
    worst = longest = 0.0
    for i in range(n - 1):
        early, late = operation[max(i - lag, 0)], operation[min(i + 1 + lag, n - 1)]
        longest = max(longest, np.linalg.norm(actual[i + 1] - actual[i]))
        u = np.arange(1, parts)[:, None] / parts
        places = actual[i] + u * (actual[i + 1] - actual[i])
        best = np.full(len(places), np.inf)
        for c in range(int(early), int(late) + 1):
            d = v[c + 1] - v[c]
            square = d @ d
            along = np.clip((places - v[c]) @ d / square, 0, 1) if square > 0 else np.zeros(len(u))
            best = np.minimum(best, np.linalg.norm(places - v[c] - along[:, None] * d, axis=1))
        worst = max(worst, best.max())
    return worst, longest / parts


def test_a_jump_between_two_legs_is_seen_between_its_samples() -> None:
    """Two legs are 10 mm apart, and both are followed; one sample of the first is on the second.

    Every sample is on the path and every point is passed, but half-way across the tool is 5 mm off.
    """
    points = [[0.0, 0.0], [0.1, 0.0], [0.1, 0.01], [0.0, 0.01]]
    commanded, operation = follow(points, 10)
    actual = commanded.copy()
    actual[5, 1] += 0.01
    spec = spec_of(*CONTOUR.criteria, lag_s=30 * TICK_S)
    result = contour(points, actual, operation, spec=spec)
    # From (40, 0) to (50, 10) mm: half-way it is 5 mm from either leg.
    assert result.measured == pytest.approx(5e-3, abs=1e-9)
    assert result.time_s == pytest.approx(4.5 * TICK_S)
    assert result.status is Status.FAILED


def test_a_short_cut_between_two_legs_that_meet_is_seen_between_its_samples() -> None:
    """From the middle of one leg to the middle of the next, and back to the corner along it.

    Every sample is on the path, and the corner is passed, too. The halves are at right angles:
    half-way across the tool is half of their length from either.
    """
    points = [[0.0, 0.0], [0.1, 0.0], [0.1, 0.1], [0.0, 0.1]]
    commanded, operation = follow(points, 10)
    actual = commanded.copy()
    actual[5:11] = [[0.05, 0.0], [0.1, 0.05], [0.1, 0.04], [0.1, 0.02], [0.1, 0.01], [0.1, 0.0]]
    spec = spec_of(*CONTOUR.criteria, lag_s=30 * TICK_S)
    result = contour(points, actual, operation, spec=spec)
    assert result.measured == pytest.approx(0.025, abs=1e-9)
    assert result.time_s == pytest.approx(5.5 * TICK_S)
    assert result.note == ""


def test_constant_lateral_offset_is_the_error() -> None:
    commanded, operation = follow([[0, 0], [0.1, 0]], 200)
    result = contour([[0, 0], [0.1, 0]], commanded + np.array([0.0, 3e-4]), operation)

    assert result.measured == pytest.approx(3e-4, abs=1e-12)
    assert result.status is Status.PASSED
    assert result.unit == "m"


def test_lag_along_the_path_does_not_count_but_lag_across_a_corner_does() -> None:
    """A corner cut by c on both legs: the vertex is c / sqrt(2) from the chord of the cut."""
    points = [[0, 0], [0.1, 0], [0.1, 0.1]]
    commanded, operation = follow(points, 100)
    late = np.vstack([np.repeat(commanded[:1], 6, axis=0), commanded[:-6]])

    assert contour(points, late, operation).measured == pytest.approx(0.0, abs=1e-12)

    cut = 4e-3
    path = np.array([[0, 0], [0.1 - cut, 0], [0.1, cut], [0.1, 0.1]])
    actual = np.vstack(
        [np.linspace(path[i], path[i + 1], 67)[: 67 if i == 2 else 66] for i in range(3)]
    )
    operation = np.minimum(np.arange(len(actual)) // 99, 1).astype(float)
    result = contour(points, actual, operation)

    assert result.measured == pytest.approx(cut / np.sqrt(2), abs=1e-12)
    assert result.position == pytest.approx((0.1, 0.0))
    assert result.job_line == 10
    assert result.status is Status.FAILED


def test_offset_from_a_circle() -> None:
    """A circle of n chords followed at radius r + d: farthest from mid-chord, by d + sagitta."""
    n, r, d = 72, 0.05, 2e-4
    angle = 2 * np.pi * np.arange(n + 1) / n
    points = r * np.column_stack([np.cos(angle), np.sin(angle)])
    fine = 2 * np.pi * np.arange(n * 20 + 1) / (n * 20)
    actual = (r + d) * np.column_stack([np.cos(fine), np.sin(fine)])
    operation = np.minimum(np.arange(len(fine)) // 20, n - 1)

    expected = (r + d) - r * np.cos(np.pi / n)
    assert contour(points, actual, operation).measured == pytest.approx(expected, abs=1e-12)


def test_a_retraced_path_does_not_hide_a_missed_end() -> None:
    """To 180 mm and back on the same line, turned 0.47 mm early: no sample leaves the line."""
    points = [[0, 0], [0.18, 0], [0, 0]]
    commanded, operation = follow(points, 200)
    actual = np.minimum(commanded, [0.18 - 4.7e-4, 1.0])
    result = contour(points, actual, operation)

    assert result.measured == pytest.approx(4.7e-4, abs=1e-12)
    assert result.position == pytest.approx((0.18, 0.0))


def test_another_branch_that_crosses_or_runs_alongside_does_not_hide_an_error() -> None:
    """Two lines 1 mm apart, far apart in time: an offset of 0.8 mm is 0.8 mm, not 0.2 mm."""
    points = [[0, 0], [0.1, 0], [0.1, 0.05], [0, 0.05], [0, 1e-3], [0.1, 1e-3]]
    commanded, operation = follow(points, 100)
    actual = commanded.copy()
    middle = slice(30, 70)
    actual[middle, 1] += 8e-4

    assert contour(points, actual, operation).measured == pytest.approx(8e-4, abs=1e-12)


def test_crossing_figure_of_eight_against_brute_force() -> None:
    t = np.linspace(0, 2 * np.pi, 41)
    points = 0.05 * np.column_stack([np.sin(t), np.sin(2 * t)])
    commanded, operation = follow(points, 20)
    rng = np.random.default_rng(1)
    actual = commanded + 1e-3 * np.cumsum(rng.normal(size=commanded.shape), axis=0) / 20
    expected = brute_force(points, actual, operation, 4)

    result = contour(points, actual, operation, spec=spec_of(*CONTOUR.criteria, lag_s=4 * TICK_S))
    assert result.measured == pytest.approx(expected, abs=1e-12)


def test_rotary_axes_act_at_the_tool_radius() -> None:
    points = [[0, 0], [1.0, 0]]
    commanded, operation = follow(points, 100)
    result = contour(points, commanded + np.array([0.0, 2e-4]), operation, axes=("A", "X"))
    assert result.measured == pytest.approx(2e-4, abs=1e-12)

    points = [[0, 0], [0, 0.1]]
    commanded, operation = follow(points, 100)
    result = contour(points, commanded + np.array([2e-3, 0.0]), operation, axes=("A", "X"))
    assert result.measured == pytest.approx(0.1 * 2e-3, abs=1e-12)  # 100 mm tool radius


def test_a_load_that_trails_by_more_than_the_lag_is_charged() -> None:
    points = [[0.01 * i, 0] for i in range(11)]
    commanded, operation = follow(points, 5)
    late = np.vstack([np.repeat(commanded[:1], 20, axis=0), commanded[:-20]])
    generous = contour(points, late, operation, spec=spec_of(*CONTOUR.criteria, lag_s=0.1))
    strict = contour(points, late, operation, spec=spec_of(*CONTOUR.criteria, lag_s=0.025))

    assert generous.measured == pytest.approx(0.0, abs=1e-12)
    assert strict.measured > 0.02


def labelled_early(points, per_move, samples):
    """Return a command along ``points`` whose operations begin ``samples`` before their chords."""
    commanded, operation = follow(points, per_move)
    return commanded, np.concatenate([operation[samples:], np.repeat(operation[-1:], samples)])


@pytest.mark.parametrize("per_block", [1, 9, 1000])
def test_a_blend_is_on_the_chord_that_the_command_is_on(per_block: int) -> None:
    """In a blend round a corner the operation begins long before the corner.

    The load follows the programmed path exactly, 6 samples late: nothing is wrong. By the labels
    alone it would be 20 + 6 - 10 samples of 1 mm away.
    """
    points = [[0, 0], [0.1, 0], [0.1, 0.1]]
    commanded, operation = labelled_early(points, 100, 20)
    late = np.vstack([np.repeat(commanded[:1], 6, axis=0), commanded[:-6]])
    spec = spec_of(*CONTOUR.criteria, lag_s=10 * TICK_S)
    exact = contour(points, late, operation, commanded=commanded, spec=spec, per_block=per_block)
    assert exact.measured == pytest.approx(0.0, abs=1e-12)
    labels = contour(points, late, operation, spec=spec, per_block=per_block)
    assert labels.measured == pytest.approx(0.016, abs=1e-12)


def test_the_command_tells_two_nearly_equal_chords_apart() -> None:
    """Forth and back 0.8 mm apart: a load 0.6 mm off towards the other line is 0.6 mm off."""
    points = [[0, 0], [0.1, 0], [0, 8e-4]]
    commanded, operation = follow(points, 200)
    load = commanded.copy()
    load[20:60, 1] += 6e-4
    found = contour(points, load, operation, commanded=commanded)
    assert found.measured == pytest.approx(6e-4, abs=1e-12)


@pytest.mark.parametrize("axes", [("X", "Y"), ("Y", "X")])
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("beyond_m", [-4e-6, 0.0, 4e-6])
def test_a_fraction_of_a_count_beyond_a_retraced_line_hides_no_overshoot(
    axes, sign: float, beyond_m: float
) -> None:
    """100 mm forth and 40 mm back: the command rests within a count (17 um) of the end.

    Beyond the end the command lies on the way forth, too, which is nearer by 4 um. A load that
    overshoots by 0.2 mm is still off the path.
    """
    points = [[0, 0], [sign * 0.1, 0], [sign * 0.06, 0]]
    commanded, operation = follow(points, 50, standstill=60)
    commanded[100:, 0] -= sign * beyond_m
    load = commanded.copy()
    load[120:150, 0] = sign * (0.06 - 2e-4)
    found = contour(points, load, operation, commanded=commanded, axes=axes)
    assert found.measured == pytest.approx(2e-4, abs=1e-12)


def test_no_operation_after_the_end_means_the_last_one() -> None:
    """A controller that reports -1 once it is done still stands at its last operation."""
    points = [[0, 0], [0.1, 0], [0.1, 0.1]]
    commanded, operation = follow(points, 50)
    actual = commanded.copy()
    actual[110:, 0] += 4e-4  # after the end, off the second leg; 0.1 m from the first
    ended = np.where(np.arange(len(operation)) > 100, -1.0, operation)
    result = contour(points, actual, ended, spec=spec_of(*CONTOUR.criteria, lag_s=0.0))
    assert result.measured == pytest.approx(4e-4, abs=1e-12)
    assert result.job_line == 20


@pytest.mark.parametrize("vertices_per_block", [2, 1000])
def test_a_machine_that_stops_on_its_way_fails(vertices_per_block: int) -> None:
    """The end is 100 mm along a slanted line, and 44 mm are done; the rest is recorded or not.

    The machine stands there, in the same operation, for longer than the whole job takes.
    """
    points = [[0.006 * i, 0.008 * i] for i in range(11)]
    commanded, operation = follow(points, 10)
    stands = np.minimum(np.arange(150), 44)
    result = contour(
        points,
        commanded[stands],
        operation[stands],
        per_block=7,
        spec=spec_of(*CONTOUR.criteria, lag_s=0.0),
        vertices_per_block=vertices_per_block,
    )

    assert result.measured == pytest.approx(0.1 - 0.044, abs=1e-12)
    assert result.time_s == pytest.approx(149 * TICK_S)
    assert result.job_line == 100
    assert "before" in result.note


@pytest.mark.parametrize("vertices_per_block", [2, 1000])
def test_a_recording_that_ends_early_proves_nothing_of_the_rest(vertices_per_block: int) -> None:
    """Cut at 44 of 100 mm: the recorded part is on the path; a sample off the path still fails."""
    points = [[0.006 * i, 0.008 * i] for i in range(11)]
    commanded, operation = follow(points, 10)
    spec = spec_of(*CONTOUR.criteria, lag_s=0.0)
    more = {"per_block": 7, "spec": spec, "vertices_per_block": vertices_per_block}
    result = contour(points, commanded[:45], operation[:45], **more)
    assert (result.status, result.measured) == (Status.NOT_MEASURED, None)
    assert "X.load ends at 0.22 s, the motion at 0.5 s" in result.note

    off = commanded[:45].copy()
    off[20] += np.array([0.8e-3, -0.6e-3])
    result = contour(points, off, operation[:45], **more)
    assert result.status is Status.FAILED
    assert result.measured == pytest.approx(1e-3, abs=1e-12)
    assert "X.load ends at 0.22 s" in result.note


def test_a_segment_reaches_the_vertices_of_both_its_samples() -> None:
    """A cut across a right angle: half a diagonal from the corner, half-way in time."""
    vertices = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]])
    best, best_time_s = np.full((3, 1), np.inf), np.zeros((3, 1))
    vertices_to_path(
        Track(
            points=np.array([[[0.0], [0.0]], [[1.0], [1.0]]]),
            time_s=np.array([2.0, 4.0]),
            begin=np.array([1, 1]),
            end=np.array([1, 2]),
            first=0,
        ),
        NO_BOWS,
        NO_BOXES,
        vertices,
        (0, 0),
        None,
        np.full(1, -np.inf),
        Closest(best, best_time_s),
    )
    assert best == pytest.approx([0.0, 0.5, 0.0], abs=1e-15)
    assert best_time_s == pytest.approx([2.0, 3.0, 4.0])


@given(
    seed=st.integers(0, 2**32 - 1),
    moves=st.integers(1, 12),
    per_move=st.integers(1, 9),
    lag=st.integers(0, 7),
    per_block=st.integers(1, 40),
    per_vertex_block=st.integers(1, 5),
)
def test_random_polylines_against_brute_force(
    seed, moves, per_move, lag, per_block, per_vertex_block
) -> None:
    """Blocks of any size give the same as all chords against all samples."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.01, 0.01, size=(moves + 1, 2))
    commanded, operation = follow(points, per_move, standstill=int(rng.integers(0, 12)))
    actual = commanded + rng.normal(scale=1e-3, size=commanded.shape)
    result = contour(
        points,
        actual,
        operation,
        spec=spec_of(*CONTOUR.criteria, lag_s=lag * TICK_S),
        per_block=per_block,
        vertices_per_block=per_vertex_block,
    )
    again = contour(
        points,
        actual,
        operation,
        spec=spec_of(*CONTOUR.criteria, lag_s=lag * TICK_S),
        per_block=10**6,
    )

    least = brute_force(points, actual, operation, lag)
    between, step_m = brute_between(points, actual, operation, lag)
    assert result.measured >= max(least, between) - step_m - 1e-12, (points, actual)
    assert result.measured <= max(least, between + step_m) + 1e-12, (points, actual)
    if least > between + step_m:
        assert result.measured == pytest.approx(least, abs=1e-12), (points, actual)
    # A sample that waits at the end of a block gives the same but for the last digit of a sum.
    assert result.measured == pytest.approx(again.measured, abs=1e-12)
    assert (result.note, result.job_line) == (again.note, again.job_line)


def test_a_move_to_where_the_machine_is_needs_no_sample() -> None:
    """The first operation takes no time: the recording begins with the second one."""
    points = [[0.0, 0.0], [0.0, 0.0], [0.1, 0.0]]
    commanded, operation = follow(points[1:], 20)
    load = commanded + np.array([0.0, 1e-4])
    result = contour(points, load, operation + 1, commanded=commanded)
    assert result.measured == pytest.approx(1e-4, abs=1e-12)
