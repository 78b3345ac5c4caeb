"""Tables of step intervals: one for each length of a move, cut from a motion law by its inverse.

Step j of n is due when the law has risen to j / n. Its time is rounded to the controller's timer
from where it is and not from the step before, so that no error accumulates; the intervals are the
differences of the rounded times. The last step is due at the end of the window, and never after it.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from math import pi, sqrt

import numpy as np

from threadline.arrays import FloatArray, IntArray, Locked, read_only_int
from threadline.errors import PlanError
from threadline.laws import Law
from threadline.shaping import FlexibleMode

_MOST_STEPS = 50_000_000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StepTable(Locked):
    """The intervals of one move.

    Parameters
    ----------
    units
        Length of the move in units of the design.
    intervals
        (n,) whole timer periods from each step to the next, the first from the start of the
        window; all positive.
    timer_s, window_s
        Exact period of the timer and duration of the window, s.
    step_m
        Way of a step, m.
    """

    units: int
    intervals: IntArray
    timer_s: Fraction
    window_s: Fraction
    step_m: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "intervals", read_only_int(self.intervals, "intervals", ndim=1))

    def __len__(self) -> int:
        return len(self.intervals)

    @property
    def times(self) -> IntArray:
        """(n,) timer periods from the start of the window to each step."""
        return np.cumsum(self.intervals)

    @property
    def shortest_s(self) -> float:
        """Shortest interval between two steps, or before the first, s."""
        return float(int(self.intervals.min()) * self.timer_s)

    @property
    def left_s(self) -> float:
        """What is left of the window after the last step: less than a timer period, s."""
        return float(self.window_s - int(self.intervals.sum()) * self.timer_s)

    def residual_m(self, mode: FlexibleMode) -> float:
        """Return the amplitude of ``mode`` at the end of the window, steps being instantaneous.

        A step of the base by d leaves a mode the amplitude ``d omega / omega_d`` with the phase of
        its time; the steps of a table add up as complex numbers.
        """
        omega = 2.0 * pi * mode.frequency_hz
        damped = omega * sqrt(1.0 - mode.damping_ratio**2)
        pole = mode.damping_ratio * omega + 1j * damped
        before_end = float(self.window_s) - self.times * float(self.timer_s)
        swung = np.exp(-pole * before_end).sum()
        return float(self.step_m * omega / damped * np.abs(swung))


def step_tables(
    law: Law,
    *,
    window_s: Fraction,
    timer_s: Fraction,
    unit_m: float,
    steps_per_unit: int,
    longest_units: int,
) -> tuple[StepTable, ...]:
    """Return the tables for moves of 1, 2 ... ``longest_units`` units, of as many steps as belong.

    Parameters
    ----------
    law
        Monotone.
    window_s, timer_s
        Exact: every move takes the whole window.
    unit_m
        Unit of the design, m.
    steps_per_unit
        Steps of the drive in a unit.
    longest_units
        Longest move.

    Raises
    ------
    OptionError
        If the law goes back.
    PlanError
        If a number is not positive, or two steps would fall into one timer period.
    """
    for what, value in (
        ("window", window_s), ("timer period", timer_s), ("unit", unit_m),
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
    counts = steps_per_unit * np.arange(1, longest_units + 1)
    ends = np.cumsum(counts)
    begins = ends - counts
    rises = (np.arange(1, total + 1) - np.repeat(begins, counts)) / np.repeat(counts, counts)
    ratio = window_s / timer_s
    ticks = np.rint(law.inverse(rises) * float(ratio)).astype(np.int64)
    last = ratio.numerator // ratio.denominator
    ticks = np.minimum(ticks, last)
    tables = []
    for units, (begin, end) in enumerate(zip(begins.tolist(), ends.tolist(), strict=True), start=1):
        intervals = np.diff(ticks[begin:end], prepend=0)
        if not bool(np.all(intervals > 0)):
            step = int(np.argmin(intervals))
            raise PlanError(
                f"step tables: in a move of {units} units steps {step} and {step + 1} fall into "
                f"one period of the timer of {float(timer_s) * 1e6:g} us",
                remedy="Take a longer window, a finer timer or a coarser step.",
            )
        tables.append(
            StepTable(
                units=units, intervals=intervals, timer_s=timer_s, window_s=window_s,
                step_m=unit_m / steps_per_unit,
            )
        )  # fmt: skip
    return tuple(tables)


def peak_rate_hz(table: StepTable) -> float:
    """Return the highest rate of steps, Hz."""
    return 1.0 / table.shortest_s


def mean_rate_hz(table: StepTable) -> float:
    """Return the mean rate of steps over the window, Hz."""
    return len(table) / float(table.window_s)


def positions_m(table: StepTable, time_s: FloatArray) -> FloatArray:
    """Return where the move is at (m,) times since the start of the window, m."""
    due = table.times * float(table.timer_s)
    return table.step_m * np.searchsorted(due, time_s, side="right").astype(np.float64)
