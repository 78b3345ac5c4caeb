"""Turn a recording into blocks: all channels at the same instants, with the path around them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray
from threadline.commands.plan import Plan
from threadline.errors import RecordingError
from threadline.files import Channel, ChannelKind, Recording, RecordingBlock
from threadline.verdict.progress import PlanClock, chords_under_way, shares_of
from threadline.verdict.samples import (
    MOST_WAITING,
    Block,
    Follower,
    Setting,
    Steady,
    sample_interval_s,
    samples_of_lag,
    together,
)
from threadline.verdict.window import PathWindow

_MASTERS = (ChannelKind.TOOL, ChannelKind.LOAD, ChannelKind.MEASURED, ChannelKind.COMMANDED)
_COLUMNS: Mapping[str, tuple[ChannelKind, ...]] = {
    "commanded": (ChannelKind.COMMANDED,),
    "actual": (ChannelKind.TOOL, ChannelKind.LOAD),
    "velocity": (ChannelKind.VELOCITY,),
    "own": (ChannelKind.MEASURED,),
    "voltage": (ChannelKind.VOLTAGE,),
    "current": (ChannelKind.CURRENT,),
    "torque_share": (ChannelKind.TORQUE_SHARE,),
}
_LARGEST = ("voltage", "current", "current_peak", "torque_share")
# The value of largest magnitude since the previous sample: a second channel of the same kind.
_PEAK_NAME = "{axis}.current_peak"
_CHORDS = ("low", "high", "safe", "share")
FEW = 1024  # samples: a smaller block waits for more, because each block costs every measure a call
_OF_RUNS = 1 << 18  # samples of all runs together that are enough, as in a block of the twin
COPIED = 60_000  # values of a column up to which joining two blocks costs less than a block


def find_first(recording: Recording, kinds: Sequence[ChannelKind], axis: str) -> Channel | None:
    """Return the channel of ``axis`` with the first of ``kinds`` that the recording has."""
    for kind in kinds:
        channel = recording.find(kind, axis)
        if channel is not None:
            return channel
    return None


def peak_channels(recording: Recording, axes: Sequence[str]) -> list[Channel]:
    """Return the existing channels of the largest current between samples."""
    names = {_PEAK_NAME.format(axis=axis) for axis in axes}
    return [channel for channel in recording.channels if channel.name in names]


def master_channel(recording: Recording, axes: Sequence[str]) -> Channel:
    """Return the channel that sets the instants of all others: the actual position, if recorded.

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
    """Return the facts about a recording and its plan that a measure needs before the first sample.

    Parameters
    ----------
    lag_s
        Free following error in time: how far the machine may trail its command.

    Raises
    ------
    RecordingError
        If the recording holds no position of any axis of the plan.
    BudgetError
        If the lag has too many samples to hold in memory.
    """
    axes = plan.motion.programmed.axes
    interval_s = sample_interval_s(master_channel(recording, axes))
    return Setting(
        plan=plan,
        recording=recording,
        axes=axes,
        radius_m=plan.motion.programmed.radius_m,
        interval_s=interval_s,
        lag_samples=samples_of_lag(lag_s, interval_s, recording.runs),
    )


_Places = dict[str, NDArray[Any]]
"""(n,) operations, chords of the path as in ``_CHORDS``, and the share of the chord ``low``."""


@dataclass(slots=True)
class _Held:
    """Buffered samples: instants, columns of all axes, places on the path, and the plan's time."""

    time_s: FloatArray
    columns: dict[str, FloatArray]
    whole: _Places
    plan_s: FloatArray | None = None  # if it differs from the clock
    slow: NDArray[np.bool_] | None = None

    def __len__(self) -> int:
        return len(self.time_s)

    def short_with(self, after: _Held) -> bool:
        """Return whether copying both into one costs less than measuring one more block."""
        return sum(max(v.size for v in one.columns.values()) for one in (self, after)) <= COPIED

    def joined(self, after: _Held) -> _Held:
        """Return these samples, followed by ``after``."""
        held = self.slow is not None or after.slow is not None
        return _Held(
            np.concatenate([self.time_s, after.time_s]),
            {k: _behind(v, after.columns[k]) for k, v in self.columns.items()},
            {k: np.concatenate([v, after.whole[k]]) for k, v in self.whole.items()},
            np.concatenate([one.due_s for one in (self, after)]) if held else None,
            np.concatenate([one.slowed for one in (self, after)]) if held else None,
        )

    @property
    def due_s(self) -> FloatArray:
        """(n,) the plan's time at each sample."""
        return self.time_s if self.plan_s is None else self.plan_s

    @property
    def slowed(self) -> NDArray[np.bool_]:
        """(n,) whether the plan's time advanced less than the clock since the previous sample."""
        return np.zeros(len(self), dtype=np.bool_) if self.slow is None else self.slow


