"""What the load does once the command has ended: residual vibration and settling time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from threadline.arrays import FloatArray
from threadline.verdict.measure import Finding, Measure, Option
from threadline.verdict.samples import Block, Setting

RESIDUAL_OPTIONS = {"after": Option(unit="s", default=0.0), "window": Option(unit="s", default=1.0)}
SETTLING_OPTIONS = {"band": Option(unit="m", default=1e-4)}


class CommandEnd:
    """Finds the instant at which the command changes for the last time, block by block."""

    def __init__(self) -> None:
        self._last: FloatArray | None = None
        self.time_s = 0.0
        self.operation: int | None = None
        self.position: tuple[float, ...] | None = None

    def begins_at(self, block: Block) -> int | None:
        """Return the sample of the block with which the standstill begins anew, if there is one."""
        commanded = block.commanded
        assert commanded is not None
        before = commanded[:1] if self._last is None else self._last[None]
        changed = (np.diff(commanded, axis=0, prepend=before) != 0).any(axis=1)
        at = np.flatnonzero(changed)
        fresh = self._last is None
        self._last = commanded[-1]
        if not len(at) and not fresh:
            return None
        index = int(at[-1]) if len(at) else 0
        self.time_s = float(block.time_s[index])
        self.operation = block.operation_at(index)
        self.position = block.position_at(index)
        return index


class _Residual:
    """Per axis: half the peak-to-peak of the load after the command's end; length at the tool.

    From ``after`` the end of the command, for ``window``. With ``after`` 0 the way that the load
    still has to go counts too.
    """

    def __init__(self, setting: Setting, after_s: float, window_s: float) -> None:
        self._axes = setting.axes
        self._radius_m = setting.radius_m
        self._after_s, self._window_s = after_s, window_s
        self._end = CommandEnd()
        self._clear()

    def _clear(self) -> None:
        self._low = np.full(len(self._axes), np.inf)
        self._high = np.full(len(self._axes), -np.inf)
        self._time_s = np.zeros(len(self._axes))

    def feed(self, block: Block) -> None:
        assert block.actual is not None
        begin = self._end.begins_at(block)
        if begin is not None:
            self._clear()
        since = block.time_s - self._end.time_s
        after = self._after_s
        # The first sample is where the command arrived: the load must be seen after it.
        inside = (since > 0) & (since >= after) & (since <= after + self._window_s)
        if not inside.any():
            return
        part, time_s = block.actual[inside], block.time_s[inside]
        low, high = part.min(axis=0), part.max(axis=0)
        grown = (low < self._low) | (high > self._high)
        far = np.where(high > self._high, part.argmax(axis=0), part.argmin(axis=0))
        self._time_s = np.where(grown, time_s[far], self._time_s)
        self._low, self._high = np.minimum(self._low, low), np.maximum(self._high, high)

    def finish(self) -> Sequence[Finding]:
        findings = []
        for column, axis in enumerate(self._axes):
            swing = float(self._high[column] - self._low[column]) / 2 * self._radius_m[column]
            if not np.isfinite(swing):
                note = "the recording ends with the command"
                findings.append(Finding(value=None, axis=axis, note=note))
                continue
            findings.append(
                Finding(
                    value=float(swing),
                    axis=axis,
                    time_s=float(self._time_s[column]),
                    operation=self._end.operation,
                    position=self._end.position,
                )
            )
        return findings


class _Settling:
    """Time from the command's end until the tool stays within ``band`` of the commanded end.

    The distance is at the tool, over all axes. A tool that is still outside when the recording
    ends has not settled: the value is infinite.
    """

    def __init__(self, setting: Setting, band_m: float) -> None:
        self._radius_m = setting.radius_m
        self._band_m = band_m
        self._end = CommandEnd()
        self._settled_s: float | None = None
        self._seen_s = 0.0

    def feed(self, block: Block) -> None:
        assert block.actual is not None and block.commanded is not None
        begin = self._end.begins_at(block)
        if begin is not None:
            self._settled_s = None
        begin = begin or 0
        away = (block.actual[begin:] - block.commanded[-1]) * self._radius_m
        outside = np.flatnonzero(np.linalg.norm(away, axis=1) > self._band_m)
        self._seen_s = float(block.time_s[-1])
        if not len(outside):
            if self._settled_s is None:
                self._settled_s = float(block.time_s[begin])
            return
        inside = begin + int(outside[-1]) + 1
        self._settled_s = float(block.time_s[inside]) if inside < len(block) else None

    def finish(self) -> Sequence[Finding]:
        if self._seen_s <= self._end.time_s:
            return [Finding(value=None, note="the recording ends with the command")]
        if self._settled_s is None:
            note = f"not settled {self._seen_s - self._end.time_s:.3g} s after the command"
            value, time_s = float("inf"), self._seen_s
        else:
            note, value, time_s = "", self._settled_s - self._end.time_s, self._settled_s
        return [
            Finding(
                value=value,
                time_s=time_s,
                operation=self._end.operation,
                position=self._end.position,
                note=note,
            )
        ]


def start_residual(setting: Setting, options: Mapping[str, float]) -> Measure:
    """Begin measuring the residual vibration."""
    return _Residual(setting, options["after"], options["window"])


def start_settling(setting: Setting, options: Mapping[str, float]) -> Measure:
    """Begin measuring the settling time."""
    return _Settling(setting, options["band"])
