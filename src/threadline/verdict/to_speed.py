"""Stitches that the head needs to reach its speed, and to stop from its speed, leg by leg.

The stitcher thesis asks that the head accelerates to its speed, and decelerates from it, within two
stitches. Both counts end when the head has 95 % of the set speed. They differ in their beginning
(for a stop, read in reversed time, in their end):

- ``stitches_to_speed`` begins with the first movement of the command along the new leg. If the plan
  swings back before it departs, the count begins with the swing, not with the last rest.
- ``stitches_from_needle`` begins with the first needle-down of the leg.

Fractions of a turn count. The first movement is dated by the levels from 0.5 to 1.5 % of the set
speed: the mean of the instants at which the command first passes each level. So a swing that grows
from below 1 % to above it changes the count gradually.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray, IntArray
from threadline.verdict.finding import Finding, RunFindings
from threadline.verdict.legs import STILL, TURNS, Dip, Instant, Past, Rows
from threadline.verdict.measure import Measure, Option
from threadline.verdict.needle import Stitches, has_stitches, planned_stitches
from threadline.verdict.samples import Block, Setting, enough_of, lanes
from threadline.verdict.sewn import PART_OF_STITCH

OPTIONS = {"over": Option(unit="s", default=0.002)}
NEEDLE_OPTIONS = {"delay": Option(unit="s", default=0.0), **OPTIONS}
_HIGH = 0.95  # of the set speed
_MOVES = 0.02  # of the highest speed of a following needle: a slower head rests
_WINDOW_TURNS = 2.0 * TURNS + 8.0


class _Head:
    """Instants at which the head of one run reached 95 % of its speed, and fell below it."""

    def __init__(self) -> None:
        self._due_s: list[float] = []
        self._ups: list[tuple[bool, Instant]] = []
        self.worst: Finding | None = None

    def take(self, due_s: float, up: bool, at: Instant) -> None:
        """Add a passage of 95 %, upward or downward, and the sample after it."""
        self._due_s.append(due_s)
        self._ups.append((up, at))

    def drop(self, before_s: float) -> None:
        """Discard passages before an instant, except the last."""
        first = max(bisect_right(self._due_s, before_s) - 1, 0)
        del self._due_s[:first], self._ups[:first]

    def left(self, stop_s: float) -> float | None:
        """Return when the head last had its speed before an instant; None if it never had."""
        at = bisect_right(self._due_s, stop_s) - 1
        if at < 0:
            return None
        return stop_s if self._ups[at][0] else self._due_s[at]

    def came(self, dip: Dip, until_s: float) -> tuple[float, Instant] | None:
        """Return when the head first has its speed after a dip, before ``until_s``."""
        assert dip.rise is not None
        rise_s = dip.rise.due_s
        at = bisect_right(self._due_s, rise_s) - 1
        if at >= 0 and self._ups[at][0]:
            # The head had its speed before the command; a trailing head may still have the old one.
            found = self._due_s[at] > dip.turn.due_s
            return (self._due_s[at], self._ups[at][1]) if found else (rise_s, dip.rise)
        if at + 1 < len(self._due_s) and self._due_s[at + 1] <= until_s:
            return self._due_s[at + 1], self._ups[at + 1][1]
        return None

    def count(self, value: float, at: Instant, note: str, over: float) -> None:
        """Keep a count if it is the largest; ``over``: by how much it may be too large."""
        if self.worst is None or self.worst.value is None or value > self.worst.value:
            self.worst = Finding(
                value=value,
                time_s=at.time_s,
                operation=at.operation,
                position=at.position,
                note=note,
                over=over,
            )


class _ToSpeed:
    """The longest time to reach the speed, or to stop from it, in turns of the needle.

    If the needle follows the head, the set speed is the commanded speed of the head at that
    instant. Stitches sewn in a hold, or while the head regains its speed after a hold, do not
    count. Times are times of the plan, which stands still in a hold.

    Speeds are means over ``over``, or over ``PART_OF_STITCH`` of the shortest first stitch if that
    is less: a mean over more than a dip would hide the dip.
    """

    def __init__(self, setting: Setting, over_s: float, delay_s: float | None) -> None:
        self._columns = [setting.axes.index(axis) for axis in setting.plan.job.axes]
        self._radius_m = setting.radius_m[self._columns, None]
        self._count_m = setting.resolution[self._columns] * setting.radius_m[self._columns]
        planned = setting.plan.motion.of_loads is not None
        self._delay_s = 0.0 if planned or delay_s is None else delay_s
        self._of_needle = delay_s is not None
        self._source: Iterator[Stitches] = (
            planned_stitches(setting.plan) if has_stitches(setting.plan.job) else iter(())
        )
        self._run: Stitches | None = next(self._source, None)
        self._last: Stitches | None = None  # once all have passed
        self._number = 0  # of the first stitch of ``_run``
        if self._run is not None:
            least_s = float(np.fmin.reduce(self._run.period_s, initial=np.inf))
            over_s = min(over_s, PART_OF_STITCH * least_s)
        self._every = enough_of(over_s, setting.interval_s)
        interval_s = self._every * setting.interval_s
        self._span = max(round(over_s / interval_s), 1)
        self._over_s = self._span * interval_s
        # Coarser means date a start too early and a speed too late, each by less than a mean.
        coarse = self._over_s > over_s and setting.coarse
        self._late_s = 2.0 * self._over_s if coarse else 0.0
        self._sews = self._run is not None
        self._turn_s = 0.0  # the longest turn of the needle so far
        self._tail: list[FloatArray] = []
        self._past, self._dips = Past(), list[Dip]()
        self._heads = [_Head() for _ in range(setting.runs)]
        self._before: tuple[float, FloatArray] | None = None  # last sample of the heads

    def feed(self, block: Block) -> None:
        block = block.every(self._every)
        assert block.actual is not None
        rests = block.rests
        if rests is None or not self._sews or not len(block):
            return
        assert block.commanded is not None
        # ``rests`` holds positions to a count, which would turn a slow movement into steps.
        taken = (rests[:, :, None], block.commanded[:, :, None], lanes(block.actual))
        points = [p[:, self._columns] * self._radius_m for p in taken]
        tails = self._tail or [np.repeat(p[:1], self._span, axis=0) for p in points]
        whole = [np.concatenate([tail, p]) for tail, p in zip(tails, points, strict=True)]
        self._tail = [p[-self._span :] for p in whole]
        speeds = [(p[self._span :] - p[: -self._span]) / self._over_s for p in whole]
        rows, set_speed, period_s, follows, sewn = self._set(block.due_s, speeds[1][:, :, 0])
        meant, actual = (np.linalg.norm(v, axis=1) for v in speeds[::2])
        going = np.ones(len(block), dtype=np.bool_)
        if block.slow is not None:  # a hold is the operator's choice
            going = ~block.slow
        kept = (rows.stitch >= 0) & going
        if kept.any():
            self._past.add(rows.rows(kept))
        # For a following needle the set speed is the commanded speed, while it moves at all.
        geared = np.maximum(meant[:, 0], _MOVES * set_speed)
        set_speed = np.where(follows, geared, set_speed)
        at = np.flatnonzero(sewn & going)
        if len(at):
            self._turn_s = max(self._turn_s, float(period_s[at].max()))
            self._take_heads(block, at, actual[at] / set_speed[at, None])
            self._take_command(block, at, meant[at, 0] / set_speed[at], period_s[at], follows[at])
        self._resolve(final=False)

    def finish(self) -> Sequence[RunFindings]:
        self._resolve(final=True)
        note = "no leg of the seam comes to its speed" if self._sews else "the job has no stitches"
        none = Finding(value=None, note=note)
        return [RunFindings.made([head.worst or none for head in self._heads])]

    def _set(
        self, due_s: FloatArray, velocity: FloatArray
    ) -> tuple[Rows, FloatArray, FloatArray, NDArray[np.bool_], NDArray[np.bool_]]:
        """Return the stitches of (n,) instants of the plan.

        Returns
        -------
        tuple
            The samples with their stitches, -1 where there is none; (n,) set speed, duration of the
            needle's turn, whether the needle follows, and whether it sews. For a following needle
            the set speed is its highest.
        """
        count, width = velocity.shape
        set_speed, period_s = np.ones(count), np.ones(count)
        follows = np.zeros(count, dtype=np.bool_)
        known = np.zeros(count, dtype=np.bool_)
        along, contour = np.zeros((count, width)), np.zeros(count, dtype=np.int64)
        number, first = np.full(count, -1), np.zeros(count, dtype=np.bool_)
        needle_s, down_s, rest_s = (np.full(count, -np.inf) for _ in range(3))

        def fill(run: Stitches, mine: NDArray[np.bool_], stitch: IntArray) -> None:
            speed = np.where(run.follows, run.fastest_hz, 1.0 / run.period_s)
            set_speed[mine] = (run.target_m * speed)[stitch]
            follows[mine] = run.follows[stitch]
            period_s[mine] = run.period_s[stitch]
            step = run.point - run.from_point
            step_m = np.linalg.norm(step, axis=1, keepdims=True)
            along[mine] = (step / np.where(step_m > 0.0, step_m, 1.0))[stitch]
            contour[mine], number[mine] = run.contour[stitch], self._number + stitch
            down_s[mine] = run.down_s[stitch]
            needle_s[mine] = (run.down_s - run.period_s)[stitch]
            first[mine] = run.first[stitch]
            rested = run.first & (self._number + np.arange(len(run)) > 0)
            rest_s[mine] = np.where(rested, run.from_s, -np.inf)[stitch]

        while self._run is not None:
            run = self._run
            mine = ~known & (due_s <= run.down_s[-1])
            if not mine.any():
                break
            fill(run, mine, np.searchsorted(run.down_s, due_s[mine], side="left"))
            known |= mine
            if due_s[-1] <= run.down_s[-1]:
                break
            self._last, self._number = run, self._number + len(run)
            self._run = next(self._source, None)
        sewn = known & np.isfinite(period_s)
        if self._run is None and self._last is not None:
            # Oscillation after a stop continues after the last needle-down.
            run, self._number = self._last, self._number - len(self._last)
            behind = ~known & (due_s <= run.down_s[-1] + TURNS * run.period_s[-1])
            fill(run, behind, np.full(int(behind.sum()), len(run) - 1))
            self._number += len(run)
        rows = Rows(
            due_s=np.asarray(due_s),
            velocity=velocity / set_speed[:, None],
            grain=self._count_m / self._over_s / set_speed[:, None],
            along=along,
            stitch=number,
            contour=contour,
            needle_s=needle_s,
            down_s=down_s,
            first=first,
            rest_s=rest_s,
        )
        return rows, set_speed, period_s, follows, sewn

    def _take_heads(self, block: Block, at: IntArray, actual: FloatArray) -> None:
        """Find where (n, runs) relative speeds of the heads pass 95 %."""
        due_s = block.due_s[at]
        if self._before is None:
            for run in np.flatnonzero(actual[0] >= _HIGH).tolist():
                self._heads[run].take(float(due_s[0]), True, _instant(block, int(at[0])))
            times, speeds = due_s, actual
            offset = 0
        else:
            times = np.append(self._before[0], due_s)
            speeds = np.concatenate([self._before[1], actual])
            offset = 1
        self._before = float(due_s[-1]), actual[-1:]
        fast = speeds >= _HIGH
        for k, run in zip(*np.nonzero(fast[1:] != fast[:-1]), strict=True):
            low, high = speeds[k, run], speeds[k + 1, run]
            part = (_HIGH - low) / (high - low)
            when_s = float(times[k] + part * (times[k + 1] - times[k]))
            after = _instant(block, int(at[k + 1 - offset]))
            self._heads[int(run)].take(when_s, bool(fast[k + 1, run]), after)

    def _take_command(
        self,
        block: Block,
        at: IntArray,
        meant: FloatArray,
        period_s: FloatArray,
        follows: NDArray[np.bool_],
    ) -> None:
        """Follow the command through stretches at its speed and below it."""
        low = meant < _HIGH
        edges = np.flatnonzero(np.diff(low)) + 1
        for part in np.split(np.arange(len(at)), edges):
            instant = partial(_instant, block)
            dip = self._dips[-1] if self._dips and self._dips[-1].rise is None else None
            if not low[part[0]]:
                if dip is not None:
                    dip.rise = instant(int(at[part[0]]))
                    dip.rise_period_s = float(period_s[part[0]])
                continue
            speeds = meant[part]
            still = np.flatnonzero(speeds <= STILL)
            least = int(np.argmin(speeds))
            begins, ends = (int(still[0]), int(still[-1])) if len(still) else (least, least)
            if dip is None:
                dip = Dip(
                    begin_s=float(block.due_s[at[part[0]]]),
                    least=np.inf,
                    stop=instant(int(at[part[0]])),
                    turn=instant(int(at[part[0]])),
                    period_s=float(period_s[part[0]]),
                )
                self._dips.append(dip)
            if dip.least > STILL and speeds[least] < dip.least:
                dip.stop = instant(int(at[part[begins]]))
                dip.turn, dip.least = instant(int(at[part[ends]])), float(speeds[least])
            elif len(still):
                dip.turn = instant(int(at[part[ends]]))
            if follows[part].all():
                dip.geared = True

    def _resolve(self, *, final: bool) -> None:
        """Count the stops and starts for which all samples have been seen."""
        end_s = np.inf if final else self._past.end_s
        for k, dip in enumerate(self._dips):
            ended = dip.rise is not None or dip.least <= STILL
            turn_s = max(dip.period_s, dip.rise_period_s) if dip.rise else dip.period_s
            seen_s = (dip.rise or dip.stop).due_s + (TURNS + 2.0) * turn_s
            if not dip.stopped and (final or (ended and end_s >= seen_s)):
                self._stopped(dip)
            if dip.rise is None or dip.started or not dip.stopped:
                continue
            rises = (d.rise.due_s for d in self._dips[k + 1 :] if d.rise is not None)
            until_s = next(rises, np.inf)
            came = [head.came(dip, until_s) for head in self._heads]
            if final or until_s < np.inf or None not in came:
                self._started(dip, came)
        self._dips = [dip for dip in self._dips if not (dip.stopped and dip.started)]
        oldest_s = self._past.end_s
        for dip in self._dips:
            # Once the stop before a rest is counted, only the end of the rest matters.
            if not dip.stopped or dip.rise is not None:
                oldest_s = min(oldest_s, dip.begin_s)
        keep_s = oldest_s - _WINDOW_TURNS * self._turn_s
        self._past.drop(keep_s)
        for head in self._heads:
            head.drop(keep_s)

    def _stopped(self, dip: Dip) -> None:
        """Count from the last 95 % speed of each head to the stop of the command."""
        dip.stopped = True
        gone_s, needle_s = self._past.stop(dip)
        note = _STOPS[0] if np.isnan(needle_s) else _STOPS[1]
        if self._of_needle:
            gone_s, note = needle_s + self._delay_s, _STOPS[2]
        for head in self._heads:
            left_s = head.left(dip.stop.due_s)
            if left_s is not None and not np.isnan(gone_s):
                turns = max(gone_s - left_s, 0.0) / dip.period_s
                head.count(turns, dip.stop, note, self._late_s / dip.period_s)

    def _started(self, dip: Dip, came: Sequence[tuple[float, Instant] | None]) -> None:
        """Count from the start of the command until each head has its speed."""
        dip.started = True
        moved_s, needle_s = self._past.start(dip)
        note = _STARTS[0] if np.isnan(needle_s) else _STARTS[1]
        if self._of_needle:
            moved_s, note = needle_s + self._delay_s, _STARTS[2]
        for head, there in zip(self._heads, came, strict=True):
            if there is not None and not np.isnan(moved_s):
                turns = max(there[0] - moved_s, 0.0) / dip.rise_period_s
                head.count(turns, there[1], note, self._late_s / dip.rise_period_s)


_STARTS = ("from where it is slowest", "from the first movement", "from the first needle-down")
_STOPS = ("to where it is slowest", "to the last movement", "to the last needle-down")


def _instant(block: Block, index: int) -> Instant:
    return Instant(
        due_s=float(block.due_s[index]),
        time_s=float(block.time_s[index]),
        operation=None if block.operation is None else int(block.operation[index]),
        position=_position(block, index),
    )


def _position(block: Block, index: int) -> tuple[float, ...] | None:
    assert block.commanded is not None
    position = block.commanded[index]
    return tuple(position.tolist()) if np.isfinite(position).all() else None


def start_to_speed(setting: Setting, options: Mapping[str, float]) -> Measure:
    """Begin measuring the turns from the first movement of a leg until the head has its speed."""
    return _ToSpeed(setting, options["over"], None)


def start_from_needle(setting: Setting, options: Mapping[str, float]) -> Measure:
    """Begin measuring the turns from the first needle-down of a leg to the head's speed."""
    return _ToSpeed(setting, options["over"], options["delay"])
