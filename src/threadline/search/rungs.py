"""What a search for the fastest plan of a job tells: every plan that it proved, and the best."""

from __future__ import annotations

from dataclasses import dataclass

from threadline.jobs.operations import FeedMode
from threadline.search.fastest import Fastest


@dataclass(frozen=True, slots=True, kw_only=True)
class Rung:
    """The fastest plan at one share of the limits, or with one contour allowance.

    Parameters
    ----------
    share
        Share of the machine's acceleration and jerk limits that was used.
    found
        The feeds in spec.
    duration_s
        Duration of the job at the best of them; None where no feed passes.
    contour_m
        How far the loads were allowed to leave the path; None where the timing has no such limit.
    """

    share: float
    found: Fastest
    duration_s: float | None
    contour_m: float | None = None

    @property
    def alone(self) -> bool:
        """Whether its neighbours are out of specification."""
        return self.found.fastest is not None and self.found.fastest.alone


@dataclass(frozen=True, slots=True, kw_only=True)
class Bound:
    """A lower bound on the time along a path.

    Parameters
    ----------
    within
        Whose limits alone it keeps: ``"the axes"``, or ``"axes and drives"``.
    duration_s
        The least time within them.
    """

    within: str
    duration_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class FastestJob:
    """What was found: the rung with the shortest job, and all that were tried, by share.

    Parameters
    ----------
    bounds
        With ``optimal``: lower bounds on the time of the best plan; otherwise empty.
    left_out
        Shares of the limits that were not searched, because even at the highest feed the job takes
        no less time with them than with the best.
    moves, judged_moves, parts
        How many moves the job has, and how many of them in how many distinct stretches every try
        was judged by; 0 where it was judged by all of them.
    cut
        Whether tries were judged without the middles of moves that last long.
    whole
        Whether the best plan of the whole job was judged, too, where tries were judged by less.
    ended
        Why the search stopped before its end; empty where it did not.
    by
        What its feeds are of.
    """

    best: Rung
    rungs: tuple[Rung, ...]
    bounds: tuple[Bound, ...] = ()
    left_out: tuple[float, ...] = ()
    moves: int = 0
    judged_moves: int = 0
    parts: int = 0
    cut: bool = False
    whole: bool = True
    ended: str = ""
    by: FeedMode = FeedMode.FASTEST_AXIS
