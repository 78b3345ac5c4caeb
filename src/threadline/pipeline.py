"""Runs every arrow of the house in order, and nothing else."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from threadline.errors import OptionError, PlanError
from threadline.jobs import read_job
from threadline.jobs.operations import Job
from threadline.machine import Machine
from threadline.machine.vary import derate, vary
from threadline.options import (
    DEFAULT_INTERPOLATION,
    Options,
    describe,
    parse_feed_mode,
    refuse_axis_options,
)
from threadline.path import check_budget, on_time_path, plan_path, programmed_path
from threadline.plan import Plan, SwitchPlan
from threadline.plant.analysis import unstable_loops
from threadline.shaping import parse_shaper, shape_trajectory
from threadline.signals import Recording, RecordingBlock, Stream, TickTable
from threadline.targets import compile_ticks, feed_forward_commands
from threadline.targets.schedule import compile_schedule
from threadline.targets.schedule_options import shaping_of
from threadline.trajectory import plan_trajectory
from threadline.twin import simulate
from threadline.twin.switching import simulate_switching
from threadline.verdict import Criterion, Spec, Verdict, judge

REPEAT_SEED = 1994

Progress = Callable[[str, float], None]
"""Called with what is being done and the fraction that is done."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Proof:
    """A plan, what the simulated machine made of it, what was asked, and the verdict."""

    plan: Plan
    recording: Recording
    verdict: Verdict
    spec: Spec


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SwitchProof:
    """The same of an on/off machine."""

    plan: SwitchPlan
    recording: Recording
    verdict: Verdict
    spec: Spec


def check_loops(machine: Machine) -> None:
    """Refuse a machine whose position loop is unstable, before any motion is planned.

    Raises
    ------
    PlanError
        Naming the axis and how far the loop is beyond its limit; or that the machine has no loop.
    """
    if not machine.axes:
        raise PlanError(
            f"{machine.name} has no axes with loops: its cylinders are switched on and off",
            place=machine.place,
            remedy="threadline prove, judge and compile take its move lists.",
        )
    unstable = unstable_loops(machine)
    if unstable:
        raise PlanError(
            "; ".join(unstable),
            place=machine.place,
            remedy="Lower the gain of its controller, or correct its clock; threadline analyse "
            "shows the loop.",
        )


def open_job(job_file: Path, machine: Machine, options: Options) -> Job:
    """Return the job in a file, read as the options say.

    Raises
    ------
    JobError
        If it cannot be read.
    OptionError
        If F is given a meaning that the format or the machine does not have.
    """
    if options.feed_mode is None:
        return read_job(job_file, machine)
    return read_job(job_file, machine, **parse_feed_mode(options.feed_mode))


def plan_job(job: Job, machine: Machine, options: Options) -> Plan:
    """Plan ``job`` on ``machine``: paths, trajectory, commands.

    With ``options.feed_forward_s`` the trajectory of the plan is where the loads are to be, on
    the clock of the recording, and ``Plan.feed_forward`` says what current and voltage the model
    needs for it; a demand above its limit is no error, the verdict shows what comes of it.

    Raises
    ------
    PlanError
        If the machine cannot do the job.
    """
    shaper = None
    if options.shaper is not None:
        shaper = parse_shaper(options.shaper, float(machine.tick_clock.period_s))
    programmed = programmed_path(job, machine, feed=options.feed)
    check_budget(job, machine, options.feed)
    limited = derate(machine, options.limit_share)
    if options.feed_forward_s is not None and options.interpolation == DEFAULT_INTERPOLATION:
        path = on_time_path(programmed, limited)
    else:
        path = plan_path(
            programmed,
            limited,
            interpolation=options.interpolation,
            tolerance_m=options.tolerance_m,
        )
    planned = trajectory = plan_trajectory(path, limited)
    if options.feed_forward_s is not None:
        if shaper is not None:
            raise OptionError(
                "a shaper and feed-forward exclude each other: the inverse leaves nothing to shape",
                remedy="Leave one of them out.",
            )
        ahead = feed_forward_commands(planned, machine, job, options.feed_forward_s)
        return Plan(
            job=job,
            machine=machine,
            programmed=programmed,
            path=replace(path, historical=False),
            trajectory=ahead.trajectory,
            commands=ahead.commands,
            unshaped=ahead.timed,
            feed_forward=ahead.demands,
            rests_s=ahead.rests_s,
            options=describe(job, machine, options),
        )
    if shaper is not None:
        trajectory = shape_trajectory(planned, shaper, machine, centroid_shift=True)
    commands = compile_ticks(trajectory, machine, job)
    return Plan(
        job=job,
        machine=machine,
        programmed=programmed,
        path=path,
        trajectory=trajectory,
        commands=commands,
        unshaped=None if shaper is None else planned,
        options=describe(job, machine, options),
    )


