"""How the fastest speed falls when the machine is not what the plan believes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from threadline.errors import OptionError
from threadline.jobs.operations import Job
from threadline.machine import Machine
from threadline.machine.vary import off_tolerance
from threadline.options import Options
from threadline.pipeline import Progress
from threadline.search.fastest import Fastest
from threadline.search.feed import fastest_feed
from threadline.search.needle import fastest_needle
from threadline.verdict import Spec

ENDS = (-1.0, 0.0, 1.0)
"""Lower end of the tolerance, the file's own value, upper end."""
_POINTS = 12
_SLOWEST = 0.25  # of the highest speed of the search
_EDGE = 5e-3


@dataclass(frozen=True, slots=True, kw_only=True)
class Mismatch:
    """What a search found on one of the machines.

    Parameters
    ----------
    mass, stiffness
        Of loads and links, in parts of their tolerances.
    found
        Feeds or needle speeds in specification, with plans made for the machine as its file says.
    """

    mass: float
    stiffness: float
    found: Fastest


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
    edges to half a percent.

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

    def search(actual: Machine) -> Fastest:
        return fastest_needle(
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
) -> list[Mismatch]:
    """Return the feeds in spec at the ends of the tolerances, as ``needle_over_tolerances`` does.

    Parameters
    ----------
    low, high
        Feeds to search between, m/s of the fastest axis; ``low`` is a quarter of ``high`` when
        None.

    Raises
    ------
    OptionError
        If no number has a tolerance.
    """

    def search(actual: Machine) -> Fastest:
        return fastest_feed(
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
        )

    return _over_tolerances(search, machine, progress)


def _over_tolerances(
    search: Callable[[Machine], Fastest], machine: Machine, progress: Progress | None
) -> list[Mismatch]:
    if off_tolerance(machine, mass=1.0, stiffness=1.0) == machine:
        raise OptionError(
            f"loads and links of {machine.name} have no tolerances",
            remedy='Write them in the machine file: "111 kg +- 10 %".',
        )
    found = []
    cells = [(mass, stiffness) for mass in ENDS for stiffness in ENDS]
    for number, (mass, stiffness) in enumerate(cells):
        if progress is not None:
            progress("searching over tolerances", number / len(cells))
        actual = off_tolerance(machine, mass=mass, stiffness=stiffness)
        found.append(Mismatch(mass=mass, stiffness=stiffness, found=search(actual)))
    return found
