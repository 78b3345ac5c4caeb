"""The distinct stretches of a long job: what a search judges once, however often it comes.

A winding program repeats its circuits, each turned on by some degrees of the mandrel. What a
machine makes of a move depends on the moves shortly before it and on those that its planner sees
behind it, and not on how far a mandrel has turned. So a move whose surroundings were met before
tells nothing new.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from threadline.arrays import FloatArray, IntArray
from threadline.jobs import Job
from threadline.jobs.operations import (
    Feed,
    MoveRun,
    Operation,
    OperationStream,
    Source,
    move_runs,
)
from threadline.machine import Machine
from threadline.path import programmed_path
from threadline.signals import Stream

_NEAR = 2e-5
"""Differences of moves, m or rad, that count as rounding of a program's numbers: 0.001 degrees."""
_BESIDE_S = 3.0
"""How long the surroundings of a move are at least, by the feeds of the program."""
_LEAST, _MOST = 4, 64  # moves on either side
_WORTH = 0.5  # of a job: more of it that is new makes its parts worth less than the whole
_FACTOR = np.uint64(0x9E3779B97F4A7C15)
_MOST_MOVES = 2_000_000
_NOWHERE = Source("", 0)


@dataclass(frozen=True, slots=True, eq=False)
class _Moves:
    """The moves of a job as arrays, and what else stands before each of them.

    Parameters
    ----------
    ends
        (n + 1, axes) positions, the start of the job first.
    code
        (n, k) whole numbers; equal rows are equal moves.
    before
        By the number of a move, n included, the operations that stand before it.
    """

    ends: FloatArray
    code: IntArray
    moves: tuple[MoveRun, ...]
    before: dict[int, list[Operation]]


def distinct_parts(job: Job, machine: Machine) -> tuple[Job, ...]:
    """Return jobs that hold every stretch of ``job`` that is not met before, with what is beside.

    ``job`` itself is the only one where most of it is new, where it holds more than two million
    moves, and where its speed is not that of feeds.
    """
    if job.paced_by != "feed":
        return (job,)
    read = _read(job, machine)
    if read is None or len(read.code) < 4 * _LEAST:
        return (job,)
    beside = _beside(job, machine, len(read.code))
    kept = _dilated(_new(read.code, beside), beside)
    if kept.sum() > _WORTH * len(kept):
        return (job,)
    edges = np.flatnonzero(np.diff(kept.astype(np.int8), prepend=0, append=0))
    return tuple(
        replace(
            job,
            start=tuple(read.ends[first].tolist()),
            operations=OperationStream(Stream.of(_part(read, int(first), int(stop)))),
        )
        for first, stop in edges.reshape(-1, 2)
    )


def moves_in(job: Job) -> int:
    """Return how many moves a job has."""
    return sum(len(item) for item in move_runs(job) if isinstance(item, MoveRun))


def _read(job: Job, machine: Machine) -> _Moves | None:
    runs, before, count = [], dict[int, list[Operation]](), 0
    feeds: dict[Feed | None, int] = {}
    feed_of: list[IntArray] = []
    for item in move_runs(job):
        if not isinstance(item, MoveRun):
            before.setdefault(count, []).append(item)
            continue
        runs.append(item)
        count += len(item)
        if count > _MOST_MOVES:
            return None
        edges = [*[begin for begin, _ in item.feeds], len(item)]
        own = [feeds.setdefault(feed, len(feeds)) for _, feed in item.feeds]
        feed_of.append(np.repeat(own, np.diff(edges)))
    if not runs:
        return None
    ends = np.concatenate([np.array([job.start]), *(run.targets for run in runs)])
    kinds: dict[str, int] = {}
    stands = np.zeros(count, dtype=np.int64)
    for at, items in before.items():
        if at < count:
            told = repr([replace(item, source=_NOWHERE) for item in items])
            stands[at] = 1 + kinds.setdefault(told, len(kinds))
    bounded = [machine.axes[axis].kind == "linear" for axis in job.axes]
    columns = [*np.diff(ends, axis=0).T, *ends[:-1, bounded].T]
    code = np.stack(
        [*(_clustered(column) for column in columns), np.concatenate(feed_of), stands], axis=1
    )
    return _Moves(ends, code, tuple(runs), before)


