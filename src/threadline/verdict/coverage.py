"""Instants of each channel that a recording covers, and how its run ended."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from threadline.errors import RecordingError
from threadline.files import Channel, ChannelKind, Event, Outcome, Recording, RecordingBlock, Stream
from threadline.files.recording import end_with_reason
from threadline.machine import Machine
from threadline.verdict.types import Change, Disturbance, Result, Status

_ROUNDING = 1e-9  # of a sample
_MOST = 1e15  # SI: no measurement is larger


@dataclass(slots=True)
class _Seen:
    """Ticks of a channel: the first sample, the end, and the first gap."""

    first: int
    end: int
    gap: tuple[int, int] | None = None


@dataclass(frozen=True, slots=True)
class Lack:
    """The missing samples of a channel.

    ``why`` names them in words. ``early``: only the end is missing, without a gap before it.
    """

    why: str
    early: bool


class Coverage:
    """Watches the blocks of a recording as they are read, without keeping them.

    Parameters
    ----------
    recording
        The recording; judge ``watched`` in its place.
    """

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self._seen: dict[str, _Seen] = {}
        self._lacks: dict[tuple[tuple[str, ...], float, float], Lack | None] = {}
        self.watched: Recording = replace(recording, blocks=Stream(self._blocks))

    def _blocks(self) -> Iterator[RecordingBlock]:
        self._seen, self._lacks = {}, {}
        for block in self._recording:
            for channel in self._recording.channels:
                count = len(block.samples[channel.name])
                if count:
                    self._take(channel, block.first_tick[channel.clock.name], count)
            yield block

    def _take(self, channel: Channel, first: int, count: int) -> None:
        seen = self._seen.get(channel.name)
        end = first + channel.stride * count
        if seen is None:
            if first < 0:
                raise RecordingError(
                    f"channel {channel.name!r} begins at {_s(channel, first)}, before the commands",
                    remedy="Time 0 is the first tick of the job; leave out what comes before it.",
                )
            self._seen[channel.name] = _Seen(first, end)
            return
        if first < seen.end:
            last = _s(channel, seen.end - channel.stride)
            raise RecordingError(
                f"a block of channel {channel.name!r} begins at {_s(channel, first)}, and the "
                f"blocks before it go on until {last}",
                remedy="Blocks follow each other in time and do not overlap; record it again.",
            )
        if first > seen.end and seen.gap is None:
            seen.gap = (seen.end, first)
        seen.end = end

    def lack(self, channels: Iterable[Channel], begin_s: float, end_s: float) -> Lack | None:
        """Return the missing samples of the channels between two instants; None if there are none.

        A gap anywhere counts. So does one missing sample at the start or end, also in comparison
        with a longer channel. If several channels lack samples, the result is the lack after which
        the least of the run can be judged. Call it after the recording has been read to its end.
        """
        channels = list(channels)
        span = tuple(channel.name for channel in channels), begin_s, end_s
        if span not in self._lacks:  # many measures read the same channels
            self._lacks[span] = self._lack(channels, begin_s, end_s)
        return self._lacks[span]

    def _lack(self, channels: Sequence[Channel], begin_s: float, end_s: float) -> Lack | None:
        found: list[Lack] = []
        last_s, longest = max(
            (
                (float(c.clock.time_s(seen.end - c.stride)), c.name)
                for c in channels
                if (seen := self._seen.get(c.name)) is not None
            ),
            default=(0.0, ""),
        )
        for channel in channels:
            seen = self._seen.get(channel.name)
            if seen is None:
                if any(channel is c for c in self._recording.channels):
                    found.append(Lack(f"{channel.name} has no samples", early=False))
                continue  # computed for every instant, not recorded
            period_s = float(channel.clock.period_s)
            slack_s = (1.0 + _ROUNDING) * period_s * channel.stride
            if seen.gap is not None:
                low, high = (_s(channel, tick) for tick in seen.gap)
                why = f"{channel.name} has no samples from {low} to {high}"
                found.append(Lack(why, early=False))
            elif seen.first * period_s > begin_s + slack_s:
                why = f"{channel.name} begins at {_s(channel, seen.first)}, the motion before"
                found.append(Lack(why, early=False))
            elif seen.end * period_s + _ROUNDING * slack_s < end_s:
                last = _s(channel, seen.end - channel.stride)
                why = f"{channel.name} ends at {last}, the motion at {end_s:.6g} s"
                found.append(Lack(why, early=True))
            elif seen.end * period_s <= last_s + _ROUNDING * slack_s:
                last = _s(channel, seen.end - channel.stride)
                why = f"{channel.name} ends at {last}, {longest} goes on until {last_s:.6g} s"
                found.append(Lack(why, early=True))
        return min(found, key=lambda lack: lack.early, default=None)


def _s(channel: Channel, tick: int) -> str:
    return f"{channel.clock.time_s(tick):.6g} s"


MOST_NAMED = 50
"""Number of events of one kind that a verdict names; further ones are only counted."""
_ENDS = {"stopped": Change.STOPPED, "fault": Change.FAULT}


def _refuse_absurd(block: RecordingBlock) -> None:
    """Refuse samples whose squares could overflow; NaN counts as not measured.

    Parallel runs come from the simulation, which checks its own output.
    """
    for name, samples in block.samples.items():
        if samples.ndim > 1 or not len(samples):
            continue
        if -_MOST <= samples.min() <= samples.max() <= _MOST:
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


class EventReader:
    """Reads the blocks of a recording and collects its events.

    Attributes
    ----------
    disturbances
        Limit switches and events that changed the motion so far.
    stopped_s
        Start of the stop that ended the run, s; None if nobody stopped it.
    """

    def __init__(self, recording: Recording, machine: Machine) -> None:
        self._recording, self._machine = recording, machine
        self._outcome: Outcome | None = None
        self.disturbances: list[Disturbance] = []
        self.stopped_s: float | None = None

    def __iter__(self) -> Iterator[RecordingBlock]:
        known, self.disturbances = Outcome(), []
        switches = [
            _Cut(channel, self._recording, self._machine)
            for channel in self._recording.channels
            if channel.kind is ChannelKind.INPUT and channel.name in self._machine.inputs
        ]
        events = _Events(self._recording)
        for block in self._recording:
            _refuse_absurd(block)
            known = known.after(block.events)
            for event in block.events:
                events.take(event)
            for switch in switches:
                switch.take(block)
            yield block
        self._outcome = known
        cuts = [switch.found for switch in switches if switch.found is not None]
        self.disturbances, self.stopped_s = [*cuts, *events.found()], events.stopped_s

    def outcome(self) -> Outcome:
        """Return how the run ended; read the recording if that has not been done."""
        if self._outcome is None:
            for _ in self:
                pass
        assert self._outcome is not None
        return self._outcome


class _Cut:
    """Watches a limit switch until it cuts the supply of its drive, in the first run to hit it."""

    def __init__(self, channel: Channel, recording: Recording, machine: Machine) -> None:
        self._channel, self._runs = channel, recording.runs
        self._operation = recording.find(ChannelKind.OPERATION)
        self._switch = machine.inputs[channel.name]
        self.found: Disturbance | None = None

    def take(self, block: RecordingBlock) -> None:
        """Examine the samples of a block."""
        if self.found is not None:
            return
        channel = self._channel
        values = block.samples[channel.name].reshape(-1, self._runs) != 0.0
        on = np.flatnonzero(values.any(axis=1))
        if not len(on):
            return
        first = int(on[0])
        tick = block.first_tick[channel.clock.name] + first * channel.stride
        operation = None
        if self._operation is not None and self._operation.clock == channel.clock:
            operations = block.samples[self._operation.name]
            at = (tick - block.first_tick[channel.clock.name]) // self._operation.stride
            operation = int(operations[min(at, len(operations) - 1)]) if len(operations) else None
        runs = np.flatnonzero(values[first])
        self.found = Disturbance(
            change=Change.LIMIT_SWITCH,
            text=f"the limit switch {channel.name} of {self._switch.axis} cut the supply of "
            f"drives.{self._switch.cuts}",
            time_s=float(channel.clock.time_s(tick)),
            operation=operation if operation is not None and operation >= 0 else None,
            axis=self._switch.axis,
            run=int(runs[0]) + 1 if self._runs > 1 else None,
        )


class _Events:
    """Collects the events of a recording that changed its motion."""

    def __init__(self, recording: Recording) -> None:
        self._clock = recording.channels[0].clock if recording.channels else None
        self._found: list[Disturbance] = []
        self._held: Event | None = None
        self._holds = 0
        self._late: Event | None = None
        self._late_ticks = 0
        self._overrides = 0
        self._by_run = False  # whether the run itself was overridden, not the controller alone
        self._brakes = (0, -1)  # first and last tick of the latest hold
        self.stopped_s: float | None = None

    def take(self, event: Event) -> None:
        """Take the next event."""
        if event.kind == "hold" and self._held is None:
            self._held = event
        elif event.kind == "resume" and self._held is not None:
            self._end_hold(event)
        elif event.kind == "late":
            self._late = self._late or event
            self._late_ticks += int(event.value)
        elif event.kind == "override":
            self._overrides += 1
            self._by_run = self._by_run or event.value > 0.0
            if self._overrides <= MOST_NAMED:
                where = "in the run" if event.value > 0.0 else "at the controller"
                self._add(Change.OVERRIDE, f"overrides set {where}: {event.name}", event)
        elif event.kind in _ENDS:
            if event.kind == "stopped" and self._clock is not None:
                held, until = self._brakes
                began = (
                    self._held.tick if self._held else held if until >= event.tick else event.tick
                )
                self.stopped_s = float(self._clock.time_s(began))
            last = self._found[-1] if self._found else None
            if self._brakes[1] >= event.tick and last and last.change is Change.HOLD:
                self._found.pop()  # braking went on to the end of the run
            why = end_with_reason(event.kind, event.name)
            self._add(_ENDS[event.kind], f"the run ended early, {why},", event)

    def found(self) -> list[Disturbance]:
        """Return the collected events, once all were taken."""
        if self._held is not None:
            self._end_hold(None)
        if self._holds > MOST_NAMED:
            self._found.append(
                Disturbance(
                    change=Change.HOLD, text=f"it was held {self._holds} times in all", time_s=None
                )
            )
        if self._overrides > MOST_NAMED:
            where = "" if self._by_run else " at the controller"
            times = f"overrides were set{where} {self._overrides} times in all"
            self._found.append(Disturbance(change=Change.OVERRIDE, text=times, time_s=None))
        if self._late is not None:
            ticks = f"{self._late_ticks} tick{'s' if self._late_ticks > 1 else ''}"
            self._add(Change.LATE, f"rows came late, at {ticks} in all, first", self._late)
        return self._found

    def _end_hold(self, until: Event | None) -> None:
        assert self._held is not None
        self._holds += 1
        if until is not None:
            self._brakes = self._held.tick, until.tick
        if self._holds <= MOST_NAMED:
            why = f", {self._held.name}," if self._held.name else ""
            lasted = ""
            if until is not None and self._clock is not None:
                lasted_s = float(self._clock.time_s(until.tick - self._held.tick))
                lasted = f" for {lasted_s:.3g} s"
            self._add(Change.HOLD, f"it was held{why}{lasted}", self._held)
        self._held = None

    def _add(self, change: Change, text: str, event: Event) -> None:
        self._found.append(
            Disturbance(
                change=change,
                text=text,
                time_s=None if self._clock is None else float(self._clock.time_s(event.tick)),
                operation=event.operation if event.operation >= 0 else None,
            )
        )


_CURRENT = "current_peak"
_CHANGES = {
    _CURRENT: (Change.SATURATION, 0.0, "the current of {axis} was at its limit, first"),
    "dac_saturation": (
        Change.SATURATION, 0.0, "the controller of {axis} gave all that it has, first",
    ),
    "step_loss": (
        Change.LOST_STEPS, 1.0, "the drive of {axis} lost steps: the motion needed up to {share} "
        "of its torque or force",
    ),
    "servo_force": (
        Change.LOST_STEPS, 1.0, "the motion of {axis} needed up to {share} of its drive's torque "
        "or force",
    ),
}  # fmt: skip
"""By measure: the effect on the motion, and the measured value above which it is listed."""


def effects_in(results: Sequence[Result], machine: Machine) -> list[Disturbance]:
    """Return the effects on the motion that follow from the measured results of a verdict."""
    found = []
    for result in results:
        if result.name not in _CHANGES or result.measured is None:
            continue
        change, limit, text = _CHANGES[result.name]
        if result.name == _CURRENT:
            most = machine.drive_of(result.axis).amplifier.current_limit
            limit = np.inf if most is None else most.si * (1.0 - _ROUNDING)
        if result.measured > limit:
            share = f"{100.0 * result.measured:.4g} %"
            found.append(
                Disturbance(
                    change=change,
                    text=text.format(axis=result.axis, share=share),
                    time_s=result.time_s,
                    operation=result.operation,
                    job_line=result.job_line,
                    axis=result.axis,
                    run=result.run,
                )
            )
    return found


def with_event_readers(
    recordings: Sequence[Recording], machine: Machine
) -> list[tuple[Recording, EventReader]]:
    """Return each recording, and the ``EventReader`` through which its blocks are read."""
    found = []
    for recording in recordings:
        reader = EventReader(recording, machine)
        found.append((replace(recording, blocks=reader), reader))
    return found


def end_words(outcome: Outcome) -> str:
    """Say how a run ended before its last row; empty if it was complete."""
    if not outcome.incomplete:
        return ""
    assert outcome.ended is not None
    # A controller that reports no operation leaves -1.
    known = outcome.operation is not None and outcome.operation >= 0
    where = f" in operation {outcome.operation}" if known else ""
    return f"the run ended{where}, {end_with_reason(outcome.ended.value, outcome.text)}"


def not_beyond(
    result: Result, why: str, stopped_s: float | None = None, *, of_worst: bool = True
) -> Result:
    """Return ``result`` of a run that ended early: only a failure seen before the end is certain.

    Parameters
    ----------
    why
        How the run ended; empty if it was complete.
    stopped_s
        Start of a requested stop: an error that the stop itself causes does not fail a criterion.
    of_worst
        Whether the measure is the worst of all samples. Other measures need the whole run.
    """
    late = result.time_s is None or (stopped_s is not None and result.time_s >= stopped_s)
    by_stop = stopped_s is not None and (late or not of_worst)
    if not why or result.status is Status.NOT_MEASURED:
        return result
    if result.status is Status.FAILED and not by_stop:
        return result
    so_far = (
        ""
        if result.measured is None
        else f" ({_with_unit(result.measured, result.unit)} until then)"
    )
    note = "; ".join(filter(None, (result.note, f"{why}{so_far}")))
    return replace(result, status=Status.NOT_MEASURED, measured=None, note=note)


def _with_unit(value: float, unit: str) -> str:
    """Return a value with its unit; without a unit it is a share.

    >>> _with_unit(0.25e-3, "m"), _with_unit(0.05, "")
    ('0.00025 m', '5 %')
    """
    return f"{value:.4g} {unit}" if unit else f"{100.0 * value:.4g} %"
