"""Where a circuit of a job begins: with one pass of an outermost subroutine call."""

from __future__ import annotations

from threadline.jobs.operations import Source


def begins_circuit(before: Source | None, now: Source) -> bool:
    """Say whether a circuit begins between two operations that follow each other.

    Parameters
    ----------
    before
        Where the operation before comes from; None at the beginning of the job.
    now
        Where the operation comes from.
    """
    if not now.passes:
        return False
    if before is None or not before.passes or before.passes[0] != now.passes[0]:
        return True
    # Two calls of one pass each, one after the other: the lines begin again.
    return len(before.passes) == len(now.passes) == 1 and now.line < before.line
