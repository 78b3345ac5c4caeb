"""Reads each run once, with all its measures at the same time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from threadline.base.arrays import IntArray
from threadline.verdict.finding import Finding, RunFindings
from threadline.verdict.measure import MeasureKind, MeasureOfRuns, OfRuns, Run, Running
from threadline.verdict.samples import Block
from threadline.verdict.sweep import feed

Key = tuple[str, tuple[tuple[str, float], ...]]
"""A measure and its options."""
Findings = dict[Key, list[RunFindings]]


class _Begun:
    """The started measures of one run, and the reasons for measures that cannot start."""

    def __init__(self, run: Run, kinds: Mapping[Key, MeasureKind], together: bool) -> None:
        self.run = run
        self._lacking: Findings = {}
        self._running: dict[Key, Running] = {}
        self.last: Block | None = None
        for key, kind in kinds.items():
            reading = kind.of_run(run)
            if reading is None or (isinstance(reading, OfRuns) and not together):
                continue
            if reading.start is None:
                continue
            missing = run.lacks(reading, kind.per_axis)
            if missing:
                # For every axis: another recording may have measured it, and both count.
                for_axes = run.plan.axes if kind.per_axis else ("",)
                self._lacking[key] = [
                    RunFindings.made([Finding(value=None, axis=axis, note=missing)])
                    for axis in for_axes
                ]
            else:
                options = kind.with_defaults(dict(key[1]))
                self._running[key] = Running(
                    kind=kind, reading=reading, measure=reading.start(run, options), options=options
                )
        self._measures = [one.measure for one in self._running.values()]

    def blocks(self) -> Iterator[Block]:
        """Feed the measures; yield their blocks."""
        for block in self.run.blocks():
            feed(self._measures, block)
            self.last = block
            yield block

    def found(self) -> Findings:
        measured = self.run.results(list(self._running.values()), self.last)
        return self._lacking | dict(zip(self._running, measured, strict=True))


class _Timed:
    """A run with the plan's operations, read in step with the run as it was recorded."""

    def __init__(self, run: Run, kinds: Mapping[Key, MeasureKind], together: bool) -> None:
        self.begun = _Begun(run, kinds, together)
        self._blocks = self.begun.blocks()
        self._operation: IntArray = np.empty(0, dtype=np.int64)  # of samples not requested yet

    def operations(self, count: int) -> IntArray:
        """Read until ``count`` more samples are known; return their operations."""
        while len(self._operation) < count:
            block = next(self._blocks)
            assert block.operation is not None
            self._operation = np.concatenate([self._operation, block.operation])
        taken, self._operation = self._operation[:count], self._operation[count:]
        return taken

    def finish(self) -> None:
        """Read the rest."""
        for _ in self._blocks:
            pass

    def leave(self) -> None:
        """Stop reading, so that no blocks are kept for it."""
        self.begun.run.leave()


class Pass:
    """One pass over one run.

    Until it is known whether the recording has operations of its own, the run is measured twice in
    parallel: with the operations as recorded, and with the plan's operations by time.

    Parameters
    ----------
    run
        The run.
    kinds
        Measures, by key.
    together
        Whether the parallel runs of its recording are measured together, too.
    """

    def __init__(self, run: Run, kinds: Mapping[Key, MeasureKind], *, together: bool) -> None:
        self._begun = _Begun(run, kinds, together)
        self._timed = None if run.fallback is None else _Timed(run.fallback, kinds, together)

    def blocks(self) -> Iterator[tuple[Block, IntArray | None]]:
        """Read the run; yield its blocks, and the operations by time while they may be needed."""
        for block in self._begun.blocks():
            if self._timed is not None and self._begun.run.fallback is None:
                self._timed.leave()
                self._timed = None
            yield block, None if self._timed is None else self._timed.operations(len(block))
        if self._timed is not None:
            self._timed.finish()
            self._begun = self._timed.begun

    @property
    def run(self) -> Run:
        """The run; after reading, the run whose operations count."""
        return self._begun.run

    def found(self) -> Findings:
        """Return the findings of this run, after reading; discard its samples."""
        found = self._begun.found()
        self.run.release()
        return found


def read_all(passes: Sequence[Pass], together: Sequence[MeasureOfRuns]) -> None:
    """Read every run once.

    Parameters
    ----------
    together
        Measures of all runs. If there are any, the run that is furthest behind is read next, so
        that no run gets far ahead of another.
    """
    readers = dict(enumerate(one.blocks() for one in passes))
    taken = dict.fromkeys(readers, 0)
    while readers:
        number = min(readers, key=taken.__getitem__) if together else next(iter(readers))
        item = next(readers[number], None)
        if item is None:
            del readers[number]
            continue
        block, by_time = item
        taken[number] += len(block)
        for measure in together:
            measure.feed(number, block, by_time)
