"""Shorter jobs that stand for a long one: no middles of long moves, no repeated stretches.

A hoop layer is one move of hundreds of turns at a constant speed. Once the machine runs evenly, its
motion repeats until it brakes, so the beginning and the end of the move suffice. A search keeps
each end for the time of the speed change, and for some seconds more.

A winding program repeats its circuits, each turned by some degrees of the mandrel. The machine's
motion in a move depends on the moves shortly before it, and on the later moves that the planner
looks ahead to. It does not depend on the mandrel's total turns. So a move with surroundings that
occurred before gives no new result.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray, IntArray
from threadline.files import Stream
from threadline.jobs import Job
from threadline.jobs.operations import Feed, MoveRun, Operation, OperationStream, Source, move_runs
from threadline.machine import Machine
from threadline.motion.path import programmed_path

EVENLY_S = 3.0
"""Time for which either end of a long move is simulated at constant speed, s."""
_WORTH = 0.5  # a move or a job is not cut if a larger share of it would stay
_LONG_MOVES_MOST_MOVES = 100_000  # a job with more moves is not cut


@dataclass(frozen=True, slots=True, eq=False)
class LongMoves:
    """A job whose long moves can be cut.

    Parameters
    ----------
    job, machine
        The job, and the machine that does it.
    items
        Operations of the job, with its moves in runs; empty where the job is not cut.
    way
        (n, axes) travel of each move.
    """

    job: Job
    machine: Machine
    items: tuple[Operation | MoveRun, ...]
    way: FloatArray

    @classmethod
    def of(cls, job: Job, machine: Machine) -> LongMoves:
        """Read a job once.

        A job is not cut if a mandrel's radius changes on the way, if it holds more than a hundred
        thousand moves, or if feeds do not set its speed.
        """
        nothing = cls(job, machine, (), np.zeros((0, len(job.axes))))
        if job.paced_by != "feed" or machine.local_radii(job.axes) is not None:
            return nothing
        items, count = list[Operation | MoveRun](), 0
        for item in move_runs(job):
            items.append(item)
            count += len(item) if isinstance(item, MoveRun) else 0
            if count > _LONG_MOVES_MOST_MOVES:
                return nothing
        targets = [item.targets for item in items if isinstance(item, MoveRun)]
        ends = np.concatenate([np.array([job.start]), *targets])
        return cls(job, machine, tuple(items), np.diff(ends, axis=0))

    def without_middles(self, feed: Feed, share: float) -> tuple[Job, Machine]:
        """Return the job with its long moves cut short, and the machine that it is judged on.

        Targets behind a cut are shifted back by the travel left out, so that the motion stays
        continuous. If a shifted target leaves the travel, or the shifted targets need more than a
        stroke, the machine is returned without ends of travel.

        Parameters
        ----------
        feed
            Feed of every move but the rapid ones.
        share
            Share of the acceleration and jerk limits that is used.
        """
        unchanged = self.job, self.machine
        if not len(self.way):
            return unchanged
        kept_share = 2.0 * self._end_share(feed, share)
        left_out = np.where(kept_share < _WORTH, 1.0 - kept_share, 0.0)
        if not left_out.any():
            return unchanged
        shifts = np.cumsum(self.way * left_out[:, None], axis=0)
        items, first, vertices = list[Operation | MoveRun](), 0, [np.array([self.job.start])]
        for item in self.items:
            if isinstance(item, MoveRun):
                item = replace(item, targets=item.targets - shifts[first : first + len(item)])  # noqa: PLW2901
                first += len(item)
                vertices.append(item.targets)
            items.append(item)
        job = replace(self.job, operations=OperationStream(Stream.of(items)))
        columns = [self.machine.axis_names.index(axis) for axis in job.axes]
        low, high = self.machine.travel[columns].T
        positions = np.concatenate(vertices)
        strokes = [self.machine.axes[axis].stroke for axis in job.axes]
        strokes_si = np.array([np.inf if stroke is None else stroke.si for stroke in strokes])
        if ((low <= positions) & (positions <= high)).all() and (
            np.ptp(positions, axis=0) <= strokes_si
        ).all():
            return job, self.machine
        return unchanged if self.machine.inputs else (job, _without_ends(self.machine))

    def _end_share(self, feed: Feed, share: float) -> FloatArray:
        """Return (n,) the share of each move that is kept at either end; 1 for short moves."""
        machine, axes = self.machine, self.job.axes
        columns = [machine.axis_names.index(axis) for axis in axes]
        path = programmed_path(self.job, machine, feed)
        nominal_s = np.concatenate([block.nominal_s for block in path])[1:]
        distances = np.abs(self.way)
        lasts_s = np.maximum(nominal_s, (distances / machine.velocity_limit[columns]).max(axis=1))
        lasts_s = np.where(lasts_s > 0.0, lasts_s, 1.0)
        acceleration = share * machine.acceleration_limit[columns]
        rises_s = (distances / lasts_s[:, None] / acceleration).max(axis=1)
        with np.errstate(invalid="ignore"):
            rises_s += np.nan_to_num(machine.acceleration_limit / machine.jerk_limit).max()
        return np.asarray(np.minimum((EVENLY_S + 2.0 * rises_s) / lasts_s, 1.0))


def _without_ends(machine: Machine) -> Machine:
    """Return the machine with endless axes."""
    axes = {
        name: replace(axis, travel=None, stroke=None, endless=True)
        for name, axis in machine.axes.items()
    }
    return replace(machine, axes=axes)


_NEAR = 2e-5
"""Moves, m or rad, that differ by less are equal but for a program's rounding to 0.001 degrees."""
_BESIDE_S = 3.0
"""Least duration, s, of the surroundings on either side of a move, at the program's feeds."""
_LEAST, _MOST = 4, 64  # least and largest number of surrounding moves on either side
_FACTOR = np.uint64(0x9E3779B97F4A7C15)
_DISTINCT_MOST_MOVES = 2_000_000
_NOWHERE = Source("", 0)