def _behind(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return both arrays joined; the runs of one axis at one instant stay side by side."""
    sides = [np.swapaxes(part, 1, -1) for part in (first, second)]
    return np.swapaxes(np.concatenate(sides), 1, -1)


def _samples(recording: Recording, axes: Sequence[str]) -> Iterator[_Held]:
    """Yield the blocks of the recording with one column per axis, at the master's instants."""
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
            None if c is None else Follower(c, master, largest=name in _LARGEST) for c in channels
        ]
        for name, channels in found.items()
        if any(c is not None for c in channels)
    }
    tension = recording.find(ChannelKind.TENSION)
    if tension is not None:
        followers["tension"] = [Follower(tension, master)]
    operations = recording.find(ChannelKind.OPERATION)
    if operations is not None:
        followers["operation"] = [Follower(operations, master)]
    waiting, plan_clock = _Waiting(recording, followers), PlanClock(master.clock)
    reached = np.iinfo(np.int64).min
    for block in chain(recording, (None,)):
        if block is None:  # the recording has ended
            parts = waiting.taken(0)
        else:
            plan_clock.take(block.events)
            count = len(block.samples[master.name])
            first = block.first_tick.get(master.clock.name, 0)
            waiting.take(block, master.clock.times_s(first, count, master.stride))
            parts = waiting.taken(waiting.unknown())
        for part in parts:
            numbers = part.columns.pop("operation", None)
            if "commanded" in part.columns:  # the same for all runs
                part.columns["commanded"] = part.columns["commanded"][:, 0]
            if numbers is not None:
                # Where samples are missing the operation is unknown, as before the first sample.
                numbered = np.where(np.isnan(numbers[:, 0, 0]), -1.0, numbers[:, 0, 0])
                operation = np.rint(numbered).astype(np.int64)
                # After its end a controller may send -1: the last operation still holds.
                operation = np.maximum.accumulate(np.maximum(operation, reached))
                reached = int(operation[-1])
                part.whole["operation"] = operation
            due_s, part.slow = plan_clock.at(part.time_s)
            part.plan_s = None if part.slow is None else due_s
            yield part


class _Waiting:
    """Samples that wait until every channel has reached their instant.

    Channels with the same clock and stride arrive together. Others may lag: up to
    ``MOST_WAITING`` samples of the master wait for them.

    Parameters
    ----------
    recording
        The recording that the samples come from.
    followers
        Interpolators per column and axis; None if there is no channel.
    """

    def __init__(
        self, recording: Recording, followers: Mapping[str, Sequence[Follower | None]]
    ) -> None:
        self._recording, self._followers = recording, followers
        self._others = [f for row in followers.values() for f in row if f and not f.same]
        self._held: list[tuple[FloatArray, dict[Follower, FloatArray]]] = []  # the oldest first

    def take(self, block: RecordingBlock, time_s: FloatArray) -> None:
        """Take a block in which the master has samples at ``time_s``."""
        for follower in self._others:
            follower.take(block)
        if len(time_s):
            every = (f for row in self._followers.values() for f in row if f and f.same)
            self._held.append((time_s, {f: f.values(block, len(time_s)) for f in every}))

    def unknown(self) -> int:
        """Return how many of the last samples still lack a channel."""
        if not self._others:
            return 0
        count = 0
        for time_s, _ in self._held:
            count += len(time_s) - min(f.known(time_s) for f in self._others)
        return min(count, MOST_WAITING)

    def taken(self, left: int) -> Iterator[_Held]:
        """Yield all samples except the last ``left``, block by block."""
        count = sum(len(time_s) for time_s, _ in self._held) - left
        while count > 0:
            time_s, own = self._held.pop(0)
            if count < len(time_s):
                rest = {f: values[count:] for f, values in own.items()}
                self._held.insert(0, (time_s[count:], rest))
                time_s, own = time_s[:count], {f: values[:count] for f, values in own.items()}
            count -= len(time_s)
            columns = {
                name: _columns(
                    [None if f is None else own[f] if f.same else f.at(time_s) for f in row],
                    self._recording,
                )
                for name, row in self._followers.items()
            }
            yield _Held(time_s, columns, {})


def _columns(channels: Sequence[FloatArray | None], recording: Recording) -> FloatArray:
    """Return (n, runs, axes) from one channel per axis, NaN for an axis without a channel.

    The runs of one axis at one instant lie side by side.
    """
    there = together(channels)
    if there is not None:
        return there
    count = next(len(values) for values in channels if values is not None)
    shape = count, 1 if all(v is None or v.ndim == 1 for v in channels) else recording.runs
    rows = np.empty((count, len(channels), shape[1]))
    for column, values in enumerate(channels):
        if values is None:
            rows[:, column] = np.nan
        else:
            rows[:, column] = values[:, None] if values.ndim == 1 else values
    return rows.transpose(0, 2, 1)


