"""The number of chords of a piece, and the distance of these chords from it."""

from __future__ import annotations

import numpy as np
import pytest

from threadline.commands.merged_chords import merged
from threadline.commands.planned_job import planned_job
from threadline.jobs.operations import Feed, FeedMode, Move

from .makers import HERE, job_of, polynomials, winder

AXES = ("X", "Y")
ROUNDED_M = 1e-9
"""What the rounding of the ends of chords adds to how far they stray."""


def chords(pieces, tolerance_m: float) -> list[int]:
    """Return the number of moves into which each piece, a move of the job, is divided."""
    moves = [Move(tuple(c.sum(axis=0)), Feed(FeedMode.RAPID, 0.0), HERE) for c in pieces]
    timed = polynomials([(1.0, c.tolist(), i) for i, c in enumerate(pieces)], axes=AXES)
    made = list(planned_job(job_of(moves, AXES), timed, winder(), tolerance_m))
    # Of n chords in 1 s each has 1 / n s: the inverse time of each is n.
    feeds = [int(move.feed.value) for move in made]
    found = []
    while feeds:
        found.append(feeds[0])
        assert feeds[: feeds[0]] == [feeds[0]] * feeds[0]
        del feeds[: feeds[0]]
    return found


def strays(c, parts: int) -> float:
    """Return how far the piece is from ``parts`` chords at equal steps of u, sampled densely."""
    u = np.linspace(0.0, 1.0, 200 * parts + 1)
    way = u[:, None] ** np.arange(len(c)) @ c
    at = np.linspace(0.0, 1.0, parts + 1)[:, None] ** np.arange(len(c)) @ c
    low = np.minimum((u * parts).astype(int), parts - 1)
    share = (u * parts - low)[:, None]
    return float(np.linalg.norm(way - at[low] * (1 - share) - at[low + 1] * share, axis=1).max())


@pytest.mark.parametrize("tolerance", [1e-3, 1e-4, 3e-6])
def test_a_parabola_needs_as_many_as_its_sagitta_says(tolerance: float) -> None:
    """y = 0.02 (u^2 - u) over 0.1 m: n chords are off by 0.02 / (4 n^2), exactly."""
    c = np.array([[0.0, 0.0], [0.1, -0.02], [0.0, 0.02]])
    (parts,) = chords([c], tolerance)
    assert parts == int(np.ceil(np.sqrt(0.02 / (4 * tolerance)) - 1e-9))
    assert strays(c, parts) <= tolerance * (1 + 1e-9)
    assert strays(c, parts - 1) > tolerance


def test_no_piece_strays_farther_than_the_tolerance() -> None:
    rng = np.random.default_rng(3)
    for _ in range(50):
        block = rng.normal(scale=0.01, size=(2, int(rng.integers(3, 7)), 2))
        tolerance = float(10.0 ** rng.uniform(-6, -3))
        for c, parts in zip(block, chords(block, tolerance), strict=True):
            # The bound is on each axis: two of them are off by its root of two at most.
            assert strays(c, parts) <= np.sqrt(2.0) * tolerance, (c, tolerance)


def test_a_straight_piece_is_one_chord() -> None:
    straight = np.array([[0.0, 0.0], [0.1, 0.2], [0.0, 0.0]])
    assert chords([straight[:2], straight[:2]], 1e-9) == [1, 1]
    assert chords([straight], 1e-9) == [1]


def test_a_corner_lies_between_its_slowest_moves() -> None:
    """Into a reversal and out of it equally slowly: no slow piece of its own after the corner."""
    x = np.array([0.0, 0.1, 0.1 + 2e-5, 0.1, 0.0])
    points = np.column_stack([x, np.zeros(5)])
    speeds = np.array([0.036, 0.006, 0.006, 0.036])
    found = merged(points, speeds)
    assert [(part.first, part.stop, part.speed) for part in found] == [
        (0, 2, 0.036),
        (2, 4, 0.036),
    ]
    straight = np.column_stack([np.array([0.0, 0.1, 0.2, 0.3, 0.4]), np.zeros(5)])
    assert [part.stop for part in merged(straight, speeds)] == [3, 4]
