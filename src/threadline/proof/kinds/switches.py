"""Work by switchings: cylinders are switched on and off at the scans of a PLC."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.commands.plan import Plan, Scheduled
from threadline.commands.plcopen import write_plcopen, write_scl
from threadline.commands.schedule import compile_cycles
from threadline.commands.schedule_options import shaping_of
from threadline.commands.structured_text import write_openplc, write_structured_text
from threadline.commands.write import Target, WrittenPlan
from threadline.files import Commands, Recording, SwitchSchedule, switch_schedule
from threadline.jobs.operations import Job
from threadline.machine import Machine
from threadline.machine.days import within
from threadline.machine.vary import FRICTION_OF_DAYS, SUPPLY_OF_DAYS, vary
from threadline.proof.kinds.kind import Kind
from threadline.proof.kinds.variants import one_by_one
from threadline.proof.options import Options, describe, refuse_axis_options
from threadline.twin.switching import SwitchOptions, simulate_switching


def _check(machine: Machine) -> None:
    """Accept every machine: without a loop nothing can be unstable."""


def _plan(job: Job, machine: Machine, options: Options) -> Plan:
    """Plan the schedule; the options shape each cylinder's switching."""
    shaping = (
        {}
        if options.shaper is None
        else shaping_of(
            machine, options.shaper, mode=options.shaper_mode, damping_ratio=options.shaper_damping
        )
    )
    job, scheduled = compile_cycles(job, machine, shaping)
    return Plan(
        job=job,
        machine=machine,
        commands=scheduled.commands,
        intent=scheduled,
        options=describe(job, machine, options),
    )


def _simulate(commands: Commands, machine: Machine) -> Recording:
    return simulate_switching(switch_schedule(commands), machine)


def _with_scans(commands: Commands, machine: Machine, random: np.random.Generator) -> Recording:
    """Simulate with scans that begin early or late, within the jitter of the machine file."""
    assert machine.plc is not None
    if machine.plc.jitter is None:
        return _simulate(commands, machine)
    options = SwitchOptions(scans=int(random.integers(1 << 31)))
    return simulate_switching(switch_schedule(commands), machine, options)


def _days(
    commands: Commands, machine: Machine, count: int, random: np.random.Generator
) -> Sequence[Recording]:
    """Simulate days: friction of the cylinders within +-30 %, supply within +-5 %, jitter of scans.

    The phase of the scan does not vary: every move begins at a scan, and an external input is
    assumed to be present when the schedule waits for it. The first run has the friction and supply
    of the machine file and evenly spaced scans.
    """
    machines = [machine]
    for _ in range(count - 1):
        friction, supply = random.uniform(*FRICTION_OF_DAYS), random.uniform(*SUPPLY_OF_DAYS)
        machines.append(vary(machine, friction=friction, supply=supply))
    first, *others = machines
    return [
        _simulate(commands, first),
        *(_with_scans(commands, varied, random) for varied in others),
    ]


def _on_days(commands: Commands, machine: Machine, fractions: FloatArray) -> Sequence[Recording]:
    """Simulate days at (k, 3) places, from 0 to 1: friction, supply, and seed of the jitter."""
    frictions = within(FRICTION_OF_DAYS, fractions[:, 0]).tolist()
    supplies = within(SUPPLY_OF_DAYS, fractions[:, 1]).tolist()
    seeds = (fractions[:, 2] * (1 << 31)).astype(np.int64).tolist()
    return [
        _with_scans(commands, vary(machine, friction=f, supply=s), np.random.default_rng(seed))
        for f, s, seed in zip(frictions, supplies, seeds, strict=True)
    ]


def _program(plan: WrittenPlan) -> Scheduled:
    """Return the schedule of one cycle: the program itself repeats it."""
    return plan.scheduled.single or plan.scheduled


KIND = Kind(
    name="switches",
    takes=("move list",),
    commands=SwitchSchedule,
    intent=Scheduled,
    check=_check,
    check_options=refuse_axis_options,
    plan=_plan,
    simulate=_simulate,
    days=_days,
    ranges_of_days=lambda _: 3,
    on_days=_on_days,
    others=partial(one_by_one, _with_scans),
    together=lambda _: False,
    compared={"shaper": ("none", "zv", "um-zv", "um-zvd")},
    targets={
        "openplc": Target(write=lambda plan, path: write_openplc(_program(plan), path)),
        "plcopen": Target(write=lambda plan, path: write_plcopen(_program(plan), path)),
        "scl": Target(write=lambda plan, path: write_scl(_program(plan), path)),
        "st": Target(write=lambda plan, path: write_structured_text(_program(plan), path)),
    },
)
