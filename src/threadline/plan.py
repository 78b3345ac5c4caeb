"""Plan: what was intended."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from threadline.jobs.operations import Job
from threadline.machine import Machine
from threadline.path.types import PlannedPath, ProgrammedPath
from threadline.signals import Commands
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
        The trajectory before it was shaped; None where it is not shaped.
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
    options: Mapping[str, str] = field(default_factory=dict)
