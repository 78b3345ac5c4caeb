"""Common form of all measures: start on a recording, feed blocks, finish."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, ClassVar, Generic, Literal, NamedTuple, Protocol, TypeVar

from threadline.base.arrays import IntArray
from threadline.commands.plan import Plan
from threadline.files import ChannelKind, Recording
from threadline.verdict.finding import Finding, RunFindings
from threadline.verdict.samples import Block
from threadline.verdict.types import Status

Dimension = Literal[
    "tool",
    "tool/s",
    "axis",
    "axis/s",
    "axis/s^2",
    "axis/s^3",
    "time",
    "current",
    "rate",
    "ratio",
    "stitch",
]
"""Dimension of a measured value: length at the tool, the axis' own unit (m or rad), rates, ..."""


class Measure(Protocol):
    """Measures one recording in one pass, all runs of it at once."""

    def feed(self, block: Block) -> None:
        """Take the next samples."""

    def finish(self) -> Sequence[RunFindings]:
        """Return the worst value of every run: for each axis, or for the tool."""


class SweptMeasure(ABC):
    """A measure that takes the samples of a block in the sweep of all measures (``sweep.feed``).

    ``part`` gives the arrays that compiled loops read and update. ``feed`` is called after the
    sweep, and reads the results from these arrays.
    """

    @abstractmethod
    def part(self, block: Block) -> NamedTuple | None:
        """Return its arrays for the sweep over ``block``; None if it takes no part."""

    @abstractmethod
    def feed(self, block: Block) -> None:
        """Take the sweep's results for ``block``."""

    @abstractmethod
    def finish(self) -> Sequence[RunFindings]:
        """Return the worst value of every run, as ``Measure.finish``."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Option:
    """An option of a measure: its SI unit, its default, and whether 0 would measure nothing."""

    unit: str
    default: float
    above_0: bool = False


Needs = tuple[tuple[ChannelKind, ...], ...]
"""Required kinds of channel; one kind of each set suffices."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Running:
    """A started measurement: its kind, how it reads its run, the measure, and its options."""

    kind: MeasureKind
    reading: RunReading
    measure: Measure
    options: Mapping[str, float] = field(default_factory=dict)


class Run(Protocol):
    """One recording with its plan, in the form that the measures of its kind of work read.

    ``of`` names the kind of run in words. ``absent`` is the reason given for an axis without a
    finding.
    """

    of: ClassVar[str]
    absent: ClassVar[str]

    @property
    def plan(self) -> Plan:
        """The intended work."""

    @property
    def recording(self) -> Recording:
        """The judged recording."""

    @property
    def by_time(self) -> bool:
        """Whether the operations are taken from the plan at the same instant."""

    @property
    def fallback(self) -> Run | None:
        """The same run with the operations of the plan; None once it is known which ones count.

        A live recording may have an empty column of operations. Until a real operation appears both
        runs are measured: they share one stream of blocks, and are read in step.
        """

    def lacks(self, reading: RunReading, per_axis: bool) -> str:
        """Return why the recording lacks data for a measure; empty if it does not."""

    def blocks(self) -> Iterator[Block]:
        """Yield the blocks for the measures; reads the recording."""

    def leave(self) -> None:
        """Read no more of the recording."""

    def results(self, running: Sequence[Running], last: Block | None) -> list[list[RunFindings]]:
        """Return the findings of each measure, as far as seen, after the last block."""

    def unseen(self, reading: RunReading) -> str:
        """Return, after reading, the samples that a measure of many runs missed."""

    def release(self) -> None:
        """Discard the samples of this run, once the measures that read one run have finished.

        Data for measures of many runs is kept.
        """


RunT_contra = TypeVar("RunT_contra", contravariant=True)
Options = Mapping[str, float]


class MeasureOfRuns(Protocol):
    """Measures several recordings in one pass over all of them in step."""

    def feed(self, number: int, block: Block, by_time: IntArray | None) -> None:
        """Take the next samples of a run.

        Parameters
        ----------
        number
            Number of the run, from 0 on.
        by_time
            (n,) operations of the plan at the same instants, until it is known whether the
            recording has its own.
        """

    def finish(self, runs: Sequence[Any]) -> Sequence[Finding]:
        """Return the findings; ``runs`` are the runs that count in the end (``Run.fallback``)."""


@dataclass(frozen=True, slots=True)
class _WholeRuns:
    """A measure that reads whole runs, not blocks."""

    finish: Callable[[Sequence[Any]], Sequence[Finding]]

    def feed(self, number: int, block: Block, by_time: IntArray | None) -> None:
        """Do nothing: the whole runs are read at the end."""


def whole_runs(
    measure: Callable[[Sequence[RunT_contra], Options], Sequence[Finding]],
) -> Callable[[Sequence[RunT_contra], Options], MeasureOfRuns]:
    """Return a starter for a measure that is a function of whole runs."""
    return lambda _, options: _WholeRuns(lambda runs: measure(runs, options))


@dataclass(frozen=True, slots=True)
class _Whole:
    """A measure that reads its whole run, not blocks."""

    findings: Callable[[], Sequence[Finding]]

    def finish(self) -> Sequence[RunFindings]:
        """Measure the whole run, and return the findings."""
        return [RunFindings.made([finding]) for finding in self.findings()]

    def feed(self, block: Block) -> None:
        """Do nothing: the whole run is read at the end."""


