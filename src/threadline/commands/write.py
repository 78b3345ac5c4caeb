"""The targets, by name: formats in which a plan can be written."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from threadline.commands.boards import BOARDS
from threadline.commands.intents import Scheduled
from threadline.commands.turns import Stitched
from threadline.files import Commands, TickTable
from threadline.files.formats.common import Written
from threadline.jobs.operations import Job
from threadline.machine import Machine
from threadline.machine.motion_planner import LinuxCncPlanner
from threadline.motion.path.interpolations import FIRMWARE
from threadline.motion.path.types import PlannedPath, ProgrammedPath
from threadline.motion.timing.types import Trajectory

if TYPE_CHECKING:
    from threadline.files.formats.tick_table import NeedleSource


class TableWriter(Protocol):
    """Writes a tick table."""

    def __call__(self, table: TickTable, path: Path, needle: NeedleSource | None = None) -> Written:
        """Write ``table`` to ``path``; rows of a seam also have the columns of ``needle``."""
        ...


TABLES = {
    "csv": "threadline.files.formats.tick_table:write_table_csv",
    "npz": "threadline.files.formats.tick_table:write_table_npz",
    "ticks": "threadline.files.formats.trajectory_array:write_array",
}
"""Module and function that write a tick table, by the word of ``--target``."""


def table_writer(target: str) -> TableWriter:
    """Return the writer of a tick table for a word of ``--target``."""
    module, function = TABLES[target].split(":")
    found: TableWriter = getattr(import_module(module), function)
    return found


class Timed(Protocol):
    """The part of an intent that targets of moves use."""

    @property
    def path(self) -> PlannedPath:
        """Planned path."""
        ...

    @property
    def programmed(self) -> ProgrammedPath:
        """Path of the job, at the requested feeds."""
        ...

    @property
    def trajectory(self) -> Trajectory:
        """The planned motion."""
        ...


class WrittenPlan(Protocol):
    """The part of a plan that targets read; each target reads the fields of its kind of work."""

    @property
    def job(self) -> Job:
        """Job of the plan."""
        ...

    @property
    def machine(self) -> Machine:
        """Machine of the plan."""
        ...

    @property
    def commands(self) -> Commands:
        """Commands for the controller."""
        ...

    @property
    def feed_override(self) -> float | None:
        """Factor on the feeds of the job; None if another feed replaces them."""
        ...

    @property
    def limits_in_full(self) -> bool:
        """Whether the plan may use the full limits of acceleration and jerk."""
        ...

    @property
    def motion(self) -> Timed:
        """Paths and trajectory."""
        ...

    @property
    def scheduled(self) -> Scheduled:
        """Schedule and moves."""
        ...

    @property
    def stitched(self) -> Stitched:
        """Turns and stitches."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Target:
    """A format in which a plan can be written.

    Parameters
    ----------
    write
        Function that writes complete files, or none.
    takes_shaped
        Whether the target can hold a shaped motion or a motion with feed-forward.
    write_no_slower
        Function that writes a program for which the firmware takes no longer than for the job
        itself, or refuses; None if no firmware planner runs the file.
    """

    write: Callable[[WrittenPlan, Path], list[Written]]
    takes_shaped: bool = True
    write_no_slower: Callable[[WrittenPlan, Path], list[Written]] | None = None


def _write_nc(plan: WrittenPlan, path: Path) -> list[Written]:
    from threadline.commands.nc import write_nc

    return [write_nc(plan.job, plan.motion.trajectory, plan.machine, path)]


def _keeps_vertices(plan: WrittenPlan) -> bool:
    """Return whether a plan goes through the ends of the program's moves; LinuxCNC's does not."""
    as_firmware = plan.motion.path.interpolation == FIRMWARE
    return as_firmware and not isinstance(plan.machine.planner, LinuxCncPlanner)


def _of_firmware(name: str) -> Target:
    def write_one(plan: WrittenPlan, path: Path, slower: bool) -> Written:
        from threadline.commands.firmware_program import write_firmware_program
        from threadline.commands.merged_chords import Chords

        chords = Chords(
            name,
            plan.job,
            plan.motion.trajectory,
            plan.machine,
            plan.feed_override,
            vertices=_keeps_vertices(plan),
        )
        return write_firmware_program(
            chords, path, programmed=plan.motion.programmed, slower=slower
        )

    def no_slower(plan: WrittenPlan, path: Path) -> list[Written]:
        from threadline.commands.firmware_program import refuse_slower

        # With a share of the limits the user asked for the planned speeds, so they stay.
        slower = not plan.limits_in_full
        file = write_one(plan, path, slower=slower)
        refuse_slower(name, plan.job, file.as_run_s, plan.feed_override)
        return [file]

    return Target(
        write=lambda plan, path: [write_one(plan, path, slower=True)],
        takes_shaped=False,
        write_no_slower=no_slower,
    )


TICK_TARGETS: Mapping[str, Target] = {
    "nc": Target(write=_write_nc, takes_shaped=False),
    **{name: _of_firmware(name) for name in BOARDS},
}
"""Targets of machines whose controllers take one row per tick."""
