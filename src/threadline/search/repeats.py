"""Repeats of a job: the result of each run, and the choice of the run to go on from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

from threadline.base.arrays import FloatArray
from threadline.commands.plan import Plan
from threadline.dynamics.learning import LearningFilter
from threadline.machine import Machine
from threadline.proof.pipeline import Proof
from threadline.search.feed_ranges import used
from threadline.verdict import Verdict

Sensed = Literal["head", "motor"]


GAIN = 0.9


_WORSE = 1.1  # a run whose error is larger than this times the least error is undone


LEAST_GAIN = 1.0 / 16.0  # below this share of the first gain the best table is kept


@dataclass(frozen=True, slots=True, kw_only=True)
class Rules:
    """The rules of learning a job.

    Parameters
    ----------
    gain
        Share of the error that is corrected after a run, in (0, 1].
    low_pass_hz
        Frequency at which the low-pass halves, Hz; None: chosen by ``learning_filter``.
    sensed
        Where the error is measured: at the head (the load) or at the motor's encoder.
    """

    gain: float = GAIN
    low_pass_hz: float | None = None
    sensed: Sensed = "head"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Repeat:
    """One run of the job.

    Parameters
    ----------
    number
        0 for the run of the plan's table.
    verdict
        Verdict on this run.
    error_si
        (axes,) root mean square of the error, m or rad.
    error_m
        Root mean square of the error over all axes at the tool, m.
    peak_si
        (axes,) largest error, m or rad.
    current
        Largest current / limit over all drives; None if no current was recorded.
    gain
        Gain of the change before this run; 0 for the table of an earlier run.
    followed
        Whether learning went on from this run; if not, it was undone.
    note
        Limit that shortened or stopped the change before this run; empty if there is none.
    """

    number: int
    verdict: Verdict
    error_si: FloatArray
    error_m: float
    peak_si: FloatArray
    current: float | None
    gain: float
    followed: bool
    note: str = ""

    @property
    def share(self) -> float:
        """Used share of the tightest limit."""
        return used(self.verdict)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tried:
    """A run, the references that it played, and its error.

    Parameters
    ----------
    offset
        (n + 1, axes) change of the planned references, counts, not rounded.
    error
        (n + 1, axes) error at the beginning of each tick, m or rad, faded out after the motion.
    passed
        Whether the run was in specification.
    error_m
        Root mean square of the error over all axes at the tool, m.
    """

    offset: FloatArray
    error: FloatArray
    passed: bool
    error_m: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Learned:
    """The result of repeats.

    Parameters
    ----------
    plan
        The plan with the best table.
    actual
        The machine that ran.
    repeats
        Every run, in order.
    best
        Number of the run with the best table.
    filters
        The learning filter of each axis.
    rules
        Gain, low-pass and sensor of the learning.
    proof
        Proof of the best table, at the given level.
    """

    plan: Plan
    actual: Machine
    repeats: tuple[Repeat, ...]
    best: int
    filters: tuple[LearningFilter, ...]
    rules: Rules
    proof: Proof

    @property
    def passed(self) -> bool:
        """Whether the best table is in specification."""
        return self.proof.verdict.passed

    @property
    def within(self) -> int | None:
        """Number of the first run from which on every followed run is in specification."""
        followed_runs = [run for run in self.repeats if run.followed]
        number = None
        for run in reversed(followed_runs):
            if not run.verdict.passed:
                break
            number = run.number
        return number


def best_of(runs: Sequence[tuple[bool, float]], gain: float) -> tuple[int, float]:
    """Return the number of the run to go on from, and the gain after runs that got worse.

    Parameters
    ----------
    runs
        For each run whether it was in specification, and its error.
    gain
        The first gain; each run that is undone halves it.

    Examples
    --------
    >>> best_of([(False, 1.0), (False, 0.3), (False, 0.5)], 0.8)
    (1, 0.4)
    """
    best_index, least = 0, runs[0][1]
    for number, (passed, error) in enumerate(runs[1:], start=1):
        if follows(runs[best_index][0], least, passed, error):
            least = error if passed and not runs[best_index][0] else min(least, error)
            best_index = number
        else:
            gain *= 0.5
    return best_index, gain


def follows(best_passed: bool, least: float, passed: bool, error: float) -> bool:
    """Return whether learning goes on from a run.

    Learning goes on from a run in specification if the best run is not, and never the other way
    round. Otherwise it goes on if the error is at most 1.1 times the least error so far.
    """
    if passed != best_passed:
        return passed
    return error <= _WORSE * least


def best_table(repeats: Sequence[Repeat]) -> int:
    """Return the number of the best followed run: in specification, with the least used share."""
    followed = (one for one in repeats if one.followed)
    return min(followed, key=lambda one: (not one.verdict.passed, one.share)).number


def with_followed(repeats: Sequence[Repeat]) -> list[Repeat]:
    """Return the runs with ``followed`` set: False for a run that was undone."""
    marked, runs = [], [(run.verdict.passed, run.error_m) for run in repeats]
    for number, run in enumerate(repeats):
        best_index, _ = best_of(runs[: number + 1], 1.0)
        marked.append(replace(run, followed=best_index == number))
    return marked
