"""Which share of the machines within the tolerances is out of specification, against a wish."""

from __future__ import annotations

import numpy as np

from threadline.arrays import FloatArray
from threadline.errors import MachineError, RecordingError
from threadline.kinds.kind import Kind
from threadline.plan import Plan
from threadline.verdict import Judge, Result, Status
from threadline.verdict.binomial import clopper_pearson

REJECTS = "rejects"
_AT_ONCE = 256


def rejects(
    kind: Kind,
    plan: Plan,
    judge: Judge,
    parts: FloatArray,
    wished: float,
    random: np.random.Generator,
) -> tuple[Result, int]:
    """Judge other machines, and return how many are out of specification, and how many were tried.

    What is measured is the upper end of the exact 95 % interval of that share: the yield is at
    least the rest. Where the machines so far say already that it is too much, no more are tried.
    A machine that cannot be simulated, or that never ends what it waits for, is out.

    Parameters
    ----------
    parts
        (k, n) where each number of each machine lies in its tolerance.
    wished
        The yield that is asked for, a share.
    random
        Where encoders stand.
    """
    tried = failed = 0
    most, limit = 1.0, 1.0 - wished
    for at in range(0, len(parts), _AT_ONCE):
        some = parts[at : at + _AT_ONCE]
        failed += _failed(kind, plan, judge, some, random)
        tried += len(some)
        most = 1.0 - clopper_pearson(tried - failed, tried)[0]
        if 1.0 - clopper_pearson(len(parts) - failed, len(parts))[0] > limit:
            break
    result = Result(
        name=REJECTS,
        axis="",
        measured=most,
        limit=limit,
        unit="",
        status=Status.FAILED if most > limit else Status.PASSED,
        required=True,
        note=f"{failed} of {tried} machines within the tolerances are out of specification",
    )
    return result, tried


def _failed(
    kind: Kind, plan: Plan, judge: Judge, parts: FloatArray, random: np.random.Generator
) -> int:
    """Return how many machines are out; where one has no answer, the halves say which."""
    try:
        others = kind.others(plan.commands, plan.machine, parts, random)
        return sum(int((~judge.each(one).passed).sum()) for one in others)
    except (MachineError, RecordingError):
        if len(parts) == 1:
            return 1
        half = len(parts) // 2
        low = _failed(kind, plan, judge, parts[:half], random)
        return low + _failed(kind, plan, judge, parts[half:], random)
