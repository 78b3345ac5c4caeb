"""The averages with which loads follow a motion wherever their machine is in its tolerances."""

from __future__ import annotations

from dataclasses import replace
from math import ceil, log2

import numpy as np

from threadline.arrays import FloatArray
from threadline.control.corner_machines import corner_responses
from threadline.control.robust_averages import (
    RobustWeights,
    RunUp,
    StepOfSpeed,
    frequencies_rad_s,
    robust_weights,
)
from threadline.errors import PlanError
from threadline.jobs.operations import FeedMode, Job, Move
from threadline.machine import Machine
from threadline.machine.vary import corners
from threadline.trajectory import Trajectory
from threadline.trajectory.averaged import DEGREE, Averages

TURNS = 4
"""Turns of a needle in which the speed may change: the two stitches before and after a rest."""
_STEPS = 28  # of the spline in the time of a change
_COUNT = 43  # weights: their tails are longer than the change
_SAMPLES = 5  # of the motion in a step of the spline; odd, so that the weights have a middle
_FINE = 4  # instants at which answers are looked at, in a step
_SEEN_S = 2.0
_SAMPLED = (4096, 8192)  # least and most instants: memory grows with them
_LEAST_CHANGE_S = 0.01
_SUPPLY = 0.95  # of the current limit: the supply of a bad day
_PLACE_M = 4.7e-4  # of the 0.5 mm that the founding cases may be off at a corner
_WEAK, _STRONG = 0.9, 0.43  # of it, for the axis with the largest error and for others: 1 in square
_LOOKS = 88  # at the run-up of a motion
_STRAIGHT = 1e-9


def robust_averages(
    planned: Trajectory,
    machine: Machine,
    job: Job,
    radius_m: FloatArray,
    share: float,
    smoothing_s: float | None,
) -> Averages:
    """Return averages over time that leave the least error of speed on nine machines.

    Parameters
    ----------
    planned
        Before it is smoothed; its velocity steps from piece to piece.
    job
        Its needle says how long a change of speed may take, unless ``smoothing_s`` does.
    radius_m
        (axes,) at which the axes act on the job.
    share
        Of the tolerances of loads and springs: the machines are at the ends of it.

    Raises
    ------
    OptionError
        If no load or spring has a tolerance.
    PlanError
        If the job has no needle and no smoothing is given, if the time is too short, or if the
        current does not suffice.
    """
    change_s = _change_s(job) if smoothing_s is None else smoothing_s
    if change_s < _LEAST_CHANGE_S:
        raise PlanError(
            f"a robust plan may change the speed within {change_s * 1e3:.4g} ms, at least "
            f"{_LEAST_CHANGE_S * 1e3:g} ms are needed",
            remedy="Lower the speed of the needle, or give a longer --smoothing.",
        )
    step_s = change_s / _STEPS
    grid_s = step_s / _FINE
    samples = min(max(2 ** ceil(log2(_SEEN_S / grid_s)), _SAMPLED[0]), _SAMPLED[1])
    omega = frequencies_rad_s(grid_s, samples)
    run_up, speeds = _run_up(planned, change_s)
    machines = corners(machine, share)
    axes = []
    for axis, speed, radius in zip(planned.axes, speeds, radius_m, strict=True):
        limit = machine.drive_of(axis).amplifier.current_limit
        axes.append(
            StepOfSpeed(
                speed=float(speed),
                room=_PLACE_M * (1.0 if len(planned.axes) == 1 else np.sqrt(0.5)) / float(radius),
                current_limit_a=np.inf if limit is None else _SUPPLY * limit.si,
                machines=corner_responses(machine, axis, machines, omega),
            )
        )

    def solved(step: StepOfSpeed) -> RobustWeights | None:
        return robust_weights(
            step,
            run_up,
            count=_COUNT,
            step_s=step_s,
            degree=DEGREE,
            grid_s=grid_s,
            samples=samples,
        )

    found: list[RobustWeights] = []
    for name, step in zip(planned.axes, axes, strict=True):
        weights = solved(step)
        if weights is None:
            raise PlanError(
                f"axes.{name}: no average over time changes the speed by {step.speed:.4g} within "
                f"{change_s * 1e3:.4g} ms and {step.current_limit_a:.4g} A on all machines within "
                "the tolerances",
                remedy="Give a longer --smoothing, or lower the speed.",
            )
        found.append(weights)
    if len(axes) > 1:
        # Where two axes meet both are off: what the weaker takes of the room the others give.
        weakest = int(np.argmax([weights.error for weights in found]))
        tried = []
        for column, step in enumerate(axes):
            room = step.room / np.sqrt(0.5) * (_WEAK if column == weakest else _STRONG)
            other = solved(replace(step, room=float(room)))
            if other is None or other.error >= found[weakest].error:
                break
            tried.append(other)
        found = tried if len(tried) == len(axes) else found
    # A sample acts the later the earlier it is in the window of a control point.
    coarse = np.stack([weights.weights[::-1] for weights in found], axis=1)
    return Averages(weights=_refined(coarse), step_s=step_s / _SAMPLES)


