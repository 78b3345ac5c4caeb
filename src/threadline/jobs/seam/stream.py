"""The stitches of a seam as operations, one by one with tags or in runs of arrays."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from threadline.arrays import FloatArray
from threadline.jobs.operations import (
    Dwell,
    Feed,
    FeedMode,
    Move,
    MoveRun,
    Operation,
    OperationStream,
    Source,
    ToolEvent,
)
from threadline.jobs.seam.sewing import SewnContour, StitchBlock
from threadline.signals import Stream

_RAPID = Feed(FeedMode.RAPID, 0.0)
_RUN = 4096


class StitchStream(OperationStream):
    """A job's worth of contours: travel, sew, the stitches, trim, for each.

    Both readings give the same operations in the same order; runs leave the tags behind.
    """

    __slots__ = ()

    def __init__(self, sewn: Sequence[SewnContour]) -> None:
        super().__init__(lambda: _runs(sewn))
        Stream.__init__(self, lambda: _operations(sewn))


def _operations(sewn: Sequence[SewnContour]) -> Iterator[Operation]:
    for number, contour in enumerate(sewn):
        yield from _begin(contour)
        needle = _Needle(contour)
        for block in contour.blocks():
            yield from needle.stitches(number, block)
            yield from _rest(contour, block)
        yield ToolEvent("trim", 1.0, Source(contour.place.file, needle.line))


def _runs(sewn: Sequence[SewnContour]) -> Iterator[Operation | MoveRun]:
    for contour in sewn:
        yield from _begin(contour)
        line = contour.place.line
        for block in contour.blocks():
            line = int(block.line[-1])
            for start in range(0, len(block.line), _RUN):
                part = slice(start, start + _RUN)
                yield MoveRun(
                    targets=block.points[1:][part],
                    line=block.line[part],
                    feeds=tuple(_feeds(contour, block.times_s[part])),
                    file=contour.place.file,
                    passes=(),
                )
            yield from _rest(contour, block)
        yield ToolEvent("trim", 1.0, Source(contour.place.file, line))


def _begin(contour: SewnContour) -> Iterator[Operation]:
    source = Source(contour.place.file, contour.place.line)
    x, y = contour.start().tolist()
    speed = contour.settings.travel_speed_m_s
    feed = _RAPID if speed is None or math.isinf(speed) else Feed(FeedMode.PATH, speed)
    yield Move((x, y), feed, source, {"kind": "travel", "seam": contour.seam})
    if contour.settings.settle_s:
        yield Dwell(contour.settings.settle_s, source)
    yield ToolEvent("sew", 1.0, source)


def _rest(contour: SewnContour, block: StitchBlock) -> Iterator[Operation]:
    if block.rests and block.leg is not contour.legs[-1]:
        yield Dwell(0.0, Source(contour.place.file, int(block.line[-1])))


def _feeds(contour: SewnContour, times_s: FloatArray) -> Iterator[tuple[int, Feed]]:
    """Yield each feed and the stitch from which on it counts."""
    if contour.settings.needle == "constant":
        yield 0, Feed(FeedMode.INVERSE_TIME, contour.settings.needle_speed_hz)
        return
    for k in np.flatnonzero(np.diff(times_s, prepend=-1.0)).tolist():
        yield k, Feed(FeedMode.INVERSE_TIME, 1.0 / float(times_s[k]))


class _Needle:
    """Counts the stitches of a contour and their time."""

    def __init__(self, contour: SewnContour) -> None:
        self.contour = contour
        self.stitch = 0
        self.time_s = 0.0
        self.line = contour.place.line
        self.even = Feed(FeedMode.INVERSE_TIME, contour.settings.needle_speed_hz)

    def stitches(self, number: int, block: StitchBlock) -> Iterator[Move]:
        """Yield the stitches of a leg with their tags."""
        contour, settings = self.contour, self.contour.settings
        constant = settings.needle == "constant"
        source = Source(contour.place.file, self.line)
        base: dict[str, float | str] = {
            "kind": "lock" if block.leg.lock else "sew",
            "seam": contour.seam,
            "contour": number,
            "target_m": settings.stitch_length_m,
        }
        corner_at = len(block.lengths_m) - 1 if block.leg.end_turn_rad is not None else -1
        for k, (x, y, length, time, exempt, line) in enumerate(_rows(block)):
            self.time_s += time
            if line != source.line:
                source = Source(contour.place.file, line)
            tags = {
                **base,
                "stitch": self.stitch,
                "exempt": exempt,
                "corner": int(k == corner_at),
                # Whole turns of the needle are counted, so that no rounding adds up.
                "needle_s": (self.stitch + 1) / settings.needle_speed_hz
                if constant
                else self.time_s,
                "length_m": length,
            }
            feed = self.even if constant else Feed(FeedMode.INVERSE_TIME, 1.0 / time)
            yield Move((x, y), feed, source, tags)
            self.stitch += 1
        self.line = source.line


def _rows(block: StitchBlock) -> Iterator[tuple[float, float, float, float, int, int]]:
    return zip(
        block.points[1:, 0].tolist(),
        block.points[1:, 1].tolist(),
        block.lengths_m.tolist(),
        block.times_s.tolist(),
        block.exempt.astype(np.int64).tolist(),
        block.line.tolist(),
        strict=True,
    )
