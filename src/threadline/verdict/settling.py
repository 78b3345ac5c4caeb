"""Residual vibration, settling time and velocity ripple."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.verdict.finding import RunFindings, Worst
from threadline.verdict.measure import Measure, Option
from threadline.verdict.samples import Block, Setting, enough_of

RESIDUAL_OPTIONS = {
    "after": Option(unit="s", default=0.0),
    "window": Option(unit="s", default=1.0, above_0=True),
}
SETTLING_OPTIONS = {"band": Option(unit="m", default=1e-4)}
_WATCHED_S = 0.2
"""Shortest time for which a load is watched after the command: half a period of 2.5 Hz."""


def _if_watched(found: RunFindings, watched_s: float, least_s: float) -> RunFindings:
    """Return findings about the rest after a command; if it is too short they can only fail."""
    if watched_s >= least_s * (1.0 - 1e-9):
        return found
    why = (
        f"the recording goes on for {1e3 * max(watched_s, 0.0):.4g} ms after the command; it needs "
        f"{1e3 * least_s:.4g} ms"
    )
    return found.each(lambda one: one if one.value is None else replace(one, unseen=why))


class CommandEnd:
    """Finds the instant at which the command changes for the last time, block by block.

    A change below the resolution of the command does not count: see ``Steady``.
    """

    def __init__(self) -> None:
        self._last: FloatArray | None = None
        self.time_s = 0.0
        self.operation: int | None = None
        self.position: FloatArray | None = None

    def begins_at(self, block: Block) -> int | None:
        """Return the sample of the block with which a new rest begins, if any."""
        commanded = block.rests
        assert commanded is not None
        index = _last_change(commanded, self._last)
        if index is None and self._last is None:
            index = 0
        self._last = commanded[-1].copy()
        if index is None:
            return None
        self.time_s = float(block.time_s[index])
        self.operation = None if block.operation is None else int(block.operation[index])
        self.position = commanded[index]
        return index


def _last_change(commanded: FloatArray, before: FloatArray | None) -> int | None:
    """Return the last of (n, axes) commands that differs from its predecessor, if any."""
    if len(commanded) > 1 and (commanded[-1] != commanded[-2]).any():  # still moving
        return len(commanded) - 1
    changed = np.flatnonzero((commanded[1:] != commanded[:-1]).any(axis=1))
    if len(changed):
        return int(changed[-1]) + 1
    return 0 if before is not None and (commanded[0] != before).any() else None


class _Residual:
    """Per axis: half the peak-to-peak motion of the load after the command's end, at the tool.

    The window begins ``after`` the end of the command and lasts for ``window``, both ends included.
    Between two samples the load moves in a straight line. With ``after`` 0 the distance that the
    load still has to go counts, too.
    """

    def __init__(self, setting: Setting, after_s: float, window_s: float) -> None:
        self._axes, self._runs = setting.axes, setting.runs
        self._lengths = setting.lengths
        self._after_s, self._window_s = after_s, window_s
        self._end = CommandEnd()
        self._time_of_last_s = np.nan
        self._last: FloatArray = np.full((setting.runs, len(setting.axes)), np.nan)
        self._clear()

    def _clear(self) -> None:
        shape = self._runs, len(self._axes)
        self._low, self._high = np.full(shape, np.inf), np.full(shape, -np.inf)
        self._time_s = np.zeros(shape)
        self._lasts = False  # whether the recording continues after the command

    def feed(self, block: Block) -> None:
        assert block.actual is not None
        begin = self._end.begins_at(block)
        if begin is not None:
            self._clear()
        end_s = self._end.time_s
        self._lasts |= bool(block.time_s[-1] > end_s)
        begin_s, stop_s = end_s + self._after_s, end_s + self._after_s + self._window_s
        inside = (block.time_s >= begin_s) & (block.time_s <= stop_s)
        time_s, part = block.time_s[inside], block.actual[inside]
        # Ends of the window between two samples.
        for at_s in (begin_s, stop_s):
            place = self._between(block, at_s)
            if place is not None:
                time_s = np.append(time_s, at_s)
                part = np.concatenate([part, place[None]])
        self._time_of_last_s, self._last = float(block.time_s[-1]), block.actual[-1]
        if not len(time_s):
            return
        low, high = part.min(axis=0), part.max(axis=0)
        # The instant at which the whole window has been seen, wherever blocks begin.
        for grown, far in (
            (low < self._low, part.argmin(axis=0)),
            (high > self._high, part.argmax(axis=0)),
        ):
            self._time_s = np.where(grown, np.maximum(time_s[far], self._time_s), self._time_s)
        self._low, self._high = np.minimum(self._low, low), np.maximum(self._high, high)

    def _between(self, block: Block, at_s: float) -> FloatArray | None:
        """Return the (runs, axes) positions at an instant between two samples; None elsewhere."""
        assert block.actual is not None
        after = int(np.searchsorted(block.time_s, at_s))
        if after == len(block) or block.time_s[after] == at_s:
            return None
        before_s = block.time_s[after - 1] if after else self._time_of_last_s
        before = block.actual[after - 1] if after else self._last
        if not before_s < at_s:  # nor before the first sample
            return None
        share = (at_s - before_s) / (block.time_s[after] - before_s)
        return np.asarray(before + share * (block.actual[after] - before))

    def finish(self) -> Sequence[RunFindings]:
        found = []
        swing = self._lengths((self._high - self._low) / 2, self._low)
        for column, axis in enumerate(self._axes):
            values = swing[:, column]
            worst = Worst(
                self._runs, len(self._axes), axis, note="the recording ends with the command"
            )
            worst.offer(
                np.where(np.isfinite(values) & self._lasts, values, np.nan),
                time_s=self._time_s[:, column],
                operation=self._end.operation,
                position=self._end.position,
            )
            found.append(worst.found())
        watched_s = self._time_of_last_s - self._end.time_s
        least_s = self._after_s + min(self._window_s, _WATCHED_S)
        return [_if_watched(one, watched_s, least_s) for one in found]


def _enters(before: FloatArray, after: FloatArray, radius: float) -> FloatArray:
    """Return (n,) share of the segment from ``before`` to ``after`` at which it enters a ball.

    The ball is about 0. ``before``, (n, axes), lies outside, ``after`` inside or on it; otherwise
    the result is meaningless.
    """
    step = after - before
    square, half = (step**2).sum(axis=1), (before * step).sum(axis=1)
    beyond = (before**2).sum(axis=1) - radius**2
    root = np.sqrt(np.maximum(half**2 - square * beyond, 0.0))
    # The smaller root, in the form that does not cancel: half is below 0.
    with np.errstate(over="ignore"):  # where the result is meaningless
        share = beyond / np.maximum(root - half, 1e-300)
    return np.asarray(np.clip(share, 0.0, 1.0))


class _Settling:
    """Time from the command's end until the tool stays within ``band`` of the commanded end.

    The distance is at the tool, over all axes. Between two samples the tool moves in a straight
    line, so it enters the band between the last sample outside and the next one. If the tool is
    still outside when the recording ends, it has not settled: the value is infinite.
    """

    def __init__(self, setting: Setting, band_m: float) -> None:
        self._lengths, self._runs = setting.lengths, setting.runs
        self._axes = len(setting.axes)
        self._band_m = band_m
        self._end = CommandEnd()
        self._settled_s: FloatArray = np.full(setting.runs, np.nan)  # NaN: not settled
        self._seen_s = 0.0
        self._outside: FloatArray | None = None  # (runs, axes) the last sample

    def feed(self, block: Block) -> None:
        assert block.actual is not None and block.commanded is not None
        begin_at = begin = self._end.begins_at(block)
        if begin is not None:
            self._settled_s[:] = np.nan
        begin = begin or 0
        actual, time_s = block.actual[begin:], block.time_s[begin:]
        if self._outside is not None and begin_at is None:
            # The segment from the last sample of the previous block to the first sample here.
            actual = np.concatenate([self._outside[None], actual])
            time_s = np.concatenate([[self._seen_s], time_s])
        away = self._lengths(actual - block.commanded[-1], actual)
        outside = np.linalg.norm(away, axis=2) > self._band_m
        self._seen_s, self._outside = float(block.time_s[-1]), block.actual[-1]
        left = outside.any(axis=0)
        last = len(outside) - 1 - outside[::-1].argmax(axis=0)  # the last sample outside
        runs = np.arange(self._runs)
        after = np.minimum(last + 1, len(outside) - 1)
        share = _enters(away[last, runs], away[after, runs], self._band_m)
        inside_s = time_s[last] + share * (time_s[after] - time_s[last])
        inside_s = np.where(last + 1 < len(outside), inside_s, np.nan)
        begun_s = np.where(np.isnan(self._settled_s), time_s[0], self._settled_s)
        self._settled_s = np.where(left, inside_s, begun_s)

    def finish(self) -> Sequence[RunFindings]:
        worst = Worst(self._runs, self._axes, note="the recording ends with the command")
        if self._seen_s > self._end.time_s:
            never = np.isnan(self._settled_s)
            lasted_s = self._seen_s - self._end.time_s
            note = f"not settled {lasted_s:.3g} s after the command"
            worst.offer(
                np.where(never, np.inf, self._settled_s - self._end.time_s),
                time_s=np.where(never, self._seen_s, self._settled_s),
                operation=self._end.operation,
                position=self._end.position,
                note=np.where(never, note, "").astype(object),
            )
        return [_if_watched(worst.found(), self._seen_s - self._end.time_s, _WATCHED_S)]


def start_residual(setting: Setting, options: Mapping[str, float]) -> Measure:
    """Begin measuring the residual vibration."""
    return _Residual(setting, options["after"], options["window"])


def start_settling(setting: Setting, options: Mapping[str, float]) -> Measure:
    """Begin measuring the settling time."""
    return _Settling(setting, options["band"])


OPTIONS = {"over": Option(unit="s", default=0.02)}
_SAME = 1e-6  # relative: two speeds, or two directions
_ARRIVED = 0.5  # of the motion in one sample interval


def _farthest(
    points: FloatArray,
    span: int,
    samples: IntArray,
    set_speed: FloatArray,
    worst: FloatArray,
    at: IntArray,
) -> None:
    """Fill in the largest relative error of the distance over ``span`` samples.

    Parameters
    ----------
    points
        (n + span, axes, runs); point i + span is compared with point i.
    samples
        The indices i to use.
    set_speed
        (n,) expected distance.
    """
    _, axes, runs = points.shape
    squared = np.empty(runs)
    for i in samples:
        squared[:] = 0.0
        for a in range(axes):
            for r in range(runs):
                step = points[i + span, a, r] - points[i, a, r]
                squared[r] += step * step
        for r in range(runs):
            away = abs(np.sqrt(squared[r]) / set_speed[i] - 1.0)
            larger = away > worst[r]
            worst[r] = away if larger else worst[r]
            at[r] = i if larger else at[r]


_farthest_fast = njit(nogil=True)(_farthest)


class _Ripple:
    """Largest relative difference between the tool's speed and the programmed speed.

    The speed is the tool's displacement over ``over``. Samples within the lag of a corner or of a
    change of the set speed are exempt: they belong to two chords. Chords that continue straight at
    the same speed, such as stitches of a seam, count as one. Also exempt: rapid moves, which have
    no set speed; the time after the command has arrived at the end; and holds, with the lag after
    them.
    """

    def __init__(self, setting: Setting, over_s: float) -> None:
        self._radius_m = setting.radius_m
        self._every = enough_of(over_s, setting.interval_s)
        self._interval_s = self._every * setting.interval_s
        self._span = max(round(over_s / self._interval_s), 1)
        self._after = self._span + setting.lag_samples // self._every
        self._slow = -self._after - 1  # last sample of a hold, relative to the next sample
        self._runs = setting.runs
        self._tail: FloatArray = np.empty((0, len(setting.axes), setting.runs))
        self._worst = Worst(
            setting.runs, len(setting.axes), note="no sample is away from every corner"
        )

    def feed(self, block: Block) -> None:
        block = block.every(self._every)
        if not len(block):
            return
        held = self._held(block)
        path, begin, end = block.window()
        points = np.concatenate([self._tail, block.at_tool])
        known = len(self._tail)
        self._tail = points[-self._span :]
        # Sample i of the block is compared with the sample ``span`` before it.
        skipped = max(self._span - known, 0)
        if len(block) <= skipped:
            return
        begin, end = begin[skipped:], end[skipped:]
        set_speed = path.speed_m_s[begin]
        part = _part(path.vertices, path.speed_m_s)
        free = (part[begin] == part[end]) & (set_speed > 0) & ~held[skipped:]
        if path.exhausted and block.commanded is not None:
            # Once the command has arrived, no speed is expected any more.
            left = path.vertices[-1] - block.commanded[skipped:] * self._radius_m
            free &= np.linalg.norm(left, axis=1) > _ARRIVED * set_speed * self._interval_s
        if not free.any():
            return
        ripple, at = np.full(self._runs, -np.inf), np.zeros(self._runs, dtype=np.int64)
        distance = set_speed * (self._span * self._interval_s)
        _farthest_fast(points, self._span, np.flatnonzero(free), distance, ripple, at)
        index = at + skipped
        self._worst.offer(
            ripple,
            time_s=block.time_s[index],
            operation=block.operations_at(index),
            position=block.positions_at(index),
        )

    def _held(self, block: Block) -> NDArray[np.bool_]:
        """Return (n,) whether a hold, or the return to speed after it, was within lag and span."""
        if block.slow is None:
            return np.zeros(len(block), dtype=np.bool_)
        latest = np.where(block.slow, np.arange(len(block)), self._slow)
        latest = np.maximum.accumulate(latest)
        self._slow = int(latest[-1]) - len(block)
        return np.arange(len(block)) - latest <= self._after

    def finish(self) -> Sequence[RunFindings]:
        return [self._worst.found()]


def _part(vertices: FloatArray, speed_m_s: FloatArray) -> IntArray:
    """Return (m,) a number for each chord that changes only at a corner or a new speed."""
    chord = np.diff(vertices, axis=0, prepend=vertices[:1])
    length = np.linalg.norm(chord, axis=1, keepdims=True)
    direction = np.divide(chord, length, out=np.zeros_like(chord), where=length > 0.0)
    turned = np.abs(np.diff(direction, axis=0)).max(axis=1) > _SAME
    faster = np.abs(np.diff(speed_m_s)) > _SAME * np.abs(speed_m_s[1:])
    return np.concatenate([[0], np.cumsum(turned | faster)]).astype(np.int64)


def start_ripple(setting: Setting, options: Mapping[str, float]) -> Measure:
    """Begin measuring the velocity ripple."""
    return _Ripple(setting, options["over"])
