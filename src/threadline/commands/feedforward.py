"""The third choice of a plan: whether motors or loads follow the timed motion; their commands."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from math import ceil

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.commands.short_table import ToldEnds, leads_s, short_table, shortened
from threadline.commands.ticks import compile_ticks
from threadline.dynamics import AxisPreview, Demand
from threadline.dynamics.values import Values
from threadline.errors import PlanError
from threadline.files import Stream, TickTable
from threadline.jobs.operations import Job
from threadline.machine import Machine
from threadline.motion.shaping import Shaper, shape_trajectory
from threadline.motion.timing import (
    Trajectory,
    TrajectoryBlock,
    TrajectoryReader,
    averaged_trajectory,
    check_limits,
    held_trajectory,
)
from threadline.motion.timing.averaged import DEGREE, Averages


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


ROWS = 2048  # references in hand at once
KEPT = 32  # blocks of so many


def followed_by_loads(
    planned: Trajectory,
    machine: Machine,
    job: Job,
    averages: Averages,
    model: Values | None = None,
    stepped: Trajectory | None = None,
    ends_m: float | None = None,
) -> Followed:
    """Return the commands with which the loads follow ``planned``, smoothed by ``averages``.

    Parameters
    ----------
    planned
        From rest to rest; its velocity may step.
    machine
        Its limits are checked on the smoothed motion, before anything is put out.
    job
        Where an output, a wait or a dwell comes between two moves, the loads come to rest.
    averages
        Over time, of the motion of all axes.
    model
        The numbers that the inverses believe in; the machine's own when None.
    stepped
        The motion that is smoothed, with other run-ups than ``planned``, at the same times;
        ``planned`` itself when None.
    ends_m
        By how much the loads may leave their motion where the table begins and ends, at the tool,
        so that it rests neither before the motion nor after it; None keeps these rests.

    Raises
    ------
    LimitError
        If the smoothed motion breaks a limit of travel, velocity, acceleration or jerk.
    MachineError
        If an axis or its filter has no stable inverse.
    PlanError
        If an inverse needs more derivatives than the smoothed motion has.
    """
    motion = _Motion(planned, machine, job, averages, model, stepped)
    before_s, after_s = _rests_s(machine, planned.axes, model)
    if ends_m is not None:
        previews = [AxisPreview(machine, axis, model) for axis in planned.axes]
        for begin_s in leads_s(machine, previews, before_s):
            short = motion.short((begin_s, after_s), ends_m)
            if short is not None:
                return short
    return motion.whole((before_s, after_s))


@dataclass(frozen=True, slots=True, eq=False)
class _Motion:
    """A motion that loads are to follow, with the parameters of ``followed_by_loads``."""

    planned: Trajectory
    machine: Machine
    job: Job
    averages: Averages
    model: Values | None
    stepped: Trajectory | None

    def whole(self, rests_s: tuple[float, float]) -> Followed:
        """Return it with the rests that its inverses need."""
        timed, trajectory = self._smoothed(rests_s)
        reading, references = self._read(trajectory)
        return Followed(
            following=Following.LOAD,
            timed=timed,
            trajectory=trajectory,
            commands=compile_ticks(references, self.machine, self.job),
            demands=tuple(preview.demand for preview in reading.previews),
            rests_s=rests_s,
        )

    def short(self, rests_s: tuple[float, float], ends_m: float) -> Followed | None:
        """Return it with a table that ends with the motion; None where that cannot be.

        The second of ``rests_s`` is what its inverses need.
        """
        _, trajectory = self._smoothed(rests_s)
        reading, references = self._read(trajectory)
        over_s = trajectory.duration_s - rests_s[1]
        table = short_table(
            self.machine, trajectory, reading.previews, reading.told, over_s, ends_m
        )
        if table is None:
            return None
        timed, trajectory = self._smoothed((rests_s[0], 0.0))
        return Followed(
            following=Following.LOAD,
            timed=timed,
            trajectory=trajectory,
            commands=compile_ticks(shortened(references, table), self.machine, self.job),
            demands=table.demands([preview.demand for preview in reading.previews]),
            rests_s=(rests_s[0], 0.0),
            table_s=table.rows * float(self.machine.tick_clock.period_s),
        )

    def _smoothed(self, rests_s: tuple[float, float]) -> tuple[Trajectory, Trajectory]:
        """Return the motion before and after it was smoothed, with rests before and after it."""
        width_s = self.averages.width_s
        held_s = (rests_s[0] + 0.5 * width_s, rests_s[1] + 0.5 * width_s)
        held = timed = held_trajectory(self.planned, self.job, width_s, *held_s)
        if self.stepped is not None:
            held = held_trajectory(self.stepped, self.job, width_s, *held_s)
        trajectory = averaged_trajectory(held, self.averages)
        check_limits(trajectory, self.machine)
        return timed, trajectory

    def _read(self, trajectory: Trajectory) -> tuple[_References, Trajectory]:
        """Read the references once: that finds the demands; of a short motion they are kept."""
        reading = _References(trajectory, self.machine, self.model)
        kept: list[TrajectoryBlock] | None = []
        for block in reading.blocks():
            if kept is not None:
                kept.append(block)
                kept = kept if len(kept) <= KEPT else None
        references = reference_trajectory(trajectory, self.machine, self.model)
        return reading, references if kept is None else replace(references, blocks=Stream.of(kept))


def reference_trajectory(
    trajectory: Trajectory, machine: Machine, model: Values | None = None
) -> Trajectory:
    """Return the positions to command, one straight piece per reference tick.

    ``compile_ticks`` turns it into the table; its velocity is not limited, for the reference runs
    ahead of the motor by what the filter needs to give the volts.

    Parameters
    ----------
    trajectory
        Of the load, at rest at its start for ``lead_s`` and at its end for ``settle_s`` of every
        axis, with as many derivatives as their inverses need.
    model
        The numbers that the inverses believe in; the machine's own when None.

    Raises
    ------
    MachineError
        If an axis or its filter has no stable inverse.
    """
    return Trajectory(
        axes=trajectory.axes,
        historical=True,
        blocks=Stream(_referred, trajectory, machine, model),
    )


def _referred(
    trajectory: Trajectory, machine: Machine, model: Values | None
) -> Iterator[TrajectoryBlock]:
    return _References(trajectory, machine, model).blocks()


class _References:
    """One reading of the trajectory."""

    def __init__(self, trajectory: Trajectory, machine: Machine, model: Values | None) -> None:
        self._trajectory = trajectory
        self._machine = machine
        self.previews = [AxisPreview(machine, axis, model) for axis in trajectory.axes]
        self.told = [ToldEnds() for _ in trajectory.axes]

    def blocks(self) -> Iterator[TrajectoryBlock]:
        clock = self._machine.tick_clock
        step = float(clock.period_s)
        end_s = self._trajectory.duration_s
        total = max(ceil(end_s / step - 1e-9), 0)
        motion = TrajectoryReader(self._trajectory)
        labels = _Labels(self._trajectory)
        pairs = zip(self.previews, self.told, strict=True)
        columns = [_Column(k, preview, told) for k, (preview, told) in enumerate(pairs)]
        last: FloatArray | None = None
        for first in range(0, total, ROWS):
            count = min(ROWS, total - first)
            due = clock.times_s(first, count + 1)
            told = np.stack([column.until(due, motion) for column in columns], axis=1)
            if last is not None:
                told[0] = last
            last = told[-1]
            motion.drop(min(column.reached_s for column in columns))
            middle = due[:-1] + 0.5 * step
            yield TrajectoryBlock(
                start_s=due[:-1],
                duration_s=np.diff(due),
                coefficients=np.stack([told[:-1], np.diff(told, axis=0)], axis=1),
                operation=labels.at(middle),
            )


class _Column:
    """The references of one axis: computed at its controller's ticks, taken where they are due."""

    def __init__(self, column: int, preview: AxisPreview, ends: ToldEnds) -> None:
        self._column, self._preview, self._ends = column, preview, ends
        self._next = self._next_early = 0  # ticks of the controller
        self._time_s: FloatArray = np.empty(0)
        self._told: FloatArray = np.empty(0)

    @property
    def reached_s(self) -> float:
        """Before it the motion is not read again."""
        return self._next * self._preview.timing.tick_s

    def until(self, due_s: FloatArray, motion: TrajectoryReader) -> FloatArray:
        """Return the (n,) references that are due at (n,) rising times."""
        timing, preview = self._preview.timing, self._preview
        stop = ceil((due_s[-1] + timing.held_s) / timing.tick_s) + 1
        time_s = np.arange(self._next, stop) * timing.tick_s
        early_s = np.arange(self._next_early, stop + preview.ahead) * timing.tick_s + timing.early_s
        self._next, self._next_early = stop, stop + preview.ahead
        now = motion.ladder(time_s, preview.orders)[:, :, self._column]
        early = motion.ladder(early_s, preview.orders)[:, :, self._column]
        told = preview.feed(time_s, now, early)
        self._ends.add(preview.latest)
        self._time_s = np.concatenate([self._time_s, time_s])
        self._told = np.concatenate([self._told, told])
        result = np.interp(due_s + timing.held_s, self._time_s, self._told)
        kept = max(int(np.searchsorted(self._time_s, due_s[-1])) - 2, 0)
        self._time_s, self._told = self._time_s[kept:], self._told[kept:]
        return np.asarray(result)


