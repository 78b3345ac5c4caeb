"""Work by tick tables: plan, simulate and write motions of axes, and the needle of a seam."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray
from threadline.base.option_defaults import USUAL
from threadline.commands.feedforward import followed_by_loads, followed_by_motors
from threadline.commands.learned import learned_commands
from threadline.commands.plan import Following, Motion, Plan
from threadline.commands.write import TABLES, TICK_TARGETS, Target, WrittenPlan, table_writer
from threadline.dynamics.values import Values
from threadline.errors import OptionError
from threadline.files import (
    ChannelKind,
    Clock,
    Commands,
    Recording,
    TickBlock,
    TickTable,
    tick_table,
)
from threadline.files.formats.common import Written
from threadline.jobs.operations import FeedMode, Job
from threadline.machine import Machine
from threadline.machine.variants import numbers_at, variant
from threadline.machine.vary import Days, derate, drawn_days, varied_numbers, vary, with_reserve
from threadline.motion.path import chord_path, on_chords, plan_path, programmed_path
from threadline.motion.path.types import PlannedPath, ProgrammedPath
from threadline.motion.path.wide_corners import Corners
from threadline.motion.timing import (
    Pace,
    check_budget,
    check_limits,
    even_averages,
    plan_trajectory,
    with_steps,
)
from threadline.proof.kinds.kind import Kind, check_loops
from threadline.proof.options import Options, PathChoice, describe
from threadline.twin import simulate, simulate_position_runs, simulate_runs
from threadline.verdict import Criterion, Spec
from threadline.verdict.needle import has_stitches, planned_stitches
from threadline.verdict.replayed import product_at_random, with_products
from threadline.winding.product import product_of_text

if TYPE_CHECKING:
    from threadline.files.formats.tick_table import NeedleRows

_SLACK = 1e-6  # ticks: a needle-down up to so long before a tick counts as a needle-down at it


class NeedleColumns:
    """Computes the needle columns of a seam's table, block by block.

    The needle goes down at the end of every stitch. It also goes down one turn before the end of a
    contour's first stitch. Before this first needle-down of a contour, and after the last one, the
    needle must be up.

    Parameters
    ----------
    plan
        Plan of a job with stitches.
    clock
        Clock of the rows.
    """

    def __init__(self, plan: Plan, clock: Clock) -> None:
        self._clock = clock
        self._runs = planned_stitches(plan)
        self._down_s: FloatArray = np.zeros(0)  # needle-downs still to write, in order
        self._begin_s: list[float] = []  # first and last needle-down of every contour so far
        self._end_s: list[float] = []
        self._known_s = -np.inf
        self._exhausted = False
        self._trim_until = 0  # tick

    def rows(self, block: TickBlock) -> NeedleRows:
        """Return the needle columns of ``block``, which must be the next block of the table."""
        first, rows = block.first_tick, len(block)
        period_s = float(self._clock.period_s)
        self._pull(float(self._clock.time_s(first + rows)) + period_s)
        ticks = np.floor(self._down_s / period_s + _SLACK).astype(np.int64)
        in_block = ticks < first + rows
        began_s = np.array([float(self._clock.time_s(tick)) for tick in ticks[in_block].tolist()])
        after_s = np.maximum(self._down_s[in_block] - began_s, 0.0)
        row = np.maximum(ticks[in_block] - first, 0)
        self._down_s = self._down_s[~in_block]
        middle_s = (first + np.arange(rows) + 0.5) * period_s
        begun = np.searchsorted(self._begin_s, middle_s, side="right")
        up = begun == np.searchsorted(self._end_s, middle_s, side="left")
        from threadline.files.formats.tick_table import NeedleRows

        return NeedleRows(row=row, after_s=after_s, up=up, trim=self._trims(block))

    def _pull(self, until_s: float) -> None:
        """Read stitches until the end of one is later than ``until_s``."""
        while not self._exhausted and self._known_s <= until_s:
            run = next(self._runs, None)
            if run is None:
                self._exhausted = True
                self._end_s.append(self._known_s)
                return
            first_s = run.down_s[run.first] - run.period_s[run.first]
            before_s = np.concatenate(([self._known_s], run.down_s[:-1]))[run.first]
            if not self._begin_s:
                before_s = before_s[1:]
            self._begin_s += first_s.tolist()
            self._end_s += before_s.tolist()
            self._down_s = np.sort(np.concatenate((self._down_s, first_s, run.down_s)))
            self._known_s = float(run.down_s[-1])

    def _trims(self, block: TickBlock) -> NDArray[np.bool_]:
        """Return (rows,) whether the thread is trimmed during the row."""
        first, rows = block.first_tick, len(block)
        trims = np.zeros(rows, dtype=bool)
        trims[: max(self._trim_until - first, 0)] = True
        events = {(event.kind, event.operation): event for event in block.events}
        for event in block.events:
            if (event.kind, event.name) != ("tool", "trim"):
                continue
            dwell = events.get(("dwell", event.operation + 1))
            dwell_s = 0.0 if dwell is None else dwell.value
            dwell_ticks = max(1, ceil(dwell_s / float(self._clock.period_s) - _SLACK))
            self._trim_until = event.tick + dwell_ticks
            trims[event.tick - first : max(self._trim_until - first, 0)] = True
        return trims


def _check_product(machine: Machine, product: str | None) -> None:
    """Refuse a wound product on a machine without an eye.

    Raises
    ------
    OptionError
        Names the machine.
    """
    if product is not None and (machine.tool is None or machine.tool.kind != "eye"):
        raise OptionError(
            f"--product needs the eye of a winder, and {machine.name} has none",
            remedy='Describe it in the machine file: [tool] kind = "eye", turn, along and across.',
        )


def _check_options(machine: Machine, options: Options) -> None:
    _check_product(machine, options.product)
    on_chords_by_loads = options.following is Following.LOAD and options.interpolation in USUAL
    if options.robust_share is not None and not on_chords_by_loads:
        raise OptionError(
            f"--robust '{options.robust_share * 100:g} %' needs feed-forward along the programmed "
            "chords and times",
            remedy="Give --feed-forward too, and no other --interpolation.",
        )
    if options.shaper_mode is not None or options.shaper_damping is not None:
        raise OptionError(
            f"--mode and --damping are for on/off machines, which {machine.name} is not",
            remedy='Write both with the shaper: --shaper "zv:12Hz:0.02".',
        )
    if options.feed is not None and options.feed.mode is FeedMode.SHAFT:
        text = f"{options.feed.value:g} stitch/s"
        raise OptionError(
            f"feed {text!r}: {machine.name} has no shaft that turns a stitch at a time",
            remedy=f'The needle speed of a seam is --needle "{text}", or needle_speed in its file.',
        )
    if options.following is Following.LOAD and machine.takes_positions:
        raise OptionError(
            f"--feed-forward acts through the controllers of the axes, and {machine.name} has "
            f"none: drives.{machine.axes[next(iter(machine.axes))].drive} receives positions",
            remedy="Leave it out; --shaper keeps the load from ringing.",
        )
    if math.isfinite(options.contour_m or math.inf) and machine.takes_positions:
        raise OptionError(
            f"--contour bounds the following error of loops, and {machine.name} has none: "
            f"drives.{machine.axes[next(iter(machine.axes))].drive} receives positions",
            remedy="Leave it out.",
        )
    if options.following is Following.LOAD and options.timing.shaper is not None:
        raise OptionError(
            "a shaper and feed-forward exclude each other: the inverse leaves nothing to shape",
            remedy="Leave one of them out.",
        )


def _plan(job: Job, machine: Machine, options: Options) -> Plan:
    """Plan the path, its timing, and whether motors or loads follow it."""
    timing = options.timing
    if timing.feed is not None and timing.feed.mode is FeedMode.OVERRIDE and job.paced_by != "feed":
        raise OptionError(
            f"feed {timing.feed.value * 100.0:g} %: {job.name} has no feeds to multiply, its speed "
            f"is set by the {job.paced_by}",
            remedy='Give a speed, like "36 mm/s", or change it in the job.',
        )
    tick_s = float(machine.tick_clock.period_s)
    shaper = motion_law = None
    if timing.shaper is not None:
        from threadline.motion.shaping import parse_shaper

        shaper = parse_shaper(timing.shaper, tick_s)
    if timing.law is not None:
        from threadline.motion.shaping.shaped_law import law_named

        motion_law = law_named(timing.law)
    at_limits = timing.pace is not Pace.PROGRAMMED
    programmed = programmed_path(job, machine, feed=timing.feed, at_limits=at_limits)
    check_budget(job, machine, timing.feed)
    machine_with_reserve = with_reserve(machine, timing.reserve)
    limited_machine = derate(machine_with_reserve, timing.limit_share)
    path = _shape(programmed, limited_machine, options.path)
    of_loads = timing.smoothing_s is not None
    timed = plan_trajectory(
        path,
        limited_machine,
        timing.pace,
        motion_law,
        timing.contour_m,
        of_loads=of_loads,
        along_m_s2=job.along_m_s2,
    )
    warnings: tuple[str, ...] = ()
    # A voltage or current demand above its limit is no error here: the verdict shows the effect.
    if timing.smoothing_s is None:
        followed = followed_by_motors(timed, machine, job, shaper)
    elif timing.robust_share is None:
        averages = even_averages(timing.smoothing_s)
        followed = followed_by_loads(
            timed, machine_with_reserve, job, averages, ends_m=timing.ends_m
        )
    else:
        from threadline.commands.robust_following import robust_averages

        averages, warnings = robust_averages(
            timed, machine, job, programmed.radius_m, timing.robust_share, timing.change_s
        )
        stepped = with_steps(timed)
        followed = followed_by_loads(timed, machine, job, averages, stepped=stepped)
    motion = Motion(
        programmed=programmed,
        path=path,
        trajectory=followed.trajectory,
        following=followed.following,
        timed=None if followed.timed is followed.trajectory else followed.timed,
        demands=followed.demands,
        rests_s=followed.rests_s,
        table_s=followed.table_s,
        needle_follows=job.needle_follows,
        of_averages=warnings,
    )
    commands = followed.commands
    if options.table is not None:
        commands = learned_commands(commands, options.table)
    return Plan(
        job=job,
        machine=machine,
        commands=commands,
        intent=motion,
        options=describe(job, machine, options),
    )


def _shape(programmed: ProgrammedPath, machine: Machine, choice: PathChoice) -> PlannedPath:
    if on_chords(choice.interpolation):
        return chord_path(programmed, choice.interpolation)
    return plan_path(
        programmed,
        machine,
        choice.interpolation,
        choice.tolerance_m,
        corners=Corners(outside_m=choice.outside_m, narrow=choice.narrow),
    )


def _simulate(commands: Commands, machine: Machine) -> Recording:
    return simulate(tick_table(commands), machine)


_RECORDED = (
    ChannelKind.COMMANDED,
    ChannelKind.LOAD,
    ChannelKind.VELOCITY,
    ChannelKind.VOLTAGE,
    ChannelKind.CURRENT,
    ChannelKind.TENSION,
    ChannelKind.OPERATION,
)
"""Channels of a simulated machine that the judge reads: it reads loads, and hence no encoders."""


def _days(
    commands: Commands, machine: Machine, count: int, random: np.random.Generator
) -> Sequence[Recording]:
    """Simulate runs with varied friction, supply and encoder phases; the first is nominal."""
    table = tick_table(commands)
    if count == 1 or machine.without_dynamics:  # limits do not vary from day to day
        return [simulate(table, machine)]
    return _simulated_on(table, machine, drawn_days(count, len(table.axes), random))


def _ranges_of_days(commands: Commands) -> int:
    from threadline.machine.days import RANGES_OF_DAYS  # only searches need it

    return RANGES_OF_DAYS + len(tick_table(commands).axes)


def _on_days(commands: Commands, machine: Machine, fractions: FloatArray) -> Sequence[Recording]:
    """Simulate days at (k, 3 + axes) places, as ``days_at`` takes them."""
    from threadline.machine.days import days_at

    return _simulated_on(tick_table(commands), machine, days_at(fractions))


def _simulated_on(table: TickTable, machine: Machine, days: Days) -> Sequence[Recording]:
    if machine.position_sources:
        variations = zip(
            days.friction.tolist(), days.supply.tolist(), days.tension.tolist(), strict=True
        )
        machines = [vary(machine, friction=f, supply=s, tension=t) for f, s, t in variations]
        together = simulate_position_runs(table, machines, encoder_phase=days.phases)
        if together is not None:
            return [together]
        return [
            simulate(table, varied_machine, encoder_phase=phase)
            for varied_machine, phase in zip(machines, days.phases, strict=True)
        ]
    numbers = Values.of(machine, varied_numbers(machine, days)).replaced
    values = Values(machine, numbers, len(days))
    return [simulate_runs(table, values, encoder_phase=days.phases, kinds=_RECORDED)]


def _others(
    commands: Commands, machine: Machine, parts: FloatArray, random: np.random.Generator
) -> Sequence[Recording]:
    """Simulate machines within the tolerances, with random encoder phases."""
    table = tick_table(commands)
    phases = random.uniform(0.0, 1.0, (len(parts), len(table.axes)))
    if machine.position_sources:
        return [
            with_products(
                simulate(table, variant(machine, row), encoder_phase=phase),
                product_at_random(np.array([number])),
            )
            for number, (row, phase) in enumerate(zip(parts, phases, strict=True))
        ]
    values = Values.of(machine, numbers_at(machine, parts))
    return [
        with_products(
            simulate_runs(table, same_delay_values, encoder_phase=phases[indices], kinds=_RECORDED),
            product_at_random(indices),
        )
        for same_delay_values, indices in values.by_delay()
    ]


def _with_criteria(spec: Spec, machine: Machine, options: Options) -> Spec:
    """Return the specification with the criteria added that the options ask for.

    ``shaping_deviation`` is added if the motion is shaped or smoothed, without a limit unless the
    specification has one. A wound product adds the criteria of its fibre that the specification
    does not name.
    """
    if options.product is not None:
        from threadline.jobs.winding.layers import tensions_in  # only windings need it
        from threadline.verdict.fibre import criteria_of

        given = {criterion.name for criterion in spec.criteria}
        tensions_n = () if machine.spool is None else tensions_in(options.product)
        criteria = criteria_of(product_of_text(options.product), machine.spool, tensions_n)
        added = tuple(criterion for criterion in criteria if criterion.name not in given)
        spec = replace(spec, criteria=(*spec.criteria, *added))
    shaped = options.timing.shaper is not None or options.timing.smoothing_s is not None
    has_criterion = any(criterion.name == "shaping_deviation" for criterion in spec.criteria)
    if has_criterion or not shaped:
        return spec
    return replace(spec, criteria=(*spec.criteria, Criterion(name="shaping_deviation")))


def _release(plan: Plan) -> None:
    """Refuse a plan that exceeds a limit of its machine anywhere."""
    check_limits(plan.motion.trajectory, plan.machine)


def _of_table(name: str) -> Target:
    """Return a target that writes the rows; for a seam also the columns of the needle."""

    def write(plan: WrittenPlan, path: Path) -> list[Written]:
        table = tick_table(plan.commands)
        sewn = isinstance(plan, Plan) and has_stitches(plan.job)
        needle = NeedleColumns(plan, table.clock) if isinstance(plan, Plan) and sewn else None
        return [table_writer(name)(table, path, needle)]

    return Target(write=write)


KIND = Kind(
    name="ticks",
    takes=("part program", "seam", "winding"),
    commands=TickTable,
    intent=Motion,
    check=check_loops,
    check_options=_check_options,
    plan=_plan,
    simulate=_simulate,
    days=_days,
    ranges_of_days=_ranges_of_days,
    on_days=_on_days,
    others=_others,
    together=lambda machine: not machine.takes_positions,
    with_criteria=_with_criteria,
    release=_release,
    compared={"interpolation": ("linear", "b-spline", "b-spline-pulled")},
    targets={**{name: _of_table(name) for name in TABLES}, **TICK_TARGETS},
)
