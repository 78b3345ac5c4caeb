"""Averages with their own weights for starts and stops, compared with a convolution by hand."""

from __future__ import annotations

import numpy as np
import pytest

from threadline.base.arrays import FloatArray
from threadline.files import Stream
from threadline.motion.timing import Averages, Trajectory, TrajectoryBlock, averaged_trajectory
from threadline.motion.timing.averaged import averaging_weights

STEP_S = 0.001


def still_then(speeds: FloatArray, *, chunk: int) -> Trajectory:
    """Return pieces of 50 ms at each speed, in blocks of ``chunk``."""
    way = np.concatenate([[0.0], np.cumsum(speeds * 0.05)])
    starts = np.arange(len(speeds)) * 0.05
    coefficients = np.stack([way[:-1], np.diff(way)], axis=1)[:, :, None]
    blocks = [
        TrajectoryBlock(
            start_s=starts[k : k + chunk],
            duration_s=np.full(len(starts[k : k + chunk]), 0.05),
            coefficients=coefficients[k : k + chunk],
            operation=np.zeros(len(starts[k : k + chunk]), dtype=np.int64),
        )
        for k in range(0, len(starts), chunk)
    ]
    return Trajectory(axes=("X",), blocks=Stream.of(blocks))


@pytest.fixture
def averages() -> Averages:
    even = averaging_weights()
    ramp = np.arange(len(even)) - len(even) // 2
    bump = np.convolve(np.diff(even, 2), [1.0, -3.0, 3.0, -1.0])[: len(even)]
    bump -= bump.mean()
    bump -= ramp * (bump @ ramp) / (ramp @ ramp)
    bump *= 0.3 / np.abs(bump).max()
    return Averages(
        weights=even[:, None],
        step_s=STEP_S,
        starts=(even + bump)[:, None],
        stops=(even - 0.5 * bump)[:, None],
    )


def response(weights: FloatArray, after_s: FloatArray) -> FloatArray:
    """Return the position after a step of velocity by 1; averages are the spline's controls."""
    from scipy.interpolate import BSpline

    middle = len(weights) // 2
    number = np.arange(-200, 400)
    ramp = np.maximum(number, 0) * STEP_S
    controls = np.array(
        [sum(w * ramp[i + k - middle] for k, w in enumerate(weights)) for i in range(50, 550)]
    )
    knots = (np.arange(len(controls) + 6) + number[50] - 3.0) * STEP_S
    return np.asarray(BSpline(knots, controls, 5)(after_s))


@pytest.mark.parametrize("chunk", [1, 3, 20])
def test_each_end_has_its_own_weights(averages: Averages, chunk: int) -> None:
    speeds = np.array([0, 0, 0.1, 0.1, 0.15, 0.15, 0, 0, -0.2, -0.2, 0, 0, 0.0])
    moved = averaged_trajectory(still_then(speeds, chunk=chunk), averages)
    t = np.linspace(0.06, 0.53, 2_000)
    even, starts, stops = (
        np.asarray(weights)[:, 0] for weights in (averages.weights, averages.starts, averages.stops)
    )
    expected = np.zeros(len(t))
    for at_s, by, weights in (
        (0.1, 0.1, starts),
        (0.2, 0.05, even),  # from one speed to another
        (0.3, -0.15, stops),
        (0.4, -0.2, starts),
        (0.5, 0.2, stops),
    ):
        # 1 ms apart on the clock of the samples: near steps as computed, far from them a line.
        far = np.where(t - at_s > 0.1, t - at_s, 0.0)
        near = np.where(np.abs(t - at_s) <= 0.1, response(weights, np.clip(t - at_s, -0.1, 0.1)), 0)
        expected += by * (far + near)
    np.testing.assert_allclose(moved(t)[:, 0], expected, atol=1e-12)
    # The test can fail: the plain averages differ.
    plain = averaged_trajectory(
        still_then(speeds, chunk=chunk), Averages(weights=averages.weights, step_s=STEP_S)
    )
    assert np.abs(plain(t)[:, 0] - expected).max() > 1e-5


def test_weights_of_another_shape_are_refused(averages: Averages) -> None:
    with pytest.raises(ValueError, match="starts must have the shape of weights"):
        Averages(weights=averages.weights, step_s=STEP_S, starts=np.ones((3, 1)) / 3)
