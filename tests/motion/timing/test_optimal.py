"""The fastest motion, compared with closed forms, with every limit, and with ``auto``."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.motion.path.builders import job_of, polylines
from tests.motion.timing.builders import without_drives
from threadline.jobs.operations import Dwell, Feed, FeedMode, Source
from threadline.machine import load_machine
from threadline.motion.laws import shortest_move
from threadline.motion.path import interpolations, path_deviation, plan_path, programmed_path
from threadline.motion.timing import limit_peaks, plan_trajectory
from threadline.motion.timing.optimal import barrier, fastest_motion, in_time, solve
from threadline.motion.timing.optimal.elements import RunPieces, elements_of
from threadline.motion.timing.optimal.motion_limits import Limits
from threadline.motion.timing.optimal.solve import fastest

AS_BUILT = load_machine("lathe-winder")
WINDER = without_drives(AS_BUILT)
"""Its axes alone: what its drives can give has tests of its own."""
RAPID = Feed(FeedMode.RAPID, 0.0)


def straight(length, velocity, acceleration, jerk, gap=1e-4):
    c = np.zeros((1, 4, 1))
    c[0, 1, 0] = length
    elements = elements_of(
        RunPieces(c, np.zeros(0), np.zeros(1), np.zeros(1, int), 1.0), from_rest=True, to_rest=True
    )
    limits = Limits(
        velocity=np.array([velocity]), acceleration=np.array([acceleration]), jerk=np.array([jerk])
    )
    return fastest(elements, limits, gap), limits


@pytest.mark.parametrize(
    ("length", "velocity", "acceleration", "jerk", "printed_s"),
    [
        (1.0, 1.0, 5.0, 50.0, 1.3),  # reaches velocity and acceleration
        (0.05, 1.0, 5.0, 50.0, 0.31748),  # jerk alone
        (0.4, 1.0, 5.0, 50.0, None),  # jerk and acceleration
        (1.0, 0.2, 5.0, 10.0, None),  # jerk and velocity
    ],
)
def test_rest_to_rest_takes_the_time_of_the_closed_form(
    length, velocity, acceleration, jerk, printed_s
):
    """Never below the least time, and within 0.5 % of it, the loss of the finest elements."""
    least_s = shortest_move(length, velocity, acceleration, jerk).duration_s
    if printed_s is not None:
        assert least_s == pytest.approx(printed_s, abs=6e-6)
    solution, limits = straight(length, velocity, acceleration, jerk)
    motion = in_time.in_time(solution, limits)
    assert least_s * (1 - 1e-9) <= motion.end_s <= least_s * 1.005
    assert motion.evaluate(np.array([0.0, motion.end_s])) == pytest.approx(
        np.array([[0.0], [length]])
    )


def test_finer_elements_come_nearer_to_the_least_time(monkeypatch):
    """The order: with a quarter of the loss per element about half of the whole loss is left.

    The loss of an element is proportional to the square of its length, and their number to its
    inverse.
    """
    least_s = 1.3
    lost = []
    for share in (8e-3, 2e-3, 5e-4):
        monkeypatch.setattr("threadline.motion.timing.optimal.solve.LOSS", share)
        monkeypatch.setattr("threadline.motion.timing.optimal.solve.IDLE_ROUNDS", 9)
        lost.append(straight(1.0, 1.0, 5.0, 50.0, 1e-5)[0].duration_s - least_s)
    assert 0 < lost[1] < 0.6 * lost[0] and 0 < lost[2] < 0.6 * lost[1]


def test_units_change_nothing():
    """Metres or micrometres, and another unit of time: the same number in the other unit."""
    here = straight(0.3, 0.8, 5.0, 70.0)[0].duration_s
    tiny = straight(0.3e6, 0.8e6, 5.0e6, 70.0e6)[0].duration_s
    slow = straight(0.3, 0.8e-3, 5.0e-6, 70.0e-9)[0].duration_s
    assert tiny == pytest.approx(here, rel=1e-6) and slow == pytest.approx(1e3 * here, rel=1e-6)


def plan(axes, points, tolerance_m=1e-4, interpolation="optimal", machine=WINDER, **given):
    programmed = programmed_path(job_of(points, axes, RAPID, **given), machine)
    path = plan_path(programmed, machine, interpolation, tolerance_m)
    return programmed, path, plan_trajectory(path, machine)


@settings(max_examples=25, deadline=None)
@given(polylines(), st.sampled_from([1e-3, 1e-4, 1e-5]))
def test_no_limit_is_left_anywhere_and_auto_is_never_faster(line, tolerance_m):
    """Exact extremes of every piece and joint; half a percent is the loss of the elements."""
    axes, points = line
    _, path, trajectory = plan(axes, points, tolerance_m)
    if trajectory.duration_s == 0.0:
        return
    for peak in limit_peaks(trajectory, WINDER):
        assert peak.ratio <= 1.001, peak
    assert path.historical is False
    _, _, auto = plan(axes, points, tolerance_m, "auto")
    assert trajectory.duration_s <= 1.005 * auto.duration_s


@pytest.mark.long(shown_by="test_no_limit_is_left_anywhere_and_auto_is_never_faster")
def test_a_million_random_instants_are_within_the_limits_and_the_tolerance():
    """A noisy spiral with corners, reversals and points as close as micrometres."""
    random = np.random.default_rng(5)
    turn = np.linspace(0.0, 15.0, 150)
    points = np.stack([0.2 * turn, 0.1 * np.sin(turn), 0.05 + 0.04 * np.cos(3 * turn)], axis=1)
    points[:, 1:] += random.normal(scale=2e-4, size=(150, 2))
    points[100:110] = points[100] + 1e-6 * np.arange(10)[:, None]
    programmed, path, trajectory = plan(("A", "X", "Y"), points.tolist())
    times = random.uniform(0.0, trajectory.duration_s, 1_000_000)
    column = [WINDER.axis_names.index(axis) for axis in ("A", "X", "Y")]
    for order, limit in enumerate(
        (WINDER.velocity_limit, WINDER.acceleration_limit, WINDER.jerk_limit), start=1
    ):
        assert (np.abs(trajectory(times, order)).max(axis=0) <= 1.001 * limit[column]).all()
    # The motion stays on the path: the path itself is within the tolerance by its own tests.
    assert path_deviation(programmed, path).at_tool_m <= 1e-4
    places = trajectory(np.sort(times[:2000])) * programmed.radius_m
    pieces = np.concatenate([block.coefficients for block in path])
    u = np.linspace(0.0, 1.0, 33)[:, None] ** np.arange(pieces.shape[1])
    line = (np.einsum("uk,nka->nua", u, pieces) * programmed.radius_m).reshape(-1, 3)
    a, b = line[:-1], line[1:]
    d = b - a
    square = np.maximum((d * d).sum(axis=1), 1e-30)
    for place in places[::20]:
        t = np.clip(((place - a) * d).sum(axis=1) / square, 0.0, 1.0)
        assert np.linalg.norm(place - a - t[:, None] * d, axis=1).min() < 2e-6


def test_optimal_motion_rests_with_the_program_and_ends_without_acceleration():
    dwell = Dwell(0.25, Source("job.prg", 2))
    points = [[0.0, 0.0], [0.1, 0.05], [0.2, 0.0]]
    _, _, with_dwell = plan(("X", "Y"), points, extra={1: dwell})
    _, _, without = plan(("X", "Y"), points)
    # A stop at the corner costs time in addition to the dwell.
    assert with_dwell.duration_s > without.duration_s + 0.25
    still = [b for b in with_dwell if not b.coefficients[:, 1:].any()]
    assert len(still) == 1 and still[0].duration_s.sum() == pytest.approx(0.25)
    ends = np.array([0.0, float(still[0].start_s[0]), still[0].end_s, with_dwell.duration_s])
    for order, limit in ((1, WINDER.velocity_limit[1]), (2, WINDER.acceleration_limit[1])):
        assert np.abs(with_dwell(ends, order)).max() < 1e-6 * limit


def test_no_faster_than_the_feed():
    """Each chord of a program with feeds takes at least its programmed time."""
    feed = Feed(FeedMode.FASTEST_AXIS, 0.02)
    programmed = programmed_path(
        job_of([[0.0, 0.0], [0.1, 0.03], [0.2, 0.0]], ("X", "Y"), feed), WINDER
    )
    trajectory = plan_trajectory(plan_path(programmed, WINDER, "optimal", 1e-4), WINDER)
    times = np.linspace(0.0, trajectory.duration_s, 20_001)
    speed = np.abs(trajectory(times, 1)).max(axis=1)
    assert 0.01999 < speed.max() <= 0.02 * 1.0001


def test_a_run_whose_loads_follow_rests_after_as_many_pieces_as_are_solved_together(monkeypatch):
    """Loads remember their past, so such a run has no windows; their errors are left out here."""

    def alone(elements, limits, _follower, _past, begin_s):
        return in_time.in_time(fastest(elements, limits), limits, begin_s)

    monkeypatch.setattr(fastest_motion, "followed", alone)
    points = [[0.0, 0.0], [0.1, 0.0], [0.1, 0.05], [0.05, 0.08]]
    programmed = programmed_path(job_of(points, ("X", "Y"), RAPID), AS_BUILT)
    path = plan_path(programmed, AS_BUILT, "optimal", 1e-4)
    monkeypatch.setattr(fastest_motion, "MOST_FOLLOWED", sum(map(len, path)) // 2 + 1)
    before, after = plan_trajectory(path, AS_BUILT, contour_m=1e-3)
    np.testing.assert_allclose(before.evaluate(np.array([before.end_s]), 1), 0.0, atol=1e-9)
    np.testing.assert_allclose(after.evaluate(after.start_s[:1], 1), 0.0, atol=1e-9)


def test_a_machine_without_a_jerk_limit_has_the_shorter_time():
    _, _, limited = plan(("X",), [[0.0], [0.1]])
    x = replace(WINDER.axes["X"], jerk=replace(WINDER.axes["X"].jerk, si=np.inf))
    free = replace(WINDER, axes={**WINDER.axes, "X": x})
    _, _, unlimited = plan(("X",), [[0.0], [0.1]], machine=free)
    least_s = shortest_move(0.1, 1.0, 10.5).duration_s
    assert least_s <= unlimited.duration_s < min(limited.duration_s, 1.004 * least_s)


@pytest.mark.parametrize(
    "points",
    [
        [[0.0], [-0.20236047037544277], [-0.202360473359537], [-0.22595974035623867]],
        [[0.0], [0.2], [0.2 + 1e-9], [0.2 - 1e-9], [0.3]],
    ],
)
def test_moves_of_nanometres_neither_stop_it_nor_break_a_limit(points):
    _, _, trajectory = plan(("X",), points, 1e-5)
    assert max(peak.ratio for peak in limit_peaks(trajectory, WINDER)) <= 1.001
    _, _, auto = plan(("X",), points, 1e-5, "auto")
    assert trajectory.duration_s <= 1.005 * auto.duration_s


def test_a_chord_of_nanometres_before_the_end_leaves_no_jump(monkeypatch):
    """The vertex before it is kept here; with a metre's tolerance it is left out elsewhere."""
    monkeypatch.setattr(interpolations, "NEAR_SHARE", 1e-9)
    points = [[0.0, 0.0], [-0.078, 0.0105], [-0.0309, -0.03], [-0.1051, -0.03]]
    points.append([points[-1][0] - 2.5e-8, points[-1][1] - 1.08e-8])
    _, path, trajectory = plan(("X", "Y"), points, 1.0)
    assert max(peak.ratio for peak in limit_peaks(trajectory, WINDER)) <= 1.001
    assert trajectory(trajectory.duration_s)[0] == pytest.approx(points[-1], abs=1e-15)
    last = np.concatenate([block.coefficients for block in path])[-1, 1:]
    assert 0.0 < np.abs(last).max() < 3e-8  # the path has that chord indeed


