"""Deviation of loads from their path, as linear functions of the timing.

The taps of a loop give the load position as a weighted mean of the commands of the last ticks. If
an element takes longer by some time, all later commands come later by that time, and a tap's
contribution falls by the commanded speed at its instant. The point of the path that the load is
compared with comes later, too; a common delay takes no load off the path. So with taps h, commanded
speed v, the load seen at t and its matching point at t', an error along the unit vector n changes
by

    n . sum_j h_j v(t - j T) (D(t') - D(t - j T)),

where D(t) is the total time added to the elements before t.

Guards bound accelerations in place of the loops' real response: approximate, not exact. From a
motion found with guards, the same barrier method continues with the errors themselves
(``stray_rows``). These rows are as long as the memory of a loop, so that the matrix of a step is a
banded one plus some hundred dense rows, solved with the Woodbury formula. Rows are made for the
largest errors and some between them; other errors that exceed the tolerance slow the motion. A run
with too many rows keeps its guards.
"""
# mypy: disable-error-code="no-untyped-def,untyped-decorator"

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.base.progress import PLANNING
from threadline.errors import PlanError
from threadline.motion.timing.optimal import barrier
from threadline.motion.timing.optimal.elements import Elements
from threadline.motion.timing.optimal.followers import (
    AFTER,
    BEFORE,
    Follower,
    Past,
    Strays,
    aligned,
    tangents,
)
from threadline.motion.timing.optimal.in_time import in_time, slowed
from threadline.motion.timing.optimal.motion_limits import Limits
from threadline.motion.timing.optimal.solve import Problem, Solution, bernstein
from threadline.motion.timing.types import TrajectoryBlock


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rows:
    """Errors of loads, linear in the coefficients of a solution.

    Parameters
    ----------
    weights
        (m, n + 2) shares of the tolerance for a unit of each coefficient.
    share
        (m,) shares of the tolerance at present.
    """

    weights: FloatArray
    share: FloatArray


def stray_rows(
    solution: Solution, block: TrajectoryBlock, strays: Strays, chosen: IntArray
) -> Rows:
    """Return rows for the errors at the places ``chosen``.

    Parameters
    ----------
    solution, block
        The motion as elements, and as polynomials in time.
    strays
        Deviations of its loads; the errors at the chosen points are not 0.
    chosen
        (m,) indices of points.
    """
    follower = strays.follower
    tau = (solution.y**-0.5).mean(axis=1)
    tau *= (block.end_s - block.start_s[0]) / tau.sum()
    start = block.start_s[0] + np.concatenate([[0.0], np.cumsum(tau)[:-1]])
    errors = strays.error_m[chosen]
    directions = errors / np.linalg.norm(errors, axis=1, keepdims=True)
    step = float(strays.time_s[1] - strays.time_s[0])
    seen_s = strays.time_s[0] + strays.tick[chosen] * strays.fine * step
    rows = np.zeros((len(chosen), len(tau)))
    for k, (period_s, taps) in enumerate(_taps(follower)):
        reference_s = (seen_s[:, None] - np.arange(len(taps)) * period_s)[:, ::-1]
        inside = (reference_s >= block.start_s[0]) & (reference_s <= block.end_s)
        speed = np.zeros(reference_s.shape)
        speed[inside] = block.evaluate(reference_s[inside], 1)[:, k] * follower.radius_m[k]
        weight = directions[:, k, None] * taps[::-1] * speed
        share_passed = np.clip((strays.time_s[chosen, None] - start) / tau, 0.0, 1.0)
        rows += weight.sum(axis=1)[:, None] * share_passed
        rows -= _passed(weight, np.ascontiguousarray(reference_s), start, tau)
    by_y = -0.5 / 3.0 * solution.y**-1.5 / follower.tolerance_m
    return Rows(
        weights=_by_coefficients(rows[:, :, None] * by_y, solution.elements.length),
        share=strays.share[chosen],
    )


def _taps(follower: Follower) -> list[tuple[float, FloatArray]]:
    """Return the tick and the taps of each axis; a single tap for an axis without a lag."""
    return [
        (0.0, np.ones(1)) if answer is None else (answer.period_s, answer.taps)
        for answer in follower.answers
    ]


