"""The targets: what a plan can be written as, by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Protocol

from threadline.errors import OptionError
from threadline.machine import Machine
from threadline.signals import Commands, SwitchSchedule, TickTable
from threadline.signals.files.array import write_array
from threadline.signals.files.common import Written, written
from threadline.signals.files.table import write_table_csv, write_table_npz
from threadline.targets.calculate import CompiledPlan
from threadline.targets.nc import NcStyle, write_part_program
from threadline.targets.planned_job import planned_job
from threadline.targets.plcopen import write_plcopen
from threadline.targets.schedule import Scheduled
from threadline.targets.structured_text import write_structured_text
from threadline.trajectory.types import Trajectory
from threadline.wording import nearest

TableWriter = Callable[[TickTable, Path], Written]

TABLES: dict[str, TableWriter] = {
    "csv": write_table_csv,
    "npz": write_table_npz,
    "ticks": write_array,
}
"""Targets that need the tick table alone."""


class TimedPlan(CompiledPlan, Protocol):
    """What a target of moves needs: the trajectory too."""

    @property
    def trajectory(self) -> Trajectory:
        """The planned motion."""
        ...


PlanWriter = Callable[[TimedPlan, Path], Written]


def write_nc(plan: TimedPlan, path: Path) -> Written:
    """Write the planned motion as a part program: chords with their times (G93), blended (G64)."""
    job = planned_job(plan.job, plan.trajectory, plan.machine)
    # The plan has already been held to the operator's normal feed; its times are not to be
    # stretched again.
    machine = replace(plan.machine, operator=None)
    write_part_program(job, machine, path, style=NcStyle.LINUXCNC)
    return written(path)


PLANS: dict[str, PlanWriter] = {"nc": write_nc}
"""Targets that need the whole plan."""

ScheduleWriter = Callable[[Scheduled, Path], list[Written]]

SCHEDULES: dict[str, ScheduleWriter] = {
    "plcopen": write_plcopen,
    "st": write_structured_text,
}
"""Targets of on/off machines."""
_FOR_ON_OFF = f"An on/off machine is written as {' and '.join(sorted(SCHEDULES, reverse=True))}."


def target_names() -> tuple[str, ...]:
    """Return the names of all targets."""
    return tuple(sorted([*TABLES, *PLANS, *SCHEDULES]))


def check_target(target: str, machine: Machine) -> None:
    """Refuse a target that is unknown or not of this kind of machine, before anything is planned.

    Raises
    ------
    OptionError
        If it is.
    """
    if target not in target_names():
        raise OptionError(f"unknown target {target[:40]!r}", remedy=nearest(target, target_names()))
    if machine.cylinders and target not in SCHEDULES:
        raise OptionError(
            f"target {target!r} is of machines with axes, and {machine.name} switches on and off",
            remedy=f"Use {' or '.join(SCHEDULES)}.",
        )
    if not machine.cylinders and target in SCHEDULES:
        raise OptionError(
            f"target {target!r} is made from the schedule of an on/off machine, which "
            f"{machine.name} is not",
            remedy=f"Use {', '.join([*TABLES, *PLANS])}, or a machine with cylinders.",
        )


def write(plan: TimedPlan | Commands | Scheduled, target: str, out: str | Path) -> list[Written]:
    """Write ``plan`` for a controller; whole files or none.

    Parameters
    ----------
    plan
        A plan, or for ``csv``, ``npz`` and ``ticks`` the commands alone; for ``st`` and
        ``plcopen`` what ``compile_schedule`` returns.
    target
        ``csv``: every tick on a line. ``npz``: the same as arrays. ``ticks``: the trajectory
        array of the 1994 controller. ``nc``: a part program for LinuxCNC. ``st``:
        structured text for a PLC, its configuration in a second file. ``plcopen``: the same as
        PLCopen XML.
    out
        The file.

    Returns
    -------
    list of Written
        The files with their hashes.

    Raises
    ------
    OptionError
        If there is no such target.
    PlanError
        If the commands break a limit; nothing is written then.
    """
    path = Path(out)
    if target in SCHEDULES:
        if not isinstance(plan, Scheduled):
            raise OptionError(
                f"target {target!r} is made from the schedule of an on/off machine",
                remedy="Give a move list and a machine with cylinders.",
            )
        return SCHEDULES[target](plan, path)
    if target in PLANS:
        if isinstance(plan, TickTable | SwitchSchedule | Scheduled):
            switched = isinstance(plan, SwitchSchedule | Scheduled)
            raise OptionError(
                f"target {target!r} is made from the planned motion of axes, which "
                f"{'an on/off machine does not have' if switched else 'a tick table is not'}",
                remedy=_FOR_ON_OFF if switched else "Give the job and the machine.",
            )
        return [PLANS[target](plan, path)]
    if target not in TABLES:
        raise OptionError(f"unknown target {target[:40]!r}", remedy=nearest(target, target_names()))
    commands = plan if isinstance(plan, TickTable | SwitchSchedule) else plan.commands
    if not isinstance(commands, TickTable):
        raise OptionError(
            f"target {target!r} is a table of counts, which an on/off machine does not have",
            remedy=_FOR_ON_OFF,
        )
    return [TABLES[target](commands, path)]
