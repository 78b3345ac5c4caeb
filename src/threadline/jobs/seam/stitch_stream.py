"""The stitches of seams as operations, one by one or in runs of arrays."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from threadline.arrays import FloatArray
from threadline.jobs.operations import (
    Column,
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
    """The operations of a job's contours: for each of them travel, its stitches, and a trim."""

    __slots__ = ()

    def __init__(self, sewn: Sequence[SewnContour]) -> None:
        super().__init__(Stream(_runs, sewn))


def _runs(sewn: Sequence[SewnContour]) -> Iterator[Operation | MoveRun]:
    for number, contour in enumerate(sewn):
        yield from _begin(contour)
        needle = _Needle(contour, number)
        line = contour.place.line
        for block, most_hz in _with_most(contour):
            line = int(block.line[-1])
            columns = needle.columns(block)
            for start in range(0, len(block.line), _RUN):
                part = slice(start, start + _RUN)
                yield MoveRun(
                    targets=block.points[1:][part],
                    line=block.line[part],
                    feeds=tuple(_feeds(contour, block.times_s[part], most_hz[part])),
                    file=contour.place.file,
                    passes=(),
                    columns={name: column[part] for name, column in columns.items()},
                )
            yield from _rest(contour, block)
        source = Source(contour.place.file, line)
        yield ToolEvent("trim", 1.0, source)
        if contour.settings.trim_s:
            yield Dwell(contour.settings.trim_s, source)


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


def _with_most(contour: SewnContour) -> Iterator[tuple[StitchBlock, FloatArray]]:
    """Yield blocks with the (n,) speeds up to which a timing by limits may turn the needle.

    Where a corner is rounded one piece of the path is of two stitches, and has one speed. So that
    neither of them takes less than a turn, both have that of the shorter.
    """
    held: tuple[StitchBlock, FloatArray] | None = None
    for block in contour.blocks():
        most_hz = np.full(len(block.lengths_m), contour.settings.needle_speed_hz)
        # Only a needle that follows has such speeds; others need no leg in hand.
        if not contour.settings.follows:
            yield block, most_hz
            continue
        if held is not None:
            before, slowed_hz = held
            if not before.rests:
                ratio = float(block.lengths_m[0] / before.lengths_m[-1])
                slowed_hz[-1] = min(slowed_hz[-1], most_hz[0] * ratio)
                most_hz[0] *= min(1.0, 1.0 / ratio)
            yield held
        held = block, most_hz
    if held is not None:
        yield held


def _feeds(
    contour: SewnContour, times_s: FloatArray, most_hz: FloatArray
) -> Iterator[tuple[int, Feed]]:
    """Yield each feed with the index of the first stitch to which it applies."""
    if contour.settings.needle == "constant":
        yield 0, Feed(FeedMode.INVERSE_TIME, contour.settings.needle_speed_hz)
        return
    changes = np.diff(times_s, prepend=-1.0) != 0.0
    if contour.settings.follows:
        changes |= np.diff(most_hz, prepend=-1.0) != 0.0
    for k in np.flatnonzero(changes).tolist():
        most = float(most_hz[k]) if contour.settings.follows else None
        yield k, Feed(FeedMode.INVERSE_TIME, 1.0 / float(times_s[k]), most=most)


class _Needle:
    """Counts the stitches of a contour and their time."""

    def __init__(self, contour: SewnContour, number: int) -> None:
        self.contour = contour
        self.number = number
        self.stitch = 0
        self.time_s = 0.0

    def columns(self, block: StitchBlock) -> dict[str, Column]:
        """Return the tags of the stitches of a leg, as columns."""
        settings, count = self.contour.settings, len(block.lengths_m)
        stitch = np.arange(self.stitch, self.stitch + count)
        if settings.needle == "constant":
            # Whole turns of the needle are counted, so that no rounding adds up.
            ends_s = (stitch + 1) / settings.needle_speed_hz
        else:
            ends_s = np.cumsum(np.concatenate([[self.time_s], block.times_s]))[1:]
        corner = np.zeros(count, dtype=np.int64)
        corner[-1] = block.leg.end_turn_rad is not None
        self.stitch += count
        self.time_s = float(ends_s[-1])
        follows: dict[str, Column] = {}
        if settings.follows:
            follows["slowest_hz"] = np.full(count, settings.needle_slowest_hz)
            follows["fastest_hz"] = np.full(count, settings.needle_speed_hz)
            if math.isfinite(settings.needle_acceleration_hz_s):
                follows["most_hz_s"] = np.full(count, settings.needle_acceleration_hz_s)
        return follows | {
            "kind": np.full(count, "lock" if block.leg.lock else "sew"),
            "seam": np.full(count, self.contour.seam),
            "contour": np.full(count, self.number),
            "stitch": stitch,
            "exempt": block.exempt.astype(np.int64),
            "corner": corner,
            "needle_s": ends_s,
            "length_m": block.lengths_m,
            "target_m": block.target_m,
            "from_m": block.at_m[:-1],
            "to_m": block.at_m[1:],
        }
