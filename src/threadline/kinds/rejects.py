"""The share of machines within the tolerances that are out of specification, against a limit."""

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
    """Judge machines within the tolerances; return the criterion of rejects and their number.

    The measured value is the upper end of the exact 95 % interval (Clopper and Pearson) of the
    share of machines out of specification. A machine that cannot be simulated, or that waits
    forever for an input, counts as out of specification. Judging ends early once the limit would be
    exceeded even if all remaining machines were in specification. The number that is returned is
    that of the machines judged.

    Parameters
    ----------
    parts
        (k, n) place of each of the n numbers of k machines within its tolerance.
    wished
        Wanted yield, a share from 0 to 1; the limit is ``1 - wished``.
    random
        Generator from which encoder phases are drawn.
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
    """Return how many machines are out of specification.

    One machine that cannot be simulated or judged raises an error for all that share the call, so
    halves of them are tried until it is alone.
    """
    try:
        others = kind.others(plan.commands, plan.machine, parts, random)
        return sum(int((~judge.each(one).passed).sum()) for one in others)
    except (MachineError, RecordingError):
        if len(parts) == 1:
            return 1
        half = len(parts) // 2
        low = _failed(kind, plan, judge, parts[:half], random)
        return low + _failed(kind, plan, judge, parts[half:], random)
