"""Loops with a state-space controller: lead filters as one, and a plant solved separately."""

from __future__ import annotations

import control
import numpy as np
import pytest

from tests.twin.test_state_space import same_as_one, swinger
from threadline.dynamics.analysis import analyse_axis
from threadline.dynamics.loop import axis_loop
from threadline.machine import load_machine


def test_lead_filters_as_one_controller_have_the_figures_of_the_filters(tmp_path):
    own = load_machine("stitcher")
    (tmp_path / "all.toml").write_text('base = "stitcher"\n' + same_as_one(own))
    one = load_machine(tmp_path / "all.toml")
    for axis in own.axes:
        first, second = analyse_axis(own, axis), analyse_axis(one, axis)
        assert second.continuous is None
        assert second.sampled.gain_margin == pytest.approx(first.sampled.gain_margin, rel=1e-6)
        worst, other = first.sampled.margins.worst_phase, second.sampled.margins.worst_phase
        assert worst is not None
        assert other is not None
        assert other.phase_margin_deg == pytest.approx(worst.phase_margin_deg, rel=1e-6)
        assert second.sampled.bandwidth_hz == pytest.approx(first.sampled.bandwidth_hz, rel=1e-6)
        assert second.steps["load"].overshoot == pytest.approx(
            first.steps["load"].overshoot, abs=1e-9
        )
        assert second.as_json()["continuous"] is None


def test_a_loop_over_three_sensors_has_the_poles_and_the_gain_of_python_control(tmp_path):
    """The plant as two bodies, held inputs, two ticks of dead time, all by python-control."""
    J, b, M, B, k, r = 4e-4, 0.02, 20.0, 150.0, 2e5, 0.005
    A = np.array(
        [
            [0.0, 0.0, 1.0, 0.0],
            [0.0, 0.0, 0.0, 1.0],
            [-k * r * r / J, k * r / J, -b / J, 0.0],
            [k * r / M, -k / M, 0.0, -B / M],
        ]
    )
    force = np.array([[0.0], [0.0], [1.0 / J], [0.0]])
    seen = np.array([[8000 / (2 * np.pi), 0, 0, 0], A[3], [0, 250.0, 0, 0]])
    plant = control.sample_system(control.ss(A, force, seen, np.zeros((3, 1))), 1e-3, "zoh")
    late = control.ss([[0, 0], [1, 0]], [[1], [0]], [[0, 1]], [[0]], 1e-3)
    volts = 20.0 / 2**16
    controller = control.ss(
        [[0.9, 0.05], [-0.02, 0.7]],
        [[-0.001, 0.02, -0.1], [-0.003, 0.0, 0.05]],
        [[0.4 * volts, 0.7 * volts]],
        [[-1.1 * volts, 0.8 * volts, -0.9 * volts]],
        1e-3,
    )
    loop = axis_loop(swinger(tmp_path), "X")
    whole = control.feedback(plant * late, controller, sign=1)
    expected, found = whole.poles(), loop.closed().eigenvalues()
    for pole in expected:
        assert np.abs(found - pole).min() < 1e-7
    omega = np.array([3.0, 40.0, 123.0, 800.0])
    around = control.frequency_response(controller * plant * late, omega).complex
    np.testing.assert_allclose(loop.response(omega), -np.ravel(around), rtol=1e-8)
