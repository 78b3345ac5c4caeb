"""Candidates of a redesign, and the candidate that the whole pipeline proves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.commands.plan import Plan
from threadline.errors import MachineError, PlanError
from threadline.machine import Machine
from threadline.machine.numbers import with_numbers
from threadline.proof.kinds import kind_of
from threadline.proof.kinds.variants import with_machine_hash
from threadline.proof.pipeline import Trials, plan_job, simulate, try_plan
from threadline.search.design_evaluate import Evaluator, Tried
from threadline.search.design_front import redesigned
from threadline.search.design_search import pareto
from threadline.search.design_space import Space
from threadline.verdict import Spec, Verdict
from threadline.verdict.judge import Judge

_MOST_PROOFS = 12
_DELAYED = (
    "stitch_length_error",
    "stitch_speed_error",
    "stitch_placement_error",
    "seam_error",
)
_DIGITS = 3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Candidate:
    """A machine that was tried.

    Parameters
    ----------
    factors
        Factor of each parameter, by name.
    cost
        Weighted sum of |ln factor|.
    ratio, nominal
        Worst ratio of measured to limit: over all runs of the candidate, and in one run.
    binding
        Criterion that uses the largest share of its limit.
    crossover_hz, phase_margin_deg
        Crossover and phase margin that the filters were designed for; None without designed
        filters.
    acceleration
        Share of the machine's acceleration that is used.
    smoothing_s
        Width of the feed-forward smoothing; None without feed-forward.
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
class ProvedDesign:
    """A design that was proved by the whole pipeline.

    Parameters
    ----------
    candidate
        The candidate as it was proved.
    machine, spec
        Machine with the numbers of the design; specification with its needle delay.
    numbers
        Numbers that differ from the original machine: path to SI value.
    verdict
        Verdict on the machine, at the requested level.
    corners
        Verdict over one run of each machine at the corners of the parameter tolerances; None where
        corners were not asked for, or the machine itself is out of specification.
    """

    candidate: Candidate
    machine: Machine
    spec: Spec
    numbers: Mapping[str, float]
    verdict: Verdict
    corners: Verdict | None

    @property
    def passed(self) -> bool:
        """Whether the machine, and every wanted corner, is in specification."""
        return self.verdict.passed and (self.corners is None or self.corners.passed)


def cheapest_first(space: Space, tried: Tried) -> IntArray:
    """Return the candidates in spec, the cheapest first; at equal cost, the most margin first.

    Settings cost nothing: where settings alone are enough, many candidates cost the same.
    """
    in_spec = np.flatnonzero(tried.ratio <= 1.0)
    return np.asarray(
        in_spec[np.lexsort((tried.ratio[in_spec], space.cost(tried.points[in_spec])))]
    )


def candidate_at(space: Space, evaluator: Evaluator, tried: Tried, index: int) -> Candidate:
    """Return a tried candidate with the names and units of its machine."""
    point, level = tried.points[index], int(tried.level[index])
    gains = space.designs_gains
    return Candidate(
        factors=dict(zip(space.names, np.exp(point[: space.parameters]).tolist(), strict=True)),
        cost=float(space.cost(point[None])[0]),
        ratio=float(tried.ratio[index]),
        nominal=float(tried.nominal[index]),
        binding=tried.binding[index],
        crossover_hz=float(np.exp(point[-2])) if gains else None,
        phase_margin_deg=float(point[-1]) if gains else None,
        acceleration=space.share(point, level),
        smoothing_s=space.smoothing_s(point),
        delay_s=evaluator.delay_s(level, int(tried.delay[index])),
    )


