"""Run-ups in place of slower first stitches: same ends, same times, even acceleration."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from threadline.signals import Stream
from threadline.trajectory import Trajectory, TrajectoryBlock, with_run_ups


def chords(lengths, directions, duration=0.02, split=None):
    """Straight pieces of one duration from the origin; ``split`` into two blocks after so many."""
    steps = np.array(lengths)[:, None] * np.array(directions, dtype=float)
    starts = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)[:-1]])
    n = len(steps)
    rows = dict(
        start_s=np.arange(n) * duration,
        duration_s=np.full(n, duration),
        coefficients=np.stack([starts, steps], axis=1),
        operation=np.arange(n),
    )
    cuts = [0, n] if split is None else [0, split, n]
    blocks = [TrajectoryBlock(**{k: v[a:b] for k, v in rows.items()}) for a, b in pairwise(cuts)]
    return Trajectory(axes=("X", "Y"), blocks=Stream.of(blocks))


X, Y = (1, 0), (0, 1)


@pytest.mark.parametrize("split", [None, 1, 3, 4])
def test_first_and_last_stitches_of_a_leg_run_up_and_down(split):
    planned = chords([0.8, 1, 1, 0.8, 0.9, 1, 0.7], [X, X, X, X, Y, Y, Y], split=split)
    eased = with_run_ups(planned)
    ends = np.arange(8) * 0.02
    np.testing.assert_allclose(eased(ends), planned(ends), atol=1e-15)
    assert {int(label) for block in eased for label in block.operation} == set(range(7))
    # 0.8 of the speed in 0.02 s: from rest in 2 (1 - 0.8) 0.02 s, then at 50 units a second.
    t = np.array([1e-9, 0.004, 0.008 - 1e-9, 0.012, 0.07, 0.076])
    expected = [0.0, 25.0, 50.0, 50.0, 50.0, 25.0]
    np.testing.assert_allclose(eased(t, 1)[:, 0], expected, atol=1e-4)
    np.testing.assert_allclose(eased(np.array([0.082]), 1)[0], [0.0, 25.0], atol=1e-9)
    # No velocity steps but where a leg is left for one in another direction.
    fine = np.arange(1e-5, 0.0799, 1e-5)
    assert np.abs(np.diff(eased(fine, 1)[:, 0])).max() < 50.0 / 0.008 * 1.1e-5


def test_pieces_that_are_no_run_ups_stay():
    slow = chords([0.4, 1, 1, 1], [X, X, X, X])  # less than half: it did not begin at rest
    np.testing.assert_allclose(
        with_run_ups(slow)(np.linspace(0, 0.02, 9)), slow(np.linspace(0, 0.02, 9))
    )
    within = chords([1, 1, 0.8, 1, 1], [X, X, X, X, X])  # slower between two faster ones
    at = np.linspace(0, 0.0999, 333)
    np.testing.assert_allclose(with_run_ups(within)(at), within(at), atol=1e-15)
