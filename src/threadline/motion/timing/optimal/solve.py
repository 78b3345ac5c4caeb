"""The fastest run through elements within velocity, acceleration and jerk limits."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.motion.timing.optimal import barrier
from threadline.motion.timing.optimal.elements import Elements
from threadline.motion.timing.optimal.first_guess import evenly, feasible, roundings, top_of, used
from threadline.motion.timing.optimal.motion_limits import Limits
from threadline.motion.timing.optimal.rows import (
    assemble,
    braking_shares,
    demand_rows,
    shares,
    with_braking,
)

_COARSE, _FINE = 0.03, 3e-3  # gaps at which elements are refined
VARIED = 1.3  # ratio of y within an element, above which it is cut
LOSS = 2e-3  # share of the jerk time to the nearer limit
_PART = 0.2  # acceptable loss, as a share of the barrier's cost of an element
_MUCH = 64.0  # times the acceptable loss: such an element is cut in four
_ROUNDS, IDLE_ROUNDS = 12, 6
_FIRST_WEIGHT = 0.1  # first weight of the barrier over all slacks, as a share of the duration
_FALL = 0.35  # factor on the weight of the barrier from round to round
_CENTRED = 5.0  # decrement, in roots of the number of slacks, at which the weight falls
_STEPS = 60  # most Newton steps at one weight
_LIMIT_SHARE = 0.9  # used share of the tightest limit when the guards change
_ROUNDED = 1e-7  # share of a limit: elements whose rows have larger rounding are not cut
_AT_A_TIME = 2048  # elements per block of shares
_PLACES = np.array([0.0, 0.5, 1.0])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solution:
    """A motion along elements.

    Parameters
    ----------
    elements
        Elements, as fine as the motion needs.
    b
        (n + 2,) coefficients of the quadratic spline x.
    steps
        Number of Newton steps.
    gap
        Remaining cost of the barrier, as a share of the duration: its weight over all slacks. If
        the last step was centred it bounds the distance from the least duration, on these elements
        and with these tangents of the jerk limit; the limit itself is not convex.
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
        """An upper bound of the duration, tight for fine elements."""
        return float(barrier.duration(self.b, self.elements.length))

    def part(self, first: int, stop: int) -> Solution:
        """Return the motion through elements ``first`` to before ``stop``."""
        elements = self.elements
        x = bernstein(self.b, elements.length) * elements.length[:, None] ** 2
        return replace(
            self,
            elements=elements.take(slice(first, stop)),
            b=np.concatenate([x[first, :1], x[first:stop, 1], x[stop - 1, 2:]]),
        )

    def parts(self, most: int) -> Iterator[Solution]:
        """Yield the motion through at most ``most`` elements at a time."""
        for first in range(0, len(self.elements), most):
            yield self.part(first, min(first + most, len(self.elements)))


def bernstein(b: FloatArray, length: FloatArray) -> FloatArray:
    """Return the (n, 3) Bernstein coefficients of u'^2 on elements of ``length``."""
    length_before = np.concatenate([[0.0], length[:-1]])
    length_after = np.concatenate([length[1:], [0.0]])
    first = (length * b[:-2] + length_before * b[1:-1]) / (length_before + length)
    last = (length_after * b[1:-1] + length * b[2:]) / (length + length_after)
    return np.asarray(np.stack([first, b[1:-1], last], axis=1) / length[:, None] ** 2)


def fastest(elements: Elements, limits: Limits, gap: float = 1e-3) -> Solution:
    """Return the fastest motion along ``elements`` from their first to their last point.

    Elements are halved where y changes much within them, and where no limit is reached.

    Parameters
    ----------
    gap
        Share of the duration within which to reach the least duration.
    """
    problem = Problem(elements, limits)
    problem.solve(gap)
    return problem.solution()


