"""Samples as measures read them: channels at common instants, and blocks of all channels."""

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
from threadline.machine.parts import Axis
from threadline.verdict.nearest import Candidates, Nearest, charge_trailing, nearest_chords
from threadline.verdict.window import PathWindow

MOST_WAITING = 1 << 16
"""Most samples that wait for a late channel; a channel that is later is refused."""
_ROUNDING = 1e-9  # of a sample: equal instants of two clocks may differ by a rounding


def sample_interval_s(channel: Channel) -> float:
    """Return the time between two samples of a channel."""
    period_s = channel.clock.period_s
    # The quotient of two integers is correctly rounded, and no fraction needs to be reduced.
    return period_s.numerator * channel.stride / period_s.denominator


def largest_acceleration(axis: Axis) -> float:
    """Return the largest acceleration that a machine file allows of an axis."""
    braking = axis.acceleration if axis.deceleration is None else axis.deceleration
    return max(axis.acceleration.si, braking.si)


def finite_samples(channel: Channel, block: RecordingBlock) -> FloatArray:
    """Return the samples of a channel in a block.

    Raises
    ------
    RecordingError
        If one of them is not finite. Parallel runs come from the simulation, which checks its own.
    """
    values = block.samples[channel.name]
    if values.ndim == 1 and not np.isfinite(values).all():
        lost = block.first_tick[channel.clock.name] + channel.stride * int(
            np.argmin(np.isfinite(values))
        )
        raise RecordingError(
            f"channel {channel.name!r} holds a value that is not finite, at "
            f"{channel.clock.time_s(lost):.6g} s",
            remedy="Repair the trace, or leave the channel out.",
        )
    return values


class Follower:
    """One channel at the instants of another: its own samples, or the last sample held.

    With ``largest``, a finer channel gives the sample of largest magnitude since the previous
    instant, so that no peak between two instants is lost.

    Parameters
    ----------
    channel, master
        The channel to read, and the channel that sets the instants.

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
        self._asked_s = -np.inf  # the latest requested instant

    def values(self, block: RecordingBlock, count: int) -> FloatArray:
        """Return the (count, ...) samples of a block, for a channel with the same instants."""
        values = finite_samples(self._channel, block)
        # Samples missing in this block are NaN; ``Coverage`` gives the reason.
        missing = max(count - len(values), 0)
        there = values[:count]
        return there if not missing else np.concatenate([there, np.full(missing, np.nan)])

    def take(self, block: RecordingBlock) -> None:
        """Keep the channel's samples in a block until they are requested.

        Raises
        ------
        RecordingError
            If they come after their instants have counted as missing.
        """
        values = finite_samples(self._channel, block)
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
        """Return at how many of some instants the value is final."""
        return int(np.searchsorted(time_s, self._due_s - self._slack_s))

    def at(self, time_s: FloatArray) -> FloatArray:
        """Return the channel's values at instants later than the instants of earlier calls."""
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
        # The first value that was kept belongs to the previous instant and counted there.
        begin = np.minimum(np.concatenate([[self._fresh], held[:-1] + 1]), held)
        self._fresh = 1
        # ``reduceat`` reduces from each index to the next: every other interval is wanted.
        pairs = np.column_stack([begin, held + 1]).ravel()
        sizes = np.append(np.abs(values[: keep + 1]), 0.0)
        return np.asarray(np.maximum.reduceat(sizes, pairs)[::2])


