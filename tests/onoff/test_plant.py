"""The letter placer's equations, compared with scipy, by hand from the paper's numbers."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from threadline.dynamics.pneumatic import (
    cylinder_equations,
    flow_mode,
    frame_mode,
    network_of,
    step_ringing,
)
from threadline.dynamics.values import Values
from threadline.errors import MachineError
from threadline.machine import Machine, load_machine
from threadline.machine.quantity import Quantity
from threadline.twin.switching_cylinder import advance, cylinders_of

M1, MC, M2, K1, K2, B1, B2 = 19.78 + 53.76, 1.0, 6.0, 2.7e4, 1e8, 24.0, 1.5
"""Table 1 of the paper; Mc is what reproduces its eigenvalues."""


class Twin:
    """One cylinder of the twin, a millisecond at a time."""

    def __init__(self, machine: Machine, axis: str) -> None:
        made = cylinders_of(machine, (axis,), Values.of(machine), 1e-3)
        self.bank, self.motion = made.bank(), made.at_rest()

    def advance(self, level: float) -> None:
        self.motion.state[0, -2] = level
        advance(0, 0, self.bank, self.motion)

    def row(self, index: int) -> float:
        return float(self.bank.rows[0, index] @ self.motion.state[0])

    @property
    def stroke_m(self) -> float:
        return self.row(0)

    @property
    def speed_m_s(self) -> float:
        return self.row(1)

    @property
    def frame_m(self) -> float:
        return self.row(2)


def by_hand(reaction: float) -> tuple[np.ndarray, np.ndarray]:
    """Return A and b of y, z, w and their rates for a force on the head; Newton's law, by hand."""
    a = np.zeros((6, 6))
    a[:3, 3:] = np.eye(3)
    a[3] = [-(K1 + K2) / M1, K2 / M1, 0, -B1 / M1, 0, 0]
    a[4] = [K2 / MC, -K2 / MC, 0, 0, -B2 / MC, B2 / MC]
    a[5] = [0, 0, 0, 0, B2 / M2, -B2 / M2]
    return a, np.array([0, 0, 0, 0, -reaction / MC, 1.0 / M2])


def test_eigenvalues_are_the_checked_ones() -> None:
    piece = network_of(load_machine("letter-placer"), "X")
    found = np.linalg.eigvals(piece.base[0][:, :6])
    expected = [-0.742 + 10067.8j, -0.171 + 19.031j, -0.25, 0.0]
    for value in expected:
        assert np.abs(found - value).min() < 0.05 if abs(value) > 100 else 6e-4
        near = found[np.argmin(np.abs(found - value))]
        assert near.real == pytest.approx(value.real, abs=6e-4)
        assert near.imag == pytest.approx(np.imag(value), abs=0.05 if abs(value) > 100 else 6e-4)
    assert np.sort_complex(found) == pytest.approx(
        np.sort_complex(np.linalg.eigvals(by_hand(1.0)[0])), abs=1e-6
    )


def test_frequency_and_damping_of_the_model() -> None:
    frequency, damping = frame_mode(load_machine("letter-placer"), "X")
    assert frequency == pytest.approx(3.029, abs=5e-4)
    assert damping == pytest.approx(0.0090, abs=5e-5)


def residual_um(a: np.ndarray, force: np.ndarray, row: np.ndarray) -> float:
    """Return the table's amplitude after 200 mm of bang-bang at 1 m/s2, exactly."""
    half = math.sqrt(0.2)
    n = len(a)
    full = np.zeros((n + 1, n + 1))
    full[:n, :n], full[:n, n] = a, force
    state = np.zeros(n + 1)
    for newton in (M2, -M2):
        state[n] = newton
        state = expm(full * half) @ state
    state[n] = 0.0
    times = np.linspace(0.0, 1.0, 100)
    table = [row @ (expm(full * t) @ state)[:n] for t in times]
    # The ringing at the end of the move, the free head's own slow mode, and a constant.
    decay = np.exp(-0.171 * times)
    columns = [decay * np.cos(19.031 * times), decay * np.sin(19.031 * times)]
    columns += [np.exp(-0.25 * times), np.ones_like(times)]
    found = np.linalg.lstsq(np.array(columns).T, np.array(table), rcond=None)[0]
    return 1e6 * float(np.hypot(found[0], found[1]))


def test_reaction_of_the_piston_is_what_shakes_the_table() -> None:
    """662 um with the reaction, 8.6 um without, for a 200 mm bang-bang at 1 m/s2."""
    plant = cylinder_equations(load_machine("letter-placer"), "X")
    n = len(plant.states) - 2
    a, force = plant.matrix[0, :n, :n], plant.force[0, :n]
    assert residual_um(a, force, plant.frame[0, :n]) == pytest.approx(662.0, rel=0.005)
    paper, single = by_hand(0.0)
    found = residual_um(paper, single, np.eye(6)[0])
    assert found == pytest.approx(8.6, rel=0.02)


def measured_stroke(reference: str) -> tuple[float, float, float, np.ndarray]:
    machine = load_machine(reference)
    cylinder = machine.cylinders["X"]
    twin = Twin(machine, "X")
    speeds = []
    for k in range(3000):
        if twin.stroke_m >= cylinder.stroke.si - 1e-3:
            speed = speeds[-1]
            left = cylinder.stroke.si - twin.stroke_m
            return cylinder.delay.si + k * 1e-3 + left / speed, max(speeds), speed, np.array(speeds)
        twin.advance(1.0)
        speeds.append(twin.speed_m_s)
    raise AssertionError


