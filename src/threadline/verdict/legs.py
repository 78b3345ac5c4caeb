"""Where a leg begins and ends: the first and the last movement of the command along it.

A movement is dated by its speed levels from 0.5 to 1.5 % of the set speed: the mean of the instants
at which the command passes each level.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray, IntArray

STILL = 0.01  # of the set speed
_FAINT, _MOVED = 0.005, 0.01  # of the set speed: lowest level of a movement, and their range
TURNS = 6.0  # of the needle, before and after a corner, in which a movement is searched
_STRAIGHT = 1.0 - 1e-6  # cosine between two stitches on one straight line
_CORNER = 0.985  # cosine of 10 degrees: a line that turns by less has no corner


class Instant(NamedTuple):
    """A sample: the plan's time, the recording's time, the operation and the commanded position."""

    due_s: float
    time_s: float
    operation: int | None
    position: tuple[float, ...] | None


@dataclass(slots=True)
class Dip:
    """A stretch in which the command is below its speed.

    Parameters
    ----------
    begin_s
        Plan's time at which it begins.
    least
        Lowest speed, as a share of the set speed.
    stop, turn
        First and last instant at which the command rests, or its slowest instant.
    period_s
        Duration of the needle's turn where the stretch begins.
    rise_period_s
        Duration of the needle's turn where the command is back at its speed.
    rise
        Instant at which the command is back at its speed; None until then.
    geared
        Whether the needle follows the head: then the planned motion does not oscillate.
    stopped, started
        Whether the stop and the start have been counted.
    """

    begin_s: float
    least: float
    stop: Instant
    turn: Instant
    period_s: float
    rise_period_s: float = np.nan
    rise: Instant | None = None
    geared: bool = False
    stopped: bool = False
    started: bool = False


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rows:
    """Consecutive samples, n of them.

    Parameters
    ----------
    due_s
        (n,) the plan's time.
    velocity
        (n, axes) commanded, as a share of the set speed.
    grain
        (n, axes) change of ``velocity`` by one count.
    along
        (n, axes) direction of the stitch.
    stitch, contour
        (n,) number of the stitch and of its contour.
    needle_s, down_s
        (n,) plan's time of the needle-downs at the start and the end of the stitch.
    first, rest_s
        (n,) whether the stitch is the first of its contour, and the start of the rest before it;
        minus infinity unless the head comes from another contour.
    """

    due_s: FloatArray
    velocity: FloatArray
    grain: FloatArray
    along: FloatArray
    stitch: IntArray
    contour: IntArray
    needle_s: FloatArray
    down_s: FloatArray
    first: NDArray[np.bool_]
    rest_s: FloatArray

    def __len__(self) -> int:
        return len(self.due_s)

    def rows(self, rows: slice | NDArray[np.bool_] | IntArray) -> Rows:
        """Return some of the samples."""
        return Rows(**{field.name: getattr(self, field.name)[rows] for field in fields(self)})

    def joined(self, more: Rows) -> Rows:
        """Return these samples, followed by more."""
        pairs = ((f.name, getattr(self, f.name), getattr(more, f.name)) for f in fields(self))
        return Rows(**{name: np.concatenate([one, two]) for name, one, two in pairs})


@dataclass(frozen=True, slots=True)
class _Corner:
    """Where one leg ends and the next begins.

    Parameters
    ----------
    row
        Row of the first sample of the new leg.
    old, new
        (axes,) directions of both legs.
    """

    row: int
    old: FloatArray
    new: FloatArray


class Past:
    """The last samples of the command, with the stitches to which they belong."""

    def __init__(self) -> None:
        self._rows: Rows | None = None

    @property
    def end_s(self) -> float:
        """The plan's time of the last sample."""
        return -np.inf if self._rows is None else float(self._rows.due_s[-1])

    def add(self, rows: Rows) -> None:
        """Add the next samples."""
        self._rows = rows if self._rows is None else self._rows.joined(rows)

    def drop(self, before_s: float) -> None:
        """Discard samples before an instant, once they are the larger part."""
        if self._rows is not None:
            first = int(np.searchsorted(self._rows.due_s, before_s))
            if 2 * first > len(self._rows):
                self._rows = self._rows.rows(slice(first, None))

    def start(self, dip: Dip) -> tuple[float, float]:
        """Return when the command first moves along the leg after a dip, and its needle-down.

        If no leg begins there: the instant of lowest speed, and NaN.
        """
        assert self._rows is not None and dip.rise is not None
        rows, turn_s, period_s = self._rows, dip.turn.due_s, dip.rise_period_s
        _, last = self._between(dip.begin_s, dip.rise.due_s)
        corner = self._corner(dip, dip.rise.due_s, period_s)
        if corner is None:
            fresh = rows.first[: last + 1] & (rows.contour[: last + 1] == rows.contour[last])
            own = np.flatnonzero(fresh & (rows.due_s[: last + 1] >= dip.begin_s))
            if not len(own):
                return turn_s, np.nan
            needle_s = float(rows.needle_s[own[0]])
            from_s = max(needle_s - TURNS * period_s, 0.5 * (rows.rest_s[own[0]] + needle_s))
            acting = rows.along[own[0]]
        else:
            needle_s = float(rows.needle_s[corner.row])
            from_s = max(needle_s - TURNS * period_s, _middle(rows, corner.row - 1, -1))
            acting = _acting(corner.new, corner.old)
        if dip.geared:
            return turn_s, needle_s
        begin = int(np.searchsorted(rows.due_s, from_s))
        return _first_moved(rows.rows(slice(begin, last + 1)), acting), needle_s

    def stop(self, dip: Dip) -> tuple[float, float]:
        """Return when the command last moves along the leg before a dip, and its needle-down.

        If no leg ends there: the instant of lowest speed, and NaN.
        """
        assert self._rows is not None
        rows, stop_s, period_s = self._rows, dip.stop.due_s, dip.period_s
        # A recording is read block by block: a rise later than this may be known, or not yet.
        until_s = stop_s + TURNS * period_s
        if dip.rise is not None:
            until_s = min(until_s, dip.rise.due_s)
        first, last = self._between(dip.begin_s, until_s)
        corner = self._corner(dip, until_s, period_s)
        end = len(rows)
        if corner is None:
            goes_on = rows.contour[last] == rows.contour[first]
            if dip.least > STILL or (goes_on and rows.due_s[last] <= rows.down_s[last]):
                return stop_s, np.nan
            own = np.flatnonzero(rows.contour == rows.contour[first])
            of_leg = own[rows.due_s[own] <= max(stop_s, float(rows.down_s[own[-1]]))]
            needle_s, acting = float(rows.down_s[of_leg[-1]]), rows.along[of_leg[-1]]
            end, until_s = int(own[-1]) + 1, needle_s + TURNS * period_s
        else:
            needle_s = float(rows.needle_s[corner.row])
            until_s = min(needle_s + TURNS * period_s, _middle(rows, corner.row, 1))
            acting = _acting(corner.old, corner.new)
        if dip.geared:
            return stop_s, needle_s
        end = min(end, int(np.searchsorted(rows.due_s, until_s, side="right")))
        back = rows.rows(np.arange(end - 1, first - 1, -1))
        return -_first_moved(replace(back, due_s=-back.due_s), acting), needle_s

    def _corner(self, dip: Dip, until_s: float, beside_s: float) -> _Corner | None:
        """Return the corner in a dip, or within one turn of the needle before or after it.

        While one axis stops and another starts, the speed may dip twice, with the corner between.
        """
        assert self._rows is not None
        return _corner(self._rows, *self._between(dip.begin_s - beside_s, until_s + beside_s))

    def _between(self, begin_s: float, end_s: float) -> tuple[int, int]:
        """Return the first and the last row between two instants."""
        assert self._rows is not None
        first, last = np.searchsorted(self._rows.due_s, [begin_s, end_s])
        most = len(self._rows) - 1
        return int(min(first, most)), int(min(last, most))


