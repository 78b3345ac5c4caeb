"""One channel at the instants of another that has another clock or another stride."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.commands.plan import Plan
from threadline.errors import BudgetError, RecordingError
from threadline.files import Channel, Recording, RecordingBlock
from threadline.verdict.nearest import nearest_chords
from threadline.verdict.window import PathWindow

MOST_WAITING = 1 << 16
"""Samples that wait for a channel that is behind; what comes later than that is refused."""
_ROUNDING = 1e-9  # of a sample: instants of two clocks that should be one may differ by a rounding


def sample_interval_s(channel: Channel) -> float:
    """Return the time between two samples of a channel."""
    period_s = channel.clock.period_s
    # The quotient of two whole numbers is correctly rounded, and no fraction is shortened.
    return period_s.numerator * channel.stride / period_s.denominator


class Follower:
    """One channel at the instants of another: its own samples, or the last one until the next.

    Of a finer channel that is ``largest`` it is the sample of largest magnitude since the instant
    before: between two instants nothing of it is lost.

    Parameters
    ----------
    channel, master
        The channel whose samples are read, and the channel at whose instants.

    Attributes
    ----------
    same
        Whether both have the same instants, so that samples are taken block by block.
    """

    def __init__(self, channel: Channel, master: Channel, *, largest: bool = False) -> None:
        self._channel, self._master = channel, master
        self.same = channel.clock == master.clock and channel.stride == master.stride
        self._slack_s = _ROUNDING * sample_interval_s(master)
        self._largest, self._fresh = largest, 0
        self._time_s: FloatArray = np.empty(0)  # of samples that may still be needed
        self._values: FloatArray = np.empty(0)
        self._due_s = -np.inf  # when the next sample is due
        self._asked_s = -np.inf  # the last instant at which it was asked for

    def values(self, block: RecordingBlock, count: int) -> FloatArray:
        """Return (count, ...) samples of a block, where it has the same instants."""
        values = self._checked(block)
        # What is missing of it in this block is no number; whoever needs it is told so.
        lacking = max(count - len(values), 0)
        known = values[:count]
        return known if not lacking else np.concatenate([known, np.full(lacking, np.nan)])

    def _checked(self, block: RecordingBlock) -> FloatArray:
        values = block.samples[self._channel.name]
        if values.ndim == 1 and not np.isfinite(values).all():
            first = block.first_tick[self._channel.clock.name]
            raise RecordingError(
                f"channel {self._channel.name!r} holds a value that is not finite near "
                f"{self._channel.clock.time_s(first):.6g} s",
                remedy="Repair the trace, or leave the channel out.",
            )
        return values

    def take(self, block: RecordingBlock) -> None:
        """Keep the channel's samples in a block until they are asked for.

        Raises
        ------
        RecordingError
            If they come after their instants were taken for missing.
        """
        values = self._checked(block)
        if not len(values):
            return
        channel = self._channel
        first = block.first_tick[channel.clock.name]
        times = channel.clock.times_s(first, len(values), channel.stride)
        if times[0] <= self._asked_s + self._slack_s:
            raise RecordingError(
                f"channel {channel.name!r} comes with {times[0]:.6g} s when "
                f"{self._master.name!r} is at {self._asked_s:.6g} s, more than {MOST_WAITING} "
                "samples later",
                remedy="Record the channels of one instant in blocks that follow each other.",
            )
        self._time_s = np.concatenate([self._time_s, times])
        self._values = np.concatenate([self._values, values])
        self._due_s = float(times[-1]) + sample_interval_s(channel)

    def known(self, time_s: FloatArray) -> int:
        """Return at how many of some instants no sample can change its value any more."""
        return int(np.searchsorted(time_s, self._due_s - self._slack_s))

    def at(self, time_s: FloatArray) -> FloatArray:
        """Return the channel's values at instants later than those asked for before."""
        if not len(time_s):
            return np.empty(0)
        self._asked_s = float(time_s[-1])
        times, values = self._time_s, self._values
        if not len(times):
            return np.full(len(time_s), np.nan)
        held = np.maximum(np.searchsorted(times, time_s + self._slack_s, side="right") - 1, 0)
        keep = int(held[-1])
        self._time_s, self._values = times[keep:], values[keep:]
        if not self._largest:
            return np.asarray(values[held])
        # The first value that was kept belongs to the instant before: it counted there already.
        begin = np.minimum(np.concatenate([[self._fresh], held[:-1] + 1]), held)
        self._fresh = 1
        # ``reduceat`` takes stretches from each place to the next: every other one is wanted.
        pairs = np.column_stack([begin, held + 1]).ravel()
        sizes = np.append(np.abs(values[: keep + 1]), 0.0)
        return np.asarray(np.maximum.reduceat(sizes, pairs)[::2])