def whole(
    measure: Callable[[RunT_contra, Options], Sequence[Finding]],
) -> Callable[[RunT_contra, Options], Measure]:
    """Return a starter for a measure that is a function of a whole run."""
    return lambda run, options: _Whole(partial(measure, run, options))


@dataclass(frozen=True, slots=True, kw_only=True)
class OfPlan:
    """A measure that reads the plan alone.

    Parameters
    ----------
    intent
        Type of intent of the plans that it applies to.
    measure
        Returns findings by measure: its own, and findings of other measures from the same pass.
    """

    intent: type
    measure: Callable[[Plan], Mapping[str, Sequence[Finding]]]
    needs: Needs = ()
    follows: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class OfRun(Generic[RunT_contra]):
    """A measure that reads one run.

    Parameters
    ----------
    run
        Type of the runs that it applies to.
    start
        Begins a measurement of one run.
    needs
        Channels without which nothing is measured.
    follows
        Whether it follows the motion in time: samples farther apart than the lag are useless.
    of_every_axis
        Kind of channel that it needs for all axes, although it measures single ones: a command has
        ended only when it has ended on every axis.
    """

    run: type[Any]
    start: Callable[[RunT_contra, Options], Measure]
    needs: Needs = ()
    follows: bool = False
    of_every_axis: ChannelKind | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class OfRuns(Generic[RunT_contra]):
    """A measure that reads many runs of one job together; otherwise as ``OfRun``.

    Parameters
    ----------
    in_step
        Begins a measurement of runs in separate recordings.
    start
        Begins a measurement of parallel runs in one recording; None if it has none.
    """

    run: type[Any]
    in_step: Callable[[Sequence[RunT_contra], Options], MeasureOfRuns]
    start: Callable[[RunT_contra, Options], Measure] | None = None
    needs: Needs = ()
    follows: bool = False
    of_every_axis: ChannelKind | None = None


RunReading = OfRun[Any] | OfRuns[Any]
Reading = OfPlan | RunReading


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasureKind:
    """An entry of the registry of measures.

    Parameters
    ----------
    name
        As in a specification.
    dimension
        Dimension of the value.
    per_axis
        Whether it has one finding per axis; otherwise it has one for the tool.
    reads
        Its input (the plan alone, one run, many runs) and how it is read: one entry for each form
        of this input. A plan or run of another form has nothing to measure.
    options
        Options that a specification may set.
    of_worst
        Whether it is a maximum over samples: further samples can only make it larger.
    slack, allowance
        The limit is exceeded above ``slack * limit + allowance``.
    least, most
        Range of possible values; the share of a whole is at most 1.
    """

    name: str
    dimension: Dimension
    per_axis: bool
    reads: tuple[Reading, ...]
    options: Mapping[str, Option] = field(default_factory=dict)
    of_worst: bool = False
    slack: float = 1.0
    allowance: float = 0.0
    least: float = 0.0
    most: float = math.inf

    @property
    def needs(self) -> Needs:
        """Kinds of channel without which nothing is measured, for each form of its input."""
        return tuple(alternatives for reading in self.reads for alternatives in reading.needs)

    @property
    def follows(self) -> bool:
        """Whether it follows the motion in time."""
        return any(reading.follows for reading in self.reads)

    @property
    def compares_runs(self) -> bool:
        """Whether it compares many runs of one machine, and is undefined for a single run."""
        return any(isinstance(reading, OfRuns) for reading in self.reads)

    def of_run(self, run: object) -> RunReading | None:
        """Return how it reads such a run; None if it cannot."""
        for reading in self.reads:
            if not isinstance(reading, OfPlan) and isinstance(run, reading.run):
                return reading
        return None

    def of_plan(self, plan: Plan) -> OfPlan | None:
        """Return how it reads such a plan; None if it cannot."""
        for reading in self.reads:
            if isinstance(reading, OfPlan) and isinstance(plan.intent, reading.intent):
                return reading
        return None

    def with_defaults(self, given: Mapping[str, float]) -> dict[str, float]:
        """Return every option of the measure: as ``given``, else its default."""
        return {name: given.get(name, option.default) for name, option in self.options.items()}

    def unit(self, axis_kind: str) -> str:
        """Return the SI unit of the value; ``axis_kind`` is ``linear`` or ``rotary``."""
        length = "m" if axis_kind == "linear" else "rad"
        if self.dimension.startswith("axis"):
            return length + self.dimension.removeprefix("axis")
        units = {
            "tool": "m",
            "tool/s": "m/s",
            "time": "s",
            "current": "A",
            "rate": "Hz",
            "ratio": "",
        }
        return (units | {"stitch": "stitch"})[self.dimension]

    def status(self, value: float | None, limit: float | None) -> Status:
        """Return the status of a measured value under a limit; each may be None."""
        if value is None:
            return Status.NOT_MEASURED
        if limit is None:
            return Status.REPORTED
        within = value <= self.slack * limit + self.allowance
        return Status.PASSED if within else Status.FAILED
