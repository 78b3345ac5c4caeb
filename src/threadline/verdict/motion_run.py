"""A run of axes along a path, read block by block; two readers can share one recording."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar, Generic, TypeVar

import numpy as np

from threadline.commands.plan import Plan
from threadline.files import Channel, ChannelKind, Recording, RecordingBlock
from threadline.verdict.blocks import find_first, judged_blocks, master_channel, peak_channels
from threadline.verdict.bow import FOLLOWED, bows
from threadline.verdict.by_time import WatchedOperations, with_operation
from threadline.verdict.coverage import Coverage, Lack
from threadline.verdict.finding import Finding, Hidden, RunFindings
from threadline.verdict.measure import MeasureKind, Needs, Running, RunReading
from threadline.verdict.needle import planned_stitches
from threadline.verdict.samples import (
    Block,
    Setting,
    largest_acceleration,
    sample_interval_s,
    samples_of_lag,
)
from threadline.verdict.tracking import as_intended
from threadline.verdict.window import PathWindow

T = TypeVar("T")


class Fork(Generic[T]):
    """A stream shared by two readers; an item is kept until both have taken it.

    >>> fork = Fork(iter("abc"))
    >>> one, other = iter(fork.first), iter(fork.second)
    >>> next(one), next(one), next(other)
    ('a', 'b', 'a')
    >>> fork.second.leave()
    >>> list(one), list(other)
    (['c'], [])

    Parameters
    ----------
    items
        Read once, when the first reader asks.
    """

    def __init__(self, items: Iterable[T]) -> None:
        self._items = items
        self._source: Iterator[T] | None = None
        self.first: Branch[T] = Branch(self)
        self.second: Branch[T] = Branch(self)

    def pull(self) -> bool:
        """Read the next item for both readers; return whether there was one."""
        if self._source is None:
            self._source = iter(self._items)
        for item in self._source:
            self.first.put(item)
            self.second.put(item)
            return True
        return False


class Branch(Generic[T]):
    """One reader's side of a fork."""

    def __init__(self, fork: Fork[T]) -> None:
        self._fork = fork
        self._waiting: deque[T] = deque()
        self._left = False

    def __iter__(self) -> Iterator[T]:
        while not self._left and (self._waiting or self._fork.pull()):
            yield self._waiting.popleft()

    def put(self, item: T) -> None:
        """Keep an item for this reader, unless it has left."""
        if not self._left:
            self._waiting.append(item)

    def leave(self) -> None:
        """Stop reading: nothing is kept for this reader from now on."""
        self._left = True
        self._waiting.clear()


