"""The searches of one redesign, each with its own random numbers; the best result of all counts.

A search depends on its number alone, so that searches of one redesign may be made anywhere.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from threadline.base.progress import Progress
from threadline.search.design_evaluate import Evaluator, Tried
from threadline.search.design_front import MOST_TRIED, CandidateYield, spread, yield_of
from threadline.search.design_proof import candidate_at, with_delay
from threadline.search.design_search import SEED, TARGETS, first_sample, least_change, pareto
from threadline.search.design_space import Space
from threadline.verdict import Spec

MOST_SEARCHES = 10_000
_APART = 100  # difference of the seeds of two searches; a search uses one seed for each level
_LEAST_TRIED = 2  # least number of candidates of a search whose yield is drawn


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Search:
    """One search.

    Parameters
    ----------
    number
        From 0.
    tried
        All its candidates.
    yields
        Yields of candidates that trade cost for margin, if they are wanted.
    simulated
        Number of machines that it simulated.
    """

    number: int
    tried: Tried
    yields: tuple[CandidateYield, ...]
    simulated: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Searching:
    """The common data of all searches of a redesign, and the function that makes them.

    Parameters
    ----------
    space, evaluator, spec
        The space of the candidates, their judge, and the specification.
    front
        Number of machines to draw of each candidate for the front of cost against yield.
    searches
        Number of all searches.
    """

    space: Space
    evaluator: Evaluator
    spec: Spec
    front: int
    searches: int

    def made(self, numbers: Sequence[int], progress: Progress | None = None) -> list[Search]:
        """Return the searches with these numbers."""
        searches = []
        for search_index, number in enumerate(numbers):
            low, high = search_index / len(numbers), (search_index + 1) / len(numbers)
            searches.append(self._one(number, within_progress(progress, low, high)))
        return searches

    def _one(self, number: int, progress: Progress | None) -> Search:
        space, evaluator, seed = self.space, self.evaluator, SEED + _APART * number
        simulated_before, search_share = evaluator.simulated, 0.85 if self.front else 1.0

        def report(what: str, low: float, high: float) -> Callable[[float], None]:
            def report_fraction(fraction: float) -> None:
                if progress is not None:
                    progress(what, search_share * (low + (high - low) * fraction))

            return report_fraction

        tried = first_sample(space, evaluator, report("sampling", 0.0, 0.33), seed)
        tried = least_change(space, evaluator, tried, report("narrowing", 0.33, 0.73), seed=seed)
        for target_index, target in enumerate(TARGETS):
            begin, step = 0.73 + 0.27 * target_index / len(TARGETS), 0.27 / len(TARGETS)
            step_report = report("trading cost for margin", begin, begin + step)
            tried = least_change(space, evaluator, tried, step_report, target=target, seed=seed)
        simulated = evaluator.simulated - simulated_before
        step_report = report("drawing machines of each candidate", 1.0, 1.0 / search_share)
        yields = self._yields(tried, step_report) if self.front else ()
        return Search(number=number, tried=tried, yields=yields, simulated=simulated)

    def _yields(
        self, tried: Tried, step_report: Callable[[float], None]
    ) -> tuple[CandidateYield, ...]:
        """Return the yields of candidates that trade cost for margin, and of the machine as is."""
        space, evaluator = self.space, self.evaluator
        front = pareto(space, tried, most_ratio(evaluator))
        unchanged = np.abs(tried.points[:, : space.parameters]).max(axis=1) < 1e-9
        as_built = np.flatnonzero(unchanged)
        best = as_built[np.argsort(tried.ratio[as_built], kind="stable")][:1]
        candidate_count = max(MOST_TRIED // self.searches, _LEAST_TRIED)
        spread_front = front[spread(len(front), candidate_count)] if len(front) else front
        chosen = np.unique(np.concatenate([best, spread_front]))
        yields = []
        for candidate_index, index in enumerate(chosen.tolist()):
            candidate = candidate_at(space, evaluator, tried, index)
            delayed = with_delay(self.spec, candidate.delay_s)
            acceleration = candidate.acceleration
            yields.append(
                yield_of(space, evaluator, tried.points[index], acceleration, delayed, self.front)
            )
            step_report((candidate_index + 1) / len(chosen))
        return tuple(one for one in yields if one is not None)


def most_ratio(evaluator: Evaluator) -> float:
    """Return the largest ratio of candidates that trade cost for margin.

    Candidates with a larger ratio were not tried in further runs.
    """
    return 1.0 + 1e-9 if evaluator.others.asked else 1.5


def pooled(searches: Sequence[Search]) -> Tried:
    """Return the candidates of all searches, in their order."""
    candidates = searches[0].tried
    for search in searches[1:]:
        candidates = candidates.join(search.tried)
    return candidates


def within_progress(progress: Progress | None, low: float, high: float) -> Progress | None:
    """Return a progress whose shares count between two shares of ``progress``."""
    if progress is None:
        return None
    return lambda what, share: progress(what, low + (high - low) * share)