@dataclass(frozen=True, slots=True, eq=False)
class _Moves:
    """The moves of a job as arrays, and the other operations before each move.

    Parameters
    ----------
    ends
        (n + 1, axes) positions, the start of the job first.
    code
        (n, k) whole numbers; equal rows are equal moves.
    before
        The other operations before a move, by the index of the move; n for those at the end.
    """

    ends: FloatArray
    code: IntArray
    moves: tuple[MoveRun, ...]
    before: dict[int, list[Operation]]


def distinct_parts(job: Job, machine: Machine, *, joined: bool = False) -> tuple[Job, ...]:
    """Return jobs that hold every new stretch of ``job``, each with its surroundings.

    Each stretch begins and ends at rest, although the whole job does not stop there. A mandrel that
    stops from full speed lifts its fibre, and the fibre is not tied at the begin of a stretch. With
    ``joined`` the result is a single job that goes on from each stretch to the next without a stop;
    this needs rotary axes without ends.

    ``job`` itself is returned if most of it is new, if its stretches cannot be joined, if it holds
    more than two million moves, or if feeds do not set its speed.
    """
    if job.paced_by != "feed":
        return (job,)
    moves_read = _read(job, machine)
    if moves_read is None or len(moves_read.code) < 4 * _LEAST:
        return (job,)
    beside_count = _beside(job, machine, len(moves_read.code))
    is_kept = _dilated(_new(moves_read.code, beside_count), beside_count)
    if is_kept.sum() > _WORTH * len(is_kept):
        return (job,)
    edges = np.flatnonzero(np.diff(is_kept.astype(np.int8), prepend=0, append=0))
    rotary = [one for one in map(machine.axes.get, job.axes) if one and one.kind != "linear"]
    spans = [(int(first), int(stop)) for first, stop in edges.reshape(-1, 2)]
    chains = [[span] for span in spans]
    if joined:
        chain = spans[:1]
        for first, stop in spans[1:]:
            repeated = _again(moves_read.code, chain[-1][1], first, beside_count)
            if repeated is None or not all(axis.endless for axis in rotary):
                return (job,)
            chain.append((repeated, stop))
        chains = [chain]
    return tuple(
        replace(
            job,
            start=tuple(moves_read.ends[chain[0][0]].tolist()),
            operations=OperationStream(Stream.of(_chained(moves_read, chain))),
        )
        for chain in chains
    )


def _again(code: IntArray, end: int, before: int, beside: int) -> int | None:
    """Return the last move up to ``before`` that follows the same moves as the move ``end``."""
    preceding = code[end - beside : end]
    for offset in np.flatnonzero((code[end:before] == code[end - 1]).all(axis=1))[::-1]:
        candidate = end + int(offset) + 1
        # An operation before the first move of a stretch, such as a dwell, would be lost.
        if not code[candidate, -1] and np.array_equal(
            code[candidate - beside : candidate], preceding
        ):
            return candidate
    return None


def _chained(read: _Moves, chain: list[tuple[int, int]]) -> Iterator[Operation | MoveRun]:
    """Yield the moves of all stretches; each stretch is shifted to the end of the previous one."""
    position = read.ends[chain[0][0]]
    for first, stop in chain:
        shift = position - read.ends[first]
        for item in _part(read, first, stop):
            if isinstance(item, MoveRun):
                yield replace(item, targets=item.targets + shift)
            else:
                yield item
        position = read.ends[stop] + shift


def moves_in(job: Job) -> int:
    """Return the number of moves of a job."""
    return sum(len(item) for item in move_runs(job) if isinstance(item, MoveRun))


