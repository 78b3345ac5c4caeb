"""Place in the plan at an instant of a run: the chord of the path, and the time of the plan."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.errors import RecordingError
from threadline.files import Clock, Event
from threadline.verdict.nearest import lengths_squared
from threadline.verdict.window import PathWindow

_SAME_M = 1e-6  # two chords are equally near to a command if their distances differ by less
_SAME_STEP = 1e-9  # of a step: rounding of its component along a chord


def _squared(points: FloatArray, i: int, vertices: FloatArray, chord: int) -> float:
    """Return the squared distance of point ``i`` to a chord."""
    along, length, squared = 0.0, 0.0, 0.0
    for k in range(points.shape[1]):
        direction = vertices[chord, k] - vertices[chord - 1, k]
        along += (points[i, k] - vertices[chord - 1, k]) * direction
        length += direction * direction
    where = 0.0 if length <= 0.0 else min(max(along / length, 0.0), 1.0)
    for k in range(points.shape[1]):
        start = vertices[chord - 1, k]
        gap = points[i, k] - start - where * (vertices[chord, k] - start)
        squared += gap * gap
    return squared


def _along(
    points: FloatArray, before: FloatArray, i: int, vertices: FloatArray, chord: int
) -> float:
    """Return the component along a chord of the step to point ``i``; ``before`` is point -1."""
    along, length = 0.0, 0.0
    for k in range(points.shape[1]):
        direction = vertices[chord, k] - vertices[chord - 1, k]
        along += (points[i, k] - (points[i - 1, k] if i else before[k])) * direction
        length += direction * direction
    return along / np.sqrt(length) if length > 0.0 else 0.0


def _step_m(points: FloatArray, before: FloatArray, i: int) -> float:
    """Return the length of the step to point ``i``; ``before`` is point -1."""
    squared = 0.0
    for k in range(points.shape[1]):
        squared += (points[i, k] - (points[i - 1, k] if i else before[k])) ** 2
    return float(np.sqrt(squared))


_squared_fast = njit(nogil=True)(_squared)
_along_fast = njit(nogil=True)(_along)
_step_m_fast = njit(nogil=True)(_step_m)


def _refine(
    points: FloatArray,
    before: FloatArray,
    vertices: FloatArray,
    first: IntArray,
    last: IntArray,
    same_m: float,
) -> None:
    """Widen the chords ``first`` to ``last`` of each point by a neighbour that matches better.

    Distances that differ by ``same_m`` are equal. Rows are accessed by index: taking a row out of
    an array would count references.
    """
    end = len(vertices) - 1
    for i in range(len(points)):
        low, high = first[i], last[i]
        own, ahead = np.inf, -np.inf
        for c in range(low, high + 1):
            own = min(own, _squared_fast(points, i, vertices, c))
        own = np.sqrt(own)
        for side in range(2):
            other = low - 1 if side == 0 else high + 1
            if other < 1 or other > end:
                continue
            nearer = own - np.sqrt(_squared_fast(points, i, vertices, other))
            if nearer < -same_m:
                continue
            if ahead == -np.inf:  # not computed yet: a neighbour is seldom as near
                for c in range(low, high + 1):
                    if np.sqrt(_squared_fast(points, i, vertices, c)) <= own + same_m:
                        ahead = max(ahead, _along_fast(points, before, i, vertices, c))
                ahead += _SAME_STEP * _step_m_fast(points, before, i)
            if nearer > same_m or _along_fast(points, before, i, vertices, other) > ahead:
                if side == 0:
                    first[i] = other
                else:
                    last[i] = other


_refine_fast = njit(nogil=True)(_refine)


def shares_of(points: FloatArray, chord: IntArray, path: PathWindow) -> FloatArray:
    """Return (n,) shares of the chords at their nearest places to (n, axes) points, at the tool."""
    start = path.vertices[chord - path.first - 1]
    vector = path.vertices[chord - path.first] - start
    length = lengths_squared(vector)
    along = ((points - start) * vector).sum(axis=1) / np.where(length > 0.0, length, 1.0)
    return np.asarray(np.clip(along, 0.0, 1.0))


def chords_under_way(
    path: PathWindow,
    own: tuple[IntArray, IntArray],
    commanded: FloatArray | None,
    before: FloatArray | None,
    resolution_m: float,
) -> tuple[IntArray, IntArray]:
    """Return (n,) first and last chord that each command is on, counted from the path's start.

    These are the chords of its operation, and a neighbour if the command is nearer to it, or
    equally near and moving along it: a blend round a corner has one operation but follows two.
    Commands are whole counts, so chords whose distances differ by less than a count are equally
    near: a command that ends a fraction of a count beyond the last chord of a retraced line is not
    on the chord before.

    Parameters
    ----------
    path
        Window with the operations and their neighbours.
    own
        (n,) first and last chord of the current operation, see ``PathWindow.chords``.
    commanded
        (n, axes) lengths at the tool; None if the command was not recorded.
    before
        (axes,) the previous command; None at the start.
    resolution_m
        Length at the tool of a step of one count in every axis.
    """
    first, last = own[0].copy(), np.maximum(*own)
    if commanded is not None and np.isfinite(commanded).all():
        points = np.ascontiguousarray(commanded)
        before = points[0] if before is None else before
        same_m = max(resolution_m, _SAME_M)
        _refine_fast(points, before, path.vertices, first, last, same_m)
    return first + path.first, last + path.first


_MOST_S = 1e9  # thirty years
_ROUNDING = 1e-9  # of a period: an instant this close to a tick is that tick


class PlanClock:
    """Follows the ``plan`` events of a recording, in bounded memory.

    Without events the plan's time equals the recording's time. After an event it advances with the
    clock, or at the rate that the event names. It stands still if the previous event had the same
    plan time, within ``_ROUNDING`` of a period. It never goes back.

    Parameters
    ----------
    clock
        Clock of the recording.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._slack_s = _ROUNDING * float(clock.period_s)
        self._from_s: FloatArray = np.empty(0)  # time of each event
        self._due_s: FloatArray = np.empty(0)  # plan's time at each event
        self._rate: FloatArray = np.empty(0)  # rate of the plan's time after each event
        self._tick = 0  # of the latest event
        self._gone = 0  # events that were discarded
        self._passed = 0  # events up to the latest requested instant
        self._latest_s = -np.inf  # plan's time at that instant

    def take(self, events: Iterable[Event]) -> None:
        """Take the events of a block, before its instants are requested.

        Raises
        ------
        RecordingError
            If events go back in time, or name a time outside any plan.
        """
        plans = [event for event in events if event.kind == "plan"]
        if not plans:
            return
        for event in plans:
            if event.tick < self._tick or not 0.0 <= event.value <= _MOST_S:
                raise RecordingError(
                    f"an event says that {event.value:.6g} s of the plan were due at "
                    f"{self._clock.time_s(event.tick):.6g} s",
                    remedy="Events follow each other in time, and a plan begins at 0 s; record it "
                    "again.",
                )
            self._tick = event.tick
        named = np.array([_rate_of(event) for event in plans])
        due = np.array([event.value for event in plans])
        before = np.append(self._due_s[-1:] if len(self._due_s) else [np.nan], due[:-1])
        times = np.array([self._clock.time_s(event.tick) for event in plans])
        self._from_s = np.concatenate([self._from_s, times])
        self._due_s = np.concatenate([self._due_s, due])
        stands = np.abs(due - before) <= self._slack_s
        self._rate = np.concatenate([self._rate, np.where(stands, 0.0, named)])

    def at(self, time_s: FloatArray) -> tuple[FloatArray, NDArray[np.bool_] | None]:
        """Return the plan's time at (n,) ascending instants, later than in earlier calls.

        Returns
        -------
        tuple
            (n,) times of the plan, s; and (n,) whether the plan's time advanced less than the clock
            since the previous instant. Without any event yet: the instants themselves, and None.
        """
        if not len(self._from_s) or not len(time_s):
            return time_s, None
        known = np.searchsorted(self._from_s, time_s + self._slack_s, side="right")
        last = np.maximum(known - 1, 0)
        behind_s = self._due_s[last] + self._rate[last] * (time_s - self._from_s[last])
        due_s = np.where(known + self._gone > 0, behind_s, time_s)
        due_s = np.maximum(np.maximum.accumulate(due_s), self._latest_s)
        number = known + self._gone
        moved = np.diff(number, prepend=self._passed) > 0
        slow = moved | ((number > 0) & (self._rate[last] < 1.0))
        self._passed, self._latest_s = int(number[-1]), float(due_s[-1])
        done = max(int(known[-1]) - 1, 0)
        self._gone += done
        self._from_s, self._due_s = self._from_s[done:], self._due_s[done:]
        self._rate = self._rate[done:]
        return due_s, slow


def _rate_of(event: Event) -> float:
    """Return the rate at which the plan's time advances after an event that does not stop it.

    Raises
    ------
    RecordingError
        If the name of the event is not a rate from 0 to 1.
    """
    if not event.name:
        return 1.0
    try:
        rate = float(event.name)
    except ValueError:
        rate = np.nan
    if not 0.0 < rate <= 1.0:
        raise RecordingError(
            f"an event says that the plan goes on at the rate {event.name[:20]!r}",
            remedy="A run plays at most one row of its plan per tick: a rate is above 0 and at "
            "most 1; record it again.",
        )
    return rate