@njit()
def _passed(weight, times_s, start, tau):
    """Return (m, n) sums of (m, t) weights times the share of an element passed by each time."""
    row_count, width = weight.shape
    sums = np.empty((row_count, len(start)))
    mass, moment = np.zeros(width + 1), np.zeros(width + 1)
    for r in range(row_count):
        for j in range(width):
            mass[j + 1] = mass[j] + weight[r, j]
            moment[j + 1] = moment[j] + weight[r, j] * times_s[r, j]
        low, high = 0, 0
        for i in range(len(start)):
            while low < width and times_s[r, low] < start[i]:
                low += 1
            while high < width and times_s[r, high] < start[i] + tau[i]:
                high += 1
            partial = moment[high] - moment[low] - start[i] * (mass[high] - mass[low])
            sums[r, i] = mass[width] - mass[high] + partial / tau[i]
    return sums


def _by_coefficients(by_y: FloatArray, length: FloatArray) -> FloatArray:
    """Return (m, n + 2) derivatives by b from (m, n, 3) derivatives by y."""
    n = len(length)
    length_before = np.concatenate([[0.0], length[:-1]])
    length_after = np.concatenate([length[1:], [0.0]])
    first, middle, last = (by_y / (length**2)[:, None]).transpose(2, 0, 1)
    by_b = np.zeros((len(by_y), n + 2))
    by_b[:, :n] += first * (length / (length_before + length))
    by_b[:, 1 : n + 1] += first * (length_before / (length_before + length)) + middle
    by_b[:, 1 : n + 1] += last * (length_after / (length + length_after))
    by_b[:, 2:] += last * (length / (length + length_after))
    return by_b


_MOST_CONSTRAINT_ENTRIES = 1_000_000  # rows times elements
MOST_ROUNDS_OF_ROWS = 24
_IDLE = 3  # rounds without much gain, after which the search stops
_ENOUGH = 5e-4  # of the duration: a smaller gain is not much
_NEAR = 0.6  # of the tolerance: a larger error that is a local maximum gets a row
_EVERY = (1, 3, 5)  # one in so many of other large errors; ticks have 4 points: all phases occur
_FEW = 5e7  # rows squared times elements, the cost of a step; above it fewer errors get rows
_AIM = 0.995  # of the tolerance
_LITTLE = 1.1  # of the tolerance: with more it is not worthwhile to slow a motion
_SLOWER, _BY_SHARE, _SLOWED_ROUNDS = 1.0001, 0.35, 8  # factors of slowing per round, and rounds
_LEAST_ROOM = 2e-3  # of the tolerance, where a row begins
_FASTER = 1.2  # of x, in one round: the rows are linearised at the old x
_MOST_SLOWER = 0.3  # of x
_WEIGHTS = (3e-2, 3e-3, 1e-3)  # of the barrier, over all slacks, as shares of the duration
_STEPS = 40  # at one weight
_CENTRED = 0.5  # decrement in units of the weight, at which the weight falls
_NEAR_LIMIT = 0.9  # of the distance to the nearest row


def polished(
    problem: Problem, block: TrajectoryBlock, limits: Limits, follower: Follower, past: Past
) -> TrajectoryBlock:
    """Return a faster motion that the loads follow; ``block`` if none is found.

    Parameters
    ----------
    problem
        End of the search for ``block``; its guards are removed.
    block
        A motion whose loads keep the tolerance of the follower.
    limits, past
        Limits of axes and drives; the motion before it.
    """
    begin_s = float(block.start_s[0])
    best, least_s, idle = block, np.inf, 0
    elements = problem.elements
    problem.regard(
        replace(elements, guard=elements.guard[:, :, :0], guard_cap=np.full(len(elements), np.inf))
    )
    for _ in range(MOST_ROUNDS_OF_ROWS):
        solution = problem.solution()
        block_now = in_time(solution, limits, begin_s)
        strays = follower.strays(past, block_now)
        block_within = slowed_a_little(block_now, float(strays.share.max()), follower, past)
        enough_s = _ENOUGH * (best.end_s - begin_s)
        # Gains may come in later rounds, so slowing may pay off later.
        idle = 0 if block_now.end_s < least_s - enough_s else idle + 1
        least_s = min(least_s, block_now.end_s)
        if block_within is not None and block_within.end_s < best.end_s:
            idle = 0 if block_within.end_s < best.end_s - enough_s else idle
            best = block_within
        points = places_with_rows(strays.share, len(elements))
        if idle == _IDLE or len(points) * len(elements) > _MOST_CONSTRAINT_ENTRIES:
            break
        _descend(problem, stray_rows(solution, block_now, strays, points))
    return best


