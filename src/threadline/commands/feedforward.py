"""Commands for motors that follow the timed motion, or whose loads follow it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from math import ceil
from typing import TYPE_CHECKING

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.commands.ticks import compile_ticks
from threadline.dynamics.values import Values
from threadline.errors import PlanError
from threadline.files import Stream, TickTable
from threadline.jobs.operations import Job
from threadline.machine import Machine
from threadline.motion.timing import (
    Trajectory,
    TrajectoryBlock,
    TrajectoryReader,
    averaged_trajectory,
    check_limits,
    held_trajectory,
)
from threadline.motion.timing.averaged import DEGREE, Averages

if TYPE_CHECKING:
    from threadline.commands.short_table import InverseEnds
    from threadline.dynamics.preview import AxisPreview, Demand
    from threadline.motion.shaping import Shaper


class Following(StrEnum):
    """The part that follows the trajectory: motors or loads."""

    MOTOR = "motor"  # the trajectory is the motor's reference; belt and frame move the load
    LOAD = "load"  # the inverse of the axis gives the motor's reference


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Followed:
    """A motion and its commands.

    Parameters
    ----------
    following
        Whether motors or loads follow the motion.
    timed
        Motion before shaping or smoothing, with the necessary rests, on the clock of the recording.
    trajectory
        Intended position of the motors or loads, on the same clock.
    commands
        Commands for the controllers.
    demands
        Demand of the inverse model on each axis; empty if the motors follow.
    rests_s
        Rest of the loads before their motion, while the references begin, and after their motion,
        while the oscillation of the inverses decays, s.
    table_s
        Duration of a table that is shorter than the motion with its rests, s. After such a table
        the control loops bring the loads to rest.
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
    """Return the motion itself as commands, shaped if a shaper is given.

    Raises
    ------
    OptionError, LimitError
        As ``shape_trajectory``.
    PlanError
        As ``compile_ticks``.
    """
    trajectory = timed
    if shaper is not None:
        from threadline.motion.shaping import shape_trajectory

        trajectory = shape_trajectory(timed, shaper, machine, centroid_shift=True)
    return Followed(
        following=Following.MOTOR,
        timed=timed,
        trajectory=trajectory,
        commands=compile_ticks(trajectory, machine, job),
    )


ROWS = 2048  # references processed at once
MOST_CACHED = 32  # most blocks of references kept in memory


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
        Motion from rest to rest; its velocity may step.
    machine
        Machine; its limits are checked on the smoothed motion before any output.
    job
        Job; the loads come to rest where an output, a wait or a dwell stands between two moves.
    averages
        Averages over time, applied to the motion of all axes.
    model
        Model values for the inverses; None: the machine's own values.
    stepped
        Motion to smooth, with other run-ups than ``planned`` at the same times; None: ``planned``.
    ends_m
        Largest distance, at the tool, by which the loads may leave their motion at both ends of the
        table. With it the table has no rests before and after the motion. None keeps these rests.

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
        from threadline.commands.short_table import leads_s
        from threadline.dynamics.preview import AxisPreview

        previews = [AxisPreview(machine, axis, model) for axis in planned.axes]
        for begin_s in leads_s(machine, previews, before_s):
            short = motion.short((begin_s, after_s), ends_m)
            if short is not None:
                return short
    return motion.whole((before_s, after_s))


