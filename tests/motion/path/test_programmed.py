import numpy as np
import pytest

from threadline.errors import LimitError, PlanError
from threadline.jobs.operations import Dwell, Feed, FeedMode, SetOutput, Source
from threadline.machine import load_machine
from threadline.motion.path import programmed_path

from .builders import COUNTS, job_of

WINDER = load_machine("lathe-winder")
TICK_S = 0.005


def vertices(path, name):
    return np.concatenate([getattr(block, name) for block in path])


def nominal(points, axes, programmed, **given):
    return vertices(programmed_path(job_of(points, axes, programmed), WINDER, **given), "nominal_s")


def test_counts_per_tick_of_the_fastest_axis():
    """Each move takes the largest displacement in counts / feed, in ticks of 5 ms."""
    points = [[0, 0], [1.0, 0.01], [1.0, 0.11]]  # A in rad, X in m
    got = nominal(points, ("A", "X"), Feed(COUNTS, 10.0))
    a_counts = np.degrees(1.0) * 35.18159
    assert got == pytest.approx([0, a_counts / 10 * TICK_S, 100 * 55.358 / 10 * TICK_S], rel=1e-12)


@pytest.mark.parametrize(
    ("mode", "value", "base", "seconds"),
    [
        (FeedMode.FASTEST_AXIS, 0.02, (), 0.1 / 0.02),  # A: 1 rad at 0.1 m
        (FeedMode.PATH, 0.02, (), 0.05 / 0.02),  # X 30 mm and Y 40 mm
        (FeedMode.BASE_AXES, 0.02, ("A",), 0.1 / 0.02),
        (FeedMode.BASE_AXES, 0.02, ("A", "X"), np.hypot(0.1, 0.03) / 0.02),
        (FeedMode.INVERSE_TIME, 0.25, (), 4.0),
        (FeedMode.RAPID, 0.0, (), 0.0),
    ],
)
def test_meaning_of_each_feed(mode, value, base, seconds):
    feed = Feed(mode, value, base)
    points = [[0, 0, 0], [1.0, 0.03, 0.04], [1.0, 0.03, 0.04]]
    got = nominal(points, ("A", "X", "Y"), feed if mode is FeedMode.RAPID else None, feed=feed)
    assert got == pytest.approx([0.0, seconds, 0.0], rel=1e-12)


def test_feed_whose_axes_rest_takes_the_whole_length():
    """A mandrel turn under a path feed, and a carriage move under a mandrel feed, still end."""
    points = [[0, 0], [1.0, 0.0], [1.0, 0.03]]
    path = nominal(points, ("A", "X"), None, feed=Feed(FeedMode.PATH, 0.01))
    base = nominal(points, ("A", "X"), None, feed=Feed(FeedMode.BASE_AXES, 0.01, ("A",)))
    assert path == pytest.approx([0, 10.0, 3.0])
    assert base == pytest.approx([0, 10.0, 3.0])


def test_operator_caps_the_programmed_feed_but_not_the_given_one():
    points = [[0.0], [0.1], [0.2]]
    fast = Feed(FeedMode.FASTEST_AXIS, 0.2)
    programmed = programmed_path(job_of(points, ("X",), fast), WINDER)
    normal_s = 0.1 * 55358 / 10 * TICK_S
    assert vertices(programmed, "nominal_s") == pytest.approx([0, normal_s, normal_s])
    assert sum(block.slowed for block in programmed) == 2
    assert nominal(points, ("X",), fast, feed=fast) == pytest.approx([0, 0.5, 0.5])
    assert nominal(points, ("X",), None) == pytest.approx([0, normal_s, normal_s])


def test_rests_and_dwells_belong_to_the_vertex_before():
    here = Source("job.prg", 9)
    job = job_of(
        [[0], [0.1], [0.2], [0.3]],
        ("X",),
        Feed(COUNTS, 10),
        extra={1: Dwell(0.5, here), 2: SetOutput("trim", 1.0, here)},
    )
    path = programmed_path(job, WINDER)
    assert vertices(path, "rest").tolist() == [1, 1, 1, 1]
    assert vertices(path, "dwell_s").tolist() == [0, 0.5, 0, 0]
    assert vertices(path, "operation").tolist() == [0, 0, 2, 4]
    assert vertices(path, "line").tolist() == [0, 1, 2, 3]


def test_moves_outside_travel_are_refused_with_axis_value_limit_and_line():
    job = job_of([[0], [0.4], [0.51]], ("X",), Feed(COUNTS, 10))
    with pytest.raises(LimitError, match=r"job\.prg:2.*axis X.*510 mm.*500 mm") as caught:
        list(programmed_path(job, WINDER))
    assert (caught.value.axis, caught.value.limit_si) == ("X", 0.5)


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_feed_must_be_greater_than_zero(value):
    job = job_of([[0], [0.1]], ("X",), Feed(COUNTS, value))
    with pytest.raises(PlanError, match=r"job\.prg:1.*feed"):
        list(programmed_path(job, WINDER))


def test_unknown_axis_is_named():
    with pytest.raises(PlanError, match="axis Z"):
        programmed_path(job_of([[0], [1]], ("Z",), None), WINDER)


def test_blocks_join_without_seam():
    """20 000 moves: blocks are bounded, and every chord counts once."""
    points = np.cumsum(np.full((20_001, 1), 1e-5), axis=0) - 1e-5
    path = programmed_path(job_of(points.tolist(), ("X",), Feed(COUNTS, 10)), WINDER)
    assert max(len(block) for block in path) <= 4097
    assert np.array_equal(vertices(path, "positions"), points)
    assert vertices(path, "nominal_s").sum() == pytest.approx(0.2 * 55358 / 10 * TICK_S)
