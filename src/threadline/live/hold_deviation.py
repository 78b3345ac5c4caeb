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
    gentle_ticks,
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
    stands, worst = table.start_counts.astype(np.float64), 0.0
    for block in table:
        places = stands + np.cumsum(block.counts, axis=0)
        time_s = table.clock.times_s(block.first_tick + 1, len(block))
        played = (places / scale * radius)[:, columns]
        meant = reader.ladder(time_s, 1)[:, 0] * radius[columns]
        worst = max(worst, float(np.linalg.norm(played - meant, axis=1).max(initial=0.0)))
        if len(block):
            reader.drop(float(time_s[-1]))
            stands = places[-1]
    return worst


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
    for at in _PLACES:
        window = PathWindow(tick_table(plan.commands), pass_stops=True)
        places, until = _held_places(window, plan, at, _gently(plan, hold))
        if until and (found := _spoiled(plan, spec, window, places)):
            return found
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
        rows = int(window.reach(rate * _MOST_ROWS))
        evenly = np.minimum(rate * np.arange(ceil(rows / rate) + 1.0), rows)
        changing = _overridden_places(window, plan, (rate, rows), hold)
        for places in (_resting(evenly, window, plan), changing):
            if len(places) and (found := _spoiled(plan, spec, window, places)):
                return round(100.0 * rate), found
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
        rows = int(window.reach(rate * _MOST_ROWS))
        slower = window.counts(np.minimum(rate * np.arange(ceil(rows / rate) + 1.0), rows))
        if limits.excess(slower, window.counts(np.arange(rows + 1.0))) > 1.0:
            return round(100.0 * rate)
    return 100


def _spoiled(plan: Plan, spec: Spec, window: PathWindow, places: FloatArray) -> tuple[Result, ...]:
    """Return the criteria that a run with (n,) places at its ticks brings out of specification."""
    soft = [c for c in spec.criteria if c.limit and not c.hard]
    narrower = tuple(replace(c, limit=_SPARE * (c.limit or 0.0)) for c in soft)
    if not soft:
        return ()
    table = tick_table(plan.commands)
    counts = np.diff(window.rounded(places), axis=0)
    operation = window.operations(places[:-1])
    rows = TickBlock(first_tick=0, counts=counts, operation=operation)
    held = simulate(replace(table, blocks=Stream.of([rows])), plan.machine)
    pace, ticks = Pace(table.clock), len(counts)
    events = (*pace.played(0, places[1:]), *pace.ended(ticks, 1))
    recording = replace(held, blocks=Stream(_with_events, held.blocks, events, table.clock.name))
    failed = [
        result
        for result in Judge(plan, replace(spec, criteria=narrower)).verdict([recording]).results
        if result.status is Status.FAILED
    ]
    if failed:
        alone = Judge(plan, spec).verdict([simulate(plan.commands, plan.machine)])
        bad = {(r.name, r.axis) for r in alone.results if r.status is Status.FAILED}
        failed = [result for result in failed if (result.name, result.axis) not in bad]
    limits = {(c.name, c.axis): c.limit for c in soft}
    return tuple(
        replace(r, limit=limits.get((r.name, r.axis), limits.get((r.name, "")))) for r in failed
    )


def _gently(plan: Plan, hold: Hold) -> float:
    """Return the shortest duration of the braking of a hold, in ticks."""
    return gentle_ticks(float(plan.machine.tick_clock.period_s)) if hold is Hold.GENTLY else 0.0


def _held_places(
    window: PathWindow, plan: Plan, at: float | None, gently: float
) -> tuple[FloatArray, int]:
    """Return the (n,) places at the ticks of a run with holds, and the tick after the last hold.

    The tick is 0 if no row moves. The rest of the table after the last hold is played unchanged.
    ``at`` is the place of the holds within their parts, as a share of the rows; None: at the
    fastest row. ``gently`` is the shortest duration of a braking, in ticks.
    """
    table = tick_table(plan.commands)
    rows = int(window.reach(_MOST_ROWS))
    radius = plan.machine.radius_m / table.counts_per_unit
    step = np.diff(window.counts(np.arange(rows + 1.0)), axis=0) * radius
    speed = np.linalg.norm(step, axis=1)
    limits = CountLimits.of(plan.machine, loads_follow=plan.motion.of_loads is not None)
    stands = np.ones(ceil(_STANDS_S / float(table.clock.period_s)))
    places, until = np.arange(3.0), 0
    for begin, end in pairwise(np.linspace(0, rows, _HOLDS + 1).astype(int).tolist()):
        if end <= begin:
            continue
        row = begin + (int(np.argmax(speed[begin:end])) if at is None else int(at * (end - begin)))
        if speed[row] <= 0.0 or row <= places[-1] or row + 2 >= rows:
            continue
        places = np.concatenate([places, np.arange(places[-1] + 1.0, row + 1.0)])
        window.reach(places[-1] + MOST_PLACES + most_changed(gently))
        last = float(window.reach(places[-1]))
        before = (float(places[-3]), float(places[-2]), float(places[-1]))
        down = np.minimum(brake(window, before, limits, gently), last)
        rests_at = float(down[-1]) if len(down) else float(places[-1])
        up = np.minimum(rise(window, rests_at, limits, gently), last)
        places = np.concatenate([places, down, rests_at * stands, up])
        until = len(places)
    rest = np.arange(np.floor(places[-1]) + 1.0, rows + 1.0)
    return np.concatenate([places, rest]), until