@dataclass(frozen=True, slots=True, eq=False)
class _Motion:
    """A motion for loads to follow, with the parameters of ``followed_by_loads``."""

    planned: Trajectory
    machine: Machine
    job: Job
    averages: Averages
    model: Values | None
    stepped: Trajectory | None

    def whole(self, rests_s: tuple[float, float]) -> Followed:
        """Return the motion with the rests that its inverses need."""
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
        """Return the motion with a table that ends together with it; None if no table does.

        The second value of ``rests_s`` is the rest that the inverses need.
        """
        _, trajectory = self._smoothed(rests_s)
        reading, references = self._read(trajectory)
        over_s = trajectory.duration_s - rests_s[1]
        from threadline.commands.short_table import short_table, shortened

        table = short_table(
            self.machine, trajectory, reading.previews, reading.inverse_ends, over_s, ends_m
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
        """Return the motion before and after smoothing, with rests at both ends."""
        width_s = self.averages.width_s
        held_s = (rests_s[0] + 0.5 * width_s, rests_s[1] + 0.5 * width_s)
        held = timed = held_trajectory(self.planned, self.job, width_s, *held_s)
        if self.stepped is not None:
            held = held_trajectory(self.stepped, self.job, width_s, *held_s)
        trajectory = averaged_trajectory(held, self.averages)
        check_limits(trajectory, self.machine)
        return timed, trajectory

    def _read(self, trajectory: Trajectory) -> tuple[_References, Trajectory]:
        """Read the references once for the demands, and keep the blocks of a short motion."""
        reading = _References(trajectory, self.machine, self.model)
        cached: list[TrajectoryBlock] | None = []
        for block in reading.blocks():
            if cached is not None:
                cached.append(block)
                cached = cached if len(cached) <= MOST_CACHED else None
        references = reference_trajectory(trajectory, self.machine, self.model)
        return reading, references if cached is None else replace(
            references, blocks=Stream.of(cached)
        )


def reference_trajectory(
    trajectory: Trajectory, machine: Machine, model: Values | None = None
) -> Trajectory:
    """Return the positions to command, one straight piece per reference tick.

    ``compile_ticks`` turns the result into the table. The velocity of the references is not
    limited, because a reference runs ahead of the motor by the error that the filter needs to give
    the volts.

    Parameters
    ----------
    trajectory
        Motion of the load, with as many derivatives as the inverses need. The load rests at the
        start for the ``lead_s`` and at the end for the ``settle_s`` of every axis.
    model
        Model values for the inverses; None: the machine's own values.

    Raises
    ------
    MachineError
        If an axis or its filter has no stable inverse.
    """
    return Trajectory(
        axes=trajectory.axes, historical=True, blocks=Stream(_referred, trajectory, machine, model)
    )


def _referred(
    trajectory: Trajectory, machine: Machine, model: Values | None
) -> Iterator[TrajectoryBlock]:
    return _References(trajectory, machine, model).blocks()


class _References:
    """One pass through the trajectory."""

    def __init__(self, trajectory: Trajectory, machine: Machine, model: Values | None) -> None:
        self._trajectory = trajectory
        self._machine = machine
        from threadline.commands.short_table import InverseEnds
        from threadline.dynamics.preview import AxisPreview

        self.previews = [AxisPreview(machine, axis, model) for axis in trajectory.axes]
        self.inverse_ends = [InverseEnds() for _ in trajectory.axes]

    def blocks(self) -> Iterator[TrajectoryBlock]:
        clock = self._machine.tick_clock
        step = float(clock.period_s)
        end_s = self._trajectory.duration_s
        total = max(ceil(end_s / step - 1e-9), 0)
        motion = TrajectoryReader(self._trajectory)
        labels = _Labels(self._trajectory)
        pairs = zip(self.previews, self.inverse_ends, strict=True)
        columns = [_Column(k, preview, ends) for k, (preview, ends) in enumerate(pairs)]
        last: FloatArray | None = None
        for first in range(0, total, ROWS):
            count = min(ROWS, total - first)
            due = clock.times_s(first, count + 1)
            references = np.stack([column.until(due, motion) for column in columns], axis=1)
            if last is not None:
                references[0] = last
            last = references[-1]
            motion.drop(min(column.reached_s for column in columns))
            middle = due[:-1] + 0.5 * step
            yield TrajectoryBlock(
                start_s=due[:-1],
                duration_s=np.diff(due),
                coefficients=np.stack([references[:-1], np.diff(references, axis=0)], axis=1),
                operation=labels.at(middle),
            )


class _Column:
    """References of one axis, computed at the controller's ticks and interpolated at due times."""

    def __init__(self, column: int, preview: AxisPreview, ends: InverseEnds) -> None:
        self._column, self._preview, self._ends = column, preview, ends
        self._next = self._next_early = 0  # ticks of the controller
        self._time_s: FloatArray = np.empty(0)
        self._references: FloatArray = np.empty(0)

    @property
    def reached_s(self) -> float:
        """Time before which the motion is not read again, s."""
        return self._next * self._preview.timing.tick_s

    def until(self, due_s: FloatArray, motion: TrajectoryReader) -> FloatArray:
        """Return the (n,) references due at (n,) rising times."""
        timing, preview = self._preview.timing, self._preview
        stop = ceil((due_s[-1] + timing.held_s) / timing.tick_s) + 1
        time_s = np.arange(self._next, stop) * timing.tick_s
        early_s = np.arange(self._next_early, stop + preview.ahead) * timing.tick_s + timing.early_s
        self._next, self._next_early = stop, stop + preview.ahead
        now = motion.derivatives(time_s, preview.orders)[:, :, self._column]
        early = motion.derivatives(early_s, preview.orders)[:, :, self._column]
        references = preview.feed(time_s, now, early)
        self._ends.add(preview.latest)
        self._time_s = np.concatenate([self._time_s, time_s])
        self._references = np.concatenate([self._references, references])
        result = np.interp(due_s + timing.held_s, self._time_s, self._references)
        first_needed = max(int(np.searchsorted(self._time_s, due_s[-1])) - 2, 0)
        self._time_s, self._references = (
            self._time_s[first_needed:],
            self._references[first_needed:],
        )
        return np.asarray(result)


class _Labels:
    """The active operation at rising times."""

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
    """Return how long the loads must rest before and after their motion, s."""
    before, after = 0.0, 0.0
    for axis in axes:
        from threadline.dynamics.preview import AxisPreview

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
