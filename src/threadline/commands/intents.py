"""Intents: the wanted result of a plan; of axes that follow a path, and of a schedule."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from threadline.base.arrays import finite
from threadline.commands.feedforward import Following
from threadline.files import SwitchSchedule
from threadline.jobs.operations import Job
from threadline.machine import Machine
from threadline.motion.path.types import PlannedPath, ProgrammedPath
from threadline.motion.timing.types import Trajectory

if TYPE_CHECKING:
    from threadline.commands.schedule_moves import AxisShaping, Homing, Levels
    from threadline.dynamics.preview import Demand


class Intent(Protocol):
    """The intended result of the commands: an interface for every kind of work."""

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the moving axes, in the order of all columns."""

    @property
    def duration_s(self) -> float:
        """Planned duration of the commands, s."""

    @property
    def historical(self) -> bool:
        """Whether acceleration and jerk are unlimited, as with the 1994 interpolations."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings for the user, in words."""

    def interpolation(self, options: Mapping[str, str]) -> str:
        """Return the requested interpolation, or the name that takes its place."""

    def planned_with(self, options: Mapping[str, str]) -> str:
        """Return words for the planning method."""

    def json_entries(self, options: Mapping[str, str]) -> dict[str, Any]:
        """Return the entries that this kind of work adds to the JSON of a verdict."""

    def lines_of(self, job: Job, operations: Collection[int]) -> dict[int, int]:
        """Return the line of the job for each of ``operations``, 0 for one without a line."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Motion:
    """The intent of axes that follow a path.

    Parameters
    ----------
    programmed
        Path of the job, in axis space.
    path
        Planned path.
    trajectory
        Planned path over time.
    following
        Whether the motors follow the trajectory, which is their reference, or the loads follow it
        and the inverses of the axes give the references of the motors.
    timed
        Timed path before shaping, or before smoothing for the inverses; None without either.
    demands
        Demand of the inverse model on each axis; empty if the motors follow.
    rests_s
        Rests of the loads in the table before and after their motion, which the inverses need, s.
    table_s
        Duration of a table that ends before the loads stand, s; None if the table is as long as the
        trajectory.
    needle_follows
        Whether a needle turns with the path of the head, and keeps no times of its own.
    of_averages
        Warnings about the smoothing of the motion.
    """

    programmed: ProgrammedPath
    path: PlannedPath
    trajectory: Trajectory
    following: Following = Following.MOTOR
    timed: Trajectory | None = None
    demands: tuple[Demand, ...] = ()
    rests_s: tuple[float, float] = (0.0, 0.0)
    needle_follows: bool = False
    of_averages: tuple[str, ...] = ()
    table_s: float | None = None

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the axes, in the order of all columns."""
        return self.programmed.axes

    @property
    def duration_s(self) -> float:
        """Duration of the commands, s."""
        return self.trajectory.duration_s if self.table_s is None else self.table_s

    @property
    def moving_s(self) -> tuple[float, float]:
        """Start and end of the motion on the clock of the table, s."""
        before_s, after_s = self.rests_s
        return before_s, self.trajectory.duration_s - after_s

    @property
    def historical(self) -> bool:
        """Whether this is a motion of the 1994 controller, which respects no limits."""
        return self.trajectory.historical

    @property
    def of_loads(self) -> Trajectory | None:
        """Intended positions of the loads; None if the motors follow the trajectory."""
        return self.trajectory if self.following is Following.LOAD else None

    @property
    def of_needle(self) -> Trajectory:
        """The motion to which a needle is geared.

        With feed-forward, a needle with times of its own is geared to the motion before smoothing.
        """
        if self.of_loads is not None and self.timed is not None and not self.needle_follows:
            return self.timed
        return self.trajectory

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings about smoothing, and about axes whose drive cannot give the feed-forward."""
        beyond = tuple(line for demand in self.demands if (line := _beyond(demand)))
        return self.of_averages + beyond

    def interpolation(self, options: Mapping[str, str]) -> str:
        """Return the requested interpolation, or the path's interpolation if none is requested."""
        return options.get("interpolation", self.path.interpolation)

    def planned_with(self, options: Mapping[str, str]) -> str:
        """Return words for the interpolation, with feed-forward if the loads follow."""
        name = self.interpolation(options)
        return name if self.of_loads is None else f"{name}, feed-forward"

    def json_entries(self, options: Mapping[str, str]) -> dict[str, Any]:  # noqa: ARG002
        """Return times of the motion and the feed-forward of each axis, if the loads follow."""
        if self.of_loads is None:
            return {}
        begin_s, end_s = self.moving_s
        return {
            "motion": {"begin_s": begin_s, "end_s": end_s, "duration_s": end_s - begin_s},
            "feed_forward": [
                {
                    "axis": demand.axis,
                    "current_a": demand.current_a,
                    "current_limit_a": finite(demand.current_limit_a),
                    "current_at_s": demand.current_at_s,
                    "volts": demand.volts,
                    "volt_limit": demand.volt_limit,
                    "bound_by": demand.bound_by,
                    "share": demand.share,
                }
                for demand in self.demands
            ],
        }

    def lines_of(self, job: Job, operations: Collection[int]) -> dict[int, int]:  # noqa: ARG002
        """Return the line of each operation; one without motion has the line of the motion before.

        The programmed path is read once, and no further than needed.
        """
        numbers = np.unique(np.array(list(operations), dtype=np.int64))
        lines: dict[int, int] = {}
        latest = 0
        for block in self.programmed if len(numbers) else ():
            if len(lines) == len(numbers) or not len(block):
                break
            due = numbers[len(lines) :]
            due = due[due < block.operation[-1]]
            at = np.searchsorted(block.operation, due, side="right") - 1
            for operation, index in zip(due.tolist(), at.tolist(), strict=True):
                lines[operation] = int(block.line[index]) if index >= 0 else latest
            latest = int(block.line[-1])
        for operation in numbers[len(lines) :].tolist():
            lines[operation] = latest
        return lines