class _Labels:
    """The operation under way at rising times."""

    def __init__(self, trajectory: Trajectory) -> None:
        self._source = iter(trajectory)
        self._block: TrajectoryBlock | None = None

    def at(self, time_s: FloatArray) -> np.ndarray:
        found = np.zeros(len(time_s), dtype=np.int64)
        begin = 0
        while begin < len(time_s):
            if self._block is None or self._block.end_s <= time_s[begin]:
                fresh = next(self._source, None)
                if fresh is None:
                    break
                self._block = fresh
                continue
            end = int(np.searchsorted(time_s, self._block.end_s))
            at = np.searchsorted(self._block.start_s, time_s[begin:end], side="right") - 1
            found[begin:end] = self._block.operation[np.maximum(at, 0)]
            begin = end
        if begin < len(time_s) and self._block is not None:
            found[begin:] = self._block.operation[-1]
        return found


def _rests_s(machine: Machine, axes: tuple[str, ...], model: Values | None) -> tuple[float, float]:
    """Return how long the loads must rest before and after their motion, in s."""
    before, after = 0.0, 0.0
    for axis in axes:
        preview = AxisPreview(machine, axis, model)
        if preview.orders - 1 > DEGREE:
            raise PlanError(
                f"the inverse of axis {axis} needs {preview.orders - 1} derivatives of the "
                f"motion, smoothed motions have {DEGREE}",
                remedy="Leave feed-forward out.",
            )
        before = max(before, preview.timing.lead_s)
        after = max(after, preview.timing.settle_s)
    step = float(machine.tick_clock.period_s)
    return before, ceil(after / step) * step
