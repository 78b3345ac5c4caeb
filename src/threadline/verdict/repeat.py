"""Repeatability: how far runs of one and the same job lie apart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import zip_longest

import numpy as np

from threadline.arrays import FloatArray
from threadline.verdict.blocks import judged_blocks
from threadline.verdict.found import Finding, Found, Worst
from threadline.verdict.measure import Measure, Option
from threadline.verdict.samples import Block, Setting

OPTIONS = {"recordings": Option(unit="", default=20.0)}


class _Spread:
    """The largest distance, at the tool, of any run from the mean of all runs.

    Compared at equal operation and equal instant, over the whole job: a difference in lag counts.
    """

    def __init__(self, radius_m: FloatArray, lacking: str) -> None:
        self._radius_m, self._lacking = radius_m, lacking
        self._worst = Worst(1, len(radius_m), note=lacking or "the recordings are empty")

    def feed(self, block: Block) -> None:
        """Take the next samples of all runs."""
        if self._lacking or block.actual is None:
            return
        away = (block.actual - block.actual.mean(axis=1, keepdims=True)) * self._radius_m
        squared = (away**2).sum(axis=2)
        at, run = np.unravel_index(int(np.argmax(squared)), squared.shape)
        index = np.array([at])
        self._worst.offer(
            np.sqrt(squared[index, run]),
            time_s=block.time_s[index],
            operation=block.operations_at(index),
            position=block.positions_at(index),
            note=f"recording {int(run) + 1}",
        )

    def finish(self) -> Sequence[Found]:
        """Return the one finding that all runs have together."""
        return [self._worst.found()]


def start_repeatability(setting: Setting, options: Mapping[str, float]) -> Measure:
    """Begin measuring the spread of the runs that one recording holds side by side.

    Parameters
    ----------
    options
        ``recordings``: how many it takes; fewer measure nothing.
    """
    wanted = max(int(options["recordings"]), 2)
    few = setting.runs < wanted
    return _Spread(
        setting.radius_m, f"needs {wanted} recordings, has {setting.runs}" if few else ""
    )


def measure_repeatability(
    runs: Sequence[Setting], options: Mapping[str, float]
) -> Sequence[Finding]:
    """Return the spread of runs that were recorded one by one.

    Fewer than the specification asks for measure nothing, nor do runs that were not in the same
    operation at the same instant.

    Parameters
    ----------
    runs
        Read in step; memory holds one block of each.
    options
        ``recordings``: how many it takes.
    """
    wanted, count = max(int(options["recordings"]), 2), sum(run.runs for run in runs)
    if count < wanted:
        return [Finding(value=None, note=f"needs {wanted} recordings, has {count}")]
    streams = [judged_blocks(run.recording, run.axes, 0, None) for run in runs]
    spread = _Spread(runs[0].radius_m, "")
    for blocks in zip_longest(*streams):
        if any(block is None or len(block) != len(blocks[0]) for block in blocks):
            return [Finding(value=None, note="the recordings differ in length")]
        operations = np.stack([b.operation for b in blocks if b.operation is not None])
        if (operations != operations[0]).any():
            return [Finding(value=None, note="the recordings differ in their operations")]
        actual = [block.actual for block in blocks if block.actual is not None]
        spread.feed(replace(blocks[0], actual=np.concatenate(actual, axis=1)))
    return [found.worst() for found in spread.finish()]