def _change_s(job: Job) -> float:
    turns = (
        1.0 / move.feed.value
        for move in job
        if isinstance(move, Move)
        and "stitch" in move.tags
        and move.feed is not None
        and move.feed.mode is FeedMode.INVERSE_TIME
    )
    turn_s = min(turns, default=None)
    if turn_s is None:
        raise PlanError(
            f"{job.name} has no needle that says in which time a robust plan may change its speed",
            remedy='Give it: --smoothing "90 ms". Loads ring less the longer it is.',
        )
    return TURNS * turn_s


def _refined(weights: FloatArray) -> FloatArray:
    """Return the weights of the same averages, of samples ``_SAMPLES`` times as dense.

    A uniform B-spline of degree d is a sum of narrower ones: those of d + 1 moving averages over
    their steps (the two-scale relation of splines).
    """
    mask = np.ones(1)
    for _ in range(DEGREE + 1):
        mask = np.convolve(mask, np.full(_SAMPLES, 1.0 / _SAMPLES))
    spread = np.zeros(((len(weights) - 1) * _SAMPLES + 1, weights.shape[1]))
    spread[::_SAMPLES] = weights
    return np.stack([np.convolve(column, mask) for column in spread.T], axis=1)


def _run_up(planned: Trajectory, change_s: float) -> tuple[RunUp, FloatArray]:
    """Return how the motion comes to its speed from its first rest, and every axis' highest speed.

    Speeds are those of pieces on the whole, as chords at programmed times have them.
    """
    most = np.zeros(len(planned.axes))
    begin_s: float | None = None
    for block in planned:
        steps = block.coefficients[:, 1:].sum(axis=1) / block.duration_s[:, None]
        most = np.maximum(most, np.abs(steps).max(axis=0))
        moving = np.flatnonzero(np.abs(steps).max(axis=1) > 0.0)
        if begin_s is None and len(moving):
            begin_s = float(block.start_s[moving[0]])
    step = RunUp(at_s=np.zeros(1), share=np.ones(1), change_s=change_s)
    if begin_s is None:
        return step, most
    # In the middle of short stretches: where pieces meet the speed may step.
    width_s = 0.5 * change_s / _LOOKS
    looks = begin_s + width_s * (np.arange(_LOOKS) + 0.5)
    middle_s: FloatArray = np.asarray(looks[looks < planned.duration_s])
    speed = np.linalg.norm(planned(middle_s, 1), axis=1)
    gained = np.diff(np.maximum.accumulate(speed), prepend=0.0)
    kept = gained > _STRAIGHT * speed.max(initial=0.0)
    if not kept.any():
        return step, most
    # What is gained between two looks came half-way between them; the first at the start.
    at_s = np.maximum(middle_s[kept] - begin_s - 0.5 * width_s, 0.0)
    return RunUp(at_s=at_s, share=gained[kept] / gained[kept].sum(), change_s=change_s), most
