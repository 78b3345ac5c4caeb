"""Pieces of a run as elements."""

from __future__ import annotations

import numpy as np

from threadline.motion.path.types import PieceBlock
from threadline.motion.timing.optimal.motion_limits import Limits
from threadline.motion.timing.optimal.run_elements import run_elements


def test_pieces_of_femtometres_beside_a_rest_are_left_out():
    """They are below the rounding of a place: a motion from rest along them has no digits."""
    moves = np.array([1e-15, 0.1, 1e-13, 0.05, 2e-15])
    starts = np.cumsum(moves) - moves
    zeros = np.zeros(5)
    run = PieceBlock(
        coefficients=np.stack([starts, moves], axis=1)[:, :, None],
        operation=np.arange(5),
        nominal_s=zeros,
        rest_after=np.array([0, 0, 0, 0, 1]),
        dwell_s=zeros,
        line=np.arange(5),
    )
    limits = Limits(velocity=np.ones(1), acceleration=np.ones(1), jerk=np.ones(1))
    whole = run_elements(run, np.ones(1), limits)
    assert whole is not None
    assert sorted(set(whole.elements.operation.tolist())) == [1, 2, 3]
    went_on = run_elements(run, np.ones(1), limits, to_rest=False)
    assert went_on is not None
    assert sorted(set(went_on.elements.operation.tolist())) == [1, 2, 3, 4]