def slowed_a_little(
    block: TrajectoryBlock, share: float, follower: Follower, past: Past
) -> TrajectoryBlock | None:
    """Return the motion, slowed evenly if its loads exceed the tolerance by up to a tenth.

    The rows are linearised, so most rounds end with an excess of about a hundredth. None if the
    loads stray more, or still stray after a few rounds.

    Parameters
    ----------
    block
        A motion from rest to rest.
    share
        Largest error of its loads, as a share of the tolerance.
    follower, past
        The loops of the loads, and the motion before ``block``.
    """
    for _ in range(_SLOWED_ROUNDS):
        if share <= 1.0 or share > _LITTLE:
            break
        block = slowed(block, _SLOWER * share**_BY_SHARE)
        share = float(follower.strays(past, block).share.max())
    return block if share <= 1.0 else None


def places_with_rows(share: FloatArray, elements: int) -> IntArray:
    """Return the places whose errors get rows: as many as can be solved quickly.

    They are the peaks near the tolerance, and all, a third or a fifth of the other large errors.

    Parameters
    ----------
    share
        (n,) errors, as shares of the tolerance.
    elements
        Number of elements of the motion: a step costs their number times that of places, squared.
    """
    padded = np.concatenate([[-np.inf], share, [-np.inf]])
    peak = (share >= padded[:-2]) & (share > padded[2:])
    number = np.arange(len(share))
    for every in _EVERY:
        points = np.flatnonzero((share > _NEAR) & (peak | (number % every == 0)))
        if len(points) ** 2 * elements <= _FEW:
            break
    return points


def _descend(problem: Problem, rows: Rows) -> None:
    """Make the motion as fast as its limits and the rows allow, near where it is."""
    elements = problem.elements
    length = elements.length
    problem.limit(replace(elements, guard_cap=_FASTER * bernstein(problem.b, length).max(axis=1)))
    b_before = problem.b.copy()
    room = _slowed_near_rows(problem, rows)
    slacks = problem.slacks + len(room)
    for share in _WEIGHTS:
        weight = share * float(barrier.duration(problem.b, length)) / slacks
        for _ in range(_STEPS):
            slack = room - rows.weights @ (problem.b - b_before)
            step, decrement = newton_step(problem, rows.weights, slack, weight)
            if not np.isfinite(step).all():
                break  # rounding ends it here: b keeps within all limits
            if barrier.advance(problem.b, step, length, problem.rows, problem.tangent) <= 0.0:
                break
            barrier.follow(problem.b, length, problem.rows, problem.tangent)
            problem.steps += 1
            if decrement < _CENTRED * weight:
                break
    problem.limit(elements)


def _slowed_near_rows(problem: Problem, rows: Rows) -> FloatArray:
    """Slow the motion evenly until every row has room; return the (m,) rooms from the old motion.

    All limits of a motion use less as x falls, and so do most errors; an error that does not shrink
    keeps its value as its limit.
    """
    falls = rows.weights @ problem.b
    room = _AIM - rows.share
    missing_room = _LEAST_ROOM - room
    needed_share = np.zeros(len(room))
    np.divide(missing_room, falls, out=needed_share, where=(missing_room > 0.0) & (falls > 0.0))
    slowing = min(float(needed_share.max(initial=0.0)), _MOST_SLOWER)
    problem.b = (1.0 - slowing) * problem.b
    return np.maximum(room, _LEAST_ROOM - slowing * falls)


def newton_step(
    problem: Problem, weights: FloatArray, slack: FloatArray, weight: float
) -> tuple[FloatArray, float]:
    """Return Newton's step, short enough to keep every slack above 0, and its decrement.

    Parameters
    ----------
    weights, slack
        (m, n) and (m,): the rows ask for ``weights @ step < slack``.
    weight
        Weight of the barriers, of the rows and of the limits of the problem.
    """
    matrix, g = barrier.derivatives(
        problem.b, problem.elements.length, problem.rows, problem.tangent, weight
    )
    g = g + weights.T @ (weight / slack)
    step = barrier.solved(matrix, g)
    if len(weights):
        # With B = L D L' and V = W L'^-1 D^-1/2, W B^-1 W' is V V'; so the step is
        # (B + W' S W)^-1 = B^-1 - B^-1 W' (S^-1 + V V')^-1 W B^-1 of -g.
        halved = barrier.halved(matrix, weights)
        inner_matrix = halved @ halved.T
        inner_matrix[np.diag_indices_from(inner_matrix)] += slack**2 / weight
        pushed = weights.T @ np.linalg.solve(inner_matrix, weights @ step)
        step = step + barrier.solved(matrix, pushed)
        approach = weights @ step
        steps_to_row = np.full(len(slack), np.inf)
        np.divide(slack, approach, out=steps_to_row, where=approach > 0.0)
        step = step * min(1.0, _NEAR_LIMIT * float(steps_to_row.min()))
    return step, -float(g @ step)


