"""Criteria, specifications and verdicts."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Literal

NO_OPTIONS: Mapping[str, float] = {}


def is_measured(value: float, unit: str) -> bool:
    """Return whether ``value`` can be a result: a number; for a time also infinity (never)."""
    return math.isfinite(value) or (unit == "s" and value == math.inf)


class Status(StrEnum):
    """Result of a criterion."""

    PASSED = "passed"
    FAILED = "failed"
    NOT_MEASURED = "not-measured"  # its channel is absent from the recording
    REPORTED = "reported"  # it has no limit


class Level(StrEnum):
    """How far a verdict reaches."""

    LIMITS = "limits and time alone"  # no dynamics in the machine file: positions are unknown
    NOMINAL = "nominal"  # few runs of one machine: no claim about others
    REPEATED = "repeated"  # enough runs to contain the variation from run to run
    YIELD = "yield over tolerances"  # a share of the machines within the tolerances of the file
    TOLERANCES = "over tolerances"  # the worst machine found within them, and drawn machines
    DRAWN = "drawn machines"  # machines drawn at random within the tolerances, one run each


REPEATED_RUNS = 20
"""Least number of runs for the level *repeated*."""
EQUAL_SHARES = 1e-6
"""Used shares of limits that differ by less than this share count as equal: the order of the
criteria decides which is named, not rounding."""
_NEAR = 3.0


def level_of(runs: int, machines: int, wanted_yield: float | None) -> Level:
    """Return the level of runs of a machine, and of others within its tolerances."""
    if machines:
        return Level.TOLERANCES if wanted_yield is None else Level.YIELD
    return Level.REPEATED if runs >= REPEATED_RUNS else Level.NOMINAL


@dataclass(frozen=True, slots=True, kw_only=True)
class Criterion:
    """A line of a specification.

    Parameters
    ----------
    name
        One of the measures: ``contour_error``, ``turning_point_error``, ...
    axis
        Its axis, ``""`` for every axis or for the tool.
    step
        Its step of a move list, ``""`` for every step.
    limit
        Largest allowed value, SI; None if it is only reported.
    required
        Whether the verdict passes only if it was measured.
    options
        How it is measured (a band, a window), SI; missing options have the measure's default.
    hard
        The limit is the machine's own. A historical interpolation may exceed the limits of
        acceleration and jerk: it only reports its values.
    every_axis
        Whether it was written for every axis: then an axis that the job does not move is left out.
    note
        A remark for the verdict, such as that the machine's own limit is narrower.
    """

    name: str
    axis: str = ""
    limit: float | None = None
    required: bool = False
    options: Mapping[str, float] = field(default_factory=lambda: NO_OPTIONS)
    hard: bool = False
    every_axis: bool = False
    step: str = ""
    note: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Spec:
    """A specification: criteria with limits.

    Parameters
    ----------
    name
        For people.
    criteria
        In the order of the verdict.
    lag_s
        Free following error in time: a position is compared with the part of the program from this
        time before its instant to this time after it.
    sha256
        Hash of the file.
    file
        File name as given; empty for the machine's own specification, and if made in Python.
    """

    name: str
    criteria: tuple[Criterion, ...]
    lag_s: float = 0.1
    sha256: str = ""
    file: str = ""

    def __repr__(self) -> str:
        return f"<Spec {self.name!r}: {len(self.criteria)} criteria>"

    def with_margin(self, share: float) -> Spec:
        """Return the specification with a share of every limit kept free.

        The machine's own limits stay, since the motion is planned with them.

        Parameters
        ----------
        share
            At least 0 and below 1.
        """
        return replace(
            self,
            criteria=tuple(
                c if c.hard or c.limit is None else replace(c, limit=c.limit * (1.0 - share))
                for c in self.criteria
            ),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """A criterion and its measured value.

    Parameters
    ----------
    name, axis, limit, required
        As in the criterion; ``axis`` is filled in if one was measured.
    measured
        The worst value, SI ``unit``; None if nothing was measured. A time may be infinite: the tool
        never settles.
    time_s
        When the worst value occurred, from the start of the job.
    operation, job_line
        Where in the job; None if there is no such place.
    passes
        Passes of the subroutines around that line, the outermost first; empty in the main program.
    position
        (axes of the job,) commanded position there, m or rad, or the missed programmed point; None
        if there is no such place.
    note
        Remark beyond the number: ``short``, ``past``, why nothing was measured.
    run
        Number of the run with the worst value, from 1, other machines last; None for a single run,
        and if the value belongs to the plan or to all runs together.
    step
        The step of a move list that it was measured in; ``""`` for the whole job.
    of
        ``"plan"`` if the plan was measured, and no run; ``"recording"`` if a limit of the plan was
        measured on the recording instead; else ``"run"``.
    typical
        Median of the runs; None for a single run, and if no run was measured.

    Raises
    ------
    ValueError
        If ``measured`` is not a number: NaN is never a result, and only a time may be infinite.
    """

    name: str
    axis: str
    measured: float | None
    limit: float | None
    unit: str
    status: Status
    required: bool = False
    time_s: float | None = None
    operation: int | None = None
    job_line: int | None = None
    position: tuple[float, ...] | None = None
    note: str = ""
    step: str = ""
    passes: tuple[int, ...] = ()
    hard: bool = False
    run: int | None = None
    of: Literal["plan", "recording", "run"] = "run"
    typical: float | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        if self.measured is not None and not is_measured(self.measured, self.unit):
            raise ValueError(f"{self.name} {self.axis}: {self.measured} {self.unit} is no result")

    @property
    def severity(self) -> tuple[int, float]:
        """Orders results from harmless to worst: by status, then by measured over limit."""
        rank = (Status.REPORTED, Status.PASSED, Status.NOT_MEASURED, Status.FAILED)
        if self.measured is None:
            return rank.index(self.status), 0.0
        return rank.index(self.status), self.measured / self.limit if self.limit else self.measured


class Change(StrEnum):
    """Kinds of events that change the motion of a run."""

    LIMIT_SWITCH = "limit-switch"  # a switch cut the supply of a motor
    SATURATION = "saturation"  # the output of a controller was at its clamp
    LOST_STEPS = "lost-steps"  # the torque or force asked of a drive exceeded its limit
    HOLD = "hold"  # the rows of the commands were held
    LATE = "late"  # rows of the commands came late
    OVERRIDE = "override"  # speeds were changed, in the run or at the controller itself
    STOPPED = "stopped"  # the run ended early
    FAULT = "fault"


@dataclass(frozen=True, slots=True, kw_only=True)
class Disturbance:
    """An event that changed the motion of a run and is not part of its plan.

    Parameters
    ----------
    change
        Kind of event.
    text
        Description for people, without its place.
    time_s
        When it happened or began, from the start of the job.
    operation, job_line
        Place in the job; None if unknown.
    axis
        The axis whose motion it changed; ``""`` for all.
    run
        Number of the first run in which it happened, from 1; None if there was one run only.
    """

    change: Change
    text: str
    time_s: float | None
    operation: int | None = None
    job_line: int | None = None
    axis: str = ""
    run: int | None = None

    @property
    def words(self) -> str:
        """Description with time and line, for people."""
        where = [
            "" if self.time_s is None else f"at {self.time_s:.3f} s",
            "" if not self.job_line else f"line {self.job_line}",
            "" if self.run is None else f"run {self.run}",
        ]
        return f"{self.text} {', '.join(filter(None, where))}".rstrip()


@dataclass(frozen=True, slots=True, kw_only=True)
class OverTolerances:
    """Results for the machines within the tolerances of a machine file.

    Parameters
    ----------
    searched
        Number of machines that the search for the worst tried, in one run each.
    criterion
        The criterion that the worst of them exceeds or comes closest to; empty if none has a limit.
    share
        Share of the limit that the worst machine uses, over as many runs as the machine of the
        file; None if the limit is 0, or the machine cannot be simulated.
    drawn, passed
        Number of machines drawn at random, in one run each, and how many are in specification.
    least
        Share of all machines that are in specification at least, with ``confidence``; the exact
        one-sided bound of Clopper and Pearson for the drawn machines.
    """

    searched: int
    criterion: str
    share: float | None
    drawn: int
    passed: int
    least: float
    confidence: float = 0.95


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchedDays:
    """Result of a search for a bad day; over tolerances, for a bad machine on a bad day.

    Parameters
    ----------
    searched
        Number of runs that the search tried.
    criterion
        The criterion that the worst of them exceeds or comes closest to; empty if none has a limit.
    share
        Share of the limit that the worst of them uses; None if the limit is 0, or the run never
        ends.
    machines
        Whether machines within the tolerances were searched, each on a day of its own.
    """

    searched: int
    criterion: str
    share: float | None
    machines: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """Every criterion's result, in the order of the specification.

    Parameters
    ----------
    results
        One for each criterion, axis and step.
    simulated
        Whether every run was simulated.
    runs
        Number of judged runs of the machine.
    machines
        Number of other machines within its tolerances, drawn at random.
    tolerances
        Results of the search for the worst machine and of the drawn machines within the
        tolerances; None if neither was wanted.
    days
        Result of a search for a bad day, which ``fastest`` makes for its answer; else None.
    wanted_yield
        Share of these machines that must be in specification; None: every one.
    ends
        Number of judged machines at the ends of the tolerances of loads and springs, one run each.
    band
        Number of judged machines with modes all over a band, one run each.
    incomplete
        How a run ended before its last row; empty if none did.
    late_ticks
        Ticks, in all runs, at which a due row had not come.
    limits_alone
        Whether only limits and time were judged: the runs are simulated, and the machine file has
        no dynamics.
    recorded
        Whether recordings were judged, not runs simulated for the verdict.
    disturbances
        Events that changed the motion of the runs, in the order of time.
    """

    results: tuple[Result, ...]
    simulated: bool
    runs: int = 1
    machines: int = 0
    tolerances: OverTolerances | None = None
    days: SearchedDays | None = None
    wanted_yield: float | None = None
    ends: int = 0
    band: int = 0
    incomplete: str = ""
    late_ticks: int = 0
    limits_alone: bool = False
    recorded: bool = False
    disturbances: tuple[Disturbance, ...] = ()

    def __repr__(self) -> str:
        count = {status: sum(r.status is status for r in self.results) for status in Status}
        counts = ", ".join(f"{n} {status.value}" for status, n in count.items() if n)
        return f"<Verdict {'passed' if self.passed else 'not passed'} ({self.level}): {counts}>"

    @property
    def level(self) -> Level:
        """How far the verdict reaches."""
        if self.limits_alone:
            return Level.LIMITS
        if self.tolerances is not None:
            return Level.TOLERANCES
        return level_of(self.runs, self.machines, self.wanted_yield)

    @property
    def tightest(self) -> Result | None:
        """The result that uses most of its limit; None if no limit above 0 was measured.

        The machine's own limits do not count, since a plan is made to use them. Of equal shares
        the first counts.
        """
        limited = [r for r in self.results if r.limit and r.measured is not None and not r.hard]
        most = max(map(_share, limited), default=0.0) * (1.0 - EQUAL_SHARES)
        return next((result for result in limited if _share(result) >= most), None)

    @property
    def near(self) -> bool:
        """Whether other runs of the machine may well exceed a limit that these runs keep.

        The remaining margin is then less than three times the distance of the worst run from the
        median of the runs.
        """
        return any(
            r.limit is not None and r.measured is not None and r.typical is not None
            and r.status is Status.PASSED and r.measured > r.typical
            and r.limit - r.measured < _NEAR * (r.measured - r.typical)
            for r in self.results
        )  # fmt: skip

    @property
    def covers(self) -> float:
        """Share of all runs that are no worse than the worst of these runs, with 95 % confidence.

        The bound of order statistics for any distribution: ``0.05 ** (1 / runs)``.
        """
        return float(0.05 ** (1.0 / self.runs))

    @property
    def answers(self) -> bool:
        """Whether anything with a limit other than the machine's own was measured."""
        return any(
            r.limit is not None and r.measured is not None and not r.hard for r in self.results
        )

    @property
    def passed(self) -> bool:
        """Whether nothing failed, every required criterion was measured, every run was complete."""
        return not self.incomplete and all(
            result.status is not Status.FAILED
            and not (result.required and result.status is Status.NOT_MEASURED)
            for result in self.results
        )

    def result(self, name: str, axis: str = "") -> Result:
        """Return the result of a criterion, for the worst axis if no axis is named.

        Raises
        ------
        KeyError
            If it was not judged.
        """
        found = [r for r in self.results if r.name == name and (not axis or r.axis == axis)]
        if not found:
            raise KeyError((name, axis))
        return max(found, key=lambda result: result.severity)


def _share(result: Result) -> float:
    assert result.measured is not None and result.limit
    return result.measured / result.limit
