"""What a planner reports of its path, worked out when somebody asks."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import cached_property
from typing import ParamSpec

from threadline.path.auto import points_added
from threadline.path.deviation import path_deviation
from threadline.path.types import PlannedPath, ProgrammedPath

P = ParamSpec("P")


class LazySummary(Mapping[str, float]):
    """A mapping that reads its paths at the first look at it, and once only.

    Parameters
    ----------
    work
        A function that its module names, and what it is called with: like a stream, a summary
        can be sent to another process.
    """

    def __init__(
        self, work: Callable[P, Mapping[str, float]], *arguments: P.args, **keywords: P.kwargs
    ) -> None:
        self._work, self._arguments, self._keywords = work, arguments, keywords

    @cached_property
    def _found(self) -> Mapping[str, float]:
        return self._work(*self._arguments, **self._keywords)

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
