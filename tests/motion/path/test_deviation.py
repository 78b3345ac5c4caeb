import numpy as np
import pytest

from threadline.files import Stream
from threadline.jobs.operations import Feed
from threadline.machine import load_machine
from threadline.motion.path import (
    PieceBlock,
    PlannedPath,
    Timing,
    path_deviation,
    plan_path,
    programmed_path,
)

from .builders import COUNTS, job_of, there_and_back

WINDER = load_machine("lathe-winder")
FEED = Feed(COUNTS, 10)


def programmed(points, axes):
    return programmed_path(job_of(points, axes, FEED), WINDER)


def path_of(coefficients, axes, operation, radius):
    c = np.array(coefficients, dtype=float)
    block = PieceBlock(
        coefficients=c,
        operation=np.array(operation),
        nominal_s=np.ones(len(c)),
        rest_after=np.zeros(len(c), dtype=np.int64),
        dwell_s=np.zeros(len(c)),
        line=np.array(operation) + 1,
    )
    return PlannedPath(
        axes=axes,
        radius_m=np.array(radius),
        interpolation="by hand",
        timing=Timing.TIME,
        historical=True,
        blocks=Stream.of([block]),
    )


def test_a_path_beside_the_chord_strays_by_the_distance():
    """A parabola that bulges 4 mm over a chord of 100 mm: 4 mm in the middle."""
    path = path_of([[[0, 0], [0.1, 0.016], [0, -0.016]]], ("X", "Y"), [0], [1.0, 1.0])
    found = path_deviation(programmed([[0, 0], [0.1, 0]], ("X", "Y")), path)
    assert found.at_tool_m == pytest.approx(0.004, rel=1e-9)
    assert not found.at_vertex
    assert found.position == pytest.approx([0.05, 0.004], abs=1e-6)
    assert found.per_axis == pytest.approx([0.0, 0.004], abs=1e-9)


def test_a_vertex_that_the_path_cuts_off_counts():
    """The straight way from the first to the last point misses the corner by 50 mm / sqrt 2."""
    path = path_of([[[0, 0], [0.05, 0.05]]], ("X", "Y"), [0], [1.0, 1.0])
    found = path_deviation(programmed([[0, 0], [0.05, 0], [0.05, 0.05]], ("X", "Y")), path)
    assert found.at_vertex
    assert found.at_tool_m == pytest.approx(0.05 / np.sqrt(2), rel=1e-9)
    assert (found.line, found.operation) == (1, 0)


def test_rotary_axes_act_at_the_tool_radius():
    """0.02 rad at 100 mm are 2 mm; the difference of the axis itself stays in rad."""
    path = path_of([[[0, 0], [0.08, 0.1], [-0.08, 0]]], ("A", "X"), [0], [0.1, 1.0])
    found = path_deviation(programmed([[0, 0], [0, 0.1]], ("A", "X")), path)
    assert found.at_tool_m == pytest.approx(0.002, rel=1e-9)
    assert found.per_axis[0] == pytest.approx(0.02, rel=1e-9)


def test_only_moves_near_in_order_are_looked_at():
    """A path on the way back is not near the way forth, although they coincide."""
    points = [[0.0, 0.0], [0.1, 0.0], [0.1, 0.1], [0.2, 0.1], [0.2, 0.2], [0.0, 0.2], [0.0, 0.0]]
    wrong = path_of([[[0.05, 0.0], [0.0, 0.0]]], ("X", "Y"), [5], [1.0, 1.0])
    found = path_deviation(programmed(points, ("X", "Y")), wrong)
    # Point (50, 0) lies on the first chord; the last ones pass it at 50 mm.
    assert found.at_tool_m >= 0.05 - 1e-12


def test_plain_spline_misses_the_reversal_as_printed():
    """8.6 mm at the turning point of the thesis' test, and on which line."""
    line = programmed(there_and_back(), ("X",))
    found = path_deviation(line, plan_path(line, WINDER, "b-spline"))
    assert found.at_tool_m == pytest.approx(0.18 / 7 / 3, rel=1e-9)
    assert found.at_vertex and found.line == 7
    pulled = path_deviation(line, plan_path(line, WINDER, "b-spline-pulled"))
    assert pulled.at_tool_m < 1e-8


def test_linear_has_none_over_many_blocks():
    way = 0.2 * np.sin(np.linspace(0, 60, 10_001))
    line = programmed([[x] for x in way], ("X",))
    assert path_deviation(line, plan_path(line, WINDER, "linear")).at_tool_m < 1e-15


def to_chords(points, vertices):
    """Return (n,) distances of points to the nearest of all chords."""
    begin, way = vertices[:-1], np.diff(vertices, axis=0)
    squared = np.maximum((way**2).sum(axis=1), 1e-300)
    part = np.clip(((points[:, None] - begin) * way).sum(axis=2) / squared, 0.0, 1.0)
    return np.linalg.norm(points[:, None] - begin - part[..., None] * way, axis=2).min(axis=1)


@pytest.mark.parametrize("name", ["auto", "parabolic", "cubic", "quintic"])
def test_random_polylines_against_dense_samples(name):
    """Both ways: 801 places of each piece to the chords, and each vertex to all those places.

    A place halfway between two samples is nearer by at most a length of s^2 / 8 times a curvature:
    1e-7 m on these pieces. Near in order is never nearer than nearest of all.
    """
    rng = np.random.default_rng(400)
    u = np.linspace(0.0, 1.0, 801)[:, None]
    for case in range(15):
        points = np.cumsum(rng.normal(size=(int(rng.integers(3, 9)), 2)), axis=0)
        points -= points[0]
        points *= 0.03 * 10 ** rng.uniform(-1.5, 0.0) / np.abs(points).max()
        line = programmed(points.tolist(), ("X", "Y"))
        path = plan_path(line, WINDER, name)
        found = path_deviation(line, path)
        places = np.concatenate(
            [u ** np.arange(len(c)) @ c for block in path for c in block.coefficients]
        )
        vertices = np.concatenate([block.positions for block in line.blocks])
        away = max(to_chords(places, vertices).max(), to_chords(vertices, places).max())
        assert found.at_tool_m == pytest.approx(away, abs=1e-7), (case, points)
