"""The targets, by name: formats in which a plan can be written."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

from threadline.commands.boards import BOARDS, refuse_lost
from threadline.commands.firmware_program import refuse_slower, write_firmware_program
from threadline.commands.nc import NcStyle, write_part_program
from threadline.commands.planned_job import planned_job
from threadline.commands.plcopen import write_plcopen, write_scl
from threadline.commands.schedule import Scheduled
from threadline.commands.step_files import write_steps, write_t15
from threadline.commands.stitched import Stitched
from threadline.commands.structured_text import write_structured_text
from threadline.errors import Place, PlanError
from threadline.files import Commands, TickTable
from threadline.files.formats.common import Written, written
from threadline.files.formats.tick_table import Beside, write_table_csv, write_table_npz
from threadline.files.formats.trajectory_array import write_array
from threadline.jobs.operations import FeedMode, Job, Move, Stop, ToolEvent
from threadline.machine import Machine
from threadline.motion.path.types import ProgrammedPath
from threadline.motion.timing.types import Trajectory


class TableWriter(Protocol):
    """Writes a tick table."""

    def __call__(self, table: TickTable, path: Path, needle: Beside | None = None) -> Written:
        """Write ``table`` to ``path``; rows of a seam also have the columns of ``needle``."""
        ...


TABLES: dict[str, TableWriter] = {
    "csv": write_table_csv,
    "npz": write_table_npz,
    "ticks": write_array,
}
"""The writers of a tick table, by the word of ``--target``."""


class Timed(Protocol):
    """The part of an intent that targets of moves use."""

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


def write_nc(job: Job, trajectory: Trajectory, machine: Machine, path: Path) -> Written:
    """Write the planned motion as a part program: chords with their times (G93), blended (G64).

    A G0 becomes a G1 with its planned time, because LinuxCNC would choose its own time for a G0,
    and the program would no longer match the plan. A G0 with a laser on is refused: HAL tells G0
    from G1 (``motion.motion-type``), and a laser may burn in G1 only. A tool that goes down into
    the material is no laser, and its spindle turns in a G0 as in a G1. Outputs (M62, M64) have the
    state that the program gives them in either.

    Raises
    ------
    PlanError
        If LinuxCNC reads a word of the job differently, or a G0 has a spindle on that may be a
        laser.
    """
    refuse_lost(job, machine, NcStyle.LINUXCNC)
    rapids = _dark_rapids(job)
    timed = planned_job(job, trajectory, machine)
    # The plan already respects the operator's normal feed; do not apply the feed to its times
    # again.
    write_part_program(timed, replace(machine, operator=None), path, style=NcStyle.LINUXCNC)
    if not rapids:
        return written(path)
    count = "1 G0 is a G1" if rapids == 1 else f"{rapids} G0 are G1"
    told = f"{count} with the planned time (G93)"
    return written(path, (f"{path.name}: {told}; --target linuxcnc keeps G0",))


def _dark_rapids(job: Job) -> int:
    """Return the number of moves at G0; refuse a G0 with a spindle on that may be a laser.

    It is none if a feed move with the spindle on goes down along Z.
    """
    spindle, power, count, at = "", 1.0, 0, job.start
    lit: tuple[str, Place] | None = None  # the first G0 with the spindle on
    height = job.axes.index("Z") if "Z" in job.axes else None
    plunges = False
    for operation in job:
        acts: tuple[ToolEvent | Stop, ...] = ()
        if isinstance(operation, Move):
            acts = operation.acts
        elif isinstance(operation, ToolEvent | Stop):
            acts = (operation,)
        for act in acts:
            for word in act.words.split():
                if word in {"M3", "M4", "M5"}:
                    spindle = "" if word == "M5" else f"{word} (line {act.source.line})"
                elif word.startswith("S"):
                    power = float(word[1:])
        if not isinstance(operation, Move):
            continue
        before, at = at, operation.target
        feed, lights = operation.feed, bool(spindle and power)
        if feed is None or feed.mode is not FeedMode.RAPID:
            plunges |= lights and height is not None and at[height] < before[height]
        elif before != at:
            count += 1
            lit = lit or ((spindle, operation.source.place) if lights else None)
    if lit is not None and not plunges:
        raise PlanError(
            f"{lit[0]} is on in a G0, which the target nc writes as a G1 with its planned time, "
            "and no feed move goes down along Z: a laser that HAL switches off in G0 would burn "
            "there",
            place=lit[1],
            remedy="Write M5 before the G0, or choose --target linuxcnc, which keeps G0.",
        )
    return count


def _of_firmware(name: str) -> Target:
    def write_one(plan: WrittenPlan, path: Path, slower: bool) -> Written:
        return write_firmware_program(
            name,
            plan.job,
            plan.motion.trajectory,
            plan.machine,
            path,
            programmed=plan.motion.programmed,
            override=plan.feed_override,
            slower=slower,
        )

    def no_slower(plan: WrittenPlan, path: Path) -> list[Written]:
        # With a share of the limits the user asked for the planned speeds, so they stay.
        gentle = not plan.limits_in_full
        file = write_one(plan, path, slower=gentle)
        refuse_slower(name, plan.job, file.as_run_s)
        return [file]

    return Target(
        write=lambda plan, path: [write_one(plan, path, slower=True)],
        takes_shaped=False,
        write_no_slower=no_slower,
    )


TICK_TARGETS: Mapping[str, Target] = {
    "nc": Target(
        write=lambda plan, path: [write_nc(plan.job, plan.motion.trajectory, plan.machine, path)],
        takes_shaped=False,
    ),
    **{name: _of_firmware(name) for name in BOARDS},
}
"""Targets of machines whose controllers take one row per tick."""
SWITCH_TARGETS: Mapping[str, Target] = {
    "plcopen": Target(write=lambda plan, path: write_plcopen(plan.scheduled, path)),
    "scl": Target(write=lambda plan, path: write_scl(plan.scheduled, path)),
    "st": Target(write=lambda plan, path: write_structured_text(plan.scheduled, path)),
}
"""Targets of on/off machines."""
STEP_TARGETS: Mapping[str, Target] = {
    "steps": Target(write=lambda plan, path: write_steps(plan.stitched, path)),
    "t15": Target(write=lambda plan, path: [write_t15(plan.stitched, path)]),
}
"""Targets of machines that play step tables between stitches."""
