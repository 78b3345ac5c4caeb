"""The place of a polynomial piece that is nearest to a point, compared with a dense search.

The reference samples a piece at 4001 places and refines the nearest with scipy's bounded minimum:
its result exceeds the least distance by less than 1e-9 m on pieces of some 10 mm.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from threadline.motion.path import path_deviation
from threadline.motion.path.deviation import SAMPLES, nearest_on_piece

from .test_deviation import path_of, programmed

PLACES = np.linspace(0.0, 1.0, 4001)


def dense(c, target) -> float:
    """Return the least distance of a piece from a point."""

    def gap(u):
        return ((u ** np.arange(len(c)) @ c - target) ** 2).sum()

    gaps = ((PLACES[:, None] ** np.arange(len(c)) @ c - target) ** 2).sum(axis=1)
    at = int(gaps.argmin())
    around = PLACES[max(at - 1, 0)], PLACES[min(at + 1, len(PLACES) - 1)]
    found = minimize_scalar(gap, bounds=around, method="bounded", options={"xatol": 1e-12})
    return float(np.sqrt(min(found.fun, gaps[at])))


@pytest.mark.parametrize("at_rest", [0, 1, 2])
def test_random_pieces_against_dense_search(at_rest: int) -> None:
    """Pieces of two to six coefficients; those that begin at rest have a slope of 0 there."""
    rng = np.random.default_rng(17 + at_rest)
    for case in range(400):
        order, axes = int(rng.integers(2 + at_rest, 7)), int(rng.integers(1, 4))
        c = rng.normal(scale=0.01, size=(order, axes))
        c[1 : 1 + at_rest] = 0.0
        target = c[0].copy() if case % 4 == 0 else rng.normal(scale=0.01, size=axes)
        u, squared = nearest_on_piece(c, target, np.inf, np.empty(SAMPLES + 1))
        assert np.sqrt(squared) <= dense(c, target) + 1e-9, (case, c, target)
        # Nor is it beyond the ends of the piece, where the polynomial may come nearer.
        assert 0.0 <= u <= 1.0 and np.sqrt(squared) >= dense(c, target) - 1e-9, (case, u)
        there = u ** np.arange(order) @ c
        assert np.sqrt(squared) == pytest.approx(np.linalg.norm(there - target), abs=1e-15)


def test_the_path_of_a_piece_that_begins_at_rest_is_near_the_vertex_that_it_passes() -> None:
    """Two chords in one piece, x = 0.06 u^2 - 0.04 u^3, from rest: the vertex lies on it.

    At u = 0, the nearest of nine samples, the slope of the distance is 0 and tells no direction.
    """
    c = [[0.0, 0.0], [0.0, 0.0], [0.06, 0.0], [-0.04, 0.0]]
    points = [[0.0, 0.0], [1e-4, 0.0], [0.02, 0.0]]
    found = path_deviation(
        programmed(points, ("X", "Y")), path_of([c], ("X", "Y"), [1], [1.0, 1.0])
    )
    assert found.at_tool_m < 1e-9