class Problem:
    """The rows of the elements, and the present solution.

    Guards may change after solving (``regard``); then it is solved again from there.
    """

    def __init__(
        self,
        elements: Elements,
        limits: Limits,
        most: FloatArray | None = None,
        begun: tuple[FloatArray, FloatArray] | None = None,
    ) -> None:
        """Begin with a motion.

        Parameters
        ----------
        most
            (n,) largest x of each element at the start.
        begun
            A feasible motion to start from: b and the tangents.
        """
        self.elements, self.limits = elements, limits
        self.steps = 0
        self.weight = np.inf
        self.rows: Any = None
        self.b: FloatArray
        self.tangent: FloatArray
        self.held = (0, 0)
        """Numbers of first and last coefficients of b that stay unchanged."""
        self.settled_s = 0.0
        """Distance from the held end, in time, within which no element is cut."""
        self.fresh = 0.0
        """Place in the common parameter: no element before it is cut for reaching no limit."""
        self._assemble()
        if begun is None:
            self._begin(most)
        else:
            self.b, self.tangent = begun

    def most_used(self) -> float:
        """Return the largest share of a limit that the motion uses, with its tangents."""
        share = np.empty(len(self.elements))
        return float(used(self.b, self.elements.length, self.rows, self.tangent, share, False))

    def solve(self, gap: float, *, cuts: int = _ROUNDS, idle: bool = True) -> None:
        """Find the fastest motion, within a share ``gap`` of the least duration.

        Parameters
        ----------
        cuts
            Number of rounds that cut elements where y changes much.
        idle
            Whether to cut elements that reach no limit, too.
        """
        self._descend(max(_COARSE, gap))
        for _ in range(cuts):
            if not self._refine(self._varied()):
                break
            self._descend(max(_COARSE, gap))
        for _ in range(IDLE_ROUNDS if idle else 0):
            self._descend(max(_FINE, gap))
            if not self._refine(np.maximum(self._idle(), self._varied())):
                break
        self._descend(gap)

    def regard(self, elements: Elements) -> None:
        """Replace the guards on the same elements, and start from the present motion slowed down.

        The used shares of velocity and acceleration limits are proportional to x, and the tangent
        limits widen as x falls: a motion that is slowed evenly stays within all limits.
        """
        self.elements = elements
        self.weight = np.inf
        self._assemble()
        self._slow(_LIMIT_SHARE, anew=True)

    def limit(self, elements: Elements) -> None:
        """Replace the elements' caps on the rate; the motion stays unchanged."""
        self.elements = elements
        self._assemble()

    def solution(self) -> Solution:
        """Return the solution."""
        return Solution(elements=self.elements, b=self.b, steps=self.steps, gap=self.gap())

    def _assemble(self) -> None:
        at, of = self.elements, self.limits
        largest = of.largest_acceleration
        self.rows = None  # the old rows use most of a run's memory: free them first
        self.top = top_of(at, of)
        acc, jerk, points, count, top = assemble(
            at.c, at.guard, of.velocity, largest, of.jerk, self.top
        )
        drive, first = demand_rows(at.c, of.demand, largest, top)
        if of.deceleration is not None:
            drive, first = with_braking(drive, first, at.c, *of.accelerations)
        self.rows = acc, jerk, points, count, top, drive, first
        self.slacks = int(2 * count.sum() + len(at) + 3 * np.isfinite(top).sum() + len(drive))

    def _begin(self, most: FloatArray | None = None) -> None:
        """Start from a slow motion, with (n,) x of ``most`` at most."""
        largest_x = evenly(self.elements, self.limits)
        if most is not None:
            largest_x = np.minimum(largest_x, most)
        self.b, self.tangent = feasible(self.elements.length, self.rows, largest_x)

    def _slow(self, allowed: float, *, anew: bool) -> None:
        """Slow the motion evenly if it uses more than ``allowed`` of a limit.

        ``anew``: set each tangent to its best first.
        """
        length, share = self.elements.length, np.empty(len(self.elements))
        largest_share = used(self.b, length, self.rows, self.tangent, share, anew)
        if largest_share <= allowed or self.held != (0, 0):
            return  # a motion with held ends is not slowed: rounding errors are accepted
        self.b = self.b * (_LIMIT_SHARE / largest_share)
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
                    self.b, length, self.rows, self.tangent, self.weight, self.held
                )
                if not np.isfinite(step).all():
                    return  # rounding ends it here: b keeps within all limits
                if barrier.advance(self.b, step, length, self.rows, self.tangent) <= 0.0:
                    return  # rounding has used up the room to a limit
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
        """Return the barrier's time cost per element: smaller differences of y are meaningless."""
        return self.weight * self.slacks / len(self.elements)

    def _varied(self) -> IntArray:
        """Return the number of parts to cut each element into because y changes much in it."""
        y = bernstein(self.b, self.elements.length)
        ratio = y.max(axis=1) / y.min(axis=1)
        ratio[(y**-0.5).mean(axis=1) < self._cost_s()] = 1.0
        return np.where(ratio > VARIED**4, 3, np.where(ratio > VARIED, 2, 1))

    def guards_used(self) -> FloatArray:
        """Return the (n,) largest shares of a guard within each element."""
        guards = self.elements.guard.shape[2]
        return np.concatenate([part[:, :, -guards:].max(axis=(1, 2)) for part in self._shares()])

    def _shares(self) -> Iterator[FloatArray]:
        """Yield the (m, places, limits) used shares of the limits of elements, some at a time."""
        at, of = self.elements, self.limits
        limits = of.velocity, of.largest_acceleration, of.jerk
        all_y = bernstein(self.b, at.length)
        for begin in range(0, len(at), _AT_A_TIME):
            rows = slice(begin, begin + _AT_A_TIME)
            c, guard, y, top = at.c[rows], at.guard[rows], all_y[rows], self.top[rows]
            used_block = shares(c, guard, y, limits, of.demand, top, _PLACES)
            if of.deceleration is None:
                yield np.asarray(used_block)
            else:
                # First, since guards are located relative to the end.
                yield np.concatenate(
                    [braking_shares(c, y, *of.accelerations, _PLACES), used_block], axis=2
                )

    def _fastest(self) -> FloatArray:
        """Return the (axes,) largest velocities of the motion: bounds, tight for short elements."""
        elements = self.elements
        rates = np.arange(1.0, elements.c.shape[1])[:, None] * np.abs(elements.c[:, 1:])
        rate = np.sqrt(bernstein(self.b, elements.length).max(axis=1))
        return np.asarray((rates.sum(axis=1) * rate[:, None]).max(axis=0))

    def settled(self) -> int:
        """Return the number of elements that are far enough from the end to be cut."""
        moving = len(self.elements) - max(self.held[1] - 1, 0)
        time_s = (bernstein(self.b, self.elements.length)[:moving] ** -0.5).mean(axis=1)
        return moving - int(np.searchsorted(np.cumsum(time_s[::-1]), self.settled_s))

    def _idle(self) -> IntArray:
        """Return 2 for each element to cut in two, since it reaches no limit somewhere, else 1."""
        time_s = (bernstein(self.b, self.elements.length) ** -0.5).mean(axis=1)
        least_used = np.concatenate([part.max(axis=2).min(axis=1) for part in self._shares()])
        lost_s = time_s * (1.0 - least_used)
        ramp_s = self.limits.ramp_s(self._fastest())
        enough_s = max(LOSS * ramp_s, _PART * self._cost_s())
        lost_s[np.cumsum(self.elements.length) <= self.fresh] = 0.0
        return np.where(lost_s > _MUCH * enough_s, 4, np.where(lost_s > enough_s, 2, 1))

    def _refine(self, parts: IntArray) -> bool:
        """Cut elements into ``parts``; return whether there is anything to cut."""
        parts[roundings(self.b, self.elements.length, self.rows) > _ROUNDED] = 1
        parts[self.settled() :] = 1
        if (parts == 1).all():
            return False
        self._cut(parts.astype(np.int64))
        return True

    def _cut(self, parts: IntArray) -> None:
        self.rows = None
        element = np.repeat(np.arange(len(parts)), parts)
        x = bernstein(self.b, self.elements.length) * self.elements.length[:, None] ** 2
        count = parts[element].astype(np.float64)
        begin = (np.arange(len(element)) - np.repeat(np.cumsum(parts) - parts, parts)) / count
        end = begin + 1.0 / count
        # The blossom of the quadratic: coefficient k belongs to the nodes about element k.
        x = x[element]
        inner = (
            (1.0 - begin) * (1.0 - end) * x[:, 0]
            + (begin * (1.0 - end) + end * (1.0 - begin)) * x[:, 1]
            + begin * end * x[:, 2]
        )
        self.b = np.concatenate([[self.b[0]], inner, [self.b[-1]]])
        self.tangent = self.tangent[element] / count
        self.elements = self.elements.split(parts)
        del element, x, count, begin, end, inner
        self._assemble()
        self._slow(1.0 - _ROUNDED, anew=False)
