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
    freely = replace(options, feed_forward_s=None, contour_m=math.inf)
    path = plan_job(job, machine, freely).motion.path
    # A table may end before the loads are at rest; this is the largest time that it saves thereby.
    sooner_s = 0.0
    if options.timing.ends_m is not None:
        sooner_s = EARLIEST * _tick_s(machine)
    of_loads = not options.follows_contour
    reserved = with_reserve(machine, options.reserve)
    drives = limits_of(reserved, path.axes, path.radius_m, of_loads=of_loads)
    return tuple(
        Bound(within=within, duration_s=max(least_time_s(path, limits) - sooner_s, 0.0))
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
    places = np.concatenate([block.positions for block in blocks])
    rests = np.concatenate([block.rest for block in blocks])
    full = with_reserve(machine, (0.0, 0.0))
    found = [0.0]
    for k, axis in enumerate(programmed.axes):
        radius_m = programmed.radius_m[k : k + 1]
        way = shortened_way(places[:, k], rests, within_m / float(radius_m[0]))
        if len(way) < 2:
            continue
        alone = ProgrammedPath(
            axes=(axis,), radius_m=radius_m, blocks=Stream(_one_block, _to_and_fro(way))
        )
        path = plan_path(alone, full, OPTIMAL, _SHARP * within_m)
        found.append(least_time_s(path, limits_of(full, (axis,), radius_m)))
    sooner_s = 0.0 if options.timing.ends_m is None else EARLIEST * _tick_s(machine)
    least_s = max(found) - sooner_s
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
    ends = [float(places[0])]
    towards = 0.0
    far = float(places[0])
    for place, rest in zip(places[1:].tolist(), rests[1:].tolist(), strict=True):
        if towards == 0.0:
            if abs(place - far) > 2.0 * within:
                towards, far = math.copysign(1.0, place - far), place
        elif (place - far) * towards > 0.0:
            far = place
        elif (far - place) * towards > 2.0 * within:
            ends.append(far - towards * within)
            towards, far = -towards, place
        if rest and towards and far != ends[0]:
            ends.append(far - towards * within)
            towards = 0.0
    if towards:
        ends.append(far - towards * within)
    return np.array(ends)


def _to_and_fro(way: FloatArray) -> VertexBlock:
    count = len(way)
    rest = np.zeros(count, dtype=np.int64)
    rest[[0, -1]] = 1
    return VertexBlock(
        positions=way[:, None],
        operation=np.arange(count),
        nominal_s=np.zeros(count),
        rest=rest,
        dwell_s=np.zeros(count),
        line=np.arange(count),
    )


def _one_block(block: VertexBlock) -> Iterator[VertexBlock]:
    yield block
