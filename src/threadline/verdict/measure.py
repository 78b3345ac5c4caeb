"""What every measure has in common: it starts on a recording, is fed blocks, and finishes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, Protocol

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.plan import Plan
from threadline.signals import ChannelKind, Recording
from threadline.verdict.switch_run import SwitchRun
from threadline.verdict.types import Status
from threadline.verdict.window import PathWindow

Dimension = Literal["tool", "axis", "axis/s", "axis/s^2", "axis/s^3", "time", "current", "ratio"]
"""Of a measured value: a length at the tool, the axis' own unit (m or rad) and its rates, ..."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """The worst value of one measure, of one axis or (``""``) of the tool.

    ``value`` is None where nothing could be measured; ``note`` then says why. ``step`` is the step
    of a move list.
    """

    value: float | None
    axis: str = ""
    time_s: float | None = None
    operation: int | None = None
    job_line: int | None = None
    position: tuple[float, ...] | None = None
    note: str = ""
    step: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """What a measure knows before the first sample.

    Parameters
    ----------
    plan, recording
        What was intended, and what is judged.
    axes, radius_m
        Of the programmed path: names, and (axes,) lengths at the tool per unit of the axis.
    interval_s
        Time between two samples.
    lag_samples
        How many samples the machine may trail its command.
    """

    plan: Plan
    recording: Recording
    axes: tuple[str, ...]
    radius_m: FloatArray
    interval_s: float
    lag_samples: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Block:
    """Consecutive samples, n of them, with every channel on the same instants.

    Parameters
    ----------
    first
        Number of the first sample since the start.
    time_s
        (n,) instants.
    commanded, actual, own, voltage, current, current_peak
        (n, axes) or None where a channel is absent: the command; the tool or the load; the axis'
        own encoder; the amplifier's input; the motor's current, and its largest since the sample
        before. A column of NaN marks an axis that lacks the channel while another has it.
    operation
        (n,) operation under way, never decreasing, or None.
    chord
        (n,) chord that the command is on, counted from the start of the path, or None.
    begin, end
        (n,) first and last chord that it was or will be on within the lag of each sample.
    path
        The programmed path about these operations, or None without an operation channel.
    """

    first: int
    time_s: FloatArray
    commanded: FloatArray | None
    actual: FloatArray | None
    own: FloatArray | None
    voltage: FloatArray | None
    current: FloatArray | None
    current_peak: FloatArray | None
    operation: IntArray | None
    chord: IntArray | None
    begin: IntArray | None
    end: IntArray | None
    path: PathWindow | None

    def __len__(self) -> int:
        return len(self.time_s)

    def window(self) -> tuple[PathWindow, IntArray, IntArray]:
        """Return the path, and ``begin`` and ``end`` counted within what it holds."""
        assert self.path is not None and self.begin is not None and self.end is not None
        begin = np.maximum(self.begin - self.path.first, 1)
        return self.path, begin, np.maximum(self.end - self.path.first, begin)

    def operation_at(self, index: int) -> int | None:
        """Return the operation under way at a sample."""
        return None if self.operation is None else int(self.operation[index])

    def position_at(self, index: int) -> tuple[float, ...] | None:
        """Return the commanded position at a sample."""
        return None if self.commanded is None else tuple(self.commanded[index].tolist())


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
    needs
        Kinds of channel, each a set of alternatives, without which nothing is measured.
    start
        Begins a measurement of a recording; None for measures of the plan or of many recordings.
    of_many
        Measures all recordings together.
    of_switching
        Measures a run of an on/off machine; None where there is nothing to measure on one.
    options
        What a specification may set.
    follows
        It follows the motion in time: samples farther apart than the lag tell nothing.
    slack, allowance
        The limit is exceeded above ``slack * limit + allowance``.
    """

    name: str
    dimension: Dimension
    per_axis: bool
    needs: tuple[tuple[ChannelKind, ...], ...] = ()
    start: Callable[[Setting, Mapping[str, float]], Measure] | None = None
    of_many: (
        Callable[[Sequence[Recording], Plan, Mapping[str, float]], Sequence[Finding]] | None
    ) = None
    of_switching: Callable[[SwitchRun, Mapping[str, float]], Sequence[Finding]] | None = None
    options: Mapping[str, Option] = field(default_factory=dict)
    follows: bool = False
    slack: float = 1.0
    allowance: float = 0.0

    def with_defaults(self, given: Mapping[str, float]) -> dict[str, float]:
        """Return every option of the measure: as ``given``, else its default."""
        return {name: given.get(name, option.default) for name, option in self.options.items()}

    def unit(self, axis_kind: str) -> str:
        """Return the SI unit of the value; ``axis_kind`` is ``linear`` or ``rotary``."""
        length = "m" if axis_kind == "linear" else "rad"
        if self.dimension.startswith("axis"):
            return length + self.dimension.removeprefix("axis")
        return {"tool": "m", "time": "s", "current": "A", "ratio": ""}[self.dimension]

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
