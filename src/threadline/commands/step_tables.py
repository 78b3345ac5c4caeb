"""Tables of step intervals: one per length of a move, from the inverse of a motion law.

Step j of n is due when the law has risen to j / n. The time of each step is rounded to the
controller's timer as an absolute time, so rounding errors do not add up. The intervals are the
differences of the rounded times. The last step is due at the end of the window, and never later.
"""

from __future__ import annotations

from fractions import Fraction
from functools import lru_cache
from math import pi, sqrt

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.errors import PlanError
from threadline.files import StepTable
from threadline.motion.laws import Law
from threadline.motion.shaping import FlexibleMode

_MOST_STEPS = 50_000_000


def step_tables(
    law: Law, *, window_s: Fraction, timer_s: Fraction, steps_per_unit: int, longest_units: int
) -> tuple[StepTable, ...]:
    """Return the tables for moves of 1, 2 ... ``longest_units`` units.

    Parameters
    ----------
    law
        Motion law, monotone.
    window_s, timer_s
        Window of a move and period of the timer, exact, s; every move takes the whole window.
    steps_per_unit
        Steps of the drive per unit.
    longest_units
        Length of the longest move.

    Raises
    ------
    OptionError
        If the law moves backwards.
    PlanError
        If a number is not positive, or two steps would fall into one timer period.
    """
    for what, value in (
        ("window", window_s), ("timer period", timer_s),
        ("number of steps a unit", steps_per_unit), ("longest move", longest_units),
    ):  # fmt: skip
        if not value > 0:
            raise PlanError(f"step tables: the {what} must be positive, got {value}")
    total = steps_per_unit * longest_units * (longest_units + 1) // 2
    if total > _MOST_STEPS:
        raise PlanError(
            f"step tables: {total} steps in all, limit {_MOST_STEPS}",
            remedy="Take a coarser step or a shorter longest move.",
        )
    ends = np.cumsum(steps_per_unit * np.arange(1, longest_units + 1))
    begins = np.concatenate(([0], ends[:-1]))
    ratio = window_s / timer_s
    ticks = np.rint(_due(law, steps_per_unit, longest_units) * float(ratio)).astype(np.int64)
    last = ratio.numerator // ratio.denominator
    ticks = np.minimum(ticks, last)
    # One pass for all tables: a design has over a hundred, and a search cuts them at each speed.
    intervals = np.diff(ticks, prepend=0)
    intervals[begins] = ticks[begins]
    if intervals.min() < 1:
        units = int(np.searchsorted(ends, int(np.argmax(intervals < 1)), side="right")) + 1
        step = int(np.argmin(intervals[begins[units - 1] : ends[units - 1]]))
        raise PlanError(
            f"step tables: in a move of {units} units steps {step} and {step + 1} fall into "
            f"one period of the timer of {float(timer_s) * 1e6:g} us",
            remedy="Take a longer window, a finer timer or a coarser step.",
        )
    intervals.flags.writeable = False
    parts = zip(begins.tolist(), ends.tolist(), strict=True)
    return tuple(
        StepTable(units=units, intervals=intervals[begin:end])
        for units, (begin, end) in enumerate(parts, start=1)
    )


@lru_cache(maxsize=4)
def _due(law: Law, steps_per_unit: int, longest_units: int) -> FloatArray:
    """Return when each step of every table is due, as a share of the window; read-only.

    A search plays one law in many windows, and cutting the law takes most of the time of a plan.
    """
    counts = steps_per_unit * np.arange(1, longest_units + 1)
    steps = np.concatenate([np.arange(1, count + 1) / count for count in counts.tolist()])
    due = law.inverse(steps)
    due.setflags(write=False)
    return due


def shortest_s(table: StepTable, timer_s: Fraction) -> float:
    """Return the shortest interval between two steps, or before the first step, s."""
    return float(int(table.intervals.min()) * timer_s)


def left_s(table: StepTable, timer_s: Fraction, window_s: Fraction) -> float:
    """Return the rest of the window after the last step, less than a timer period, s."""
    return float(window_s - int(table.intervals.sum()) * timer_s)


def steps_residual_m(
    table: StepTable, timer_s: Fraction, window_s: Fraction, step_m: float, mode: FlexibleMode
) -> float:
    """Return the amplitude of ``mode`` at the end of the window, for instantaneous steps.

    A step of the base by d excites a mode with the amplitude ``d omega / omega_d``, at the phase of
    the step's time. The steps of a table add up as complex numbers.
    """
    omega = 2.0 * pi * mode.frequency_hz
    damped = omega * sqrt(1.0 - mode.damping_ratio**2)
    pole = mode.damping_ratio * omega + 1j * damped
    before_end = float(window_s) - table.times * float(timer_s)
    swung = np.exp(-pole * before_end).sum()
    return float(step_m * omega / damped * np.abs(swung))
