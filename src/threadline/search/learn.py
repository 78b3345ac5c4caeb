"""A repeated job: each run's error corrects the references of the next run.

Iterative learning control. The learning filter of each axis (``dynamics/learning.py``) turns the
error of a run into a change of its references. A run that got worse is undone: learning goes on
from the best run, with half the gain. Every new table is first played by the simulated machine of
the file: a change that brings a drive to its limit, or an axis out of its travel, is halved.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.base.progress import Progress
from threadline.commands.learned import learned_plan, positions, with_offsets
from threadline.commands.plan import Following, Plan
from threadline.dynamics.learning import learning_filter
from threadline.errors import OptionError
from threadline.files import ChannelKind, Recording, TickTable, tick_table
from threadline.jobs.operations import Job
from threadline.machine import Machine
from threadline.machine.vary import REPEAT_SEED, corners, drawn_days, ends_of, off_tolerance, vary
from threadline.motion.timing import TrajectoryReader
from threadline.proof.pipeline import NOMINAL, Trials, prove_plan
from threadline.search.feed_ranges import used
from threadline.search.repeats import (
    LEAST_GAIN,
    Learned,
    Repeat,
    Rules,
    Tried,
    best_of,
    best_table,
    with_followed,
)
from threadline.twin import simulate
from threadline.verdict import Judge, Spec, Verdict
from threadline.verdict.needle import has_stitches

REPEATS = 5
MOST_REPEATS = 100
_HALVINGS = 5
_RINGING_S = 0.25  # the error is learned so long after the motion, and then fades out as long
_MOST_TICKS = 400_000
_FULL = 0.999  # a drive that uses a larger share of its limit counts as limited


class Learner:
    """Learns a job from its runs.

    Parameters
    ----------
    plan
        The plan: its table, the motion of the loads, and the machine.
    rules
        Gain, low-pass and sensor of the learning.

    Raises
    ------
    OptionError
        If the machine has no control loops, the job is too long, or the needle is timed for a head
        that lags behind its references.
    MachineError
        If an axis shares bodies with another drive.
    """

    def __init__(self, plan: Plan, rules: Rules) -> None:
        check_learnable(plan.job, plan.machine, plan.motion.following)
        if (ticks := plan.commands.tick_count() or 0) > _MOST_TICKS:
            raise OptionError(
                f"{plan.job.name} takes {ticks} ticks, and a job can be learned up to "
                f"{_MOST_TICKS}",
                remedy="Divide the job.",
            )
        self.plan, self.rules = plan, rules
        machine = plan.machine
        self.table: TickTable = tick_table(plan.commands)
        self._columns = [machine.axis_names.index(axis) for axis in plan.axes]
        self._scale = machine.counts_per_unit[self._columns]
        self._radius = machine.radius_m[self._columns]
        tolerance_share = 1.0 if off_tolerance(machine, mass=1.0, stiffness=1.0) != machine else 0.0
        machines = corners(machine, tolerance_share) if tolerance_share else [machine]
        self.filters = tuple(
            learning_filter(
                machine,
                axis,
                machines,
                of_load=rules.sensed == "head",
                low_pass_hz=rules.low_pass_hz,
            )
            for axis in plan.axes
        )
        self._begun = positions(self.table)
        ticks = len(self._begun)
        self._time_s = machine.tick_clock.times_s(0, ticks)
        self._target = self._intended(ticks)
        end_s = plan.motion.trajectory.duration_s - plan.motion.rests_s[1]
        periods_past_end = (self._time_s - end_s - _RINGING_S) / _RINGING_S
        self._weight = 0.5 + 0.5 * np.cos(np.pi * np.clip(periods_past_end, 0.0, 1.0))
        self._own = self._demand(simulate(self.table, machine))

    @property
    def _kind(self) -> ChannelKind:
        return ChannelKind.LOAD if self.rules.sensed == "head" else ChannelKind.MEASURED

    def _intended(self, ticks: int) -> FloatArray:
        """Return the (ticks, axes) intended positions of the sensor, m or rad."""
        motion = self.plan.motion
        if self._kind is ChannelKind.MEASURED and motion.following is Following.LOAD:
            # An encoder should read what it reads on the simulated machine, whose load follows the
            # motion.
            return self._read(simulate(self.table, self.plan.machine))
        reader = TrajectoryReader(motion.trajectory)
        until_s = np.minimum(self._time_s[:ticks], motion.trajectory.duration_s)
        return np.asarray(reader.derivatives(until_s, 1)[:, 0, :])

    def _read(self, recording: Recording) -> FloatArray:
        """Return the (n + 1, axes) sensor readings at the beginning of each tick, m or rad."""
        names = []
        for axis in self.plan.axes:
            channel = recording.find(self._kind, axis)
            if channel is None:
                raise OptionError(
                    f"the recording has no {self._kind} channel of axis {axis}",
                    remedy="Give --measured motor, which reads the encoder.",
                )
            names.append(channel.name)
        samples = recording.samples_of(names)
        return np.stack([np.interp(self._time_s, *samples[name]) for name in names], axis=1)

    def tried(self, recording: Recording, offset: FloatArray, *, passed: bool) -> Tried:
        """Return a run with its offset and its error.

        Raises
        ------
        OptionError
            If the recording lacks a channel of the sensor, or ends early.
        """
        if recording.outcome().incomplete:
            raise OptionError(
                "a run that did not come to its end cannot be learned from",
                remedy="Give a run that was completed.",
            )
        error = (self._target - self._read(recording)) * self._weight[:, None]
        error_at_tool = error * self._radius
        rms = float(np.sqrt((error_at_tool**2).sum(axis=1).mean()))
        return Tried(offset=offset, error=error, passed=passed, error_m=rms)

    def next(self, runs: Sequence[Tried]) -> tuple[FloatArray, float, str]:
        """Return the (n + 1, axes) offset of the next run in counts, the gain, and a note.

        The note names the limit that shortened the change; it is empty for a full change.

        Parameters
        ----------
        runs
            All runs so far, in order; at least one.
        """
        best_index, gain = best_of(
            [(run.passed, run.error_m) for run in runs],
            self.rules.gain,
        )
        best = runs[best_index]
        if gain < self.rules.gain * LEAST_GAIN:
            return best.offset, 0.0, "the best table is kept"
        columns = zip(self.filters, best.error.T, self._scale, strict=True)
        change = np.stack(
            [axis_filter.change(error) * scale for axis_filter, error, scale in columns],
            axis=1,
        )
        change[0] = change[-1] = 0.0
        note = ""
        for _ in range(_HALVINGS):
            offset = best.offset + gain * change
            broken_limit = self._beyond(self.commands(offset))
            if broken_limit is None:
                return offset, gain, note
            gain, note = 0.5 * gain, broken_limit
        return best.offset, 0.0, note

    def commands(self, offset: FloatArray) -> TickTable:
        """Return the plan's table with an (n + 1, axes) offset in counts, which is rounded."""
        whole_offset = np.zeros_like(self._begun)
        whole_offset[:, self._columns] = np.rint(offset).astype(np.int64)
        return with_offsets(self.table, whole_offset)

    def nothing(self) -> FloatArray:
        """Return the (n + 1, axes) offset of the plan's own table: zeros."""
        return np.zeros((len(self._begun), len(self._columns)))

    def offset_of(self, table: TickTable) -> FloatArray:
        """Return the (n + 1, axes) offset of a table learned from this plan."""
        return np.asarray((positions(table) - self._begun)[:, self._columns], dtype=np.float64)

    def _beyond(self, table: TickTable) -> str | None:
        """Return which limit a table breaks on the file's machine; None if it keeps them all."""
        machine = self.plan.machine
        for axis, column in zip(self.plan.axes, self._columns, strict=True):
            axis_limits = machine.axes[axis]
            if axis_limits.travel is None:
                continue
            positions_si = positions(table)[:, column] / machine.counts_per_unit[column]
            for end, extreme in zip(
                axis_limits.travel, (positions_si.min(), positions_si.max()), strict=True
            ):
                is_outside = extreme < end.si if end is axis_limits.travel[0] else extreme > end.si
                if is_outside:
                    return f"travel of axis {axis}"
        for name, share in self._demand(simulate(table, machine)).items():
            if share > max(_FULL, self._own[name]):
                return f"the {name} reaches its limit"
        return None

    def _demand(self, recording: Recording) -> dict[str, float]:
        """Return the largest voltage and current of each axis as shares of their limits."""
        limits = {}
        for axis in self.plan.axes:
            controller = self.plan.machine.controller_of(axis)
            limit = self.plan.machine.drive_of(axis).amplifier.current_limit
            for kind, limit_value in (
                (ChannelKind.VOLTAGE, controller.dac.range.si),
                (ChannelKind.CURRENT, None if limit is None else limit.si),
            ):
                channel = recording.find(kind, axis)
                if channel is not None and limit_value is not None:
                    limits[channel.name] = f"{kind} of axis {axis}", limit_value
        return {
            limits[name][0]: float(np.abs(values).max()) / limits[name][1]
            for name, (_, values) in recording.samples_of(limits).items()
        }

    def account(
        self, run: Tried, recording: Recording, verdict: Verdict, step: tuple[int, float, str]
    ) -> Repeat:
        """Return the record of a run; its ``followed`` is corrected later by ``with_followed``.

        ``step`` holds the number of the run, and gain and note of the change before the run.
        """
        number, gain, note = step
        currents = [
            share for name, share in self._demand(recording).items() if name.startswith("current")
        ]
        return Repeat(
            number=number,
            verdict=verdict,
            error_si=np.sqrt((run.error**2).mean(axis=0)),
            error_m=run.error_m,
            peak_si=np.abs(run.error).max(axis=0),
            current=max(currents, default=None),
            gain=gain,
            note=note,
            followed=True,
        )


