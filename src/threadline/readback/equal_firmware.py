"""Comparison of a plan with a program for a firmware that plans its own motion.

The program must follow the path of the plan. If the code of the firmware is available
(``klipper_host``, ``grbl_steps``, ``marlin_steps``), it also runs the program, and each step of its
motors is compared with a reference. With ``--interpolation firmware`` the plan is timed as the
firmware times the job, so the plan is the reference. Any other plan has other times; then the
reference is the motion that Threadline's model of the firmware makes of the program. The same model
predicts run times.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from threadline.commands.boards import BOARDS, LINUXCNC_BLENDS, read_written
from threadline.commands.firmware_program import as_run_times_s
from threadline.commands.plan import Plan
from threadline.files.commands import tick_table
from threadline.machine import Machine
from threadline.machine.motion_planner import LinuxCncPlanner
from threadline.motion.path import plan_path, programmed_path
from threadline.motion.path.interpolations import FIRMWARE
from threadline.motion.timing import plan_trajectory
from threadline.motion.timing.types import Trajectory
from threadline.readback import grbl_steps, klipper_host, marlin_steps
from threadline.readback.equal_found import Found
from threadline.readback.equal_programs import (
    PLACE_M,
    TIME_SHARE,
    compare_read_back,
    firmware_note,
    radius_m,
)
from threadline.readback.stepped import Beside, Steps, beside

SEGMENT_S = 0.01
"""Time for which grbl keeps one speed, s: 1 / ``ACCELERATION_TICKS_PER_SECOND``."""
STEPS = 1.0
"""Largest distance, in motor steps, between a step and the reference at the same instant."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Oracle:
    """The code of a firmware, which runs programs on this computer.

    Parameters
    ----------
    name
        Name, for messages.
    missing
        Function that returns why the code cannot be run here; an empty text if it can.
    unfit
        Function of a machine and the axes of a job that returns why the code cannot run the job;
        an empty text if it can.
    run
        Function that runs a program and returns the steps of each axis. Its arguments are the
        program, the machine, the axes, and the steps per mm or degree of each axis.
    same_instant
        Whether positions are compared at the same instant; if not, the distance of each step from
        the path is compared.
    slack_s
        Time, s, that is added to the limit of a step's difference in time.
    apart
        Function of a machine that returns how the settings compiled into the code differ from the
        machine file; an empty text if they do not.
    """

    name: str
    missing: Callable[[], str]
    unfit: Callable[[Machine, Sequence[str]], str]
    run: Callable[[Path, Machine, Sequence[str], Mapping[str, float]], dict[str, Steps]]
    same_instant: bool
    slack_s: float = 0.0
    apart: Callable[[Machine], str] = lambda _machine: ""


ORACLES: Mapping[str, Oracle] = {
    "klipper": Oracle(
        name="Klipper's host",
        missing=klipper_host.missing,
        unfit=klipper_host.unfit,
        run=klipper_host.steps_on_klipper,
        same_instant=True,
    ),
    "grbl": Oracle(
        name="grbl's own code",
        missing=grbl_steps.missing,
        unfit=grbl_steps.unfit,
        run=grbl_steps.steps_on_grbl,
        same_instant=False,
        slack_s=SEGMENT_S,
    ),
    "marlin": Oracle(
        name="Marlin's own planner",
        missing=marlin_steps.missing,
        unfit=marlin_steps.unfit,
        run=marlin_steps.steps_on_marlin,
        same_instant=False,
        apart=marlin_steps.apart,
    ),
}
"""Oracles by target. Programs for other targets are read only by Threadline's own reader."""


def missing_oracle(target: str) -> str:
    """Return why the code of a firmware cannot be run here; empty if it can, or has no oracle."""
    return ORACLES[target].missing() if target in ORACLES else ""