def plan_switching(job: Job, machine: Machine, options: Options) -> SwitchPlan:
    """Plan ``job`` on an on/off machine: its schedule.

    Raises
    ------
    PlanError
        If the machine cannot do the job.
    OptionError
        If an option is given that a schedule does not have.
    """
    refuse_axis_options(machine, options)
    shaping = {} if options.shaper is None else shaping_of(machine, options.shaper)
    return SwitchPlan(
        scheduled=compile_schedule(job, machine, shaping),
        options=describe(job, machine, options),
    )


def with_shaping(spec: Spec, machine: Machine, options: Options) -> Spec:
    """Return what is asked, with ``shaping_deviation`` where the motion is shaped or smoothed.

    What that does to the path is always said, with or without a limit.
    """
    shaped = options.shaper is not None or options.feed_forward_s is not None
    named = any(criterion.name == "shaping_deviation" for criterion in spec.criteria)
    if machine.cylinders or named or not shaped:
        return spec
    return replace(spec, criteria=(*spec.criteria, Criterion(name="shaping_deviation")))


def prove(
    job_file: Path,
    machine: Machine,
    spec: Spec,
    options: Options,
    progress: Progress | None = None,
    repeats: int = 1,
    actual: Machine | None = None,
) -> Proof:
    """Plan, simulate and judge a job: the whole question, answered once."""
    check_loops(machine)
    plan = plan_job(open_job(job_file, machine, options), machine, options)
    return prove_plan(plan, spec, progress, repeats, actual)


def prove_plan(
    plan: Plan,
    spec: Spec,
    progress: Progress | None = None,
    repeats: int = 1,
    actual: Machine | None = None,
) -> Proof:
    """Simulate and judge a plan.

    Parameters
    ----------
    actual
        The machine that runs it, where it isn't the one that the plan was made for: with other
        masses or stiffnesses than feed-forward believes in, for instance.
    repeats
        Runs in all. Beyond the first, which is the machine as its file says, the encoders' phase
        is drawn anew, friction within +-30 % and supply within +-5 %, from a fixed seed: the
        spread of these runs is the repeatability.
    """
    if not isinstance(plan.commands, TickTable):
        raise PlanError(f"{plan.job.name}: only tick tables can be simulated on axes")
    random = np.random.default_rng(REPEAT_SEED)
    machine = plan.machine if actual is None else actual
    origin = dict(plan.options) | ({} if actual is None else {"actual": actual.reference})
    first = replace(simulate(plan.commands, machine), origin=origin)
    recordings = [first if progress is None else _watched(first, plan, progress)]
    for _ in range(repeats - 1):
        other = vary(machine, friction=random.uniform(0.7, 1.3), supply=random.uniform(0.95, 1.05))
        phase = random.uniform(0.0, 1.0, len(plan.commands.axes))
        recordings.append(simulate(plan.commands, other, encoder_phase=phase))
    verdict = judge(recordings, plan, spec)
    return Proof(plan=plan, recording=first, verdict=verdict, spec=spec)


def prove_switching(job_file: Path, machine: Machine, spec: Spec, options: Options) -> SwitchProof:
    """Plan, simulate and judge a move list of an on/off machine."""
    return prove_switch_plan(plan_switching(read_job(job_file, machine), machine, options), spec)


def prove_switch_plan(plan: SwitchPlan, spec: Spec) -> SwitchProof:
    """Simulate and judge a plan of an on/off machine."""
    recording = replace(simulate_switching(plan.commands, plan.machine), origin=dict(plan.options))
    verdict = judge([recording], plan, spec)
    return SwitchProof(plan=plan, recording=recording, verdict=verdict, spec=spec)


def _watched(recording: Recording, plan: Plan, progress: Progress) -> Recording:
    total_s = max(plan.trajectory.duration_s, 1e-9)

    def blocks() -> Iterator[RecordingBlock]:
        clock = plan.machine.tick_clock
        for block in recording:
            yield block
            done_s = clock.time_s(block.first_tick.get(clock.name, 0))
            progress("simulating and judging", min(done_s / total_s, 1.0))

    return replace(recording, blocks=Stream(blocks))
