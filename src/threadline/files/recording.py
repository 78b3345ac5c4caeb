"""Recordings: named channels of a stated kind, simulated or real, and how a run ended."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.errors import RecordingError
from threadline.files.clock import Clock, Event
from threadline.files.stream import Stream


class Ended(StrEnum):
    """How a run ended; an event of one of these kinds is the last of a recording."""

    COMPLETED = "completed"  # every row was played
    STOPPED = "stopped"  # the operator, or a stop that nobody answered, ended it early
    FAULT = "fault"  # the machine or the link to it failed


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What the events of a recording say of the run as a whole.

    Parameters
    ----------
    ended
        How the run ended; None where no event says so, as in a trace of another controller.
    text
        Reason of a stop or a fault; empty where the run was completed.
    tick
        Tick of the end on the clock of the recording; None with ``ended``.
    operation
        Index of the operation that was under way at the end.
    late_ticks
        Number of ticks at which a row was due and had not come.
    halted_ticks
        Ticks from each stop, wait or hold to the resumption, summed; a halt that the run ended in
        is not counted.
    halted_since
        Tick at which a halt began that has not been resumed; None where there is none.

    Examples
    --------
    >>> run = (Event(tick=5, kind="late", operation=1, value=3.0),
    ...        Event(tick=9, kind="fault", operation=2, name="the link is gone"))
    >>> outcome = Outcome().after(run)
    >>> outcome.incomplete, outcome.late_ticks, outcome.text
    (True, 3, 'the link is gone')
    """

    ended: Ended | None = None
    text: str = ""
    tick: int | None = None
    operation: int | None = None
    late_ticks: int = 0
    halted_ticks: int = 0
    halted_since: int | None = None

    @property
    def incomplete(self) -> bool:
        """Whether the run ended before its last row."""
        return self.ended in {Ended.STOPPED, Ended.FAULT}

    def after(self, events: Iterable[Event]) -> Outcome:
        """Return the outcome with further events, in their order, taken into account."""
        known = self
        for event in events:
            if event.kind in tuple(Ended):
                known = replace(
                    known,
                    ended=Ended(event.kind),
                    text=event.name,
                    tick=event.tick,
                    operation=event.operation,
                )
            elif event.kind == "late":
                known = replace(known, late_ticks=known.late_ticks + int(event.value))
            elif event.kind in {"stop", "wait", "hold"} and known.halted_since is None:
                known = replace(known, halted_since=event.tick)
            elif event.kind == "resume" and known.halted_since is not None:
                halted = known.halted_ticks + event.tick - known.halted_since
                known = replace(known, halted_ticks=halted, halted_since=None)
        return known


def said_once(ended: str, why: str) -> str:
    """Return how a run ended, and why, without saying a word twice.

    >>> said_once("stopped", "stopped by the operator"), said_once("fault", "the link is gone")
    ('stopped by the operator', 'fault: the link is gone')
    """
    if not why:
        return ended
    return why if why.startswith(ended) else f"{ended}: {why}"


class ChannelKind(StrEnum):
    """What the samples of a channel are."""

    COMMANDED = "commanded"  # where the axis was told to be
    MEASURED = "measured"  # what the axis' own encoder read
    LOAD = "load"  # where the driven mass was
    FRAME = "frame"  # where the frame was
    TOOL = "tool"  # where the point that does the work was
    VOLTAGE = "voltage"  # at the amplifier's input
    CURRENT = "current"  # in the motor
    TORQUE_SHARE = "torque_share"  # torque asked of a position source, over the torque it has
    INPUT = "input"  # state of a digital input, 0 or 1
    OUTPUT = "output"  # state of a digital output, 0 or 1
    OPERATION = "operation"  # index of the operation of the job that was under way


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
        What the samples are.
    unit
        SI unit of the samples, ``""`` for numbers without unit.
    clock, stride
        The clock of the samples, and the number of its ticks from sample to sample.
    axis
        Axis that the channel belongs to, ``""`` for none.
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
        Per clock name: the tick of the first sample of each channel of that clock.
    samples
        Per channel name: (n,) float64, n the same for channels of one clock and stride. A recording
        of several runs has (n, runs) samples of each channel in which the runs differ.
    events
        Events that took effect within the block.
    """

    first_tick: Mapping[str, int]
    samples: Mapping[str, FloatArray]
    events: tuple[Event, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Recording:
    """What a machine, real or simulated, did.

    Sample k of a channel is the value at the instant of its tick, before the controller acts on
    that sample. A channel that the machine cannot measure is absent, and no other replaces it.

    Parameters
    ----------
    channels
        Every channel, each with a name of its own.
    blocks
        Blocks of samples, in order. A ``Stream`` where they are to be read again or sent to another
        process.
    job_sha256, machine_sha256
        Hashes of the job and of the machine.
    simulated
        False for a live recording.
    origin
        How the plan was made (job file, machine, interpolation, feed, tolerance ...), so that a
        recording can be judged on its own.
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

    def __post_init__(self) -> None:
        first = {(c.kind, c.axis): c for c in reversed(self.channels)}
        # ``X.current`` is the current at the samples, also where ``X.current_peak`` stands first.
        plain = (c for c in self.channels if c.name == f"{c.axis}.{c.kind.value}")
        first |= {(c.kind, c.axis): c for c in plain}
        object.__setattr__(self, "_by_kind", first)

    def __iter__(self) -> Iterator[RecordingBlock]:
        """Yield the blocks; of several runs, with a column for each run.

        Commands and operations, which are the same in all runs, and outputs stay as they are.

        Raises
        ------
        RecordingError
            If a channel has another number of columns than there are runs.
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
                    f"channel {channel.name!r} has samples of shape {values.shape}, and the "
                    f"recording holds {self.runs} runs",
                    remedy="Give one column of samples for each run, or one for all runs.",
                )
        return replace(block, samples=samples)

    def find(self, kind: ChannelKind, axis: str = "") -> Channel | None:
        """Return the channel of ``kind`` and ``axis``, or None when the machine has none.

        Of several, it is the one called ``AXIS.kind``, else the first.
        """
        return self._by_kind.get((kind, axis))

    def channel(self, name: str) -> Channel:
        """Return the channel called ``name``.

        Raises
        ------
        RecordingError
            If there is none of that name; the error lists the channels.
        """
        for channel in self.channels:
            if channel.name == name:
                return channel
        known = ", ".join(c.name for c in self.channels)
        raise RecordingError(f"no channel {name!r}", remedy=f"It has {known}.")

    def run(self, number: int) -> Recording:
        """Return one of the runs side by side, counted from 1, as a recording of its own."""
        if self.runs == 1:
            return self
        return replace(self, blocks=Stream(_of_one_run, self.blocks, number - 1), runs=1)

    def is_empty(self) -> bool:
        """Say whether no channel has a sample; reads as far as the first one."""
        return not any(len(values) for block in self for values in block.samples.values())

    def outcome(self) -> Outcome:
        """Return how the run ended and whether its rows came in time; reads every block."""
        known = Outcome()
        for block in self:
            known = known.after(block.events)
        return known

    def samples(self, name: str) -> tuple[FloatArray, FloatArray]:
        """Return times in s and values of a whole channel, both (n,); for short recordings."""
        channel = self.channel(name)
        times, values = [], []
        for block in self:
            part = block.samples[name]
            first = block.first_tick[channel.clock.name]
            times.append(channel.clock.times_s(first, len(part), channel.stride))
            values.append(part)
        if not times:
            return np.empty(0), np.empty(0)
        return np.concatenate(times), np.concatenate(values)


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
