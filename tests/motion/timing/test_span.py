"""Results of a whole reading of a trajectory are kept, without planning it again."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from tests.made import Made
from threadline.files import Stream
from threadline.motion.timing import Trajectory
from threadline.motion.timing.types import TrajectoryBlock


def block(start_s: float, way: float) -> TrajectoryBlock:
    """Return one straight piece of 0.5 s; a way of 0 is a rest."""
    return TrajectoryBlock(
        start_s=np.array([start_s]),
        duration_s=np.array([0.5]),
        coefficients=np.array([[[0.0], [way]]]),
        operation=np.array([0]),
    )


class Counted:
    """Rest, motion, rest, motion, rest; counts its readings."""

    def __init__(self) -> None:
        self.begun = 0

    def __call__(self):
        self.begun += 1
        yield from (block(0.5 * k, way) for k, way in enumerate((0.0, 0.1, 0.0, -0.1, 0.0)))


def test_one_reading_tells_duration_and_motion() -> None:
    made = Counted()
    trajectory = Trajectory(axes=("X",), blocks=Made(made))
    next(iter(trajectory))  # a part of a reading is not enough
    assert len(list(trajectory)) == 5 and made.begun == 2
    assert trajectory.duration_s == pytest.approx(2.5)
    assert trajectory.moves_s == pytest.approx((0.5, 2.0))
    assert made.begun == 2
    unread = Trajectory(axes=("X",), blocks=Made(made))
    assert unread.moves_s == pytest.approx((0.5, 2.0)) and unread.duration_s == pytest.approx(2.5)
    assert made.begun == 3


def test_pickled_trajectory_keeps_its_span_of_motion() -> None:
    still = Trajectory(axes=("X",), blocks=Stream.of([block(0.0, 0.0)]))
    assert still.moves_s == (0.0, 0.0) and still.duration_s == 0.5
    there = pickle.loads(pickle.dumps(still))
    assert there.moves_s == (0.0, 0.0) and len(list(there)) == 1
