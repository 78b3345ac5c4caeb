"""The stitcher thesis's own figures, from the machine files."""

from __future__ import annotations

import numpy as np
import pytest
from tools import claims

from threadline.dynamics.analysis import actuator_of, analyse, analyse_axis, loop_figures
from threadline.dynamics.linear_model import free_modes, locked_modes
from threadline.dynamics.loop import axis_loop, axis_loops
from threadline.dynamics.poles import closed_poles
from threadline.dynamics.responses import step_response
from threadline.dynamics.values import Values
from threadline.machine import load_machine

from . import reference as ref

INCH = 25.4e-3


@pytest.mark.parametrize(("axis", "omega"), [("X", 500.0), ("Y", 400.0)])
def test_actuators(axis, omega):
    """500 and 400 rad/s, 0.7, 42 rad/s/V (40.5 on Y with the printed amplifier gain of 42)."""
    found = actuator_of(load_machine("stitcher"), axis)
    assert found.natural_rad_s == pytest.approx(omega, rel=0.01)
    assert found.damping == pytest.approx(0.7, abs=0.01)
    assert found.dc_gain == pytest.approx(42, rel=0.04)
    p = ref.X if axis == "X" else ref.Y
    exact = p["Ka"] * ref.KT / (ref.R * p["B"] + ref.KT * ref.KV)
    assert found.dc_gain == pytest.approx(exact, rel=1e-9)
    loaded = p["Ka"] * ref.KT / (ref.R * (p["B"] + p["b"] * ref.RATIO**2) + ref.KT * ref.KV)
    assert found.loaded_dc_gain == pytest.approx(loaded, rel=1e-6)
    # The low-frequency speed per volt of the whole model agrees.
    loop = axis_loop(load_machine("stitcher"), axis)
    slow = np.array([1e-3])
    speed = abs(loop.plant_response(slow, "continuous")[0]) * 1e-3 / ref.COUNTS
    assert speed == pytest.approx(found.loaded_dc_gain, rel=1e-6)


def test_locked_modes():
    """11.93 Hz with 0.200 on X; 16.5 and 30.9 Hz on Y (printed 12, 15 and 30)."""
    machine = load_machine("stitcher")
    (x,) = locked_modes(machine, "X")
    assert x.frequency_hz == pytest.approx(np.sqrt(6.24e5 / 111) / (2 * np.pi), rel=1e-12)
    assert x.damping == pytest.approx(3330 / (2 * np.sqrt(6.24e5 * 111)), rel=1e-9)
    assert (round(x.frequency_hz, 2), round(x.damping, 3)) == (11.93, 0.2)
    low, high = locked_modes(machine, "Y")
    assert (round(low.frequency_hz, 1), round(high.frequency_hz, 1)) == (16.5, 30.9)
    assert locked_modes(load_machine("lathe-winder"), "X") == ()
    (free,) = free_modes(machine, "X")
    exact = np.sqrt(6.24e5 * (1 / 111 + ref.RATIO**2 / 4.75e-4)) / (2 * np.pi)
    assert free.frequency_hz == pytest.approx(exact, rel=1e-6)


@pytest.mark.parametrize(
    ("name", "axis", "bandwidth"),
    [
        ("stitcher-rigid", "X", 33),
        ("stitcher-rigid", "Y", 36),
        ("stitcher-rigid-half-mass", "X", 39),
        ("stitcher-rigid-half-mass", "Y", 38),
    ],
)
def test_bandwidths(name, axis, bandwidth):
    """Within 8 % of print, sampled and continuous, and exactly at -3 dB."""
    loop = axis_loop(load_machine(name), axis)
    for model in ("sampled", "continuous"):
        found = loop_figures(loop, model).bandwidth_hz
        assert found == pytest.approx(bandwidth, rel=0.08)
        L = loop.response(np.array([2 * np.pi * found]), model)[0]
        assert abs(L / (1 + L)) == pytest.approx(2**-0.5, rel=1e-6)


@pytest.mark.parametrize(
    ("axis", "gain", "zero", "crossover", "margin"),
    [("X", 178, 175, 13.5, 65.8), ("Y", 170, 200, 15.0, 64.7)],
)
def test_printed_lead_filters_cross_where_they_should(axis, gain, zero, crossover, margin):
    """178 (s + 175) / (s + 14821) and 170 (s + 200) / (s + 14821) V/rad, through Tustin's rule."""
    half = ref.TICK / 2
    A, B = (1 - zero * half) / (1 + zero * half), (14821 * half - 1) / (14821 * half + 1)
    K = gain / (ref.VOLTS * ref.COUNTS) * (1 - B) / (1 + A)
    name = axis.lower()
    machine = load_machine("stitcher-rigid")
    values = Values.of(
        machine,
        {
            f"controllers.{name}.{key}": np.array([v])
            for key, v in (("gain", K), ("zero", A), ("pole", B))
        },
    )
    worst = loop_figures(axis_loop(machine, axis, values), "sampled").margins.worst_phase
    assert worst.omega_rad_s / (2 * np.pi) == pytest.approx(crossover, abs=0.05)
    assert worst.phase_margin_deg == pytest.approx(margin, abs=0.06)