_ROUNDING = 1e-9
NO_DYNAMICS = "the machine file has no dynamics: the masses that its drives move are unknown"
_NO_TENSION = (
    'no tension channel: a column "tension" gives it, see docs/files.md; a simulated machine has '
    "one with the [spool] of its machine file and a --product"
)
_ARRIVED_M = 1e-4  # at the tool: a few counts, the accuracy of a quantised command


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionRun(Setting):
    """One run of axes with a path, read block by block in bounded memory.

    Parameters
    ----------
    lag_s
        Free following error in time: how far the machine may trail its command.
    by_time
        Whether operations come from the commands at the same instant, because none were recorded.
    coverage
        Instants of each channel that the recording covers, once it has been read.
    operations
        For a live recording with a column of operations: whether the column is usable.
    by_plan
        The same run with the operations of the commands, in case the column is empty.
    branch
        Its side of the stream, if two runs share one recording.
    """

    of: ClassVar[str] = "a machine with axes"
    absent: ClassVar[str] = "the recording has no such channel"

    lag_s: float
    by_time: bool
    coverage: Coverage
    operations: WatchedOperations | None = None
    by_plan: MotionRun | None = None
    branch: Branch[RecordingBlock] | None = None

    @property
    def fallback(self) -> MotionRun | None:
        """The run with the commands' operations, until a recorded operation appears."""
        return None if self.operations is None or self.operations.usable else self.by_plan

    def release(self) -> None:
        """Do nothing: a run holds no more samples than one block."""

    def leave(self) -> None:
        """Read no more of the recording."""
        if self.branch is not None:
            self.branch.leave()

    def lacks(self, reading: RunReading, per_axis: bool) -> str:
        """Return why the recording lacks data for a measure; empty if it does not."""
        for alternatives in reading.needs:
            lacking = self._lacking(alternatives)
            # A measure of single axes takes the axes that exist; the tool needs every axis.
            every = not per_axis or reading.of_every_axis in alternatives
            if lacking and (every or len(lacking) == len(self.axes)):
                return self._why(alternatives, lacking)
        return self._too_coarse(reading.needs) if reading.follows else ""

    def _absent(self, reading: RunReading) -> dict[str, str]:
        """Return the axes that a measure of single axes cannot measure, each with the reason."""
        return {
            axis: self._why(alternatives, [axis])
            for alternatives in reading.needs
            for axis in self._lacking(alternatives)
        }

    def _why(self, alternatives: Sequence[ChannelKind], axes: Sequence[str]) -> str:
        """Return why none of these channels of some axes exists, and how to provide one."""
        if self.recording.simulated and self.plan.machine.without_dynamics:
            return NO_DYNAMICS
        if ChannelKind.TENSION in alternatives:
            return _NO_TENSION
        return f"no {' or '.join(alternatives)} channel of {', '.join(axes)}: " + _how_to_give(
            alternatives, axes[0]
        )

    def _lacking(self, alternatives: Sequence[ChannelKind]) -> list[str]:
        """Return the axes for which the recording has none of these channels."""
        operation = self.recording.find(ChannelKind.OPERATION)
        if ChannelKind.OPERATION in alternatives and operation is not None:
            return []  # one channel for all axes
        if ChannelKind.TENSION in alternatives and self.recording.find(ChannelKind.TENSION):
            return []
        return [a for a in self.axes if find_first(self.recording, alternatives, a) is None]

    def _too_coarse(self, needs: Needs) -> str:
        """Return which channel is sampled more coarsely than the lag; empty if none is.

        An error could come and go between two samples, and the free lag would be a whole sample.
        Samples at each tick of the commands are always fine enough, even for a shorter lag.
        """
        channels = [
            channel
            for alternatives in needs
            for axis in ("", *self.axes)
            if (channel := find_first(self.recording, alternatives, axis)) is not None
        ]
        coarsest = max(channels, key=sample_interval_s)
        interval_s = sample_interval_s(coarsest)
        finest_s = max(self.lag_s, float(self.plan.commands.clock.period_s))
        if interval_s <= finest_s * (1.0 + _ROUNDING):
            return ""
        return (
            f"{coarsest.name} has a sample every {1e3 * interval_s:.4g} ms, the lag of the "
            f"specification is {1e3 * self.lag_s:.4g} ms: what happens in between is not seen; "
            f"record every {1e3 * finest_s:.4g} ms at least"
        )

    def blocks(self) -> Iterator[Block]:
        """Yield the blocks for the measures; reads the recording, in bounded memory."""
        path = PathWindow(self.plan.motion.programmed)
        return judged_blocks(self.recording, self.axes, self.lag_samples, path, self.resolution)

    def results(self, running: Sequence[Running], last: Block | None) -> list[list[RunFindings]]:
        """Return the findings of each measure, as far as seen, after the last block."""
        if not running:
            return []
        begin_s, end_s = self.plan.motion.trajectory.moves_s
        if last is not None:
            # Later by the time of its holds; earlier if it has reached the end already.
            late_s = float(last.time_s[-1] - last.due_s[-1])
            end_s = float(last.time_s[-1]) if self._arrived(last) else end_s + late_s
        return [self._result(one, begin_s, end_s) for one in running]

    def _result(self, one: Running, begin_s: float, end_s: float) -> list[RunFindings]:
        absent = self._absent(one.reading) if one.kind.per_axis else {}
        found = [
            RunFindings.alike(Finding(value=None, axis=axis, note=why), self.runs)
            for axis, why in absent.items()
        ]
        for one_found in one.measure.finish():
            # A result for an axis that was never seen is not a measurement.
            if one_found.axis not in absent:
                channels = self._channels(one.reading, one_found.axis)
                lack = self.coverage.lack(channels, begin_s, end_s)
                hidden = self._hidden(one, one_found.axis)
                if hidden is not None:
                    one_found = one_found.each(partial(_with_hidden, hidden))  # noqa: PLW2901
                found.append(
                    one_found
                    if lack is None
                    else one_found.each(partial(_as_seen, kind=one.kind, lack=lack))
                )
        return found

    def _hidden(self, one: Running, axis: str) -> Hidden | None:
        """Return the error that the samples may hide from a measure; None if they hide none.

        Samples at each tick hide an error only from measures that follow the loads between samples,
        and only in a foreign recording without velocities. Between samples T apart a position
        deviates from the straight segment by at most a T^2 / 8 at an acceleration of a. A speed is
        a mean: samples must not be further apart than its averaging time.
        """
        places = [n for n in one.reading.needs if not _PLACES.isdisjoint(n)]
        channels = [
            channel
            for alternatives in places
            for of in ((axis,) if axis else self.axes)
            if (channel := find_first(self.recording, alternatives, of)) is not None
        ]
        if not channels:
            return None
        coarsest = max(channels, key=sample_interval_s)
        interval_s = sample_interval_s(coarsest)
        tick_s = float(self.plan.commands.clock.period_s)
        at_ticks = interval_s <= tick_s * (1.0 + _ROUNDING)
        if at_ticks and (one.kind.name not in FOLLOWED or self._known_between):
            return None
        unit = one.kind.dimension
        over_s = _VELOCITY_S if unit == "axis/s" else one.options.get("over", 0.0)
        if over_s:
            over_s = max(over_s, tick_s)
            if interval_s <= over_s * (1.0 + _ROUNDING):
                return None
            why = f"that says nothing of speeds over {1e3 * over_s:.4g} ms"
            return Hidden(coarsest.name, interval_s, np.inf, why, enough_s=over_s)
        of_axes = [self.axes.index(axis)] if axis else range(len(self.axes))
        most = np.array(
            [largest_acceleration(self.plan.machine.axes[self.axes[k]]) for k in of_axes]
        )
        at_tool = float(np.linalg.norm(most * self.radius_m[list(of_axes)]))
        away = interval_s**2 / 8.0
        hidden_m = at_tool * away
        why = (
            f"between two of them the tool may be {1e3 * hidden_m:.4g} mm beside, at the "
            f"{at_tool:.4g} m/s^2 of the machine file"
        )
        if unit == "tool":
            instead = f", or {', '.join(f'{axis}.velocity' for axis in self.axes)} at each tick"
            return Hidden(
                coarsest.name, interval_s, hidden_m, why, instead=instead if at_ticks else ""
            )
        if unit == "axis":
            return Hidden(coarsest.name, interval_s, float(most[0]) * away, why)
        if unit == "time" and "band" in one.options:
            enough_s = float(np.sqrt(8.0 * one.options["band"] / at_tool))
            if interval_s > enough_s:
                return Hidden(
                    coarsest.name, interval_s, np.inf, why, enough_s=max(enough_s, tick_s)
                )
        if one.kind.name == "stitch_length_error":
            first = next(iter(planned_stitches(self.plan)), None)
            least_m = np.inf if first is None else float(first.target_m.min())
            return Hidden(coarsest.name, interval_s, 2.0 * hidden_m / least_m, why)
        return None

    @property
    def _known_between(self) -> bool:
        """Whether the path between samples at each tick is known, or the recording is simulated."""
        return self.recording.simulated or bows(self)

    def unseen(self, reading: RunReading) -> str:
        """Return which channels a measure of many runs lacks, or where; empty if none.

        Call it once the recording has been read to its end.
        """
        lack = self.coverage.lack(self._channels(reading), *self.plan.motion.trajectory.moves_s)
        return "" if lack is None else lack.why

    def _channels(self, reading: RunReading, axis: str = "") -> list[Channel]:
        """Return the channels that a measure reads, for ``axis`` or, by default, for all axes.

        They always include the channel that sets the instants of the others.
        """
        found = [master_channel(self.recording, self.axes)]
        for alternatives in reading.needs:
            every = not axis or reading.of_every_axis in alternatives
            of = ("", *self.axes) if every else ("", axis)
            found += [
                c for a in of if (c := find_first(self.recording, alternatives, a)) is not None
            ]
        if any(ChannelKind.CURRENT in alternatives for alternatives in reading.needs):
            found += peak_channels(self.recording, (axis,) if axis else self.axes)
        return found

    def _arrived(self, block: Block) -> bool:
        """Return whether the command rests at the path's end, in the last moving operation."""
        path, commanded, operation = block.path, block.commanded, block.operation
        if path is None or commanded is None or operation is None or not path.exhausted:
            return False
        left = np.linalg.norm(path.vertices[-1] - commanded[-1] * self.radius_m)
        return bool(operation[-1] >= path.operation[-1] and left <= _ARRIVED_M)


