"""How far loads stray from their path, as linear functions of the timing.

A load is where the taps of its loop put what it was told over the last ticks. Where an element
takes longer by some time, all that is told after it comes later by that time: what a tap weighs
then falls by the speed of that instant. The place of the path that the load is held against comes
later, too; what both have in common takes no load off the path. So with taps h, told speed v, the
load seen at t and its place at t', an error along the unit vector n changes by

    n . sum_j h_j v(t - j T) (D(t') - D(t - j T)),

where D(t) is the sum of what is added to the elements before t.
"""
# mypy: disable-error-code="no-untyped-def,untyped-decorator"

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.compiled import njit
from threadline.trajectory.optimal.followers import Follower, Strays
from threadline.trajectory.optimal.solve import Solution
from threadline.trajectory.types import TrajectoryBlock


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rows:
    """Errors of loads, linear in the coefficients of a solution.

    Parameters
    ----------
    weights
        (m, n + 2) shares of the tolerance for a unit of each coefficient.
    share
        (m,) of the tolerance, as it is.
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
        The motion, and the same in time.
    strays
        What its loads make of it; the errors of the places are not 0.
    chosen
        (m,) indices of places.
    """
    follower = strays.follower
    tau = (solution.y**-0.5).mean(axis=1)
    tau *= (block.end_s - block.start_s[0]) / tau.sum()
    start = block.start_s[0] + np.concatenate([[0.0], np.cumsum(tau)[:-1]])
    errors = strays.error_m[chosen]
    towards = errors / np.linalg.norm(errors, axis=1, keepdims=True)
    step = float(strays.time_s[1] - strays.time_s[0])
    seen_s = strays.time_s[0] + strays.tick[chosen] * strays.fine * step
    rows = np.zeros((len(chosen), len(tau)))
    for k, (period_s, taps) in enumerate(_taps(follower)):
        told_s = (seen_s[:, None] - np.arange(len(taps)) * period_s)[:, ::-1]
        inside = (told_s >= block.start_s[0]) & (told_s <= block.end_s)
        speed = np.zeros(told_s.shape)
        speed[inside] = block.evaluate(told_s[inside], 1)[:, k] * follower.radius_m[k]
        weight = towards[:, k, None] * taps[::-1] * speed
        passed = np.clip((strays.time_s[chosen, None] - start) / tau, 0.0, 1.0)
        rows += weight.sum(axis=1)[:, None] * passed
        rows -= _passed(weight, np.ascontiguousarray(told_s), start, tau)
    by_y = -0.5 / 3.0 * solution.y**-1.5 / follower.tolerance_m
    return Rows(
        weights=_by_coefficients(rows[:, :, None] * by_y, solution.elements.length),
        share=strays.share[chosen],
    )


def _taps(follower: Follower) -> list[tuple[float, FloatArray]]:
    """Return the tick and the taps of each axis; one tap where it is where it is told to be."""
    return [
        (0.0, np.ones(1)) if answer is None else (answer.period_s, answer.taps)
        for answer in follower.answers
    ]


@njit()
def _passed(weight, times_s, start, tau):
    """Return (m, n) sums of (m, t) weights times the share of an element passed at rising times."""
    many, width = weight.shape
    out = np.empty((many, len(start)))
    mass, moment = np.zeros(width + 1), np.zeros(width + 1)
    for r in range(many):
        for j in range(width):
            mass[j + 1] = mass[j] + weight[r, j]
            moment[j + 1] = moment[j] + weight[r, j] * times_s[r, j]
        low, high = 0, 0
        for i in range(len(start)):
            while low < width and times_s[r, low] < start[i]:
                low += 1
            while high < width and times_s[r, high] < start[i] + tau[i]:
                high += 1
            within = moment[high] - moment[low] - start[i] * (mass[high] - mass[low])
            out[r, i] = mass[width] - mass[high] + within / tau[i]
    return out


def _by_coefficients(by_y: FloatArray, length: FloatArray) -> FloatArray:
    """Return (m, n + 2) derivatives by b of what has (m, n, 3) derivatives by y."""
    n = len(length)
    before = np.concatenate([[0.0], length[:-1]])
    after = np.concatenate([length[1:], [0.0]])
    first, middle, last = (by_y / (length**2)[:, None]).transpose(2, 0, 1)
    out = np.zeros((len(by_y), n + 2))
    out[:, :n] += first * (length / (before + length))
    out[:, 1 : n + 1] += first * (before / (before + length)) + middle
    out[:, 1 : n + 1] += last * (after / (length + after))
    out[:, 2:] += last * (length / (length + after))
    return out
