"""Jobs made by hand, for the tests of this folder."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from threadline.jobs.operations import Feed, FeedMode, Job, Move, Operation, Source, Stop
from threadline.signals import Stream

COUNTS = FeedMode.COUNT_PER_TICK


def job_of(
    points: Sequence[Sequence[float]],
    axes: tuple[str, ...],
    feed: Feed | None,
    *,
    extra: dict[int, Operation] | None = None,
) -> Job:
    """Return a job that visits ``points`` (m, rad); the first is the start.

    Move i has line i; ``extra[i]`` is inserted after it.
    """
    operations: list[Operation] = []
    for line, point in enumerate(points[1:], start=1):
        operations.append(Move(tuple(map(float, point)), feed, Source("job.prg", line)))
        if extra and line in extra:
            operations.append(extra[line])
    operations.append(Stop(True, Source("job.prg", len(points))))
    return Job(
        name="job",
        file="job.prg",
        sha256="",
        axes=axes,
        start=tuple(map(float, points[0])),
        operations=Stream.of(operations),
    )


def there_and_back(points_each_way: int = 8) -> list[list[float]]:
    """Return the reversal test: X 0 -> 180 mm -> 0 with as many points each way, ends included."""
    way = np.linspace(0.0, 0.18, points_each_way)
    return [[x] for x in way] + [[x] for x in way[-2::-1]]
