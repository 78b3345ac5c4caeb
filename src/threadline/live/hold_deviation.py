"""Effect of a hold or a feed override on the work: distance from the path, and vibration.

With feed-forward or a shaper the commands differ from the path: they make the loads follow the
path, at the full feed only. In a hold the loads come to rest at the commanded positions, which lie
beside the path. If the commands are the path, the axes brake along it as hard as their limits
allow. Such braking may shake a load more than the plan does, so it is simulated. A run with a feed
override is simulated, too: its slower rows may excite a mode that the plan does not.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from math import ceil

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.commands.plan import Plan
from threadline.files import Event, RecordingBlock, Stream, TickBlock, tick_table
from threadline.live.ahead import OVERRIDE_S, ticks_in
from threadline.live.braking import (
    MOST_PLACES,
    CountLimits,
    brake,
    change_rate,
    gentle_hold_ticks,
    most_changed,
    rise,
)
from threadline.live.pace import Pace
from threadline.live.path_window import HALTS, PathWindow, rest_rows
from threadline.live.states import Hold
from threadline.motion.timing import TrajectoryReader
from threadline.proof.pipeline import simulate
from threadline.verdict import Judge, Result, Spec, Status
from threadline.verdict.rendering import shown

_AROUND_S = 2.0  # time before and after, in s, in which the nearest place of the path is sought
_FINER = 4  # points of the path for each tick
_AT_ONCE = 1 << 13
_HOLDS = 8  # simulated holds of a run, one in each part of the table
_PLACES = (None, 0.62, 0.24, 0.86)
"""Place of a hold within each part: None is the fastest row, a number is a share of its rows."""
_STANDS_S = 0.5  # duration of each hold, in which the loads come to rest
_MOST_ROWS = 200_000  # longest table that is simulated with holds
_SPARE = 0.97  # share of a limit that a simulated hold may use
_SLOWER = (0.75, 0.5, 0.25, 0.1)  # rates of simulated overrides


def hold_deviation_m(plan: Plan) -> float:
    """Return the largest distance in m from the planned path to the position of a hold.

    Rotary axes count at their radius. It is 0 if the commands are the path itself.
    """
    from scipy.spatial import KDTree  # slow to import, and needed only if a run may be held

    motion = plan.motion
    if motion.timed is None:
        return 0.0
    path, table = motion.timed, tick_table(plan.commands)
    period_s = float(table.clock.period_s)
    radius, scale = plan.machine.radius_m, plan.machine.counts_per_unit
    begin_s = motion.rests_s[0]
    last_counts, largest_m, tick = table.start_counts.astype(np.float64), 0.0, 0
    for block in table:
        for first in range(0, len(block), _AT_ONCE):
            position_counts = last_counts + np.cumsum(
                block.counts[first : first + _AT_ONCE], axis=0
            )
            first_s = tick * period_s - begin_s - _AROUND_S
            span_s = len(position_counts) * period_s + 2.0 * _AROUND_S
            times_s = first_s + np.linspace(0.0, span_s, ceil(_FINER * span_s / period_s))
            path_points_m = path(np.clip(times_s, 0.0, path.duration_s)) * radius
            distances_m, _ = KDTree(path_points_m).query(position_counts / scale * radius)
            largest_m = max(largest_m, float(np.max(distances_m, initial=0.0)))
            last_counts, tick = position_counts[-1], tick + len(position_counts)
    return largest_m


def hold_ahead_m(plan: Plan) -> float:
    """Return the largest distance in m from the intended position of the loads to a hold.

    Both are taken at the same instant, at the tool. With feed-forward the motors lead the loads,
    and in a hold the loads reach the positions of the motors. The distance is 0 if the commands are
    the intended motion.
    """
    intended = plan.motion.of_loads
    if intended is None:
        return 0.0
    table, reader = tick_table(plan.commands), TrajectoryReader(intended)
    columns = [table.axes.index(axis) for axis in intended.axes]
    radius, scale = plan.machine.radius_m, plan.machine.counts_per_unit
    last_counts, largest_m = table.start_counts.astype(np.float64), 0.0
    for block in table:
        position_counts = last_counts + np.cumsum(block.counts, axis=0)
        times_s = table.clock.times_s(block.first_tick + 1, len(block))
        commanded_m = (position_counts / scale * radius)[:, columns]
        intended_m = reader.derivatives(times_s, 1)[:, 0] * radius[columns]
        largest_m = max(
            largest_m, float(np.linalg.norm(commanded_m - intended_m, axis=1).max(initial=0.0))
        )
        if len(block):
            reader.drop(float(times_s[-1]))
            last_counts = position_counts[-1]
    return largest_m


def hold_limit_m(spec: Spec, criterion: str = "contour_error") -> float:
    """Return the limit of a placement criterion, in m; infinite without one."""
    limits = [c.limit for c in spec.criteria if c.name == criterion and c.limit is not None]
    return min(limits, default=float("inf"))


def hold_waits(plan: Plan, spec: Spec, leaves_m: float) -> bool:
    """Return whether a hold must wait for the next rest, as it would be out of spec elsewhere.

    Parameters
    ----------
    plan, spec
        The plan, and its specification.
    leaves_m
        Distance of a hold from the path; infinite if only rests can be held.
    """
    if leaves_m > hold_limit_m(spec) or not math.isfinite(leaves_m):
        return True
    limit_m = hold_limit_m(spec, "progress_error")
    return leaves_m > 0.0 and math.isfinite(limit_m) and hold_ahead_m(plan) > limit_m


def spoiled_by_holds(plan: Plan, spec: Spec, hold: Hold = Hold.AT_ONCE) -> tuple[Result, ...]:
    """Return the criteria that a hold would put out of specification, as measured.

    Runs on the nominal machine are simulated until one fails. Each run is held once in each of
    ``_HOLDS`` parts of its table; it brakes and starts again as the executor does. The first run is
    held at the fastest row of each part, the others at the shares ``_PLACES``, because the fastest
    rows are not always the worst: where axes with different lags come to rest, the eye of a winder
    swings and may lift the fibre. A criterion that fails without a hold, too, is not counted.
    """
    for share in _PLACES:
        window = PathWindow(tick_table(plan.commands), pass_stops=True)
        places, last_hold_end = _held_places(window, plan, share, _gently(plan, hold))
        if last_hold_end and (spoiled := _spoiled(plan, spec, window, places)):
            return spoiled
    return ()


def spoiled_by_override(plan: Plan, spec: Spec, hold: Hold) -> tuple[int, tuple[Result, ...]]:
    """Return an override in % that would put the work out of specification, and the criteria.

    Returns 100 and no criteria if no override does. For each rate of ``_SLOWER`` two runs on the
    nominal machine are simulated. One run keeps its rate. The other is interrupted at the fastest
    row of each of ``_HOLDS`` parts of its table: it plays at the full feed for a while, or is held,
    in turn.

    Parameters
    ----------
    hold
        When a hold brakes, and how hard.
    """
    table = tick_table(plan.commands)
    for rate in _SLOWER:
        window = PathWindow(table, pass_stops=True)
        row_count = int(window.reach(rate * _MOST_ROWS))
        constant_rate_places = np.minimum(rate * np.arange(ceil(row_count / rate) + 1.0), row_count)
        changing_rate_places = _overridden_places(window, plan, (rate, row_count), hold)
        for places in (_resting(constant_rate_places, window, plan), changing_rate_places):
            if len(places) and (spoiled := _spoiled(plan, spec, window, places)):
                return round(100.0 * rate), spoiled
    return 100, ()


def override_exceeds(plan: Plan) -> int:
    """Return an override in % at which a row asks an axis for more than its limits; 100 if none.

    Between two rows the axes move at constant speed. A row that lasts several ticks therefore has
    its whole change of speed within one tick, which exceeds a limit of jerk where counts are fine.
    """
    table = tick_table(plan.commands)
    limits = CountLimits.of(plan.machine, loads_follow=plan.motion.of_loads is not None)
    for rate in _SLOWER:
        window = PathWindow(table, pass_stops=True)
        row_count = int(window.reach(rate * _MOST_ROWS))
        slower_counts = window.counts(
            np.minimum(rate * np.arange(ceil(row_count / rate) + 1.0), row_count)
        )
        if limits.excess(slower_counts, window.counts(np.arange(row_count + 1.0))) > 1.0:
            return round(100.0 * rate)
    return 100


def _spoiled(plan: Plan, spec: Spec, window: PathWindow, places: FloatArray) -> tuple[Result, ...]:
    """Return the criteria that a run with (n,) places at its ticks brings out of specification."""
    soft_criteria = [c for c in spec.criteria if c.limit and not c.hard]
    narrowed_criteria = tuple(replace(c, limit=_SPARE * (c.limit or 0.0)) for c in soft_criteria)
    if not soft_criteria:
        return ()
    table = tick_table(plan.commands)
    counts = np.diff(window.rounded(places), axis=0)
    operations = window.operations(places[:-1])
    tick_block = TickBlock(first_tick=0, counts=counts, operation=operations)
    simulated = simulate(replace(table, blocks=Stream.of([tick_block])), plan.machine)
    pace, tick_count = Pace(table.clock), len(counts)
    events = (*pace.played(0, places[1:]), *pace.after_end(tick_count, 1))
    recording = replace(
        simulated, blocks=Stream(_with_events, simulated.blocks, events, table.clock.name)
    )
    failed = [
        result
        for result in Judge(plan, replace(spec, criteria=narrowed_criteria))
        .verdict([recording])
        .results
        if result.status is Status.FAILED
    ]
    if failed:
        verdict_without_holds = Judge(plan, spec).verdict([simulate(plan.commands, plan.machine)])
        failed_without_holds = {
            (r.name, r.axis) for r in verdict_without_holds.results if r.status is Status.FAILED
        }
        failed = [
            result for result in failed if (result.name, result.axis) not in failed_without_holds
        ]
    limits = {(c.name, c.axis): c.limit for c in soft_criteria}
    return tuple(
        replace(r, limit=limits.get((r.name, r.axis), limits.get((r.name, "")))) for r in failed
    )


def _gently(plan: Plan, hold: Hold) -> float:
    """Return the shortest duration of the braking of a hold, in ticks."""
    return (
        gentle_hold_ticks(float(plan.machine.tick_clock.period_s)) if hold is Hold.GENTLY else 0.0
    )


def _held_places(
    window: PathWindow, plan: Plan, share: float | None, brake_ticks: float
) -> tuple[FloatArray, int]:
    """Return the (n,) places at the ticks of a run with holds, and the tick after the last hold.

    The tick is 0 if no row moves. The rest of the table after the last hold is played unchanged.
    ``share`` is the place of the holds within their parts, as a share of the rows; None: at the
    fastest row. ``brake_ticks`` is the shortest duration of a braking, in ticks.
    """
    table = tick_table(plan.commands)
    row_count = int(window.reach(_MOST_ROWS))
    m_per_count = plan.machine.radius_m / table.counts_per_unit
    steps_m = np.diff(window.counts(np.arange(row_count + 1.0)), axis=0) * m_per_count
    speeds = np.linalg.norm(steps_m, axis=1)
    limits = CountLimits.of(plan.machine, loads_follow=plan.motion.of_loads is not None)
    rest_ones = np.ones(ceil(_STANDS_S / float(table.clock.period_s)))
    places, last_hold_end = np.arange(3.0), 0
    for begin, end in pairwise(np.linspace(0, row_count, _HOLDS + 1).astype(int).tolist()):
        if end <= begin:
            continue
        row = begin + (
            int(np.argmax(speeds[begin:end])) if share is None else int(share * (end - begin))
        )
        if speeds[row] <= 0.0 or row <= places[-1] or row + 2 >= row_count:
            continue
        places = np.concatenate([places, np.arange(places[-1] + 1.0, row + 1.0)])
        window.reach(places[-1] + MOST_PLACES + most_changed(brake_ticks))
        last_place = float(window.reach(places[-1]))
        last_places = (float(places[-3]), float(places[-2]), float(places[-1]))
        braking_places = np.minimum(brake(window, last_places, limits, brake_ticks), last_place)
        rests_at = float(braking_places[-1]) if len(braking_places) else float(places[-1])
        rising_places = np.minimum(rise(window, rests_at, limits, brake_ticks), last_place)
        places = np.concatenate([places, braking_places, rests_at * rest_ones, rising_places])
        last_hold_end = len(places)
    rest_places = np.arange(np.floor(places[-1]) + 1.0, row_count + 1.0)
    return np.concatenate([places, rest_places]), last_hold_end


def _overridden_places(
    window: PathWindow, plan: Plan, rate_and_end: tuple[float, int], hold: Hold
) -> FloatArray:
    """Return the (n,) places at the ticks of an overridden run; empty if no row moves.

    ``rate_and_end`` is the rate and the row at which the places end; ``hold`` says how a hold
    brakes.
    """
    rate, end_row = rate_and_end
    m_per_count = plan.machine.radius_m / plan.machine.counts_per_unit
    steps_m = np.diff(window.counts(np.arange(end_row + 1.0)), axis=0) * m_per_count
    speeds = np.linalg.norm(steps_m, axis=1)
    if not speeds.any():
        return np.empty(0)
    limits = CountLimits.of(plan.machine, loads_follow=plan.motion.of_loads is not None)
    rest_ticks, override_ticks = (
        ticks_in(_STANDS_S, plan.machine),
        float(ticks_in(OVERRIDE_S, plan.machine)),
    )
    hold_ticks, places = _gently(plan, hold), np.arange(3.0)

    def append_places(new_places: FloatArray) -> None:
        nonlocal places
        places = np.concatenate([places, np.minimum(new_places, end_row)])
        window.reach(places[-1] + rest_ticks + 2.0 * most_changed(max(override_ticks, hold_ticks)))

    def switch_rate(rate_before: float, rate_after: float) -> None:
        duration_ticks = override_ticks if rate_before else hold_ticks
        append_places(
            change_rate(
                window, float(places[-1]), (rate_before, rate_after), limits, duration_ticks
            )
        )

    append_places(np.empty(0))
    switch_rate(1.0, rate)
    for part_index, (begin, end) in enumerate(
        pairwise(np.linspace(0, end_row, _HOLDS + 1).astype(int))
    ):
        fastest_row = begin + int(np.argmax(speeds[begin:end])) if end > begin else begin
        if fastest_row <= places[-1] or fastest_row + 2 >= end_row:
            continue
        append_places(places[-1] + rate * np.arange(1.0, (fastest_row - places[-1]) / rate + 1.0))
        if hold is not Hold.AT_REST and part_index % 2:
            append_places(brake(window, (places[-3], places[-2], places[-1]), limits, hold_ticks))
            append_places(np.full(rest_ticks, places[-1]))
            switch_rate(0.0, rate)
        else:
            switch_rate(rate, 1.0)
            append_places(places[-1] + np.arange(1.0, rest_ticks + 1.0))
            switch_rate(1.0, rate)
    append_places(places[-1] + rate * np.arange(1.0, (end_row - places[-1]) / rate + 1.0))
    if places[-1] < end_row:
        append_places(np.array([float(end_row)]))
    return _resting(places, window, plan)


def _resting(places: FloatArray, window: PathWindow, plan: Plan) -> FloatArray:
    """Return places with a braking after them, if they end before the table does."""
    window.reach(places[-1] + MOST_PLACES)
    limits = CountLimits.of(plan.machine, loads_follow=plan.motion.of_loads is not None)
    if window.at_end and places[-1] >= window.reach(places[-1]):
        return places
    braking_places = brake(window, (places[-3], places[-2], places[-1]), limits)
    return np.concatenate([places, np.minimum(braking_places, window.reach(places[-1]))])


def _with_events(
    blocks: Iterable[RecordingBlock], events: Sequence[Event], clock_name: str
) -> Iterator[RecordingBlock]:
    """Yield blocks with the events ``events``, each in the block of its tick."""
    pending = list(events)
    for block in blocks:
        sample_count = max(map(len, block.samples.values()), default=0)
        due_events = [e for e in pending if e.tick < block.first_tick[clock_name] + sample_count]
        pending = pending[len(due_events) :]
        yield replace(block, events=(*block.events, *due_events))


def hold_words(
    plan: Plan,
    leaves_m: float,
    hold: Hold,
    *,
    spoiled: Sequence[Result] = (),
    at_once: bool = False,
) -> str:
    """Return a note on holds for the operator before a run; empty if there is nothing to say.

    Parameters
    ----------
    plan
        The plan.
    leaves_m, hold
        Distance of a hold from the path, and how the run is held.
    spoiled
        The criteria that a hold would bring out of specification, by simulation.
    at_once
        Whether the controller holds on its path by itself, and waits for no rest.
    """
    if spoiled and math.isfinite(leaves_m):
        criteria_words = _results_words(spoiled)
        if at_once:
            return (
                "the controller holds at once: at full speed that shakes the load "
                f"({criteria_words})"
            )
        shaken = f"braking at full speed would shake the load ({criteria_words})"
        if hold is Hold.GENTLY:
            tick_s = float(plan.machine.tick_clock.period_s)
            braking_s = gentle_hold_ticks(tick_s) * tick_s
            return f"{shaken}, so a hold brakes within {braking_s:.2g} s; STOP brakes at once"
        when = "at the next rest" if rests_within(plan) else "at the end, for there is no rest"
        return f"{shaken}, so a hold stands {when}"
    if not 0.0 < leaves_m < math.inf:
        return ""
    ahead_m = hold_ahead_m(plan)
    deviation_words = f"{1e3 * leaves_m:.2f} mm beside the path"
    if ahead_m > 0.0:
        deviation_words += f" or {1e3 * ahead_m:.2f} mm from where it is due"
    if hold is not Hold.AT_REST:
        return f"a hold may stand {deviation_words}, within the limit"
    if at_once:
        return f"a hold may stand {deviation_words}, beyond the limit: the controller holds at once"
    if rests_within(plan):
        return f"a hold may stand {deviation_words}, so it stands at the next rest"
    return (
        f"a hold may stand {deviation_words}, so it waits for a rest, and there is none before "
        "the end"
    )


def override_words(leaves_m: float, percent: int, spoiled: Sequence[Result]) -> str:
    """Return why an override would spoil the work; empty if it would not.

    Parameters
    ----------
    leaves_m
        Largest distance in m of the loads from the path at a slower rate if it is too large; else
        0.
    percent, spoiled
        As ``spoiled_by_override`` returns them.
    """
    if leaves_m > 0.0:
        return (
            "its commands make the loads follow the path at the full feed alone; slower they "
            f"would come up to {1e3 * leaves_m:.2f} mm from where they are due"
        )
    return f"at {percent} % its loads would shake ({_results_words(spoiled)})" if spoiled else ""


def _results_words(results: Sequence[Result]) -> str:
    return ", ".join(
        f"{' '.join(filter(None, (r.name.replace('_', ' '), r.axis)))} "
        f"{shown(r.measured or 0.0, r.unit)} of {shown(r.limit or 0.0, r.unit)}"
        for r in results
    )


def rests_within(plan: Plan) -> bool:
    """Return whether a plan rests or stops between two motions, where a hold can take effect."""
    table = tick_table(plan.commands)
    rest_row_count, last_moving = rest_rows(table), -1  # the last row that moves
    for block in table:
        moving_rows = np.flatnonzero((block.counts != 0).any(axis=1)) + block.first_tick
        if last_moving < 0 and len(moving_rows):
            last_moving = int(moving_rows[0])  # the rest before it is the start
        if len(moving_rows) and (np.diff(moving_rows, prepend=last_moving) > rest_row_count).any():
            return True
        if any(event.kind in HALTS for event in block.events):
            return True
        last_moving = int(moving_rows[-1]) if len(moving_rows) else last_moving
    return False