def _clustered(values: FloatArray) -> IntArray:
    """Return (n,) a number for each value: the same for values that differ by roundings alone."""
    order = np.argsort(values, kind="stable")
    ascending = values[order]
    gap = np.diff(ascending, prepend=ascending[0]) > _NEAR
    group = np.cumsum(gap)
    # A chain of near values may be long: where it is, its parts are told apart by their place.
    first = ascending[np.flatnonzero(np.concatenate([[True], gap[1:]]))]
    place = np.floor((ascending - first[group]) / (4.0 * _NEAR)).astype(np.int64)
    number = np.cumsum(gap | (np.diff(place, prepend=0) != 0))
    found = np.empty(len(values), dtype=np.int64)
    found[order] = number
    return found


def _beside(job: Job, machine: Machine, count: int) -> int:
    """Return how many moves on either side of one are its surroundings."""
    took_s: list[FloatArray] = []
    for block in programmed_path(job, machine):
        took_s.append(block.nominal_s[block.nominal_s > 0.0])
    every = np.concatenate(took_s) if took_s else np.zeros(0)
    typical_s = float(np.median(every)) if len(every) else _BESIDE_S
    return int(np.clip(np.ceil(_BESIDE_S / typical_s), _LEAST, min(_MOST, max(count // 4, 1))))


def _new(code: IntArray, beside: int) -> NDArray[np.bool_]:
    """Return (n,) whether the surroundings of a move come here for the first time."""
    with np.errstate(over="ignore"):
        own = np.zeros(len(code), dtype=np.uint64)
        for column in code.T:
            own = (own ^ (column.astype(np.uint64) + _FACTOR)) * _FACTOR
            own ^= own >> np.uint64(29)
        # Beyond the ends of the job there is nothing, which is met nowhere else.
        outer = np.arange(1, beside + 1, dtype=np.uint64)
        long = np.concatenate([outer, own, outer + np.uint64(beside)])
        around = np.zeros(len(code), dtype=np.uint64)
        for shift in range(2 * beside + 1):
            around = around * _FACTOR + long[shift : shift + len(code)]
            around ^= around >> np.uint64(31)
    _, first = np.unique(around, return_index=True)
    new = np.zeros(len(code), dtype=bool)
    new[first] = True
    return new


def _dilated(new: NDArray[np.bool_], beside: int) -> NDArray[np.bool_]:
    """Return (n,) whether a move is new or within ``beside`` of one that is."""
    count = np.concatenate([[0], np.cumsum(new)])
    at = np.arange(len(new))
    low, high = np.maximum(at - beside, 0), np.minimum(at + beside + 1, len(new))
    return np.asarray(count[high] > count[low])


def _part(read: _Moves, first: int, stop: int) -> Iterator[Operation | MoveRun]:
    """Yield the moves from ``first`` up to ``stop``, with what stands between them."""
    at = 0
    for run in read.moves:
        begin, end = max(first - at, 0), min(stop - at, len(run))
        if begin < end:
            if at > first:
                yield from read.before.get(at, ())
            yield _cut(run, begin, end)
        at += len(run)


def _cut(run: MoveRun, begin: int, end: int) -> MoveRun:
    """Return some of the moves of a run."""
    feeds = [(max(at - begin, 0), feed) for at, feed in run.feeds if at < end]
    ahead = [index for index, (at, _) in enumerate(feeds) if at == 0][-1]
    return replace(
        run,
        targets=run.targets[begin:end],
        line=run.line[begin:end],
        feeds=tuple(feeds[ahead:]),
        columns={name: column[begin:end] for name, column in run.columns.items()},
        acts=tuple((at - begin, acts) for at, acts in run.acts if begin <= at < end),
    )