def learn(
    learner: Learner,
    spec: Spec,
    *,
    actual: Machine | None = None,
    repeats: int = REPEATS,
    trials: Trials = NOMINAL,
    progress: Progress | None = None,
) -> Learned:
    """Repeat a job on a simulated machine and learn from every run.

    Parameters
    ----------
    learner, spec
        The plan to begin with and how it is learned, and the specification.
    actual
        The machine that runs; None: the machine of the plan.
    repeats
        Number of runs after the first one.
    trials
        Runs that prove the best table. If there are several, each repeat also has other friction,
        supply and encoder phases.

    Raises
    ------
    OptionError
        If the machine cannot play the table.
    """
    plan = learner.plan
    run_machine = plan.machine if actual is None else actual
    days = drawn_days(
        repeats + 1 if trials.repeats > 1 else 1,
        len(learner.table.axes),
        np.random.default_rng(REPEAT_SEED),
    )
    runs: list[Tried] = []
    accounts: list[Repeat] = []
    offset, gain, note = learner.nothing(), 0.0, ""
    for number in range(repeats + 1):
        if progress is not None:
            progress("repeating the job", number / (repeats + 1))
        if number:
            offset, gain, note = learner.next(runs)
        table = learner.commands(offset)
        day = number if trials.repeats > 1 else 0
        varied_machine = vary(
            run_machine,
            friction=float(days.friction[day]),
            supply=float(days.supply[day]),
            tension=float(days.tension[day]),
        )
        recording = simulate(table, varied_machine, encoder_phase=days.phases[day])
        recording_in_memory = replace(recording, blocks=tuple(recording.blocks))
        verdict = Judge(replace(plan, commands=table), spec).verdict([recording_in_memory])
        run = learner.tried(recording_in_memory, offset, passed=verdict.passed)
        runs.append(run)
        accounts.append(learner.account(run, recording_in_memory, verdict, (number, gain, note)))
    accounts = with_followed(accounts)
    best = best_table(accounts)
    learned = learned_plan(plan, learner.commands(runs[best].offset))
    return Learned(
        plan=learned, actual=run_machine, repeats=tuple(accounts), best=best,
        filters=learner.filters, rules=learner.rules,
        proof=prove_plan(learned, spec, None, trials.without_others, actual),
    )  # fmt: skip


