"""The fastest run through elements within velocity, acceleration and jerk limits."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.trajectory.optimal import barrier
from threadline.trajectory.optimal.along_path import AlongPath, across
from threadline.trajectory.optimal.first_guess import even, feasible, roundings, used
from threadline.trajectory.optimal.path_elements import Elements
from threadline.trajectory.optimal.rows import assemble, demand_rows
from threadline.trajectory.optimal.two_sided import braking_shares, with_braking
from threadline.trajectory.optimal.usage import shares

_COARSE, _FINE = 0.03, 3e-3  # gaps at which elements are made finer
_VARIED = 1.3  # ratio of y within an element, above which it is cut
_LOSS = 2e-3  # of the time that the jerk takes to the nearer limit
_PART = 0.2  # of what the barrier costs an element: to lose less is enough
_MUCH = 64.0  # times what is enough to lose: an element that loses as much is cut in four
_LEAST_RAMP = 0.02  # of the time to the velocity's limit at that of the acceleration
_ROUNDS, _IDLE_ROUNDS = 12, 6
_FIRST_WEIGHT = 0.1  # of the duration, over all slacks
_FALL = 0.35  # of the weight of the barrier from round to round
_CENTRED = 5.0  # decrement, in roots of the number of slacks, at which the weight falls
_STEPS = 60  # at one weight
_KEPT = 0.9  # of the tightest limit, where other guards are taken
_ROUNDED = 1e-7  # of a limit: an element whose rows are rounded by more is not cut
_AT_A_TIME = 2048  # elements, of which shares are told
_PLACES = np.array([0.0, 0.5, 1.0])


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """What the axes may do.

    Parameters
    ----------
    velocity, acceleration, jerk
        (axes,); a jerk may be infinite.
    demand
        (m, axes, 2) share of what the drive of an axis has to give (volts, current) that 1 m/s,
        and 1 m/s^2, of it needs; 0 for none. At an acceleration of its limit and no velocity, no
        demand may be above 1.
    deceleration
        (axes,) what an axis may brake with, where that is another limit than ``acceleration``.
    along
        What the tool may do along its path and across it.
    """

    velocity: FloatArray
    acceleration: FloatArray
    jerk: FloatArray
    demand: FloatArray = field(default_factory=lambda: np.zeros((0, 0, 2)))
    deceleration: FloatArray | None = None
    along: AlongPath | None = None

    @property
    def sides(self) -> tuple[FloatArray, FloatArray]:
        """(axes,) limits of speeding up, and of braking."""
        braking = self.acceleration if self.deceleration is None else self.deceleration
        return self.acceleration, braking

    @property
    def largest_acceleration(self) -> FloatArray:
        """(axes,) the higher limit of speeding up and braking."""
        return np.maximum(*self.sides)

    def with_length(self) -> Limits:
        """Return the limits with those along the path as of one more axis: the way gone."""
        if self.along is None:
            return self
        own = self.along
        speeding, braking = (
            np.append(limit, along) for limit, along in zip(self.sides, own.sides, strict=True)
        )
        return replace(
            self,
            velocity=np.append(self.velocity, own.velocity),
            acceleration=speeding,
            jerk=np.append(self.jerk, own.jerk),
            demand=np.pad(self.demand, ((0, 0), (0, 1), (0, 0))),
            deceleration=None if np.array_equal(speeding, braking) else braking,
        )

    @property
    def ramp_s(self) -> float:
        """The time that the jerk takes to the limit of acceleration or velocity, about."""
        with np.errstate(invalid="ignore"):
            by_jerk = np.fmin(self.acceleration / self.jerk, np.sqrt(self.velocity / self.jerk))
            by_acceleration = _LEAST_RAMP * self.velocity / self.acceleration
        # What has no limit at all has no ramp either.
        return float(np.nanmin(np.fmax(by_jerk, by_acceleration)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solution:
    """A motion along elements.

    Parameters
    ----------
    elements
        As fine as the motion asks for.
    b
        (n + 2,) coefficients of the quadratic spline x.
    steps
        Newton steps that were made.
    gap
        What the barrier still costs, as a share of the duration: its weight over all slacks. It
        bounds how far the least is, on these elements and with these tangents of the jerk's
        limit, where the last step was centred; the limit itself is not convex.
    """

    elements: Elements
    b: FloatArray
    steps: int
    gap: float

    @property
    def y(self) -> FloatArray:
        """(n, 3) Bernstein coefficients of u'^2 on each element."""
        return bernstein(self.b, self.elements.length)

    @property
    def duration_s(self) -> float:
        """An upper bound of the duration, near it where the elements are fine."""
        return float(barrier.duration(self.b, self.elements.length))


