"""The distance from the path at which a hold would stand.

With feed-forward or a shaper the commands are not the path itself: they are made so that the loads
follow it at the full rate. In a hold the loads come to rest at the commanded positions, which lie
beside the path.
"""

from __future__ import annotations

import math
from math import ceil

import numpy as np

from threadline.live.path_window import HALTS, rest_rows
from threadline.plan import Plan
from threadline.signals import tick_table
from threadline.trajectory import TrajectoryReader
from threadline.verdict import Spec

_AROUND_S = 2.0  # time before and after, in s, in which the nearest place of the path is sought
_FINER = 4  # points of the path for each tick
_AT_ONCE = 1 << 13


def hold_deviation_m(plan: Plan) -> float:
    """Return the largest distance in m from the planned path to the position of a hold.

    Rotary axes are taken at their radius. It is 0 where the commands are the path itself.
    """
    from scipy.spatial import KDTree  # slow to import, and asked for where a run may be held

    motion = plan.motion
    if motion.timed is None:
        return 0.0
    path, table = motion.timed, tick_table(plan.commands)
    period_s = float(table.clock.period_s)
    radius, scale = plan.machine.radius_m, plan.machine.counts_per_unit
    begin_s = motion.rests_s[0]
    stands, worst, tick = table.start_counts.astype(np.float64), 0.0, 0
    for block in table:
        for at in range(0, len(block), _AT_ONCE):
            places = stands + np.cumsum(block.counts[at : at + _AT_ONCE], axis=0)
            first_s = tick * period_s - begin_s - _AROUND_S
            span_s = len(places) * period_s + 2.0 * _AROUND_S
            times_s = first_s + np.linspace(0.0, span_s, ceil(_FINER * span_s / period_s))
            near = path(np.clip(times_s, 0.0, path.duration_s)) * radius
            found, _ = KDTree(near).query(places / scale * radius)
            worst = max(worst, float(np.max(found, initial=0.0)))
            stands, tick = places[-1], tick + len(places)
    return worst


def hold_ahead_m(plan: Plan) -> float:
    """Return the largest distance in m from where loads are meant to be to where a hold has them.

    Both at the same instant, at the tool: with feed-forward the motors are ahead of the loads,
    which come there in a hold. It is 0 where the motors are told what is meant.
    """
    intended = plan.motion.of_loads
    if intended is None:
        return 0.0
    table, reader = tick_table(plan.commands), TrajectoryReader(intended)
    columns = [table.axes.index(axis) for axis in intended.axes]
    radius, scale = plan.machine.radius_m, plan.machine.counts_per_unit
    stands, worst = table.start_counts.astype(np.float64), 0.0
    for block in table:
        places = stands + np.cumsum(block.counts, axis=0)
        time_s = table.clock.times_s(block.first_tick + 1, len(block))
        told = (places / scale * radius)[:, columns]
        meant = reader.ladder(time_s, 1)[:, 0] * radius[columns]
        worst = max(worst, float(np.linalg.norm(told - meant, axis=1).max(initial=0.0)))
        if len(block):
            reader.drop(float(time_s[-1]))
            stands = places[-1]
    return worst


def hold_limit_m(spec: Spec, criterion: str = "contour_error") -> float:
    """Return the limit of a criterion of place, in m; infinite without one."""
    limits = [c.limit for c in spec.criteria if c.name == criterion and c.limit is not None]
    return min(limits, default=float("inf"))


def hold_waits(plan: Plan, spec: Spec, leaves_m: float) -> bool:
    """Return whether a hold waits for the next rest, as elsewhere it would be out of spec.

    Parameters
    ----------
    plan, spec
        The plan, and what is asked of it.
    leaves_m
        The distance from the path at which it would stand; infinite where only rests can be held.
    """
    if leaves_m > hold_limit_m(spec) or not math.isfinite(leaves_m):
        return True
    limit_m = hold_limit_m(spec, "progress_error")
    return leaves_m > 0.0 and math.isfinite(limit_m) and hold_ahead_m(plan) > limit_m


def hold_words(plan: Plan, leaves_m: float, *, waits: bool) -> str:
    """Return what the operator has to know of holds before a run; empty where that is nothing.

    Parameters
    ----------
    plan
        The plan.
    leaves_m, waits
        The distance from the path at which it would stand, and whether it waits for a rest.
    """
    if not 0.0 < leaves_m < math.inf:
        return ""
    ahead_m = hold_ahead_m(plan)
    places = f"{1e3 * leaves_m:.2f} mm beside the path"
    if ahead_m > 0.0:
        places += f" or {1e3 * ahead_m:.2f} mm from where it is due"
    if not waits:
        return f"a hold may stand {places}, within the limit"
    if rests_within(plan):
        return f"a hold may stand {places}, so h stands at the next rest"
    return f"a hold may stand {places}, so h waits for a rest, and there is none before the end"


def rests_within(plan: Plan) -> bool:
    """Return whether the rows of a plan rest between two motions, or stop, so that a hold may."""
    table = tick_table(plan.commands)
    needed, moved = rest_rows(table), -1  # the last row that moves
    for block in table:
        rows = np.flatnonzero((block.counts != 0).any(axis=1)) + block.first_tick
        if moved < 0 and len(rows):
            moved = int(rows[0])  # the rest before it is the start
        if len(rows) and (np.diff(rows, prepend=moved) > needed).any():
            return True
        if any(event.kind in HALTS for event in block.events):
            return True
        moved = int(rows[-1]) if len(rows) else moved
    return False
