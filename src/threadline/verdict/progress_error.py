"""Progress error: how far the tool runs ahead of its command along the path, or lags behind."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from threading import local

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.motion.timing import TrajectoryReader
from threadline.verdict.blocks import judged_blocks
from threadline.verdict.bow import NO_VELOCITY, MotionBetween
from threadline.verdict.boxes import NO_BOXES
from threadline.verdict.finding import Finding, RunFindings, Worst
from threadline.verdict.measure import Measure, SweptMeasure
from threadline.verdict.nearest import chord_vectors, lengths_squared
from threadline.verdict.places import CEILING, Command, ProgressPart, move_on
from threadline.verdict.samples import Block, Setting
from threadline.verdict.window import PathWindow

COMMAND_BY_TIME = "command from the plan by time"
"""Note of a result that was measured against the plan, for lack of a recorded command."""
_ROUNDING = 1e-9  # of the time between two samples
_AT_ONCE = 4096  # samples whose ticks are computed together
_LATEST = local()
"""Trajectory of the last recording of many runs that had to be read twice, and the ceiling, m^2,
that spares the next recording of it the second reading."""


class _Progress(SweptMeasure):
    """Largest distance along the path between the tool and the place of its command.

    Each sample is compared with the command's path within the lag before it. The matched places may
    only go forward from sample to sample; the measure is the least error with such a matching. That
    is the Frechet distance of the two paths within the lag, less the tool's distance from the path,
    which is ``contour_error``. Trailing by less than the lag costs nothing; running ahead costs its
    length; a step back costs at least half its length, for it lies between two places.

    Without a recorded command for every axis, the plan at the same instant takes its place.

    Lengths are at the tool, over all axes, rotary ones times their radius. Tool and command are
    taken as straight between samples, so on a straight piece of the path the result does not depend
    on the sampling rate. If the velocities of the loads are known, a bound of the tool's deviation
    from its segments is added; a tool that advances along its segment, at any speed, does not
    deviate. If samples are further apart than a tick, the finding states how far the command
    deviates from its segments: by this distance the tool may seem ahead of a command that turned
    between two samples.

    With many runs, places far behind all of them are dropped while the recording is read. If a
    dropped place might have been the better match, the recording is read again with every place
    kept. The next runs of the same plan keep places as far behind as these runs needed.
    """

    def __init__(self, setting: Setting, *, every_place: bool = False) -> None:
        axes, runs = len(setting.axes), setting.runs
        self._setting, self._radius_m = setting, setting.radius_m
        self._lag = setting.lag_samples
        self._number = 0  # samples so far
        self._places: IntArray = np.array([0, -1], dtype=np.int64)
        known_m2 = getattr(_LATEST, "ceiling", 0.0)
        if getattr(_LATEST, "trajectory", None) is not setting.plan.motion.trajectory:
            known_m2 = 0.0
        self._ceiling: FloatArray = np.full(1, np.inf if every_place or runs == 1 else known_m2)
        self._dropped: FloatArray = np.full(runs, np.inf)  # m^2
        # The command's places within the lag, and one before them.
        self._command: FloatArray = np.empty((0, axes))
        self._heading: FloatArray = np.empty((0, axes))
        self._stood: FloatArray | None = None
        self._value: FloatArray = np.full((self._lag + 2, runs), np.inf)  # m^2
        self._squared: FloatArray = np.full(runs, -np.inf)
        self._at: IntArray = np.zeros(runs, dtype=np.int64)
        self._side: FloatArray = np.zeros(runs)
        self._worst = Worst(runs, axes, note="the recording is empty")
        self._between, self._charge = MotionBetween(setting), np.zeros(runs)
        self._trajectory = setting.plan.motion.trajectory
        self._columns = [self._trajectory.axes.index(axis) for axis in setting.axes]
        self._planned: TrajectoryReader | None = None
        self._turns = _Turns(setting)

    def part(self, block: Block) -> ProgressPart:
        """Return the arrays for the sweep, with the command of the block."""
        fresh, steady = (one * self._radius_m for one in self._commanded(block))
        self._turns.take(block.due_s)
        first = len(self._command)
        command = np.concatenate([self._command, fresh])
        vector, squared = chord_vectors(command)
        stood = steady[:1] if self._stood is None else self._stood
        self._stood = steady[-1:]
        departs = np.diff(steady, axis=0, prepend=stood)
        heading = np.concatenate([self._heading, _headings(self._heading, departs)])
        self._command, self._heading = command, heading
        if np.isfinite(self._ceiling[0]):
            self._ceiling[0] = max(self._ceiling[0], lengths_squared(vector).max())
        return ProgressPart(
            command=Command(
                points=command,
                vector=vector,
                inverse=1.0 / squared,
                length=np.sqrt(lengths_squared(vector)),
                heading=heading,
            ),
            first=first,
            number=self._number,
            lag=self._lag,
            places=self._places,
            value=self._value,
            worst=self._squared,
            at=self._at,
            side=self._side,
            ceiling=self._ceiling,
            dropped=self._dropped,
            between=self._between.part(block),
            charge=self._charge,
        )

    def feed(self, block: Block) -> None:
        """Take the sweep's results."""
        keep = max(int(self._places[0]) - 1, 0)
        self._places -= keep
        self._command, self._heading = self._command[keep:], self._heading[keep:]
        distance_m = np.sqrt(self._squared)
        if self._worst.is_beaten(distance_m):
            index = np.maximum(self._at - self._number, 0)
            sides = np.where(self._side > 0.0, "ahead", np.where(self._side < 0.0, "behind", ""))
            self._worst.offer(
                distance_m,
                time_s=block.time_s[index],
                operation=block.operations_at(index),
                position=block.positions_at(index),
                note=sides.astype(object),
            )
        self._number += len(block)

    def finish(self) -> Sequence[RunFindings]:
        """Return the least error with which the tool can have reached any place by the end."""
        if self._between.incomplete:
            return [RunFindings.alike(Finding(value=None, note=NO_VELOCITY), len(self._charge))]
        if (self._dropped <= self._squared).any():
            return self._again()
        whole = self._worst.copy()
        whole.value += self._charge
        found = whole.found()
        if self._planned is not None:
            found = found.each(_by_time)
        if self._turns.most_m:
            found = found.each(partial(replace, over=self._turns.most_m))
        return [found]

    def _again(self) -> Sequence[RunFindings]:
        """Read the recording once more, and keep every place."""
        setting = self._setting
        path = PathWindow(setting.plan.motion.programmed)
        every = _Progress(setting, every_place=True)
        axes, lag, resolution = setting.axes, setting.lag_samples, setting.resolution
        for block in judged_blocks(setting.recording, axes, lag, path, resolution):
            points, away = block.at_tool, block.nearest[0]
            move_on(points, NO_BOXES, away, 0, (0,) * points.shape[1], every.part(block))
            every.feed(block)
        _LATEST.trajectory = self._trajectory
        _LATEST.ceiling = CEILING * float(every._squared.max())
        every._charge[:] = self._charge
        every._turns = self._turns
        return every.finish()

    def _commanded(self, block: Block) -> tuple[FloatArray, FloatArray]:
        """Return (n, axes) the command of a block, and a copy rounded for finding rests.

        Taken from the plan if an axis has no recorded command.
        """
        if block.commanded is not None and np.isfinite(block.commanded).all():
            assert block.rests is not None
            return block.commanded, block.rests
        if self._planned is None:
            self._planned = TrajectoryReader(self._trajectory)
        found = self._planned.derivatives(block.due_s, 1)[:, 0, self._columns]
        self._planned.drop(float(block.due_s[-1]))
        return found, found