def test_valve_drive_follows_the_data_sheet() -> None:
    """0.79 s, 0.43 and 0.33 m/s and 0.38 J, to the printed digits."""
    time_s, fastest, last, speeds = measured_stroke("letter-placer+data-sheet")
    assert time_s == pytest.approx(0.79, abs=0.005)
    assert fastest == pytest.approx(0.43, abs=0.005)
    assert last == pytest.approx(0.33, abs=0.005)
    assert 0.5 * (M2 + MC) * last**2 == pytest.approx(0.38, abs=0.012)
    # Almost constant: half of the motion within 10 % of the largest speed.
    assert np.mean(speeds > 0.9 * fastest) > 0.45


def test_speed_at_full_flow_is_nearly_a_ramp_without_a_plateau() -> None:
    """A triangle is above 90 % of its peak for 10 % of the time; at 20 % flow it is half."""
    _, fastest, _, speeds = measured_stroke("letter-placer+full-flow")
    assert np.mean(speeds > 0.9 * fastest) < 0.25
    assert np.argmax(speeds) > 0.9 * len(speeds)


def test_twin_agrees_with_an_independent_integration() -> None:
    """A rigid beam, the rest by hand, LSODA at 1e-9; 1e-3 of the peak covers the beam's give."""
    machine = load_machine("letter-placer")
    plain = replace(machine.cylinders["X"], air_ramp=None)
    machine = replace(machine, cylinders={"X": plain, "Z": machine.cylinders["Z"]})
    k, c, lag, speed = 35.7e3, 300.0, 0.12, 0.43
    levels = [(0.0, 0.63), (0.17, 1.0), (0.35, 0.37), (0.5, 0.0)]

    def slope(t: float, x: np.ndarray) -> list[float]:
        y, yd, _, wd, v, e = x
        level = [b for a, b in levels if a <= t + 1e-12][-1]
        force = k * e + c * (v - (wd - yd)) - B2 * (wd - yd)
        head, table = force / M2, (-force - K1 * y - B1 * yd) / (M1 + MC)
        return [yd, table, wd, head, (speed * level - v) / lag, v - (wd - yd)]

    state, edges = np.zeros(6), [a for a, _ in levels] + [1.2]
    values = []
    for begin, end in itertools.pairwise(edges):
        grid = np.linspace(begin, end, round((end - begin) * 1000) + 1)
        done = solve_ivp(
            lambda t, x, b=begin, e=end: slope(min(max(t, b), e - 1e-9), x),
            (begin, end), state, method="LSODA", t_eval=grid, rtol=1e-9, atol=1e-12,
        )  # fmt: skip
        values.append(done.y[:, :-1])
        state = done.y[:, -1]
    expected = np.concatenate(values, axis=1)
    twin = Twin(machine, "X")
    frame, stroke = [], []
    for i in range(expected.shape[1]):
        frame.append(twin.frame_m)
        stroke.append(twin.stroke_m)
        twin.advance([b for a, b in levels if a <= i * 1e-3 + 1e-9][-1])
    peak = np.abs(expected[0]).max()
    assert peak > 2e-4
    assert np.abs(np.array(frame) - expected[0]).max() < 2e-3 * peak
    assert np.abs(np.array(stroke) - (expected[2] - expected[0])).max() < 1e-6


def test_ringing_of_a_step_is_that_of_the_twin() -> None:
    """The residue of the slowest mode equals the twin's frame motion, long after a step."""
    machine = load_machine("letter-placer")
    plain = replace(machine.cylinders["X"], air_ramp=None, stroke=Quantity(
        si=10.0, unit="m", tolerance_si=0.0, provenance=machine.cylinders["X"].stroke.provenance
    ))  # fmt: skip
    machine = replace(machine, cylinders={"X": plain, "Z": machine.cylinders["Z"]})
    ringing = step_ringing(machine, "X")
    twin = Twin(machine, "X")
    frame = []
    for _ in range(4000):
        frame.append(twin.frame_m)
        twin.advance(1.0)
    times = np.arange(2000, 4000) * 1e-3
    expected = (ringing.amplitude_m * np.exp(ringing.pole * times)).real
    found = np.array(frame[2000:])
    rest = found - expected
    # The rest is the slow push of the steady drag, b2 v / K1 = 24 um, which hardly changes.
    assert np.ptp(rest) < 0.01 * np.ptp(expected)


def test_valves_excite_a_slower_mode_than_a_free_piston() -> None:
    machine = load_machine("letter-placer")
    assert flow_mode(machine, "X")[0] == pytest.approx(
        math.sqrt(K1 / (M1 + MC + M2)) / (2 * math.pi), rel=0.01
    )


@pytest.mark.parametrize("lag_s", [1e-15, 1e-12, 1e-6])
def test_a_fast_valve_hides_no_mode(lag_s: float, tmp_path: Path) -> None:
    """The lag of a valve is before the cylinder, and rings nothing; once it was a traceback."""
    file = tmp_path / "fast.toml"
    file.write_text(f'base = "letter-placer"\ncylinders.X.lag = "{lag_s} s exact, assumed"\n')
    as_built = flow_mode(load_machine("letter-placer"), "X")
    assert flow_mode(load_machine(file), "X") == pytest.approx(as_built, rel=1e-9)


def test_a_mode_that_is_lost_beside_all_else_is_told(tmp_path: Path) -> None:
    file = tmp_path / "stiff.toml"
    file.write_text(
        'base = "letter-placer"\ncylinders.X.air_damping = "1e14 N s/m exact, assumed"\n'
    )
    with pytest.raises(MachineError, match="rates of the cylinder are ten million times as fast"):
        step_ringing(load_machine(file), "X")
