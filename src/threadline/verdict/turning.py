"""Turning-point error: an axis stops short of a programmed reversal, or runs past it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.compiled import njit
from threadline.verdict.finding import Found, Worst
from threadline.verdict.measure import Measure, Option
from threadline.verdict.reversals import ReversalScan, Turning
from threadline.verdict.samples import Block, Setting
from threadline.verdict.window import PathWindow

OPTIONS = {"smallest": Option(unit="m", default=5e-5)}


def _track(
    points: FloatArray,
    column: int,
    time_s: FloatArray,
    chord: IntArray,
    first: int,
    lag: int,
    values: FloatArray,
    leaves: IntArray,
    whole: IntArray,
    real: FloatArray,
    errors: FloatArray,
    times_s: FloatArray,
) -> int:
    """Follow an axis of many runs through the turnings of a block; return how many of them closed.

    ``points`` is (n, axes, runs), of which the axis is ``column``. ``whole`` is [direction, sample
    at which the command left the turning or -1], the same for all runs; ``real``, (4, runs), is
    [best, its time, best of the opposite direction since then, its time]. ``errors`` and
    ``times_s`` are (turnings, runs).
    """
    closed, runs = 0, points.shape[2]
    for i in range(len(points)):
        side, now_s = whole[0], time_s[i]
        for r in range(runs):
            y = side * points[i, column, r]
            farther = y > real[0, r]
            back = farther or -y > real[2, r]
            real[0, r] = y if farther else real[0, r]
            real[1, r] = now_s if farther else real[1, r]
            real[2, r] = -y if back else real[2, r]
            real[3, r] = now_s if back else real[3, r]
        if closed == len(values):
            continue
        if whole[1] < 0 and chord[i] >= leaves[closed]:
            whole[1] = first + i
        if whole[1] < 0:
            continue
        overtaken = closed + 1 < len(values) and chord[i] >= leaves[closed + 1]
        if overtaken or first + i - whole[1] >= lag:
            for r in range(runs):
                errors[closed, r] = real[0, r] - whole[0] * values[closed]
                times_s[closed, r] = real[1, r]
                real[0, r], real[1, r] = real[2, r], real[3, r]
                real[2, r], real[3, r] = whole[0] * points[i, column, r], now_s
            closed += 1
            whole[0], whole[1] = -whole[0], -1
    return closed


_track_fast = njit(nogil=True)(_track)


class _Axis:
    """One axis: the turnings ahead of it, and its farthest position in the current direction."""

    def __init__(self, column: int, name: str, setting: Setting, smallest: float) -> None:
        self._column, self._runs = column, setting.runs
        self._lag = setting.lag_samples
        self._scan = ReversalScan(column, smallest, setting.radius_m)
        self._open: list[Turning] = []
        self._whole = np.array([0, -1], dtype=np.int64)
        self._real: FloatArray = np.zeros((4, setting.runs))
        self._real[[0, 2]] = -np.inf
        self._worst = Worst(setting.runs, len(setting.axes), name, note="the recording is empty")
        self._last_s = 0.0
        self._last: FloatArray = np.zeros(setting.runs)

    def feed(self, block: Block, path: PathWindow) -> None:
        assert block.chord is not None
        found = self._scan.scan(path)
        self._open.extend(found)
        self._last = block.at_tool[-1, self._column].copy()
        self._last_s = float(block.time_s[-1])
        if not self._whole[0]:
            self._whole[0] = self._open[0].direction if self._open else self._scan.direction
        if not self._whole[0]:
            return
        shape = len(self._open), self._runs
        errors, times_s = np.empty(shape), np.empty(shape)
        closed = _track_fast(
            block.at_tool,
            self._column,
            block.time_s,
            block.chord,
            block.first,
            self._lag,
            np.array([turning.value for turning in self._open], dtype=np.float64),
            np.array([turning.leaves for turning in self._open], dtype=np.int64),
            self._whole,
            self._real,
            errors,
            times_s,
        )
        for turning, error, at_s in zip(self._open, errors[:closed], times_s, strict=False):
            self._offer(turning, error, at_s)
        del self._open[:closed]

    def finish(self, path: PathWindow | None, last: FloatArray | None) -> Found:
        if path is None or last is None:
            return self._worst.found()
        real, direction = self._real, int(self._whole[0])
        for turning in [*self._open, self._scan.end()]:
            if direction:
                self._offer(turning, real[0] - direction * turning.value, real[1])
            else:
                self._offer(turning, np.abs(self._last - turning.value), self._last_s)
            direction = -direction
            # What followed the last turning is the way to the next; after that comes nothing.
            real = np.stack([real[2], real[3], -real[0], real[1]])
        rest = path.remainder(last)
        if rest is not None:
            self._worst.offer(
                np.abs(self._last - rest.end[self._column]),
                time_s=self._last_s,
                operation=rest.operation,
                line=rest.line,
                position=rest.position,
                note="the recording ends before the job",
            )
        return self._worst.found()

    def _offer(self, turning: Turning, error: FloatArray, time_s: FloatArray | float) -> None:
        sides = np.where(error > 0.0, "past", np.where(error < 0.0, "short", ""))
        self._worst.offer(
            np.abs(error),
            time_s=time_s,
            operation=turning.operation,
            line=turning.line,
            position=np.array(turning.position),
            note=sides.astype(object) if turning.direction else "",
        )


class _TurningPoints:
    r"""Per axis: the farthest that it comes at each reversal, against the programmed value.

    Lengths at the tool (rotary axes times their radius). A reversal is watched from the one
    before it until the command has left it for the lag, or has left the next one. The end of
    the job is the last of them. An extreme between two samples can be missed by at most
    a T^2 / 8, with the acceleration a and the sample interval T. A stroke that takes less
    time than the machine's lag is charged with the distance that was not yet covered.
    """

    def __init__(self, setting: Setting, smallest: float) -> None:
        self._axes = [
            _Axis(column, name, setting, smallest) for column, name in enumerate(setting.axes)
        ]
        self._path: PathWindow | None = None
        self._last: FloatArray | None = None

    def feed(self, block: Block) -> None:
        assert block.path is not None
        self._path, self._last = block.path, block.at_tool[-1]
        for axis in self._axes:
            axis.feed(block, block.path)

    def finish(self) -> Sequence[Found]:
        return [axis.finish(self._path, self._last) for axis in self._axes]


def start_turning(setting: Setting, options: Mapping[str, float]) -> Measure:
    """Begin measuring the turning-point error."""
    return _TurningPoints(setting, options["smallest"])