_LEAST, _MOST = 0.02, 100.0  # of an ease
_LEAST_USED = 0.5
_MOST_CHANGE = 1.1  # of the logarithm of a guard, in one round
_GAP = 1e-3  # of the duration
_FOLLOWING_ERROR_ROUNDS, _SLOWER_ROUNDS = 6, 10
_SLOWED = 1.3  # exponent on the excess share, by which a place is slowed
_LONGER, _MOST_LONGER, _LONGEST = 1.01, 1.5, 10  # steps of slowing a whole run; number of rounds


def followed(
    elements: Elements, limits: Limits, follower: Follower, past: Past, begin_s: float
) -> TrajectoryBlock:
    """Return the fastest motion of a run that its loads follow within the follower's tolerance.

    The steady error of each acceleration is a guard of the timing. The loops' real response is then
    computed, and guards are eased or tightened accordingly. If the loads still exceed the tolerance
    after some rounds, the motion is slowed around that place.

    Raises
    ------
    PlanError
        If the loads exceed the tolerance however slow the run is.
    """
    ease, straight, largest_x = np.ones(len(elements)), np.ones(len(elements)), None
    problem = Problem(follower.guarded(elements, ease, straight), limits)
    for number in range(_FOLLOWING_ERROR_ROUNDS + _SLOWER_ROUNDS):
        if number == 0:
            problem.solve(_GAP)
        else:  # a guard that steps would have its place cut ever finer
            problem.solve(_GAP, cuts=1, idle=False)
        solution = problem.solution()
        block = in_time(solution, limits, begin_s)
        PLANNING.reach(block.end_s, number + 1, _FOLLOWING_ERROR_ROUNDS + _SLOWER_ROUNDS)
        strays = follower.strays(past, block)
        if strays.share.max() <= 1.0 and number >= _FOLLOWING_ERROR_ROUNDS:
            return polished(problem, block, limits, follower, past)
        middles = middles_s(solution)
        middles *= (block.end_s - begin_s) / middles[-1]
        coarse_element = _whose(elements, solution.elements)
        elements = solution.elements
        x = solution.y.max(axis=1) * elements.length**2
        if number < _FOLLOWING_ERROR_ROUNDS:
            new_straight = straightness(middles, elements, follower)
            straight = 0.5 * (straight[coarse_element] + new_straight) if number else new_straight
            log_change = np.clip(strays.due(block, begin_s + middles), -_MOST_CHANGE, _MOST_CHANGE)
            # An inactive guard is tightened from where it would become active.
            active_share = np.clip(problem.guards_used(), _LEAST_USED, 1.0)
            ease = (
                ease[coarse_element]
                * np.exp(log_change)
                * np.where(log_change < 0.0, active_share, 1.0)
            )
            ease = np.clip(ease, _LEAST, _MOST)
        else:
            excess_share = strays.worst(begin_s + middles)
            ease, straight = ease[coarse_element], straight[coarse_element]
            known_caps = np.full(len(x), np.inf) if largest_x is None else largest_x[coarse_element]
            largest_x = caps_where_loads_stray(known_caps, x, excess_share)
        problem.regard(follower.guarded(elements, ease, straight, largest_x))
    return polished(problem, slowed_until_followed(block, follower, past), limits, follower, past)


def caps_where_loads_stray(
    known_caps: FloatArray, x: FloatArray, excess_share: FloatArray
) -> FloatArray:
    """Return (n,) ``known_caps``, lowered below ``x`` where ``excess_share`` is above 1."""
    lowered_caps = np.minimum(known_caps, x * np.maximum(excess_share, 1.0) ** -_SLOWED)
    return np.where(excess_share > 1.0, lowered_caps, known_caps)


def _whose(coarse: Elements, fine: Elements) -> IntArray:
    """Return the (n,) elements of ``coarse`` that contain the elements of ``fine``."""
    ends = np.cumsum(coarse.length)
    middles = np.cumsum(fine.length) - 0.5 * fine.length
    return np.minimum(np.searchsorted(ends, middles), len(coarse) - 1)


def slowed_until_followed(
    block: TrajectoryBlock, follower: Follower, past: Past
) -> TrajectoryBlock:
    """Return the motion slowed evenly until its loads follow.

    Raises
    ------
    PlanError
        If they stray however slowly they are moved.
    """
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
    """Return the (n,) share of an error along the path that stays along it while it shows.

    Parameters
    ----------
    middles
        (n,) time at the middle of each element, s.
    """
    lag = follower.lag_s
    return np.asarray(
        aligned(middles, tangents(elements, follower.radius_m), BEFORE * lag, AFTER * lag)
    )
