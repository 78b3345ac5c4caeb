"""Arc-length tables, compared with closed forms, elliptic integrals and dense sums."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import BSpline
from scipy.special import ellipeinc

from threadline.geometry.arclength import arc_table
from threadline.geometry.curves import (
    Pieces,
    bezier,
    bulges,
    chords,
    ellipse_arc,
    join_pieces,
    spline,
)

NEAR_M = 1e-11  # a table is good to 1e-12 m a span; a few dozen spans add up


def dense_length(pieces: Pieces, samples: int = 200_001) -> float:
    """Return an extrapolated sum of chords, without derivatives or quadrature."""
    total = 0.0
    for k in range(len(pieces)):
        lengths = []
        for n in (samples, 2 * samples - 1):
            points = pieces.evaluate(np.full(n, k), np.linspace(0, 1, n))[0]
            lengths.append(np.hypot(*np.diff(points, axis=0).T).sum())
        total += lengths[1] + (lengths[1] - lengths[0]) / 3.0
    return total


def test_circle_has_the_length_of_its_angle() -> None:
    table = arc_table(ellipse_arc(np.array([0.3, -0.1]), *(0.05 * np.eye(2)), 0.4, -4.0))

    assert table.length_m == pytest.approx(0.2, abs=NEAR_M)
    # Half-way along the length is half-way along the angle, clockwise.
    expected = [0.3 + 0.05 * np.cos(-1.6), -0.1 + 0.05 * np.sin(-1.6)]
    assert table.points(np.array([0.1]))[0] == pytest.approx(expected, abs=NEAR_M)
    assert table.curvature(np.array([0.1]))[0] == pytest.approx(-20.0, rel=1e-9)


@pytest.mark.parametrize(("a", "b"), [(0.1, 0.04), (0.1, 0.0999), (0.2, 0.002)])
def test_ellipse_against_the_elliptic_integral(a: float, b: float) -> None:
    """Length from the minor axis on is a E(phi | 1 - b^2/a^2), scipy's incomplete integral."""
    arc = ellipse_arc(np.zeros(2), np.array([0.0, b]), np.array([a, 0.0]), 0.0, 2.5)
    table = arc_table(arc)

    m = 1.0 - (b / a) ** 2
    assert table.length_m == pytest.approx(a * ellipeinc(2.5, m), abs=NEAR_M)
    phi = np.linspace(0.0, 2.5, 41)
    points = table.points(a * ellipeinc(phi, m))
    exact = np.column_stack([a * np.sin(phi), b * np.cos(phi)])
    assert np.abs(points - exact).max() < 1e-9


def test_parabola_against_its_closed_form() -> None:
    """y = x^2 / (4 f) as a Bezier curve; length from the vertex is in every handbook."""
    f, x = 0.02, 0.15
    control = np.array([[0.0, 0.0], [x / 2, 0.0], [x, x**2 / (4 * f)]])
    table = arc_table(bezier(control))

    def closed_form(at: np.ndarray) -> np.ndarray:
        h = at / 2.0
        q = np.sqrt(f**2 + h**2)
        return h * q / f + f * np.log((h + q) / f)

    assert table.length_m == pytest.approx(closed_form(np.array([x]))[0], abs=NEAR_M)
    at = np.linspace(0.0, x, 57)
    assert np.abs(table.points(closed_form(at))[:, 0] - at).max() < 1e-9


def test_cusp_is_measured_and_inverted() -> None:
    """x = t^2, y = t^3 has speed 0 at the cusp, where quadrature of fixed order fails."""
    # Power basis on t in [-1, 1], t = 2u - 1.
    pieces = bezier(np.array([[1, -1], [-1 / 3, 1], [-1 / 3, -1], [1, 1.0]]) * 0.01)
    table = arc_table(pieces)

    half = (13.0**1.5 - 8.0) / 27.0 * 0.01  # semicubical parabola, Neile 1657
    assert table.length_m == pytest.approx(2 * half, abs=NEAR_M)
    cusp = table.points(np.array([half]))[0]
    # Near a cusp a length s is a distance of about s along x; y is s^1.5.
    assert cusp == pytest.approx([0.0, 0.0], abs=1e-9)


@given(
    st.lists(
        st.tuples(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1)), min_size=4, max_size=4, unique=True
    )
)
def test_bezier_lengths_agree_with_dense_sums(control: list[tuple[float, float]]) -> None:
    """Any cubic, cusps and loops included, against a million chords (accurate to about 1e-9)."""
    pieces = bezier(np.array(control))
    table = arc_table(pieces)

    assert table.length_m == pytest.approx(dense_length(pieces, 20_001), abs=2e-7, rel=1e-6)


@given(st.floats(0.0, 1.0), st.integers(0, 10**6))
def test_inverse_is_the_inverse(share: float, seed: int) -> None:
    """The length measured up to the found point is the wanted length, within 1e-9 m."""
    control = np.random.default_rng(seed).uniform(-0.1, 0.1, (4, 2))
    table = arc_table(bezier(control))
    expected = share * table.length_m
    _, u = table.locate(np.array([expected]))
    n = 2 * int(20_000 * u[0]) + 3
    points = bezier(control).evaluate(np.zeros(n, dtype=np.int64), np.linspace(0, u[0], n))[0]
    again = np.hypot(*np.diff(points, axis=0).T).sum()
    # Half as many chords are four times as far off: Richardson removes the error.
    again += (again - np.hypot(*np.diff(points[::2], axis=0).T).sum()) / 3.0

    assert again == pytest.approx(expected, abs=1e-9)


