"""Recording -> blocks in which every channel has the same instants and knows its neighbourhood."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.errors import RecordingError
from threadline.plan import Plan
from threadline.signals import Channel, ChannelKind, Recording, RecordingBlock
from threadline.verdict.progress import chords_under_way
from threadline.verdict.samples import Block, Setting
from threadline.verdict.window import PathWindow

_MASTERS = (ChannelKind.TOOL, ChannelKind.LOAD, ChannelKind.MEASURED, ChannelKind.COMMANDED)
_COLUMNS: Mapping[str, tuple[ChannelKind, ...]] = {
    "commanded": (ChannelKind.COMMANDED,),
    "actual": (ChannelKind.TOOL, ChannelKind.LOAD),
    "own": (ChannelKind.MEASURED,),
    "voltage": (ChannelKind.VOLTAGE,),
    "current": (ChannelKind.CURRENT,),
    "torque_share": (ChannelKind.TORQUE_SHARE,),
}
_LARGEST = ("voltage", "current", "current_peak", "torque_share")
# The value of largest magnitude since the sample before: a second channel of the same kind.
_PEAK_NAME = "{axis}.current_peak"
_MOST = 1e15  # SI: a sample beyond it is no measurement
_CHORDS = ("low", "high", "safe")
_ROUNDING = 1e-9  # of a sample: instants of two clocks that should be one may differ by a rounding


def find_first(recording: Recording, kinds: Sequence[ChannelKind], axis: str) -> Channel | None:
    """Return the channel of ``axis`` of the first of ``kinds`` that the recording has."""
    for kind in kinds:
        channel = recording.find(kind, axis)
        if channel is not None:
            return channel
    return None


def peak_channels(recording: Recording, axes: Sequence[str]) -> list[Channel]:
    """Return the channels of the largest current between samples that there are."""
    names = {_PEAK_NAME.format(axis=axis) for axis in axes}
    return [channel for channel in recording.channels if channel.name in names]


def master_channel(recording: Recording, axes: Sequence[str]) -> Channel:
    """Return the channel whose instants all others are judged at: the actual position, if any.

    Raises
    ------
    RecordingError
        If the recording holds no position of any of ``axes``.
    """
    for kind in _MASTERS:
        for axis in axes:
            channel = recording.find(kind, axis)
            if channel is not None:
                return channel
    raise RecordingError(
        f"the recording holds no position of the axes {', '.join(axes)}",
        remedy="Record at least the measured position of every axis of the job.",
    )


def setting_of(plan: Plan, recording: Recording, lag_s: float = 0.0) -> Setting:
    """Return what a measure knows before the first sample of ``recording``.

    Parameters
    ----------
    lag_s
        How far the machine may trail its command.

    Raises
    ------
    RecordingError
        If the recording holds no position of any axis of the plan.
    """
    axes = plan.motion.programmed.axes
    interval_s = sample_interval_s(master_channel(recording, axes))
    return Setting(
        plan=plan,
        recording=recording,
        axes=axes,
        radius_m=plan.motion.programmed.radius_m,
        interval_s=interval_s,
        lag_samples=int(np.floor(lag_s / interval_s + 1e-9)),
    )


class _Follower:
    """One channel at the instants of another: its own samples, or the last one until the next.

    Of a finer channel that is ``largest`` it is the sample of largest magnitude since the instant
    before: between two instants nothing of it is lost.
    """

    def __init__(self, channel: Channel, master: Channel, *, largest: bool = False) -> None:
        self._channel = channel
        same = channel.clock == master.clock and channel.stride == master.stride
        self._slack_s = None if same else _ROUNDING * sample_interval_s(master)
        self._largest, self._fresh = largest, 0
        self._time_s: FloatArray = np.empty(0)  # of samples that may still be needed
        self._values: FloatArray = np.empty(0)

    def at(self, block: RecordingBlock, time_s: FloatArray) -> FloatArray:
        """Return (n, ...) values at (n,) instants."""
        values = block.samples[self._channel.name]
        if values.ndim == 1 and not np.isfinite(values).all():
            when = "" if not len(time_s) else f" near {float(time_s[0]):.6g} s"
            raise RecordingError(
                f"channel {self._channel.name!r} holds a value that is not finite{when}",
                remedy="Repair the trace, or leave the channel out.",
            )
        if self._slack_s is None:
            # What is missing of it in this block is no number; whoever needs it is told so.
            lacking = max(len(time_s) - len(values), 0)
            known = values[: len(time_s)]
            return known if not lacking else np.concatenate([known, np.full(lacking, np.nan)])
        first = block.first_tick[self._channel.clock.name]
        times = self._channel.clock.times_s(first, len(values), self._channel.stride)
        times = np.concatenate([self._time_s, times])
        values = np.concatenate([self._values, values])
        self._time_s, self._values = times, values
        if not len(times) or not len(time_s):
            return np.full(len(time_s), np.nan)
        held = np.maximum(np.searchsorted(times, time_s + self._slack_s, side="right") - 1, 0)
        keep = int(held[-1])
        self._time_s, self._values = times[keep:], values[keep:]
        if not self._largest:
            return np.asarray(values[held])
        # The first of those kept was taken at the instant before.
        begin = np.minimum(np.concatenate([[self._fresh], held[:-1] + 1]), held)
        self._fresh = 1
        # Of every pair of places the stretch between them; what lies between pairs is left out.
        pairs = np.column_stack([begin, held + 1]).ravel()
        sizes = np.append(np.abs(values[: keep + 1]), 0.0)
        return np.asarray(np.maximum.reduceat(sizes, pairs)[::2])


def sample_interval_s(channel: Channel) -> float:
    """Return the time between two samples of a channel."""
    return float(channel.clock.period_s * channel.stride)


@dataclass(slots=True)
class _Held:
    """Samples in hand: instants, columns of all axes, and whole numbers."""

    time_s: FloatArray
    columns: dict[str, FloatArray]
    whole: dict[str, IntArray]

    def __len__(self) -> int:
        return len(self.time_s)

    def part(self, begin: int, end: int) -> _Held:
        return _Held(
            self.time_s[begin:end],
            {k: v[begin:end] for k, v in self.columns.items()},
            {k: v[begin:end] for k, v in self.whole.items()},
        )


def _samples(recording: Recording, axes: Sequence[str]) -> Iterator[_Held]:
    """Yield the blocks of the recording with one column per axis, on the master's instants."""
    master = master_channel(recording, axes)
    found = {
        name: [find_first(recording, kinds, axis) for axis in axes]
        for name, kinds in _COLUMNS.items()
    }
    found["current_peak"] = [
        next((c for c in recording.channels if c.name == _PEAK_NAME.format(axis=axis)), None)
        for axis in axes
    ]
    followers = {
        name: [
            None if c is None else _Follower(c, master, largest=name in _LARGEST) for c in channels
        ]
        for name, channels in found.items()
        if any(c is not None for c in channels)
    }
    operations = recording.find(ChannelKind.OPERATION)
    operation_follower = None if operations is None else _Follower(operations, master)
    reached = np.iinfo(np.int64).min
    for block in recording:
        count = len(block.samples[master.name])
        _refuse_absurd(block)
        if not count:
            for row in followers.values():
                for follower in row:
                    if follower is not None:
                        follower.at(block, np.empty(0))
            continue
        first = block.first_tick[master.clock.name]
        time_s = master.clock.times_s(first, count, master.stride)
        columns = {
            name: _columns([None if f is None else f.at(block, time_s) for f in row], recording)
            for name, row in followers.items()
        }
        if "commanded" in columns:  # the same of all runs
            columns["commanded"] = columns["commanded"][:, 0]
        whole = {}
        if operation_follower is not None:
            # Where samples are missing it is unknown, as before the first.
            numbers = np.nan_to_num(operation_follower.at(block, time_s), nan=-1.0)
            operation = np.rint(numbers).astype(np.int64)
            # After its end a controller may say -1: the machine is still at its last operation.
            operation = np.maximum.accumulate(np.maximum(operation, reached))
            reached = int(operation[-1])
            whole["operation"] = operation
        yield _Held(time_s, columns, whole)


