"""Averages over time, compared with closed forms of a kernel of boxes and a B-spline."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.interpolate import BSpline

from threadline.errors import OptionError
from threadline.files import Stream
from threadline.jobs.operations import Dwell, Job, Move, SetOutput, Source
from threadline.motion.timing import Trajectory, TrajectoryBlock, TrajectoryReader
from threadline.motion.timing.averaged import (
    STEPS,
    averaged_trajectory,
    even_averages,
    held_trajectory,
)

WIDTH = 0.04
HERE = Source("test", 1)


def motion(coefficients, duration, operation=None):
    """Return pieces one after the other; coefficients (n, order, axes)."""
    duration = np.asarray(duration, dtype=float)
    return Trajectory(
        axes=("X", "Y"),
        blocks=Stream.of(
            [
                TrajectoryBlock(
                    start_s=np.concatenate([[0.0], np.cumsum(duration)[:-1]]),
                    duration_s=duration,
                    coefficients=np.asarray(coefficients, dtype=float),
                    operation=np.arange(len(duration)) if operation is None else operation,
                )
            ]
        ),
    )


def job(*operations):
    return Job(
        name="t", file="t", sha256="", axes=("X", "Y"), start=(0.0, 0.0),
        operations=Stream.of(operations),
    )  # fmt: skip


def corner(v=0.2, time=0.3):
    """Return X, then Y at even speed, with rests before, between and after."""
    way = v * time
    pieces = [[[0, 0], [0, 0]], [[0, 0], [way, 0]], [[way, 0], [0, way]], [[way, way], [0, 0]]]
    return motion(pieces, [0.1, time, time, 0.1])


def kernel(t, step):
    """Four discrete boxes of nine samples, then a quintic B-spline."""
    weights = np.ones(1)
    for _ in range(4):
        weights = np.convolve(weights, np.ones(9) / 9)
    shape = BSpline.basis_element(np.arange(-3.0, 4.0), extrapolate=False)
    at = t / step - np.arange(-16, 17)
    return float(weights @ np.nan_to_num(shape(at))) / step


def test_corner_is_cut_by_the_mean_of_the_kernel():
    """v E|t| sin(turn / 2), the mean by quadrature; straight parts stay in place."""
    step = WIDTH / STEPS
    mean = 2 * quad(lambda t: t * kernel(t, step), 0, WIDTH / 2, limit=200, epsrel=1e-10)[0]
    assert mean / WIDTH == pytest.approx(0.1109, abs=1e-4)  # as the docstring states
    smooth = averaged_trajectory(corner(), even_averages(WIDTH))
    middle = smooth(np.array([0.4]))[0]
    away = np.linalg.norm(middle - [0.06, 0.0])
    # Samples every 1.05 ms see the kink off by about v step^2 kernel(0) / 6 = 2.7 um.
    assert away == pytest.approx(0.2 * mean * np.sin(np.pi / 4), abs=3e-6)
    even = np.array([0.25, 0.55])
    np.testing.assert_allclose(smooth(even), corner()(even), atol=1e-12)
    np.testing.assert_allclose(smooth(even, 1), [[0.2, 0], [0, 0.2]], atol=1e-9)


def test_parabola_is_raised_by_half_its_variance():
    """The mean of a t^2 / 2 is a (t^2 + sigma^2) / 2; boxes of n samples have (n^2 - 1) / 12."""
    a, step = 3.0, WIDTH / STEPS
    smooth = averaged_trajectory(
        motion([[[0, 0], [0, 0], [a / 2, 0]]], [1.0]), even_averages(WIDTH)
    )
    variance = (4 * (81 - 1) / 12 + 6 / 12) * step**2
    t = np.array([0.4, 0.5, 0.6])
    expected = a * (t**2 + variance) / 2
    np.testing.assert_allclose(smooth(t)[:, 0], expected, rtol=1e-12)


def test_four_derivatives_are_continuous_and_true():
    smooth = averaged_trajectory(corner(), even_averages(WIDTH))
    step = WIDTH / STEPS
    joints = np.arange(300, 500) * step
    for order in range(5):
        block = next(iter(smooth))
        before = block.evaluate(joints - 1e-9 * step, order)
        after = block.evaluate(joints + 1e-9 * step, order)
        size = np.abs(after).max()
        np.testing.assert_allclose(before, after, atol=1e-6 * size)
    h = 1e-5
    t = np.linspace(0.35, 0.45, 97)
    for order in range(4):
        slope = (smooth(t + h, order) - smooth(t - h, order)) / (2 * h)
        expected = smooth(t, order + 1)
        np.testing.assert_allclose(slope, expected, atol=2e-3 * np.abs(expected).max())


def test_operations_change_where_they_did():
    blocks = list(averaged_trajectory(corner(), even_averages(WIDTH)))
    operation = np.concatenate([b.operation for b in blocks])
    start = np.concatenate([b.start_s for b in blocks])
    changes = start[np.flatnonzero(np.diff(operation)) + 1]
    np.testing.assert_allclose(changes, [0.1, 0.4, 0.7], atol=WIDTH / STEPS)


@pytest.mark.parametrize("between", [SetOutput("valve", 1.0, HERE), Dwell(0.05, HERE)])
def test_averaged_motion_rests_for_operations_that_need_it(between):
    """The load stands still in the middle of the rest; an empty dwell rounds the corner."""
    pieces = [[[0, 0], [0.06, 0]], [[0.06, 0], [0, 0.06]]]
    path = motion(pieces, [0.3, 0.3], operation=np.array([0, 2]))
    moves = Move((0.06, 0), None, HERE), Move((0.06, 0.06), None, HERE)
    held = held_trajectory(path, job(moves[0], between, moves[1]), WIDTH, 0.1, 0.2)
    assert held.duration_s == pytest.approx(0.6 + 0.3 + WIDTH)
    smooth = averaged_trajectory(held, even_averages(WIDTH))
    rest = np.array([0.4 + WIDTH / 2])
    np.testing.assert_allclose(smooth(rest)[0], [0.06, 0.0], atol=1e-12)
    np.testing.assert_allclose(smooth(rest, 1)[0], [0.0, 0.0], atol=1e-12)
    through = held_trajectory(path, job(moves[0], Dwell(0.0, HERE), moves[1]), WIDTH, 0.1, 0.2)
    assert through.duration_s == pytest.approx(0.6 + 0.3)
    assert (
        np.abs(averaged_trajectory(through, even_averages(WIDTH))(np.array([0.4]), 1)).min() > 0.05
    )


def test_reader_gives_the_same_in_bounded_memory():
    smooth = averaged_trajectory(
        held_trajectory(corner(), job(), WIDTH, 0.1, 0.1), even_averages(WIDTH)
    )
    cut = Trajectory(
        axes=smooth.axes,
        blocks=Stream.of(
            [
                TrajectoryBlock(
                    start_s=b.start_s[k : k + 50],
                    duration_s=b.duration_s[k : k + 50],
                    coefficients=b.coefficients[k : k + 50],
                    operation=b.operation[k : k + 50],
                )
                for b in smooth
                for k in range(0, len(b), 50)
            ]
        ),
    )
    reader = TrajectoryReader(cut)
    for begin in np.arange(-0.1, 1.3, 0.1):
        t = begin + np.linspace(0, 0.099, 40)
        derivatives = reader.derivatives(t, 3)
        reader.drop(float(t[-1]))
        for order in range(3):
            expected = smooth(t, order)
            expected[(t < 0) | (t > smooth.duration_s)] *= 1.0 if order == 0 else 0.0
            np.testing.assert_allclose(derivatives[:, order], expected, atol=1e-12)


def test_a_motion_that_begins_and_ends_at_speed_stands_before_and_after_it():
    """The motion of a historical controller does so: 2 m/s from the first instant to the last."""
    block = TrajectoryBlock(
        start_s=np.array([0.0]),
        duration_s=np.array([1.0]),
        coefficients=np.array([[[3.0], [2.0]]]),
        operation=np.array([0]),
    )
    moving = Trajectory(axes=("X",), blocks=Stream.of([block]))
    derivatives = TrajectoryReader(moving).derivatives(np.array([-0.5, 0.0, 0.25, 1.0, 1.5]), 2)
    assert derivatives[:, 0, 0].tolist() == [3.0, 3.0, 3.5, 5.0, 5.0]
    assert derivatives[:, 1, 0].tolist() == [0.0, 2.0, 2.0, 2.0, 0.0]


def long_blocks(count, length):
    """Yield blocks of a second each, of equal pieces, one after the other."""
    for number in range(count):
        yield TrajectoryBlock(
            start_s=number + np.arange(length) / length,
            duration_s=np.full(length, 1.0 / length),
            coefficients=np.full((length, 4, 2), float(number)),
            operation=np.zeros(length, dtype=np.int64),
        )


def test_reader_holds_the_blocks_around_an_instant_alone():
    """Sixty blocks of a megabyte: at most four exist at once, being made, read and checked."""
    count, length = 60, 12_000
    reader = TrajectoryReader(
        Trajectory(axes=("X", "Y"), blocks=Stream(long_blocks, count, length))
    )
    tracemalloc.start()
    for begin in np.arange(0.0, count, 0.5):
        derivatives = reader.derivatives(begin + np.array([0.1, 0.2]), 2)
        assert derivatives[0, 0, 0] >= np.floor(begin)
        reader.drop(begin)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 6e6


@pytest.mark.parametrize("blocks", [1, 2])
def test_velocity_at_a_step_is_the_value_after_it(blocks):
    """Wherever the blocks are cut: 1 m/s up to the first second, 2 m/s from then on."""
    whole = TrajectoryBlock(
        start_s=np.array([0.0, 1.0]),
        duration_s=np.array([1.0, 1.0]),
        coefficients=np.array([[[0.0], [1.0]], [[1.0], [2.0]]]),
        operation=np.array([0, 0]),
    )
    cut = [
        TrajectoryBlock(
            start_s=whole.start_s[k],
            duration_s=whole.duration_s[k],
            coefficients=whole.coefficients[k],
            operation=whole.operation[k],
        )
        for k in ([slice(0, 2)] if blocks == 1 else [slice(0, 1), slice(1, 2)])
    ]
    motion = Trajectory(axes=("X",), blocks=Stream.of(cut))
    assert motion([0.0, 0.5, 1.0, 1.5], 1)[:, 0].tolist() == [1.0, 1.0, 2.0, 2.0]
    assert motion([0.5, 1.0, 1.5])[:, 0].tolist() == [0.5, 1.0, 2.0]


def test_no_width_is_refused():
    with pytest.raises(OptionError, match="must be above 0 s"):
        averaged_trajectory(corner(), even_averages(0.0))
