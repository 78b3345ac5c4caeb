"""Trajectory of a path whose shape alone is settled: as fast as limits and feed allow."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from numba import njit
from numpy.typing import NDArray

from threadline.arrays import FloatArray, IntArray
from threadline.machine import Machine
from threadline.path.smoothing import Smoothing, smoothing_for
from threadline.path.types import PieceBlock, PlannedPath
from threadline.trajectory import profile
from threadline.trajectory.smoothing import Smoother
from threadline.trajectory.timed import held_block
from threadline.trajectory.types import TrajectoryBlock

BoolArray: TypeAlias = NDArray[np.bool_]

SAMPLES = 16384  # in hand at once
MOST_PENDING = 200_000  # pieces that wait for what follows; a longer wait is cut short by a stop
_TAILS = 20.0  # times what the tails of the smoothing may cut: a tolerance below is fine
_ALONG = 1e-4  # least weight of the part of q_uu along the path, squared
_HAT = 0.25  # of the larger curvature: the smaller one at the end of a corner's piece
_CUSP = 1e-5  # of the piece's size: a slower end is a cusp


@dataclass(slots=True)
class _Pieces:
    """Pieces with what the profile needs to know of each."""

    c: FloatArray
    straight: IntArray
    cap: FloatArray  # largest u'^2 that feed and smoothing allow
    factor: FloatArray  # from u'^2 at the end to that at the start of the next
    length: FloatArray
    operation: IntArray


def followed_blocks(path: PlannedPath, machine: Machine) -> Iterator[TrajectoryBlock]:
    """Yield the trajectory of ``path`` within velocity, acceleration and jerk limits."""
    column = [machine.axis_names.index(axis) for axis in path.axes]
    run = _Run(
        radius=path.radius_m,
        limit_v=machine.velocity_limit[column],
        limit_a=machine.acceleration_limit[column],
        smoothing=smoothing_for(machine, path.axes),
        slack_m=path.smoothing_m,
    )
    for block in path:
        stops = np.flatnonzero(block.rest_after)
        first = 0
        for stop in stops:
            yield from run.extend(block, first, int(stop) + 1, ends=True)
            first = int(stop) + 1
        if first < len(block):
            yield from run.extend(block, first, len(block), ends=False)


@dataclass(slots=True)
class _Run:
    """The run under way between two rests."""

    radius: FloatArray
    limit_v: FloatArray
    limit_a: FloatArray
    smoothing: Smoothing
    slack_m: float
    pending: _Pieces | None = None
    speed: float = 0.0  # u'^2 at the start of the first pending piece
    time_s: float = 0.0  # from the start of the first pending piece to its first sample
    begin_s: float = 0.0  # when the run began
    done: int = 0  # spline pieces of the run that are out
    smoother: Smoother | None = None
    buffer: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))

    def extend(
        self, block: PieceBlock, first: int, stop: int, *, ends: bool
    ) -> Iterator[TrajectoryBlock]:
        """Take in pieces ``first`` to ``stop`` and yield what they settle."""
        rows = slice(first, stop)
        here = block.coefficients[rows]
        moves = np.abs(here[:, 1:]).max(axis=(1, 2)) > 0
        pieces = self._prepare(
            here[moves], block.nominal_s[rows][moves], block.operation[rows][moves]
        )
        self.pending = pieces if self.pending is None else _join(self.pending, pieces, self.radius)
        if self.smoother is None and len(self.pending.c):
            start = self.pending.c[0, 0]
            self.smoother = Smoother(self.smoothing, start, int(self.pending.operation[0]))
        yield from self._advance(ends)
        if not ends:
            return
        last = here[-1].sum(axis=0)
        if self.smoother is not None:
            label = int(block.operation[stop - 1])
            yield from self._emit(*self.smoother.finish(last, label))
        self.begin_s += self.done * self.smoothing.step_s
        dwell = float(block.dwell_s[stop - 1])
        if dwell > 0:
            yield held_block(last, self.begin_s, dwell, int(block.operation[stop - 1]))
            self.begin_s += dwell
        self.pending, self.smoother = None, None
        self.speed, self.time_s, self.done = 0.0, 0.0, 0

    def _prepare(self, c: FloatArray, nominal_s: FloatArray, operation: IntArray) -> _Pieces:
        if c.shape[1] < 4:
            c = np.concatenate([c, np.zeros((len(c), 4 - c.shape[1], c.shape[2]))], axis=1)
        straight = np.all(c[:, 2:] == 0.0, axis=(1, 2))
        with np.errstate(divide="ignore"):
            feed = np.where(nominal_s > 0, 1.0 / nominal_s**2, np.inf)
        smooth = self._smoothing_cap(c, straight)
        length = (
            _size(c[:, 1], self.radius)
            + _size(c[:, 1] + c[:, 2], self.radius)
            + _size(_slope(c), self.radius)
        ) / 3.0
        factor = np.concatenate([_factors(c, self.radius), np.ones(min(len(c), 1))])
        return _Pieces(
            c, straight.astype(np.int64), np.minimum(feed, smooth), factor, length, operation
        )

    def _smoothing_cap(self, c: FloatArray, straight: BoolArray) -> FloatArray:
        """Return the largest u'^2 at which the smoothing cuts a curve by no more than allowed.

        That is half the variance of its weights times q_uu u'^2.
        """
        smoothing = self.smoothing
        first, last = _cutting(c, self.radius)
        bend = np.where(straight, 0.0, np.maximum(first, last))
        tail = smoothing.tail_s2 * float(_size(self.limit_a[None], self.radius)[0])
        fine = self.slack_m < _TAILS * tail
        slack = self.slack_m if fine else self.slack_m - tail
        with np.errstate(divide="ignore"):
            cap = 2.0 * slack / (smoothing.variance_s2 * bend)
        # In a corner between straight pieces the acceleration rises and falls evenly over the
        # time 2 / u', of which the average sees the fraction 1 - width u' / 8 (3/4 at least).
        lone = np.zeros(len(c), dtype=bool)
        rises, falls = first < _HAT * last, last < _HAT * first
        lone[1:-2] = straight[:-3] & ~straight[1:-2] & ~straight[2:-1] & straight[3:]
        lone[1:-2] &= rises[1:-2] & falls[2:-1]
        lone[2:-1] |= lone[1:-2]
        seen = 1.0 - np.minimum(smoothing.width_s * np.sqrt(cap) / 8.0, 0.25)
        cap = np.where(lone, cap / seen, cap)
        if fine:
            # So small a tolerance feels where the weights still see the straight beyond a curve.
            edge = np.zeros(len(c), dtype=bool)
            edge[:-1] |= straight[1:]
            edge[1:] |= straight[:-1]
            cap = np.where(edge & ~straight, np.minimum(cap, 1.0 / smoothing.reach_s**2), cap)
        return np.asarray(cap)

    def _advance(self, ends: bool) -> Iterator[TrajectoryBlock]:
        p = self.pending
        assert p is not None
        count = len(p.c)
        if not count:
            return
        cap = p.cap.copy()
        reach = self.smoothing.reach_s
        _spread(cap, p.cap, p.factor, p.length, p.straight, reach)
        limits = (self.limit_v, self.limit_a)
        most = np.zeros((count, profile.PARTS + 1))
        profile.backward(p.c, p.straight, cap, p.factor, *limits, 0.0, most, False)
        settled = count
        if not ends:
            settled = profile.backward(p.c, p.straight, cap, p.factor, *limits, np.inf, most, True)
            # What comes later may still lower the caps of the last stretch.
            left = np.cumsum(p.length[::-1])[::-1]
            settled = min(settled, int(np.searchsorted(-left, -self._far(p, cap, reach))))
            if count - settled > MOST_PENDING:
                settled = count // 2
        if settled <= 0:
            return
        head = slice(0, settled)
        x = np.zeros((settled, profile.PARTS + 1))
        after = profile.forward(
            p.c[head], p.straight[head], p.factor[head], *limits, self.speed, most, x
        )
        yield from self._sample(p, cap, x, settled)
        self.speed = after
        tail = slice(settled, None)
        self.pending = _Pieces(
            p.c[tail],
            p.straight[tail],
            p.cap[tail],
            p.factor[tail],
            p.length[tail],
            p.operation[tail],
        )

    def _far(self, p: _Pieces, cap: FloatArray, reach: float) -> float:
        """Return a distance beyond which later caps have no effect."""
        top = _size(self.limit_v[None, :], self.radius)[0]
        speed = np.sqrt(cap) * p.length * 3.0
        return float(reach * min(top, np.nanmax(np.minimum(speed, top))))

    def _sample(
        self, p: _Pieces, cap: FloatArray, x: FloatArray, settled: int
    ) -> Iterator[TrajectoryBlock]:
        state = np.array([0.0, 0.0, self.time_s])
        out = np.empty((SAMPLES, p.c.shape[2]))
        owner = np.empty(SAMPLES, dtype=np.int64)
        assert self.smoother is not None
        while state[0] < settled:
            count = profile.sample(
                p.c[:settled],
                p.straight,
                cap,
                x,
                self.limit_v,
                self.limit_a,
                self.smoothing.step_s,
                state,
                out,
                owner,
            )
            if count:
                fresh = self.smoother.extend(out[:count].copy(), p.operation[owner[:count]])
                yield from self._emit(*fresh)
        self.time_s = float(state[2])

    def _emit(self, coefficients: FloatArray, operation: IntArray) -> Iterator[TrajectoryBlock]:
        count = len(coefficients)
        if not count:
            return
        step = self.smoothing.step_s
        yield TrajectoryBlock(
            start_s=np.asarray(self.begin_s + (self.done + np.arange(count)) * step),
            duration_s=np.full(count, step),
            coefficients=coefficients,
            operation=operation,
        )
        self.done += count


def _slope(c: FloatArray) -> FloatArray:
    """Return the (n, axes) derivative at the end of each piece."""
    return np.asarray(c[:, 1] + 2.0 * c[:, 2] + 3.0 * c[:, 3])


def _bend(c: FloatArray) -> FloatArray:
    """Return the (n, axes) second derivative at the end of each piece."""
    return np.asarray(2.0 * c[:, 2] + 6.0 * c[:, 3])


def _size(vectors: FloatArray, radius: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(((vectors * radius) ** 2).sum(axis=-1)))


def _cutting(c: FloatArray, radius: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the (n,) q_uu at the tool at both ends, its part along the path at a discount.

    What the smoothing shifts along the path is no deviation, unless the path turns back there.
    """
    first, last = c[:, 1] * radius, _slope(c) * radius
    size = np.sqrt((first**2).sum(axis=1)), np.sqrt((last**2).sum(axis=1))
    fast = np.maximum(*size)
    sound = np.minimum(*size) > _CUSP * fast
    ahead = (first * last).sum(axis=1) / np.where(sound, size[0] * size[1], 1.0)
    share = (1.0 - np.where(sound, np.clip(ahead, 0.0, 1.0), 0.0)) ** 2 + _ALONG
    ends = []
    for slope, bend in ((first, 2.0 * c[:, 2] * radius), (last, _bend(c) * radius)):
        square = (slope**2).sum(axis=1, keepdims=True)
        part = (slope * bend).sum(axis=1, keepdims=True) / np.where(square > 0, square, 1.0)
        along = part * slope
        across = ((bend - along) ** 2).sum(axis=1)
        ends.append(np.sqrt(across + share * (along**2).sum(axis=1)))
    return ends[0], ends[1]


