from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from threadline.errors import LimitError
from threadline.files import Stream
from threadline.jobs.operations import Feed
from threadline.machine import load_machine
from threadline.motion.path import plan_path, programmed_path
from threadline.motion.timing import (
    Trajectory,
    TrajectoryBlock,
    check_limits,
    limit_peaks,
    plan_trajectory,
)

from ..path.builders import COUNTS, job_of

WINDER = load_machine("lathe-winder")


def trajectory_of(coefficients, durations, *, historical=False):
    """One axis, X, from its pieces."""
    duration = np.array(durations, dtype=float)
    block = TrajectoryBlock(
        start_s=np.concatenate([[0.0], np.cumsum(duration)[:-1]]),
        duration_s=duration,
        coefficients=np.array(coefficients, dtype=float)[:, :, None],
        operation=np.arange(len(duration)),
    )
    return Trajectory(axes=("X",), blocks=Stream.of([block]), historical=historical)


def peak(peaks, quantity):
    return next(p for p in peaks if p.quantity == quantity)


def test_extremes_within_a_piece_are_exact():
    """0.1 m by the law 10 u^3 - 15 u^4 + 6 u^5 in 0.5 s: Cv 15/8, Ca 10/sqrt 3, Cj 60."""
    piece = [0, 0, 0, 1.0, -1.5, 0.6]
    peaks = limit_peaks(trajectory_of([piece], [0.5]), WINDER)
    assert abs(peak(peaks, "velocity").value_si) == pytest.approx(0.1 * 15 / 8 / 0.5, rel=1e-12)
    acceleration = abs(peak(peaks, "acceleration").value_si)
    assert acceleration == pytest.approx(0.1 * 10 / np.sqrt(3) / 0.25, rel=1e-12)
    assert abs(peak(peaks, "jerk").value_si) == pytest.approx(0.1 * 60 / 0.125, rel=1e-12)
    assert peak(peaks, "velocity").time_s == pytest.approx(0.25)
    assert peak(peaks, "travel").value_si == pytest.approx(0.1)


@given(st.lists(st.lists(st.floats(-1, 1), min_size=6, max_size=6), min_size=1, max_size=5))
def test_no_dense_sample_exceeds_the_peak(coefficients):
    """And a dense sample reaches the peak, to the square of its spacing."""
    trajectory = trajectory_of(coefficients, [0.3] * len(coefficients), historical=True)
    peaks = limit_peaks(trajectory, WINDER)
    u = np.linspace(0, 1, 2001)
    for order, quantity in ((0, "travel"), (1, "velocity")):
        found = peak(peaks, quantity)
        if not np.isfinite(found.value_si):
            continue
        c = np.array(coefficients).T
        for _ in range(order):
            c = c[1:] * np.arange(1, len(c))[:, None] / 0.3
        dense = np.abs(np.polynomial.polynomial.polyval(u, c)).max()
        scale = 1.0 + np.abs(c).sum()
        assert dense <= abs(found.value_si) + 1e-9 * scale
        assert abs(found.value_si) <= dense + 1e-5 * scale


def test_steps_count_as_infinite():
    """A start at full speed is an infinite acceleration; a step of acceleration, infinite jerk."""
    sudden = limit_peaks(trajectory_of([[0, 0.1]], [1.0]), WINDER)
    assert peak(sudden, "acceleration").value_si == np.inf
    assert peak(sudden, "jerk").value_si == np.inf
    parabolas = trajectory_of([[0, 0, 0.05], [0.05, 0.1, -0.05]], [1.0, 1.0])
    peaks = limit_peaks(parabolas, WINDER)
    assert peak(peaks, "acceleration").value_si == pytest.approx(0.1)
    assert peak(peaks, "jerk").value_si == np.inf


