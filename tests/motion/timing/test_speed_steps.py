"""Steps of speed in place of slower first and last stitches: same times, same way."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from threadline.files import Stream
from threadline.motion.timing import Trajectory, TrajectoryBlock, leads_of, with_steps

X, Y = (1, 0), (0, 1)
LAST_S = 0.02  # each piece


def chords(lengths, directions, *, rests=(), split=None):
    """Return straight pieces from the origin, at rest after ``rests``; ``split`` in two blocks."""
    steps = np.array(lengths)[:, None] * np.array(directions, dtype=float)
    starts = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)[:-1]])
    n = len(steps)
    rows = dict(
        start_s=np.arange(n) * LAST_S,
        duration_s=np.full(n, LAST_S),
        coefficients=np.stack([starts, steps], axis=1),
        # An operation without motion between two moves is a rest.
        operation=np.arange(n) + np.searchsorted(np.array(rests, dtype=int), np.arange(n)),
    )
    cuts = [0, n] if split is None else [0, split, n]
    blocks = [TrajectoryBlock(**{k: v[a:b] for k, v in rows.items()}) for a, b in pairwise(cuts)]
    return Trajectory(axes=("X", "Y"), blocks=Stream.of(blocks))


@pytest.mark.parametrize("split", [None, 1, 3, 4, 6, 7])
def test_legs_rest_for_what_their_run_ups_cost(split):
    """By hand: X loses 0.8 and 0.2 of a piece, Y 0.1 and 0.3."""
    lengths = [0.3, 0.9, 1, 1, 0.8, 0.9, 1, 0.7]
    planned = chords(lengths, [X] * 5 + [Y] * 3, rests=(4,), split=split)
    stepped = with_steps(planned)
    t = np.linspace(0.0, 0.16, 3201)
    x = np.clip(t - 0.8 * LAST_S, 0.0, 0.096 - 0.8 * LAST_S) / LAST_S
    y = np.clip(t - 0.102, 0.0, 0.154 - 0.102) / LAST_S
    np.testing.assert_allclose(stepped(t), np.stack([x, y], axis=1), atol=1e-12)
    labels = [int(label) for block in stepped for label in block.operation]
    assert sorted(set(labels)) == [0, 1, 2, 3, 4, 6, 7, 8]
    assert labels == sorted(labels)
    leads = leads_of(planned)
    assert leads.starts_s == pytest.approx((0.1 * LAST_S, 0.8 * LAST_S))
    assert leads.stops_s == pytest.approx((0.2 * LAST_S, 0.3 * LAST_S))


@pytest.mark.parametrize(
    "planned",
    [
        chords([1, 1, 0.8, 1, 1], [X] * 5),  # slower between two faster ones
        chords([1, 0.8, 0.8, 1], [X, X, Y, Y]),  # a corner that is passed in motion
        chords([1, 1, 1], [X] * 3),
        chords([0.1, 0.2, 0.3, 0.4, 0.5, 0.6], [X] * 6),  # no piece has the speed of a leg
    ],
)
def test_pieces_that_are_no_run_ups_stay(planned):
    at = np.linspace(0.0, planned.duration_s, 333)
    np.testing.assert_allclose(with_steps(planned)(at), planned(at), atol=1e-15)
    assert leads_of(planned).starts_s == (0.0, 0.0)


def test_a_long_motion_streams():
    """1000 legs in blocks of three pieces: as the same legs in one block."""
    lengths = [0.5, 0.9, 1, 1, 1, 0.7] * 1000
    rests = tuple(range(5, 5999, 6))
    whole = chords(lengths, [X] * 6000, rests=rests)
    (block,) = list(whole)
    parts = [
        TrajectoryBlock(
            start_s=block.start_s[k : k + 3],
            duration_s=block.duration_s[k : k + 3],
            coefficients=block.coefficients[k : k + 3],
            operation=block.operation[k : k + 3],
        )
        for k in range(0, 6000, 3)
    ]
    streamed = Trajectory(axes=("X", "Y"), blocks=Stream.of(parts))
    at = np.linspace(0.0, 120.0, 20_001)
    np.testing.assert_allclose(with_steps(streamed)(at), with_steps(whole)(at), atol=1e-9)
    assert not np.allclose(with_steps(whole)(at), whole(at), atol=1e-3)