def _columns(channels: Sequence[FloatArray | None], recording: Recording) -> FloatArray:
    """Return (n, runs, axes) of a channel of each axis, NaN where it has none.

    The runs of one axis at one instant lie side by side.
    """
    count = next(len(values) for values in channels if values is not None)
    shape = count, 1 if all(v is None or v.ndim == 1 for v in channels) else recording.runs
    rows = np.empty((count, len(channels), shape[1]))
    for column, values in enumerate(channels):
        if values is None:
            rows[:, column] = np.nan
        else:
            rows[:, column] = values[:, None] if values.ndim == 1 else values
    return rows.transpose(0, 2, 1)


def _refuse_absurd(block: RecordingBlock) -> None:
    """Refuse samples whose squares could overflow; what is not a number is not measured.

    Runs side by side come from the simulation itself, which looks at what it gives.
    """
    for name, samples in block.samples.items():
        if samples.ndim > 1:
            continue
        if np.isinf(samples).any():
            raise RecordingError(
                f"channel {name!r} holds a value that is not finite",
                remedy="Repair the trace, or leave the channel out.",
            )
        if (np.abs(samples) > _MOST).any():
            worst = float(np.nanmax(np.abs(samples)))
            raise RecordingError(
                f"channel {name!r} has a sample of {worst:.3g}, beyond {_MOST:g}",
                remedy="No machine can have measured it; record it again.",
            )


