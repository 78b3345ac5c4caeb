"""Plan: what was intended."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from threadline.control import Demand
from threadline.jobs.operations import Job
from threadline.machine import Machine
from threadline.path.types import PlannedPath, ProgrammedPath
from threadline.signals import Commands, SwitchSchedule
from threadline.targets.schedule import Scheduled
from threadline.trajectory.types import Trajectory


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Plan:
    """Everything that was decided before the machine moved.

    Parameters
    ----------
    job, machine
        The two inputs.
    programmed
        What the job says, in axis space.
    path
        What will be followed.
    trajectory
        The path over time.
    commands
        What the controller is given.
    unshaped
        The trajectory before it was shaped, or smoothed for feed-forward; None where it is
        neither.
    feed_forward
        What the motion asks of each axis where the commands come from the inverses of the axes,
        so that the loads follow the trajectory as it stands; empty where the commands are the
        trajectory itself.
    rests_s
        How long the loads rest in the table before their motion and after it, for the sake of
        feed-forward.
    options
        How it was planned (interpolation, feed, tolerance), as text, for people and recordings.
    """

    job: Job
    machine: Machine
    programmed: ProgrammedPath
    path: PlannedPath
    trajectory: Trajectory
    commands: Commands
    unshaped: Trajectory | None = None
    feed_forward: tuple[Demand, ...] = ()
    rests_s: tuple[float, float] = (0.0, 0.0)
    options: Mapping[str, str] = field(default_factory=dict)

    @property
    def interpolation(self) -> str:
        """The interpolation that was asked for; feed-forward has ``auto`` keep programmed times."""
        return self.options.get("interpolation", self.path.interpolation)

    @property
    def motion_s(self) -> tuple[float, float]:
        """When the motion begins and ends, on the clock of the table."""
        before_s, after_s = self.rests_s
        return before_s, self.trajectory.duration_s - after_s

    @property
    def planned_with(self) -> str:
        """Interpolation, and feed-forward where it was asked for, for people."""
        return f"{self.interpolation}, feed-forward" if self.feed_forward else self.interpolation


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SwitchPlan:
    """Everything that was decided before an on/off machine moved.

    Such a machine is told when to switch and not where to be: there are moves with levels instead
    of paths and a trajectory.

    Parameters
    ----------
    scheduled
        Job, machine, schedule, and every move with its levels.
    options
        How it was planned (shaper), as text, for people and recordings.
    """

    scheduled: Scheduled
    options: Mapping[str, str] = field(default_factory=dict)

    @property
    def job(self) -> Job:
        """The job."""
        return self.scheduled.job

    @property
    def machine(self) -> Machine:
        """The machine."""
        return self.scheduled.machine

    @property
    def commands(self) -> SwitchSchedule:
        """What the PLC is given."""
        return self.scheduled.commands

    @property
    def duration_s(self) -> float:
        """Of the schedule; inputs that come late make a cycle longer."""
        return self.commands.duration_ticks * float(self.commands.clock.period_s)
