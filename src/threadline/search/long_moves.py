"""Long moves of a job without their middles, which a search need not watch to their end.

A hoop layer is one move of hundreds of turns at a constant speed. Once the machine runs evenly it
does the same again and again, until it brakes: its beginning and its end tell all of it. Each is
kept for as long as it takes to come to the speed and to leave it again, and some seconds more.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from threadline.arrays import FloatArray
from threadline.jobs import Job
from threadline.jobs.operations import (
    Feed,
    MoveRun,
    Operation,
    OperationStream,
    move_runs,
)
from threadline.machine import Machine
from threadline.path import programmed_path
from threadline.signals import Stream

EVENLY_S = 3.0
"""How long either end of a move is watched at its own speed."""
_WORTH = 0.5  # of a move: where more of it is kept, it stays whole
_MOST_MOVES = 100_000  # of a job: it takes long for other reasons


@dataclass(frozen=True, slots=True, eq=False)
class LongMoves:
    """A job whose long moves can be cut.

    Parameters
    ----------
    job, machine
        The job, and the machine that does it.
    items
        Its operations, moves in runs; none where it is not cut.
    way
        (n, axes) of its moves.
    """

    job: Job
    machine: Machine
    items: tuple[Operation | MoveRun, ...]
    way: FloatArray

    @classmethod
    def of(cls, job: Job, machine: Machine) -> LongMoves:
        """Read a job once.

        It is not cut where a mandrel's radius changes on the way, where it holds more than a
        hundred thousand moves, and where its speed is not that of feeds.
        """
        nothing = cls(job, machine, (), np.zeros((0, len(job.axes))))
        if job.paced_by != "feed" or machine.local_radii(job.axes) is not None:
            return nothing
        items, count = list[Operation | MoveRun](), 0
        for item in move_runs(job):
            items.append(item)
            count += len(item) if isinstance(item, MoveRun) else 0
            if count > _MOST_MOVES:
                return nothing
        targets = [item.targets for item in items if isinstance(item, MoveRun)]
        ends = np.concatenate([np.array([job.start]), *targets])
        return cls(job, machine, tuple(items), np.diff(ends, axis=0))

    def without_middles(self, feed: Feed, share: float) -> tuple[Job, Machine]:
        """Return the job with its long moves cut short, and the machine that it is judged on.

        What follows a cut lies back by what is left out, so that nothing stops that would go on.
        Where that leads out of the travel, the machine is given back without ends of travel.

        Parameters
        ----------
        feed
            Of every move but the rapid ones.
        share
            Of the limits of acceleration and jerk that is used.
        """
        whole = self.job, self.machine
        if not len(self.way):
            return whole
        kept = 2.0 * self._kept(feed, share)
        left_out = np.where(kept < _WORTH, 1.0 - kept, 0.0)
        if not left_out.any():
            return whole
        back = np.cumsum(self.way * left_out[:, None], axis=0)
        items, first, ends = list[Operation | MoveRun](), 0, [np.array([self.job.start])]
        for item in self.items:
            if isinstance(item, MoveRun):
                item = replace(item, targets=item.targets - back[first : first + len(item)])  # noqa: PLW2901
                first += len(item)
                ends.append(item.targets)
            items.append(item)
        job = replace(self.job, operations=OperationStream(Stream.of(items)))
        column = [self.machine.axis_names.index(axis) for axis in job.axes]
        low, high = self.machine.travel[column].T
        places = np.concatenate(ends)
        if ((low <= places) & (places <= high)).all():
            return job, self.machine
        return whole if self.machine.inputs else (job, _without_ends(self.machine))

    def _kept(self, feed: Feed, share: float) -> FloatArray:
        """Return (n,) the share of each move that is kept at either end; 1 of short ones."""
        machine, axes = self.machine, self.job.axes
        column = [machine.axis_names.index(axis) for axis in axes]
        path = programmed_path(self.job, machine, feed)
        nominal_s = np.concatenate([block.nominal_s for block in path])[1:]
        size = np.abs(self.way)
        lasts_s = np.maximum(nominal_s, (size / machine.velocity_limit[column]).max(axis=1))
        lasts_s = np.where(lasts_s > 0.0, lasts_s, 1.0)
        acceleration = share * machine.acceleration_limit[column]
        rises_s = (size / lasts_s[:, None] / acceleration).max(axis=1)
        with np.errstate(invalid="ignore"):
            rises_s += np.nan_to_num(machine.acceleration_limit / machine.jerk_limit).max()
        return np.asarray(np.minimum((EVENLY_S + 2.0 * rises_s) / lasts_s, 1.0))


def _without_ends(machine: Machine) -> Machine:
    """Return a machine that no axis comes to an end of."""
    axes = {
        name: replace(axis, travel=None, stroke=None, endless=True)
        for name, axis in machine.axes.items()
    }
    return replace(machine, axes=axes)