def _read(job: Job, machine: Machine) -> _Moves | None:
    runs, operations_before, count = [], dict[int, list[Operation]](), 0
    feeds: dict[Feed | None, int] = {}
    feed_of: list[IntArray] = []
    for item in move_runs(job):
        if not isinstance(item, MoveRun):
            operations_before.setdefault(count, []).append(item)
            continue
        runs.append(item)
        count += len(item)
        if count > _DISTINCT_MOST_MOVES:
            return None
        edges = [*[begin for begin, _ in item.feeds], len(item)]
        feed_numbers = [feeds.setdefault(feed, len(feeds)) for _, feed in item.feeds]
        feed_of.append(np.repeat(feed_numbers, np.diff(edges)))
    if not runs:
        return None
    ends = np.concatenate([np.array([job.start]), *(run.targets for run in runs)])
    kinds: dict[str, int] = {}
    operation_before = np.zeros(count, dtype=np.int64)
    for index, items in operations_before.items():
        if index < count:
            text = repr([replace(item, source=_NOWHERE) for item in items])
            operation_before[index] = 1 + kinds.setdefault(text, len(kinds))
    bounded = [machine.axes[axis].kind == "linear" for axis in job.axes]
    columns = [*np.diff(ends, axis=0).T, *ends[:-1, bounded].T]
    code = np.stack(
        [*(_clustered(column) for column in columns), np.concatenate(feed_of), operation_before],
        axis=1,
    )
    return _Moves(ends, code, tuple(runs), operations_before)


def _clustered(values: FloatArray) -> IntArray:
    """Return (n,) a number for each value; values that differ only by rounding share a number."""
    order = np.argsort(values, kind="stable")
    ascending = values[order]
    gap = np.diff(ascending, prepend=ascending[0]) > _NEAR
    group = np.cumsum(gap)
    # A chain of near values may be long, so it is split by value.
    first = ascending[np.flatnonzero(np.concatenate([[True], gap[1:]]))]
    bin_number = np.floor((ascending - first[group]) / (4.0 * _NEAR)).astype(np.int64)
    number = np.cumsum(gap | (np.diff(bin_number, prepend=0) != 0))
    numbers = np.empty(len(values), dtype=np.int64)
    numbers[order] = number
    return numbers


def _beside(job: Job, machine: Machine, count: int) -> int:
    """Return the number of moves on either side that form a move's surroundings."""
    block_times_s: list[FloatArray] = []
    for block in programmed_path(job, machine):
        block_times_s.append(block.nominal_s[block.nominal_s > 0.0])
    times_s = np.concatenate(block_times_s) if block_times_s else np.zeros(0)
    typical_s = float(np.median(times_s)) if len(times_s) else _BESIDE_S
    return int(np.clip(np.ceil(_BESIDE_S / typical_s), _LEAST, min(_MOST, max(count // 4, 1))))


def _new(code: IntArray, beside: int) -> NDArray[np.bool_]:
    """Return (n,) whether the surroundings of a move occur for the first time."""
    with np.errstate(over="ignore"):
        hashes = np.zeros(len(code), dtype=np.uint64)
        for column in code.T:
            hashes = (hashes ^ (column.astype(np.uint64) + _FACTOR)) * _FACTOR
            hashes ^= hashes >> np.uint64(29)
        # Positions beyond the ends of the job get codes of their own, which occur only once.
        padding = np.arange(1, beside + 1, dtype=np.uint64)
        padded = np.concatenate([padding, hashes, padding + np.uint64(beside)])
        window_hashes = np.zeros(len(code), dtype=np.uint64)
        for shift in range(2 * beside + 1):
            window_hashes = window_hashes * _FACTOR + padded[shift : shift + len(code)]
            window_hashes ^= window_hashes >> np.uint64(31)
    _, first_indices = np.unique(window_hashes, return_index=True)
    new = np.zeros(len(code), dtype=bool)
    new[first_indices] = True
    return new


def _dilated(new: NDArray[np.bool_], beside: int) -> NDArray[np.bool_]:
    """Return (n,) whether a move is new or within ``beside`` of a new move."""
    count = np.concatenate([[0], np.cumsum(new)])
    index = np.arange(len(new))
    low, high = np.maximum(index - beside, 0), np.minimum(index + beside + 1, len(new))
    return np.asarray(count[high] > count[low])


def _part(read: _Moves, first: int, stop: int) -> Iterator[Operation | MoveRun]:
    """Yield the moves from ``first`` up to ``stop``, with the operations between them."""
    run_begin = 0
    for run in read.moves:
        begin, end = max(first - run_begin, 0), min(stop - run_begin, len(run))
        if begin < end:
            if run_begin > first:
                yield from read.before.get(run_begin, ())
            yield _cut(run, begin, end)
        run_begin += len(run)


def _cut(run: MoveRun, begin: int, end: int) -> MoveRun:
    """Return the moves of a run from ``begin`` up to ``end``."""
    feeds = [(max(at - begin, 0), feed) for at, feed in run.feeds if at < end]
    in_force = [index for index, (at, _) in enumerate(feeds) if at == 0][-1]
    return replace(
        run,
        targets=run.targets[begin:end],
        line=run.line[begin:end],
        feeds=tuple(feeds[in_force:]),
        columns={name: column[begin:end] for name, column in run.columns.items()},
        acts=tuple((at - begin, acts) for at, acts in run.acts if begin <= at < end),
    )
