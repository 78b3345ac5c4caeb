"""The quartic path: its pieces, compared with scipy's spline, its bound with dense samples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import BSpline

from threadline.files import Stream
from threadline.machine import load_machine
from threadline.motion.path import plan_path
from threadline.motion.path.auto import auto_pieces, points_added
from threadline.motion.path.greville import CUT, cut_of, quartic_spacing, quartic_spans
from threadline.motion.path.polygon import QUARTIC, Chords, control_polygon, turns
from threadline.motion.path.runs import Vertices
from threadline.motion.path.types import ProgrammedPath, VertexBlock

U = np.linspace(0.0, 1.0, 65)


def programmed(points, rests=(), block=4096):
    count = len(points)
    own = np.arange(count)
    rest = np.isin(own, [*rests, count - 1]).astype(np.int64)
    blocks = [
        VertexBlock(
            positions=points[rows],
            operation=np.maximum(own[rows] - 1, 0),
            nominal_s=np.zeros(len(own[rows])),
            rest=rest[rows],
            dwell_s=np.zeros(len(own[rows])),
            line=own[rows],
        )
        for rows in (slice(at, at + block) for at in range(0, count, block))
    ]
    axes = tuple(map(str, range(points.shape[1])))
    return ProgrammedPath(axes=axes, radius_m=np.ones(len(axes)), blocks=Stream.of(blocks))


def pieces(points, cut_m, **given):
    path = auto_pieces(programmed(points, **given), cut_m, degree=QUARTIC)
    return np.concatenate([block.coefficients for block in path])


def drawn(seed):
    """Return a polygon of one to eleven legs of two decades, with straight joints and reversals."""
    random = np.random.default_rng([seed, 31])
    count = int(random.integers(1, 12))
    way = random.normal(size=(count, 2))
    if seed % 2:
        way = np.array([1.0, 0.0]) + 0.3 * way  # all turns are small
    way[random.random(count) < 0.25] = way[0]
    way[random.random(count) < 0.15] = -way[0]
    way *= (10.0 ** random.uniform(-1.0, 1.0, count) / np.linalg.norm(way, axis=1))[:, None]
    return np.concatenate([np.zeros((1, 2)), np.cumsum(way, axis=0)]), random


def mirrored(rows, times=3):
    """Return rows extended by their mirror image at each end, and how many were put in front."""
    before = 0
    for _ in range(times):
        rows = np.concatenate([rows, 2.0 * rows[-1] - rows[-2::-1]])
        before += len(rows) - 1
        rows = np.concatenate([2.0 * rows[0] - rows[:0:-1], rows])
    return rows, before


def test_pieces_are_those_of_scipys_spline_and_its_bound_holds():
    """Control points at the means of four knots, by ``numpy.interp``."""
    for seed in range(60):
        points, random = drawn(seed)
        length, turn = turns(points, np.ones(2))
        time_s = random.uniform(0.5, 2.0, len(length)) * length
        c, pace, straight = quartic_spans(
            points, turn, np.append(0.0, length), np.append(0.0, time_s), 0, len(length)
        )
        rows = np.column_stack([points, np.append(0.0, np.cumsum(time_s))])
        rows, before = mirrored(rows)
        knots = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(rows[:, :2], axis=0), axis=1)))
        mean = np.array([knots[i + 1 : i + 5].mean() for i in range(len(knots) - 5)])
        control = np.stack([np.interp(mean, knots, column) for column in rows.T], axis=1)
        spline, strayed = BSpline(knots, control, 4), 0.0
        for k in range(len(length)):
            s = knots[before + k] + U * length[k]
            there = spline(s)
            np.testing.assert_allclose(
                U[:, None] ** np.arange(5) @ c[k], there[:, :2], atol=1e-11, rtol=0.0
            )
            polygon = np.stack([np.interp(s, knots, column) for column in rows.T[:2]], axis=1)
            strayed = max(strayed, np.linalg.norm(there[:, :2] - polygon, axis=1).max())
            if straight[k]:
                assert not c[k, 2:].any()
            else:
                v = 1.0 - U
                own = pace[k] @ np.stack([v**3, 3 * U * v**2, 3 * U**2 * v, U**3])
                np.testing.assert_allclose(own, length[k] * spline(s, 1)[:, 2], atol=1e-10)
        bound = max((cut_of(length, turn, v) for v in range(1, len(length))), default=0.0)
        assert strayed <= bound * (1.0 + 1e-9) + 1e-12


@pytest.mark.parametrize("seed", range(8))
def test_the_bound_is_near_where_all_turns_have_one_sense(seed):
    """Within a twentieth of dense samples; turns that cancel each other are added up, too."""
    random = np.random.default_rng(seed)
    turned = np.cumsum(random.uniform(0.05, 0.3, 12))
    way = 10.0 ** random.uniform(-0.5, 0.5, (12, 1)) * np.stack([np.cos(turned), np.sin(turned)], 1)
    points = np.concatenate([np.zeros((1, 2)), np.cumsum(way, axis=0)])
    length, turn = turns(points, np.ones(2))
    legs = np.append(0.0, length)
    c, _, _ = quartic_spans(points, turn, legs, legs, 0, len(length))
    places = U[:, None] ** np.arange(5) @ c
    polygon = points[:-1, None] + U[:, None] * np.diff(points, axis=0)[:, None]
    strayed = np.linalg.norm(places - polygon, axis=2)[2:-2].max()
    bound = max(cut_of(length, turn, v) for v in range(2, len(length) - 1))
    assert strayed <= bound * (1.0 + 1e-12) <= 1.05 * strayed


@pytest.mark.parametrize("seed", range(8))
def test_no_bound_of_a_path_with_its_points_is_above_the_tolerance(seed):
    """For 40 polygons each, bit for bit the knots of a path, by the bound for any knots."""
    used = []
    for number in range(40):
        points, random = drawn(1000 * seed + number)
        length, turn = turns(points, np.ones(2))
        cut_m = 10.0 ** random.uniform(-2.0, 0.5)
        count = len(points)
        vertices = Vertices(
            positions=points,
            nominal_s=np.ones(count),
            operation=np.arange(count),
            line=np.arange(count),
            beside_m=np.zeros(count),
            more_m=np.zeros(count),
        )
        knots = control_polygon(
            vertices, length, turn, cut_m, Chords(0, count - 1, True, True), QUARTIC
        )
        turned, legs = np.append(0.0, knots.turn), knots.length_m
        assert (legs > 0.0).all() and legs.sum() == pytest.approx(length.sum())
        used += [cut_of(legs, turned, v) / cut_m for v in range(1, len(legs))]
    assert 0.99 < max(used) <= 1.0 + 1e-9


def test_another_knot_cuts_no_vertex_more():
    for seed in range(40):
        points, random = drawn(seed)
        length, turn = turns(points, np.ones(2))
        leg = int(random.integers(len(length)))
        share = random.uniform(0.01, 0.99)
        more = np.insert(length, leg, share * length[leg])
        more[leg + 1] *= 1.0 - share
        turned = np.insert(turn, leg + 1, 0.0)
        for v in range(1, len(length)):
            now = cut_of(more, turned, v + (v > leg))
            assert now <= cut_of(length, turn, v) * (1.0 + 1e-12)


@pytest.mark.parametrize("turn_deg", [20.0, 90.0, 170.0, 180.0])
def test_a_corner_of_long_legs_is_cut_by_what_is_allowed(turn_deg):
    """No more and no less, by four pieces between two lines: there the bound is exact."""
    turn = np.radians(turn_deg)
    corner = np.array([[0.0, 0.0], [0.1, 0.0], [0.1 + 0.1 * np.cos(turn), 0.1 * np.sin(turn)]])
    c = pieces(corner, 1e-4)
    assert (~c[:, 2:].any(axis=(1, 2))).tolist() == [True, False, False, False, False, True]
    places = (np.linspace(0.0, 1.0, 2001)[:, None] ** np.arange(5) @ c).reshape(-1, 2)
    assert np.linalg.norm(places - corner[1], axis=1).min() == pytest.approx(1e-4, rel=1e-6)
    reach = 2.0 * 1e-4 / (CUT * 2.0 * np.sin(0.5 * turn))
    assert c[0, 1, 0] == pytest.approx(0.1 - reach, rel=1e-12)


@pytest.mark.parametrize("seed", range(12))
def test_three_derivatives_go_on_across_every_joint(seed):
    """Each piece in units of its length along the polygon, by one rate of the next one over it."""
    points, random = drawn(seed)
    if len(points) < 3:
        points = np.array([[0.0, 0.0], [1.0, 0.2], [1.5, -0.4], [1.5, 3.0]])
    cut_m = 10.0 ** random.uniform(-3.0, -0.5)
    c = pieces(points, cut_m)
    powers = np.arange(5)
    size = np.abs(c[:, 1:]).max(axis=(1, 2))
    ends, begins = [c[:-1].copy()], [c[1:].copy()]
    for _ in range(3):
        ends.append(ends[-1][:, 1:] * powers[1 : ends[-1].shape[1], None])
        begins.append(begins[-1][:, 1:] * powers[1 : begins[-1].shape[1], None])
    last, first = [e.sum(axis=1) for e in ends], [b[:, 0] for b in begins]
    np.testing.assert_allclose(last[0], first[0], atol=1e-13 * np.abs(points).max())
    speed = np.linalg.norm(last[1], axis=1), np.linalg.norm(first[1], axis=1)
    for k in range(len(c) - 1):
        if min(speed[0][k] / size[k], speed[1][k] / size[k + 1]) < 1e-3:
            continue  # it turns back there
        rate = speed[0][k] / speed[1][k]
        for order in (1, 2, 3):
            scale = max(size[k], size[k + 1] * rate**order)
            apart = last[order][k] - first[order][k] * rate**order
            assert np.abs(apart).max() <= 1e-8 * scale, (k, order)


def test_blocks_leave_no_seam():
    """Wherever blocks end: the same curves; a line is two lines if a block ends in it."""
    random = np.random.default_rng(5)
    points = np.cumsum(random.normal(size=(60, 2)), axis=0)
    points[30:40] = points[29] + np.outer(np.arange(1.0, 11.0), random.normal(size=2))
    whole = pieces(points, 0.05, rests=(20,))
    curved = whole[:, 2:].any(axis=(1, 2))
    for block in (1, 2, 3, 7, 50):
        parts = pieces(points, 0.05, rests=(20,), block=block)
        own = parts[:, 2:].any(axis=(1, 2))
        np.testing.assert_allclose(parts[own], whole[curved], atol=1e-12)
        np.testing.assert_allclose(parts[~own].sum(axis=0)[1], whole[~curved].sum(axis=0)[1])


def test_a_dense_curve_has_no_added_points_and_one_piece_for_each_leg():
    turn = np.linspace(0.0, 2.0 * np.pi, 721)
    c = pieces(0.1 * np.stack([np.sin(turn), 1.0 - np.cos(turn)], axis=1), 1e-4)
    assert len(c) == 720 and c[:, 2:].any(axis=(1, 2)).all()


def like_legs(random, count=14):
    """A polygon of legs that are like each other, with turns of a decade to either side."""
    turned = np.cumsum(10.0 ** random.uniform(-1.3, -0.3, count) * random.choice([-1, 1, 1], count))
    way = random.uniform(0.7, 1.3, (count, 1)) * np.stack([np.cos(turned), np.sin(turned)], 1)
    return np.concatenate([np.zeros((1, 2)), np.cumsum(way, axis=0)])


def test_a_vertex_alone_has_one_knot_on_one_leg_where_that_is_enough():
    """It is cut by more than with two, and by no more than allowed, whatever the blocks."""
    turned = np.cumsum([0.0, 0.1, 0.1, 0.1, 0.4, 0.1, 0.1, 0.1])
    way = np.stack([np.cos(turned), np.sin(turned)], 1)
    points = np.concatenate([np.zeros((1, 2)), np.cumsum(way, axis=0)])
    c = pieces(points, 0.115)
    assert len(c) == len(way) + 1
    places = (np.linspace(0.0, 1.0, 201)[:, None] ** np.arange(5) @ c).reshape(-1, 2)
    assert np.linalg.norm(places - points[4], axis=1).min() > 0.4 / 6.0
    assert len(pieces(points, 0.06)) == len(way) + 2  # one is not enough
    for block in (1, 2, 3, 5):
        np.testing.assert_array_equal(pieces(points, 0.115, block=block), c)


@pytest.mark.parametrize("seed", range(3))
def test_no_vertex_with_one_knot_is_cut_by_more_than_the_tolerance(seed):
    """By dense samples of 50 polygons; some of them have such vertices."""
    single = 0
    for number in range(50):
        random = np.random.default_rng([seed, number, 77])
        points = like_legs(random)
        cut_m = 10.0 ** random.uniform(-1.7, -0.7)
        c = pieces(points, cut_m)
        places = (U[:, None] ** np.arange(5) @ c).reshape(-1, 2)
        start, way = points[:-1], np.diff(points, axis=0)
        along = ((places[:, None] - start) * way).sum(axis=2) / (way**2).sum(axis=1)
        near = start + np.clip(along, 0.0, 1.0)[..., None] * way
        strayed = np.linalg.norm(places[:, None] - near, axis=2).min(axis=1).max()
        assert strayed <= cut_m * (1.0 + 1e-9)
        length, turn = turns(points, np.ones(2))
        spacing, none = np.empty((2, len(points))), np.zeros(len(points))
        quartic_spacing(length, turn, np.full(len(turn), cut_m), none, 0, len(length), spacing)
        single += int(((spacing[0] == 0.0) != (spacing[1] == 0.0)).sum())
        np.testing.assert_array_equal(c, pieces(points, cut_m, block=1 + number % 5))
    assert single > 5


def test_points_are_counted_for_either_degree():
    """One on either side of a corner for a cubic, two for a quartic."""
    corner = programmed(np.array([[0.0, 0.0], [0.1, 0.0], [0.1, 0.1]]))
    assert [points_added(corner, 1e-4, degree) for degree in (3, QUARTIC)] == [2, 4]


def test_optimal_follows_the_quartic_and_auto_a_cubic():
    """Third derivatives at the joints of a corner, in units of length, and the printed points."""
    corner = programmed(np.array([[0.0, 0.1], [0.1, 0.1], [0.1, 0.2]]))
    corner = replace(corner, axes=("X", "Y"))
    steps, added = [], []
    for name in ("optimal", "auto"):
        path = plan_path(corner, load_machine("lathe-winder"), name, 1e-4)
        c = np.concatenate([block.coefficients for block in path])
        powers = np.arange(c.shape[1])
        # The pieces continue evenly: each in units of its own rate at the joint.
        last = (c * (powers * (powers - 1) * (powers - 2))[:, None]).sum(axis=1)[:-1]
        last /= np.linalg.norm((c * powers[:, None]).sum(axis=1)[:-1], axis=1)[:, None] ** 3
        first = 6.0 * c[1:, 3] / np.linalg.norm(c[1:, 1], axis=1)[:, None] ** 3
        steps.append(np.abs(last - first).max() / np.abs(first).max())
        added.append(path.summary["points_added"])
    assert steps[0] < 1e-6 < 0.5 < steps[1]
    assert added == [4, 2]
