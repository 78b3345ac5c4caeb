"""Jobs made by hand, for the tests of this folder."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from hypothesis import strategies as st

from threadline.files import Stream
from threadline.jobs.operations import Feed, FeedMode, Job, Move, Operation, Source, Stop

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


TRAVEL = {"A": (-20.0, 20.0), "X": (-0.5, 0.5), "Y": (-0.05, 0.25)}


@st.composite
def polylines(draw) -> tuple[tuple[str, ...], list[list[float]]]:
    """Draw axes and a polyline on them: repeated points, reversals, tiny and huge moves."""
    axes = draw(st.sampled_from([("X",), ("A", "X"), ("X", "Y"), ("A", "X", "Y")]))
    position = [0.0 for _ in axes]
    points = [list(position)]
    for _ in range(draw(st.integers(1, 12))):
        kind = draw(st.sampled_from(["any", "any", "tiny", "repeat", "back", "one"]))
        if kind == "back" and len(points) > 1:
            position = list(points[-2])
        elif kind != "repeat":
            scale = draw(st.sampled_from([1e-5, 1e-4, 1e-3])) if kind == "tiny" else 0.3
            only = draw(st.integers(0, len(axes) - 1))
            for j, axis in enumerate(axes):
                if kind == "one" and j != only:
                    continue
                low, high = TRAVEL[axis]
                step = draw(st.integers(-1000, 1000)) / 1000 * scale * (20 if axis == "A" else 1)
                position[j] = float(np.clip(position[j] + step, low, high))
        points.append(list(position))
    return axes, points