MOST_HELD = 2_000_000  # samples of all runs in the lag: some 600 MB
PARTS_OF_MEAN = 4096  # samples in the averaging time, at most twice as many
_LESS_THAN_A_COUNT = 1e-6  # of a count: tolerance for rounding when counts are compared
PLANNED_RESOLUTION = 1e-12
"""Resolution, m or rad, of commanded positions that come from the plan, in doubles."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """The facts about a recording and its plan that a measure needs before the first sample.

    Parameters
    ----------
    plan, recording
        The intended work, and the judged recording.
    axes, radius_m
        Axes of the programmed path: names, and (axes,) lengths at the tool per unit of the axis.
    interval_s
        Time between two samples.
    lag_samples
        Number of samples that the machine may trail its command.
    """

    plan: Plan
    recording: Recording
    axes: tuple[str, ...]
    radius_m: FloatArray
    interval_s: float
    lag_samples: int

    @property
    def coarse(self) -> bool:
        """Whether samples are further apart than ticks of the commands."""
        tick_s = float(self.plan.commands.clock.period_s)
        return self.interval_s > tick_s * (1.0 + _LESS_THAN_A_COUNT)

    @property
    def resolution(self) -> FloatArray:
        """(axes,) smallest change of a commanded position that counts as motion, m or rad.

        One count of the axis, because commands are whole counts; a rounding error if the loads
        follow the motion and the commanded positions come from the plan. See ``Steady``.
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
        """Number of parallel runs in the recording."""
        return self.recording.runs


@dataclass(frozen=True, kw_only=True, eq=False)
class Block:
    """Consecutive samples of parallel runs, n of them, with every channel at the same instants.

    Parallel runs have the same commands and differ in the response of the machine. In each array
    (n, runs, axes) the runs of one axis at one instant are adjacent in memory; ``lanes`` returns
    this layout for compiled loops.

    Parameters
    ----------
    first
        Number of the first sample since the start of the recording.
    time_s
        (n,) instants.
    commanded
        (n, axes) or None, for all runs; NaN for an axis without such a channel.
    actual, own
        (n, runs, axes) or None: position of the tool or load, and reading of the axis' encoder.
    voltage, current, current_peak
        (n, runs, axes) or None; the last two of largest magnitude since the previous sample.
    operation
        (n,) current operation, or None.
    chord
        (n,) chord that the command is on, counted from the start of the path, or None.
    begin, end
        (n,) first and last chord that the command is on within the lag around each sample.
    left
        (n,) share of the chord ``begin`` that the command had left behind one lag before; None if
        its place on the chord is unknown.
    path
        The programmed path around these operations, or None without an operation channel.
    torque_share
        (n, runs, axes) or None: torque asked of a drive over its limit, the largest since the
        previous sample.
    plan_s, slow
        (n,) the plan's time at each sample, and whether it advanced less than the clock since the
        previous sample; None until the first hold, while it equals the recording's time.
    velocity
        (n, runs, axes) or None: velocity of the load at each of these instants.
    tension
        (n, runs) or None: tension of a winder's fibre, N.
    steady
        (n, axes) ``commanded`` with rests found by ``Steady``; None: equal to ``commanded``.
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
    left: FloatArray | None = None
    velocity: FloatArray | None = None
    tension: FloatArray | None = None

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def rests(self) -> FloatArray | None:
        """(n, axes) ``steady``, else ``commanded``; None without a command."""
        return self.commanded if self.steady is None else self.steady

    @property
    def due_s(self) -> FloatArray:
        """(n,) the plan's time at each sample."""
        return self.time_s if self.plan_s is None else self.plan_s

    @property
    def runs(self) -> int:
        """Number of parallel runs."""
        of_runs = (self.actual, self.own, self.voltage, self.current)
        return next((values.shape[1] for values in of_runs if values is not None), 1)

    def window(self) -> tuple[PathWindow, IntArray, IntArray]:
        """Return the path, and ``begin`` and ``end`` counted within its window."""
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
        """(n, runs) squared distance of the tool to the nearest chord of its window, and which."""
        path, begin, end = self.window()
        return nearest_chords(self.at_tool, begin, end, path.vertices)

    @cached_property
    def shares(self) -> FloatArray | None:
        """(n, axes, runs) ratio of true lengths to ``at_tool``; None where it is 1."""
        assert self.actual is not None and self.path is not None
        local = self.path.local
        return None if local is None else local.shares(lanes(self.actual), axis=1)

    @cached_property
    def nearest_on_surface(self) -> tuple[FloatArray, IntArray]:
        """As ``nearest``, at the mandrel's radius; a tool that trails by more than the lag pays."""
        path, begin, end = self.window()
        points, shares = self.at_tool, self.shares
        squared, chord = self.nearest
        if shares is not None:
            squared, chord = nearest_chords(points, begin, end, path.vertices, shares)
        if self.left is None:
            return squared, chord
        found = Nearest(squared.copy(), chord, np.full(len(self), -1))
        window = Candidates(begin, end)
        charge_trailing(points, window, self.left, path.vertices, shares, found)
        return found.squared, chord

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
            velocity=None,
            own=those(self.own),
            voltage=those(self.voltage),
            current=those(self.current),
            current_peak=None,
            operation=those(self.operation),
            chord=those(self.chord),
            begin=those(self.begin),
            end=those(self.end),
            torque_share=None,
            tension=those(self.tension),
            plan_s=those(self.plan_s),
            slow=None if self.slow is None else _any_since(self.slow, rows),
            steady=those(self.steady),
            left=those(self.left),
        )

    def operations_at(self, index: IntArray) -> IntArray | None:
        """Return the current operations at some samples."""
        return None if self.operation is None else self.operation[index]

    def positions_at(self, index: IntArray) -> FloatArray | None:
        """Return the commanded positions at some samples; NaN if unknown."""
        return None if self.commanded is None else self.commanded[index]


