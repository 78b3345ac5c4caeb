"""Repeatability: how far runs of one and the same job lie apart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import zip_longest

import numpy as np

from threadline.path.types import ProgrammedPath
from threadline.plan import Plan
from threadline.signals import Recording
from threadline.verdict.blocks import judged_blocks
from threadline.verdict.measure import Block, Finding, Option

OPTIONS = {"recordings": Option(unit="", default=20.0)}


def measure_repeatability(
    recordings: Sequence[Recording], plan: Plan, options: Mapping[str, float]
) -> Sequence[Finding]:
    """Return the largest distance, at the tool, of any run from the mean of all runs.

    Compared at equal operation and equal instant, over the whole job: a difference in lag counts.
    One recording alone, or fewer than the specification asks for, measures nothing; nor do runs
    that were not in the same operation at the same instant.

    Parameters
    ----------
    recordings
        Read in step; memory holds one block of each.
    plan
        Gives the order of the axes and their radii.
    options
        ``recordings``: how many it takes.
    """
    wanted = max(int(options["recordings"]), 2)
    if len(recordings) < wanted:
        return [Finding(value=None, note=f"needs {wanted} recordings, has {len(recordings)}")]
    path: ProgrammedPath = plan.programmed
    streams = [judged_blocks(recording, path.axes, 0, None) for recording in recordings]
    worst = Finding(value=None, note="the recordings are empty")
    for blocks in zip_longest(*streams):
        if any(block is None or len(block) != len(blocks[0]) for block in blocks):
            return [Finding(value=None, note="the recordings differ in length")]
        operations = np.stack([b.operation for b in blocks if b.operation is not None])
        if (operations != operations[0]).any():
            return [Finding(value=None, note="the recordings differ in their operations")]
        finding = _spread(blocks, path)
        if worst.value is None or (finding.value or 0.0) > worst.value:
            worst = finding
    return [worst]


def _spread(blocks: Sequence[Block], path: ProgrammedPath) -> Finding:
    actual = np.stack([block.actual for block in blocks if block.actual is not None])
    away = np.linalg.norm((actual - actual.mean(axis=0)) * path.radius_m, axis=2)
    run, at = np.unravel_index(int(np.argmax(away)), away.shape)
    return Finding(
        value=float(away[run, at]),
        time_s=float(blocks[0].time_s[at]),
        operation=blocks[0].operation_at(int(at)),
        position=blocks[0].position_at(int(at)),
        note=f"recording {int(run) + 1}",
    )
