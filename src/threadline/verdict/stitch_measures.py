"""Measures of an embroidery machine: what its tables ask for, and where its stitches come to lie.

Each tells the worst stitch by block and number, how many are out of its limit, and the speed of the
shaft at which the worst would be in.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from threadline.arrays import FloatArray
from threadline.plan import Plan
from threadline.signals.step_play import one_behind_the_other
from threadline.targets.stitched import Stitched
from threadline.verdict.demands import SLACK
from threadline.verdict.finding import Finding
from threadline.verdict.stitch_run import StitchRun

_MINUTE = 60.0


def measure_tables(plan: Plan) -> Mapping[str, Sequence[Finding]]:
    """Return what the plan alone tells: use of the windows, steps, loading of tables, travel."""
    stitched = plan.stitched
    return {
        "window_use": [_window_use(stitched)],
        "step_rate": _step_rates(stitched),
        "fetch_use": [_fetch_use(stitched)],
        "travel": _travel(stitched),
    }


def _at(stitched: Stitched, turn: int, value: float, note: str = "", axis: str = "") -> Finding:
    """Return a finding of a turn, with its name."""
    turns = stitched.turns
    named = stitched.turns.name(turn)
    return Finding(
        value=value,
        axis=axis,
        time_s=float(turns.begin[turn] * float(stitched.commands.clock.period_s)),
        operation=int(turns.operation[turn]),
        job_line=int(turns.line[turn]),
        position=tuple(stitched.places_m[turn].tolist()),
        note="; ".join(filter(None, (named, note))),
    )


def _window_use(stitched: Stitched) -> Finding:
    """Return the largest share of its window that a move needs within the limits of the axes."""
    use = window_uses(stitched)
    worst = int(np.argmax(use))
    note = ""
    if use[worst] > SLACK:
        needed = stitched.pace.rigid_windows_s(stitched.turns.moves)
        turn_s = float(needed[worst]) / stitched.pace.share
        note = f"{_out(use > SLACK, 'turns')}; it can at {_speed(turn_s)}"
    # A window is rounded to a period of the timer, and is not too short for that.
    rounded = 1.0 / float(stitched.turns.window[worst])
    return _at(stitched, worst, max(0.0, float(use[worst]) - rounded), note)


def window_uses(stitched: Stitched) -> FloatArray:
    """Return (n,) share of its window that the move of each turn needs within the limits."""
    windows = stitched.turns.window * float(stitched.commands.clock.period_s)
    return np.asarray(stitched.pace.rigid_windows_s(stitched.turns.moves) / windows)


def step_rates_hz(stitched: Stitched, column: int) -> FloatArray:
    """Return (n,) highest rate of steps of an axis in each turn, Hz; 0 where it stands."""
    commands, turns = stitched.commands, stitched.turns
    shortest = np.minimum.reduceat(*one_behind_the_other(commands.library)).astype(np.float64)
    tick_s = np.full(len(turns), float(commands.clock.period_s))
    if commands.counted_by == "angle":
        tick_s *= turns.window / commands.window_angle
    table = np.abs(turns.moves.units[:, column]) - 1
    return np.where(table >= 0, 1.0 / (shortest[np.maximum(table, 0)] * tick_s), 0.0)


def _step_rates(stitched: Stitched) -> list[Finding]:
    """Return the highest rate of steps of each axis, Hz."""
    found = []
    for k, axis in enumerate(stitched.axes):
        rates = step_rates_hz(stitched, k)
        worst = int(np.argmax(rates))
        found.append(_at(stitched, worst, float(rates[worst]), axis=axis))
    return found


def _fetch_use(stitched: Stitched) -> Finding:
    """Return the largest share of the time between two moves that loading tables takes."""
    turns = stitched.turns
    if len(turns) < 2:
        return Finding(value=0.0, note="one turn: its tables are there before")
    period_s = float(stitched.commands.clock.period_s)
    free_s = (turns.begin[1:] - turns.begin[:-1] - turns.window[:-1]) * period_s
    loads = np.count_nonzero(turns.moves.units[1:], axis=1) * stitched.pace.tables.fetch.si
    use = loads / free_s
    worst = int(np.argmax(use))
    note = f"{loads[worst] * 1e3:.4g} of {free_s[worst] * 1e3:.4g} ms"
    return _at(stitched, worst + 1, float(use[worst]), note)


def _travel(stitched: Stitched) -> list[Finding]:
    """Return by how much the frame leaves its travel on each axis, m."""
    places = stitched.places_m
    found = []
    for k, axis in enumerate(stitched.axes):
        low, high = stitched.machine.travel[k]
        beyond = np.maximum(places[:, k] - high, low - places[:, k])
        worst = int(np.argmax(beyond))
        found.append(_at(stitched, worst, max(0.0, float(beyond[worst])), axis=axis))
    return found


def stitch_residual(run: StitchRun, _options: Mapping[str, float]) -> list[Finding]:
    """Per axis: the largest distance of the frame from its place while the needle is in, m."""
    sewn, pace = run.sewn, run.stitched.pace
    alone_s = pace.needed_turns_s(run.stitched.turns.moves)[run.turns]
    # A stitch is out where either axis is: it is one needle that enters.
    out = _out(np.asarray((sewn.residual_m > pace.tolerance_m).any(axis=1)), "stitches")
    found = []
    for k, axis in enumerate(run.plan.axes):
        residual = sewn.residual_m[:, k]
        worst = _worst(run, residual, sewn.time_s[:, k], axis)
        if (residual > pace.tolerance_m).any():
            # Those of the planner's tolerance: a limit is none of a measure's business.
            note = (
                f"{out} beyond {pace.tolerance_m * 1e3:.4g} mm on an axis; alone it can "
                f"at {_speed(float(alone_s[int(np.nanargmax(residual))]))}"
            )
            worst = replace(worst, note=f"{worst.note}; {note}")
        found.append(worst)
    return found


def servo_force(run: StitchRun, _options: Mapping[str, float]) -> list[Finding]:
    """Per axis: the largest share of its servo's force."""
    sewn = run.sewn
    return [
        _worst(run, sewn.force[:, k], sewn.force_s[:, k], axis)
        for k, axis in enumerate(run.plan.axes)
    ]


def _worst(run: StitchRun, values: FloatArray, times: FloatArray, axis: str) -> Finding:
    if np.isnan(values).all():
        return Finding(value=None, axis=axis, note="no stitch was seen")
    worst = int(np.nanargmax(values))
    turn = int(run.turns[worst])
    found = _at(run.stitched, turn, float(values[worst]), axis=axis)
    return replace(found, time_s=float(times[worst]))


def _out(over: NDArray[np.bool_], what: str) -> str:
    return f"{int(over.sum())} of {len(over)} {what}"


def _speed(turn_s: float) -> str:
    return f"{_MINUTE / turn_s:.4g} stitches a minute"
