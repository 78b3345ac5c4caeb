"""How the fastest speed falls when the machine is not what the plan believes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from threadline.base.progress import Progress
from threadline.errors import OptionError
from threadline.jobs.operations import FeedMode, Job
from threadline.machine import Machine
from threadline.machine.vary import off_tolerance
from threadline.proof.options import Options
from threadline.search.cycle import fastest_cycle
from threadline.search.fastest import Fastest
from threadline.search.feed import fastest_feed, fastest_needle
from threadline.search.forbidden import Interval
from threadline.search.shaft import constant_speeds, speed_range_hz
from threadline.verdict import Spec

ENDS = (-1.0, 0.0, 1.0)
"""Lower end of the tolerance, the file's own value, upper end."""
_POINTS = 12
_SLOWEST = 0.25  # of the highest speed of the search
_EDGE = 5e-3


@dataclass(frozen=True, slots=True, kw_only=True)
class Searched:
    """What a search over tolerances varies, in the words of its tables and pictures.

    Parameters
    ----------
    name
        What is searched, as a noun: "no needle speed is in spec".
    best
        The adjective of the best one.
    unit, per_unit
        In which it is printed, and what the searched number is multiplied by for that.
    done
        What the machines do with the job.
    nothing
        What is drawn where nothing is in spec: no speed is a speed of 0, no cycle is none at all.
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
    """What a search found on one of the machines, with plans made for what the file says.

    Parameters
    ----------
    mass, stiffness
        Of loads and springs, in parts of their tolerances.
    best
        The highest speed in spec, or the shortest cycle in s; None where none is.
    intervals
        All speeds in spec, the fastest first.
    limited_by
        As ``Fastest`` has it.
    """

    mass: float
    stiffness: float
    best: float | None
    intervals: tuple[Interval, ...]
    limited_by: str


_Found = tuple[float | None, tuple[Interval, ...], str]


def needle_over_tolerances(
    seam: Path,
    machine: Machine,
    spec: Spec,
    options: Options,
    *,
    low: float | None = None,
    high: float,
    progress: Progress | None = None,
) -> list[Mismatch]:
    """Return the needle speeds in spec at the ends of the tolerances of masses and stiffnesses.

    Plans are those for ``machine`` as it is in its file; what sews them has other numbers, as a
    real machine has. The speeds are scanned more coarsely than by ``fastest_needle``: 12 of them,
    edges to half a percent, each judged by one run.

    Parameters
    ----------
    low, high
        Needle speeds to search between, in stitches a second; ``low`` is a quarter of ``high``
        when None.

    Raises
    ------
    OptionError
        If no number has a tolerance, or the range is empty.
    """

    def search(actual: Machine) -> _Found:
        return _speeds(
            fastest_needle(
                seam,
                machine,
                spec,
                options,
                low=_SLOWEST * high if low is None else low,
                high=high,
                points=_POINTS,
                near=0,
                edge_relative=_EDGE,
                actual=actual,
            )
        )

    return _over_tolerances(search, machine, progress)


def feed_over_tolerances(
    job: Job,
    machine: Machine,
    spec: Spec,
    options: Options,
    *,
    low: float | None = None,
    high: float,
    progress: Progress | None = None,
    by: FeedMode = FeedMode.FASTEST_AXIS,
) -> list[Mismatch]:
    """Return the feeds in spec at the ends of the tolerances, as ``needle_over_tolerances`` does.

    Parameters
    ----------
    low, high
        Feeds to search between, m/s of what ``by`` says; ``low`` is a quarter of ``high`` when
        None.
    by
        As ``fastest_feed`` takes it.

    Raises
    ------
    OptionError
        If no number has a tolerance.
    """

    def search(actual: Machine) -> _Found:
        return _speeds(
            fastest_feed(
                job,
                machine,
                spec,
                options,
                low=_SLOWEST * high if low is None else low,
                high=high,
                points=_POINTS,
                near=0,
                edge_relative=_EDGE,
                actual=actual,
                by=by,
            )
        )

    return _over_tolerances(search, machine, progress)


def shaft_over_tolerances(
    job: Job,
    machine: Machine,
    spec: Spec,
    options: Options,
    *,
    low: float | None = None,
    high: float | None = None,
    progress: Progress | None = None,
) -> list[Mismatch]:
    """Return the constant speeds of the shaft in spec, as ``needle_over_tolerances`` does.

    Parameters
    ----------
    low, high
        Speeds to search between, in stitches a second; ``high`` is that of the machine when None,
        and ``low`` a quarter of it.

    Raises
    ------
    OptionError
        If no number has a tolerance.
    """
    end = speed_range_hz(machine)[1] if high is None else high

    def search(actual: Machine) -> _Found:
        return _speeds(
            constant_speeds(
                job,
                machine,
                spec,
                options,
                low=_SLOWEST * end if low is None else low,
                high=end,
                points=_POINTS,
                near=0,
                actual=actual,
            )
        )

    return _over_tolerances(search, machine, progress)


def cycle_over_tolerances(
    job: Job, machine: Machine, spec: Spec, *, progress: Progress | None = None
) -> list[Mismatch]:
    """Return the shortest cycle in spec at the ends of the tolerances.

    The commands that a cycle is made of are shapers and switchings for the modes that ``machine``
    has in its file; which of them are chosen, and the waits, is found on a machine with other
    masses and stiffnesses. One run judges each.

    Raises
    ------
    OptionError
        If no number has a tolerance, or several cylinders move at once.
    """

    def search(actual: Machine) -> _Found:
        found = fastest_cycle(job, machine, spec, actual=actual)
        best = found.cycle_s
        return best, () if best is None else (Interval(low=best, high=best),), found.limited_by

    return _over_tolerances(search, machine, progress)


def _speeds(found: Fastest) -> _Found:
    return found.best, found.intervals, found.limited_by


def _over_tolerances(
    search: Callable[[Machine], _Found], machine: Machine, progress: Progress | None
) -> list[Mismatch]:
    if off_tolerance(machine, mass=1.0, stiffness=1.0) == machine:
        raise OptionError(
            f"loads and springs of {machine.name} have no tolerances",
            remedy='Write them in the machine file: "111 kg +- 10 %".',
        )
    cells = []
    places = [(mass, stiffness) for mass in ENDS for stiffness in ENDS]
    for number, (mass, stiffness) in enumerate(places):
        if progress is not None:
            progress("searching over tolerances", number / len(places))
        best, intervals, limited_by = search(off_tolerance(machine, mass=mass, stiffness=stiffness))
        cells.append(
            Mismatch(
                mass=mass,
                stiffness=stiffness,
                best=best,
                intervals=intervals,
                limited_by=limited_by,
            )
        )
    return cells
