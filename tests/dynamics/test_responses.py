"""Responses of plants and controllers against hand-written formulas and an integrator."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from threadline.dynamics.analysis import loop_figures
from threadline.dynamics.loop import axis_loop, axis_loops
from threadline.dynamics.poles import closed_poles
from threadline.dynamics.sampled import StateSpace, digital_filter, sample
from threadline.dynamics.values import Values
from threadline.machine import load_machine

from . import reference as ref

OMEGA = 2 * np.pi * np.geomspace(0.1, 200, 300)


@pytest.mark.parametrize(("axis", "numbers"), [("X", ref.X), ("Y", ref.Y)])
def test_response_is_the_hand_written_one(axis, numbers):
    """The bar of 1e-9 is rounding; the printed r/N in the file has 7 digits: 1e-6."""
    loop = axis_loop(load_machine("stitcher"), axis)
    filters = ref.FILTERS["stitcher-rigid"][axis]
    expected = ref.open_loop(numbers, *filters, OMEGA)
    np.testing.assert_allclose(loop.response(OMEGA, "continuous"), expected, rtol=2e-6)
    s = 1j * OMEGA
    head = ref.motor_angle(numbers, s, load=True) / ref.motor_angle(numbers, s) / ref.RATIO
    pair = loop.plant.select([loop.plant.inputs[loop.index]], [f"{axis}.load", f"{axis}.measured"])
    load, measured = pair.response(OMEGA)[:, :, 0].T
    np.testing.assert_allclose(load / measured, head, rtol=2e-6)


@pytest.mark.parametrize("delay_s", [0.0, 0.3e-3, 1e-3, 2.7e-3])
def test_sampled_plant_is_the_plant_integrated_tick_by_tick(delay_s):
    """Held commands arrive late by a fraction of a tick; DOP853 between the arrivals."""
    A = np.array([[0.0, 1.0], [-(40.0**2), -8.0]])
    B, C = np.array([[0.0], [3.0]]), np.array([[1.0, 0.2]])
    plant = StateSpace(
        A=A, B=B, C=C, D=np.zeros((1, 1)), delay_s=np.array([delay_s]),
        states=("a", "b"), inputs=("u",), outputs=("y",),
    )  # fmt: skip
    tick = 1e-3
    sampled = sample(plant, tick)
    commands = np.random.default_rng(7).normal(size=40)

    def input_at(t):
        k = int(np.floor((t - delay_s) / tick + 1e-9))
        return commands[k] if 0 <= k < len(commands) else 0.0

    edges = np.unique(
        np.round(
            np.concatenate([np.arange(40) * tick, np.arange(-3, 40) * tick + delay_s % tick]), 12
        )
    )
    edges = edges[(edges >= 0) & (edges <= 39 * tick + 1e-12)]
    x, at_ticks = np.zeros(2), [0.0]
    for first, last in pairwise(edges):
        u = input_at(0.5 * (first + last))
        done = solve_ivp(
            lambda _t, y, u=u: A @ y + B[:, 0] * u,
            (first, last),
            x,
            "DOP853",
            rtol=1e-12,
            atol=1e-14,
        )
        x = done.y[:, -1]
        if abs(last / tick - round(last / tick)) < 1e-6:
            at_ticks.append(float(C[0] @ x))
    mine, state = [], np.zeros(2)
    late = sampled.ticks[0]
    for k in range(40):
        mine.append(float(sampled.C[0] @ state))
        newer = commands[k - late] if k >= late else 0.0
        older = commands[k - late - 1] if k > late else 0.0
        state = (
            sampled.transition @ state + sampled.newer[:, 0] * newer + sampled.older[:, 0] * older
        )
    assert max(map(abs, mine)) > 1e-3
    np.testing.assert_allclose(mine, at_ticks, atol=1e-12)
    omega = np.array([3.0, 50.0, 900.0])
    z = np.exp(1j * omega * tick)
    by_sum = []
    for zz in z:
        held = sampled.newer[:, 0] * zz**-late + sampled.older[:, 0] * zz ** -(late + 1)
        by_sum.append(sampled.C[0] @ np.linalg.solve(zz * np.eye(2) - sampled.transition, held))
    np.testing.assert_allclose(sampled.response(omega)[:, 0, 0], by_sum, rtol=1e-12)


def test_closed_sampled_loop_is_the_machine_integrated():
    """A step of 20 counts on X: 150 ticks by DOP853 with the filter and its dead time by hand."""
    loop = axis_loop(load_machine("stitcher"), "X")
    closed = loop.closed()
    mine = closed.respond(np.full((150, 1), 20.0))[:, closed.outputs.index("X.load")]
    by_hand = ref.simulate_x(*ref.FILTERS["stitcher-rigid"]["X"], 20.0, 150)
    assert by_hand[-1] > 2e-5
    # 1e-6 relative: the printed r/N has seven digits in the file.
    np.testing.assert_allclose(mine, by_hand, atol=2e-6 * by_hand.max())


def test_winder_poles_of_the_printed_form():
    """1772 x 0.45 (1 + 0.005 s) / (s (s + 46.7)): -25.3 +- 12.5j, not the printed real poles."""
    machine = load_machine("lathe-winder")
    values = Values.of(
        machine, {"controllers.x.kp": np.array([1.0]), "controllers.x.kd": np.array([1.0])}
    )
    poles = closed_poles(axis_loops(machine, values, hold=False)["X"])
    exact = np.roots([1, 46.7 + 1772 * 0.45 * 0.005, 1772 * 0.45])
    # The file's inertia has four digits: 0.5 % on the imaginary part.
    assert poles[0].real == pytest.approx(exact[0].real, abs=0.05)
    assert abs(poles[0].imag) == pytest.approx(abs(exact[0].imag), abs=0.1)
    assert (round(poles[0].real, 1), round(abs(poles[0].imag), 0)) == (-25.3, 12.0)


@pytest.mark.parametrize("kind", ["p", "pi", "pid"])
def test_controllers_follow_their_difference_equations(kind, tmp_path):
    """The response by formula, against the difference equation run on a sine."""
    gains = {"p": 'kp = "2 dac/count exact, assumed"'}
    gains["pi"] = gains["p"] + '\nki = "0.05 dac/count exact, assumed"'
    gains["pid"] = gains["pi"] + '\nkd = "3 dac/count exact, assumed"'
    file = tmp_path / "m.toml"
    dropped = "" if kind == "pid" else 'kd = "none"\n'
    file.write_text(
        f'base = "lathe-winder"\n[controllers.x]\nkind = "{kind}"\n{dropped}{gains[kind]}\n'
    )
    machine = load_machine(str(file))
    digital = digital_filter(machine, "x")
    omega, tick = 20.0, 5e-3
    kp, ki, kd = 2.0, 0.05 if kind != "p" else 0.0, 3.0 if kind == "pid" else 0.0
    level = 20 / 4096
    expected = level * (
        kp + ki / (1 - np.exp(-1j * omega * tick)) + kd * (1 - np.exp(-1j * omega * tick))
    )
    assert digital.sampled_response(np.array([omega]))[0] == pytest.approx(expected, rel=1e-12)
    slow = np.array([0.5])
    assert digital.continuous_response(slow)[0] == pytest.approx(
        digital.sampled_response(slow)[0], rel=5e-3
    )
    figures = loop_figures(axis_loop(machine, "X"), "sampled")
    assert figures.unstable == loop_figures(axis_loop(machine, "X"), "continuous").unstable