class _Turns:
    """Largest deviation, at the tool, of the planned command from the segment between two samples.

    It is computed at each tick between them. With samples at each tick it is 0.
    """

    def __init__(self, setting: Setting) -> None:
        trajectory, tick_s = setting.plan.motion.trajectory, setting.plan.commands.clock.period_s
        parts = int(np.ceil(setting.interval_s / float(tick_s) * (1.0 - _ROUNDING)))
        self._share = np.arange(parts) / parts if setting.coarse else np.empty(0)
        self._reader = TrajectoryReader(trajectory)
        self._columns = [trajectory.axes.index(axis) for axis in setting.axes]
        self._radius_m = setting.radius_m
        self._last_s: FloatArray = np.empty(0)
        self.most_m = 0.0

    def take(self, due_s: FloatArray) -> None:
        """Take the plan's time at the next samples."""
        if not len(self._share) or not len(due_s):
            return
        ends = np.concatenate([self._last_s, due_s])
        self._last_s = ends[-1:]
        for begin in range(0, len(ends) - 1, _AT_ONCE):
            part = ends[begin : begin + _AT_ONCE + 1]
            between = part[:-1, None] + np.diff(part)[:, None] * self._share
            times = np.append(between.ravel(), part[-1])
            places = self._reader.derivatives(times, 1)[:, 0, self._columns] * self._radius_m
            self._reader.drop(float(part[-1]))
            self.most_m = max(self.most_m, _deviation(places, len(self._share)))


def _deviation(places: FloatArray, parts: int) -> float:
    """Return the largest distance of (n parts + 1, axes) places from the segments of ``parts``."""
    start, end = places[:-1:parts, None], places[parts::parts, None]
    away, vector = places[:-1].reshape(len(start), parts, -1) - start, end - start
    length = np.maximum((vector**2).sum(axis=2), np.finfo(np.float64).tiny)
    along = np.clip((away * vector).sum(axis=2) / length, 0.0, 1.0)
    return float(np.sqrt(((away - along[..., None] * vector) ** 2).sum(axis=2).max()))


def _by_time(finding: Finding) -> Finding:
    return replace(finding, note="; ".join(filter(None, (finding.note, COMMAND_BY_TIME))))


def _headings(heading: FloatArray, step: FloatArray) -> FloatArray:
    """Return the (n, axes) direction of motion of the command at each place: its last ``step``.

    ``step`` is the displacement to each place, zero while the command rests within its resolution.
    Before the first motion the heading is 0.
    """
    moved = step[:, 0] != 0.0
    for axis in range(1, step.shape[1]):
        moved |= step[:, axis] != 0.0
    if moved.all():
        return step
    before = heading[-1:] if len(heading) else np.zeros((1, step.shape[1]))
    latest = np.maximum.accumulate(np.where(moved, np.arange(1, len(step) + 1), 0))
    return np.asarray(np.concatenate([before, step])[latest])


def start_progress(setting: Setting, options: Mapping[str, float]) -> Measure:  # noqa: ARG001
    """Begin measuring the progress error."""
    return _Progress(setting)