class Steady:
    """Commanded positions that stand still while they change by less than their resolution.

    An axis keeps its position until the command is ``resolution`` away, then takes the command's
    position. Every criterion that needs the end of the command, a rest or the direction of a motion
    reads these positions: noise of the recorder below a count, or a rounding, is no motion.
    Commands in whole counts are unchanged, to the bit.

    Parameters
    ----------
    resolution
        (axes,) m or rad.
    """

    def __init__(self, resolution: FloatArray) -> None:
        self._resolution = resolution
        self._last: FloatArray = np.full(len(resolution), np.nan)

    def take(self, commanded: FloatArray) -> FloatArray:
        """Return the next (n, axes) positions with rests held; NaN if unknown."""
        steady = np.array(commanded)
        _hold_fast(steady, self._resolution, self._last)
        return steady


def _hold(positions: FloatArray, resolution: FloatArray, last: FloatArray) -> None:
    """Hold (n, axes) positions in place; ``last`` is the held position, and is updated."""
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
    """Return for the samples ``rows`` whether any sample since the previous row is ``slow``."""
    kept = np.arange(len(slow))[rows]
    counted = np.append(0, np.cumsum(slow))
    return np.diff(counted[kept + 1], prepend=0) > 0


def samples_of_lag(lag_s: float, interval_s: float, runs: int) -> int:
    """Return the lag in samples; the judge holds so many before and after a sample, in each run.

    Raises
    ------
    BudgetError
        If all runs together have more than ``MOST_HELD``.
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
    """Return the stride in samples that is fine enough for means over ``over_s``.

    At ticks of a nanosecond a mean over 2 ms would hold two million samples. From one used sample
    to the next, a mean changes by one part in ``PARTS_OF_MEAN`` of the difference between the
    speeds at its ends.
    """
    return max(int(over_s / interval_s / PARTS_OF_MEAN), 1)


def together(channels: Sequence[FloatArray | None]) -> FloatArray | None:
    """Return (n, runs, axes) from (n, runs) samples of every axis, if their memory allows it.

    The twin writes the output of many runs, for all axes, into one array, (n, axes, runs); each
    channel is a part of it. None if the channels do not fill such an array and must be copied.
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
    """Return the memory address of an array."""
    return int(values.__array_interface__["data"][0])


def lanes(values: FloatArray) -> FloatArray:
    """Return (n, runs, axes) values as contiguous (n, axes, runs); without a copy if possible."""
    return np.ascontiguousarray(values.transpose(0, 2, 1))
