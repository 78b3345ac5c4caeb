"""Pieces of a spline along which the programmed speed changes: cut into parts, the same curve."""

from __future__ import annotations

import numpy as np
import pytest

from threadline.motion.path.polygon import even_parts, turns

CASES = 200
EVEN, MOST_PARTS = 0.02, 16
"""Share by which the pace along a part may vary, and most parts of a piece."""


def differences(rng: np.random.Generator) -> list[np.ndarray]:
    """Return Bezier differences of the time along each piece, from even to six times as slow."""
    return [rng.uniform(0.01, 0.01 * 10 ** rng.uniform(0, 0.8), size=(CASES, 1)) for _ in range(3)]


def cut_evenly(
    c: np.ndarray, times: list[np.ndarray], straight: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the piece of each part, the parts, and their times at the feed."""
    pace, own = 3.0 * np.concatenate(times, axis=1), np.arange(len(c))
    cut, nominal_s, owner, line = even_parts(
        c, pace, np.full(len(c), 0.03), straight, (own, own + 7)
    )
    np.testing.assert_array_equal(line, owner + 7)
    return owner, cut, nominal_s


def test_parts_are_the_piece_that_they_are_cut_from() -> None:
    """At eleven places of every part, against the piece itself: to rounding, 1e-15 m of 0.1 m."""
    rng = np.random.default_rng(3)
    c = rng.normal(scale=0.02, size=(CASES, 4, 2))
    owner, cut, _ = cut_evenly(c, differences(rng), np.zeros(CASES, dtype=np.bool_))
    assert np.bincount(owner).max() > 5 and len(np.unique(owner)) == CASES
    u = np.linspace(0.0, 1.0, 11)[:, None] ** np.arange(4)
    for piece in range(CASES):
        parts = np.flatnonzero(owner == piece)
        for number, part in enumerate(parts):
            at = (number + np.linspace(0.0, 1.0, 11)[:, None]) / len(parts)
            np.testing.assert_allclose(u @ cut[part], at ** np.arange(4) @ c[piece], atol=1e-15)


def test_no_part_is_faster_than_its_feed_or_much_slower() -> None:
    """The time of a part is at least the programmed integral, and little above it.

    Along a piece the time per u is a quadratic with the Bezier values 3 t: within a part it changes
    by at most twice their spread over the number of parts.
    """
    rng = np.random.default_rng(4)
    c = rng.normal(scale=0.02, size=(CASES, 4, 2))
    t = differences(rng)
    owner, _, nominal_s = cut_evenly(c, t, np.zeros(CASES, dtype=np.bool_))
    a, b, d = 3.0 * np.concatenate(t, axis=1).T
    count = np.bincount(owner)
    spread = np.max([a, b, d], axis=0) - np.min([a, b, d], axis=0)
    for piece in range(CASES):
        joints = np.linspace(0.0, 1.0, count[piece] + 1)
        # The integral of the quadratic, in powers of u.
        powers = np.polynomial.Polynomial(
            [0.0, a[piece], b[piece] - a[piece], (a[piece] - 2.0 * b[piece] + d[piece]) / 3.0]
        )
        own = np.diff(powers(joints))
        given = nominal_s[owner == piece]
        assert (given >= own * (1.0 - 1e-12)).all()
        assert (given <= own + 2.0 * spread[piece] / count[piece] ** 2 + 1e-15).all()
        expected = np.ceil(3.0 * spread[piece] / (a + b + d)[piece] / EVEN)
        assert count[piece] == np.clip(expected, 1, MOST_PARTS)


@pytest.mark.parametrize("straight", [False, True])
def test_a_piece_at_one_speed_and_a_straight_one_stay_whole(straight: bool) -> None:
    rng = np.random.default_rng(5)
    c = rng.normal(scale=0.02, size=(CASES, 4, 2))
    t = differences(rng) if straight else [np.full((CASES, 1), 0.01)] * 3
    owner, cut, nominal_s = cut_evenly(c, t, np.full(CASES, straight))
    np.testing.assert_array_equal(owner, np.arange(CASES))
    np.testing.assert_array_equal(cut, c)
    if not straight:
        np.testing.assert_allclose(nominal_s, 0.03, rtol=1e-15)


def test_a_turn_on_a_mandrel_counts_at_the_larger_radius_beside_it() -> None:
    """Right angles, each weighted with the larger radius beside it; otherwise sqrt 2."""

    class Shares:
        def most_between(self, positions: np.ndarray) -> np.ndarray:
            return np.repeat([[0.5], [1.0], [0.25], [0.25]], 2, axis=1)

    corners = 0.01 * np.array([[0, 0], [1, 0], [1, 1], [2, 1], [2, 2]], dtype=float)
    length, turn = turns(corners, np.ones(2), Shares())
    np.testing.assert_allclose(length, 0.01)
    np.testing.assert_allclose(turn, np.sqrt(2.0) * np.array([0.0, 1.0, 1.0, 0.25, 0.0]))
