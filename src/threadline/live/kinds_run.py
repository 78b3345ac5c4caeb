"""How each kind of work is run: one row for each; no other code asks for the kind."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.commands.plan import Plan
from threadline.files import (
    Commands,
    Event,
    StepPlay,
    SwitchSchedule,
    TickTable,
    played,
    tick_table,
)
from threadline.live.ahead import Ahead, halts_of_rows
from threadline.live.derived import Rest, rest_of_rows, rest_of_scans, rest_of_turns
from threadline.live.feed_override import MOST_PERCENT
from threadline.live.guards import Guards, ScanGuards, TurnGuards
from threadline.live.hold_deviation import (
    hold_ahead_m,
    hold_deviation_m,
    hold_waits,
    override_exceeds,
    override_words,
    spoiled_by_holds,
    spoiled_by_override,
)
from threadline.live.path_window import rests_of
from threadline.live.scans_ahead import ScansAhead, waits_of_schedule
from threadline.live.states import Hold
from threadline.live.turns_ahead import TurnsAhead
from threadline.live.wire import Message
from threadline.machine import Machine
from threadline.proof.kinds import kind_of
from threadline.verdict import Result, Spec


class RunAhead(Protocol):
    """The part of a run that was sent to the machine, which always ends at rest."""

    keeps_home: bool
    """Whether positions are known after a stop."""
    to_rest: bool
    """Whether a hold waits for the next rest of the program."""
    gently: bool
    """Whether the next ``cut`` and the next start from rest are gentle."""
    rate: float
    """Rows of the table to play per tick, where ``RunKind.no_override`` is empty."""

    @property
    def share_done(self) -> float | None:
        """Executed share of its commands, 0 to 1; None if it follows from the time."""

    @property
    def start(self) -> IntArray:
        """Starting position, in the units of its commands."""

    @property
    def settle_ticks(self) -> int:
        """Recording time after the end, in ticks."""

    @property
    def end(self) -> int:
        """Tick up to which the sent part lasts."""

    @property
    def complete(self) -> bool:
        """Whether the end of the commands has been sent."""

    @property
    def halt(self) -> Event | None:
        """Stop or wait at which the sent part ends."""

    @property
    def rests(self) -> bool:
        """Whether the sent part ends at the rest that ``to_rest`` asks for."""

    def refuse_elsewhere(self, stands: IntArray) -> None:
        """Refuse to begin anywhere but at ``start``."""

    def hear(self, head: Mapping[str, Any]) -> str:
        """Process the head of a report; return a fault that it reports, or nothing."""

    def met(self, now: Mapping[str, float]) -> bool:
        """Return whether it stands at a wait whose input has the wanted value."""

    def pass_halt(self) -> None:
        """Go on after the halt."""

    def forget(self, tick: int) -> None:
        """Delete data from before a tick."""

    def extend(self, until: int) -> Message:
        """Return the refill up to a tick, with a part that brings it to rest after that."""

    def cut(self, tick: int) -> Message:
        """Return the refill that brakes to rest from a tick on."""

    def undo(self) -> bool:
        """Undo the last cut, which the machine refused; return whether there was one."""

    def rest_until(self, tick: int) -> None:
        """Extend a rest to a tick."""

    def start_again(self) -> None:
        """Start from rest."""


class Watch(Protocol):
    """Guards of one run."""

    def trip(
        self, tick: int, samples: Mapping[str, FloatArray], late: bool, late_periods: float
    ) -> str:
        """Return the text of the fault in a report; empty if there is none."""


class MakeAhead(Protocol):
    """Makes the object that sends a run ahead."""

    def __call__(
        self,
        commands: Commands,
        machine: Machine,
        *,
        pass_stops: bool = False,
        loads_follow: bool = False,
    ) -> RunAhead:
        """Return the object for the beginning of a run."""


class MakeRest(Protocol):
    """Makes the commands for the rest of a job, from an operation on; see ``derived``."""

    def __call__(
        self, commands: Commands, machine: Machine, operation: int, *, at_rest: bool
    ) -> Rest:
        """Return the commands."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RunKind:
    """How one kind of work is run.

    Parameters
    ----------
    start
        Returns the starting position of commands, in their units.
    ahead
        Makes the object that sends commands ahead to the machine.
    guards
        Makes the guards of a run.
    halts
        Returns the events at which a run waits for the operator or for an input.
    hold_deviation_m
        Returns the distance of a hold from the path, in m; infinite if work can be held only at its
        rests.
    spoiled_by_holds
        Returns the criteria that a hold would put out of specification; its last argument says how
        a hold brakes.
    rest
        Makes the commands for the rest of a job.
    loads_follow
        Whether the commands of a plan make the loads follow the motion (feed-forward).
    rests_s
        Returns the (n, 2) begin and end, s, of each rest at which a hold can stand; None if a hold
        stands at once, or where the machine allows it.
    reports_plan_time
        Whether recordings give the plan time of the rows (events ``plan``).
    no_override
        Why the feed of its runs cannot be overridden; empty if it can.
    override_spoils
        Returns why an override would spoil the work of a plan; empty if it would not. Its last
        arguments are the distance of a hold from the path, and how a hold brakes.
    by_hand
        Whether its axes can be moved by hand, one at a time.
    """

    start: Callable[[Commands], IntArray]
    ahead: MakeAhead
    guards: Callable[[Machine], Watch]
    halts: Callable[[Commands], Iterable[Event]]
    hold_deviation_m: Callable[[Plan], float]
    rest: MakeRest
    spoiled_by_holds: Callable[[Plan, Spec, Hold], tuple[Result, ...]] = lambda *_: ()
    loads_follow: Callable[[Plan], bool] = lambda _: False
    rests_s: Callable[[Commands], FloatArray | None] = lambda _: None
    by_hand: bool = False
    reports_plan_time: bool = False
    no_override: str = ""
    override_spoils: Callable[[Plan, Spec, float, Hold], str] = lambda *_: ""