@pytest.mark.parametrize("speed", [0.004, 0.03])
def test_a_feed_far_below_the_limits_is_reached_at_once(speed):
    """Two chords at a feed: their length at the feed, and less than two ramps.

    With a corner they are no single line. Once the lead-ins took a second at a low feed.
    """
    feed = Feed(FeedMode.FASTEST_AXIS, speed)
    programmed = programmed_path(
        job_of([[0.0, 0.0], [0.2, 0.0], [0.4, 0.04]], ("X", "Y"), feed), WINDER
    )
    trajectory = plan_trajectory(plan_path(programmed, WINDER, "optimal", 1e-4), WINDER)
    ramp_s = shortest_move(10.0, speed, 10.5, 2100.0).duration_s - 10.0 / speed
    assert 0.4 / speed <= trajectory.duration_s <= (0.4 / speed + ramp_s) * 1.001 + ramp_s


def test_a_dense_run_has_as_many_elements_as_pieces_and_loses_little(monkeypatch):
    """Two elements a piece and one: both within the limits, and within half a percent."""
    turn = np.linspace(0.0, 9.0, 300)
    points = np.stack([0.1 * np.sin(turn), 0.05 - 0.05 * np.cos(1.3 * turn)], axis=1).tolist()
    found = []
    for order in (0, 5):  # share of pieces for which one element is enough
        monkeypatch.setattr("threadline.motion.timing.optimal.elements.OF_QUARTIC", order)
        trajectory = plan(("X", "Y"), points)[2]
        found.append((sum(map(len, trajectory)), trajectory.duration_s))
        assert max(peak.ratio for peak in limit_peaks(trajectory, WINDER)) <= 1.001
    (fine, fine_s), (coarse, coarse_s) = found
    assert coarse < 0.9 * fine
    assert coarse_s == pytest.approx(fine_s, rel=5e-3)


