"""Turning-point error: an axis stops short of a programmed reversal, or runs past it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numba import njit

from threadline.arrays import FloatArray, IntArray
from threadline.verdict.measure import Finding, Measure, Option
from threadline.verdict.reversals import ReversalScan, Turning
from threadline.verdict.samples import Block, Setting
from threadline.verdict.window import PathWindow

OPTIONS = {"smallest": Option(unit="m", default=5e-5)}


def _track(
    x: FloatArray,
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
    """Follow an axis through the turnings of a block; return how many of them closed.

    ``whole`` is [direction, sample at which the command left the turning or -1]; ``real`` is
    [best, its time, best of the opposite direction since then, its time].
    """
    closed = 0
    for i in range(len(x)):
        y = whole[0] * x[i]
        if y > real[0]:
            real[0], real[1] = y, time_s[i]
            real[2], real[3] = -y, time_s[i]
        elif -y > real[2]:
            real[2], real[3] = -y, time_s[i]
        if closed == len(values):
            continue
        if whole[1] < 0 and chord[i] >= leaves[closed]:
            whole[1] = first + i
        if whole[1] < 0:
            continue
        overtaken = closed + 1 < len(values) and chord[i] >= leaves[closed + 1]
        if overtaken or first + i - whole[1] >= lag:
            errors[closed] = real[0] - whole[0] * values[closed]
            times_s[closed] = real[1]
            closed += 1
            whole[0], whole[1] = -whole[0], -1
            real[0], real[1] = real[2], real[3]
            real[2], real[3] = -whole[0] * x[i], time_s[i]
    return closed


_track_fast = njit(cache=True, nogil=True)(_track)


class _Axis:
    """One axis: the turnings ahead of it, and its farthest position in the current direction."""

    def __init__(self, column: int, name: str, setting: Setting, smallest: float) -> None:
        self._name = name
        self._column = column
        self._radius_m = setting.radius_m[column]
        self._lag = setting.lag_samples
        self._scan = ReversalScan(column, smallest, setting.radius_m)
        self._open: list[Turning] = []
        self._whole = np.array([0, -1], dtype=np.int64)
        self._real = np.array([-np.inf, 0.0, -np.inf, 0.0])
        self._worst = Finding(value=None, axis=name, note="the recording is empty")
        self._last = (0.0, 0.0)  # position, time

    def feed(self, block: Block, path: PathWindow) -> None:
        assert block.actual is not None and block.chord is not None
        found = self._scan.scan(path)
        self._open.extend(found)
        x = np.ascontiguousarray(block.actual[:, self._column]) * self._radius_m
        self._last = (float(x[-1]), float(block.time_s[-1]))
        if not self._whole[0]:
            self._whole[0] = self._open[0].direction if self._open else self._scan.direction
        if not self._whole[0]:
            return
        count = len(self._open)
        errors, times_s = np.empty(count), np.empty(count)
        closed = _track_fast(
            x,
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
            self._offer(turning, float(error), float(at_s))
        del self._open[:closed]

    def finish(self, path: PathWindow | None, last: FloatArray | None) -> Finding:
        if path is None or last is None:
            return self._worst
        real, direction = self._real, int(self._whole[0])
        for turning in [*self._open, self._scan.end()]:
            if direction:
                self._offer(turning, float(real[0]) - direction * turning.value, float(real[1]))
            else:
                self._offer(turning, abs(self._last[0] - turning.value), self._last[1])
            direction = -direction
            # What followed the last turning is the way to the next; after that comes nothing.
            real = np.array([real[2], real[3], -real[0], real[1]])
        rest = path.remainder(last)
        if rest is not None:
            missing = abs(self._last[0] - float(rest.end[self._column]))
            end = Turning(0.0, 0, rest.operation, rest.line, rest.position, 0)
            self._offer(end, -missing, self._last[1], "the recording ends before the job")
        return self._worst

    def _offer(self, turning: Turning, error: float, time_s: float, note: str = "") -> None:
        if self._worst.value is not None and abs(error) <= self._worst.value:
            return
        if not note and turning.direction and error:
            note = "past" if error > 0 else "short"
        self._worst = Finding(
            value=abs(error),
            axis=self._name,
            time_s=time_s,
            operation=turning.operation,
            job_line=turning.line,
            position=turning.position,
            note=note,
        )


class _TurningPoints:
    r"""Per axis: the farthest that it comes at each reversal, against the programmed value.

    Lengths at the tool (rotary axes times their radius). A reversal is watched from the one
    before it until the command has left it for the lag, or has left the next one. The end of
    the job is the last of them. An extreme between two samples can be missed by at most
    a T^2 / 8, with the acceleration a and the sample interval T. Strokes shorter in time than
    the machine's lag are charged with what it had not yet covered.
    """

    def __init__(self, setting: Setting, smallest: float) -> None:
        self._axes = [
            _Axis(column, name, setting, smallest) for column, name in enumerate(setting.axes)
        ]
        self._radius_m = setting.radius_m
        self._path: PathWindow | None = None
        self._last: FloatArray | None = None

    def feed(self, block: Block) -> None:
        assert block.path is not None and block.actual is not None
        self._path = block.path
        self._last = block.actual[-1] * self._radius_m
        for axis in self._axes:
            axis.feed(block, block.path)

    def finish(self) -> Sequence[Finding]:
        return [axis.finish(self._path, self._last) for axis in self._axes]


def start_turning(setting: Setting, options: Mapping[str, float]) -> Measure:
    """Begin measuring the turning-point error."""
    return _TurningPoints(setting, options["smallest"])