def _corner(rows: Rows, first: int, last: int) -> _Corner | None:
    """Return the sharpest corner between stitches of one contour in some samples, if any."""
    own = np.arange(max(first, 1), last + 1)
    own = own[rows.stitch[own] != rows.stitch[own - 1]]
    own = own[rows.contour[own] == rows.contour[own - 1]]
    if not len(own):
        return None
    cosine = (rows.along[own] * rows.along[own - 1]).sum(axis=1)
    sharpest = int(np.argmin(cosine))
    if cosine[sharpest] > _CORNER:
        return None
    row = int(own[sharpest])
    return _Corner(row, rows.along[row - 1], rows.along[row])


def _middle(rows: Rows, row: int, step: int) -> float:
    """Return the middle of the straight stretch that begins at ``row`` and goes on by ``step``.

    Beyond the middle a movement belongs to the other end of the leg. A bend ends the stretch: there
    the head moves in all directions.
    """
    rest = rows.along[row:] if step > 0 else rows.along[row::-1]
    bent = np.flatnonzero(rest @ rows.along[row] < _STRAIGHT)
    far = row + step * (int(bent[0]) if len(bent) else len(rest) - 1)
    if not len(bent):  # it goes on beyond the samples
        return np.inf if step > 0 else -np.inf
    return float(0.5 * (rows.due_s[row] + rows.due_s[far]))


def _acting(leg: FloatArray, other: FloatArray) -> FloatArray:
    """Return the vector whose product with a velocity ``a leg + b other`` is a."""
    cosine = float(leg @ other)
    across = leg - cosine * other
    squared = float(across @ across)
    # On a line that turns back both legs have the same direction.
    return across / squared if squared > 1.0 - _CORNER**2 else leg


def _first_moved(rows: Rows, acting: FloatArray) -> float:
    """Return the mean of the instants at which a speed first passes each level of a movement."""
    if not len(rows):
        return np.nan
    speed = np.abs(rows.velocity @ acting)
    # A command in whole counts varies by one count from sample to sample.
    speed -= rows.grain @ np.abs(acting) + _FAINT
    most = np.maximum.accumulate(speed)
    begin, end = most[:-1], most[1:]
    rising = end - begin
    left = np.clip(1.0 - begin / _MOVED, 0.0, 1.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = np.where(rising > 0.0, (_levels(end) - _levels(begin)) / rising, left)
    return float(rows.due_s[0] + (mean * np.diff(rows.due_s)).sum())


def _levels(speed: FloatArray) -> FloatArray:
    """Return the integral up to ``speed`` of 1 below 0, and ``max(1 - s / _MOVED, 0)`` above."""
    part = np.minimum(speed, _MOVED)
    return np.asarray(part - np.maximum(part, 0.0) ** 2 / (2.0 * _MOVED))
