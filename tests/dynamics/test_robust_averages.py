"""Averages that leave many machines without ringing, compared with independent simulations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import optimize
from scipy.interpolate import BSpline
from scipy.optimize import OptimizeResult, linprog

from tests.second_order import states_of
from threadline.dynamics.inverse import CornerResponse, corner_responses
from threadline.dynamics.responses import answers_of
from threadline.dynamics.robust_averages import (
    ChangeOfSpeed,
    RobustWeights,
    StepOfSpeed,
    WeightGrid,
    frequencies_rad_s,
    robust_weights,
)
from threadline.errors import PlanError
from threadline.machine import load_machine
from threadline.machine.vary import corners

CHANGE_S, COUNT, SAMPLES = 0.1, 43, 4096
STEP_S = CHANGE_S / 28
GRID_S = STEP_S / 4
MODE, DAMPING = 75.0, 0.2


def change(stop: bool) -> ChangeOfSpeed:
    """The speed may change in CHANGE_S, half of it before the step and half after."""
    early_s = CHANGE_S / 4
    return ChangeOfSpeed(
        stop=stop,
        early_s=early_s,
        still_s=early_s + 0.002,
        within_s=CHANGE_S / 2,
        even_s=CHANGE_S / 2,
    )


def believed_and(factor: float) -> tuple[list[float], list[float]]:
    """Return a mode in place of the one that the inverse cancels, as polynomials in s."""
    w = MODE * factor
    zeros = [1.0 / MODE**2, 2.0 * DAMPING / MODE, 1.0]
    return zeros, [1.0 / w**2, 2.0 * DAMPING / w, 1.0]


def response(factor: float, omega: np.ndarray) -> CornerResponse:
    above, below = believed_and(factor)
    s = 1j * omega
    load = np.polyval(above, s) / np.polyval(below, s)
    return CornerResponse(load=load, sensor=load, current_s_a_m=None)


def answer(weights: np.ndarray, factor: float, t: np.ndarray) -> np.ndarray:
    """The speed of the load after a step of speed at 0, by integration in time."""
    element = BSpline.basis_element(np.arange(-3.0, 4.0), extrapolate=False)
    at = (t[:, None] - (np.arange(COUNT) - (COUNT - 1) / 2) * STEP_S) / STEP_S
    kernel = np.nan_to_num(element(at)) @ weights / STEP_S
    meant = np.cumsum(kernel) * (t[1] - t[0])
    from scipy.signal import tf2ss

    a, b, c, d = tf2ss(*believed_and(factor))
    return np.asarray(states_of(a, b, meant, t[1] - t[0]) @ c[0] + d[0] * meant)


def found_for(
    factors: tuple[float, ...], *stops: bool, near: RobustWeights | None = None
) -> RobustWeights:
    omega = frequencies_rad_s(GRID_S, SAMPLES)
    found = robust_weights(
        StepOfSpeed(
            speed=0.1,
            room=1e-3,
            current_limit_a=np.inf,
            machines=[response(factor, omega) for factor in factors],
        ),
        [change(stop) for stop in stops],
        WeightGrid(count=COUNT, step_s=STEP_S, degree=5, grid_s=GRID_S, samples=SAMPLES),
        near=near,
    )
    assert found is not None
    return found


@pytest.mark.parametrize("stops", [(False,), (True,), (False, True)])
def test_no_machine_rings_more_than_is_said(stops):
    factors = (1.0, 0.85, 1.15)
    found = found_for(factors, *stops)
    assert found.weights.sum() == pytest.approx(1.0, abs=1e-9)
    t = np.arange(-0.2, 0.6, 2e-5)
    worst = 0.0
    for factor in factors:
        speed = answer(found.weights, factor, t)
        if False in stops:  # even from the end of its change on, and no motion before it begins
            worst = max(worst, float(np.abs(speed - 1.0)[t >= CHANGE_S / 2].max()))
            assert abs(np.cumsum(speed * 2e-5)[t <= 0.0] * 0.1).max() < 1e-3 * 1.02
        if True in stops:  # even until it, and no motion after it
            worst = max(worst, float(np.abs(speed)[t <= -CHANGE_S / 2].max()))
            left = np.cumsum((1.0 - speed)[::-1] * 2e-5)[::-1][t >= 0.0]
            assert abs(left * 0.1).max() < 1e-3 * 1.02
    # Rows are met to 1e-6 at instants 0.9 ms apart; in between the speed moves a little more.
    assert worst == pytest.approx(found.error, abs=3e-3)
    assert found.error < 0.02
    # The test can fail: averages of the same width, made without the machines, ring more.
    even = np.convolve(np.ones(22) / 22, np.ones(22) / 22)
    after = t >= CHANGE_S / 2
    plain = max(np.abs(answer(even, f, t) - 1.0)[after].max() for f in factors)
    assert plain > 2.0 * found.error


def test_the_answer_is_the_same_wherever_the_programs_begin():
    """With the instants that bound other machines, another start or a stop, or without any."""
    for stops in ((False,), (False, True)):
        single = found_for((1.0, 0.7, 1.4), *stops)
        led = found_for((1.0, 0.7, 1.4), *stops, near=found_for((1.0, 0.85, 1.15), True))
        assert led.cost == pytest.approx(single.cost, abs=2e-5)
        assert led.error == pytest.approx(single.error, abs=2e-4)
        t = np.arange(-0.2, 0.6, 2e-4)
        for factor in (1.0, 0.7, 1.4):
            np.testing.assert_allclose(
                answer(led.weights, factor, t), answer(single.weights, factor, t), atol=2e-3
            )


def test_a_mean_is_even_where_the_speed_is_not():
    """Stitches keep their length where no average of this width keeps the speed as well."""
    mean_s, factors = 0.6 * CHANGE_S, (1.0, 0.7, 1.4)
    omega = frequencies_rad_s(GRID_S, SAMPLES)
    axis = StepOfSpeed(
        speed=0.1,
        room=1e-3,
        current_limit_a=np.inf,
        machines=[response(factor, omega) for factor in factors],
    )
    early = replace(change(False), even_s=CHANGE_S / 8)
    of_speed, of_mean = (
        robust_weights(
            axis,
            [replace(early, mean_s=lasts_s)],
            WeightGrid(count=COUNT, step_s=STEP_S, degree=5, grid_s=GRID_S, samples=SAMPLES),
        )
        for lasts_s in (0.0, mean_s)
    )
    assert of_speed is not None and of_mean is not None
    assert of_mean.error < 0.7 * of_speed.error
    step_s = 2e-5
    t = np.arange(-0.2, 0.8, step_s)
    lasts, off = round(mean_s / step_s), []
    for factor in factors:
        way = np.cumsum(answer(of_mean.weights, factor, t)) * step_s
        gone = (way[lasts:] - way[:-lasts]) / mean_s
        # The first checked mean begins a sample of the grid later.
        begins = t[:-lasts] >= early.even_s + GRID_S
        off.append(np.abs(gone - 1.0)[begins].max())
    assert max(off) == pytest.approx(of_mean.error, abs=3e-3)


def test_averages_for_a_start_alone_cost_less_than_averages_for_both_ends():
    """A stop needs the same backwards, and both share the weights that serve both."""
    factors = (1.0, 0.8, 1.2)
    assert found_for(factors, False).cost < 0.98 * found_for(factors, False, True).cost


TURN_S = 1.0 / 71.0
"""Of a needle at 71 stitches a second, the edge for the starts of Y of the stitcher as built."""


def start_of_y(share_of_limit: float, seed: int) -> RobustWeights | None:
    """Return the start of a leg of ``stitcher-even.seam.toml``, with slightly wrong coefficients.

    Seed 0 changes nothing; the others change parts in 1e12 to 1e10, more than kernels round
    differently.
    """
    machine = load_machine("stitcher")
    step_s = 4.0 * TURN_S / 28
    omega = frequencies_rad_s(step_s / 4, SAMPLES)
    (exact,) = corner_responses(machine, "Y", [machine], omega)
    assert exact.current_s_a_m is not None
    random = np.random.default_rng(seed)
    size = 10.0 ** (-12 + seed % 3) if seed else 0.0
    off = [1.0 + size * random.standard_normal(len(omega)) for _ in range(2)]
    return robust_weights(
        StepOfSpeed(
            speed=0.182865,
            room=4.2e-4 * np.sqrt(0.5),
            current_limit_a=share_of_limit * 0.95 * 27.0,
            machines=[
                CornerResponse(
                    load=exact.load * off[0],
                    sensor=exact.sensor,
                    current_s_a_m=exact.current_s_a_m * off[1],
                )
            ],
        ),
        [
            ChangeOfSpeed(
                stop=False,
                early_s=TURN_S,
                still_s=TURN_S + 0.00315,
                within_s=2.0 * TURN_S,
                even_s=0.018696,
                aside_s=0.009473,
                share=(1.014, 1.014),
            )
        ],
        WeightGrid(count=COUNT, step_s=step_s, degree=5, grid_s=step_s / 4, samples=SAMPLES),
    )


@pytest.mark.long(shown_by="test_the_answer_is_the_same_wherever_the_programs_begin")
def test_an_answer_at_the_edge_is_that_of_no_last_digit():
    """With 27 A less 5 % every seed finds the same answer; with 1 % less no seed finds one."""
    first = start_of_y(1.0, 0)
    assert first is not None
    for seed in range(1, 11):
        other = start_of_y(1.0, seed)
        assert other is not None, seed
        assert other.error == pytest.approx(first.error, abs=1e-6), seed
        np.testing.assert_allclose(other.weights, first.weights, atol=1e-5, err_msg=str(seed))
    assert [start_of_y(0.99, seed) for seed in range(3)] == [None] * 3


def test_a_program_without_an_answer_is_not_taken_for_one_without_weights(monkeypatch):
    """For either algorithm: the other one is tried, and if both fail, a message says so."""
    asked: list[str] = []

    def failing(solvers: tuple[str, ...]):
        def solve(*args: object, method: str, **rest: object) -> OptimizeResult:
            asked.append(method)
            if method in solvers:
                return OptimizeResult(x=None, status=4, message="status unknown")
            return linprog(*args, method=method, **rest)

        return solve

    meant = found_for((1.0, 0.85, 1.15), False)
    monkeypatch.setattr(optimize, "linprog", failing(("highs-ds",)))
    found = found_for((1.0, 0.85, 1.15), False)
    assert set(asked) == {"highs-ds", "highs-ipm"}
    assert found.error == pytest.approx(meant.error, abs=1e-6)
    monkeypatch.setattr(optimize, "linprog", failing(("highs-ds", "highs-ipm")))
    with pytest.raises(PlanError, match=r"failed on a feasible linear program \(status unknown\)"):
        found_for((1.0, 0.85, 1.15), False)


def test_a_corner_answers_as_its_closed_loop_does_in_time():
    """T / T0 against the impulse responses of both loops, tick by tick."""
    machine = load_machine("stitcher")
    nine = corners(machine)
    assert nine[0] == machine
    assert len({(c.bodies["x_head"].inertia.si, c.links["x_belt"].stiffness.si) for c in nine}) == 9
    omega = 2.0 * np.pi * np.array([2.0, 8.0, 12.0, 20.0, 40.0])
    for axis in ("X", "Y"):
        loops = [answers_of(m)[axis] for m in (machine, nine[5])]
        period = loops[0].period_s
        spectra = [
            np.exp(-1j * omega[:, None] * period * np.arange(len(a.taps))) @ a.taps for a in loops
        ]
        itself, other = corner_responses(machine, axis, [machine, nine[5]], omega)
        np.testing.assert_allclose(itself.load, 1.0, atol=1e-12)
        # The impulse responses are cut off at 1e-5.
        np.testing.assert_allclose(other.load, spectra[1] / spectra[0], rtol=2e-3)


def test_current_of_a_steady_speed_is_that_of_its_friction():
    """0.24 N m s/rad of the motor and 3330 N s/m of the load, by hand."""
    machine = load_machine("stitcher")
    (found,) = corner_responses(machine, "X", [machine], np.array([1e-3]))
    radius = 0.029 / 6
    torque = 0.24 / radius + 3330.0 * radius
    assert found.current_s_a_m is not None
    assert found.current_s_a_m[0].real == pytest.approx(torque / 0.5, rel=1e-3)