def judged_blocks(
    recording: Recording,
    axes: Sequence[str],
    lag_samples: int,
    path: PathWindow | None,
    resolution: FloatArray | None = None,
    *,
    few: int = FEW,
) -> Iterator[Block]:
    """Yield every sample once, in order, with the chords within the lag before and after it.

    Memory holds two blocks of the recording, twice the lag, and the programmed path around them.
    Small blocks are joined.

    Parameters
    ----------
    recording
        Read once.
    axes
        The axes in the order of the columns.
    lag_samples
        The lag, in samples.
    path
        Window on the path, moved along with the blocks; None leaves the path out.
    resolution
        (axes,) resolution of the commanded positions: see ``Steady``. None: every change is motion.
    few
        A block with fewer samples waits for more; 1 during a live run.
    """
    held = None if resolution is None else Steady(resolution)
    waiting: list[_Held] = []  # samples that were not yielded yet, the oldest first
    past: _Places = {}  # chords of the samples before them, as far as the lag reaches
    last: FloatArray | None = None  # the command before the next samples
    first, few = 0, min(few, _OF_RUNS // recording.runs)
    for fresh in _samples(recording, axes):
        commanded = fresh.columns.get("commanded")
        if held is not None and commanded is not None:
            fresh.columns["steady"] = commanded = held.take(commanded)
        if path is not None and "operation" in fresh.whole:
            at_tool = None if commanded is None else commanded * path.radius_m
            fresh.whole |= _chords(fresh, path, at_tool, last, resolution)
            last = None if at_tool is None else at_tool[-1]
        if waiting and len(waiting[-1]) < few and waiting[-1].short_with(fresh):
            fresh = waiting.pop().joined(fresh)  # noqa: PLW2901
        waiting.append(fresh)
        ready = sum(map(len, waiting)) - lag_samples
        if ready < few:
            continue
        chords = _joined([past, *(one.whole for one in waiting)])
        at = len(past.get("low", ()))
        # A block cut in two would cost each measure its calls twice.
        while waiting and ready >= len(waiting[0]):
            part = waiting.pop(0)
            yield _block(part, chords, at, first, lag_samples, path)
            first, at, ready = first + len(part), at + len(part), ready - len(part)
        past = {k: v[max(at - lag_samples - 1, 0) : at] for k, v in chords.items()}
    chords = _joined([past, *(one.whole for one in waiting)])
    at = len(past.get("low", ()))
    for part in waiting:
        yield _block(part, chords, at, first, lag_samples, path)
        first, at = first + len(part), at + len(part)


def _joined(parts: Sequence[_Places]) -> _Places:
    """Return the chords of consecutive samples joined; empty if they are unknown."""
    known = [part for part in parts if "low" in part]
    return {
        name: np.concatenate([part[name] for part in known]) for name in (_CHORDS if known else ())
    }


def _block(
    part: _Held, chords: _Places, at: int, first: int, lag_samples: int, path: PathWindow | None
) -> Block:
    """Return a block of ``part``, whose first sample has row ``at`` of ``chords``."""
    chord_begin = chord_end = left = None
    if path is not None and chords:
        low, high = chords["low"], chords["high"]
        rows = np.arange(at, at + len(part))
        before = np.maximum(rows - lag_samples, 0)
        chord_begin = np.minimum(low[before], low[rows])
        left = np.where(low[before] == chord_begin, chords["share"][before], 0.0)
        chord_end = np.maximum(high[np.minimum(rows + lag_samples, len(high) - 1)], high[rows])
        # One sample earlier: the segment from the last sample to this one still counts there.
        path.drop(int(chords["safe"][max(at - 1 - lag_samples, 0)]))
    return Block(
        first=first,
        time_s=part.time_s,
        commanded=part.columns.get("commanded"),
        actual=part.columns.get("actual"),
        velocity=part.columns.get("velocity"),
        own=part.columns.get("own"),
        voltage=part.columns.get("voltage"),
        current=part.columns.get("current"),
        current_peak=part.columns.get("current_peak"),
        torque_share=part.columns.get("torque_share"),
        tension=_of_no_axis(part.columns.get("tension")),
        operation=part.whole.get("operation"),
        chord=part.whole.get("low"),
        begin=chord_begin,
        end=chord_end,
        path=path if chord_begin is not None else None,
        plan_s=part.plan_s,
        slow=part.slow,
        steady=part.columns.get("steady"),
        left=left,
    )


def _of_no_axis(values: FloatArray | None) -> FloatArray | None:
    """Return (n, runs) of the single column of a channel that belongs to no axis."""
    return None if values is None else values[:, :, 0]


def _chords(
    fresh: _Held,
    path: PathWindow,
    at_tool: FloatArray | None,
    before: FloatArray | None,
    resolution: FloatArray | None,
) -> _Places:
    """Return the chords that the samples are on, and the first chord of any later sample."""
    operation = fresh.whole["operation"]
    path.reach(int(operation[-1]))
    own = path.chords(operation)
    count_m = 0.0 if resolution is None else float(np.linalg.norm(resolution * path.radius_m))
    low, high = chords_under_way(path, own, at_tool, before, count_m)
    share = path.begins(operation, low - path.first)
    if at_tool is not None and np.isfinite(at_tool).all():
        share = shares_of(at_tool, low, path)
    return {"low": low, "high": high, "safe": own[0] - 1 + path.first, "share": share}
