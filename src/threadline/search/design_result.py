"""What a search for the smallest change brings: machines that were tried, and the one proved."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from threadline.jobs.operations import Job
from threadline.machine import Machine
from threadline.search.design_region import Region
from threadline.search.design_space import Space
from threadline.verdict import Spec, Verdict
from threadline.verdict.types import Level


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Candidate:
    """A machine that was tried.

    Parameters
    ----------
    factors
        By parameter.
    cost
        Weighted sum of |ln factor|.
    ratio, nominal
        Worst measured over limit: of all the runs that it was tried in, and of one.
    binding
        The criterion that uses most of its limit.
    crossover_hz, phase_margin_deg
        What its filters were designed for; None where they weren't.
    acceleration
        Share of the machine's acceleration.
    smoothing_s
        Of feed-forward; None without it.
    delay_s
        Needle delay; None without stitches.
    """

    factors: Mapping[str, float]
    cost: float
    ratio: float
    nominal: float
    binding: str
    crossover_hz: float | None
    phase_margin_deg: float | None
    acceleration: float
    smoothing_s: float | None
    delay_s: float | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Found:
    """A design that was proved by the whole pipeline.

    Parameters
    ----------
    candidate
        As it was proved.
    machine, spec
        With the numbers of the design and its needle delay.
    numbers
        Those that differ from the machine as it was: path to SI value.
    verdict
        Of the machine, at the level that was asked for.
    corners
        Of one run of each machine at the corners of the tolerances of the parameters; None where
        they were not asked for, or the machine itself is out of specification.
    """

    candidate: Candidate
    machine: Machine
    spec: Spec
    numbers: Mapping[str, float]
    verdict: Verdict
    corners: Verdict | None

    @property
    def passed(self) -> bool:
        """Whether the machine is in specification, and every corner that was asked for."""
        return self.verdict.passed and (self.corners is None or self.corners.passed)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DesignResult:
    """What a search for the smallest change brought.

    Parameters
    ----------
    machine, job
        As they were.
    found
        None where no change within the bounds meets the specification.
    pareto
        Cost against margin, the cheapest first.
    known
        The best settings of each known answer, by its title.
    as_built
        The machine as it is, with the best settings.
    region
        What is in spec around the design, in two of its parameters; None with fewer than two.
    nearest
        The candidate that came nearest to the specification.
    simulated
        Machines simulated in the search.
    level
        At which the design was asked for.
    screened
        The runs of which ``Candidate.ratio`` is the worst, in words.
    refused
        Why candidates that the search took for good were not, when they were proved.
    """

    machine: Machine
    job: Job
    space: Space
    found: Found | None
    pareto: tuple[Candidate, ...]
    known: Mapping[str, Candidate]
    as_built: Candidate
    region: Region | None
    nearest: Candidate
    simulated: int
    level: Level
    screened: str
    refused: tuple[str, ...]