def judged_blocks(
    recording: Recording, axes: Sequence[str], lag_samples: int, path: PathWindow | None
) -> Iterator[Block]:
    """Yield every sample once, in order, with the chords within the lag before and after it.

    Memory holds one block of the recording, twice the lag, and the programmed path about them.

    Parameters
    ----------
    recording
        Read once.
    axes
        Order of the columns.
    lag_samples
        The lag, in samples.
    path
        Moved along with the blocks; None leaves it out.
    """
    waiting: list[_Held] = []  # samples that were not yielded yet, the oldest first
    past: dict[str, IntArray] = {}  # chords of the samples before them, as far as the lag reaches
    last: FloatArray | None = None  # the command before the next samples
    first = 0
    for fresh in _samples(recording, axes):
        if path is not None and "operation" in fresh.whole:
            fresh.whole |= _chords(fresh, path, last)
            commanded = fresh.columns.get("commanded")
            last = None if commanded is None else commanded[-1] * path.radius_m
        waiting.append(fresh)
        ready = sum(map(len, waiting)) - lag_samples
        chords = _joined([past, *(one.whole for one in waiting)])
        at = len(past.get("low", ()))
        while waiting and ready > 0:
            part = waiting[0].part(0, ready)
            yield _block(part, chords, at, first, lag_samples, path)
            first, at, ready = first + len(part), at + len(part), ready - len(part)
            waiting[0] = waiting[0].part(len(part), len(waiting[0]))
            if not len(waiting[0]):
                del waiting[0]
        past = {k: v[max(at - lag_samples - 1, 0) : at] for k, v in chords.items()}
    chords = _joined([past, *(one.whole for one in waiting)])
    at = len(past.get("low", ()))
    for part in waiting:
        yield _block(part, chords, at, first, lag_samples, path)
        first, at = first + len(part), at + len(part)


def _joined(parts: Sequence[Mapping[str, IntArray]]) -> dict[str, IntArray]:
    """Return the chords of consecutive samples as one; nothing where they are not known."""
    known = [part for part in parts if "low" in part]
    return {
        name: np.concatenate([part[name] for part in known]) for name in (_CHORDS if known else ())
    }


def _block(
    part: _Held,
    chords: Mapping[str, IntArray],
    at: int,
    first: int,
    lag_samples: int,
    path: PathWindow | None,
) -> Block:
    """Return a block of ``part``, whose first sample has row ``at`` of ``chords``."""
    chord_begin = chord_end = None
    if path is not None and chords:
        low, high = chords["low"], chords["high"]
        rows = np.arange(at, at + len(part))
        chord_begin = np.minimum(low[np.maximum(rows - lag_samples, 0)], low[rows])
        chord_end = np.maximum(high[np.minimum(rows + lag_samples, len(high) - 1)], high[rows])
        # One sample back: the way from the last sample to this one still counts there.
        path.drop(int(chords["safe"][max(at - 1 - lag_samples, 0)]))
    return Block(
        first=first,
        time_s=part.time_s,
        commanded=part.columns.get("commanded"),
        actual=part.columns.get("actual"),
        own=part.columns.get("own"),
        voltage=part.columns.get("voltage"),
        current=part.columns.get("current"),
        current_peak=part.columns.get("current_peak"),
        torque_share=part.columns.get("torque_share"),
        operation=part.whole.get("operation"),
        chord=part.whole.get("low"),
        begin=chord_begin,
        end=chord_end,
        path=path if chord_begin is not None else None,
    )


def _chords(fresh: _Held, path: PathWindow, before: FloatArray | None) -> dict[str, IntArray]:
    """Return the chords that the samples are on, and the first that any later one can be on."""
    operation = fresh.whole["operation"]
    path.reach(int(operation[-1]))
    commanded = fresh.columns.get("commanded")
    at_tool = None if commanded is None else commanded * path.radius_m
    low, high = chords_under_way(path, operation, at_tool, before)
    return {"low": low, "high": high, "safe": path.chord_from(operation) - 1 + path.first}
