"""Time-optimal and robust moves, compared with published times and the matrix exponential."""

from __future__ import annotations

import math

import numpy as np
import pytest

from threadline.motion.shaping.designs import design
from threadline.motion.shaping.onoff.body_and_modes import (
    Command,
    RestToRest,
    ringing,
    shaped_command,
    simulate,
    worst_ringing,
)
from threadline.motion.shaping.onoff.optimal import time_optimal
from threadline.motion.shaping.onoff.robust import beside, least_ringing, robust_optimum
from threadline.motion.shaping.types import UNSHAPED, FlexibleMode, ShaperError

MODE = FlexibleMode(3.04)
MOVE = RestToRest(0.2, 1.0, (MODE,))


def test_time_optimal_move_of_the_facts() -> None:
    optimum = time_optimal(MOVE)
    assert optimum.command.duration_s == pytest.approx(0.920678, abs=5e-7)
    switches = [0.383164, 0.460339, 0.537513]
    assert optimum.command.switches_s == pytest.approx(switches, abs=5.1e-7)
    assert optimum.certificate >= -1e-9


@pytest.mark.parametrize("frequency_hz", [0.05, 0.01, 1e-3, 1e-4])
def test_a_slow_mode_is_silenced_in_the_time_of_its_limit(frequency_hz: float) -> None:
    """u needs an integral of u v^3 of 6 L / (a w^2) and none of u, u v^2: T^4 / 64 at best.

    Four levels, switched at (1 - 1/sqrt 2) / 2, 1/2 and (1 + 1/sqrt 2) / 2, have it. The omitted
    terms of sine and cosine are of the order of (w T)^2.
    """
    omega = 2.0 * np.pi * frequency_hz
    mode = FlexibleMode(frequency_hz)
    command = time_optimal(RestToRest(0.01, 1.0, (mode,))).command
    limit = (64.0 * 6.0 * 0.01 / omega**2) ** 0.25
    share = (omega * limit) ** 2
    assert command.duration_s == pytest.approx(limit, rel=0.01 * share + 1e-9)
    assert command.switches_s / command.duration_s == pytest.approx(
        [(1 - 0.5**0.5) / 2, 0.5, (1 + 0.5**0.5) / 2], abs=0.01 * share + 1e-9
    )


def test_a_slow_damped_mode_is_silenced() -> None:
    """The matrix exponential, not the rows, shows its rest: to 1e-9 of a step and of a metre."""
    mode = FlexibleMode(0.03, 0.25)
    command = time_optimal(RestToRest(0.01, 1.0, (mode,))).command
    assert simulate(command, mode, 1.0) == pytest.approx([0.01, 0.0, 0.0], abs=2e-9)


@pytest.mark.parametrize(
    "modes",
    [
        (FlexibleMode(3.04, 0.009),),
        (FlexibleMode(3.04, 0.17),),
        (FlexibleMode(3.04), FlexibleMode(7.1, 0.01)),
    ],
)
def test_time_optimal_moves_rest_and_cannot_be_beaten(modes: tuple[FlexibleMode, ...]) -> None:
    """In 0.1 % less time a linear program on another grid finds none; in 0.1 % more it does."""
    move = RestToRest(0.2, 1.0, modes)
    optimum = time_optimal(move).command
    for mode in modes:
        end = simulate(optimum, mode, 1.0)
        assert end == pytest.approx([0.2, 0.0, 0.0], abs=1e-10)
    ticks = 331
    faster = least_ringing(
        move, relative=0.0, tick_s=0.999 * optimum.duration_s / ticks, ticks=ticks
    )
    assert faster is None or faster[0] > 1e-4
    slower = least_ringing(
        move, relative=0.0, tick_s=1.001 * optimum.duration_s / ticks, ticks=ticks
    )
    assert slower is not None
    assert slower[0] < 1e-7


def test_durations_of_shaped_moves() -> None:
    expected = {"um-zv": 1.0041, "zv": 1.0589, "um-zvd": 1.1354, "zvd": 1.2234}
    assert MOVE.rigid_duration_s == pytest.approx(0.8944, abs=5e-5)
    for kind, duration in expected.items():
        command = shaped_command(MOVE, design(kind, MODE))
        assert command.duration_s == pytest.approx(duration, abs=5.1e-5), kind
        assert np.abs(command.levels).max() <= 1.0 + 1e-12
        assert simulate(command, MODE, 1.0) == pytest.approx([0.2, 0.0, 0.0], abs=1e-9)