def _beyond(demand: Demand) -> str:
    """Return words for a demand of an axis beyond its limit; empty if there is none."""
    if demand.share <= 1.0:
        return ""
    if demand.bound_by == "current":
        need = (
            f"{demand.current_a:.1f} A at {demand.current_at_s:.3f} s; its amplifier gives "
            f"{demand.current_limit_a:g} A"
        )
    else:
        need = f"{demand.volts:.2f} V; its controller puts out {demand.volt_limit:g} V"
    return (
        f"axes.{demand.axis}: the reference needs {need}. Smooth it over a longer time, or lower "
        "the speed"
    )


ON_OFF = "on-off"
"""Name that plans of on/off machines give in place of an interpolation."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ScheduledMove:
    """A move of the schedule: positions, scans and levels.

    Parameters
    ----------
    operation, step, axis, forward
        Operation of the job, step of the cycle, cylinder, and direction of the move.
    begin_m, end_m
        Positions at the start and at the end of the move, m.
    first_tick, last_tick
        Scans of the first and the last switching.
    levels
        Levels of the move; their ticks count from ``first_tick``.
    """

    operation: int
    step: str
    axis: str
    begin_m: float
    end_m: float
    first_tick: int
    last_tick: int
    levels: Levels

    @property
    def forward(self) -> bool:
        """Whether the move goes away from 0."""
        return self.end_m > self.begin_m


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scheduled:
    """A schedule with its moves, timeouts, warnings and shaping.

    Parameters
    ----------
    job, machine
        Job and machine of the schedule.
    commands
        Switch schedule; its events name the steps (kind ``tool``) and the waits.
    moves, homings
        All moves, and all cylinders that an operation brings home, in order.
    wait_timeouts_s
        Timeout of each event of kind ``wait``, in order, s.
    warnings
        Distances that whole scans do not give exactly, moves without travel, and waits for a
        switch whose piston stands near the switch point.
    shaping
        Shaping of each cylinder; cylinders not named move unshaped.
    again_tick
        Scan at which further cycles begin; 0 if all cycles are equal.
    single
        The schedule of one cycle, for the program of a PLC, if this schedule has a first and a
        further cycle.
    creeping
        How each cylinder creeps to a late end switch: travel ``opening_m`` in an opening of its
        valves, time ``every_s`` between openings, and ringing ``rings_m`` after one opening; the
        ringing of two openings half a period apart cancels.
    """

    job: Job
    machine: Machine
    commands: SwitchSchedule
    moves: tuple[ScheduledMove, ...]
    wait_timeouts_s: tuple[float, ...]
    homings: tuple[Homing, ...] = ()
    warnings: tuple[str, ...] = ()
    shaping: Mapping[str, AxisShaping] = field(default_factory=dict)
    again_tick: int = 0
    single: Scheduled | None = None
    creeping: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    @property
    def one_cycle(self) -> Scheduled:
        """The schedule of one cycle: ``single``, or this schedule if all cycles are equal."""
        return self if self.single is None else self.single

    @property
    def steady_tick(self) -> int:
        """Scan at which the judged cycle begins: the further cycle if there are two."""
        return 0 if self.single is None else self.single.commands.duration_ticks

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the cylinders, in the order of all columns."""
        return self.job.axes

    @property
    def duration_s(self) -> float:
        """Duration of the schedule, s; late inputs make a cycle longer."""
        return self.commands.duration_ticks * float(self.commands.clock.period_s)

    @property
    def historical(self) -> bool:
        """False: the limits of a schedule are the limits of its valves, and always hold."""
        return False

    def interpolation(self, options: Mapping[str, str]) -> str:  # noqa: ARG002
        """Return the name that takes the place of an interpolation."""
        return ON_OFF

    def planned_with(self, options: Mapping[str, str]) -> str:  # noqa: ARG002
        """Return words for the planning method."""
        return "switched"

    def json_entries(self, options: Mapping[str, str]) -> dict[str, Any]:
        """Return how cylinders creep, and their shaping if a shaper was requested."""
        creep = {"creep": self.creeping} if self.creeping else {}
        if "shaper" not in options:
            return creep
        return creep | {"shaping": {axis: one.as_json() for axis, one in self.shaping.items()}}

    def lines_of(self, job: Job, operations: Collection[int]) -> dict[int, int]:
        """Return the line of each operation, 0 for an operation without one."""
        return {i: o.source.line for i, o in enumerate(job) if i in operations}
