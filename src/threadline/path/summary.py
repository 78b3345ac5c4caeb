"""What a planner reports of its path, worked out when somebody asks."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import cached_property

from threadline.path.auto import points_added
from threadline.path.deviation import path_deviation
from threadline.path.types import PlannedPath, ProgrammedPath


class LazySummary(Mapping[str, float]):
    """A mapping that reads its paths at the first look at it, and once only."""

    def __init__(self, work: Callable[[], Mapping[str, float]]) -> None:
        self._work = work

    @cached_property
    def _found(self) -> Mapping[str, float]:
        return self._work()

    def __getitem__(self, key: str) -> float:
        return self._found[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self._found)

    def __len__(self) -> int:
        return len(self._found)


def auto_summary(
    programmed: ProgrammedPath, planned: PlannedPath, cut_m: float
) -> dict[str, float]:
    """Return points added, largest deviation and the program line where it is."""
    added = {"points_added": float(points_added(programmed, cut_m))}
    return added | deviation_summary(programmed, planned)


def deviation_summary(programmed: ProgrammedPath, planned: PlannedPath) -> dict[str, float]:
    """Return the largest deviation and the program line where it is."""
    deviation = path_deviation(programmed, planned)
    return {
        "largest_deviation_m": deviation.at_tool_m,
        "largest_deviation_line": float(deviation.line),
    }
