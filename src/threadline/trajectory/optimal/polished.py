"""The last of a motion that loads follow: how far they stray as rows of the timing itself.

Guards bound accelerations and stand for what the loops make of them: of the right size, and not
exact. From a motion that was found with them, the same barrier goes on with the errors themselves
(``stray_rows``) in their place. These rows are as long as the memory of a loop, so that the matrix
of a step is no longer narrow: it is one that is, with some hundred rows beside it, and solved by
the formula of Woodbury. Rows are of the largest errors and of some between them; what strays too
far beside them is slowed for. A run with too many of both keeps its guards.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.trajectory.optimal import barrier
from threadline.trajectory.optimal.followers import Follower, Past
from threadline.trajectory.optimal.in_time import in_time, slowed
from threadline.trajectory.optimal.motion_limits import Limits
from threadline.trajectory.optimal.solve import Problem, bernstein
from threadline.trajectory.optimal.stray_rows import Rows, stray_rows
from threadline.trajectory.types import TrajectoryBlock

_MOST = 1_000_000  # rows times elements
_ROUNDS = 24
_IDLE = 3  # rounds without much gain, after which no further one is made
_ENOUGH = 5e-4  # of the duration: a smaller gain is not much
_NEAR = 0.6  # of the tolerance: a larger error has a row, where it is the largest about it
_EVERY = (1, 3, 5)  # of other large errors one in so many; ticks have 4 places: all phases of them
_FEW = 5e7  # square of rows times elements, what a step takes: above it rows are of fewer errors
_AIM = 0.995  # of the tolerance
_LITTLE = 1.1  # of the tolerance: with more a motion is not worth to be slowed for it
_SLOWER, _BY_SHARE, _SLOWED_ROUNDS = 1.0001, 0.35, 8  # and by how much it is, at a time
_LEAST_ROOM = 2e-3  # of the tolerance, where a row begins
_FASTER = 1.2  # of x, in one round: the rows are of where it was
_MOST_SLOWER = 0.3  # of x
_WEIGHTS = (3e-2, 3e-3, 1e-3)  # of the barrier, over all slacks, as shares of the duration
_STEPS = 40  # at one weight
_CENTRED = 0.5  # decrement in units of the weight, at which the weight falls
_NEAR_LIMIT = 0.9  # of the way to the nearest row


def polished(
    problem: Problem, block: TrajectoryBlock, limits: Limits, follower: Follower, past: Past
) -> TrajectoryBlock:
    """Return a faster motion that loads follow, ``block`` where none is found.

    Parameters
    ----------
    problem
        Where the search for ``block`` ended; it loses its guards.
    block
        A motion whose loads keep the tolerance of the follower.
    limits, past
        Of axes and drives; the motion before it.
    """
    begin_s = float(block.start_s[0])
    best, least_s, idle = block, np.inf, 0
    at = problem.elements
    problem.regard(
        replace(at, guard=at.guard[:, :, :0], guard_cap=np.full(len(at), np.inf)),
    )
    for _ in range(_ROUNDS):
        solution = problem.solution()
        now = in_time(solution, limits, begin_s)
        strays = follower.strays(past, now)
        kept = _kept(now, float(strays.share.max()), follower, past)
        enough_s = _ENOUGH * (best.end_s - begin_s)
        # Where it goes on to be faster, slowing may gain later what it does not yet.
        idle = 0 if now.end_s < least_s - enough_s else idle + 1
        least_s = min(least_s, now.end_s)
        if kept is not None and kept.end_s < best.end_s:
            idle = 0 if kept.end_s < best.end_s - enough_s else idle
            best = kept
        chosen = _chosen(strays.share, len(at))
        if idle == _IDLE or len(chosen) * len(at) > _MOST:
            break
        _descend(problem, stray_rows(solution, now, strays, chosen))
    return best


def _kept(
    block: TrajectoryBlock, share: float, follower: Follower, past: Past
) -> TrajectoryBlock | None:
    """Return the motion, slowed evenly where its loads stray a little too far by ``share``.

    The rows are of where the motion was, so that most rounds end with some of a hundredth too much.
    """
    for _ in range(_SLOWED_ROUNDS):
        if share <= 1.0 or share > _LITTLE:
            break
        block = slowed(block, _SLOWER * share**_BY_SHARE)
        share = float(follower.strays(past, block).share.max())
    return block if share <= 1.0 else None


def _chosen(share: FloatArray, elements: int) -> IntArray:
    """Return the places of the errors that have rows: as many as are quickly solved with."""
    inside = np.concatenate([[-np.inf], share, [-np.inf]])
    peak = (share >= inside[:-2]) & (share > inside[2:])
    number = np.arange(len(share))
    for every in _EVERY:
        chosen = np.flatnonzero((share > _NEAR) & (peak | (number % every == 0)))
        if len(chosen) ** 2 * elements <= _FEW:
            break
    return chosen


def _descend(problem: Problem, rows: Rows) -> None:
    """Make the motion as fast as its limits and the rows allow, near where it is."""
    at = problem.elements
    length = at.length
    problem.limit(replace(at, guard_cap=_FASTER * bernstein(problem.b, length).max(axis=1)))
    was = problem.b.copy()
    room = _slowed(problem, rows)
    slacks = problem.slacks + len(room)
    for share in _WEIGHTS:
        weight = share * float(barrier.duration(problem.b, length)) / slacks
        for _ in range(_STEPS):
            slack = room - rows.weights @ (problem.b - was)
            step, decrement = _newton(problem, rows.weights, slack, weight)
            if not np.isfinite(step).all():
                break  # rounding ends it here: b keeps within all limits
            if barrier.advance(problem.b, step, length, problem.rows, problem.tangent) <= 0.0:
                break
            barrier.follow(problem.b, length, problem.rows, problem.tangent)
            problem.steps += 1
            if decrement < _CENTRED * weight:
                break
    problem.limit(at)


def _slowed(problem: Problem, rows: Rows) -> FloatArray:
    """Slow the motion evenly until every row has room; return the (m,) rooms from where it was.

    All that a motion uses of its limits falls with x, and so do most errors; one that does not is
    allowed what it has.
    """
    falls = rows.weights @ problem.b
    room = _AIM - rows.share
    lacks = _LEAST_ROOM - room
    due = np.zeros(len(room))
    np.divide(lacks, falls, out=due, where=(lacks > 0.0) & (falls > 0.0))
    slower = min(float(due.max(initial=0.0)), _MOST_SLOWER)
    problem.b = (1.0 - slower) * problem.b
    return np.maximum(room, _LEAST_ROOM - slower * falls)


def _newton(
    problem: Problem, weights: FloatArray, slack: FloatArray, weight: float
) -> tuple[FloatArray, float]:
    """Return the step that rows of (m,) ``slack`` leave of Newton's, and its decrement."""
    matrix, g = barrier.derivatives(
        problem.b, problem.elements.length, problem.rows, problem.tangent, weight
    )
    g = g + weights.T @ (weight / slack)
    step = barrier.solved(matrix, g)
    if len(weights):
        # With B = L D L' and V = W L'^-1 D^-1/2, W B^-1 W' is V V'; so the step is
        # (B + W' S W)^-1 = B^-1 - B^-1 W' (S^-1 + V V')^-1 W B^-1 of -g.
        halved = barrier.halved(matrix, weights)
        inner = halved @ halved.T
        inner[np.diag_indices_from(inner)] += slack**2 / weight
        pushed = weights.T @ np.linalg.solve(inner, weights @ step)
        step = step + barrier.solved(matrix, pushed)
        nearer = weights @ step
        far = np.full(len(slack), np.inf)
        np.divide(slack, nearer, out=far, where=nearer > 0.0)
        step = step * min(1.0, _NEAR_LIMIT * float(far.min()))
    return step, -float(g @ step)
