"""Runs of any length, planned as far ahead as a window reaches.

A window ends in some pieces that are traversed so slowly and evenly that the motion could rest
within them without another plan. The plan beyond the horizon is kept for the next window. That one
begins with the position, velocity and acceleration at the horizon, continues along the rest of the
plan, and slowly through the new pieces: a motion within all limits, which the solver makes faster.
If there is no such motion, the plan is followed to its end and rests there.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, replace

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.motion.path.types import PieceBlock
from threadline.motion.timing.optimal.elements import Elements, PiecesAhead, join, rows_of
from threadline.motion.timing.optimal.first_guess import evenly
from threadline.motion.timing.optimal.in_time import as_it_is, in_time
from threadline.motion.timing.optimal.motion_limits import Limits
from threadline.motion.timing.optimal.run_elements import RunElements, run_elements
from threadline.motion.timing.optimal.solve import Problem, Solution, bernstein
from threadline.motion.timing.types import TrajectoryBlock

ADDED = 1000
"""Pieces by which a window extends beyond the previous one; more if they are hardly cut."""
MOST_ADDED = 6000
_ELEMENTS = 11_000  # approximate number of elements that a window adds
HORIZON = 1.25
"""Part that is planned again with the next window, in braking times from the speed limit; at most
``MOST_AHEAD`` pieces."""
MOST_AHEAD = 5000
LEAST_AHEAD = 80  # least number of pieces that are planned again
SEEN = 100
"""Pieces after a window that are considered."""
_SLOW = 0.25  # of the constant rate that elements near the end of a window allow
_LONGER = 3e-4  # permitted relative stretching of a motion: jerks of 1.0009 of their limit
_AT_A_TIME = 4096  # elements converted to time together
_SLOWER, _TRIES = 0.8, 16  # factor on x if the stretching is too large
_HELD = (1, 8, 64, 512)
"""Least number of elements in which a window keeps the constant x that it began with."""
SLOW_PIECES = 40  # pieces at the end of a window that are traversed evenly
_CUT = 2.0  # mean number of elements per piece above which the next pieces start with two
_EVEN = 1e-9  # of x: relative change that counts as constant


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _RestOfPlan:
    """The rest of a plan: from a place on the path to its slow end.

    Parameters
    ----------
    elements, b, tangent
        (n,) elements, (n + 2,) coefficients of their motion and (n,) tangents.
    ending
        Coefficients of the motion through the ending of ``shape``.
    borders
        (m,) ends of the pieces in the common parameter.
    shape
        The pieces added last.
    fresh
        Place in the common parameter up to which elements were cut for reaching no limit.
    cut
        Mean number of elements per piece.
    """

    elements: Elements
    b: FloatArray
    tangent: FloatArray
    ending: FloatArray
    borders: FloatArray
    shape: RunElements
    fresh: float
    cut: float

    @property
    def added(self) -> int:
        """Number of pieces that the next window adds."""
        return int(max(ADDED, min(_ELEMENTS / self.cut, MOST_ADDED)))

    def up_to(self, pieces: int) -> int:
        """Return the number of elements before the end of a piece."""
        ends = np.cumsum(self.elements.length)
        return int(np.abs(ends - self.borders[pieces - 1]).argmin()) + 1

    def before(self, horizon_s: float) -> int:
        """Return the number of pieces that end before the horizon begins."""
        fast_elements = self.up_to(len(self.borders) - self.shape.slow)
        place = _place(
            self.elements.take(slice(0, fast_elements)), self.b[: fast_elements + 2], horizon_s
        )
        count = int(np.searchsorted(self.borders, place * (1.0 + _EVEN), side="right"))
        most_pieces = len(self.borders) - LEAST_AHEAD
        return max(min(max(count, len(self.borders) - MOST_AHEAD), most_pieces), 1)

    def left(self, pieces: int) -> tuple[Solution, _RestOfPlan]:
        """Return the motion through ``pieces`` pieces, and the rest of the plan."""
        elements, b = self.elements, self.b
        m = self.up_to(pieces)
        node = float(bernstein(b, elements.length)[m, 0]) * elements.length[m] ** 2
        done_motion = Solution(elements=elements, b=b, steps=0, gap=0.0).part(0, m)
        # The common parameter starts anew: over millions of pieces its size would drift. Scaling by
        # a power of two rounds no digit, so that limits met to the last digit stay met.
        unit = float(2.0 ** -np.round(np.log2(elements.length[m])))
        rest_elements = elements.take(slice(m, None))
        return done_motion, _RestOfPlan(
            elements=replace(rest_elements, length=unit * rest_elements.length),
            b=unit**2 * np.concatenate([[node], b[m + 1 :]]),
            tangent=self.tangent[m:],
            ending=unit**2 * self.ending,
            borders=unit * (self.borders[pieces:] - self.borders[pieces - 1]),
            shape=self.shape.in_units_of(1.0 / unit),
            fresh=unit * (self.fresh - float(self.borders[pieces - 1])),
            cut=self.cut,
        )

    def to_rest(self) -> Solution:
        """Return the motion to its end, and to a rest there."""
        ending = self.shape.ending
        if ending is None:
            return Solution(elements=self.elements, b=self.b, steps=0, gap=0.0)
        m = self.up_to(len(self.borders) - self.shape.slow)
        return Solution(
            elements=join([self.elements.take(slice(0, m)), ending]),
            b=np.concatenate([self.b[: m + 1], self.ending[1:]]),
            steps=0,
            gap=0.0,
        )


def windowed(
    ahead: PiecesAhead,
    radius_m: FloatArray,
    limits: Limits,
    gap: float,
    begin_s: float,
    *,
    dense: bool,
) -> Generator[TrajectoryBlock, None, tuple[PieceBlock | None, float]]:
    """Yield the motion through a run with too many pieces to plan together.

    Parameters
    ----------
    limits
        Limits, with those along the path as one more axis.
    gap
        Share of the duration of a window within which to reach its least duration.
    dense
        Whether the run has so many pieces that one element each is enough at the start, unless
        pieces of the previous window were cut.

    Returns
    -------
    tuple
        The last pieces read, and the time.
    """
    rest: _RestOfPlan | None = None
    now_s, horizon_s = begin_s, HORIZON * _braking_s(limits)
    while True:
        added = ADDED if rest is None else rest.added
        run = ahead.take(added + SEEN)
        if run is None and rest is None:
            return None, now_s
        next_pieces = None
        if run is not None and len(run) == added + SEEN and not run.rest_after[-1]:
            next_pieces = rows_of(run, added, len(run))
            ahead.put_back(next_pieces)
            run = rows_of(run, 0, added)
        blocks_and_rest = None
        if run is not None:
            plan = _planned(rest, run, next_pieces, radius_m, limits, dense)
            blocks_and_rest = None if plan is None else _window(plan, limits, gap, now_s, horizon_s)
            del plan
        if blocks_and_rest is None and rest is not None:
            # No feasible continuation is known: the plan ends in a rest.
            blocks = _as_polynomials(rest.to_rest(), limits, now_s)
            assert blocks is not None  # true when it was kept
            blocks_and_rest = blocks, None
            if run is not None:
                ahead.put_back(run)
                next_pieces = run  # the run goes on
        elif blocks_and_rest is None and run is not None:
            plan = _planned(None, run, None, radius_m, limits, dense)
            blocks = [] if plan is None else [in_time(_solved(plan, gap).to_rest(), limits, now_s)]
            del plan
            blocks_and_rest = blocks, None
        blocks, rest = blocks_and_rest if blocks_and_rest is not None else ([], None)
        yield from blocks
        now_s = blocks[-1].end_s if blocks else now_s
        if next_pieces is None:
            return run, now_s


def _window(
    plan: _Plan, limits: Limits, gap: float, begin_s: float, horizon_s: float
) -> tuple[list[TrajectoryBlock], _RestOfPlan | None] | None:
    """Return the motion up to the horizon, and the rest of the plan.

    None if either exceeds a limit as polynomials in time.
    """
    rests = plan.shape.ending is None
    plan.problem.settled_s = 0.0 if rests else 0.5 * horizon_s
    solved = _solved(plan, gap)
    if rests:
        blocks = _as_polynomials(solved.to_rest(), limits, begin_s)
        return None if blocks is None else (blocks, None)
    motion, rest = solved.left(solved.before(horizon_s))
    del solved
    blocks = _as_polynomials(motion, limits, begin_s)
    if blocks is None or _as_polynomials(rest.to_rest(), limits, 0.0) is None:
        return None
    return blocks, rest


def _as_polynomials(
    solution: Solution, limits: Limits, begin_s: float
) -> list[TrajectoryBlock] | None:
    """Return a motion as polynomials in time, None if they exceed a limit."""
    blocks: list[TrajectoryBlock] = []
    for part in solution.parts(_AT_A_TIME):
        block = as_it_is(part, limits, begin_s, _LONGER)
        if block is None:
            return None
        blocks.append(block)
        begin_s = block.end_s
    return blocks


@dataclass(slots=True, eq=False)
class _Plan:
    """A problem with a starting motion, and borders and shape as in ``_RestOfPlan``."""

    problem: Problem
    ending: FloatArray
    borders: FloatArray
    shape: RunElements


def _planned(
    rest: _RestOfPlan | None,
    run: PieceBlock,
    next_pieces: PieceBlock | None,
    radius_m: FloatArray,
    limits: Limits,
    dense: bool,
) -> _Plan | None:
    """Return a motion through the kept plan and ``run``, and slowly on into ``next_pieces``.

    None if none is known; without ``next_pieces`` it comes to rest.
    """
    previous, is_dense = None, True if dense else None
    if rest is not None:
        previous, is_dense = rest.shape, is_dense if rest.cut < _CUT else False
    shape = run_elements(
        run,
        radius_m,
        limits,
        previous,
        to_rest=next_pieces is None,
        dense=is_dense,
        slow=SLOW_PIECES,
    )
    if shape is None:
        return None
    level = None if rest is None else float(rest.b[-1])
    slow_motion = _slow_way(shape, level, next_pieces, radius_m, limits)
    if slow_motion is None:
        return None
    b, tangent, held, ending = slow_motion
    borders, elements = _ends_of(shape), shape.elements
    if rest is not None:
        borders = np.concatenate([rest.borders, rest.borders[-1] + borders])
        elements = join([rest.elements, elements])
        b = np.concatenate([rest.b[:-1], b[1:]])
        tangent = np.concatenate([rest.tangent, tangent])
    problem = Problem(elements, limits, begun=(b, tangent))
    if not problem.most_used() < 1.0:
        return None
    problem.held = (0 if rest is None else 2, held)
    problem.fresh = 0.0 if rest is None else rest.fresh
    return _Plan(problem=problem, ending=ending, borders=borders, shape=shape)


def _slow_way(
    shape: RunElements,
    level: float | None,
    next_pieces: PieceBlock | None,
    radius_m: FloatArray,
    limits: Limits,
) -> tuple[FloatArray, FloatArray, int, FloatArray] | None:
    """Return a slow motion, its tangents, the number of constant end coefficients, and a rest.

    The rest is given by the coefficients of a motion through the ending of ``shape``.

    Parameters
    ----------
    level
        The constant x with which it begins, None if it begins at rest.
    next_pieces
        The next pieces: the motion ends in pieces of constant x from which it can continue or
        rest. Without them it ends at rest.
    """
    elements, n = shape.elements, len(shape.elements)
    largest_x = np.full(n, np.inf)
    if next_pieces is None or shape.ending is None:
        slow_motion = _from_level(elements, limits, largest_x, level)
        return (
            None
            if slow_motion is None
            else (slow_motion.b, slow_motion.tangent, 0, slow_motion.b[:0])
        )
    if len(shape) < 3 * shape.slow:
        return None
    element_ends = np.cumsum(elements.length)
    zone_length = (1.0 - _EVEN) * shape.length[-shape.slow - 1 :].sum()  # and one to slow down in
    count = int((element_ends > element_ends[-1] - zone_length).sum())
    next_elements = run_elements(next_pieces, radius_m, limits, shape, to_rest=False, dense=True)
    if next_elements is not None:
        elements = join([elements, next_elements.elements])
    largest_x = np.append(largest_x, np.full(len(elements) - n, np.inf))
    end_x = _SLOW * float(evenly(elements, limits)[n - count :].min())
    rest_x = np.full(len(shape.ending), np.inf)
    for _ in range(_TRIES):
        largest_x[n - count : n + 1], rest_x[0] = end_x, end_x
        slow_motion, rest_motion = (
            _from_level(elements, limits, largest_x, level),
            Problem(shape.ending, limits, rest_x),
        )
        if slow_motion is None:
            return None
        end_coefficients = np.concatenate([slow_motion.b[n - count + 1 : n + 2], rest_motion.b[:2]])
        if _is_even(end_coefficients, end_x):
            b = np.append(slow_motion.b[: n + 1], end_x)
            b[n - count + 1 :] = rest_motion.b[:2] = end_x
            return b, slow_motion.tangent[:n], count + 1, rest_motion.b
        end_x = _SLOWER * float(end_coefficients.min())
    return None


def _from_level(
    elements: Elements, limits: Limits, largest_x: FloatArray, level: float | None
) -> Problem | None:
    """Return a slow motion, with (n,) x of at most ``largest_x``, that begins with a constant x.

    A slow motion speeds up as soon as it may, and is slowed around places where its jerk is then
    too large. If these are at its beginning, it stays constant for some elements first.
    """
    for held in _HELD:
        x_limits = largest_x.copy()
        if level is not None:
            x_limits[:held] = np.minimum(x_limits[:held], level)
        slow_motion = Problem(elements, limits, x_limits)
        if _is_even(slow_motion.b[:2], level):
            return slow_motion
    return None


def _is_even(x: FloatArray, level: float | None) -> bool:
    return level is None or bool((np.abs(x - level) <= _EVEN * level).all())


def _braking_s(limits: Limits) -> float:
    """Return the time that the slowest axis takes to brake from its velocity limit to rest."""
    v, a, j = limits.velocity, np.minimum(*limits.accelerations), limits.jerk
    with np.errstate(invalid="ignore", over="ignore"):
        braking_time_s = np.where(v * j > a**2, v / a + a / j, 2.0 * np.sqrt(v / j))
    return float(np.max(braking_time_s[np.isfinite(braking_time_s)], initial=0.0))


def _solved(plan: _Plan, gap: float) -> _RestOfPlan:
    """Return the fastest motion of a plan; the plan is not needed afterwards."""
    problem = plan.problem
    problem.solve(gap)
    problem.rows = None
    return _RestOfPlan(
        elements=problem.elements,
        b=problem.b,
        tangent=problem.tangent,
        ending=plan.ending,
        borders=plan.borders,
        shape=plan.shape,
        fresh=float(problem.elements.length[: problem.settled()].sum()),
        cut=len(problem.elements) / len(plan.borders),
    )


def _place(elements: Elements, b: FloatArray, to_go_s: float) -> float:
    """Return the place in the common parameter from which a motion takes about ``to_go_s``."""
    after_s = np.cumsum((bernstein(b, elements.length) ** -0.5).mean(axis=1)[::-1])
    return float(elements.length[: len(after_s) - int(np.searchsorted(after_s, to_go_s))].sum())


def _ends_of(shape: RunElements) -> FloatArray:
    """Return the (n,) ends of the pieces; a lead-in lengthens the first."""
    total = float(shape.elements.length.sum())
    return np.asarray(total - (shape.length.sum() - np.cumsum(shape.length)))
