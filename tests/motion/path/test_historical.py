import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import BSpline

from threadline.errors import OptionError
from threadline.jobs.operations import Dwell, Feed, Source
from threadline.machine import load_machine
from threadline.motion.path import plan_path, programmed_path
from threadline.motion.timing import plan_trajectory

from .builders import COUNTS, job_of, there_and_back

WINDER = load_machine("lathe-winder")
COUNT_M = 1 / 55_358
TICK_S = 0.005


def planned(points, name, feed=10.0, axes=("X",), extra=None):
    job = job_of(points, axes, Feed(COUNTS, feed), extra=extra)
    path = plan_path(programmed_path(job, WINDER, Feed(COUNTS, feed)), WINDER, name)
    return path, plan_trajectory(path, WINDER)


def pieces(path):
    return np.concatenate([block.coefficients for block in path])


def test_linear_takes_whole_ticks_and_never_exceeds_the_feed():
    """10 000 counts at 10 per tick are 1000 ticks; 25.3 ticks become 26."""
    _, exact = planned([[0.0], [10_000 * COUNT_M]], "linear")
    assert exact.duration_s == pytest.approx(1000 * TICK_S, rel=1e-12)
    _, odd = planned([[0.0], [253 * COUNT_M]], "linear")
    assert odd.duration_s == pytest.approx(26 * TICK_S, rel=1e-12)
    middle = odd(np.array([13 * TICK_S]), 1)[0, 0]
    assert middle == pytest.approx(253 * COUNT_M / (26 * TICK_S), rel=1e-12)


def test_linear_axes_arrive_together():
    _, trajectory = planned([[0, 0], [0.1, 0.03], [0.1, -0.02]], "linear", axes=("X", "Y"))
    at = trajectory(np.linspace(0, trajectory.duration_s, 200))
    # On the first chord Y is 0.3 X, on the second X stands still.
    first = at[:, 0] < 0.1 - 1e-12
    assert at[first, 1] == pytest.approx(0.3 * at[first, 0], abs=1e-12)
    assert at[-1] == pytest.approx([0.1, -0.02], abs=1e-12)


def test_point_to_point_rests_at_each_point_and_peaks_at_the_feed():
    path, trajectory = planned([[0.0], [0.05], [0.08]], "point-to-point", feed=40)
    bounds = np.concatenate([block.start_s for block in trajectory])
    assert trajectory(bounds, 1) == pytest.approx(0.0, abs=1e-12)
    peak = np.abs(trajectory(np.linspace(0, trajectory.duration_s, 20_001), 1)).max()
    assert peak == pytest.approx(40 * COUNT_M / TICK_S, rel=1e-6)
    assert path.historical


@given(
    st.lists(st.tuples(*[st.floats(-0.04, 0.1)] * 2, st.floats(-6.0, 6.0)), min_size=4, max_size=30)
)
def test_b_spline_agrees_with_scipy(points):
    """Uniform knots, tripled ends: scipy's de Boor evaluation, to 1e-12 of the coordinates."""
    path, _ = planned([[0, 0, 0], *points], "b-spline", axes=("X", "Y", "A"))
    control = np.array([[0.0, 0, 0], *points])
    padded = np.concatenate([control[[0, 0]], control, control[[-1, -1]]])
    reference = BSpline(np.arange(len(padded) + 4.0), padded, 3)
    got = pieces(path)
    assert len(got) == len(padded) - 3
    for u in (0.0, 0.3, 1.0):
        ours = sum(got[:, k] * u**k for k in range(4))
        expected = reference(3 + np.arange(len(got)) + u * (1 - 1e-16))
        assert ours == pytest.approx(expected, abs=1e-12 * 6.0 * 4)