def learned_verdict(
    plan: Plan, spec: Spec, repeats: int, trials: Trials, actual: Machine | None
) -> Verdict:
    """Return the verdict on the table that is learned from a plan.

    Parameters
    ----------
    repeats
        Number of runs after the first one.
    trials
        Runs that prove a table. With ``ends`` each machine at the ends of the tolerances learns its
        own table. The result is the verdict on the first machine out of specification, or else on
        the machine nearest to a limit.
    actual
        The machine that runs, without ``ends``; None: the machine of the plan.
    """
    learner = Learner(plan, Rules())
    machines = [actual]
    if trials.ends is not None:
        machines += [one for _, one in ends_of(plan.machine, trials.ends).machines]
    verdicts: list[Verdict] = []
    for machine in machines:
        learned = learn(
            learner, spec, actual=machine, repeats=repeats, trials=trials.without_others
        ).proof.verdict
        if not learned.passed:
            return learned
        verdicts.append(learned)
    return max(verdicts, key=used)


def check_learnable(job: Job, machine: Machine, following: Following) -> None:
    """Refuse a job that cannot be learned, before it is planned.

    Raises
    ------
    OptionError
        If the machine has no loops, or the needle is timed for a head that lags.
    """
    if not machine.controllers or machine.takes_positions:
        raise OptionError(
            f"{machine.name} has no control loops, so there are no references to learn",
            remedy="Learning needs axes with controllers of kind pd or lead.",
        )
    if has_stitches(job) and following is Following.MOTOR:
        raise OptionError(
            f"{job.name}: its needle is timed for a head that lags, and learning ends the lag",
            remedy="Give --feed-forward: with it the head follows its motion.",
        )
