"""Repeatability: how far runs of one and the same job lie apart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import zip_longest

import numpy as np

from threadline.arrays import FloatArray
from threadline.verdict.blocks import judged_blocks
from threadline.verdict.measure import Finding, Option
from threadline.verdict.samples import Block, Setting

OPTIONS = {"recordings": Option(unit="", default=20.0)}


def measure_repeatability(
    runs: Sequence[Setting], options: Mapping[str, float]
) -> Sequence[Finding]:
    """Return the largest distance, at the tool, of any run from the mean of all runs.

    Compared at equal operation and equal instant, over the whole job: a difference in lag counts.
    One recording alone, or fewer than the specification asks for, measures nothing; nor do runs
    that were not in the same operation at the same instant.

    Parameters
    ----------
    runs
        Read in step; memory holds one block of each.
    options
        ``recordings``: how many it takes.
    """
    wanted = max(int(options["recordings"]), 2)
    if len(runs) < wanted:
        return [Finding(value=None, note=f"needs {wanted} recordings, has {len(runs)}")]
    streams = [judged_blocks(run.recording, run.axes, 0, None) for run in runs]
    worst = Finding(value=None, note="the recordings are empty")
    for blocks in zip_longest(*streams):
        if any(block is None or len(block) != len(blocks[0]) for block in blocks):
            return [Finding(value=None, note="the recordings differ in length")]
        operations = np.stack([b.operation for b in blocks if b.operation is not None])
        if (operations != operations[0]).any():
            return [Finding(value=None, note="the recordings differ in their operations")]
        finding = _spread(blocks, runs[0].radius_m)
        if worst.value is None or (finding.value or 0.0) > worst.value:
            worst = finding
    return [worst]


def _spread(blocks: Sequence[Block], radius_m: FloatArray) -> Finding:
    actual = np.stack([block.actual for block in blocks if block.actual is not None])
    away = np.linalg.norm((actual - actual.mean(axis=0)) * radius_m, axis=2)
    run, at = np.unravel_index(int(np.argmax(away)), away.shape)
    return Finding(
        value=float(away[run, at]),
        time_s=float(blocks[0].time_s[at]),
        operation=blocks[0].operation_at(int(at)),
        position=blocks[0].position_at(int(at)),
        note=f"recording {int(run) + 1}",
    )