def proved(
    space: Space, evaluator: Evaluator, tried: Tried, spec: Spec, trials: Trials, corners: bool
) -> tuple[ProvedDesign | None, tuple[str, ...]]:
    """Return the cheapest candidate that the whole pipeline proves, and why others were refused."""
    refused: list[str] = []
    order = cheapest_first(space, tried)
    if trials.machines or trials != trials.without_others:
        # Many candidates cost nearly the same. If one of them fails, the others fail by a similar
        # amount.
        order = pareto(space, tried, 1.0 + 1e-9)
        # The tried candidates are spread evenly from the cheapest to the one with the largest
        # margin.
        proof_count = min(len(order), _MOST_PROOFS)
        order = order[np.linspace(0, len(order) - 1, proof_count).round().astype(int)]
    for index in order[:_MOST_PROOFS]:
        exact_point = tried.points[index]
        for point in (_rounded(space, exact_point), exact_point):
            retried = evaluator.tried(point[None], tried.level[index : index + 1])
            if retried.ratio[0] > 1.0:
                continue
            candidate = candidate_at(space, evaluator, retried, 0)
            try:
                proved_design = _prove(space, evaluator, point, candidate, spec, trials, corners)
            except PlanError as error:
                refused.append(error.message)
                continue
            if proved_design.passed:
                return proved_design, tuple(refused)
            failed_verdict = (
                proved_design.verdict if proved_design.corners is None else proved_design.corners
            )
            worst_result = max(failed_verdict.results, key=lambda r: r.severity)
            refused.append(f"{worst_result.name} {worst_result.axis}".strip())
    return None, tuple(refused)


def _rounded(space: Space, point: FloatArray) -> FloatArray:
    """Return the point with three digits of the factors and of the settings."""
    rounded = point.copy()
    count = space.parameters
    settings = space.designs_gains or space.ahead
    log_indices = [*range(count), *([count] if settings else [])]
    for k in log_indices:
        rounded[k] = np.log(float(f"{np.exp(point[k]):.{_DIGITS}g}"))
    if settings:
        rounded[-1] = float(f"{point[-1]:.{_DIGITS}g}")
    return np.clip(rounded, space.low, space.high)


def _prove(
    space: Space,
    evaluator: Evaluator,
    point: FloatArray,
    candidate: Candidate,
    spec: Spec,
    trials: Trials,
    corners: bool,
) -> ProvedDesign:
    """Prove one candidate by the whole pipeline, and its corners if they are wanted.

    Raises
    ------
    PlanError
        If a loop is unstable, or no commands can be made for the machine.
    """
    machine, numbers = redesigned(space, evaluator, point, candidate.acceleration)
    delayed = with_delay(spec, candidate.delay_s)
    kind_of(machine).check(machine)
    plan = plan_job(evaluator.read(machine), machine, evaluator.options_at(point))
    try:
        verdict = try_plan(plan, delayed, trials).verdict
        at_corners = None
        if corners and verdict.passed:
            at_corners = _at_corners(space, plan, machine, delayed, point)
    except MachineError as error:
        raise PlanError(error.message) from error
    return ProvedDesign(
        candidate=candidate,
        machine=machine,
        spec=delayed,
        numbers=numbers,
        verdict=verdict,
        corners=at_corners,
    )


def _at_corners(space: Space, plan: Plan, built: Machine, spec: Spec, point: FloatArray) -> Verdict:
    """Judge one run of each machine at the corners of the parameter tolerances."""
    recordings = []
    for corner in space.corners(point[None]):
        corner_numbers = {k: float(v[0]) for k, v in space.numbers(corner[None]).items()}
        machine = with_numbers(built, corner_numbers)
        kind_of(machine).check(machine)
        recordings.append(simulate(with_machine_hash(plan.commands, machine), machine))
    return Judge(plan, spec).verdict(recordings[:1], recordings[1:])


def with_delay(spec: Spec, delay_s: float | None) -> Spec:
    """Return ``spec`` with another needle delay."""
    if delay_s is None:
        return spec
    return replace(
        spec,
        criteria=tuple(
            replace(c, options={**c.options, "delay": delay_s}) if c.name in _DELAYED else c
            for c in spec.criteria
        ),
    )
