"""Repeatability: the spread of runs of the same job."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.verdict.finding import Finding, RunFindings, Worst
from threadline.verdict.measure import Measure, MeasureOfRuns, Option, Run
from threadline.verdict.samples import Block, Setting

OPTIONS = {"recordings": Option(unit="", default=20.0)}


class _Spread:
    """The largest distance, at the tool, of any run from the mean of all runs.

    Compared at equal operation and equal instant, over the whole job: a difference in lag counts.
    """

    def __init__(self, setting: Setting, lacking: str) -> None:
        self.setting, self._lacking = setting, lacking
        self._worst = Worst(1, len(setting.axes), note=lacking or "the recordings are empty")
        self._squared: FloatArray = np.zeros(1)

    def feed(self, block: Block) -> None:
        """Take the next samples of all runs."""
        if self._lacking or block.actual is None:
            return
        mean = block.actual.mean(axis=1, keepdims=True)
        away = self.setting.lengths(block.actual - mean, block.actual)
        squared = (away**2).sum(axis=2)
        self._squared = np.maximum(self._squared, squared.max(axis=0))
        at, run = np.unravel_index(int(np.argmax(squared)), squared.shape)
        index = np.array([at])
        self._worst.offer(
            np.sqrt(squared[index, run]),
            time_s=block.time_s[index],
            operation=block.operations_at(index),
            position=block.positions_at(index),
            note=f"recording {int(run) + 1}",
        )

    def finish(self) -> Sequence[RunFindings]:
        """Return the one finding for all runs together."""
        typical = float(np.sqrt(np.median(self._squared)))
        return [self._worst.found().each(lambda one: replace(one, typical=typical))]


def start_repeatability(setting: Setting, options: Mapping[str, float]) -> Measure:
    """Begin measuring the spread of parallel runs in one recording.

    Parameters
    ----------
    options
        ``recordings``: number of runs needed; fewer measure nothing.
    """
    least_count = max(int(options["recordings"]), 2)
    few = setting.runs < least_count
    return _Spread(setting, f"needs {least_count} recordings, has {setting.runs}" if few else "")


def start_in_step(runs: Sequence[Setting], options: Mapping[str, float]) -> MeasureOfRuns:
    """Begin measuring the spread of runs in separate recordings.

    Nothing is measured with fewer runs than the specification asks for, or if the runs are not in
    the same operation at the same instant.

    Parameters
    ----------
    runs
        Read in step; memory holds only the lead of one run over the others.
    options
        ``recordings``: number of runs needed.
    """
    least_count, count = max(int(options["recordings"]), 2), sum(run.runs for run in runs)
    few = f"needs {least_count} recordings, has {count}" if count < least_count else ""
    return _InStep(len(runs), _Spread(runs[0], few), few)


@dataclass(slots=True)
class _Taken:
    """Samples of a run that wait for the other runs: a block from sample ``begin`` on."""

    block: Block
    by_time: IntArray | None
    begin: int = 0

    @property
    def left(self) -> int:
        return len(self.block) - self.begin


class _Operations:
    """Hashes of the operations of a run, as recorded and by time."""

    def __init__(self) -> None:
        self.samples = 0
        self._own, self._by_time, self.both = sha256(), sha256(), False

    def take(self, block: Block, by_time: IntArray | None) -> None:
        self.samples += len(block)
        if block.operation is not None:
            self._own.update(block.operation.tobytes())
        if by_time is not None:
            self.both = True
            self._by_time.update(by_time.tobytes())

    def digest(self, run: Run) -> bytes:
        return (self._by_time if self.both and run.by_time else self._own).digest()


class _InStep:
    """The spread of runs, sample by sample, as soon as every run has the sample."""

    def __init__(self, count: int, spread: _Spread, few: str) -> None:
        self._few = few
        # With operations by time the spread is the same; the operation reported may differ.
        self._own, self._by_time = spread, _Spread(spread.setting, few)
        self._held = False
        self._waiting: list[deque[_Taken]] = [deque() for _ in range(count)]
        self._operations = [_Operations() for _ in range(count)]

    def feed(self, number: int, block: Block, by_time: IntArray | None) -> None:
        """Take the next samples of a run."""
        if self._few or block.actual is None or not len(block):
            return
        self._held = self._held or block.slow is not None
        self._operations[number].take(block, by_time)
        self._waiting[number].append(_Taken(block, by_time))
        while all(self._waiting):
            heads = [waiting[0] for waiting in self._waiting]
            count = min(head.left for head in heads)
            self._compare(heads, count)
            for head, waiting in zip(heads, self._waiting, strict=True):
                head.begin += count
                if not head.left:
                    waiting.popleft()

    def _compare(self, heads: Sequence[_Taken], count: int) -> None:
        actual = [
            head.block.actual[head.begin : head.begin + count]
            for head in heads
            if head.block.actual is not None
        ]
        first, rows = heads[0].block, slice(heads[0].begin, heads[0].begin + count)
        part = replace(
            first,
            time_s=first.time_s[rows],
            actual=np.concatenate(actual, axis=1),
            commanded=None if first.commanded is None else first.commanded[rows],
            operation=None if first.operation is None else first.operation[rows],
        )
        self._own.feed(part)
        by_time = heads[0].by_time
        self._by_time.feed(replace(part, operation=None if by_time is None else by_time[rows]))

    def finish(self, runs: Sequence[Run]) -> Sequence[Finding]:
        """Return the largest distance, if all runs did the same operations at the same instants."""
        if not self._few:
            if self._held:
                return [Finding(value=None, note="a run was held: its instants are its own")]
            if any(one.samples != self._operations[0].samples for one in self._operations):
                return [Finding(value=None, note="the recordings differ in length")]
            digests = {one.digest(run) for one, run in zip(self._operations, runs, strict=True)}
            if len(digests) > 1:
                return [Finding(value=None, note="the recordings differ in their operations")]
        late = runs[0].by_time and self._operations[0].both
        return [found.worst() for found in (self._by_time if late else self._own).finish()]
