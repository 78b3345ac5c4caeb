"""What certainty costs: a search over the ends of the tolerances beside one without them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from threadline.cli.fastest_asked import Asked
from threadline.cli.found import typed
from threadline.machine.vary import ends_of
from threadline.options import Options
from threadline.pipeline import Trials

Search = Callable[[Options, Trials], tuple[float | None, float | None]]
"""Searches with options and trials; returns the best speed and how long the job takes at it, s,
each None where there is none or it is not known."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Certainty:
    """The fastest on all machines at the ends of the tolerances, and that of the file's alone.

    Parameters
    ----------
    machines
        How many the plan is for, that of the file among them.
    sure, alone
        Best speeds, or durations in s, of both searches; None where none is in specification.
    unit
        Of both.
    share
        By how much the speed falls, or the duration grows; None where one of them has no best.
    """

    machines: int
    sure: float | None
    alone: float | None
    unit: str
    share: float | None

    def line(self) -> str:
        """Say it for people."""
        both = [
            "none" if best is None else f"{typed(best)} {self.unit}"
            for best in (self.sure, self.alone)
        ]
        change = "" if self.share is None else f": {abs(self.share):.1%} slower"
        return (
            f"what certainty costs: {both[0]} on all {self.machines} machines, {both[1]} planned "
            f"and judged for the machine as its file says{change}"
        )

    def json(self) -> dict[str, Any]:
        """Return it as JSON content."""
        return {
            "certainty": {
                "machines": self.machines,
                "best": self.sure,
                "alone": self.alone,
                "unit": self.unit,
                "slower": self.share,
            }
        }


def certainty_of(
    asked: Asked, found: tuple[float | None, float | None], unit: str, search: Search
) -> Certainty | None:
    """Search once more for the machine of the file alone; None where no ends were asked for.

    Parameters
    ----------
    found
        Best speed and duration of the search over the ends.
    unit
        Of the speed; where durations are known they are compared, in s.
    """
    if asked.trials.ends is None:
        return None
    options = asked.options
    if options.robust_share is not None:
        options = replace(options, robust_share=0.0)
    alone = search(options, replace(asked.trials, ends=None))
    timed = found[1] is not None or alone[1] is not None
    sure, best = (found[1], alone[1]) if timed else (found[0], alone[0])
    share = None
    if sure is not None and best is not None:
        share = sure / best - 1.0 if timed else 1.0 - sure / best
    machine = asked.machine if asked.actual is None else asked.actual
    return Certainty(
        machines=1 + len(ends_of(machine, asked.trials.ends)),
        sure=sure,
        alone=best,
        unit="s" if timed else unit,
        share=share,
    )
