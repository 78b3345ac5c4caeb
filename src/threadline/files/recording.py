"""Recordings: named channels of a stated kind, and the outcome of the run."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.errors import RecordingError
from threadline.files.clock import Clock, Event
from threadline.files.stream import Stream


class RunEnd(StrEnum):
    """How a run ended: the kind of the last event of its recording."""

    COMPLETED = "completed"  # every row was played
    STOPPED = "stopped"  # ended early by the operator, or by a stop without an answer
    FAULT = "fault"  # the machine, or the link to it, failed


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """Outcome of a run, from the events of its recording.

    Parameters
    ----------
    ended
        How the run ended; None if no event says it, as in a trace of another controller.
    text
        Reason for a stop or a fault; empty for a completed run.
    tick
        Tick at which the run ended, on the clock of the recording; None if ``ended`` is None.
    operation
        Index of the operation in progress at the end.
    late_ticks
        Number of ticks at which a row was due but missing.
    halted_ticks
        Total number of ticks from each stop, wait or hold to its resumption, without a halt at the
        end of the run.
    halted_since
        Tick at which a halt that was not resumed began; None if there is none.

    Examples
    --------
    >>> run = (Event(tick=5, kind="late", operation=1, value=3.0),
    ...        Event(tick=9, kind="fault", operation=2, name="the link is gone"))
    >>> outcome = Outcome().after(run)
    >>> outcome.incomplete, outcome.late_ticks, outcome.text
    (True, 3, 'the link is gone')
    """

    ended: RunEnd | None = None
    text: str = ""
    tick: int | None = None
    operation: int | None = None
    late_ticks: int = 0
    halted_ticks: int = 0
    halted_since: int | None = None

    @property
    def incomplete(self) -> bool:
        """Whether the run ended before its last row."""
        return self.ended in {RunEnd.STOPPED, RunEnd.FAULT}

    def after(self, events: Iterable[Event]) -> Outcome:
        """Return the outcome after further events, which are given in order."""
        outcome = self
        for event in events:
            if event.kind in tuple(RunEnd):
                outcome = replace(
                    outcome,
                    ended=RunEnd(event.kind),
                    text=event.name,
                    tick=event.tick,
                    operation=event.operation,
                )
            elif event.kind == "late":
                outcome = replace(outcome, late_ticks=outcome.late_ticks + int(event.value))
            elif event.kind in {"stop", "wait", "hold"} and outcome.halted_since is None:
                outcome = replace(outcome, halted_since=event.tick)
            elif event.kind == "resume" and outcome.halted_since is not None:
                halted = outcome.halted_ticks + event.tick - outcome.halted_since
                outcome = replace(outcome, halted_ticks=halted, halted_since=None)
        return outcome


def end_with_reason(ended: str, why: str) -> str:
    """Return as text how a run ended and why, without repeating a word.

    >>> end_with_reason("stopped", "stopped by the operator")
    'stopped by the operator'
    >>> end_with_reason("fault", "the link is gone")
    'fault: the link is gone'
    """
    if not why:
        return ended
    return why if why.startswith(ended) else f"{ended}: {why}"


class ChannelKind(StrEnum):
    """Quantity that a channel records."""

    COMMANDED = "commanded"  # commanded position of the axis
    MEASURED = "measured"  # position of the axis' encoder
    LOAD = "load"  # position of the driven mass
    VELOCITY = "velocity"  # velocity of the driven mass
    FRAME = "frame"  # position of the frame
    TOOL = "tool"  # position of the point that does the work
    VOLTAGE = "voltage"  # voltage at the amplifier's input
    CURRENT = "current"  # current in the motor
    TORQUE_SHARE = "torque_share"  # needed torque / available torque of a stepper or pulse servo
    SENSOR = "sensor"  # reading of a sensor that is not the encoder of an axis
    TENSION = "tension"  # tension of a winder's fibre at the eye
    INPUT = "input"  # state of a digital input, 0 or 1
    OUTPUT = "output"  # state of a digital output, 0 or 1
    OPERATION = "operation"  # index of the job operation in progress


_SHARED = (ChannelKind.COMMANDED, ChannelKind.OPERATION, ChannelKind.OUTPUT)
"""Kinds of channels that are the same in all runs of the same commands."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Channel:
    """One signal of a recording.

    Parameters
    ----------
    name
        Unique within the recording, for instance ``"X.load"``.
    kind
        Quantity of the samples.
    unit
        SI unit of the samples, ``""`` for numbers without unit.
    clock, stride
        The clock of the samples, and the number of ticks from sample to sample.
    axis
        Axis of the channel, ``""`` if it belongs to no axis.
    """

    name: str
    kind: ChannelKind
    unit: str
    clock: Clock
    axis: str = ""
    stride: int = 1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordingBlock:
    """A run of samples of every channel.

    Parameters
    ----------
    first_tick
        Clock name -> tick of the first sample of each channel with this clock.
    samples
        Channel name -> (n,) float64 samples; n is the same for channels with the same clock and
        stride. In a recording of several runs, channels in which the runs differ are (n, runs).
    events
        Events that took effect within the block.
    """

    first_tick: Mapping[str, int]
    samples: Mapping[str, FloatArray]
    events: tuple[Event, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Recording:
    """Recorded motion of a real or simulated machine.

    Sample k of a channel is the value at the instant of its tick, before the controller acts on
    that sample. A channel that the machine cannot measure is absent, never replaced by another.

    Parameters
    ----------
    channels
        The channels, with unique names.
    blocks
        Blocks of samples, in order. They must be a ``Stream`` if they are read more than once or
        sent to another process.
    job_sha256, machine_sha256
        Hashes of the job and of the machine.
    simulated
        False for a live recording.
    origin
        Options of the plan (job file, machine, interpolation, feed, tolerance ...), from which the
        plan can be made again to judge the recording.
    runs
        Number of runs of the same commands that are recorded side by side.
    """

    channels: tuple[Channel, ...]
    blocks: Iterable[RecordingBlock]
    job_sha256: str
    machine_sha256: str
    simulated: bool
    origin: Mapping[str, str] = field(default_factory=dict)
    runs: int = 1
    _by_kind: dict[tuple[ChannelKind, str], Channel] = field(init=False, repr=False)

    def __repr__(self) -> str:
        kind = "simulated" if self.simulated else "live"
        return f"<Recording, {kind}: {', '.join(channel.name for channel in self.channels)}>"

    def __post_init__(self) -> None:
        by_kind = {(c.kind, c.axis): c for c in reversed(self.channels)}
        # Prefer the sampled current ``X.current``, even if ``X.current_peak`` comes first.
        plainly_named = (c for c in self.channels if c.name == f"{c.axis}.{c.kind.value}")
        by_kind |= {(c.kind, c.axis): c for c in plainly_named}
        object.__setattr__(self, "_by_kind", by_kind)

    def __iter__(self) -> Iterator[RecordingBlock]:
        """Yield the blocks; with several runs, samples have a column for each run.

        Commands, operations and outputs are the same in all runs and keep one dimension.

        Raises
        ------
        RecordingError
            If the number of columns of a channel differs from the number of runs.
        """
        return iter(self.blocks) if self.runs == 1 else map(self._side_by_side, self.blocks)

    def _side_by_side(self, block: RecordingBlock) -> RecordingBlock:
        """Return a block with a column for each run."""
        samples = dict(block.samples)
        for channel in self.channels:
            values = samples.get(channel.name)
            if values is None or channel.kind in _SHARED:
                continue
            if values.ndim == 1:
                samples[channel.name] = np.repeat(values[:, np.newaxis], self.runs, axis=1)
            elif values.shape[1:] != (self.runs,):
                raise RecordingError(
                    f"channel {channel.name!r} has samples of shape {values.shape}, but the "
                    f"recording holds {self.runs} runs",
                    remedy="Give one column of samples for each run, or one for all runs.",
                )
        return replace(block, samples=samples)

    def find(self, kind: ChannelKind, axis: str = "") -> Channel | None:
        """Return the channel of ``kind`` and ``axis``, or None if there is none.

        If there are several such channels, return the channel called ``AXIS.kind``, else the first.
        """
        return self._by_kind.get((kind, axis))

    def channel(self, name: str) -> Channel:
        """Return the channel called ``name``.

        Raises
        ------
        RecordingError
            If there is none; the error lists the channels.
        """
        for channel in self.channels:
            if channel.name == name:
                return channel
        known_names = ", ".join(c.name for c in self.channels)
        raise RecordingError(f"no channel {name!r}", remedy=f"It has {known_names}.")

    def run(self, number: int) -> Recording:
        """Return one of several runs, counted from 1, as a recording."""
        if self.runs == 1:
            return self
        return replace(self, blocks=Stream(_of_one_run, self.blocks, number - 1), runs=1)

    def is_empty(self) -> bool:
        """Return whether no channel has a sample; reads up to the first sample."""
        return not any(len(values) for block in self for values in block.samples.values())

    def outcome(self) -> Outcome:
        """Return the outcome of the run; reads every block."""
        outcome = Outcome()
        for block in self:
            outcome = outcome.after(block.events)
        return outcome

    def samples(self, name: str) -> tuple[FloatArray, FloatArray]:
        """Return times in s and values of a whole channel, both (n,); for short recordings."""
        return self.samples_of([name])[name]

    def samples_of(self, names: Iterable[str]) -> dict[str, tuple[FloatArray, FloatArray]]:
        """Return (n,) times, s, and (n,) values of whole channels by name, as ``samples`` does.

        The blocks are read only once, because each reading of a simulated recording that is not
        kept in memory simulates it again.
        """
        channels = {name: self.channel(name) for name in names}
        times: dict[str, list[FloatArray]] = {name: [] for name in channels}
        values: dict[str, list[FloatArray]] = {name: [] for name in channels}
        for block in self:
            for name, channel in channels.items():
                block_values = block.samples[name]
                first = block.first_tick[channel.clock.name]
                times[name].append(channel.clock.times_s(first, len(block_values), channel.stride))
                values[name].append(block_values)
        return {
            name: (np.concatenate(times[name]), np.concatenate(values[name]))
            if times[name]
            else (np.empty(0), np.empty(0))
            for name in channels
        }


def columns_of(recording: Recording) -> dict[str, FloatArray]:
    """Return the channels of one run as (n,) columns over the times of the finest channel.

    Keys are ``time [s]``, then the name of each channel with its unit: ``X.load [m]``. A channel
    with fewer samples holds each sample until its next one, and is NaN before its first sample.
    """
    samples = recording.samples_of(channel.name for channel in recording.channels)
    times_s = max((times for times, _ in samples.values()), key=len, default=np.empty(0))
    columns = {"time [s]": times_s}
    for channel in recording.channels:
        channel_times_s, values = samples[channel.name]
        if len(channel_times_s) != len(times_s) or not np.array_equal(channel_times_s, times_s):
            sample_index = np.searchsorted(channel_times_s, times_s, side="right") - 1
            held_values = (
                values[np.maximum(sample_index, 0)] if len(values) else np.zeros(len(times_s))
            )
            values = np.where(sample_index >= 0, held_values, np.nan)
        columns[f"{channel.name} [{channel.unit}]" if channel.unit else channel.name] = values
    return columns


def _of_one_run(blocks: Iterable[RecordingBlock], run: int) -> Iterator[RecordingBlock]:
    """Yield blocks with the samples of one run; channels that all runs share are (n,) already."""
    for block in blocks:
        yield replace(
            block,
            samples={
                name: values if values.ndim == 1 else values[:, run].copy()
                for name, values in block.samples.items()
            },
        )
