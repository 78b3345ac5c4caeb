"""Criteria and verdicts: what is asked of a job, and what came of it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Literal

NO_OPTIONS: Mapping[str, float] = {}


def is_measured(value: float, unit: str) -> bool:
    """Say whether ``value`` can be a result: a number, or of a time infinity, which is never."""
    return math.isfinite(value) or (unit == "s" and value == math.inf)


class Status(StrEnum):
    """What came of a criterion."""

    PASSED = "passed"
    FAILED = "failed"
    NOT_MEASURED = "not-measured"  # its channel is absent from the recording
    REPORTED = "reported"  # it has no limit


class Level(StrEnum):
    """How far a verdict reaches."""

    LIMITS = "limits and time alone"  # the machine file has no dynamics: nothing is said of places
    NOMINAL = "nominal"  # few runs of one machine: nothing is said of others
    REPEATED = "repeated"  # so many runs that what varies from run to run is in them
    YIELD = "yield over tolerances"  # of a share of the machines within the tolerances of the file
    TOLERANCES = "over tolerances"  # of every other machine that was drawn within them
    DRAWN = "drawn machines"  # of machines that were all drawn within them, in one run each


REPEATED_RUNS = 20
"""Runs from which a verdict is of level *repeated*."""


def level_of(runs: int, machines: int, wished: float | None) -> Level:
    """Return how far runs of a machine, and of others within its tolerances, reach."""
    if machines:
        return Level.TOLERANCES if wished is None else Level.YIELD
    return Level.REPEATED if runs >= REPEATED_RUNS else Level.NOMINAL


@dataclass(frozen=True, slots=True, kw_only=True)
class Criterion:
    """A line of a specification.

    Parameters
    ----------
    name
        One of the measures: ``contour_error``, ``turning_point_error``, ...
    axis
        The axis that it is asked of, ``""`` for every axis or for the tool.
    step
        The step of a move list that it is asked of, ``""`` for every step.
    limit
        Largest allowed value, SI; None where it is only reported.
    required
        Whether the verdict passes only if it was measured.
    options
        How it is measured (a band, a window), SI; what is left out has the measure's default.
    hard
        The limit is the machine's own. A historical interpolation is excused from those of
        acceleration and jerk: it reports what it asks for.
    every_axis
        Whether it was written for every axis: one that the job does not move is then left out.
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
        In the order in which the verdict lists them.
    lag_s
        How long the machine may trail its command before trailing is an error: placement is judged
        against the stretch of the program from this time before an instant to this time after it.
    sha256
        Of the file.
    file
        As it was named; empty for the machine's own specification, and for one made by hand.
    """

    name: str
    criteria: tuple[Criterion, ...]
    lag_s: float = 0.1
    sha256: str = ""
    file: str = ""

    def with_margin(self, share: float) -> Spec:
        """Return the specification with so much of every limit kept free.

        The machine's own limits stay: they are what the motion is planned with.

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
    """A criterion and what was measured.

    Parameters
    ----------
    name, axis, limit, required
        As in the criterion; ``axis`` is filled in where one was measured.
    measured
        The worst value, SI ``unit``; None where nothing was measured. Infinite is a time that has
        no end: what never settles.
    time_s
        When the worst value occurred, from the start of the job.
    operation, job_line
        Where in the job; None where there is no such place.
    passes
        Passes of the subroutines around that line, the outermost first; empty in the main program.
    position
        (axes of the job,) commanded position there, m or rad; for a programmed point that was
        missed, the point; None where there is no such place.
    note
        What the number alone does not say: ``short``, ``past``, why nothing was measured.
    run
        Number of the run in which the worst value was found, from 1, those of other machines last;
        None where there was one run alone, or the value is of the plan or of all runs together.
    step
        The step of a move list that it was measured in; ``""`` for the whole job.
    of
        ``"plan"`` where the value is of the plan, and no run was measured; ``"recording"`` where a
        limit of the plan was measured on the recording instead; ``"run"`` for all else.

    Raises
    ------
    ValueError
        If ``measured`` is no number: NaN is never a result, and only a time may be infinite.
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
    """Kinds of what changes the motion of a run."""

    LIMIT_SWITCH = "limit-switch"  # it cut the supply of a motor
    SATURATION = "saturation"  # the output of a controller was at its clamp
    LOST_STEPS = "lost-steps"  # a drive was asked for more torque or force than it has
    HOLD = "hold"  # the rows of the commands stood
    LATE = "late"  # rows of the commands came late
    STOPPED = "stopped"  # the run ended early
    FAULT = "fault"


@dataclass(frozen=True, slots=True, kw_only=True)
class Happening:
    """Something that changed the motion of a run: no part of its plan.

    Parameters
    ----------
    change
        What kind of thing.
    text
        What happened, for people, without its place.
    time_s
        When it was, or began, from the start of the job.
    operation, job_line
        What was under way; None where that is not known.
    axis
        Whose motion it changed; ``""`` for all.
    run
        Number of the first run in which it happened, from 1; None where there was one alone.
    """

    change: Change
    text: str
    time_s: float | None
    operation: int | None = None
    job_line: int | None = None
    axis: str = ""
    run: int | None = None

    @property
    def told(self) -> str:
        """What happened and where, for people."""
        where = [
            "" if self.time_s is None else f"at {self.time_s:.3f} s",
            "" if not self.job_line else f"line {self.job_line}",
            "" if self.run is None else f"run {self.run}",
        ]
        return f"{self.text} {', '.join(filter(None, where))}".rstrip()


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
        How many runs of the machine were judged.
    machines
        How many other machines within its tolerances were, too.
    wished
        Share of these machines that has to be in specification; None where every one has to be.
    ends
        How many machines at the ends of the tolerances of loads and springs were, one run each.
    band
        How many machines with modes all over a band were, one run each.
    incomplete
        How a run ended before its last row; empty where none did.
    late_ticks
        Ticks of all runs at which a row was due and had not come.
    limits_alone
        Whether only limits and time were judged: the runs are simulated, and the machine file has
        no dynamics.
    recorded
        Whether recordings were judged, and not runs that were simulated for the verdict.
    happenings
        What changed the motion of the runs, in the order of time.
    """

    results: tuple[Result, ...]
    simulated: bool
    runs: int = 1
    machines: int = 0
    wished: float | None = None
    ends: int = 0
    band: int = 0
    incomplete: str = ""
    late_ticks: int = 0
    limits_alone: bool = False
    recorded: bool = False
    happenings: tuple[Happening, ...] = ()

    @property
    def level(self) -> Level:
        """How far it reaches."""
        if self.limits_alone:
            return Level.LIMITS
        return level_of(self.runs, self.machines, self.wished)

    @property
    def tightest(self) -> Result | None:
        """The result that uses most of its limit; None where no limit above 0 was measured.

        The machine's own limits do not count: a plan is made to use them.
        """
        held = [r for r in self.results if r.limit and r.measured is not None and not r.hard]
        return max(held, key=_share, default=None)

    @property
    def answers(self) -> bool:
        """Whether anything was measured that has a limit other than the machine's own."""
        return any(
            r.limit is not None and r.measured is not None and not r.hard for r in self.results
        )

    @property
    def passed(self) -> bool:
        """Nothing failed, everything required was measured, and every run came to its end."""
        return not self.incomplete and all(
            result.status is not Status.FAILED
            and not (result.required and result.status is Status.NOT_MEASURED)
            for result in self.results
        )

    def result(self, name: str, axis: str = "") -> Result:
        """Return the result of a criterion, of the worst axis where none is named.

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
