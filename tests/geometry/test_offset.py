"""Seam allowances against closed forms: Steiner's formula, circles, rectangles, parallels."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from threadline.errors import JobError
from threadline.geometry.arclength import arc_table
from threadline.geometry.contours import Contour
from threadline.geometry.curves import bezier, bulges, chords, ellipse_arc
from threadline.geometry.offset import Allowance, offset_contour
from threadline.geometry.self_crossing import crossings, flatten

NEAR_M = 2e-6  # curves are offset as chords within 1 um


def allowance(distance_m: float, side: str = "outside", join: str = "round") -> Allowance:
    return Allowance(distance_m, side, join)


def polygon(points: list[tuple[float, float]]) -> Contour:
    return Contour(pieces=chords(np.array([*points, points[0]])), closed=True)


def length_m(contour: Contour) -> float:
    return arc_table(contour.pieces).length_m


def area_m2(contour: Contour) -> float:
    x, y = contour.pieces.ends()[0].T
    return abs(float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum())) / 2.0


def hull(seed: int, count: int = 12) -> list[tuple[float, float]]:
    angle = np.sort(np.random.default_rng(seed).uniform(0, 2 * np.pi, count))
    return [(0.05 * np.cos(a), 0.03 * np.sin(a)) for a in angle]


@given(st.integers(0, 10**6), st.floats(1e-4, 0.05))
def test_outside_of_a_convex_polygon_obeys_steiner(seed: int, distance: float) -> None:
    """The parallel body has P + 2 pi d around and A + P d + pi d^2 within (Steiner 1840)."""
    body = polygon(hull(seed))
    (outer,) = offset_contour(body, allowance(distance), "test")

    around, within = length_m(body), area_m2(body)
    assert length_m(outer) == pytest.approx(around + 2 * np.pi * distance, abs=1e-5)
    assert area_m2(outer) == pytest.approx(
        within + around * distance + np.pi * distance**2, rel=1e-4
    )


@pytest.mark.parametrize(("side", "radius"), [("outside", 0.05), ("inside", 0.03)])
def test_circle_becomes_a_circle(side: str, radius: float) -> None:
    ring = ellipse_arc(np.array([0.1, 0.0]), *(0.04 * np.eye(2)), 1.0, 2 * np.pi)
    circle = Contour(pieces=ring, closed=True)
    (moved,) = offset_contour(circle, allowance(0.01, side), "test")

    begin, _ = moved.pieces.ends()
    assert np.abs(np.hypot(*(begin - [0.1, 0.0]).T) - radius).max() < NEAR_M
    assert length_m(moved) == pytest.approx(2 * np.pi * radius, abs=1e-5)


def test_rectangle_inside_and_mitred_outside() -> None:
    body = polygon([(0, 0), (0.06, 0), (0.06, 0.04), (0, 0.04)])
    (inner,) = offset_contour(body, allowance(0.01, "inside"), "test")
    (outer,) = offset_contour(body, allowance(0.01, "outside", "mitre"), "test")

    assert (length_m(inner), area_m2(inner)) == pytest.approx((0.12, 0.0008), abs=1e-9)
    assert (length_m(outer), area_m2(outer)) == pytest.approx((0.28, 0.0048), abs=1e-9)


def test_clockwise_contour_has_the_same_inside() -> None:
    body = polygon([(0, 0.04), (0.06, 0.04), (0.06, 0), (0, 0)])
    (inner,) = offset_contour(body, allowance(0.01, "inside"), "test")

    assert area_m2(inner) == pytest.approx(0.0008, abs=1e-9)


def test_sharp_corner_is_rounded_past_the_mitre_limit() -> None:
    """A spike of 10 degrees has a mitre of 11.5 allowances; the limit is 4."""
    tip = np.tan(np.radians(5)) * 0.1
    body = polygon([(0, -tip), (0.1, 0), (0, tip)])
    (outer,) = offset_contour(body, allowance(0.01, "outside", "mitre"), "test")

    assert outer.pieces.ends()[0][:, 0].max() == pytest.approx(0.11, abs=NEAR_M)


def test_mitres_that_would_meet_stay_round() -> None:
    """Two sharp teeth stand side by side; the offset outwards is wider than their gap."""
    teeth = [(0, 0), (0.08, 0), (0.08, 0.01), (0.042, 0.06), (0.04, 0.02), (0.038, 0.06), (0, 0.01)]
    (outer,) = offset_contour(polygon(teeth), allowance(0.02, "outside", "mitre"), "test")
    begin, end = outer.pieces.ends()

    assert not len(crossings(begin, end, True)[0])
    # The outer corners below are square and pointed; the tips above are round.
    assert np.hypot(*(begin - [-0.02, -0.02]).T).min() < 1e-9
    assert begin[:, 1].max() == pytest.approx(0.08, abs=2e-6)


def test_narrow_waist_splits_into_two() -> None:
    """Two squares of 40 mm and a neck of 8 mm, offset 5 mm inwards, leave two of 30 mm."""
    body = polygon(
        [
            (0, 0), (0.04, 0), (0.04, 0.016), (0.08, 0.016), (0.08, 0), (0.12, 0),
            (0.12, 0.04), (0.08, 0.04), (0.08, 0.024), (0.04, 0.024), (0.04, 0.04), (0, 0.04),
        ]
    )  # fmt: skip
    parts = offset_contour(body, allowance(0.005, "inside"), "test")

    # Each square bulges into its mouth of 8 mm, between two rounds of 5 mm:
    # 2 int_0^4 (5 - sqrt(25 - t^2)) dt = 2 (20 - 6 - 12.5 asin 0.8) mm^2.
    mouth = 2.0 * (14.0 - 12.5 * np.arcsin(0.8)) * 1e-6
    assert len(parts) == 2
    for part in parts:
        assert part.closed
        assert area_m2(part) == pytest.approx(30e-3**2 + mouth, abs=2e-8)


@pytest.mark.parametrize("join", ["round", "mitre"])
@given(st.integers(0, 10**6), st.floats(0.001, 0.02), st.sampled_from(["inside", "outside"]))
def test_offset_of_any_star_keeps_its_distance(
    join: str, seed: int, distance: float, side: str
) -> None:
    """No point is nearer than the allowance, and every vertex is as near as its corner allows."""
    rng = np.random.default_rng(seed)
    angle = np.linspace(0, 2 * np.pi, 17)[:-1]
    radius = rng.uniform(0.02, 0.06, 16)
    body = polygon(list(zip(radius * np.cos(angle), radius * np.sin(angle), strict=True)))
    try:
        parts = offset_contour(body, allowance(distance, side, join), "test")
    except JobError as error:
        assert "leaves nothing" in str(error)
        return

    a, b = body.pieces.ends()
    for part in parts:
        begin, end = part.pieces.ends()
        assert not len(crossings(begin, end, True)[0])
        probes = np.concatenate([begin, (begin + end) / 2])
        q, d = probes[:, None] - a, b - a
        along = np.clip((q * d).sum(-1) / (d * d).sum(-1), 0, 1)[..., None]
        nearest = np.sqrt(((q - along * d) ** 2).sum(-1)).min(axis=1)
        assert nearest.min() > distance - 1e-8
        # The point of a mitre is up to four allowances away; on a round corner no point is.
        assert nearest.max() < distance * (4.0 if join == "mitre" else 1.0) + NEAR_M


def test_parallel_of_an_open_curve_has_the_radius_plus_the_distance() -> None:
    arc = Contour(pieces=ellipse_arc(np.zeros(2), *(0.05 * np.eye(2)), 0.0, 2.0), closed=False)
    for side, radius in (("left", 0.04), ("right", 0.06)):
        (moved,) = offset_contour(arc, allowance(0.01, side), "test")
        assert not moved.closed
        assert length_m(moved) == pytest.approx(2.0 * radius, abs=1e-6)


def test_a_bend_is_tighter_by_the_allowance_on_its_inside() -> None:
    """The end of a slot, of radius 5 mm, keeps a bend of radius 1 mm after 4 mm inwards."""
    u_shape = bulges(
        np.array([[0.0, 0.03], [0, 0], [0.01, 0], [0.01, 0.03]]), np.array([0, 1.0, 0])
    )
    outside = offset_contour(Contour(pieces=u_shape, closed=False), allowance(0.004, "left"), "t")
    (part,) = outside
    # 4 mm inside a bend of 5 mm there is a bend of 1 mm.
    assert length_m(part) == pytest.approx(0.06 + np.pi * 0.001, abs=1e-5)


@pytest.mark.parametrize(
    ("contour", "side", "text"),
    [
        (Contour(pieces=chords(np.array([[0, 0], [1.0, 0]])), closed=False), "inside", "no inside"),
        (polygon([(0, 0), (0.1, 0), (0, 0.1), (0.1, 0.1)]), "inside", "crosses itself"),
        (polygon([(0, 0), (0.1, 0), (0.1, 0.01), (0, 0.01)]), "inside", "leaves nothing"),
    ],
)
def test_contour_without_an_offset_is_refused(contour: Contour, side: str, text: str) -> None:
    with pytest.raises(JobError, match=text):
        offset_contour(contour, allowance(0.01, side), "test.svg")


def test_flattening_stays_within_its_tolerance() -> None:
    """A dense sampling of a cubic with a tight bend measures the tolerance."""
    piece = bezier(np.array([[0, 0], [0.1, 0.12], [0.0, 0.12], [0.09, 0.0]]))
    begin, end, _ = flatten(piece, 1e-5)
    dense = piece.evaluate(np.zeros(20001, dtype=np.int64), np.linspace(0, 1, 20001))[0]
    d, q = end - begin, dense[:, None] - begin
    t = np.clip((q * d).sum(-1) / (d * d).sum(-1), 0, 1)
    off = np.hypot(*np.moveaxis(q - t[..., None] * d, -1, 0)).min(axis=1)

    assert 1e-6 < off.max() <= 1e-5


@settings(max_examples=20)
@given(st.integers(0, 10**6))
def test_sweep_finds_what_brute_force_finds(seed: int) -> None:
    walk = np.cumsum(np.random.default_rng(seed).normal(size=(50, 2)), axis=0)
    a, b = walk[:-1], walk[1:]
    first, second, at_first, at_second, complete = crossings(a, b, False)

    found = set()
    for i in range(len(a)):
        for j in range(i + 2, len(a)):
            m = np.column_stack([b[i] - a[i], a[j] - b[j]])
            s, t = np.linalg.solve(m, a[j] - a[i])
            if 0 <= s <= 1 and 0 <= t <= 1:
                found.add((i, j))
    assert complete
    assert set(zip(first.tolist(), second.tolist(), strict=True)) == found
    here = a[first] + at_first[:, None] * (b[first] - a[first])
    there = a[second] + at_second[:, None] * (b[second] - a[second])
    assert np.abs(here - there).max(initial=0.0) < 1e-9


def test_a_chord_of_no_length_is_met_by_none() -> None:
    """A curve that turns back on itself after an odd number of chords has one in its middle."""
    points = np.array([[0.0, 0.0], [1.0, 0.5], [2.0, 1.0], [2.0, 1.0], [1.0, 0.5], [0.0, 0.0]])
    first, second, *_, complete = crossings(points[:-1], points[1:], False)
    assert complete
    pairs = set(zip(first.tolist(), second.tolist(), strict=True))
    assert (0, 3) in pairs and (1, 4) in pairs  # out and back lie on each other
    assert not {(0, 2), (2, 4)} & pairs