def test_corner_is_missed_by_a_sixth_of_the_second_difference():
    """Closed form: at a point the spline is off by |P0 - 2 P1 + P2| / 6."""
    points = np.array([[0, 0], [0.03, 0.01], [0.05, 0.06], [0.11, 0.05], [0.12, 0.0]])
    path, _ = planned(points.tolist(), "b-spline", axes=("X", "Y"))
    starts = pieces(path)[:, 0]  # the curve at every knot; the first two are the start and its copy
    for i in (1, 2, 3):
        miss = np.abs(points[i - 1] - 2 * points[i] + points[i + 1]) / 6
        assert np.abs(starts[i + 1] - points[i]) == pytest.approx(miss, rel=1e-12)


def test_reversal_is_missed_by_8_6_mm_unless_pulled():
    """X 0 -> 180 -> 0 with 8 points each way: 2 * (180 / 7) / 6 mm short; pulled: none."""
    _, plain = planned(there_and_back(), "b-spline", feed=80)
    _, pulled = planned(there_and_back(), "b-spline-pulled", feed=80)
    times = np.linspace(0, pulled.duration_s, 100_001)
    assert 0.18 - plain(times).max() == pytest.approx(0.18 / 7 / 3, rel=1e-6)
    assert round(1e3 * (0.18 - plain(times).max()), 1) == 8.6
    assert pulled(times).max() == pytest.approx(0.18, abs=1e-9)


@pytest.mark.parametrize("name", ["b-spline", "b-spline-pulled"])
def test_knot_intervals_last_equally_and_the_fastest_meets_the_feed(name):
    points = [[0.0], [0.02], [0.05], [0.08], [0.11], [0.12], [0.1]]
    path, trajectory = planned(points, name, feed=20)
    durations = np.concatenate([block.duration_s for block in trajectory])
    assert np.ptp(durations) < 1e-15
    times = np.linspace(0, trajectory.duration_s, 200_001)
    assert np.abs(trajectory(times, 1)).max() == pytest.approx(20 * COUNT_M / TICK_S, rel=1e-6)
    assert path.summary["interval_s"] == pytest.approx(durations[0])


def test_stop_and_dwell_within_a_spline():
    """The vertex before a dwell is met at rest and held; operations follow the moves."""
    dwell = {2: Dwell(0.75, Source("job.prg", 2))}
    points = [[0.0], [0.02], [0.05], [0.08], [0.11]]
    path, trajectory = planned(points, "b-spline", extra=dwell)
    durations = np.concatenate([block.duration_s for block in trajectory])
    held = int(np.flatnonzero(np.isclose(durations, 0.75))[0])
    begin = durations[:held].sum()
    assert trajectory(np.array([begin, begin + 0.7])) == pytest.approx(0.05, abs=1e-12)
    for derivative in (1, 2):
        assert trajectory(np.array([begin, begin + 0.75]), derivative) == pytest.approx(0, abs=1e-9)
    operation = np.concatenate([block.operation for block in trajectory])
    assert np.all(np.diff(operation) >= 0)
    assert set(operation) == {0, 1, 3, 4}
    assert operation[held] == 1
    assert sum(int(block.rest_after.sum()) for block in path) == 2


def test_streaming_gives_the_same_spline_whatever_the_block():
    """A job of 10 000 moves crosses two seams: every knot is C2."""
    way = 0.2 * np.sin(np.linspace(0, 60, 10_001))
    path, _ = planned([[x] for x in way], "b-spline")
    got = pieces(path)
    assert len(got) == 10_001 + 4 - 3
    ends = got.sum(axis=1)[:-1]
    slopes = (got * np.arange(4)[None, :, None]).sum(axis=1)[:-1]
    bends = (got * (np.arange(4) * (np.arange(4) - 1))[None, :, None]).sum(axis=1)[:-1]
    assert ends == pytest.approx(got[1:, 0], abs=1e-14)
    assert slopes == pytest.approx(got[1:, 1], abs=1e-14)
    assert bends == pytest.approx(2 * got[1:, 2], abs=1e-14)


def test_unknown_interpolation_names_the_nearest():
    job = job_of([[0], [0.1]], ("X",), Feed(COUNTS, 10))
    with pytest.raises(OptionError, match="b-spline"):
        plan_path(programmed_path(job, WINDER), WINDER, "bspline")
