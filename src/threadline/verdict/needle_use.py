"""How much of the acceleration of its drive a needle uses that follows the head."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from threadline.arrays import FloatArray
from threadline.jobs.operations import Job
from threadline.plan import Plan
from threadline.verdict.finding import Finding
from threadline.verdict.needle import Stitches, has_stitches, planned_stitches
from threadline.verdict.types import Criterion, Spec

NAME = "needle_use"


def with_needle(spec: Spec, job: Job) -> Spec:
    """Return the specification with a limit for the needle of a seam that sets one.

    The limit is that of the seam file, as limits of axes are those of the machine: no
    specification widens it.
    """
    if not np.isfinite(job.along_m_s2):
        return spec
    others = tuple(c for c in spec.criteria if c.name != NAME)
    return replace(
        spec, criteria=(*others, Criterion(name=NAME, limit=1.0, required=True, hard=True))
    )


def measure_needle_use(plan: Plan) -> dict[str, list[Finding]]:
    """Return the largest change of the needle's speed from turn to turn, over what its drive can.

    The speed of a turn is one over its time. It changes from the middle of a turn to the middle of
    the next; beside a rest of the head it changes from, or to, nothing at that end of the turn.
    """
    if not has_stitches(plan.job):
        return {NAME: [Finding(value=None, note="the job has no stitches")]}
    worst = Finding(value=None, note="no seam sets the acceleration of a needle that follows")
    before = (0.0, 0.0)  # speed, and how long half of that turn lasts
    for run in planned_stitches(plan):
        share, before = _shares(run, before)
        known = np.flatnonzero(np.isfinite(share))
        if not len(known):
            continue
        k = int(known[np.argmax(share[known])])
        if worst.value is None or share[k] > worst.value:
            worst = Finding(
                value=float(share[k]),
                time_s=float(run.down_s[k]),
                operation=int(run.operation[k]),
                job_line=int(run.line[k]),
            )
    return {NAME: [worst]}


def _shares(run: Stitches, before: tuple[float, float]) -> tuple[FloatArray, tuple[float, float]]:
    """Return (n,) shares of the limit used in each turn, NaN without one, and the last turn."""
    hz, half_s = 1.0 / run.period_s, 0.5 * run.period_s
    came_hz = np.append(before[0], hz[:-1])
    came_s = np.append(before[1], half_s[:-1])
    came_hz[run.departs], came_s[run.departs] = 0.0, 0.0
    change = np.abs(hz - came_hz) / (half_s + came_s)
    change = np.maximum(change, np.where(run.stops, hz / half_s, 0.0))
    return change / run.most_hz_s, (float(hz[-1]), float(half_s[-1]))