MOST_HELD = 2_000_000  # samples of all runs in the lag: some 600 MB
PARTS_OF_MEAN = 4096  # samples in the time over which a mean is taken, at most twice as many
_LESS_THAN_A_COUNT = 1e-6  # of a count: two counts are one count apart but for a rounding
PLANNED_RESOLUTION = 1e-12
"""Resolution, m or rad, of commanded positions that are those of the plan, in doubles."""


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

    @property
    def resolution(self) -> FloatArray:
        """(axes,) change of a commanded position that is a motion, m or rad: see ``Steady``.

        One count of the axis, as commands are whole counts; where the loads follow the motion and
        the commanded positions are those of the plan, a rounding of theirs.
        """
        intended = self.plan.motion.of_loads
        planned = () if intended is None else intended.axes
        counts = [self.plan.machine.axes[axis].counts.si for axis in self.axes]
        return np.array(
            [
                PLANNED_RESOLUTION if axis in planned else (1.0 - _LESS_THAN_A_COUNT) / count
                for axis, count in zip(self.axes, counts, strict=True)
            ]
        )

    def lengths(self, away: FloatArray, at: FloatArray) -> FloatArray:
        """Return small differences ``away``, axes last, as lengths at the tool at ``at``."""
        local = self.plan.motion.programmed.local
        shares = 1.0 if local is None else local.shares(at)
        return np.asarray(away * self.radius_m * shares)

    @property
    def runs(self) -> int:
        """How many runs the recording holds side by side."""
        return self.recording.runs