def test_lead_cannot_move_the_poles_of_the_load():
    """With the encoder on the motor, no gain or zero damps the load's poles beyond 0.4."""
    machine = load_machine("stitcher")
    for zero in (0.95, 0.976, 0.99):
        values = Values.of(machine, {"controllers.x.zero": np.array([zero])})
        loop = axis_loops(machine, values)["X"]
        for gain in (0.02, 0.2, 1.0, 2.0):
            poles = closed_poles(loop, gain, 400.0)
            near = poles[np.argmin(np.abs(poles - 75j))]
            assert -near.real / abs(near) < 0.4
            assert 60 < abs(near) < 85


def test_critical_gain_with_feedback_from_the_head():
    """A critical gain appears below the printed gain; by hand from the transfer function."""
    loop = axis_loop(load_machine("stitcher+head-feedback"), "X")
    found = loop_figures(loop, "continuous")
    gain, _ = ref.dense_margins(
        lambda w: 0.5 * ref.open_loop(ref.X, 0.89, 0.976, 0.004, w, load=True) / ref.RATIO,
        5.0,
        500.0,
    )
    assert not found.stable and found.gain_margin == pytest.approx(0.5 * gain, rel=1e-5)
    assert found.gain_margin == pytest.approx(0.623, abs=1e-3)
    on_motor = analyse_axis(load_machine("stitcher"), "X")
    assert on_motor.stable and on_motor.sampled.gain_margin > 2


def corner(kp_v_rad: float) -> tuple[float, float]:
    """Return the miss of a right-angle corner and the worst overshoot in mm, linear rigid model."""
    found = claims.stitcher_proportional(str(kp_v_rad))
    return 1e3 * found["missed_m"], 1e3 * max(found["overshot_m"])


def test_proportional_control_study():
    """Low gain cuts the corner, high gain overshoots; the least of both lies near 2 V/rad."""
    tried = (0.5, 1.0, 1.5, 1.75, 2.0, 2.5, 3.0, 4.0)
    found = {kp: corner(kp) for kp in tried}
    assert found[0.5][0] > 4.0 and found[0.5][1] < 0.01
    assert found[4.0][1] > 1.0 and found[4.0][0] < 0.15
    misses, overshoots = zip(*found.values(), strict=True)
    assert list(misses) == sorted(misses, reverse=True) and list(overshoots) == sorted(overshoots)
    best = min(found, key=lambda kp: max(found[kp]))
    assert best in {1.75, 2.0}


@pytest.mark.parametrize(("eighths", "inches"), [(3, 0.23), (4, 0.30), (5, 0.38), (6, 0.45)])
def test_head_steps(eighths, inches):
    """3 pi/8 ... 3 pi/4 rad of the motor; 3 % because 29 mm and 1.16 in are both printed."""
    for axis in "XY":
        step = step_response(axis_loop(load_machine("stitcher"), axis), "load")
        head = step.final * eighths * np.pi / 8 * ref.RATIO / INCH
        assert head == pytest.approx(inches, rel=0.03)
        assert 0.25 < step.overshoot < 0.4
        motor = step_response(axis_loop(load_machine("stitcher"), axis), "measured")
        assert motor.overshoot < 0.1 and abs(motor.steady_state_error) < 1e-9


def test_winder_is_analysed_too():
    """PD on counts at 5 ms: stable, about 125 ms without much overshoot, as the thesis chose."""
    found = analyse(load_machine("lathe-winder"))
    assert list(found) == ["A", "X", "Y"] and all(a.stable for a in found.values())
    x = found["X"].steps["measured"]
    assert x.settling_s == pytest.approx(0.122, rel=0.05) and x.overshoot < 0.05
    assert found["X"].actuator.poles[0] == pytest.approx(-46.7, abs=0.05)
    assert found["X"].as_json()["modes_hz"] == []


@pytest.mark.long(shown_by="test_proportional_control_study")
def test_no_unclipped_command_serves_nine_machines_at_55_stitches_a_second() -> None:
    """A bound above the speed of ``stitcher-robust.seam.toml``'s plan at 42 would be wrong."""
    assert claims.stitcher_two_stitches("55")["least_error"] > 0.07
    assert claims.stitcher_two_stitches("42")["least_error"] < 0.04
