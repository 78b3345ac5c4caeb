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
from threadline.signals import ChannelKind, Recording, RecordingBlock
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
    """

    residual_m: FloatArray
    time_s: FloatArray
    force: FloatArray
    force_s: FloatArray
    seen: int


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
        named = [c for c in self.recording.channels if c.name == NEEDLE]
        return "" if named else "no needle channel: nobody knows when it was in the cloth"

    def blocks(self) -> Iterator[Block]:
        """Yield nothing: its measures have the run whole."""
        return iter(())

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
        channels = [c for c in self.recording.channels if c.axis in self.plan.axes]
        end_s = float(self._sewn.time_s.max(initial=0.0))
        lack = self._coverage.lack(channels, 0.0, end_s)
        return "" if lack is None else lack.why

    def unseen(self, reading: RunReading) -> str:  # noqa: ARG002
        """Say which stitches were not seen, to a measure of many runs."""
        _ = self.sewn
        return self.unseen_why()

    def _read(self) -> Sewn:
        axes, count = self.plan.axes, len(self.turns)
        shape = (count, len(axes))
        residual, at = np.full(shape, np.nan), np.full(shape, np.nan)
        force, force_at = np.full(shape, np.nan), np.full(shape, np.nan)
        seen, was = 0, False
        for block in self.recording:
            times, needle = self._times(block), block.samples[NEEDLE] != 0
            if not len(needle):
                continue
            enters = needle & ~np.concatenate(([was], needle[:-1]))
            number = seen + np.cumsum(enters) - 1  # of the stitch, -1 before the first
            for k, axis in enumerate(axes):
                load = self.recording.find(ChannelKind.LOAD, axis)
                if load is not None:
                    inside = needle & (number >= 0) & (number < count)
                    off = np.abs(
                        block.samples[load.name][inside] - self.places_m[number[inside], k]
                    )
                    _keep(residual[:, k], at[:, k], number[inside], off, times[inside])
                pull = self.recording.find(ChannelKind.TORQUE_SHARE, axis)
                if pull is not None:
                    # From a stitch until the next it is the way there.
                    to = np.minimum(number + ~needle, count - 1)
                    _keep(force[:, k], force_at[:, k], to, block.samples[pull.name], times)
            seen += int(enters.sum())
            was = bool(needle[-1])
        return Sewn(residual_m=residual, time_s=at, force=force, force_s=force_at, seen=seen)

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
