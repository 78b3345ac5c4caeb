"""Plan: the intended work on a machine, with its commands."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar

import numpy as np

from threadline.base.arrays import finite
from threadline.commands.feedforward import Following
from threadline.commands.schedule import Scheduled
from threadline.commands.stitched import Stitched
from threadline.dynamics import Demand
from threadline.errors import PlanError
from threadline.files import Commands
from threadline.jobs.feed_times import programmed_time_s
from threadline.jobs.operations import Feed, FeedMode, Job
from threadline.machine import Machine
from threadline.motion.path.types import PlannedPath, ProgrammedPath
from threadline.motion.timing.types import Trajectory

__all__ = ["Following", "Intent", "Motion", "Plan", "Scheduled", "Stitched"]

IntentT = TypeVar("IntentT")


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

    def told(self, options: Mapping[str, str]) -> dict[str, Any]:
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

    def told(self, options: Mapping[str, str]) -> dict[str, Any]:  # noqa: ARG002
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
        wanted = np.unique(np.array(list(operations), dtype=np.int64))
        lines: dict[int, int] = {}
        latest = 0
        for block in self.programmed if len(wanted) else ():
            if len(lines) == len(wanted) or not len(block):
                break
            due = wanted[len(lines) :]
            due = due[due < block.operation[-1]]
            at = np.searchsorted(block.operation, due, side="right") - 1
            for operation, index in zip(due.tolist(), at.tolist(), strict=True):
                lines[operation] = int(block.line[index]) if index >= 0 else latest
            latest = int(block.line[-1])
        for operation in wanted[len(lines) :].tolist():
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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, weakref_slot=True)
class Plan:
    """All decisions before the machine moves, for any kind of work.

    Parameters
    ----------
    job, machine
        Job and machine of the plan.
    commands
        Commands for the controller.
    intent
        Intended result: paths and a trajectory, a schedule with its moves, or stitches.
    options
        Options of the plan (interpolation, feed, tolerance) as text, for people and recordings.
    """

    job: Job
    machine: Machine
    commands: Commands
    intent: Intent
    options: Mapping[str, str] = field(default_factory=dict)

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the moving axes, in the order of all columns."""
        return self.intent.axes

    @property
    def duration_s(self) -> float:
        """Planned duration, s; late inputs make a job longer."""
        return self.intent.duration_s

    @property
    def feed_override(self) -> float | None:
        """Factor on the feeds of the job, 1 as programmed; None if another feed replaces them."""
        text = self.options.get("feed", "programmed")
        if text.endswith("%"):
            return float(text.removesuffix("%")) / 100.0
        return 1.0 if text == "programmed" else None

    @property
    def limits_in_full(self) -> bool:
        """Whether the plan may use the full limits of acceleration and jerk."""
        return float(self.options.get("limits", "100 %").removesuffix("%")) == 100.0

    @property
    def nominal_s(self) -> float | None:
        """Time by the programmed feeds alone, s; None without a rule for F, or with ``--feed``."""
        override = self.feed_override
        if not self.job.feed_rule or override is None:
            return None
        return programmed_time_s(self.job, self.machine, Feed(FeedMode.OVERRIDE, override))

    @property
    def interpolation(self) -> str:
        """The requested interpolation, or the name that takes its place."""
        return self.intent.interpolation(self.options)

    @property
    def planned_with(self) -> str:
        """Words for the planning method."""
        return self.intent.planned_with(self.options)

    def intended(self, wanted: type[IntentT]) -> IntentT:
        """Return the intent of this plan, which must be of type ``wanted``.

        Raises
        ------
        PlanError
            If the intent is of another type: a schedule has no path, and a path has no schedule.
        """
        if not isinstance(self.intent, wanted):
            raise PlanError(
                f"{self.job.name} on {self.machine.name} is planned as "
                f"{type(self.intent).__name__}, not as {wanted.__name__}",
                remedy="Take a machine and a job of the other kind.",
            )
        return self.intent

    @property
    def motion(self) -> Motion:
        """Paths and trajectory; PlanError (see ``intended``) for other kinds of work."""
        return self.intended(Motion)

    @property
    def scheduled(self) -> Scheduled:
        """Schedule and moves; PlanError (see ``intended``) for other kinds of work."""
        return self.intended(Scheduled)

    @property
    def stitched(self) -> Stitched:
        """Turns and stitches; PlanError (see ``intended``) for other kinds of work."""
        return self.intended(Stitched)
