"""Numbers that a planner reports of its path, computed when they are first read."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import cached_property
from typing import ParamSpec

from threadline.path.auto import points_added
from threadline.path.deviation import path_deviation
from threadline.path.polygon import CUBIC
from threadline.path.types import PlannedPath, ProgrammedPath

P = ParamSpec("P")


class LazySummary(Mapping[str, float]):
    """A mapping that is computed when it is first read.

    Parameters
    ----------
    work
        Function of a module, not nested in another, so that a summary can be pickled as a
        ``Stream`` can.
    arguments, keywords
        Arguments with which it is called.
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
    programmed: ProgrammedPath, planned: PlannedPath, cut_m: float, degree: int = CUBIC
) -> dict[str, float]:
    """Return the number of points added, the largest deviation in m and its program line."""
    added = {"points_added": float(points_added(programmed, cut_m, degree))}
    return added | deviation_summary(programmed, planned)


def deviation_summary(programmed: ProgrammedPath, planned: PlannedPath) -> dict[str, float]:
    """Return the largest deviation in m, and its program line."""
    deviation = path_deviation(programmed, planned)
    return {
        "largest_deviation_m": deviation.at_tool_m,
        "largest_deviation_line": float(deviation.line),
    }
