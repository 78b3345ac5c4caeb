"""What every measure has in common: it starts on a recording, is fed blocks, and finishes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, ClassVar, Generic, Literal, Protocol, TypeVar

import numpy as np

from threadline.arrays import FloatArray
from threadline.plan import Plan
from threadline.signals import ChannelKind, Recording
from threadline.verdict.samples import Block
from threadline.verdict.types import Status, is_measured

Dimension = Literal[
    "tool", "axis", "axis/s", "axis/s^2", "axis/s^3", "time", "current", "rate", "ratio", "stitch"
]
"""Of a measured value: a length at the tool, the axis' own unit (m or rad) and its rates, ..."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """The worst value of one measure, of one axis or (``""``) of the tool.

    ``value`` is None where nothing could be measured; ``note`` then says why. ``step`` is the step
    of a move list. ``seen`` is the worst of what the recording came to, where the value also counts
    what it did not come to. ``unseen`` says what was not seen, where the value is only the worst of
    the rest: it can fail a limit, and not pass one.
    """

    value: float | None
    axis: str = ""
    time_s: float | None = None
    operation: int | None = None
    job_line: int | None = None
    position: tuple[float, ...] | None = None
    note: str = ""
    step: str = ""
    seen: Finding | None = None
    unseen: str = ""

    def worse(self, other: Finding) -> Finding:
        """Return the worse of the same finding of two recordings.

        Where one of them was not measured, neither limit nor passing is known, but for a value of
        the other that fails.
        """
        if self.value is None or other.value is None:
            if self.value is None and other.value is None:
                return self
            blank, known = (self, other) if self.value is None else (other, self)
            return replace(known, unseen=known.unseen or blank.note)
        larger = other if other.value > self.value else self
        return replace(larger, unseen=self.unseen or other.unseen)

    def under(self, kind: MeasureKind, limit: float | None) -> Finding:
        """Return what counts under a limit: of what was only partly seen, whether it fails."""
        if not self.unseen:
            return self
        if kind.status(self.value, limit) is Status.FAILED:
            note = "; ".join(filter(None, (self.note, self.unseen)))
            return replace(self, note=note, unseen="")
        return Finding(value=None, axis=self.axis, step=self.step, note=self.unseen)

    def in_unit(self, unit: str) -> Finding:
        """Return the finding as it may stand in a verdict: what is no number is not measured."""
        if self.value is None or is_measured(self.value, unit):
            return self
        note = "; ".join(filter(None, (self.note, "no number came of these samples")))
        return replace(self, value=None, note=note)


def somewhere(finding: Finding) -> Finding:
    """Return a finding without its place if it is zero: no place is worse than another then."""
    if finding.value != 0.0:
        return finding
    return replace(finding, time_s=None, operation=None, job_line=None, position=None)


class Measure(Protocol):
    """Measures one recording in one pass."""

    def feed(self, block: Block) -> None:
        """Take the next samples."""

    def finish(self) -> Sequence[Finding]:
        """Return the worst of what was fed: one finding per axis, or one for the tool."""


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

    ``of`` says in words what it is a run of. Where ``by_time``, the operations of the recording
    are those of the plan at the same instant. ``absent`` is said of an axis of which nothing was
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
        """Whether the operations are the plan's."""

    def lacks(self, reading: RunReading, per_axis: bool) -> str:
        """Say why the recording cannot tell what a measure asks for; empty where it can."""

    def results(self, running: Sequence[Running]) -> list[list[Finding]]:
        """Read the recording once; return what each measure found, as far as it was seen."""

    def unseen(self, reading: RunReading) -> str:
        """Say, once the recording was read, what a measure of many runs did not see of it."""


RunT_contra = TypeVar("RunT_contra", contravariant=True)
Options = Mapping[str, float]


@dataclass(frozen=True, slots=True)
class _Whole:
    """A measure that has its run whole, and needs no samples one after the other."""

    finish: Callable[[], Sequence[Finding]]

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
        It follows the motion in time: samples farther apart than the lag tell nothing.
    of_every_axis
        The kind among the needs that a measure of single axes needs of all: the command has ended
        when that of every axis has.
    """

    run: type[Any]
    start: Callable[[RunT_contra, Options], Measure]
    needs: Needs = ()
    follows: bool = False
    of_every_axis: ChannelKind | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class OfRuns(Generic[RunT_contra]):
    """A measure that reads many runs of one job together; otherwise as ``OfRun``."""

    run: type[Any]
    measure: Callable[[Sequence[RunT_contra], Options], Sequence[Finding]]
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
        It is the worst of all samples: samples more can only make it larger.
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

    def start(self, run: object, options: Options) -> Measure | None:
        """Begin to measure a run, with the defaults for ``options`` that are left out.

        None where it is not a measure of one such run.
        """
        reading = self.of_run(run)
        if not isinstance(reading, OfRun):
            return None
        return reading.start(run, self.with_defaults(options))

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


def largest(values: FloatArray) -> tuple[int, float]:
    """Return index and value of the largest of (n,) values, ignoring NaN; -1 where all are."""
    if not len(values) or np.isnan(values).all():
        return -1, float("nan")
    index = int(np.nanargmax(values))
    return index, float(values[index])
