"""One verdict over a machine and those at the ends of its tolerances: the worst of all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from threadline.verdict.types import Result, Status, Verdict


def worst_of(verdict: Verdict, ends: Sequence[tuple[str, Verdict]]) -> Verdict:
    """Return ``verdict`` with every result as bad as it is on the worst machine.

    Parameters
    ----------
    verdict
        Of the machine as its file says.
    ends
        What sets each other machine apart, and its verdict by the same specification. What one of
        them did not measure, as repeatability in one run, is left to ``verdict``.
    """
    results = list(verdict.results)
    for told, other in ends:
        found = {(r.name, r.axis, r.step): r for r in other.results}
        for k, result in enumerate(results):
            one = found.get((result.name, result.axis, result.step))
            if one is not None and _worse(one, result):
                note = ", ".join(filter(None, (one.note, told)))
                results[k] = replace(one, note=note, run=None)
    return replace(verdict, results=tuple(results), ends=len(ends))


def _worse(one: Result, than: Result) -> bool:
    return one.status is not Status.NOT_MEASURED and one.severity > than.severity