def _override_spoils(plan: Plan, spec: Spec, leaves_m: float, hold: Hold) -> str:
    """Return why an override would spoil the work of axes; empty if it would not."""
    if hold_waits(plan, spec, leaves_m):
        return override_words(max(leaves_m, hold_ahead_m(plan)), 100, ())
    if (percent := override_exceeds(plan)) < MOST_PERCENT:
        return f"at {percent} % its rows would go beyond the acceleration or jerk of an axis"
    return override_words(0.0, *spoiled_by_override(plan, spec, hold))


def _rests_s(commands: Commands) -> FloatArray:
    table = tick_table(commands)
    return np.asarray(rests_of(table) * float(table.clock.period_s))


_RUN_KINDS: dict[type[Commands], RunKind] = {
    TickTable: RunKind(
        start=lambda commands: tick_table(commands).start_counts,
        ahead=Ahead,
        guards=Guards,
        halts=halts_of_rows,
        hold_deviation_m=hold_deviation_m,
        spoiled_by_holds=spoiled_by_holds,
        override_spoils=_override_spoils,
        rest=rest_of_rows,
        loads_follow=lambda plan: plan.motion.of_loads is not None,
        rests_s=_rests_s,
        by_hand=True,
        reports_plan_time=True,
    ),
    SwitchSchedule: RunKind(
        start=lambda _: np.zeros(0, dtype=np.int64),
        ahead=ScansAhead,
        guards=ScanGuards,
        halts=waits_of_schedule,
        hold_deviation_m=lambda _: float("inf"),
        rest=rest_of_scans,
        no_override="its cylinders move as fast as their air, whatever the schedule is",
    ),
    StepPlay: RunKind(
        start=lambda commands: played(commands).start_steps,
        ahead=TurnsAhead,
        guards=lambda _: TurnGuards(),
        halts=lambda _: (),
        hold_deviation_m=lambda _: 0.0,
        rest=rest_of_turns,
        no_override="its frame moves by the turns of the main shaft, whose speed is set there",
    ),
}


def run_kind_of(machine: Machine) -> RunKind:
    """Return how the work of a machine is run."""
    return _RUN_KINDS[kind_of(machine).commands]