def _factors(c: FloatArray, radius: FloatArray) -> FloatArray:
    """Return the (n - 1,) ratios of u'^2 after and before each joint.

    The path is smooth in a common parameter, so that its derivatives tell the ratio; at a cusp,
    where the axes turn back and the first derivative vanishes, the second one does.
    """
    ahead, behind = _slope(c[:-1]), c[1:, 1]
    first, second = _size(ahead, radius), _size(behind, radius)
    size_ahead = np.abs(c[:-1, 1:] * radius).max(axis=(1, 2), initial=0.0)
    size_behind = np.abs(c[1:, 1:] * radius).max(axis=(1, 2), initial=0.0)
    cusp = (first < _CUSP * size_ahead) | (second < _CUSP * size_behind)
    with np.errstate(divide="ignore", invalid="ignore"):
        plain = (first / second) ** 2
        turning = _size(_bend(c[:-1]), radius) / _size(2.0 * c[1:, 2], radius)
    return np.where(cusp, turning, plain)


def _join(first: _Pieces, second: _Pieces, radius: FloatArray) -> _Pieces:
    if not len(second.c):
        return first
    if not len(first.c):
        return second
    seam = _factors(np.concatenate([first.c[-1:], second.c[:1]]), radius)
    return _Pieces(
        np.concatenate([first.c, second.c]),
        np.concatenate([first.straight, second.straight]),
        np.concatenate([first.cap, second.cap]),
        np.concatenate([first.factor[:-1], seam, second.factor]),
        np.concatenate([first.length, second.length]),
        np.concatenate([first.operation, second.operation]),
    )


@njit(cache=True)
def _spread(cap, own, factor, length, straight, reach):  # type: ignore[no-untyped-def]
    """Let the cap of a curved piece hold for all pieces that the smoothing sees from there."""
    for i in range(len(own)):
        if straight[i]:
            continue
        for way in (1, -1):
            x = own[i]
            j = i
            gone = 0.0
            far = np.sqrt(x) * length[i] * reach
            while True:
                if way == 1:
                    if j + 1 >= len(own):
                        break
                    x = x * factor[j]
                    j += 1
                else:
                    if j == 0:
                        break
                    j -= 1
                    x = x / factor[j]
                if straight[j] and gone + length[j] > far:
                    break
                cap[j] = min(cap[j], x)
                gone += length[j]
                if gone > far:
                    break
