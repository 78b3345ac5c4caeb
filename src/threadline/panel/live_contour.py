"""The contour error of a run while it goes on, from the samples that the executor receives.

At each sample the measure equals the criterion ``contour_error``: the distance of the load from the
chords that the command visits within the lag before and after the sample. Only the judge also
measures between the samples and at missed programmed points. A link without measured positions has
no live error.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from queue import SimpleQueue
from typing import Any

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.commands.plan import Plan
from threadline.errors import ThreadlineError
from threadline.files import Channel, ChannelKind, Recording, RecordingBlock
from threadline.live.kinds_run import run_kind_of
from threadline.live.states import Cause, Sink, State
from threadline.verdict import Spec, as_intended
from threadline.verdict.blocks import judged_blocks, master_channel, setting_of
from threadline.verdict.samples import Block, sample_interval_s
from threadline.verdict.window import PathWindow

_NAME = "contour_error"
_LOAD = (ChannelKind.TOOL, ChannelKind.LOAD)
_ENCODER = (ChannelKind.MEASURED,)
_ASKED = (ChannelKind.COMMANDED, ChannelKind.OPERATION)
PIECE_S = 0.1
"""Duration of the pieces in which samples are measured, s: 10 per second, the page's drawing
rate."""
_ENDS_S = 5.0
_REHEARSED = 8  # samples


@dataclass(slots=True)
class _Seen:
    """The largest distance since the last report, the largest of the run, and its instant."""

    latest_m: float = 0.0
    fresh_m: float = -1.0
    worst_m: float = -1.0
    worst_s: float = 0.0


class LiveContour:
    """Measures the contour error of one run, in a thread of its own.

    Parameters
    ----------
    plan
        The plan of the run.
    limit_m, lag_s
        The limit, m, and the largest lag of the machine behind its command, s.
    channels
        Channels of the blocks.
    kinds
        Kinds of channels that hold the position, the preferred kind first.
    """

    def __init__(
        self,
        plan: Plan,
        limit_m: float,
        lag_s: float,
        channels: tuple[Channel, ...],
        kinds: Sequence[ChannelKind],
    ) -> None:
        self._plan, self._limit_m, self._lag_s = plan, limit_m, lag_s
        self._kinds = kinds
        self._queue: SimpleQueue[list[RecordingBlock] | None] = SimpleQueue()
        self._held, self._count = list[RecordingBlock](), 0  # the next piece: blocks and samples
        self._seen, self._lock = _Seen(), threading.Lock()
        self.failed = ""
        """Why the measurement ended before the run; empty otherwise."""
        needed = tuple(c for c in channels if c.kind in {*kinds, *_ASKED})
        recording = Recording(
            channels=needed,
            blocks=(),
            job_sha256=plan.job.sha256,
            machine_sha256=plan.machine.sha256,
            simulated=False,
        )
        period_s = sample_interval_s(master_channel(recording, plan.axes))
        names = tuple(channel.name for channel in needed)
        self._names, self._piece = names, max(1, round(PIECE_S / period_s))
        feed = _Feed(self._queue, names)
        self._recording = as_intended(replace(recording, blocks=feed), plan)
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    @classmethod
    def of(cls, plan: Plan, spec: Spec, channels: tuple[Channel, ...]) -> LiveContour | None:
        """Return the measurement of a run; None if it has no limit, or nothing is measured."""
        limits = [one.limit for one in spec.criteria if one.name == _NAME and one.limit]
        if not limits or not any(c.kind is ChannelKind.OPERATION for c in channels):
            return None
        channels_present = {(c.kind, c.axis) for c in channels}
        for kinds in (_LOAD, _ENCODER):
            if all(any((kind, axis) in channels_present for kind in kinds) for axis in plan.axes):
                return cls(plan, min(limits), spec.lag_s, channels, kinds)
        return None

    @classmethod
    def rehearse(cls, plan: Plan, spec: Spec, channels: tuple[Channel, ...]) -> None:
        """Measure a few samples at rest, so that the modules are loaded before the run begins."""
        live = cls.of(plan, spec, channels)
        if live is None:
            return
        starts = run_kind_of(plan.machine).start(plan.commands) / plan.machine.counts_per_unit
        start_positions = dict(zip(plan.machine.axis_names, starts.tolist(), strict=True))
        samples_at_rest = {
            channel.name: np.full(_REHEARSED, start_positions.get(channel.axis, 0.0))
            if channel.kind in (*_LOAD, *_ENCODER, ChannelKind.COMMANDED)
            else np.zeros(_REHEARSED)
            for channel in channels
        }
        live.block(RecordingBlock(first_tick={channels[0].clock.name: 0}, samples=samples_at_rest))
        live.close()

    # --- a sink ----------------------------------------------------------------------------

    def begin(self, channels: tuple[Channel, ...], simulated: bool) -> None:
        """Ignore the channels: they are known."""

    def state(self, tick: int, state: State, cause: Cause, text: str) -> None:
        """Ignore a change of state."""

    def block(self, block: RecordingBlock) -> None:
        """Take samples; the thread wakes once per piece and measures it."""
        new_count = max(len(block.samples[name]) for name in self._names)
        if not new_count:
            return
        self._held.append(block)
        self._count += new_count
        if self._count >= self._piece:
            self._hand_over()

    def _hand_over(self) -> None:
        self._queue.put(self._held)
        self._held, self._count = [], 0

    def close(self) -> None:
        """Measure the samples received so far, and end the thread."""
        if self._held:
            self._hand_over()
        self._queue.put(None)
        self._thread.join(_ENDS_S)

    # --- its result ------------------------------------------------------------------------

    def report(self) -> dict[str, Any] | None:
        """Return the largest distance since the last report, and of the run; None before a sample.

        Lengths are m, ``worst_s`` is the instant of the plan, s.
        """
        with self._lock:
            seen = self._seen
            if seen.worst_m < 0.0 or self.failed:
                return None
            if seen.fresh_m >= 0.0:
                seen.latest_m, seen.fresh_m = seen.fresh_m, -1.0
            return {
                "now_m": seen.latest_m,
                "worst_m": seen.worst_m,
                "worst_s": seen.worst_s,
                "limit_m": self._limit_m,
                "at": "load" if self._kinds is _LOAD else "encoder",
            }

    def _work(self) -> None:
        plan, recording = self._plan, self._recording
        try:
            setting = setting_of(plan, recording, self._lag_s)
            path = PathWindow(plan.motion.programmed)
            lag, resolution = setting.lag_samples, setting.resolution
            blocks = judged_blocks(recording, setting.axes, lag, path, resolution, few=1)
            for block in blocks:
                self._take(block)
        except ThreadlineError as error:
            self.failed = error.message

    def _take(self, block: Block) -> None:
        if self._kinds is _ENCODER:
            block = replace(block, actual=block.own)
        distances2_m2: FloatArray = block.nearest_on_surface[0][:, 0]
        if not np.isfinite(distances2_m2).all():
            return
        k = int(distances2_m2.argmax())
        largest_m = float(np.sqrt(distances2_m2[k]))
        with self._lock:
            seen = self._seen
            seen.fresh_m = max(seen.fresh_m, largest_m)
            if largest_m > seen.worst_m:
                seen.worst_m, seen.worst_s = largest_m, float(block.due_s[k])


class Also:
    """A sink that passes everything on to two sinks.

    Parameters
    ----------
    first, second
        The receivers.
    """

    def __init__(self, first: Sink, second: Sink) -> None:
        self._both = (first, second)

    def begin(self, channels: tuple[Channel, ...], simulated: bool) -> None:
        """Pass on the channels."""
        for one in self._both:
            one.begin(channels, simulated)

    def state(self, tick: int, state: State, cause: Cause, text: str) -> None:
        """Pass on a change of state."""
        for one in self._both:
            one.state(tick, state, cause, text)

    def block(self, block: RecordingBlock) -> None:
        """Pass on samples."""
        for one in self._both:
            one.block(block)


class _Feed:
    """Pieces of a run as they arrive, with the channels ``names``; it ends with the run."""

    def __init__(
        self, queue: SimpleQueue[list[RecordingBlock] | None], names: Sequence[str]
    ) -> None:
        self._queue, self._names = queue, names

    def __iter__(self) -> Iterator[RecordingBlock]:
        while (piece := self._queue.get()) is not None:
            yield _joined(piece, self._names)


def _joined(blocks: Sequence[RecordingBlock], names: Sequence[str]) -> RecordingBlock:
    """Return some channels of consecutive blocks as one block."""
    samples: Mapping[str, FloatArray] = {
        name: np.concatenate([one.samples[name] for one in blocks]) for name in names
    }
    events = tuple(event for one in blocks for event in one.events)
    return RecordingBlock(first_tick=blocks[0].first_tick, samples=samples, events=events)
