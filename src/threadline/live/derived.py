"""Commands for the rest of a job: proven rows, from a place that an earlier run has reached.

For axes, rows up to that place are left out, and the axes move there first. A frame or cylinders
cannot be placed by hand: they get there by the program itself, with needle or tools off.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from threadline.base.arrays import IntArray
from threadline.errors import CommandError
from threadline.files import (
    Commands,
    Event,
    StepPlay,
    StitchBlock,
    Stream,
    TickBlock,
    TickTable,
    played,
    switch_schedule,
    tick_table,
)
from threadline.live.path_window import rest_rows
from threadline.machine import Machine

_WORK = frozenset(("tool", "vacuum"))
"""Kinds of outputs that do the work; all others move cylinders, or supply air."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rest:
    """The rest of a job.

    Parameters
    ----------
    commands
        The commands to send.
    operation
        Operation with which the work begins again.
    begins
        (axes,) position at which the commands begin, in their units; (0,) if nothing is counted.
    left_out
        Ticks of the whole commands that were left out at their beginning.
    dry
        Whether the part before the operation is repeated with needle or tools off.
    """

    commands: Commands
    operation: int
    begins: IntArray
    left_out: int
    dry: bool


def rest_of_rows(commands: Commands, machine: Machine, operation: int, *, at_rest: bool) -> Rest:  # noqa: ARG001
    """Return the rows of a table from the beginning of an operation on.

    Parameters
    ----------
    commands
        A table of ticks; it is read once.
    machine
        Unused.
    operation
        The operation.
    at_rest
        Whether the rows may begin only at a rest of the program (``REST_S`` without a count); then
        they begin at the last rest before the operation.
    """
    table = tick_table(commands)
    first, first_operation = _first_row(table, operation, rest_rows(table) if at_rest else 0)
    return rest_from_row(table, first, first_operation)


def rest_from_row(commands: Commands, first: int, operation: int) -> Rest:
    """Return the rows of a table from a given tick of an operation on.

    Parameters
    ----------
    commands
        A table of ticks; it is read once.
    first, operation
        The tick, and its operation.
    """
    table = tick_table(commands)
    begins = table.start_counts.astype(np.int64)
    for block in table:
        upto = min(max(first - block.first_tick, 0), len(block))
        begins = begins + block.counts[:upto].sum(axis=0)
    return Rest(
        commands=replace(table, start_counts=begins, blocks=Stream(_rows_from, table, first)),
        operation=operation,
        begins=begins,
        left_out=first,
        dry=False,
    )


def _first_row(table: TickTable, operation: int, rest: int) -> tuple[int, int]:
    """Return the first row of an operation, or the last rest before it, and the operation there."""
    row = resting_rows = 0
    latest = (0, operation)
    for block in table:
        moves = (np.abs(block.counts).max(axis=1, initial=0) > 0).tolist()
        for moving, row_operation in zip(moves, block.operation.tolist(), strict=True):
            if resting_rows >= rest or not row:
                latest = (row, row_operation)
            if row_operation >= operation:
                return latest
            resting_rows = 0 if moving else resting_rows + 1
            row += 1
    raise _unknown(operation)


def _rows_from(table: TickTable, first: int) -> Iterator[TickBlock]:
    """Yield the rows from a tick on, counted from 0; earlier switchings are applied at once."""
    switched: dict[str, Event] = {}
    for block in table:
        end = block.first_tick + len(block)
        if end <= first and not any(event.tick >= first for event in block.events):
            switched |= {e.name: e for e in block.events if e.kind == "output"}
            continue
        skipped = max(first - block.first_tick, 0)
        earlier_outputs = [e for e in block.events if e.tick < first and e.kind == "output"]
        switched |= {e.name: e for e in earlier_outputs}
        outputs_again = [replace(event, tick=0) for event in switched.values()]
        switched = {}
        later_events = [replace(e, tick=e.tick - first) for e in block.events if e.tick >= first]
        yield TickBlock(
            first_tick=max(block.first_tick - first, 0),
            counts=block.counts[skipped:],
            operation=block.operation[skipped:],
            events=(*outputs_again, *later_events),
        )


def rest_of_turns(commands: Commands, machine: Machine, operation: int, *, at_rest: bool) -> Rest:  # noqa: ARG001
    """Return the turns of a frame, with the needle held up before an operation."""
    play = played(commands)
    if not any((block.operation >= operation).any() for block in play):
        raise _unknown(operation)
    return Rest(
        commands=replace(play, blocks=Stream(_held_up, play, operation)),
        operation=operation,
        begins=play.start_steps,
        left_out=0,
        dry=True,
    )


def _held_up(play: StepPlay, operation: int) -> Iterator[StitchBlock]:
    for block in play:
        needle = np.where(block.operation < operation, 0, block.needle)
        yield replace(block, needle=needle)


def rest_of_scans(commands: Commands, machine: Machine, operation: int, *, at_rest: bool) -> Rest:  # noqa: ARG001
    """Return a schedule with its tools off before an operation.

    If a tool or a vacuum is on at the beginning of that operation, the part it held is lost: the
    work begins again at the last earlier operation at which all tools are off.
    """
    schedule = switch_schedule(commands)
    tools = [k for k, output in enumerate(machine.outputs.values()) if output.kind in _WORK]
    tool_works = schedule.levels[:, tools].max(axis=1, initial=0) > 0
    first = np.flatnonzero(schedule.operation >= operation)
    if not len(first):
        raise _unknown(operation)
    row = int(first[0])
    while row > 0 and tool_works[row - 1]:
        row = int(np.flatnonzero(schedule.operation == schedule.operation[row - 1])[0])
    levels = schedule.levels.copy()
    levels[:row, tools] = 0
    end_switches = {
        name for name, contact in machine.contacts.items() if contact.cylinder is not None
    }
    begin_tick = int(schedule.ticks[row])
    events = tuple(
        event
        for event in schedule.events
        if not (
            event.kind == "wait" and event.tick <= begin_tick and event.name not in end_switches
        )
    )
    return Rest(
        commands=replace(schedule, levels=levels, events=events),
        operation=int(schedule.operation[row]),
        begins=np.zeros(0, dtype=np.int64),
        left_out=0,
        dry=True,
    )


def _unknown(operation: int) -> CommandError:
    return CommandError(
        f"operation {operation} is not in this job", remedy="Continue the run of this job."
    )
