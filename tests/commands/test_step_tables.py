"""Step tables cut from a law: counts, sums, rounding, rates, and their swing on a mode."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from scipy.optimize import brentq

from threadline.commands.step_tables import left_s, shortest_s, step_tables, steps_residual_m
from threadline.errors import OptionError, PlanError
from threadline.files import StepTable
from threadline.motion.laws import Pieces, law, measured_law
from threadline.motion.shaping import FlexibleMode, residual_m

WINDOW, TIMER = Fraction(120, 1000), Fraction(1, 16_000_000)
FRAME = {"window_s": WINDOW, "steps_per_unit": 48, "longest_units": 165}
STEP_M = 1e-4 / 48


@pytest.fixture(scope="module")
def tables() -> tuple[StepTable, ...]:
    return step_tables(law("modified-sine"), timer_s=TIMER, **FRAME)


def test_every_table_has_its_steps_and_fills_the_window(tables: tuple[StepTable, ...]) -> None:
    """48 k steps, all intervals positive, their sum within a timer period of the window."""
    assert [len(table) for table in tables] == [48 * k for k in range(1, 166)]
    assert [table.units for table in tables] == list(range(1, 166))
    for table in tables:
        assert table.intervals.min() > 0
        assert 0.0 <= left_s(table, TIMER, WINDOW) < float(TIMER)
    odd = step_tables(law("modified-sine"), timer_s=Fraction(7, 10_000_000), **FRAME)
    coarse = Fraction(7, 10_000_000)
    assert all(0.0 <= left_s(table, coarse, WINDOW) < 7e-7 for table in odd)


def test_no_rounding_accumulates(tables: tuple[StepTable, ...]) -> None:
    """Each step is within half a timer period of its time, which brentq finds from the law."""
    motion = law("modified-sine")
    for table in (tables[0], tables[40], tables[164]):
        n = len(table)
        for j in (1, 2, n // 7, n // 2, n - 1):
            exact = brentq(lambda t, x=j / n: motion(t)[0] - x, 0.0, 1.0, xtol=1e-15, rtol=1e-14)
            assert abs(table.times[j - 1] - exact * float(WINDOW / TIMER)) <= 0.5 + 1e-6
    # Backwards the law is the same, and so are the intervals, to the rounding of two times.
    inner = tables[164].intervals
    assert np.abs(inner - inner[::-1]).max() <= 2


def test_rates_are_the_published_ones(tables: tuple[StepTable, ...]) -> None:
    """7920 steps in 120 ms: mean 66 kHz, peak 1.76 times that, to the timer's 62.5 ns in 8.6 us.

    Published for 8000 steps: 66.7 and 117 kHz.
    """
    longest = tables[164]
    assert len(longest) / float(WINDOW) == pytest.approx(66.7e3 * 7920 / 8000, rel=1e-3)
    assert 1.0 / shortest_s(longest, TIMER) == pytest.approx(117e3 * 7920 / 8000, rel=0.01)


def test_positions_follow_the_law_within_a_step(tables: tuple[StepTable, ...]) -> None:
    t = np.linspace(0.0, float(WINDOW), 10_001)
    for table in (tables[4], tables[164]):
        expected = table.units * 1e-4 * law("modified-sine")(t / float(WINDOW))
        found = STEP_M * np.searchsorted(table.times * float(TIMER), t, side="right")
        assert np.all(found <= expected + 1e-2 * STEP_M)
        assert np.all(found >= expected - 1.01 * STEP_M)


@pytest.mark.parametrize("frequency", [8.0, 12.0, 20.0])
def test_the_residual_after_rounding_is_that_of_the_law(
    tables: tuple[StepTable, ...], frequency: float
) -> None:
    """Steps of 2 um add up to the motion, except for less than one of them."""
    mode = FlexibleMode(frequency, 0.02)
    for table in (tables[49], tables[164]):
        exact = residual_m(
            law("modified-sine"), mode, table.units * 1e-4, np.array([float(WINDOW)])
        )[0]
        assert steps_residual_m(table, TIMER, WINDOW, STEP_M, mode) == pytest.approx(
            exact, abs=1.01 * STEP_M
        )


def test_any_monotone_law_and_no_other() -> None:
    made = step_tables(law("jerk-limited:1,2,1,3,2,1,2"), timer_s=TIMER, **FRAME)
    assert len(made) == 165
    back = measured_law(
        "over",
        Pieces(np.zeros(1), np.array([[0.0, 0.0, 9.0, -14.0, 6.0]])),
        Pieces(np.zeros(1), np.array([[0.0, 0.0, -3.0, 10.0, -6.0]])),
    )
    with pytest.raises(OptionError, match="goes back"):
        step_tables(back, timer_s=TIMER, **FRAME)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"timer_s": Fraction(1, 100_000)}, "fall into one period of the timer of 10 us"),
        ({"window_s": Fraction(0)}, "the window must be positive"),
        ({"steps_per_unit": 0}, "steps a unit must be positive"),
        ({"longest_units": 10_000_000}, "limit 50000000"),
    ],
)
def test_step_table_beyond_the_controller_is_refused(
    changed: dict[str, object], message: str
) -> None:
    with pytest.raises(PlanError, match=message):
        step_tables(law("modified-sine"), **({"timer_s": TIMER} | FRAME | changed))
