"""Velocity ripple: the speed of the tool against the one that was set."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from threadline.arrays import FloatArray, IntArray
from threadline.compiled import njit
from threadline.verdict.finding import Found, Worst
from threadline.verdict.measure import Measure, Option
from threadline.verdict.samples import Block, Setting, enough_of

OPTIONS = {"over": Option(unit="s", default=0.02)}
_SAME = 1e-6  # relative: two speeds, or two directions
_ARRIVED = 0.5  # of the way in one sample interval


def _farthest(
    points: FloatArray,
    span: int,
    samples: IntArray,
    wanted: FloatArray,
    worst: FloatArray,
    at: IntArray,
) -> None:
    """Fill in the largest relative difference of the way over ``span`` samples from ``wanted``.

    Parameters
    ----------
    points
        (n + span, axes, runs); point i + span against point i.
    samples
        Which i count.
    wanted
        (n,) length of that way.
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
            away = abs(np.sqrt(squared[r]) / wanted[i] - 1.0)
            larger = away > worst[r]
            worst[r] = away if larger else worst[r]
            at[r] = i if larger else at[r]


_farthest_fast = njit(nogil=True)(_farthest)


class _Ripple:
    """Largest relative difference between the tool's speed and the programmed one.

    The speed is that of the tool's displacement over ``over``. Samples within the lag of a corner
    or of a change of the set speed are exempt: they belong to two chords. Chords that follow each
    other straight on at one speed, as the stitches of a seam, are one. So are rapid moves, which
    have no set speed, what comes after the command has arrived at the end, and what lies within a
    hold, or within the lag behind it.
    """

    def __init__(self, setting: Setting, over_s: float) -> None:
        self._radius_m = setting.radius_m
        self._every = enough_of(over_s, setting.interval_s)
        self._interval_s = self._every * setting.interval_s
        self._span = max(round(over_s / self._interval_s), 1)
        self._after = self._span + setting.lag_samples // self._every
        self._slow = -self._after - 1  # the last sample of a hold, counted from the next one
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
        # Sample i of the block against the one `span` before it.
        skipped = max(self._span - known, 0)
        if len(block) <= skipped:
            return
        begin, end = begin[skipped:], end[skipped:]
        wanted = path.speed_m_s[begin]
        part = _part(path.vertices, path.speed_m_s)
        free = (part[begin] == part[end]) & (wanted > 0) & ~held[skipped:]
        if path.ended and block.commanded is not None:
            # Once the command has arrived nothing is wanted of the speed any more.
            left = path.vertices[-1] - block.commanded[skipped:] * self._radius_m
            free &= np.linalg.norm(left, axis=1) > _ARRIVED * wanted * self._interval_s
        if not free.any():
            return
        ripple, at = np.full(self._runs, -np.inf), np.zeros(self._runs, dtype=np.int64)
        way = wanted * (self._span * self._interval_s)
        _farthest_fast(points, self._span, np.flatnonzero(free), way, ripple, at)
        index = at + skipped
        self._worst.offer(
            ripple,
            time_s=block.time_s[index],
            operation=block.operations_at(index),
            position=block.positions_at(index),
        )

    def _held(self, block: Block) -> NDArray[np.bool_]:
        """Return (n,) whether the run was held or came to its speed within lag and span before."""
        if block.slow is None:
            return np.zeros(len(block), dtype=np.bool_)
        latest = np.where(block.slow, np.arange(len(block)), self._slow)
        latest = np.maximum.accumulate(latest)
        self._slow = int(latest[-1]) - len(block)
        return np.arange(len(block)) - latest <= self._after

    def finish(self) -> Sequence[Found]:
        return [self._worst.found()]


def _part(vertices: FloatArray, speed_m_s: FloatArray) -> IntArray:
    """Return (m,) a number for each chord that only differs across a corner or a new speed."""
    chord = np.diff(vertices, axis=0, prepend=vertices[:1])
    length = np.linalg.norm(chord, axis=1, keepdims=True)
    direction = np.divide(chord, length, out=np.zeros_like(chord), where=length > 0.0)
    turned = np.abs(np.diff(direction, axis=0)).max(axis=1) > _SAME
    faster = np.abs(np.diff(speed_m_s)) > _SAME * np.abs(speed_m_s[1:])
    return np.concatenate([[0], np.cumsum(turned | faster)]).astype(np.int64)


def start_ripple(setting: Setting, options: Mapping[str, float]) -> Measure:
    """Begin measuring the velocity ripple."""
    return _Ripple(setting, options["over"])
