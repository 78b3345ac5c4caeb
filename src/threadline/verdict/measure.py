"""What every measure has in common: it starts on a recording, is fed blocks, and finishes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, ClassVar, Generic, Literal, NamedTuple, Protocol, TypeVar

from threadline.base.arrays import IntArray
from threadline.commands.plan import Plan
from threadline.files import ChannelKind, Recording
from threadline.verdict.finding import Finding, Found
from threadline.verdict.samples import Block
from threadline.verdict.types import Status

Dimension = Literal[
    "tool", "axis", "axis/s", "axis/s^2", "axis/s^3", "time", "current", "rate", "ratio", "stitch"
]
"""Of a measured value: a length at the tool, the axis' own unit (m or rad) and its rates, ..."""


class Measure(Protocol):
    """Measures one recording in one pass, all runs of it at once."""

    def feed(self, block: Block) -> None:
        """Take the next samples."""

    def finish(self) -> Sequence[Found]:
        """Return the worst of what was fed, of every run: for each axis, or for the tool."""


class SweptMeasure(ABC):
    """A measure that takes the samples of a block in the sweep of all measures (``sweep.feed``).

    Its part in a sweep is what compiled loops read and fill in. When it is fed, the sweep is over:
    it takes from its part what came of the block.
    """

    @abstractmethod
    def part(self, block: Block) -> NamedTuple | None:
        """Return its part in the sweep over ``block``; None where it takes none."""

    @abstractmethod
    def feed(self, block: Block) -> None:
        """Take what the sweep found in ``block``."""

    @abstractmethod
    def finish(self) -> Sequence[Found]:
        """Return the worst of what was fed, as ``Measure.finish``."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Option:
    """An option of a measure: its SI unit and its default."""

    unit: str
    default: float


Needs = tuple[tuple[ChannelKind, ...], ...]
"""Kinds of channel, each a set of alternatives, without which nothing is measured."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Running:
    """A measurement that has begun: of what kind, how it reads its run, and itself."""

    kind: MeasureKind
    reading: RunReading
    measure: Measure


class Run(Protocol):
    """One recording beside its plan, as the measures of its kind of work read it.

    ``of`` says in words what it is a run of. ``absent`` is said of an axis of which nothing was
    found.
    """

    of: ClassVar[str]
    absent: ClassVar[str]

    @property
    def plan(self) -> Plan:
        """What was intended."""

    @property
    def recording(self) -> Recording:
        """What is judged."""

    @property
    def by_time(self) -> bool:
        """Whether the operations are those of the plan at the same instant."""

    @property
    def untold(self) -> Run | None:
        """The same run with the operations of the plan; None once it is known which ones count.

        A live recording may have a column of operations that says nothing. Until it says
        something both runs are measured: they share one stream of blocks, and are read in step.
        """

    def lacks(self, reading: RunReading, per_axis: bool) -> str:
        """Say why the recording cannot tell what a measure asks for; empty where it can."""

    def blocks(self) -> Iterator[Block]:
        """Yield what measures are fed with; reads the recording."""

    def leave(self) -> None:
        """Read no more of the recording."""

    def results(self, running: Sequence[Running], last: Block | None) -> list[list[Found]]:
        """Return what each measure found, as far as it was seen, after the last block."""

    def unseen(self, reading: RunReading) -> str:
        """Say, once the recording was read, what a measure of many runs did not see of it."""

    def release(self) -> None:
        """Forget the samples of this run, once the measures that read one run have finished.

        What measures of many runs read is kept.
        """


RunT_contra = TypeVar("RunT_contra", contravariant=True)
Options = Mapping[str, float]


class MeasureOfRuns(Protocol):
    """Measures runs that were recorded one by one, in one pass over all of them in step."""

    def feed(self, number: int, block: Block, by_time: IntArray | None) -> None:
        """Take the next samples of a run.

        Parameters
        ----------
        number
            Number of the run, from 0 on.
        by_time
            (n,) operations of the plan at the same instants, as long as nobody knows whether the
            recording has its own.
        """

    def finish(self, runs: Sequence[Any]) -> Sequence[Finding]:
        """Return what was found; ``runs`` are those that count in the end (``Run.untold``)."""