def bernstein(b: FloatArray, length: FloatArray) -> FloatArray:
    """Return the (n, 3) Bernstein coefficients of u'^2 on elements of ``length``."""
    before = np.concatenate([[0.0], length[:-1]])
    after = np.concatenate([length[1:], [0.0]])
    first = (length * b[:-2] + before * b[1:-1]) / (before + length)
    last = (after * b[1:-1] + length * b[2:]) / (length + after)
    return np.asarray(np.stack([first, b[1:-1], last], axis=1) / length[:, None] ** 2)


def fastest(elements: Elements, limits: Limits, gap: float = 1e-3) -> Solution:
    """Return the fastest motion along ``elements`` from their first to their last place.

    Elements are halved where y changes much within them, and where no limit is reached.

    Parameters
    ----------
    gap
        Share of the duration within which the least is to be reached.
    """
    problem = Problem(elements, limits)
    problem.solve(gap)
    return problem.solution()


class Problem:
    """The rows of the elements, and where the solution is.

    Guards may change after it was solved (``regard``), and it is solved again from there.
    """

    def __init__(self, elements: Elements, limits: Limits) -> None:
        self.elements, self.limits = elements, limits
        self.steps = 0
        self.weight = np.inf
        self.rows: Any = None
        self.b: FloatArray
        self.tangent: FloatArray
        self._assemble()
        self._begin()

    def solve(self, gap: float, *, cuts: int = _ROUNDS, idle: bool = True) -> None:
        """Find the fastest motion, within a share ``gap`` of the least duration.

        Parameters
        ----------
        cuts
            How often elements are cut where y changes much.
        idle
            Whether elements are cut where no limit is reached, too.
        """
        self._descend(max(_COARSE, gap))
        for _ in range(cuts):
            if not self._refine(self._varied()):
                break
            self._descend(max(_COARSE, gap))
        for _ in range(_IDLE_ROUNDS if idle else 0):
            self._descend(max(_FINE, gap))
            if not self._refine(np.maximum(self._idle(), self._varied())):
                break
        self._descend(gap)

    def regard(self, elements: Elements) -> None:
        """Take other guards on the same elements, and begin from the present motion made slower.

        What a motion uses of the limits of velocity and acceleration is proportional to x, and the
        limits that are tangents become wider as x falls: slowed evenly, the motion is within all.
        """
        self.elements = elements
        self.weight = np.inf
        self._assemble()
        self._slow(_KEPT, anew=True)

    def limit(self, elements: Elements) -> None:
        """Take the same elements with other rates that they allow; the motion stays as it is."""
        self.elements = elements
        self._assemble()

    def solution(self) -> Solution:
        """Return the motion as it was found."""
        return Solution(elements=self.elements, b=self.b, steps=self.steps, gap=self.gap())

    def _assemble(self) -> None:
        at, of = self.elements, self.limits
        largest = of.largest_acceleration
        self.rows = None  # those of before are most of what a run takes: they go first
        self.top = self._top()
        acc, jerk, points, count, top = assemble(
            at.c, at.guard, of.velocity, largest, of.jerk, self.top
        )
        drive, first = demand_rows(at.c, of.demand, largest, top)
        if of.deceleration is not None:
            drive, first = with_braking(drive, first, at.c, *of.sides)
        self.rows = acc, jerk, points, count, top, drive, first
        self.slacks = int(2 * count.sum() + len(at) + 3 * np.isfinite(top).sum() + len(drive))

    def _top(self) -> FloatArray:
        """Return the (n,) largest u'^2 of feed, guards and what may be across the path."""
        along = self.limits.along
        if along is None or not np.isfinite(along.centripetal):
            return self.elements.top
        bent = across(self.elements.c[:, :, :-1] * along.radius_m)
        with np.errstate(divide="ignore"):
            return np.minimum(self.elements.top, along.centripetal / bent)

    def _begin(self) -> None:
        """Start from a slow motion."""
        at, of = self.elements, self.limits
        least = np.minimum(*of.sides)
        most = even(at.length, at.c, at.guard, of.velocity, least, of.jerk, of.demand, self.top)
        self.b, self.tangent = feasible(at.length, self.rows, most)

    def _slow(self, allowed: float, *, anew: bool) -> None:
        """Slow the motion evenly where it uses more than ``allowed`` of a limit.

        ``anew`` says whether each tangent is put to its best first.
        """
        length, share = self.elements.length, np.empty(len(self.elements))
        most = used(self.b, length, self.rows, self.tangent, share, anew)
        if most <= allowed:
            return
        self.b = self.b * (_KEPT / most)
        if not used(self.b, length, self.rows, self.tangent, share, False) < 1.0:
            self._begin()  # rounding left it on a limit

    def _descend(self, gap: float) -> None:
        """Lower the weight of the barrier until the duration is within ``gap`` of the least."""
        length = self.elements.length
        unit = float(barrier.duration(self.b, length)) / self.slacks
        self.weight = min(self.weight, _FIRST_WEIGHT * unit)
        while True:
            for _ in range(_STEPS):
                step, decrement = barrier.newton(
                    self.b, length, self.rows, self.tangent, self.weight
                )
                if not np.isfinite(step).all():
                    return  # rounding ends it here: b keeps within all limits
                if barrier.advance(self.b, step, length, self.rows, self.tangent) <= 0.0:
                    return  # so it does where it took the last room to a limit
                barrier.follow(self.b, length, self.rows, self.tangent)
                self.steps += 1
                if decrement < _CENTRED * self.weight * np.sqrt(self.slacks):
                    break
            unit = float(barrier.duration(self.b, length)) / self.slacks
            if self.weight <= 1.01 * gap * unit:
                return
            self.weight = max(_FALL * self.weight, gap * unit)

    def gap(self) -> float:
        """Return the share of the duration that the barrier still costs."""
        return self.weight * self.slacks / float(barrier.duration(self.b, self.elements.length))

    def _cost_s(self) -> float:
        """Return the time that the barrier costs an element: within it y says nothing yet."""
        return self.weight * self.slacks / len(self.elements)

    def _varied(self) -> IntArray:
        """Return into how many parts each element is to be cut because y changes much in it."""
        y = bernstein(self.b, self.elements.length)
        ratio = y.max(axis=1) / y.min(axis=1)
        ratio[(y**-0.5).mean(axis=1) < self._cost_s()] = 1.0
        return np.where(ratio > _VARIED**4, 3, np.where(ratio > _VARIED, 2, 1))

    def guards_used(self) -> FloatArray:
        """Return the (n,) largest shares of a guard within each element."""
        guards = self.elements.guard.shape[2]
        return np.concatenate([part[:, :, -guards:].max(axis=(1, 2)) for part in self._shares()])

    def _shares(self) -> Iterator[FloatArray]:
        """Yield the (m, places, limits) shares of the limits that elements use, some at a time."""
        at, of = self.elements, self.limits
        largest, all_y = of.largest_acceleration, bernstein(self.b, at.length)
        for begin in range(0, len(at), _AT_A_TIME):
            own = slice(begin, begin + _AT_A_TIME)
            c, guard, y, top = at.c[own], at.guard[own], all_y[own], self.top[own]
            used = shares(c, guard, y, of.velocity, largest, of.jerk, of.demand, top, _PLACES)
            if of.deceleration is None:
                yield np.asarray(used)
            else:
                # First, for guards are told by their places at the end.
                yield np.concatenate([braking_shares(c, y, *of.sides, _PLACES), used], axis=2)

    def _idle(self) -> IntArray:
        """Return 2 for each element that reaches no limit somewhere, to be cut in two, else 1."""
        time_s = (bernstein(self.b, self.elements.length) ** -0.5).mean(axis=1)
        used = np.concatenate([part.max(axis=2).min(axis=1) for part in self._shares()])
        lost_s = time_s * (1.0 - used)
        enough_s = max(_LOSS * self.limits.ramp_s, _PART * self._cost_s())
        return np.where(lost_s > _MUCH * enough_s, 4, np.where(lost_s > enough_s, 2, 1))

    def _refine(self, parts: IntArray) -> bool:
        """Cut elements into ``parts``; return whether there is anything to cut."""
        parts[roundings(self.b, self.elements.length, self.rows) > _ROUNDED] = 1
        if (parts == 1).all():
            return False
        self._cut(parts.astype(np.int64))
        return True

    def _cut(self, parts: IntArray) -> None:
        self.rows = None
        which = np.repeat(np.arange(len(parts)), parts)
        x = bernstein(self.b, self.elements.length) * self.elements.length[:, None] ** 2
        count = parts[which].astype(np.float64)
        first = (np.arange(len(which)) - np.repeat(np.cumsum(parts) - parts, parts)) / count
        last = first + 1.0 / count
        # The blossom of the quadratic: coefficient k belongs to the nodes about element k.
        x = x[which]
        inner = (
            (1.0 - first) * (1.0 - last) * x[:, 0]
            + (first * (1.0 - last) + last * (1.0 - first)) * x[:, 1]
            + first * last * x[:, 2]
        )
        self.b = np.concatenate([[self.b[0]], inner, [self.b[-1]]])
        self.tangent = self.tangent[which] / count
        self.elements = self.elements.split(parts)
        del which, x, count, first, last, inner
        self._assemble()
        self._slow(1.0 - _ROUNDED, anew=False)