def test_ringing_agrees_with_the_simulation() -> None:
    mode = FlexibleMode(2.7, 0.05)
    command = shaped_command(MOVE, design("um-zv", MODE))
    expected = simulate(command, mode, 1.0)[2]
    assert expected > 0.1
    found = ringing(command, np.array([mode.frequency_hz]), mode.damping_ratio)[0]
    assert found == pytest.approx(expected, rel=1e-10)


def test_unshaped_move_rings_as_the_closed_form_says() -> None:
    """|1 - 2 e^(ja) + e^(2ja)| = 4 sin^2(a / 2), a = omega T / 2."""
    a = math.pi * 3.04 * MOVE.rigid_duration_s
    found = worst_ringing(shaped_command(MOVE, UNSHAPED), (MODE,), 0.0)
    assert found == pytest.approx(4.0 * math.sin(a / 2.0) ** 2, rel=1e-12)


def test_robust_optimum_is_an_optimum() -> None:
    """The grid only bounds it from above: a finer one gains under 0.1 %; rest must be global."""
    coarse = robust_optimum(MOVE, relative=0.2, tolerance=0.01, intervals=60)
    command = robust_optimum(MOVE, relative=0.2, tolerance=0.01, intervals=120)
    assert command.duration_s == pytest.approx(1.0848, abs=5e-4)
    assert coarse.duration_s == pytest.approx(command.duration_s, rel=2e-3)
    assert np.abs(command.levels).max() <= 1.0 + 1e-9
    ends = [simulate(command, FlexibleMode(3.04 * r), 1.0) for r in np.linspace(0.8, 1.2, 9)]
    assert np.array(ends)[:, 0] == pytest.approx(0.2, abs=1e-5)
    assert np.array(ends)[:, 2].max() <= 0.01 * 1.001
    assert np.array(ends)[:, 2].max() > 0.009


def test_ten_ms_scan_with_free_levels_meets_the_target() -> None:
    """At most 1 % over +-20 %, within 10 % of the robust optimum."""
    found = least_ringing(MOVE, relative=0.2, tick_s=0.01, ticks=109)
    assert found is not None
    assert found[0] <= 0.01
    assert simulate(found[1], MODE, 1.0)[0] == pytest.approx(0.2, abs=1e-9)
    assert least_ringing(MOVE, relative=0.2, tick_s=0.01, ticks=89) is None


def test_every_shaper_is_compared_with_both_bounds() -> None:
    rows = beside(
        MOVE,
        [design("zv", MODE), design("um-2ei", MODE)],
        relative=0.2,
        optimal_s=time_optimal(MOVE).command.duration_s,
        robust_s=robust_optimum(MOVE, relative=0.2, tolerance=0.01).duration_s,
    )
    assert [r.name for r in rows] == ["zv", "um-2ei"]
    assert rows[0].over_optimal == pytest.approx(1.058901 / 0.920678, abs=1e-5)
    assert rows[0].over_robust < 1.0 < rows[1].over_robust
    assert rows[0].worst_step > 0.5 > rows[1].worst_step > 0.05


def test_a_tolerance_finer_than_the_solver_keeps_its_rows_is_kept() -> None:
    """At one frequency a command can leave no ringing at all; the solver's rows hold to 1e-7."""
    mode = FlexibleMode(1.0, 0.0)
    command = robust_optimum(
        RestToRest(0.001, 1.0, (mode,)), relative=0.0, tolerance=1e-9, intervals=20
    )
    steps = np.diff(command.levels, prepend=0.0, append=0.0)
    assert abs(steps @ np.exp(2j * np.pi * mode.frequency_hz * command.times_s)) <= 1.001e-9


def test_impossible_bands_are_refused() -> None:
    with pytest.raises(ShaperError, match="no command that keeps the ringing below 1e-09"):
        robust_optimum(
            RestToRest(0.001, 1.0, (FlexibleMode(1.0, 0.0),)),
            relative=0.999,
            tolerance=1e-9,
            intervals=20,
        )
    with pytest.raises(ValueError, match="increasing edges"):
        Command(np.array([0.0, 0.0]), np.array([1.0]))