def compare_firmware(target: str, plan: Plan, path: Path) -> Found:
    """Compare the path of a program with ``plan``, and the steps that the firmware's code makes.

    Raises
    ------
    JobError, RecordingError
        If the program cannot be read, or the firmware refuses it.
    OptionError
        If an environment variable names the firmware's code, and the code does not run.
    """
    read_back = compare_read_back(target, plan, path)
    axes = plan.motion.trajectory.axes
    reason = f"only Threadline reads it: the code of {target} is not run"
    if target in ORACLES:
        reason = ORACLES[target].missing() or ORACLES[target].unfit(plan.machine, axes)
    reference = _reference(target, plan, path)
    if not reason and reference is None:
        reason = f"the machine file has no [planner] of {BOARDS[target].planner or target}"
    if reason or reference is None:
        with_reason = replace(read_back, note="; ".join(filter(None, (read_back.note, reason))))
        return with_reason if reference is None else _by_model(target, plan, path, with_reason)
    table = tick_table(plan.commands)
    counts_per_si = dict(zip(table.axes, table.counts_per_unit.tolist(), strict=True))
    steps_per_shown_unit = {
        axis: counts_per_si[axis] / 1e3 if plan.machine.axes[axis].kind == "linear"
        else float(np.radians(counts_per_si[axis]))
        for axis in axes
    }  # fmt: skip
    steps = ORACLES[target].run(path, plan.machine, axes, steps_per_shown_unit)
    counts_in_order = np.array([counts_per_si[axis] for axis in axes])
    start = reference(np.zeros(1))[0]
    differences = beside(steps, reference, counts_in_order, start, radius_m(plan))
    return _differences_found(target, plan, path, read_back, differences, reference)


def _by_model(target: str, plan: Plan, path: Path, read_back: Found) -> Found:
    """Add the difference between the run time by Threadline's model and the duration of the plan.

    Only a plan with the interpolation ``firmware`` has the times of the firmware; for any other
    plan, ``read_back`` is returned unchanged.
    """
    if plan.motion.path.interpolation != FIRMWARE:
        return read_back
    machine = replace(plan.machine, operator=None)
    job = read_written(path, machine, target)
    run_s = as_run_times_s(target, plan.motion.programmed, job, plan.machine)
    if run_s is None:
        return read_back
    limit_s = TIME_SHARE * plan.duration_s
    return replace(read_back, time_s=run_s[1] - plan.duration_s, time_limit_s=limit_s)


def _reference(target: str, plan: Plan, path: Path) -> Trajectory | None:
    """Return the trajectory with which the steps are compared; see the module.

    None if the machine file has no planner of this firmware.
    """
    planner = plan.machine.planner
    if planner is None or planner.kind != BOARDS[target].planner:
        return None
    if plan.motion.path.interpolation == FIRMWARE:
        return plan.motion.trajectory
    machine = replace(plan.machine, operator=None)
    job = read_written(path, machine, target)
    if isinstance(planner, LinuxCncPlanner):
        machine = replace(machine, planner=LINUXCNC_BLENDS)
    return plan_trajectory(plan_path(programmed_path(job, machine), machine, FIRMWARE), machine)


def _differences_found(
    target: str, plan: Plan, path: Path, found: Found, differences: Beside, reference: Trajectory
) -> Found:
    oracle, is_plan = ORACLES[target], reference is plan.motion.trajectory
    table = tick_table(plan.commands)
    radii = dict(zip(plan.motion.trajectory.axes, radius_m(plan).tolist(), strict=True))
    step_sizes_m = {
        axis: radii[axis] / scale
        for axis, scale in zip(table.axes, table.counts_per_unit.tolist(), strict=True)
    }
    wrong_text = ""
    if found.place > PLACE_M:
        wrong_text = f"it leaves the path of the plan by {1e6 * found.place:.3g} um at {found.at}"
    reference_text = "with the plan" if is_plan else "with the model of its planner"
    note = f"steps compared {reference_text}; ends of moves within {1e6 * found.place:.2g} um; "
    note += "".join(
        f"{settings_text}; " for settings_text in (oracle.apart(plan.machine),) if settings_text
    )
    by_steps = Found(
        reader=oracle.name,
        place=differences.off,
        place_limit=STEPS,
        unit="step",
        axis=differences.axis,
        tool_m=differences.off * step_sizes_m[differences.axis] if differences.axis else 0.0,
        time_s=differences.late_s,
        time_limit_s=TIME_SHARE * reference.duration_s + oracle.slack_s,
        at=f"{differences.at_s:.4g} s" if differences.axis else "",
        note=note + firmware_note(target, plan, path),
        wrong=wrong_text,
        curve=differences.curve,
    )
    if oracle.same_instant:
        return by_steps
    return replace(
        by_steps,
        place=differences.path_m,
        place_limit=PLACE_M + STEPS * max(step_sizes_m.values()),
        unit="m",
        axis="",
        tool_m=differences.path_m,
        at=f"{differences.path_at_s:.4g} s",
        curve=differences.path_curve,
    )
