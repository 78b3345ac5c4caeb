"""In which pass of a subroutine something happened: one line may be run a thousand times."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from threadline.jobs.operations import Job, MoveRun
from threadline.verdict.types import Result


def with_passes(results: Sequence[Result], job: Job) -> Iterator[Result]:
    """Yield ``results`` with the passes that their line was in; reads the job no further than that.

    A place may be on the chord of the operation before or after the one that is under way; the
    line tells which.
    """
    wanted = {
        operation + step
        for operation in (r.operation for r in results if r.job_line is not None)
        if operation is not None
        for step in (-1, 0, 1)
    }
    found = _sources(job, wanted)
    for result in results:
        if result.operation is not None and result.job_line is not None:
            for step in (0, -1, 1):
                line, passes = found.get(result.operation + step, (0, ()))
                if line == result.job_line:
                    if passes != result.passes:
                        result = replace(result, passes=passes)  # noqa: PLW2901
                    break
        yield result


def _sources(job: Job, wanted: set[int]) -> dict[int, tuple[int, tuple[int, ...]]]:
    """Return line and passes of the operations wanted."""
    found: dict[int, tuple[int, tuple[int, ...]]] = {}
    due = sorted(number for number in wanted if number >= 0)
    at = 0
    for item in job.runs() if due else ():
        count = len(item) if isinstance(item, MoveRun) else 1
        while due and due[0] < at + count:
            number = due.pop(0)
            if isinstance(item, MoveRun):
                found[number] = int(item.line[number - at]), item.passes
            else:
                found[number] = item.source.line, item.source.passes
        at += count
        if not due:
            break
    return found
