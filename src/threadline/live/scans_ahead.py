"""The part of a schedule sent ahead to the controller of a machine with cylinders.

The controller waits for its contacts itself, scan by scan. The part of the schedule that it holds
ends at a place that it does not pass, and at a scan from which on it switches everything off.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from threadline.base.arrays import IntArray
from threadline.errors import CommandError, LimitError
from threadline.files import Commands, Event, switch_schedule
from threadline.live.wire import Message, event_row
from threadline.machine import Machine

_AT_REST = frozenset(("soft-start", "vacuum"))
"""Kinds of outputs that may be on while nothing moves: air, and grips."""
_SETTLE_S = 1.0
"""Recording time in s after the end, as in a simulation."""


class ScansAhead:
    """The part of a schedule that was sent, and the scan at which the machine switches off.

    Parameters
    ----------
    commands
        Schedule to run.
    machine
        Machine with its outputs.
    pass_stops, loads_follow
        Unused: a move list has no stops for the operator, and cylinders have no loops.

    Attributes
    ----------
    end
        Scan up to which the machine goes on without another refill.
    start
        (0,): nothing is counted.
    to_rest
        Whether the schedule is to stand at its next rest.

    Raises
    ------
    CommandError
        If the schedule is for other outputs.
    """

    keeps_home = False  # an interrupted schedule leaves cylinders anywhere
    rate = 1.0  # a schedule has no feed override

    def __init__(
        self,
        commands: Commands,
        machine: Machine,
        *,
        pass_stops: bool = False,  # noqa: ARG002
        loads_follow: bool = False,  # noqa: ARG002
    ) -> None:
        schedule = switch_schedule(commands)
        if schedule.outputs != tuple(machine.outputs):
            raise CommandError(
                f"the schedule is for other outputs than {machine.name} has",
                remedy="Prove the job again.",
            )
        self._schedule, self._machine = schedule, machine
        self._waits = waits_of_schedule(schedule)
        self._rests = _rests(machine, schedule.ticks, schedule.levels, schedule.operation)
        self.start: IntArray = np.zeros(0, dtype=np.int64)
        period_s = float(schedule.clock.period_s)
        self.settle_ticks = max(1, round(_SETTLE_S / period_s))
        self.end = 0
        self.to_rest = self.gently = False
        self._rows = self._sent_waits = self._sent_creeps = self._reach = 0
        self._place = self._now = 0  # as reported
        self._off: int | None = None
        self._ending = False

    @property
    def complete(self) -> bool:
        """Whether the machine has played the whole schedule."""
        return self._off is not None and self._ending

    @property
    def halt(self) -> Event | None:
        """None: the controller waits for its contacts itself."""
        return None

    @property
    def share_done(self) -> float:
        """Share of the schedule that the controller has passed; it may wait at a contact."""
        return min(self._place / self._schedule.duration_ticks, 1.0)

    @property
    def rests(self) -> bool:
        """False: a machine at a rest needs repeated messages, or it switches off."""
        return False

    def met(self, now: Mapping[str, float]) -> bool:  # noqa: ARG002
        """Return False: there is no halt."""
        return False

    def pass_halt(self) -> None:
        """Do nothing: there is no halt."""

    def refuse_elsewhere(self, stands: IntArray) -> None:
        """Do nothing: the schedule itself waits until cylinders are at their starts."""

    def hear(self, head: Mapping[str, Any]) -> str:
        """Process the place of the schedule in a report; return a fault of the machine."""
        self._place, self._now = int(head["place"]), int(head["now"])
        self._off = None if head["off"] is None else int(head["off"])
        if self._off is not None:
            self.end = self._off
        return str(head["failure"])

    def forget(self, tick: int) -> None:
        """Do nothing: little is kept."""

    def rest_until(self, tick: int) -> None:
        """Do nothing: a schedule that stands needs no rows."""

    def start_again(self) -> None:
        """Do nothing: the next refill lets it go on."""

    def undo(self) -> bool:
        """Return False: a stop is never refused."""
        return False

    def extend(self, until: int) -> Message:
        """Return the refill that lets the schedule go on until about scan ``until``."""
        schedule = self._schedule
        goal_place = min(self._place + until - self._now, schedule.duration_ticks)
        if self.to_rest:
            rest_index = np.searchsorted(self._rests, self._reach)
            if rest_index < len(self._rests):
                goal_place = min(goal_place, int(self._rests[rest_index]))
        self._reach = max(goal_place, self._reach)
        self._ending = self._reach >= schedule.duration_ticks
        row_count = int(np.searchsorted(schedule.ticks, self._reach, side="right"))
        wait_count = sum(event.tick <= self._reach for event in self._waits)
        creep_count = sum(creep.tick <= self._reach for creep in schedule.creeps)
        new_rows = slice(self._rows, row_count)
        head = {
            "after": self._rows,
            "reach": self._reach,
            "duration": schedule.duration_ticks if self._ending else None,
            "off": until,
            "last": self._ending,
            "events": [event_row(event) for event in self._waits[self._sent_waits : wait_count]],
            "creeps": [
                list(creep.row) for creep in schedule.creeps[self._sent_creeps : creep_count]
            ],
        }
        levels = schedule.levels[new_rows]
        self._check(levels)
        arrays = {
            "ticks": schedule.ticks[new_rows],
            "levels": levels,
            "operation": schedule.operation[new_rows],
        }
        self._rows, self._sent_waits, self._sent_creeps = row_count, wait_count, creep_count
        self.end = until
        return Message("refill", head, arrays)

    def cut(self, tick: int) -> Message:
        """Return the message that switches everything off at the next scan."""
        self.end = tick
        return Message("refill", {"off": tick, "last": True})

    def _check(self, levels: IntArray) -> None:
        """Refuse rows that switch both valves of a cylinder on.

        Raises
        ------
        LimitError
            If a row does so; the error names the cylinder, and the rows are not sent.
        """
        names = list(self._machine.outputs)
        for name, cylinder in self._machine.cylinders.items():
            valve_columns = [
                names.index(direction.valve) for direction in (cylinder.forward, cylinder.back)
            ]
            if valve_columns[0] != valve_columns[1] and levels[:, valve_columns].all(axis=1).any():
                raise LimitError(
                    f"cylinder {name}: a row switches both of its valves on",
                    axis=name,
                    quantity="valves",
                    value_si=2.0,
                    limit_si=1.0,
                    remedy="Prove the job again; Threadline's schedules never do this.",
                )


def _rests(machine: Machine, ticks: IntArray, levels: IntArray, operation: IntArray) -> IntArray:
    """Return the places at which a schedule may stand: nothing moves, and no tool works.

    A shaped move switches off and on again within its operation, and does not rest there.
    """
    working_columns = [
        k for k, output in enumerate(machine.outputs.values()) if output.kind not in _AT_REST
    ]
    is_working = levels[:, working_columns].max(axis=1, initial=0).tolist()
    last_working_row = {int(op): k for k, op in enumerate(operation) if is_working[k]}
    return np.array(
        [
            tick
            for k, tick in enumerate(ticks)
            if not is_working[k] and last_working_row.get(int(operation[k]), -1) < k
        ],
        dtype=np.int64,
    )


def waits_of_schedule(commands: Commands) -> tuple[Event, ...]:
    """Return the waits of a schedule."""
    return tuple(event for event in switch_schedule(commands).events if event.kind == "wait")
