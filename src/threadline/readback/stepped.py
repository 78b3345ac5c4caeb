"""Comparison of a firmware's steps with the plan: the place of each axis, and the time."""

from __future__ import annotations

import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.errors import OptionError
from threadline.motion.timing.types import Trajectory
from threadline.readback.equal_found import Curve, thinned

_FINE = 200_000  # instants at which a reference is sampled
_MOST_PLACES = 50_000  # steps whose distance from the path is measured, evenly chosen
_SEARCH_PIECES = 48  # pieces of the path on which each step is searched


def compile_code(words: list[str], code: str, remedy: str, folder: Path | None = None) -> None:
    """Run a compiler in a folder.

    Raises
    ------
    OptionError
        If the code of a firmware does not compile; it names the first error.
    """
    finished = subprocess.run(  # noqa: S603
        words, cwd=folder, capture_output=True, text=True, errors="replace", check=False
    )
    if finished.returncode:
        lines = finished.stderr.splitlines()
        first = next((line for line in lines if "error" in line), f"{words[0]} fails")
        raise OptionError(f"{code} does not compile: {first[:160]}", remedy=remedy)


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
    time_s = np.concatenate([axis_steps.time_s for _, axis_steps in moving] or [np.zeros(0)])
    change = np.zeros((len(time_s), len(axes)), dtype=np.int64)
    begin = 0
    for column, axis_steps in moving:
        change[begin : begin + len(axis_steps.sense), column] = axis_steps.sense
        begin += len(axis_steps.sense)
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
            at_rest = np.abs(places[:, k])
            if at_rest.max() > max(off, 1.0):
                off, worst, at_s = (
                    float(at_rest.max()),
                    axis,
                    float(fine_s[int(np.argmax(at_rest))]),
                )
            continue
        axis_steps = steps[axis]
        middle_counts = axis_steps.made - 0.5 * axis_steps.sense
        due_si = reference(np.clip(axis_steps.time_s, 0.0, reference.duration_s))[:, k] - start[k]
        counts_apart = np.abs(due_si * counts[k] - middle_counts)
        end = abs(float(places[-1, k]) - float(axis_steps.made[-1]))
        if max(float(counts_apart.max()), end) > off:
            off, worst = max(float(counts_apart.max()), end), axis
            at_s = (
                float(axis_steps.time_s[int(np.argmax(counts_apart))])
                if counts_apart.max() >= end
                else fine_s[-1]
            )
        times.append(axis_steps.time_s)
        offs.append(counts_apart)
    time_s, counts_made = merged_steps(steps, axes)
    # How far both have gone, each step of an axis counted once, tells where they are on the path.
    steps_gone = np.arange(1, len(time_s) + 1, dtype=np.float64) - 0.5
    path_counts = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(places, axis=0)).sum(axis=1))])
    slack = float(len(axes))
    low, high = (
        np.clip(np.searchsorted(path_counts, steps_gone + sign * slack), 0, _FINE - 1)
        for sign in (-1, 1)
    )
    lateness_s = time_s - np.clip(time_s, fine_s[low], fine_s[high])
    m_per_count = radius_m / counts
    chosen = slice(None, None, max(1, -(-len(time_s) // _MOST_PLACES)))
    low, high = (
        np.clip(np.searchsorted(path_counts, steps_gone[chosen] + sign * 4.0 * slack), 0, _FINE - 1)
        for sign in (-1, 1)
    )
    path_distances = _from_path(counts_made[chosen] * m_per_count, places * m_per_count, low, high)
    order = np.argsort(np.concatenate(times), kind="stable")
    curve_s, counts_apart = thinned(np.concatenate(times)[order], np.concatenate(offs)[order])
    slowest = int(np.argmax(np.abs(lateness_s))) if len(lateness_s) else 0
    farthest = int(np.argmax(path_distances)) if len(path_distances) else 0
    return Beside(
        off=off,
        axis=worst,
        at_s=at_s,
        path_m=float(path_distances[farthest]) if len(path_distances) else 0.0,
        path_at_s=float(time_s[chosen][farthest]) if len(path_distances) else 0.0,
        late_s=float(lateness_s[slowest]) if len(lateness_s) else -reference.duration_s,
        curve=Curve(
            time_s=curve_s, place=counts_apart, late_s=_values_at(curve_s, time_s, lateness_s)
        ),
        path_curve=Curve(
            time_s=curve_s,
            place=_values_at(curve_s, time_s[chosen], path_distances),
            late_s=_values_at(curve_s, time_s, lateness_s),
        ),
    )


def _values_at(instants_s: FloatArray, time_s: FloatArray, values: FloatArray) -> FloatArray:
    interpolated: FloatArray = (
        np.interp(instants_s, time_s, values) if len(time_s) else np.zeros(len(instants_s))
    )
    return interpolated


def _from_path(made_m: FloatArray, path_m: FloatArray, low: IntArray, high: IntArray) -> FloatArray:
    """Return the distance of each of n places from the path between the points low and high."""
    least_m = np.full(len(made_m), np.inf)
    end = path_m[np.clip(low, 0, len(path_m) - 1)]
    for share in np.linspace(0.0, 1.0, _SEARCH_PIECES)[1:]:
        begin, end = end, path_m[np.ceil(low + share * (high - low)).astype(np.int64)]
        step = end - begin
        length2 = (step**2).sum(axis=1)
        projection = ((made_m - begin) * step).sum(axis=1)
        share_on_piece = np.divide(
            projection, length2, out=np.zeros_like(projection), where=length2 > 0.0
        )
        nearest = begin + np.clip(share_on_piece, 0.0, 1.0)[:, None] * step
        least_m = np.minimum(least_m, np.linalg.norm(made_m - nearest, axis=1))
    return least_m