def _overridden_places(
    window: PathWindow, plan: Plan, slower: tuple[float, int], hold: Hold
) -> FloatArray:
    """Return the (n,) places at the ticks of an overridden run; empty if no row moves.

    ``slower`` is the rate and the row at which the places end; ``hold`` says how a hold brakes.
    """
    rate, rows = slower
    radius = plan.machine.radius_m / plan.machine.counts_per_unit
    step = np.diff(window.counts(np.arange(rows + 1.0)), axis=0) * radius
    speed = np.linalg.norm(step, axis=1)
    if not speed.any():
        return np.empty(0)
    limits = CountLimits.of(plan.machine, loads_follow=plan.motion.of_loads is not None)
    stands, gently = ticks_in(_STANDS_S, plan.machine), float(ticks_in(OVERRIDE_S, plan.machine))
    held, places = _gently(plan, hold), np.arange(3.0)

    def go_on(more: FloatArray) -> None:
        nonlocal places
        places = np.concatenate([places, np.minimum(more, rows)])
        window.reach(places[-1] + stands + 2.0 * most_changed(max(gently, held)))

    def change(before: float, after: float) -> None:
        slowly = gently if before else held
        go_on(change_rate(window, float(places[-1]), (before, after), limits, slowly))

    go_on(np.empty(0))
    change(1.0, rate)
    for part, (begin, end) in enumerate(pairwise(np.linspace(0, rows, _HOLDS + 1).astype(int))):
        fastest = begin + int(np.argmax(speed[begin:end])) if end > begin else begin
        if fastest <= places[-1] or fastest + 2 >= rows:
            continue
        go_on(places[-1] + rate * np.arange(1.0, (fastest - places[-1]) / rate + 1.0))
        if hold is not Hold.AT_REST and part % 2:
            go_on(brake(window, (places[-3], places[-2], places[-1]), limits, held))
            go_on(np.full(stands, places[-1]))
            change(0.0, rate)
        else:
            change(rate, 1.0)
            go_on(places[-1] + np.arange(1.0, stands + 1.0))
            change(1.0, rate)
    go_on(places[-1] + rate * np.arange(1.0, (rows - places[-1]) / rate + 1.0))
    if places[-1] < rows:
        go_on(np.array([float(rows)]))
    return _resting(places, window, plan)


def _resting(places: FloatArray, window: PathWindow, plan: Plan) -> FloatArray:
    """Return places with a braking after them, if they end before the table does."""
    window.reach(places[-1] + MOST_PLACES)
    limits = CountLimits.of(plan.machine, loads_follow=plan.motion.of_loads is not None)
    if window.at_end and places[-1] >= window.reach(places[-1]):
        return places
    down = brake(window, (places[-3], places[-2], places[-1]), limits)
    return np.concatenate([places, np.minimum(down, window.reach(places[-1]))])


def _with_events(
    blocks: Iterable[RecordingBlock], events: Sequence[Event], clock: str
) -> Iterator[RecordingBlock]:
    """Yield blocks with the events ``events``, each in the block of its tick."""
    left = list(events)
    for block in blocks:
        count = max(map(len, block.samples.values()), default=0)
        due = [e for e in left if e.tick < block.first_tick[clock] + count]
        left = left[len(due) :]
        yield replace(block, events=(*block.events, *due))


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
        found = _results_words(spoiled)
        if at_once:
            return f"the controller holds at once: at full speed that shakes the load ({found})"
        shaken = f"braking at full speed would shake the load ({found})"
        if hold is Hold.GENTLY:
            tick_s = float(plan.machine.tick_clock.period_s)
            lasts_s = gentle_ticks(tick_s) * tick_s
            return f"{shaken}, so a hold brakes within {lasts_s:.2g} s; STOP brakes at once"
        until = "at the next rest" if rests_within(plan) else "at the end, for there is no rest"
        return f"{shaken}, so a hold stands {until}"
    if not 0.0 < leaves_m < math.inf:
        return ""
    ahead_m = hold_ahead_m(plan)
    places = f"{1e3 * leaves_m:.2f} mm beside the path"
    if ahead_m > 0.0:
        places += f" or {1e3 * ahead_m:.2f} mm from where it is due"
    if hold is not Hold.AT_REST:
        return f"a hold may stand {places}, within the limit"
    if at_once:
        return f"a hold may stand {places}, beyond the limit: the controller holds at once"
    if rests_within(plan):
        return f"a hold may stand {places}, so it stands at the next rest"
    return f"a hold may stand {places}, so it waits for a rest, and there is none before the end"


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
