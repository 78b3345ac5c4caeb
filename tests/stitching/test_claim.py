"""The speed of a frame: a law made for its mode, compared with the cam's, also on the twin."""

from __future__ import annotations

from fractions import Fraction
from functools import cache

import numpy as np
import pytest

from tests.stitching.test_twin import MACHINE, TIMER, commands
from threadline.commands.step_tables import step_tables
from threadline.machine.numbers import with_numbers
from threadline.motion.laws import law
from threadline.motion.shaping import FlexibleMode
from threadline.motion.shaping.law_residual import lasting_windows_s
from threadline.motion.shaping.mode_law import Demand, MadeLaw, made_law, usual_jerk_m_s3
from threadline.twin.stitching import simulate_stitching

MOVE_M, RESIDUAL_M, LIMIT = 0.0165, 5e-5, 6.334


@cache
def made(hertz: float) -> MadeLaw:
    return made_law(
        Demand(
            mode=FlexibleMode(hertz, 0.02), band=0.1, move_m=MOVE_M, residual_m=RESIDUAL_M,
            acceleration_m_s2=LIMIT, jerk_m_s3=usual_jerk_m_s3(MOVE_M, LIMIT),
        )
    )  # fmt: skip


def test_a_law_for_the_mode_turns_the_shaft_two_and_a_half_times_as_fast() -> None:
    """At 16 Hz, where the gain is smallest up to there; equal acceleration and residual.

    Modified sine gets the exact mode, and the shortest window after which every longer one is
    enough; with the same +-10 % it would need more.
    """
    mode = FlexibleMode(16.0, 0.02)
    cam = lasting_windows_s(law("modified-sine"), mode, np.array([MOVE_M]), RESIDUAL_M)[0]
    assert cam / made(16.0).window_s >= 2.5


@pytest.mark.parametrize("ratio", [0.9, 1.0, 1.1])
def test_made_law_leaves_the_allowed_residual_on_the_twin(ratio: float) -> None:
    """In steps of 2 um, on a frame within 10 % of the mode, stiff servo: 0.05 mm and two steps."""
    found = made(16.0)
    # By angle: cut for 120 ms, and played at the speed for which the law was made.
    tables = step_tables(
        found.law, window_s=Fraction(12, 100), timer_s=TIMER, steps_per_unit=48, longest_units=165
    )
    stiffness = 1000.0 * (2.0 * np.pi * 16.0 * ratio) ** 2
    machine = with_numbers(
        MACHINE,
        {
            "links.x_train.stiffness": stiffness,
            "links.x_train.damping": 2.0 * 0.02 * np.sqrt(stiffness * 1000.0),
            "bodies.x_frame.damping": 1e-6,
            "drives.x.bandwidth": 1000.0,
        },
    )
    play = commands(tables, [[164, -1]], [[1, 0]], machine, stretched=found.window_s / 0.12)
    times, load = simulate_stitching(play, machine).samples("X.load")
    after = times >= found.window_s + 1e-3
    assert np.abs(load[after] - 1e-3 - MOVE_M).max() <= RESIDUAL_M + 2 * 2.1e-6
