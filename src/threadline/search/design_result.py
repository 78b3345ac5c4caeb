"""What a search for the smallest change brings: machines that were tried, and the one proved."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from threadline.jobs.operations import Job
from threadline.machine import Machine
from threadline.search.design_region import Region
from threadline.search.design_space import Space
from threadline.verdict import Spec, Verdict


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
        Worst measured over limit: over the tolerances if they were asked for, and without.
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
        Of the machine as drawn and, where they were asked for, of all corners: the worst counts.
    proofs
        How many machines were proved.
    """

    candidate: Candidate
    machine: Machine
    spec: Spec
    numbers: Mapping[str, float]
    verdict: Verdict
    proofs: int


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
    tolerances
        Whether the design was asked to hold at all corners of the tolerances.
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
    tolerances: bool
    refused: tuple[str, ...]
