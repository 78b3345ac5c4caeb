"""What an embroidery frame did, laid beside its stitches: where it stood while the needle was in.

The channel ``needle`` tells when the needle was in the cloth, simulated or live: its k-th entry is
the k-th stitch of the design.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import ClassVar

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.plan import Plan
from threadline.signals import Channel, ChannelKind, Recording, RecordingBlock
from threadline.verdict.coverage import Coverage
from threadline.verdict.finding import Found
from threadline.verdict.measure import Running, RunReading
from threadline.verdict.samples import Block

NEEDLE = "needle"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sewn:
    """What each stitch came to; s stitches, A axes; NaN where it was not seen.

    Parameters
    ----------
    residual_m
        (s, A) largest distance of the frame from its place while the needle was in the cloth.
    time_s
        (s, A) when.
    force
        (s, A) largest share of the servo's force since the stitch before.
    force_s
        (s, A) when.
    seen
        How many entries of the needle were recorded.
    until_s
        When the needle was last seen in the cloth, s.
    """

    residual_m: FloatArray
    time_s: FloatArray
    force: FloatArray
    force_s: FloatArray
    seen: int
    until_s: float


class StitchRun:
    """A recording beside its stitches; of its samples one block is in memory at a time.

    Parameters
    ----------
    recording, plan
        The two.
    """

    of: ClassVar[str] = "an embroidery machine"
    absent: ClassVar[str] = "nothing of axis {axis} was measured"
    by_time = False
    untold = None

    def __init__(self, recording: Recording, plan: Plan) -> None:
        self.plan = plan
        self.stitched = plan.stitched
        self._coverage = Coverage(recording)
        self.recording = self._coverage.watched
        self._sewn: Sewn | None = None

    @cached_property
    def turns(self) -> IntArray:
        """(s,) turn of each stitch."""
        return np.flatnonzero(self.stitched.turns.moves.needle == 1)

    @cached_property
    def places_m(self) -> FloatArray:
        """(s, A) where the frame was to stand."""
        return self.stitched.places_m[self.turns]

    @property
    def sewn(self) -> Sewn:
        """What each stitch came to; reads the recording once."""
        if self._sewn is None:
            self._sewn = self._read()
        return self._sewn

    def lacks(self, reading: RunReading, per_axis: bool) -> str:  # noqa: ARG002
        """Say what channel is absent that its measures read; empty where none is."""
        for alternatives in reading.needs:
            for axis in self.plan.axes:
                if not any(self.recording.find(kind, axis) for kind in alternatives):
                    names = " or ".join(kind.value for kind in alternatives)
                    return f"no {names} channel of {axis}"
        if not any(c.name == NEEDLE for c in self.recording.channels):
            return "no needle channel: nobody knows when it was in the cloth"
        needle = self.recording.channel(NEEDLE)
        for channel in self._read_beside:
            if (channel.clock, channel.stride) != (needle.clock, needle.stride):
                return f"{channel.name} and {NEEDLE} are not of the same instants"
        return ""

    def blocks(self) -> Iterator[Block]:
        """Yield nothing: its measures have the run whole."""
        return iter(())

    def release(self) -> None:
        """Do nothing: it holds no more samples than one block."""

    def leave(self) -> None:
        """Do nothing: it is read as a whole."""

    def results(self, running: Sequence[Running], last: Block | None) -> list[list[Found]]:  # noqa: ARG002
        """Return what each measure finds, as far as the stitches were seen."""
        found = [list(one.measure.finish()) for one in running]
        why = self.unseen_why()
        if not why:
            return found
        return [[f.each(partial(replace, unseen=why)) for f in row] for row in found]

    def unseen_why(self) -> str:
        """Say which stitches were not seen; empty where all were."""
        if self._sewn is None:
            return ""
        wanted, seen = len(self.turns), self._sewn.seen
        if seen != wanted:
            return f"the needle entered {seen} times, the design has {wanted} stitches"
        own = [c for c in self.recording.channels if c.axis in self.plan.axes or c.name == NEEDLE]
        lack = self._coverage.lack(own, 0.0, self._sewn.until_s)
        return "" if lack is None else lack.why

    def unseen(self, reading: RunReading) -> str:  # noqa: ARG002
        """Say which stitches were not seen, to a measure of many runs."""
        _ = self.sewn
        return self.unseen_why()

    @property
    def _read_beside(self) -> list[Channel]:
        """Channels that are read beside the needle's, sample by sample."""
        kinds = (ChannelKind.LOAD, ChannelKind.TORQUE_SHARE)
        found = [self.recording.find(kind, axis) for kind in kinds for axis in self.plan.axes]
        return [channel for channel in found if channel is not None]

    def _read(self) -> Sewn:
        axes, count = self.plan.axes, len(self.turns)
        shape = (count, len(axes))
        residual, at = np.full(shape, np.nan), np.full(shape, np.nan)
        force, force_at = np.full(shape, np.nan), np.full(shape, np.nan)
        seen, was, until_s = 0, False, 0.0
        for block in self.recording:
            times, needle = self._times(block), block.samples[NEEDLE] != 0
            if not len(needle):
                continue
            enters = needle & ~np.concatenate(([was], needle[:-1]))
            number = seen + np.cumsum(enters) - 1  # of the stitch, -1 before the first
            for k, axis in enumerate(axes):
                load = self.recording.find(ChannelKind.LOAD, axis)
                if load is not None:
                    stood = block.samples[load.name][: len(needle)]
                    inside = (needle & (number >= 0) & (number < count))[: len(stood)]
                    of = number[: len(stood)][inside]
                    off = np.abs(stood[inside] - self.places_m[of, k])
                    _keep(residual[:, k], at[:, k], of, off, times[: len(stood)][inside])
                pull = self.recording.find(ChannelKind.TORQUE_SHARE, axis)
                if pull is not None:
                    # From a stitch until the next it is the way there.
                    asked = block.samples[pull.name][: len(needle)]
                    to = np.minimum(number + ~needle, count - 1)[: len(asked)]
                    _keep(force[:, k], force_at[:, k], to, asked, times)
            seen += int(enters.sum())
            was = bool(needle[-1])
            if needle.any():
                until_s = float(times[needle][-1])
        return Sewn(
            residual_m=residual,
            time_s=at,
            force=force,
            force_s=force_at,
            seen=seen,
            until_s=until_s,
        )

    def _times(self, block: RecordingBlock) -> FloatArray:
        channel = self.recording.channel(NEEDLE)
        first = block.first_tick[channel.clock.name]
        return channel.clock.times_s(first, len(block.samples[NEEDLE]), channel.stride)


def _keep(
    worst: FloatArray, when: FloatArray, number: IntArray, values: FloatArray, times: FloatArray
) -> None:
    """Keep the largest of the values of each stitch; the numbers rise."""
    for begin, end in _runs(number):
        at = begin + int(np.argmax(values[begin:end]))
        stitch = int(number[begin])
        if not worst[stitch] >= values[at]:
            worst[stitch], when[stitch] = values[at], times[at]


def _runs(number: IntArray) -> Iterator[tuple[int, int]]:
    """Yield begin and end of each run of equal numbers."""
    if len(number):
        edges = np.flatnonzero(np.diff(number)) + 1
        yield from zip([0, *edges.tolist()], [*edges.tolist(), len(number)], strict=True)
