"""What the load does once the command has ended: residual vibration and settling time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from threadline.arrays import FloatArray
from threadline.verdict.finding import Found, Worst
from threadline.verdict.measure import Measure, Option
from threadline.verdict.samples import Block, Setting

RESIDUAL_OPTIONS = {"after": Option(unit="s", default=0.0), "window": Option(unit="s", default=1.0)}
SETTLING_OPTIONS = {"band": Option(unit="m", default=1e-4)}


class CommandEnd:
    """Finds the instant at which the command changes for the last time, block by block.

    A change below the resolution of the command is none: see ``Steady``.
    """

    def __init__(self) -> None:
        self._last: FloatArray | None = None
        self.time_s = 0.0
        self.operation: int | None = None
        self.position: FloatArray | None = None

    def begins_at(self, block: Block) -> int | None:
        """Return the sample of the block with which the standstill begins anew, if there is one."""
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
    """Return the last of (n, axes) commands that is not the one before it, if there is one."""
    if len(commanded) > 1 and (commanded[-1] != commanded[-2]).any():  # it is under way
        return len(commanded) - 1
    changed = np.flatnonzero((commanded[1:] != commanded[:-1]).any(axis=1))
    if len(changed):
        return int(changed[-1]) + 1
    return 0 if before is not None and (commanded[0] != before).any() else None


class _Residual:
    """Per axis: half the peak-to-peak of the load after the command's end; length at the tool.

    From ``after`` the end of the command, for ``window``. With ``after`` 0 the way that the load
    still has to go counts too.
    """

    def __init__(self, setting: Setting, after_s: float, window_s: float) -> None:
        self._axes, self._runs = setting.axes, setting.runs
        self._lengths = setting.lengths
        self._after_s, self._window_s = after_s, window_s
        self._end = CommandEnd()
        self._clear()

    def _clear(self) -> None:
        shape = self._runs, len(self._axes)
        self._low, self._high = np.full(shape, np.inf), np.full(shape, -np.inf)
        self._time_s = np.zeros(shape)

    def feed(self, block: Block) -> None:
        assert block.actual is not None
        begin = self._end.begins_at(block)
        if begin is not None:
            self._clear()
        if block.time_s[-1] <= self._end.time_s:
            return
        since = block.time_s - self._end.time_s
        after = self._after_s
        # At the first instant the command has just arrived: only later samples show the load
        # ringing.
        inside = (since > 0) & (since >= after) & (since <= after + self._window_s)
        if not inside.any():
            return
        part, time_s = block.actual[inside], block.time_s[inside]
        low, high = part.min(axis=0), part.max(axis=0)
        # The instant at which the whole swing has been seen, wherever blocks begin.
        for grown, far in (
            (low < self._low, part.argmin(axis=0)),
            (high > self._high, part.argmax(axis=0)),
        ):
            self._time_s = np.where(grown, np.maximum(time_s[far], self._time_s), self._time_s)
        self._low, self._high = np.minimum(self._low, low), np.maximum(self._high, high)

    def finish(self) -> Sequence[Found]:
        found = []
        swing = self._lengths((self._high - self._low) / 2, self._low)
        for column, axis in enumerate(self._axes):
            values = swing[:, column]
            worst = Worst(
                self._runs, len(self._axes), axis, note="the recording ends with the command"
            )
            worst.offer(
                np.where(np.isfinite(values), values, np.nan),
                time_s=self._time_s[:, column],
                operation=self._end.operation,
                position=self._end.position,
            )
            found.append(worst.found())
        return found


class _Settling:
    """Time from the command's end until the tool stays within ``band`` of the commanded end.

    The distance is at the tool, over all axes. A tool that is still outside when the recording
    ends has not settled: the value is infinite.
    """

    def __init__(self, setting: Setting, band_m: float) -> None:
        self._lengths, self._runs = setting.lengths, setting.runs
        self._axes = len(setting.axes)
        self._band_m = band_m
        self._end = CommandEnd()
        self._settled_s: FloatArray = np.full(setting.runs, np.nan)  # of those that have
        self._seen_s = 0.0

    def feed(self, block: Block) -> None:
        assert block.actual is not None and block.commanded is not None
        begin = self._end.begins_at(block)
        if begin is not None:
            self._settled_s[:] = np.nan
        begin = begin or 0
        away = self._lengths(block.actual[begin:] - block.commanded[-1], block.actual[begin:])
        outside = np.linalg.norm(away, axis=2) > self._band_m
        self._seen_s = float(block.time_s[-1])
        left = outside.any(axis=0)
        # The sample after the last one outside, beyond the block where that is its last.
        inside = len(block) - outside[::-1].argmax(axis=0)
        after_s = np.append(block.time_s, np.nan)[inside]
        begun_s = np.where(np.isnan(self._settled_s), block.time_s[begin], self._settled_s)
        self._settled_s = np.where(left, after_s, begun_s)

    def finish(self) -> Sequence[Found]:
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
        return [worst.found()]


def start_residual(setting: Setting, options: Mapping[str, float]) -> Measure:
    """Begin measuring the residual vibration."""
    return _Residual(setting, options["after"], options["window"])


def start_settling(setting: Setting, options: Mapping[str, float]) -> Measure:
    """Begin measuring the settling time."""
    return _Settling(setting, options["band"])