_VELOCITY_S = 0.02  # averaging time of the velocity of a recording
_PLACES = {ChannelKind.TOOL, ChannelKind.LOAD, ChannelKind.MEASURED}


def _with_hidden(hidden: Hidden, finding: Finding) -> Finding:
    """Return a finding with the error that its samples may hide, which also bounds ``over``."""
    return replace(finding, hidden=hidden, over=min(finding.over, hidden.most))


def _as_seen(finding: Finding, kind: MeasureKind, lack: Lack) -> Finding:
    """Return what a finding proves although samples are missing.

    A maximum over samples from before an early end still fails a limit that it exceeds; any other
    finding counts as not measured.
    """
    seen = finding.seen or finding
    if seen.value is None:  # its note says where it ended
        return replace(seen, note="; ".join(filter(None, (seen.note, lack.why))))
    if lack.early and kind.of_worst:
        return replace(seen, seen=None, unseen=lack.why)
    return Finding(value=None, axis=finding.axis, note=lack.why)


def motion_run(recording: Recording, plan: Plan, lag_s: float) -> MotionRun:
    """Return ``recording`` with ``plan``, with operations and the intended commanded positions.

    Recorded operations have priority over the plan's at the same instant. A recording without them,
    or with -1 throughout, gets the operations of the commands. For a live recording this is known
    only after it has been read, and it can be read only once: ``by_plan`` of the returned run then
    reads the same blocks with the operations of the commands.

    Raises
    ------
    RecordingError
        If the recording holds no position of any axis of the plan, or (while it is read) an
        operation that the job does not have.
    """
    coverage = Coverage(recording)
    watched = coverage.watched
    channel = recording.find(ChannelKind.OPERATION)
    if channel is None:
        timed = with_operation(watched, plan, plan.axes)
        return _opened(timed, plan, lag_s, coverage, by_time=True)
    if recording.simulated:  # the twin always records operations
        return _opened(watched, plan, lag_s, coverage, by_time=False)
    fork = Fork(watched)
    operations = WatchedOperations(fork.first, channel, plan.job)
    others = tuple(c for c in recording.channels if c is not channel)
    fallback = replace(watched, channels=others, blocks=fork.second)
    timed = with_operation(fallback, plan, plan.axes)
    by_plan = _opened(timed, plan, lag_s, coverage, by_time=True)
    run = _opened(replace(watched, blocks=operations), plan, lag_s, coverage, by_time=False)
    return replace(run, operations=operations, by_plan=replace(by_plan, branch=fork.second))


def _opened(
    recording: Recording, plan: Plan, lag_s: float, coverage: Coverage, *, by_time: bool
) -> MotionRun:
    axes = plan.axes
    judged = as_intended(recording, plan)
    interval_s = sample_interval_s(master_channel(judged, axes))
    return MotionRun(
        plan=plan,
        recording=judged,
        axes=axes,
        radius_m=plan.motion.programmed.radius_m,
        interval_s=interval_s,
        lag_samples=samples_of_lag(lag_s, interval_s, judged.runs),
        lag_s=lag_s,
        by_time=by_time,
        coverage=coverage,
    )


def _how_to_give(alternatives: Sequence[ChannelKind], axis: str) -> str:
    if ChannelKind.LOAD in alternatives:
        return f'name the column "{axis}.load" if it was measured at the load, see docs/files.md'
    return f'a column "{axis}.{alternatives[0]}" gives it, see docs/files.md'
