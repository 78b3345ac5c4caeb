"""Corners that are entered and left on their outside: the path, and the time saved."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from tests.motion.path.test_greville import programmed
from threadline.motion.path.auto import auto_pieces
from threadline.motion.path.polygon import QUARTIC
from threadline.motion.path.wide_corners import Corners

U = np.linspace(0.0, 1.0, 201)
CUT_M = 1e-3


def path(points, corners, block=4096, cut_m=CUT_M):
    blocks = auto_pieces(programmed(points, block=block), cut_m, degree=QUARTIC, corners=corners)
    return np.concatenate([one.coefficients for one in blocks])


def places(coefficients):
    powers = U[:, None] ** np.arange(coefficients.shape[1])
    return np.einsum("pk,nka->npa", powers, coefficients).reshape(-1, coefficients.shape[2])


def sharpest(coefficients):
    """Return the largest curvature of a path in a plane, from its polynomials."""
    order = np.arange(1.0, coefficients.shape[1])
    first = coefficients[:, 1:] * order[:, None]
    second = first[:, 1:] * order[:-1, None]
    v, a = (
        np.einsum("pk,nka->npa", U[:, None] ** np.arange(c.shape[1]), c) for c in (first, second)
    )
    size = np.linalg.norm(v, axis=2)
    across = v[..., 0] * a[..., 1] - v[..., 1] * a[..., 0]
    return float((np.abs(across) / np.maximum(size, 1e-12) ** 3)[size > 1e-6].max())


def from_program(points, at):
    """Return the distances of places from the nearest chord, by projection on each."""
    found = np.full(len(at), np.inf)
    for begin, end in pairwise(points):
        way = end - begin
        share = np.clip((at - begin) @ way / (way @ way), 0.0, 1.0)
        found = np.minimum(found, np.linalg.norm(at - begin - share[:, None] * way, axis=1))
    return found


CORNER = np.array([[0.0, 0.0], [0.1, 0.0], [0.1, 0.1]])
ZIGZAG = np.array([[0.0, 0.0], [0.1, 0.0], [0.16, 0.05], [0.25, 0.02], [0.3, 0.1], [0.4, 0.1]])


def test_a_corner_of_its_own_is_passed_inside_by_the_tolerance_and_on_its_outside() -> None:
    """The vertex is missed by the whole tolerance, on the inside; the legs by less than that.

    The curvature falls with the distance over which a corner is cut: before, the tolerance; now
    also the shift of its vertex, the root of 2 of the distance of its legs.
    """
    plain, outer = (path(CORNER, Corners(outside_m=s)) for s in (0.0, CUT_M))
    inside = np.linalg.norm(places(outer) - CORNER[1], axis=1).min()
    assert inside == pytest.approx(CUT_M, rel=0.02)
    assert from_program(CORNER, places(outer)).max() <= CUT_M * (1.0 + 1e-9)
    assert places(outer)[:, 1].min() < -0.9 * CUT_M  # outside, before the corner
    assert sharpest(outer) == pytest.approx(sharpest(plain) / (1.0 + 2.0**0.5), rel=0.05)


def test_corners_to_either_side_stay_within_the_tolerance() -> None:
    outer = path(ZIGZAG, Corners(outside_m=CUT_M))
    assert from_program(ZIGZAG, places(outer)).max() <= CUT_M * (1.0 + 1e-9)
    assert np.allclose(places(outer)[[0, -1]], ZIGZAG[[0, -1]], atol=1e-12)


def test_a_narrow_corner_keeps_its_own_tolerance_and_the_others_theirs() -> None:
    """Lines of this program are the numbers of its vertices."""
    outer = path(ZIGZAG, Corners(outside_m=CUT_M, narrow=((2, 0.4 * CUT_M),)))
    missed = [np.linalg.norm(places(outer) - vertex, axis=1).min() for vertex in ZIGZAG[1:-1]]
    assert missed[1] == pytest.approx(0.4 * CUT_M, rel=0.03)
    assert missed[0] > 0.9 * CUT_M
    assert missed[2] > 0.9 * CUT_M


def test_a_path_that_turns_back_is_not_led_beyond_its_end() -> None:
    there = np.array([[0.0, 0.0], [0.1, 0.0], [0.0, 0.0]])
    assert np.array_equal(path(there, Corners(outside_m=CUT_M)), path(there, Corners()))


@pytest.mark.parametrize("block", [1, 2, 3, 5])
def test_the_path_does_not_depend_on_the_blocks_in_which_it_is_read(block: int) -> None:
    random = np.random.default_rng(block)
    points = np.cumsum(random.normal(size=(40, 2)) * 0.05, axis=0)
    corners = Corners(outside_m=CUT_M, narrow=((7, 0.5 * CUT_M),))
    whole = path(points, corners)
    assert np.array_equal(path(points, corners, block=block), whole)


def test_a_rest_stays_where_the_program_has_it() -> None:
    blocks = auto_pieces(
        programmed(ZIGZAG, rests=(2,)), CUT_M, degree=QUARTIC, corners=Corners(outside_m=CUT_M)
    )
    ends = [
        block.coefficients[row].sum(axis=0)
        for block in blocks
        for row in np.flatnonzero(block.rest_after)
    ]
    assert np.allclose(ends, ZIGZAG[[2, -1]], atol=1e-12)
