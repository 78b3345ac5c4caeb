"""Work by step tables, which move a frame between the strokes of its needles."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.commands.plan import Plan, Stitched
from threadline.commands.stitched import stitch
from threadline.commands.write import Target, WrittenPlan
from threadline.errors import OptionError, Place, PlanError
from threadline.files import Commands, Recording, StepPlay, played
from threadline.files.formats.common import Written
from threadline.jobs.operations import FeedMode, Job
from threadline.machine import Machine
from threadline.machine.vary import DAMPING_OF_DAYS, vary
from threadline.motion.shaping.shaped_law import law_named
from threadline.proof.kinds.kind import Kind
from threadline.proof.kinds.variants import one_by_one
from threadline.proof.options import LEAVE_OUT, Options, describe, foreign_options
from threadline.twin.stitching import simulate_stitching
from threadline.twin.stitching_run import driven_of

DEFAULT_ROBUST = 0.05
"""Default share of the tolerances of loads and springs that a plan covers."""


def _check(machine: Machine) -> None:
    """Refuse a frame that is not linear, or not driven by step servos."""
    driven_of(machine)


def _check_options(machine: Machine, options: Options) -> None:
    if names := foreign_options(KIND.name, machine, options):
        raise OptionError(
            f"{machine.name} takes no {' or '.join(names)}, because it moves between its stitches "
            "by a law, without a path, shaper or feed-forward to choose",
            remedy='Leave it out, or name a law: --interpolation "law:cycloidal".'
            if names == ["--interpolation"]
            else LEAVE_OUT[len(names) > 1],
        )
    if options.feed is not None and options.feed.mode is not FeedMode.SHAFT:
        raise OptionError(
            f"the speed of {machine.name} is the speed of its shaft, in stitches",
            remedy='Write it like --feed "120 stitch/min".',
        )


def _plan(job: Job, machine: Machine, options: Options) -> Plan:
    """Plan the turns of the shaft: all at the given speed, else each only as slow as it must be."""
    if job.paced_by != "shaft":
        raise PlanError(
            f"{machine.name} sews embroidery designs, and {job.name} is not one",
            place=Place(job.file),
            remedy="Give a design such as .dst, or take a machine for such jobs.",
        )
    assert machine.tables is not None
    law_name = options.timing.law or machine.tables.law
    stitched = stitch(
        job,
        machine,
        law_named(law_name),
        options.tolerance_m,
        None if options.feed is None else 1.0 / options.feed.value,
        DEFAULT_ROBUST if options.robust_share is None else options.robust_share,
    )
    return Plan(
        job=job,
        machine=machine,
        commands=stitched.commands,
        intent=stitched,
        options=describe(job, machine, options),
    )


def _simulate(commands: Commands, machine: Machine) -> Recording:
    return simulate_stitching(played(commands), machine)


def _any_day(commands: Commands, machine: Machine, _random: np.random.Generator) -> Recording:
    """Simulate one machine; step servos have no encoder phases to draw."""
    return _simulate(commands, machine)


def _days(
    commands: Commands, machine: Machine, count: int, random: np.random.Generator
) -> Sequence[Recording]:
    """Simulate days on which the damping of bodies and links differs by up to 30 %.

    Nothing else varies from day to day: a servo's steps are exact at any supply voltage. The first
    day has the damping of the machine file.
    """
    machines = [machine]
    machines += [vary(machine, damping=random.uniform(*DAMPING_OF_DAYS)) for _ in range(count - 1)]
    return [_simulate(commands, varied) for varied in machines]


def _on_days(commands: Commands, machine: Machine, fractions: FloatArray) -> Sequence[Recording]:
    """Simulate days with damping at (k, 1) places, from 0 to 1, of the range of +-30 %."""
    from threadline.machine.days import within  # only searches need it

    return [
        _simulate(commands, vary(machine, damping=factor))
        for factor in within(DAMPING_OF_DAYS, fractions[:, 0]).tolist()
    ]


def _write_steps(plan: WrittenPlan, path: Path) -> list[Written]:
    from threadline.commands.step_files import write_steps

    return write_steps(plan.stitched, path)


def _write_t15(plan: WrittenPlan, path: Path) -> list[Written]:
    from threadline.commands.step_files import write_t15

    return [write_t15(plan.stitched, path)]


def _write_dst(plan: WrittenPlan, path: Path) -> list[Written]:
    from threadline.commands.step_files import write_dst

    return [write_dst(plan.stitched, path)]


def _write_u01(plan: WrittenPlan, path: Path) -> list[Written]:
    from threadline.commands.step_files import write_u01

    return [write_u01(plan.stitched, path)]


KIND = Kind(
    name="steps",
    takes=("embroidery design",),
    commands=StepPlay,
    intent=Stitched,
    check=_check,
    check_options=_check_options,
    plan=_plan,
    simulate=_simulate,
    days=_days,
    ranges_of_days=lambda _: 1,
    on_days=_on_days,
    others=partial(one_by_one, _any_day),
    together=lambda _: False,
    compared={
        "interpolation": (
            "law:modified-sine", "law:cycloidal", "law:simple-harmonic", "law:4-5-6-7",
        )
    },
    targets={
        "steps": Target(write=_write_steps),
        "t15": Target(write=_write_t15),
        "dst": Target(write=_write_dst),
        "u01": Target(write=_write_u01),
    },
)  # fmt: skip
