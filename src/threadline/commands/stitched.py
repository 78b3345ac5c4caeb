"""A design as step tables by stitches: which table each axis plays in each turn, and when."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from typing import Any

import numpy as np

from threadline.base.arrays import IntArray, Recent
from threadline.commands.step_tables import step_tables
from threadline.commands.stitch_pace import Moves, Pace
from threadline.commands.turns import Stitched, Turns
from threadline.errors import BudgetError, Place, PlanError
from threadline.files import Event, StepPlay, StepTable, StitchBlock, Stream
from threadline.jobs.operations import Job, MoveRun, Stop, ToolEvent
from threadline.machine import Machine
from threadline.motion.laws import Law

_IN_BLOCK = 256
_BLOCK_S = 32.0  # longest block: samples of slow turns would not fit into the fast memory
_WHOLE = 1e-3  # units: how near a place must be to the grid of the design
_BUDGET_S = 1e-9
# A search plans one job at many shaft speeds, and plans its result again for the proof.
_PACES: Recent[tuple[Machine, Law, float, float], Pace] = Recent(
    8, lambda a, b: a[2:] == b[2:] and a[1] is b[1] and (a[0] is b[0] or a[0] == b[0])
)


def stitch(
    job: Job,
    machine: Machine,
    law: Law,
    tolerance_m: float,
    turn_s: float | None,
    robust_share: float = 0.0,
) -> Stitched:
    """Return the plan of a design.

    Parameters
    ----------
    job
        A design.
    machine
        Machine with a shaft and tables.
    law
        Motion law of every move.
    tolerance_m
        Largest swing allowed when a needle enters.
    turn_s
        Time of every turn. None gives each turn a time of its own. If the spindle cannot change
        its speed, None gives the highest speed at which every needle enters within the tolerance.
    robust_share
        Share of the tolerances of loads and springs for which the tolerance is kept.

    Raises
    ------
    PlanError
        If a place is between the units of the machine, the shaft cannot turn at that speed, or the
        tables cannot be played.
    BudgetError
        If the design takes longer than the machine's tick budget.
    """
    pace = _PACES.of(
        (machine, law, tolerance_m, robust_share),
        lambda: Pace(machine, law, tolerance_m, robust_share),
    )
    shaft = pace.shaft
    rows = _rows(job, pace)
    moves: Moves = rows["moves"]
    constant = turn_s is not None or shaft.acceleration is None
    given = turn_s
    if given is None:
        given = pace.constant_turn_s(moves) if constant else float(shaft.turn_s)
    if not float(shaft.turn_s) * (1.0 - 1e-9) <= given <= shaft.slowest_turn.si * (1.0 + 1e-9):
        raise PlanError(
            f"{60.0 / given:.6g} stitches a minute: the shaft of {machine.name} makes "
            f"{60.0 / shaft.slowest_turn.si:g} to {60.0 / float(shaft.turn_s):.6g}",
            place=machine.place,
            remedy="Choose a speed between them.",
        )
    count = len(moves.needle)
    bound_s = None
    if constant:
        turns_s = np.full(count, given)
    else:
        schedule = pace.scheduled(moves)
        turns_s, bound_s = schedule.turn_s, schedule.bound_s
    clock = machine.clock(pace.tables.clock)
    period_s = float(clock.period_s)
    windows = np.rint(pace.share * turns_s / period_s)
    rests = pace.rests_s(turns_s) / period_s
    begin = np.rint(np.cumsum(np.concatenate(([0.0], (pace.share * turns_s / period_s + rests)))))
    _check_budget(machine, float(begin[-1]) * period_s)
    turns = Turns(
        turn_s=turns_s, begin=begin[:-1].astype(np.int64), window=windows.astype(np.int64), **rows
    )
    needed = pace.needed_turns_s(moves)
    sewn = moves.needle == 1
    by_angle = not constant
    reference_s = shaft.turn_s if by_angle else Fraction(given).limit_denominator(10**9)
    commands = StepPlay(
        clock=clock,
        counted_by="angle" if by_angle else "time",
        steps_per_turn=round(float(reference_s) / period_s),
        window_angle=int(reference_s * shaft.window_share / clock.period_s),
        axes=machine.axis_names,
        steps_per_unit=machine.counts_per_unit,
        start_steps=np.rint(np.array(job.start) * machine.counts_per_unit).astype(np.int64),
        library=tables_of(machine, law, reference_s * shaft.window_share),
        blocks=Stream(_blocks, turns),
        duration_ticks=int(begin[-1]),
        job_sha256=job.sha256,
        machine_sha256=machine.sha256,
    )
    return Stitched(
        job=job,
        machine=machine,
        law=law,
        commands=commands,
        turns=turns,
        pace=pace,
        constant=constant,
        speed_requested=turn_s is not None,
        independent_s=float(needed.sum()),
        slowest_s=float(needed[sewn].max()) * count,
        bound_s=bound_s,
    )


def tables_of(machine: Machine, law: Law, window_s: Fraction) -> tuple[StepTable, ...]:
    """Return the tables of a machine for one window, from one unit to the longest move.

    Raises
    ------
    PlanError
        If axes differ in steps per unit, or two steps fall into one timer period.
    """
    assert machine.tables is not None
    steps = {round(axis.counts.si * machine.tables.unit.si) for axis in machine.axes.values()}
    if len(steps) > 1:
        raise PlanError(
            f"the axes take {' and '.join(map(str, sorted(steps)))} steps for a unit: one library "
            "of tables cannot serve both",
            place=machine.place,
            remedy="Give every axis the same counts.",
        )
    return step_tables(
        law,
        window_s=window_s,
        timer_s=machine.clock(machine.tables.clock).period_s,
        steps_per_unit=steps.pop(),
        longest_units=machine.tables.longest_units,
    )


def _rows(job: Job, pace: Pace) -> dict[str, Any]:
    """Return the columns of the turns; a travel too long for one turn takes several turns."""
    unit, longest = pace.tables.unit.si, pace.tables.longest_units
    at: IntArray = np.zeros((1, len(job.axes)), dtype=np.int64)
    units: list[IntArray] = []
    columns: list[IntArray] = []  # needle, operation, line, stitch, block
    events: list[Event] = []
    index = turns = 0
    for item in job.runs():
        if not isinstance(item, MoveRun):
            if isinstance(item, ToolEvent):
                events.append(Event(tick=turns, kind="tool", operation=index, name=item.name))
            elif isinstance(item, Stop) and item.final:
                events.append(Event(tick=turns, kind="end", operation=index))
            index += 1
            continue
        places = _on_grid(item, unit)
        way = np.diff(places, axis=0, prepend=at)
        stitch = np.asarray(item.columns["stitch"], dtype=np.int64)
        most = np.abs(way).max(axis=1)
        parts = np.where(stitch > 0, 1, np.maximum(1, -(-most // longest)))
        of = np.repeat(np.arange(len(way)), parts)
        number = np.arange(len(of)) - np.repeat(np.cumsum(parts) - parts, parts)
        ends = [
            np.rint(((number + more) / parts[of])[:, None] * way[of]).astype(np.int64)
            for more in (0, 1)
        ]
        units.append(ends[1] - ends[0])
        block = np.asarray(item.columns["block"], dtype=np.int64)
        row = (stitch > 0, index + np.arange(len(way)), item.line, stitch, block)
        columns.append(np.stack(row, axis=1).astype(np.int64)[of])
        at = places[-1:]
        index, turns = index + len(way), turns + len(of)
    table = np.concatenate(columns)
    return {
        "moves": Moves(units=np.concatenate(units), needle=table[:, 0]),
        "operation": table[:, 1],
        "line": table[:, 2],
        "stitch": table[:, 3],
        "block": table[:, 4],
        "events": tuple(events),
    }


def _on_grid(item: MoveRun, unit_m: float) -> IntArray:
    """Return the (n, A) places of a run in units of the machine."""
    places = np.rint(item.targets / unit_m).astype(np.int64)
    off = np.abs(item.targets / unit_m - places).max(axis=1)
    if (off > _WHOLE).any():
        wrong = int(np.argmax(off > _WHOLE))
        raise PlanError(
            f"a stitch at {', '.join(f'{m * 1e3:g}' for m in item.targets[wrong])} mm is between "
            f"the units of {unit_m * 1e3:g} mm in which the machine moves",
            place=Place(item.file, int(item.line[wrong])),
            remedy="Scale the design, or take a machine with a finer unit.",
        )
    return places


def _check_budget(machine: Machine, seconds: float) -> None:
    ticks = seconds / float(machine.tick_clock.period_s)
    if ticks > machine.tick_budget.si * (1.0 + _BUDGET_S):
        raise BudgetError(
            f"the design takes {ticks:.4g} ticks of {machine.tick_clock.name!r}, the budget is "
            f"{machine.tick_budget.si:g}",
            place=machine.place,
            remedy="Split the design, or raise tick_budget.",
        )


def _blocks(turns: Turns) -> Iterator[StitchBlock]:
    rows = int(np.clip(_BLOCK_S / turns.turn_s.max(), 1, _IN_BLOCK))
    for first in range(0, len(turns), rows):
        part = slice(first, first + rows)
        units = turns.moves.units[part]
        last = first + len(units) >= len(turns)
        yield StitchBlock(
            first_stitch=first,
            begin=turns.begin[part],
            window=turns.window[part],
            table=np.abs(units) - 1,
            sign=np.sign(units),
            start=np.zeros(len(units), dtype=np.int64),
            needle=turns.moves.needle[part],
            operation=turns.operation[part],
            events=tuple(
                e for e in turns.events if first <= e.tick and (last or e.tick < first + rows)
            ),
        )
