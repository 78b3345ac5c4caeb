"""Comparison of a firmware's steps with the plan: the place of each axis, and the time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.motion.timing.types import Trajectory
from threadline.readback.equal_found import Curve, thinned

_FINE = 200_000  # instants at which a reference is sampled
_MOST_PLACES = 50_000  # steps whose distance from the path is measured, evenly chosen
_LOOKS = 48  # pieces of the path on which each step is searched


@dataclass(frozen=True, slots=True, eq=False)
class Steps:
    """Steps of an axis: (n,) instants, s, and (n,) directions, 1 or -1."""

    time_s: FloatArray
    sense: IntArray

    @property
    def made(self) -> IntArray:
        """(n,) position of the axis after each step, in steps."""
        return np.cumsum(self.sense)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Beside:
    """The differences between steps and a reference.

    Parameters
    ----------
    off
        Largest distance of a step from the reference at the same instant, in steps of its axis.
    axis, at_s
        Axis and instant of that step.
    late_s
        Largest time between a step and the reference at the same place, s; the place may differ by
        one step on either side.
    path_m, path_at_s
        Largest distance of a step from the path of the reference at the tool, m, and its instant.
    curve, path_curve
        Over time: steps at the same instant, and distances from the path; both with the lateness.
    """

    off: float
    axis: str
    at_s: float
    late_s: float
    path_m: float
    path_at_s: float
    curve: Curve
    path_curve: Curve


def merged_steps(steps: Mapping[str, Steps], axes: Sequence[str]) -> tuple[FloatArray, IntArray]:
    """Return (n,) instants of all steps in order, and (n, axes) positions after each, in steps."""
    moving = [(k, steps[axis]) for k, axis in enumerate(axes) if axis in steps]
    time_s = np.concatenate([own.time_s for _, own in moving] or [np.zeros(0)])
    change = np.zeros((len(time_s), len(axes)), dtype=np.int64)
    begin = 0
    for column, own in moving:
        change[begin : begin + len(own.sense), column] = own.sense
        begin += len(own.sense)
    order = np.argsort(time_s, kind="stable")
    return time_s[order], np.cumsum(change[order], axis=0)


def beside(
    steps: Mapping[str, Steps],
    reference: Trajectory,
    counts: FloatArray,
    start: FloatArray,
    radius_m: FloatArray,
) -> Beside:
    """Compare steps with a trajectory that begins at instant 0.

    Parameters
    ----------
    counts
        (axes,) steps per m or rad of each axis.
    start
        (axes,) place of the trajectory at which the axes have made no step, m or rad.
    radius_m
        (axes,) radius at which each axis acts at the tool: m per rad, 1 for a linear axis.
    """
    axes = reference.axes
    fine_s = np.linspace(0.0, reference.duration_s, _FINE)
    places = (reference(fine_s) - start) * counts
    off, worst, at_s = 0.0, "", 0.0
    times, offs = [np.zeros(0)], [np.zeros(0)]
    for k, axis in enumerate(axes):
        if axis not in steps:
            still = np.abs(places[:, k])
            if still.max() > max(off, 1.0):
                off, worst, at_s = float(still.max()), axis, float(fine_s[int(np.argmax(still))])
            continue
        own = steps[axis]
        middle = own.made - 0.5 * own.sense
        due = reference(np.clip(own.time_s, 0.0, reference.duration_s))[:, k] - start[k]
        apart = np.abs(due * counts[k] - middle)
        end = abs(float(places[-1, k]) - float(own.made[-1]))
        if max(float(apart.max()), end) > off:
            off, worst = max(float(apart.max()), end), axis
            at_s = float(own.time_s[int(np.argmax(apart))]) if apart.max() >= end else fine_s[-1]
        times.append(own.time_s)
        offs.append(apart)
    time_s, made = merged_steps(steps, axes)
    # How far both have gone, each step of an axis counted once, tells where they are on the path.
    own_way = np.arange(1, len(time_s) + 1, dtype=np.float64) - 0.5
    way = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(places, axis=0)).sum(axis=1))])
    slack = float(len(axes))
    low, high = (
        np.clip(np.searchsorted(way, own_way + sign * slack), 0, _FINE - 1) for sign in (-1, 1)
    )
    late = time_s - np.clip(time_s, fine_s[low], fine_s[high])
    to_tool = radius_m / counts
    some = slice(None, None, max(1, -(-len(time_s) // _MOST_PLACES)))
    low, high = (
        np.clip(np.searchsorted(way, own_way[some] + sign * 4.0 * slack), 0, _FINE - 1)
        for sign in (-1, 1)
    )
    away = _from_path(made[some] * to_tool, places * to_tool, low, high)
    order = np.argsort(np.concatenate(times), kind="stable")
    when, apart = thinned(np.concatenate(times)[order], np.concatenate(offs)[order])
    slowest = int(np.argmax(np.abs(late))) if len(late) else 0
    farthest = int(np.argmax(away)) if len(away) else 0
    return Beside(
        off=off,
        axis=worst,
        at_s=at_s,
        path_m=float(away[farthest]) if len(away) else 0.0,
        path_at_s=float(time_s[some][farthest]) if len(away) else 0.0,
        late_s=float(late[slowest]) if len(late) else -reference.duration_s,
        curve=Curve(time_s=when, place=apart, late_s=_at(when, time_s, late)),
        path_curve=Curve(
            time_s=when, place=_at(when, time_s[some], away), late_s=_at(when, time_s, late)
        ),
    )


def _at(when: FloatArray, time_s: FloatArray, values: FloatArray) -> FloatArray:
    found: FloatArray = np.interp(when, time_s, values) if len(time_s) else np.zeros(len(when))
    return found


def _from_path(made_m: FloatArray, path_m: FloatArray, low: IntArray, high: IntArray) -> FloatArray:
    """Return the distance of each of n places from the path between the points low and high."""
    best = np.full(len(made_m), np.inf)
    end = path_m[np.clip(low, 0, len(path_m) - 1)]
    for share in np.linspace(0.0, 1.0, _LOOKS)[1:]:
        begin, end = end, path_m[np.ceil(low + share * (high - low)).astype(np.int64)]
        way = end - begin
        squared = (way**2).sum(axis=1)
        along = ((made_m - begin) * way).sum(axis=1)
        part = np.divide(along, squared, out=np.zeros_like(along), where=squared > 0.0)
        nearest = begin + np.clip(part, 0.0, 1.0)[:, None] * way
        best = np.minimum(best, np.linalg.norm(made_m - nearest, axis=1))
    return best
