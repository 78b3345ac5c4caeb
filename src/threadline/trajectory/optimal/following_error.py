"""Timing so gentle that the loads follow: the error of the closed loops as a limit."""

from __future__ import annotations

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.errors import PlanError
from threadline.planning_so_far import PLANNING
from threadline.trajectory.optimal.followers import AFTER, BEFORE, Follower, Past, tangents
from threadline.trajectory.optimal.in_time import in_time, slowed
from threadline.trajectory.optimal.motion_limits import Limits
from threadline.trajectory.optimal.path_elements import Elements
from threadline.trajectory.optimal.polished import polished
from threadline.trajectory.optimal.solve import Problem, Solution
from threadline.trajectory.optimal.stray import aligned
from threadline.trajectory.types import TrajectoryBlock

_LEAST, _MOST = 0.02, 100.0  # of an ease
_LEAST_USED = 0.5
_MOST_CHANGE = 1.1  # of the logarithm of a guard, in one round
_GAP = 1e-3  # of the duration
_ROUNDS, _SLOWER_ROUNDS = 6, 10
_SLOWED = 1.3  # power of what is too much, by which a place is slowed
_LONGER, _MOST_LONGER, _LONGEST = 1.01, 1.5, 10  # steps by which a whole run is slowed; how often


def followed(
    elements: Elements, limits: Limits, follower: Follower, past: Past, begin_s: float
) -> TrajectoryBlock:
    """Return the fastest motion of a run that its loads follow within the follower's tolerance.

    The steady error of each acceleration is a guard of the timing. What the loops really make of
    the motion is then worked out, and the guards are eased or tightened where it says so. Where
    the loads still stray too far after some rounds, the motion is slowed about that place.

    Raises
    ------
    PlanError
        If the loads are not within the tolerance however slow the run is.
    """
    ease, straight, most = np.ones(len(elements)), np.ones(len(elements)), None
    problem = Problem(follower.guarded(elements, ease, straight), limits)
    for number in range(_ROUNDS + _SLOWER_ROUNDS):
        if number == 0:
            problem.solve(_GAP)
        else:  # a guard that steps would have its place cut ever finer
            problem.solve(_GAP, cuts=1, idle=False)
        solution = problem.solution()
        block = in_time(solution, limits, begin_s)
        PLANNING.reach(block.end_s, number + 1, _ROUNDS + _SLOWER_ROUNDS)
        strays = follower.strays(past, block)
        if strays.share.max() <= 1.0 and number >= _ROUNDS:
            return polished(problem, block, limits, follower, past)
        middles = middles_s(solution)
        middles *= (block.end_s - begin_s) / middles[-1]
        at = _whose(elements, solution.elements)
        elements = solution.elements
        x = solution.y.max(axis=1) * elements.length**2
        if number < _ROUNDS:
            fresh = straightness(middles, elements, follower)
            straight = 0.5 * (straight[at] + fresh) if number else fresh
            due = np.clip(strays.due(block, begin_s + middles), -_MOST_CHANGE, _MOST_CHANGE)
            # A guard that nothing reaches is tightened from where it would bite.
            bites = np.clip(problem.guards_used(), _LEAST_USED, 1.0)
            ease = ease[at] * np.exp(due) * np.where(due < 0.0, bites, 1.0)
            ease = np.clip(ease, _LEAST, _MOST)
        else:
            over = strays.worst(begin_s + middles)
            ease, straight = ease[at], straight[at]
            known = np.full(len(x), np.inf) if most is None else most[at]
            most = _slowed(known, x, over)
        problem.regard(follower.guarded(elements, ease, straight, most))
    return polished(problem, _slower(block, follower, past), limits, follower, past)


def _slowed(known: FloatArray, x: FloatArray, over: FloatArray) -> FloatArray:
    """Return the (n,) caps ``known``, lowered below ``x`` where the share ``over`` is above 1."""
    lower = np.minimum(known, x * np.maximum(over, 1.0) ** -_SLOWED)
    return np.where(over > 1.0, lower, known)


def _whose(coarse: Elements, fine: Elements) -> IntArray:
    """Return the (n,) elements of ``coarse`` in which those of ``fine`` lie."""
    ends = np.cumsum(coarse.length)
    middles = np.cumsum(fine.length) - 0.5 * fine.length
    return np.minimum(np.searchsorted(ends, middles), len(coarse) - 1)


def _slower(block: TrajectoryBlock, follower: Follower, past: Past) -> TrajectoryBlock:
    """Return the motion slowed evenly until its loads follow."""
    for _ in range(_LONGEST):
        share = float(follower.strays(past, block).share.max())
        if share <= 1.0:
            return block
        block = slowed(block, min(_LONGER * share**0.5, _MOST_LONGER))
    raise PlanError(
        f"the loads stray {share * follower.tolerance_m * 1e3:.3g} mm from the path however slowly "
        f"they are moved; {follower.tolerance_m * 1e3:.3g} mm are allowed",
        remedy="Allow more (--contour), or let the loops settle before: a dwell, or other gains.",
    )


def middles_s(solution: Solution) -> FloatArray:
    """Return the (n,) times from the start to the middle of each element."""
    time_s = (solution.y**-0.5).mean(axis=1)
    return np.asarray(np.cumsum(time_s) - 0.5 * time_s)


def straightness(middles: FloatArray, elements: Elements, follower: Follower) -> FloatArray:
    """Return the (n,) share of an error along the path that stays along it while it is seen.

    Parameters
    ----------
    middles
        (n,) when the motion is in the middle of each element, s.
    """
    lag = follower.lag_s
    return np.asarray(
        aligned(middles, tangents(elements, follower.radius_m), BEFORE * lag, AFTER * lag)
    )