def test_an_end_at_speed_counts_as_infinite_acceleration():
    """c u^3 begins at rest without a step; it ends at 3 c a second."""
    peaks = limit_peaks(trajectory_of([[0, 0, 0, 0.02]], [1.0]), WINDER)
    for quantity in ("acceleration", "jerk"):
        assert peak(peaks, quantity).value_si == np.inf
        assert peak(peaks, quantity).time_s == pytest.approx(1.0)
    assert peak(peaks, "velocity").value_si == pytest.approx(0.06)


@pytest.mark.parametrize("per_block", [1, 2])
def test_a_step_of_acceleration_alone_counts_as_infinite_jerk(per_block):
    """c u^3, then its mirror image: at rest at both ends, 6 c and then -6 c half-way."""
    c = 0.02
    whole = next(iter(trajectory_of([[0, 0, 0, c], [c, 3 * c, -3 * c, c]], [1.0, 1.0])))
    blocks = [
        TrajectoryBlock(
            start_s=whole.start_s[k : k + per_block],
            duration_s=whole.duration_s[k : k + per_block],
            coefficients=whole.coefficients[k : k + per_block],
            operation=whole.operation[k : k + per_block],
        )
        for k in range(0, 2, per_block)
    ]
    peaks = limit_peaks(Trajectory(axes=("X",), blocks=Stream.of(blocks)), WINDER)
    assert abs(peak(peaks, "acceleration").value_si) == pytest.approx(6 * c)
    assert peak(peaks, "jerk").value_si == np.inf
    assert (peak(peaks, "jerk").time_s, peak(peaks, "jerk").operation) == (1.0, 1)


def test_breaking_a_limit_is_an_error_that_names_it():
    """0.1 m in 50 ms needs 3.75 m/s of X, which has 1 m/s."""
    fast = trajectory_of([[0, 0, 0, 1.0, -1.5, 0.6]], [0.05])
    with pytest.raises(LimitError, match=r"axis X.*velocity.*3\.75 m/s.*limit is 1 m/s") as caught:
        check_limits(fast, WINDER)
    assert caught.value.axis == "X"
    slower = trajectory_of([[0, 0, 0, 1.0, -1.5, 0.6]], [0.6])
    assert all(p.ratio < 1 for p in check_limits(slower, WINDER))


def test_a_limit_holds_to_a_thousandth_anywhere():
    """The law 10 u^3 - 15 u^4 + 6 u^5 reaches 15/8 h / T half-way, where no piece ends."""
    for share, refused in ((1.0009, False), (1.0011, True)):
        trajectory = trajectory_of([[0, 0, 0, 1.0, -1.5, 0.6]], [0.1 * 15 / 8 / share])
        peaks = limit_peaks(trajectory, wide(acceleration=1e3, jerk=1e6))
        assert peak(peaks, "velocity").ratio == pytest.approx(share, rel=1e-9)
        if refused:
            with pytest.raises(LimitError, match="velocity reaches"):
                check_limits(trajectory, wide(acceleration=1e3, jerk=1e6))
        else:
            check_limits(trajectory, wide(acceleration=1e3, jerk=1e6))


def wide(**limits):
    """The winder with other limits of X, SI."""
    axis = WINDER.axes["X"]
    other = {name: replace(getattr(axis, name), si=value) for name, value in limits.items()}
    return replace(WINDER, axes={**WINDER.axes, "X": replace(axis, **other)})


def test_historical_demands_are_reported_not_refused():
    programmed = programmed_path(job_of([[0.0], [0.1]], ("X",), Feed(COUNTS, 80)), WINDER)
    for name in ("linear", "point-to-point"):
        trajectory = plan_trajectory(plan_path(programmed, WINDER, name), WINDER)
        assert peak(check_limits(trajectory, WINDER), "jerk").ratio > 1


def test_travel_counts_from_the_middle():
    """X spans -0.5 to 0.5 m: 0.4 m is 0.8 of the way to the end."""
    peaks = limit_peaks(trajectory_of([[0, 0, 0, 4.0, -6.0, 2.4]], [2.0]), WINDER)
    assert peak(peaks, "travel").ratio == pytest.approx(0.8)
    assert peak(peaks, "travel").limit_si == pytest.approx(0.5)