@dataclass(frozen=True, kw_only=True, eq=False)
class Block:
    """Consecutive samples of runs in step, n of them, with every channel on the same instants.

    Several runs are of the same commands: they differ in what the machine made of them. Of each
    array (n, runs, axes) the runs of one axis at one instant lie side by side in memory, which is
    what ``lanes`` hands to loops.

    Parameters
    ----------
    first
        Number of the first sample since the start of the recording.
    time_s
        (n,) instants.
    commanded
        (n, axes) or None, of all runs; NaN where an axis has no such channel.
    actual, own
        (n, runs, axes) or None: where the tool or load was, and what the axis' encoder read.
    voltage, current, current_peak
        (n, runs, axes) or None; the last two of largest magnitude since the sample before.
    operation
        (n,) operation under way, or None.
    chord
        (n,) chord that the command is on, counted from the start of the path, or None.
    begin, end
        (n,) first and last chord that it was or will be on within the lag of each sample.
    path
        The programmed path about these operations, or None without an operation channel.
    torque_share
        (n, runs, axes) or None: the torque asked of a drive over what it has, its largest since the
        sample before.
    plan_s, slow
        (n,) the plan's time at each sample, and whether less of it went by than time did since the
        sample before; None while it is that of the recording, which was not held yet.
    steady
        (n, axes) ``commanded`` as what looks for a rest reads it: see ``Steady``. None as it is.
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
    torque_share: FloatArray | None = None
    plan_s: FloatArray | None = None
    slow: NDArray[np.bool_] | None = None
    steady: FloatArray | None = None

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def rests(self) -> FloatArray | None:
        """(n, axes) ``steady``, or ``commanded`` where nobody gave it; None without a command."""
        return self.commanded if self.steady is None else self.steady

    @property
    def due_s(self) -> FloatArray:
        """(n,) the plan's time at each sample: what was due then by the plan is that of it."""
        return self.time_s if self.plan_s is None else self.plan_s

    @property
    def runs(self) -> int:
        """How many runs stand side by side."""
        of_runs = (self.actual, self.own, self.voltage, self.current)
        return next((values.shape[1] for values in of_runs if values is not None), 1)

    def window(self) -> tuple[PathWindow, IntArray, IntArray]:
        """Return the path, and ``begin`` and ``end`` counted within what it holds."""
        assert self.path is not None and self.begin is not None and self.end is not None
        begin = np.maximum(self.begin - self.path.first, 1)
        return self.path, begin, np.maximum(self.end - self.path.first, begin)

    @cached_property
    def at_tool(self) -> FloatArray:
        """(n, axes, runs) actual positions as lengths at the tool."""
        assert self.actual is not None and self.path is not None
        return lanes(self.actual) * self.path.radius_m[:, None]

    @cached_property
    def last_at_tool(self) -> FloatArray:
        """(axes, runs) the last of ``at_tool``."""
        assert self.actual is not None and self.path is not None
        return np.asarray(self.actual[-1].T * self.path.radius_m[:, None])

    @cached_property
    def nearest(self) -> tuple[FloatArray, IntArray]:
        """(n, runs) squared distances of the tool to the nearest chord of its window, and which."""
        path, begin, end = self.window()
        return nearest_chords(self.at_tool, begin, end, path.vertices)

    @cached_property
    def shares(self) -> FloatArray | None:
        """(n, axes, runs) what a length is of that of ``at_tool`` there; None where it is 1."""
        assert self.actual is not None and self.path is not None
        local = self.path.local
        return None if local is None else local.shares(lanes(self.actual), axis=1)

    @cached_property
    def nearest_on_surface(self) -> tuple[FloatArray, IntArray]:
        """As ``nearest``, with lengths at the radius that a mandrel has at each sample."""
        if self.shares is None:
            return self.nearest
        path, begin, end = self.window()
        return nearest_chords(self.at_tool, begin, end, path.vertices, self.shares)

    def every(self, count: int) -> Block:
        """Return each ``count``-th sample of the recording, without the peaks between them."""
        if count == 1:
            return self
        rows = slice(-self.first % count, None, count)

        def those(values: Any) -> Any:
            return None if values is None else values[rows]

        return replace(
            self,
            first=-(-self.first // count),
            time_s=self.time_s[rows],
            commanded=those(self.commanded),
            actual=those(self.actual),
            own=those(self.own),
            voltage=those(self.voltage),
            current=those(self.current),
            current_peak=None,
            operation=those(self.operation),
            chord=those(self.chord),
            begin=those(self.begin),
            end=those(self.end),
            torque_share=None,
            plan_s=those(self.plan_s),
            slow=None if self.slow is None else _any_since(self.slow, rows),
            steady=those(self.steady),
        )

    def operations_at(self, index: IntArray) -> IntArray | None:
        """Return the operations under way at some samples."""
        return None if self.operation is None else self.operation[index]

    def positions_at(self, index: IntArray) -> FloatArray | None:
        """Return the commanded positions at some samples; NaN where one is not known."""
        return None if self.commanded is None else self.commanded[index]


class Steady:
    """Commanded positions that stand still where they change by less than their resolution.

    An axis stands at a place until it is as far from it as ``resolution``, and then at the place
    where it is. Every criterion that looks for the end of the command, for a rest or for the
    direction of a motion reads these positions: the noise of a recorder below a count, or a
    rounding, is no motion. Commands in whole counts are left as they are, to the bit.

    Parameters
    ----------
    resolution
        (axes,) m or rad.
    """

    def __init__(self, resolution: FloatArray) -> None:
        self._resolution = resolution
        self._last: FloatArray = np.full(len(resolution), np.nan)

    def take(self, commanded: FloatArray) -> FloatArray:
        """Return the next (n, axes) positions so; NaN where none is known."""
        steady = np.array(commanded)
        _hold_fast(steady, self._resolution, self._last)
        return steady


def _hold(positions: FloatArray, resolution: FloatArray, last: FloatArray) -> None:
    """Hold (n, axes) positions in place; ``last`` is where each axis stands, and brought up."""
    for axis in range(positions.shape[1]):
        stands = last[axis]
        for i in range(len(positions)):
            if abs(positions[i, axis] - stands) < resolution[axis]:
                positions[i, axis] = stands
            else:  # NaN too
                stands = positions[i, axis]
        last[axis] = stands


_hold_fast = njit(nogil=True)(_hold)


def _any_since(slow: NDArray[np.bool_], rows: slice) -> NDArray[np.bool_]:
    """Return of the samples ``rows`` whether any since the one before is ``slow``."""
    kept = np.arange(len(slow))[rows]
    counted = np.append(0, np.cumsum(slow))
    return np.diff(counted[kept + 1], prepend=0) > 0


def samples_of_lag(lag_s: float, interval_s: float, runs: int) -> int:
    """Return how many samples the lag has; so many of each run are held before and after a sample.

    Raises
    ------
    BudgetError
        If those of all runs are more than ``MOST_HELD``.
    """
    count = int(np.floor(lag_s / interval_s + _ROUNDING))
    if count * runs > MOST_HELD:
        of_runs = f" of {runs} runs" if runs > 1 else ""
        raise BudgetError(
            f"the lag of {1e3 * lag_s:.4g} ms has {count} samples{of_runs}, one every "
            f"{1e9 * interval_s:.4g} ns, and the judge holds {MOST_HELD} at most",
            remedy="Give the machine a longer clock, the specification a shorter lag, or record "
            "fewer samples.",
        )
    return count


def enough_of(over_s: float, interval_s: float) -> int:
    """Return of how many samples one is enough for means over ``over_s``.

    At ticks of a nanosecond a mean over 2 ms would hold two million samples. From one sample that
    is looked at to the next a mean changes by a part in ``PARTS_OF_MEAN`` of the difference
    between the speeds at its ends.
    """
    return max(int(over_s / interval_s / PARTS_OF_MEAN), 1)


def together(channels: Sequence[FloatArray | None]) -> FloatArray | None:
    """Return (n, runs, axes) of (n, runs) samples of every axis where they lie so in memory.

    The twin puts what many runs give of all axes into one array, (n, axes, runs), of which each
    channel is a part. None where they do not fill such an array: then they have to be copied.
    """
    first = channels[0]
    if first is None or first.ndim == 1 or first.base is None:
        return None
    samples, runs = first.shape
    size, begin = first.itemsize, _address(first)
    for number, values in enumerate(channels):
        if values is None or values.base is not first.base or values.shape != first.shape:
            return None
        if values.strides != (len(channels) * runs * size, size):
            return None
        if _address(values) - begin != number * runs * size:
            return None
    whole: Any = first.base
    shape, strides = (samples, len(channels), runs), (first.strides[0], runs * size, size)
    alike = isinstance(whole, np.ndarray) and (whole.shape, whole.strides) == (shape, strides)
    if alike and _address(whole) == begin:
        return np.asarray(whole.transpose(0, 2, 1))
    return as_strided(first, shape, strides).transpose(0, 2, 1)


def _address(values: FloatArray) -> int:
    """Return where an array begins in memory."""
    return int(values.__array_interface__["data"][0])


def lanes(values: FloatArray) -> FloatArray:
    """Return (n, axes, runs) of (n, runs, axes) values, contiguous; no copy where they are so."""
    return np.ascontiguousarray(values.transpose(0, 2, 1))
