"""The switch schedule of a job and its shapers: named valves on the scan of a PLC.

Time stands still during a wait. Rows up to the tick of the wait have taken effect, and the next
tick comes when the input is there. Operations after a wait therefore begin one tick later.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from threadline.commands.intents import Scheduled, ScheduledMove
from threadline.commands.schedule_moves import (
    AxisShaping,
    Homing,
    Levels,
    home_stage,
    levels_by_axis,
    move_levels,
    open_flows,
    shortest_ticks,
    slowest,
    table_of,
    valves_of,
    written_levels,
)
from threadline.commands.schedule_options import (
    check_air,
    check_interlocks,
    check_timeout,
    check_wait,
    reads_on,
    shaping_at,
    tell_distance,
)
from threadline.dynamics.pneumatic import opening_ringing_m, step_ringing
from threadline.errors import BudgetError, MachineError, Place, PlanError
from threadline.files import Clock, Creep, Event, SwitchSchedule
from threadline.jobs.moves import REST, STEP_EVENT, repeated
from threadline.jobs.operations import (
    Dwell,
    Home,
    Job,
    Move,
    SetOutput,
    Source,
    ToolEvent,
    WaitInput,
)
from threadline.machine import Machine

_SAME_M = 1e-9
_SEEN_LAGS = 2.0
"""Number of lags after which the cylinder has covered 86 % of its travel in an opening."""


def compile_schedule(
    job: Job, machine: Machine, shaping: Mapping[str, AxisShaping] | None = None
) -> Scheduled:
    """Return the schedule of ``job``, with each cylinder shaped by ``shaping``.

    Parameters
    ----------
    shaping
        Shaping by cylinder; other cylinders move unshaped.

    Raises
    ------
    PlanError
        If no valves give a level, a level exceeds the unshaped level where that is forbidden, a
        valve would switch faster than it can, or a cylinder moves before the soft-start valve has
        opened.
    """
    return _compiled(job, machine, shaping, -1)


def _compiled(
    job: Job, machine: Machine, shaping: Mapping[str, AxisShaping] | None, second: int
) -> Scheduled:
    """Return the schedule of ``job``, whose second cycle begins with the operation ``second``."""
    builder = _Builder(job, machine, dict(shaping or {}))
    for index, operation in enumerate(job):
        if index == job.once:
            builder.mark_again()
        if index == second:
            # The program of a PLC has one cycle: its waits confirm no move of the cycle before.
            builder.unconfirmed.clear()
        builder.add(index, operation)
    return builder.finish()


def compile_cycles(
    job: Job, machine: Machine, shaping: Mapping[str, AxisShaping] | None = None
) -> tuple[Job, Scheduled]:
    """Return job and schedule of continuous production: a first cycle and a further one.

    If all cycles are equal, the job itself is returned, with its schedule.

    Raises
    ------
    PlanError
        As ``compile_schedule``, or if a cycle does not end in the state where further ones begin.
    """
    single = compile_schedule(job, machine, shaping)
    if not job.once:
        return job, single
    _check_again(job, single)
    both = repeated(job)
    scheduled = _compiled(both, machine, shaping, len(list(job)))
    return both, replace(scheduled, single=single, warnings=single.warnings)


def _check_again(job: Job, single: Scheduled) -> None:
    """Refuse a cycle whose outputs or cylinders do not end as a further cycle begins."""
    place, machine = Place(job.file), single.machine
    commands = single.commands
    row = int(np.searchsorted(commands.ticks, single.again_tick)) - 1
    begin = commands.levels[row] if row >= 0 else np.zeros_like(commands.levels[-1])
    for name, first, last in zip(commands.outputs, begin, commands.levels[-1], strict=True):
        if first != last:
            raise PlanError(
                f"the output {name!r} is {'on' if last else 'off'} at the end of the list, and "
                f"{'on' if first else 'off'} where every further cycle begins",
                place=place,
                remedy="Switch it within the list, so that both are the same.",
            )
    for axis, start in zip(job.axes, job.start, strict=True):
        ends = [move.end_m for move in single.moves if move.axis == axis]
        if ends and abs(ends[-1] - start) > _SAME_M:
            raise PlanError(
                f"{axis} is at {machine.cylinders[axis].place(ends[-1])} at the end of the list, "
                f"and at {machine.cylinders[axis].place(start)} where every further cycle begins",
                place=place,
                remedy="Bring it back within the list.",
            )


def creep_of(
    machine: Machine, move: ScheduledMove, tick: int, most: int, state: Mapping[str, int]
) -> Creep | None:
    """Return how a cylinder creeps to the end switch behind ``move`` in a wait at ``tick``.

    The creep begins when the cylinder stands, even with the slowest valves and the longest lag
    within the tolerances of the file. Each opening of the valves is as short as possible, at the
    smallest level. Before the next opening the cylinder covers most of its travel, so that the
    switch is read in time, and an odd number of half periods of the frame passes: the ringing of
    two openings cancels, and at most one rings. None: the missing switch is a fault before the
    first opening is over.

    Parameters
    ----------
    most
        Scans of waiting after which the missing switch is a fault.
    state
        Outputs that are on beside the cylinder's.
    """
    assert machine.plc is not None
    scan_s = float(machine.clock(machine.plc.clock).period_s)

    def scans(time_s: float) -> int:
        return max(1, math.ceil(time_s / scan_s - 1e-9))

    cylinder = machine.cylinders[move.axis]
    way, rest_s = cylinder.way(move.forward), cylinder.longest_rest_s(move.forward)
    opens = scans(way.least_hold_s(machine.plc))
    first = max(move.last_tick + scans(rest_s) - tick, 0)
    if first + opens >= most:
        return None
    every_s = way.closes_s + cylinder.delay.si + _SEEN_LAGS * cylinder.lag.si
    try:
        half_s = math.pi / step_ringing(machine, move.axis).pole.imag
        every_s = half_s * (2 * math.ceil((every_s / half_s - 1.0) / 2.0) + 1)
    except MachineError:
        pass  # a frame that does not ring
    on = dict(state) | dict.fromkeys((way.valve, *slowest(way)[1]), 1)
    return Creep(
        tick=tick,
        first=first,
        every=max(round(every_s / scan_s), 2 * opens),
        opens=opens,
        rest=scans(rest_s),
        most=most,
        levels=tuple(int(on[name]) for name in machine.outputs),
    )


def _creep_warning(machine: Machine, move: ScheduledMove, creep: Creep) -> dict[str, float]:
    """Return the travel in an opening, the time to the next one, and the ringing after one."""
    assert machine.plc is not None
    scan_s = float(machine.clock(machine.plc.clock).period_s)
    cylinder = machine.cylinders[move.axis]
    way = cylinder.way(move.forward)
    open_s, level = creep.opens * scan_s + way.closes_s - way.opens_s, slowest(way)[0]
    try:
        rings_m = opening_ringing_m(machine, move.axis, level, open_s)
    except MachineError:
        rings_m = 0.0
    return {
        "opening_m": level * cylinder.speed.si * open_s,
        "every_s": creep.every * scan_s,
        "rings_m": rings_m,
    }


@dataclass(slots=True)
class _Builder:
    """State of one pass through the job, during ``compile_schedule`` only."""

    job: Job
    machine: Machine
    shaping: dict[str, AxisShaping]
    tick: int = 0
    step: str = ""
    rows: dict[int, tuple[dict[str, int], int]] = field(default_factory=dict)
    events: list[Event] = field(default_factory=list)
    timeouts: list[float] = field(default_factory=list)
    moves: list[ScheduledMove] = field(default_factory=list)
    homings: list[Homing] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    state: dict[str, int] = field(default_factory=dict)
    position: dict[str, float] = field(default_factory=dict)
    on_its_way: set[str] = field(default_factory=set)
    unconfirmed: dict[str, ScheduledMove] = field(default_factory=dict)
    creeps: list[Creep] = field(default_factory=list)
    creeping: dict[str, dict[str, float]] = field(default_factory=dict)
    again_tick: int = 0

    def __post_init__(self) -> None:
        self.state = dict.fromkeys(self.machine.outputs, 0)
        self.position = dict(zip(self.job.axes, self.job.start, strict=True))

    @property
    def clock(self) -> Clock:
        assert self.machine.plc is not None
        return self.machine.clock(self.machine.plc.clock)

    def mark_again(self) -> None:
        """Note that further cycles begin here."""
        self.again_tick = self.tick

    def _ticks(self, time_s: float) -> int:
        return max(1, math.ceil(time_s / float(self.clock.period_s) - 1e-9))

    def _set(self, tick: int, values: Mapping[str, int], operation: int) -> None:
        changes, _ = self.rows.get(tick, ({}, operation))
        self.rows[tick] = ({**changes, **values}, operation)

    def add(self, index: int, operation: object) -> None:
        match operation:
            case ToolEvent(name=name):
                self.step = name.removeprefix(STEP_EVENT)
                self.events.append(
                    Event(tick=self.tick, kind="tool", operation=index, name=self.step)
                )
            case SetOutput(name=name, value=value, source=source):
                self.state[name] = int(value)
                self._check_interlocks([], self.position, source)
                self._set(self.tick, {name: int(value)}, index)
                self.tick += self._ticks(self.machine.outputs[name].ramp_s) if value else 1
            case Dwell(duration_s=duration):
                self.tick += self._ticks(duration) if duration else 0
            case WaitInput(name=name, value=value, timeout_s=timeout, source=source):
                check_timeout(timeout, float(self.clock.period_s), source)
                self.warnings += check_wait(self.machine, self.position, name, bool(value), source)
                if self.machine.contacts[name].cylinder is not None:
                    self.on_its_way.discard(str(self.machine.contacts[name].cylinder))
                if operation.creep and value:
                    self._creep(name, timeout, source)
                self.events.append(
                    Event(tick=self.tick, kind="wait", operation=index, name=name, value=value)
                )
                self.timeouts.append(timeout)
                self.tick += 1
            case Home(axes=axes, source=source):
                self._bring_home(index, axes, source)
            case Move(target=target, source=source, tags=tags):
                self._move(index, target, source, tags)
            case _:
                raise PlanError(
                    f"operation {index}: an on/off machine has no {type(operation).__name__}"
                )

    def _move(
        self, index: int, target: tuple[float, ...], source: Source, how: Mapping[str, float | str]
    ) -> None:
        check_air(self.machine, self.state, source)
        ends, before, moving = [self.tick + 1], dict(self.position), list[str]()
        if not any(
            abs(to - self.position[axis]) > _SAME_M
            for axis, to in zip(self.job.axes, target, strict=True)
        ):
            where = ", ".join(
                f"{axis} at {self.machine.cylinders[axis].place(at)}"
                for axis, at in self.position.items()
            )
            self.warnings.append(
                f"{source.place}: this move moves nothing, because the list has {where} already; a "
                "list begins at 0, and the PLC program has its own homing from other places"
            )
        for axis, to in zip(self.job.axes, target, strict=True):
            distance = to - self.position[axis]
            self.position[axis] = to
            if abs(distance) > _SAME_M:
                moving.append(axis)
                ends.append(self._stroke(index, axis, distance, source, how))
        self._check_interlocks(moving, before, source)
        self.on_its_way |= {
            axis
            for axis in moving
            if self.machine.cylinders[axis].rest_s(self.position[axis] > before[axis])
            > float(how.get(REST, math.inf))
        }
        self.tick = max(ends)

    def _bring_home(self, index: int, axes: tuple[str, ...], source: Source) -> None:
        """Bring cylinders home one after the other, from any position."""
        check_air(self.machine, self.state, source)
        for axis in axes:
            stage = home_stage(self.machine, axis, source.place)
            before, first = dict(self.position), self.tick
            self._set(first, dict.fromkeys(stage.on, 1), index)
            self.events.append(
                Event(tick=first, kind="wait", operation=index, name=stage.switch, value=1.0)
            )
            self.timeouts.append(stage.late_s)
            self.tick += self._ticks(stage.pressed_s)
            self._set(self.tick, dict.fromkeys(stage.on, 0), index)
            self.tick += self._ticks(self.machine.cylinders[axis].rest_s(forward=False))
            self.position[axis] = 0.0
            self._check_interlocks([axis], before, source)
            self.on_its_way.discard(axis)
            self.unconfirmed.pop(axis, None)
            self.homings.append(
                Homing(operation=index, axis=axis, first_tick=first, last_tick=self.tick)
            )

    def _creep(self, name: str, timeout_s: float, source: Source) -> None:
        """Let a cylinder creep to the end switch ``name`` that its last move leads to.

        The cylinder creeps only in the first wait after the move, if interlocks let it move.
        """
        contact = self.machine.contacts[name]
        move = self.unconfirmed.get(str(contact.cylinder))
        if move is None or reads_on(contact, move.begin_m):
            return
        del self.unconfirmed[move.axis]
        try:
            self._check_interlocks([move.axis], self.position, source)
        except PlanError:
            return
        creep = creep_of(self.machine, move, self.tick, self._ticks(timeout_s), self.state)
        if creep is not None:
            self.creeps.append(creep)
            warning = _creep_warning(self.machine, move, creep)
            self.creeping.setdefault(move.axis, warning)

    def _check_interlocks(
        self, moving: list[str], before: Mapping[str, float], source: Source
    ) -> None:
        on = [name for name, value in self.state.items() if value]
        check_interlocks(self.machine, moving, on, before, self.position, self.on_its_way, source)

    def _stroke(
        self, index: int, axis: str, distance: float, source: Source, how: Mapping[str, float | str]
    ) -> int:
        cylinder = self.machine.cylinders[axis]
        way = cylinder.way(distance > 0)
        levels = self._levels(axis, distance, source, how)
        for tick, level in zip(levels.ticks, levels.levels, strict=True):
            chosen = open_flows(level, way, self.machine, source.place)
            state = {way.valve: 1} | {flow: int(flow in chosen) for flow in way.flows}
            if tick == levels.ticks[-1]:
                state = dict.fromkeys(state, 0)
            self._set(self.tick + tick, state, index)
        last = self.tick + levels.ticks[-1]
        move = ScheduledMove(
            operation=index,
            step=self.step,
            axis=axis,
            begin_m=self.position[axis] - distance,
            end_m=self.position[axis],
            first_tick=self.tick,
            last_tick=last,
            levels=levels,
        )
        self.moves.append(move)
        self.unconfirmed[axis] = move
        period_s = float(self.clock.period_s)
        tell_distance(self.warnings, levels, cylinder, axis, period_s, source, "levels" in how)
        return last + self._ticks(float(how.get(REST, cylinder.rest_s(distance > 0))))

    def _levels(
        self, axis: str, distance: float, source: Source, how: Mapping[str, float | str]
    ) -> Levels:
        """Return levels that the valves can follow; impulses are moved apart only if necessary.

        A shaper or levels that the move list gives for the move replace the cylinder's shaping.
        """
        cylinder = self.machine.cylinders[axis]
        assert self.machine.plc is not None
        way, shaping = cylinder.way(distance > 0), self.shaping.get(axis)
        tick_s, need = float(self.clock.period_s), way.least_hold_s(self.machine.plc)
        if "shaper" in how:
            shaping = shaping_at(self.machine, str(how["shaper"]), source.place).get(axis)
        valves, shortest = valves_of(way, tick_s), ("", 0)
        text = str(how.get("levels", ""))
        own = levels_by_axis(text).get(axis, "" if "=" in text else text)
        for dwell_s in (0.0, need):
            if own:
                levels = written_levels(own, abs(distance), cylinder, tick_s, source.place, valves)
            else:
                levels = move_levels(abs(distance), cylinder, tick_s, shaping, dwell_s, valves)
            chosen = [open_flows(v, way, self.machine, source.place) for v in levels.levels]
            shortest = min(
                ((flow, shortest_ticks(flow, chosen, levels.ticks)) for flow in way.flows),
                key=lambda pair: pair[1],
            )
            if shortest[1] >= need / tick_s - 1e-9:
                return levels
        raise PlanError(
            f"the valve {shortest[0]!r} would switch again after "
            f"{shortest[1] * tick_s * 1e3:g} ms; it needs {need * 1e3:g} ms",
            place=source.place,
            remedy="Take a shaper with fewer impulses, a longer move or a faster valve.",
        )

    def finish(self) -> Scheduled:
        ticks, table, operations = table_of(self.rows, tuple(self.machine.outputs))
        if self.tick > self.machine.tick_budget.si:
            raise BudgetError(
                f"the job takes {self.tick} scans, limit {self.machine.tick_budget.si:g}",
                place=Place(self.job.file),
            )
        commands = SwitchSchedule(
            clock=self.clock,
            outputs=tuple(self.machine.outputs),
            ticks=ticks,
            levels=table,
            operation=operations,
            duration_ticks=self.tick,
            job_sha256=self.job.sha256,
            machine_sha256=self.machine.sha256,
            events=tuple(self.events),
            creeps=tuple(self.creeps),
        )
        return Scheduled(
            job=self.job,
            machine=self.machine,
            commands=commands,
            moves=tuple(self.moves),
            homings=tuple(self.homings),
            wait_timeouts_s=tuple(self.timeouts),
            warnings=tuple(self.warnings),
            shaping=self.shaping,
            again_tick=self.again_tick,
            creeping=self.creeping,
        )