def test_motion_is_slowed_if_no_cut_keeps_a_limit(monkeypatch):
    """The elements are so long that their polynomials in time exceed limits that no cut mends."""
    points = [[0.0, 0.0], [0.1, 0.05], [0.2, 0.0], [0.1, 0.1]]
    cut_s = plan(("X", "Y"), points)[2].duration_s
    monkeypatch.setattr(in_time, "CUTS", 0)
    monkeypatch.setattr("threadline.motion.timing.optimal.solve.VARIED", 30.0)
    monkeypatch.setattr("threadline.motion.timing.optimal.solve.IDLE_ROUNDS", 0)
    _, _, coarse = plan(("X", "Y"), points)
    ratio = max(peak.ratio for peak in limit_peaks(coarse, WINDER))
    assert 0.5 < ratio <= 1.0 + 1e-9  # the bound that slows it lies somewhat above the extremes
    assert coarse.duration_s > cut_s
    own = in_time.as_it_is
    monkeypatch.setattr(fastest_motion, "in_time", lambda *motion: own(*motion, np.inf))
    _, _, unmended = plan(("X", "Y"), points)
    assert max(peak.ratio for peak in limit_peaks(unmended, WINDER)) > 1.001


def test_a_step_is_never_taken_backwards():
    """At 1 + 2e-16 of a limit the room over a change of 1e-20 would be a share of -1e4: b stays."""
    elements = elements_of(
        RunPieces(
            np.array([[[0.0], [1.0], [0.0], [0.0]]]),
            np.zeros(0),
            np.zeros(1),
            np.zeros(1, int),
            1.0,
        ),
        from_rest=True,
        to_rest=True,
    )
    limits = Limits(velocity=np.ones(1), acceleration=np.full(1, 5.0), jerk=np.full(1, np.inf))
    problem = solve.Problem(elements, limits)
    y = solve.bernstein(problem.b, elements.length)
    top = problem.rows[4]
    at = np.argmax(y.max(axis=1) / top)
    top[at] = np.nextafter(y[at].max(), 0.0)
    before = problem.b.copy()

    share = barrier.advance(
        problem.b, 1e-20 * before, elements.length, problem.rows, problem.tangent
    )

    assert share <= 0.0
    np.testing.assert_array_equal(problem.b, before)
