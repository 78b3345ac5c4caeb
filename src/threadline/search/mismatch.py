"""The loss of speed on machines that differ from the machine of the plan."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from threadline.errors import OptionError
from threadline.machine.vary import off_tolerance
from threadline.proof.pipeline import NOMINAL
from threadline.search.feed_ranges import Interval
from threadline.search.paced import Question

ENDS = (-1.0, 0.0, 1.0)
"""Deviations in parts of the tolerance: the lower end, the file's own value, the upper end."""
_SLOWEST = 0.25  # lowest speed of a search, as a share of the highest
_ABOVE = 1.1  # highest speed of a search, as a share of the nominal best


@dataclass(frozen=True, slots=True, kw_only=True)
class Searched:
    """The searched quantity, in the words of its tables and pictures.

    Parameters
    ----------
    name
        Name of the quantity, a noun for sentences such as "no needle speed is in spec".
    best
        Adjective of the best value.
    unit, per_unit
        Printed unit, and the factor to it.
    done
        Participle for the work of the machines.
    nothing
        Value drawn in the figure if nothing is in spec: 0 for a speed; NaN, which is not drawn, for
        a cycle.
    """

    name: str
    best: str
    unit: str
    per_unit: float
    done: str
    nothing: float = 0.0


NEEDLE = Searched(name="needle speed", best="fastest", unit="stitch/s", per_unit=1.0, done="sewn")
FEED = Searched(name="feed", best="fastest", unit="mm/s", per_unit=1e3, done="done")
F_WORDS = Searched(
    name="F", best="fastest", unit="mm/min by its rule", per_unit=60_000.0, done="done"
)
OVERRIDE = Searched(
    name="feed override", best="fastest", unit="% of the feeds", per_unit=100.0, done="done"
)
SHAFT = Searched(
    name="speed of the shaft", best="fastest", unit="stitch/min", per_unit=60.0, done="sewn"
)
CYCLE = Searched(
    name="cycle", best="shortest", unit="s", per_unit=1.0, done="done", nothing=math.nan
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Mismatch:
    """Result of a search on one of the machines, with plans made for the file's machine.

    Parameters
    ----------
    mass, stiffness
        Deviations of loads and of springs, in parts of their tolerances.
    best
        The highest speed in spec, or the shortest cycle in s; None where nothing is in spec.
    intervals
        All speeds in spec, the fastest first.
    limited_by
        As in ``Fastest``.
    """

    mass: float
    stiffness: float
    best: float | None
    intervals: tuple[Interval, ...]
    limited_by: str


BestPace = tuple[float | None, Sequence[Interval], str]
"""The best pace, all intervals in spec, the fastest first, and the limiting criterion."""


def at_tolerance_ends(
    question: Question, again: Callable[[Question], BestPace]
) -> tuple[Mismatch, ...]:
    """Return the results of a search on machines at the ends of the tolerances, one run each.

    Plans are made for the machine of the file. The machine that runs them has other numbers, like a
    real machine.

    Parameters
    ----------
    again
        Searches with the machine that runs the plans, with a coarser scan than for the answer
        itself.

    Raises
    ------
    OptionError
        If no number of a load or a spring has a tolerance.
    """
    machine = question.machine
    if off_tolerance(machine, mass=1.0, stiffness=1.0) == machine:
        raise OptionError(
            f"loads and springs of {machine.name} have no tolerances",
            remedy='Write them in the machine file: "111 kg +- 10 %".',
        )
    question = replace(question, trials=NOMINAL, until=None)
    mismatches = []
    deviations = [(mass, stiffness) for mass in ENDS for stiffness in ENDS]
    for number, (mass, stiffness) in enumerate(deviations):
        if question.progress is not None:
            question.progress("searching off the tolerances", number / len(deviations))
        actual = off_tolerance(machine, mass=mass, stiffness=stiffness)
        best, intervals, limited_by = again(replace(question, actual=actual, progress=None))
        mismatches.append(
            Mismatch(
                mass=mass,
                stiffness=stiffness,
                best=best,
                intervals=tuple(intervals),
                limited_by=limited_by,
            )
        )
    return tuple(mismatches)


def near_best(question: Question, best: float | None, top: float) -> Question:
    """Return a question about paces near the best; near ``top`` where there is no best.

    Other machines are rarely faster.
    """
    high = question.high if question.high is not None else top if best is None else best * _ABOVE
    return replace(
        question, low=_SLOWEST * high if question.low is None else question.low, high=high
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Certainty:
    """The fastest plan for all machines at the ends of the tolerances, and for the file's alone.

    Parameters
    ----------
    machines
        Number of machines that the plan must pass on, with the file's machine.
    sure, alone
        Best speeds, or durations in s, of both searches; None where nothing is in specification.
    unit
        Unit of both results.
    share
        Relative loss of speed, or growth of duration; None where one search has no best.
    """

    machines: int
    sure: float | None
    alone: float | None
    unit: str
    share: float | None