def test_quarter_circle_as_rational_bezier() -> None:
    """The weight of the middle point that makes a circle is cos(45 degrees)."""
    control = np.array([[0.05, 0.0], [0.05, 0.05], [0.0, 0.05]])
    piece = bezier(control, np.array([1.0, np.sqrt(0.5), 1.0]))
    table = arc_table(piece)

    assert table.length_m == pytest.approx(0.05 * np.pi / 2, abs=NEAR_M)
    points = table.points(np.linspace(0, table.length_m, 33))
    assert np.abs(np.hypot(*points.T) - 0.05).max() < 1e-15
    assert table.curvature(np.array([0.03]))[0] == pytest.approx(20.0, rel=1e-9)


@pytest.mark.parametrize("degree", [1, 2, 3, 5])
def test_spline_spans_are_the_spline(degree: int) -> None:
    """Against scipy's own evaluation, with uneven and repeated knots."""
    rng = np.random.default_rng(degree)
    control = rng.uniform(-0.1, 0.1, (degree + 5, 2))
    inner = np.array([0.2, 0.2, 0.55, 0.9]) if degree > 1 else np.array([0.2, 0.3, 0.55, 0.9])
    knots = np.concatenate([np.zeros(degree + 1), inner, np.ones(degree + 1)])
    spans = spline(control, knots, degree)
    exact = BSpline(knots, control, degree)

    edges = np.unique(knots)
    assert len(spans) == len(edges) - 1
    u = np.linspace(0.0, 1.0, 17)
    for k, span in enumerate(spans):
        at = edges[k] + u * (edges[k + 1] - edges[k])
        at[-1] -= 1e-14
        found = span.evaluate(np.zeros(17, dtype=np.int64), u)[0]
        assert np.abs(found - exact(at)).max() < 1e-12


def test_unclamped_spline_covers_its_own_range_only() -> None:
    control = np.random.default_rng(3).uniform(-0.1, 0.1, (7, 2))
    knots = np.arange(11.0)
    spans = join_pieces(spline(control, knots, 3))
    exact = BSpline(knots, control, 3)

    first, last = spans.ends()
    assert len(spans) == 4
    assert np.abs(first - exact(np.arange(3.0, 7.0))).max() < 1e-12
    assert np.abs(last - exact(np.arange(4.0, 8.0) - 1e-13)).max() < 1e-10


def test_bulge_is_a_quarter_of_the_angle() -> None:
    """Bulge 1 is half a circle, to the right of the chord: the DXF convention."""
    pieces = bulges(np.array([[0.0, 0.0], [0.02, 0.0], [0.02, 0.01]]), np.array([1.0, 0.0]))
    table = arc_table(pieces)

    assert table.length_m == pytest.approx(np.pi * 0.01 + 0.01, abs=NEAR_M)
    assert table.points(np.array([np.pi * 0.005]))[0] == pytest.approx([0.01, -0.01], abs=1e-12)
    assert np.abs(np.diff([*pieces.ends()], axis=0)).max() > 0
    assert pieces.ends()[1] == pytest.approx(np.array([[0.02, 0.0], [0.02, 0.01]]), abs=1e-15)


@given(st.integers(0, 10**6))
def test_maps_and_reversal_keep_the_points(seed: int) -> None:
    """An affine map of the pieces is the map of their points; reversal is u -> 1 - u."""
    rng = np.random.default_rng(seed)
    parts = [
        bezier(rng.uniform(-1, 1, (5, 2)), rng.uniform(0.2, 2, 5), line=3),
        ellipse_arc(*rng.uniform(-1, 1, (3, 2)), 0.3, float(rng.uniform(-6, 6)), line=4),
        chords(rng.uniform(-1, 1, (3, 2)), np.array([5, 6])),
    ]
    pieces = join_pieces(parts)
    matrix, offset = rng.uniform(-1, 1, (2, 2)), rng.uniform(-1, 1, 2)
    index = np.repeat(np.arange(4), 9)
    u = np.tile(np.linspace(0, 1, 9), 4)
    points = pieces.evaluate(index, u)[0]

    mapped = pieces.transform(matrix, offset).evaluate(index, u)[0]
    assert np.abs(mapped - (points @ matrix.T + offset)).max() < 1e-13
    back = pieces.reverse()
    assert np.abs(back.evaluate(3 - index, 1 - u)[0] - points).max() < 1e-12
    assert back.line.tolist() == [6, 5, 4, 3]


def test_million_chords_are_measured_at_once() -> None:
    """A spiral of 10^6 chords; the inverse hits each vertex at the sum of the chords before."""
    angle = np.linspace(0, 400.0, 1_000_001)
    points = np.column_stack([angle * np.cos(angle), angle * np.sin(angle)]) * 1e-3
    table = arc_table(chords(points))
    summed = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])

    assert table.length_m == pytest.approx(summed[-1], rel=1e-11)
    some = np.arange(0, 1_000_001, 50_000)
    assert np.abs(table.points(summed[some]) - points[some]).max() < 1e-8


def test_direction_where_the_derivative_vanishes() -> None:
    """A Bezier curve that starts with a doubled control point still has a tangent."""
    piece = bezier(np.array([[0.0, 0.0], [0.0, 0.0], [1.0, 1.0], [2.0, 1.0]]))

    first, last = piece.end_directions()
    assert first[0] == pytest.approx([np.sqrt(0.5)] * 2, abs=1e-3)
    assert last[0] == pytest.approx([1.0, 0.0], abs=1e-12)
