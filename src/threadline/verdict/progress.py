"""Where in the plan an instant of a run is: the chord of the path, and the time of the plan."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.errors import RecordingError
from threadline.files import Clock, Event
from threadline.verdict.window import PathWindow

_SAME_M = 1e-6  # two chords nearer to the command than this to each other are the same line there


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
    """Return the part of the way to point ``i`` that is along a chord; ``before`` is point -1."""
    along, length = 0.0, 0.0
    for k in range(points.shape[1]):
        direction = vertices[chord, k] - vertices[chord - 1, k]
        along += (points[i, k] - (points[i - 1, k] if i else before[k])) * direction
        length += direction * direction
    return along / np.sqrt(length) if length > 0.0 else 0.0


_squared_fast = njit(nogil=True)(_squared)
_along_fast = njit(nogil=True)(_along)


def _refine(
    points: FloatArray,
    before: FloatArray,
    vertices: FloatArray,
    first: IntArray,
    last: IntArray,
    same_m: float,
) -> None:
    """Widen the chords ``first`` to ``last`` of each point by a neighbour that it is really on.

    Rows are indexed through: to take one out of an array would count references.
    """
    end = len(vertices) - 1
    for i in range(len(points)):
        low, high = first[i], last[i]
        own, chord = np.inf, low
        for c in range(low, high + 1):
            squared = _squared_fast(points, i, vertices, c)
            if squared < own:
                own, chord = squared, c
        own = np.sqrt(own)
        ahead = _along_fast(points, before, i, vertices, chord)
        for side in range(2):
            other = low - 1 if side == 0 else high + 1
            if other < 1 or other > end:
                continue
            nearer = own - np.sqrt(_squared_fast(points, i, vertices, other))
            if nearer > same_m or (
                nearer >= -same_m and _along_fast(points, before, i, vertices, other) > ahead
            ):
                if side == 0:
                    first[i] = other
                else:
                    last[i] = other


_refine_fast = njit(nogil=True)(_refine)


def chords_under_way(
    path: PathWindow,
    own: tuple[IntArray, IntArray],
    commanded: FloatArray | None,
    before: FloatArray | None,
) -> tuple[IntArray, IntArray]:
    """Return (n,) first and last chord that each command is on, counted from the path's start.

    The chords of its operation, and the one before or after them where the command is nearer to
    that one, or as near and moving along it: a blend round a corner is labelled with one
    operation although it follows two.

    Parameters
    ----------
    path
        Holds the operations and their neighbours.
    own
        (n,) first and last chord of the operation under way, see ``PathWindow.chords``.
    commanded
        (n, axes) lengths at the tool, or None where the command was not recorded.
    before
        (axes,) the command before these, None at the start.
    """
    first, last = own[0].copy(), np.maximum(*own)
    if commanded is not None and np.isfinite(commanded).all():
        points = np.ascontiguousarray(commanded)
        before = points[0] if before is None else before
        _refine_fast(points, before, path.vertices, first, last, _SAME_M)
    return first + path.first, last + path.first


_MOST_S = 1e9  # thirty years
_ROUNDING = 1e-9  # of a period: an instant that is a tick but for a rounding is that tick


class PlanClock:
    """Follows the events ``plan`` of a recording, in bounded memory.

    Without any the plan's time is that of the recording. Behind an event it goes on with the
    clock, or stands where the event before it has the same time but for ``_ROUNDING`` of a period.
    It never goes back.

    Parameters
    ----------
    clock
        Of the recording.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._slack_s = _ROUNDING * float(clock.period_s)
        self._from_s: FloatArray = np.empty(0)  # when each event was
        self._due_s: FloatArray = np.empty(0)  # and what was due then
        self._rate: FloatArray = np.empty(0)  # at which the plan goes on behind it
        self._tick = 0  # of the latest event
        self._gone = 0  # events that were let go of
        self._passed = 0  # events up to the instant that was asked for last
        self._latest_s = -np.inf  # plan's time then

    def take(self, events: Iterable[Event]) -> None:
        """Take the events of a block, before its instants are asked for.

        Raises
        ------
        RecordingError
            If they go back, or tell a time that no plan has.
        """
        told = [event for event in events if event.kind == "plan"]
        if not told:
            return
        for event in told:
            if event.tick < self._tick or not 0.0 <= event.value <= _MOST_S:
                raise RecordingError(
                    f"an event tells that {event.value:.6g} s of the plan were due at "
                    f"{self._clock.time_s(event.tick):.6g} s",
                    remedy="Events follow each other in time, and a plan begins at 0 s; record it "
                    "again.",
                )
            self._tick = event.tick
        due = np.array([event.value for event in told])
        before = np.append(self._due_s[-1:] if len(self._due_s) else [np.nan], due[:-1])
        times = np.array([self._clock.time_s(event.tick) for event in told])
        self._from_s = np.concatenate([self._from_s, times])
        self._due_s = np.concatenate([self._due_s, due])
        stands = np.abs(due - before) <= self._slack_s
        self._rate = np.concatenate([self._rate, np.where(stands, 0.0, 1.0)])

    def at(self, time_s: FloatArray) -> tuple[FloatArray, NDArray[np.bool_] | None]:
        """Return what was due at (n,) rising instants, later than those asked for before.

        Returns
        -------
        tuple
            (n,) times of the plan, s; and (n,) whether less than the time from the instant before
            was due since then. The instants themselves and None where no event has come yet.
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
        slow = moved | ((number > 0) & (self._rate[last] == 0.0))
        self._passed, self._latest_s = int(number[-1]), float(due_s[-1])
        done = max(int(known[-1]) - 1, 0)
        self._gone += done
        self._from_s, self._due_s = self._from_s[done:], self._due_s[done:]
        self._rate = self._rate[done:]
        return due_s, slow
