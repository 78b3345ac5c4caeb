"""What a search for the fastest plan of a job tells: every plan that it proved, and the best."""

from __future__ import annotations

from dataclasses import dataclass

from threadline.search.fastest import Fastest


@dataclass(frozen=True, slots=True, kw_only=True)
class Rung:
    """The best at one share of the limits; ``duration_s`` is None where no feed passes.

    Parameters
    ----------
    contour_m
        How far the loads were allowed from their path; None where that is no limit of the timing.
    """

    share: float
    found: Fastest
    duration_s: float | None
    contour_m: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Bound:
    """The least time along the path of the best within some of its limits alone."""

    within: str
    duration_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class FastestJob:
    """What was found: the rung with the shortest job, and all that were tried, by share.

    Parameters
    ----------
    bounds
        Of a motion that is the fastest by its plan: what it could not be faster than.
    """

    best: Rung
    rungs: tuple[Rung, ...]
    bounds: tuple[Bound, ...] = ()
