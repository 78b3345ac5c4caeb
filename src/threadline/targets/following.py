"""The third choice of a plan: whether motors or loads follow the timed motion; their commands."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from threadline.control import Demand
from threadline.jobs.operations import Job
from threadline.machine import Machine
from threadline.shaping import Shaper, shape_trajectory
from threadline.signals import TickTable
from threadline.targets.ticks import compile_ticks
from threadline.trajectory import Trajectory


class Following(StrEnum):
    """What is to be where the trajectory says."""

    MOTOR = "motor"  # the trajectory is its reference; the load follows as belt and frame let it
    LOAD = "load"  # the reference of the motor is what the inverse of the axis asks for


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Followed:
    """A motion with the commands that follow it.

    Parameters
    ----------
    following
        What follows.
    timed
        The motion as it was timed, before it was shaped or smoothed, with the rests that are
        needed; on the clock of the recording.
    trajectory
        Where what follows is to be, on the same clock.
    commands
        What the controllers are told.
    demands
        Per axis, what the inverse of its model needs; empty where the motors follow.
    rests_s
        How long the loads rest before their motion, while the references begin, and after it,
        while what swings in the inverses decays.
    table_s
        How long the table is where it is shorter than the motion with its rests: the loops bring
        the loads to rest after it.
    """

    following: Following
    timed: Trajectory
    trajectory: Trajectory
    commands: TickTable
    demands: tuple[Demand, ...] = ()
    rests_s: tuple[float, float] = (0.0, 0.0)
    table_s: float | None = None


def followed_by_motors(
    timed: Trajectory,
    machine: Machine,
    job: Job,
    shaper: Shaper | Mapping[str, Shaper] | None = None,
) -> Followed:
    """Return the commands that are the motion itself, shaped where there is a shaper.

    Raises
    ------
    OptionError, LimitError
        As ``shape_trajectory``.
    PlanError
        As ``compile_ticks``.
    """
    trajectory = timed
    if shaper is not None:
        trajectory = shape_trajectory(timed, shaper, machine, centroid_shift=True)
    return Followed(
        following=Following.MOTOR,
        timed=timed,
        trajectory=trajectory,
        commands=compile_ticks(trajectory, machine, job),
    )
