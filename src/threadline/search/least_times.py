"""Lower bounds of the time that a job takes: along the path of a plan, and along any path.

One bound along the path of a plan keeps velocity, acceleration and jerk of the axes; another keeps
volts and current of their drives, too. A bound for any path considers one axis at a time.
Independently of the other axes, the axis travels from each reversal to the next, and may reverse
before both by the allowed deviation. The slowest axis bounds the job.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.dynamics.table_ends import EARLIEST
from threadline.files import Stream
from threadline.jobs.operations import Job
from threadline.machine import Machine
from threadline.machine.vary import with_reserve
from threadline.motion.path import plan_path, programmed_path
from threadline.motion.path.interpolations import OPTIMAL
from threadline.motion.path.types import ProgrammedPath, VertexBlock
from threadline.motion.timing.optimal.fastest_motion import least_time_s
from threadline.motion.timing.optimal.motion_limits import axis_limits, limits_of
from threadline.proof.options import Options
from threadline.proof.pipeline import plan_job


@dataclass(frozen=True, slots=True, kw_only=True)
class Bound:
    """A lower bound on the time along a path.

    Parameters
    ----------
    within
        Limits that the bound keeps: ``"the axes"``, or ``"axes and drives"``.
    duration_s
        The least time within these limits.
    """

    within: str
    duration_s: float


def bounds_of(job: Job, machine: Machine, options: Options) -> tuple[Bound, ...]:
    """Return the least times within the limits of the axes, and of axes and drives."""
    without_allowance = replace(options, feed_forward_s=None, contour_m=math.inf)
    path = plan_job(job, machine, without_allowance).motion.path
    # A table may end before the loads are at rest; this is the largest time that it saves thereby.
    early_end_s = 0.0
    if options.timing.ends_m is not None:
        early_end_s = EARLIEST * _tick_s(machine)
    of_loads = not options.follows_contour
    reserved = with_reserve(machine, options.reserve)
    drives = limits_of(reserved, path.axes, path.radius_m, of_loads=of_loads)
    return tuple(
        Bound(within=within, duration_s=max(least_time_s(path, limits) - early_end_s, 0.0))
        for within, limits in (
            ("the axes", axis_limits(machine, path.axes, path.radius_m)),
            ("axes and drives", drives),
        )
    )


def least_on_any_path(
    job: Job, machine: Machine, options: Options, within_m: float
) -> tuple[Bound, ...]:
    """Return about the least time of any plan that leaves the program by ``within_m`` at most.

    Volts and current are used in full. The least time of each axis is accurate to about half a
    percent.
    """
    timing = options.timing
    programmed = programmed_path(job, machine, feed=timing.feed, at_limits=True)
    blocks = list(programmed)
    positions = np.concatenate([block.positions for block in blocks])
    rests = np.concatenate([block.rest for block in blocks])
    without_reserve = with_reserve(machine, (0.0, 0.0))
    times_s = [0.0]
    for k, axis in enumerate(programmed.axes):
        radius_m = programmed.radius_m[k : k + 1]
        reversals = shortened_way(positions[:, k], rests, within_m / float(radius_m[0]))
        if len(reversals) < 2:
            continue
        axis_path = ProgrammedPath(
            axes=(axis,), radius_m=radius_m, blocks=Stream(_one_block, _to_and_fro(reversals))
        )
        path = plan_path(axis_path, without_reserve, OPTIMAL, _SHARP * within_m)
        times_s.append(least_time_s(path, limits_of(without_reserve, (axis,), radius_m)))
    early_end_s = 0.0 if options.timing.ends_m is None else EARLIEST * _tick_s(machine)
    least_s = max(times_s) - early_end_s
    within = f"axes and drives on any path within {within_m * 1e3:g} mm"
    return (Bound(within=within, duration_s=least_s),) if least_s > 0.0 else ()


def _tick_s(machine: Machine) -> float:
    return float(machine.tick_clock.period_s)


_SHARP = 1e-3  # path tolerance at the reversals of one axis, as a share of the allowed deviation


def shortened_way(places: FloatArray, rests: IntArray, within: float) -> FloatArray:
    """Return the (m,) positions at which an axis must reverse, shortened by the allowed deviation.

    Parameters
    ----------
    places
        (n,) positions of the axis in the order of the program.
    rests
        (n,) whether the motion is at rest at the position; a rest ends a stretch of the motion.
    within
        Largest distance from the program, in the unit of the axis.
    """
    reversals = [float(places[0])]
    direction = 0.0
    farthest = float(places[0])
    for position, rest in zip(places[1:].tolist(), rests[1:].tolist(), strict=True):
        if direction == 0.0:
            if abs(position - farthest) > 2.0 * within:
                direction, farthest = math.copysign(1.0, position - farthest), position
        elif (position - farthest) * direction > 0.0:
            farthest = position
        elif (farthest - position) * direction > 2.0 * within:
            reversals.append(farthest - direction * within)
            direction, farthest = -direction, position
        if rest and direction and farthest != reversals[0]:
            reversals.append(farthest - direction * within)
            direction = 0.0
    if direction:
        reversals.append(farthest - direction * within)
    return np.array(reversals)


def _to_and_fro(reversals: FloatArray) -> VertexBlock:
    count = len(reversals)
    rest = np.zeros(count, dtype=np.int64)
    rest[[0, -1]] = 1
    return VertexBlock(
        positions=reversals[:, None],
        operation=np.arange(count),
        nominal_s=np.zeros(count),
        rest=rest,
        dwell_s=np.zeros(count),
        line=np.arange(count),
    )


def _one_block(block: VertexBlock) -> Iterator[VertexBlock]:
    yield block