@dataclass(frozen=True, slots=True)
class _WholeRuns:
    """A measure that reads its runs whole, and not block by block."""

    finish: Callable[[Sequence[Any]], Sequence[Finding]]

    def feed(self, number: int, block: Block, by_time: IntArray | None) -> None:
        """Take no notice: the runs are there already."""


def whole_runs(
    measure: Callable[[Sequence[RunT_contra], Options], Sequence[Finding]],
) -> Callable[[Sequence[RunT_contra], Options], MeasureOfRuns]:
    """Return what begins a measurement that a function makes of whole runs at once."""
    return lambda _, options: _WholeRuns(lambda runs: measure(runs, options))


@dataclass(frozen=True, slots=True)
class _Whole:
    """A measure that has its run whole, and needs no samples one after the other."""

    findings: Callable[[], Sequence[Finding]]

    def finish(self) -> Sequence[Found]:
        """Measure the whole run, and return the findings."""
        return [Found.made([finding]) for finding in self.findings()]

    def feed(self, block: Block) -> None:
        """Take no notice: the run is there already."""


def whole(
    measure: Callable[[RunT_contra, Options], Sequence[Finding]],
) -> Callable[[RunT_contra, Options], Measure]:
    """Return what begins a measurement that a function makes of a whole run at once."""
    return lambda run, options: _Whole(partial(measure, run, options))


@dataclass(frozen=True, slots=True, kw_only=True)
class OfPlan:
    """A measure that reads the plan alone.

    Parameters
    ----------
    intent
        The plans that it is measured on, by what they intend.
    measure
        Returns its findings, and those of other measures that fall out of the same pass, by name.
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
        The runs that it is measured on.
    start
        Begins a measurement of one.
    needs
        Without which nothing is measured.
    follows
        Whether it follows the motion in time: samples farther apart than the lag tell nothing.
    of_every_axis
        The kind of channel that it needs of all axes, although it measures single ones: a command
        has ended only when that of every axis has.
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
        Begins a measurement of runs that were recorded one by one.
    start
        Begins a measurement of runs that one recording holds side by side; None where none can.
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
        Of the value.
    per_axis
        One finding per axis; else one for the tool.
    reads
        The input that it reads (the plan alone, one run, many runs), and how: once for each form
        that this input has. A plan or run of no such form has nothing to measure.
    options
        What a specification may set.
    of_worst
        Whether it is a maximum over samples: further samples can only make it larger.
    slack, allowance
        The limit is exceeded above ``slack * limit + allowance``.
    """

    name: str
    dimension: Dimension
    per_axis: bool
    reads: tuple[Reading, ...]
    options: Mapping[str, Option] = field(default_factory=dict)
    of_worst: bool = False
    slack: float = 1.0
    allowance: float = 0.0

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
        """Whether it reads many runs of one machine together, and nothing of a single one."""
        return any(isinstance(reading, OfRuns) for reading in self.reads)

    def of_run(self, run: object) -> RunReading | None:
        """Return how it reads such a run, or None where it reads none."""
        for reading in self.reads:
            if not isinstance(reading, OfPlan) and isinstance(run, reading.run):
                return reading
        return None

    def of_plan(self, plan: Plan) -> OfPlan | None:
        """Return how it reads such a plan, or None where it reads none."""
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
        units = {"tool": "m", "time": "s", "current": "A", "rate": "Hz", "ratio": ""}
        return (units | {"stitch": "stitch"})[self.dimension]

    def status(self, value: float | None, limit: float | None) -> Status:
        """Return what comes of a measured value under a limit, each None where there is none."""
        if value is None:
            return Status.NOT_MEASURED
        if limit is None:
            return Status.REPORTED
        within = value <= self.slack * limit + self.allowance
        return Status.PASSED if within else Status.FAILED
