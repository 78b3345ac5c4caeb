"""Search for the smallest change that meets a specification: tried machines and a proved one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.progress import Progress
from threadline.commands.plan import Plan
from threadline.errors import MachineError, PlanError
from threadline.jobs.operations import Job
from threadline.machine import Machine
from threadline.machine.model import check_dynamics
from threadline.machine.numbers import number_at, with_numbers
from threadline.proof.kinds import kind_of
from threadline.proof.kinds.variants import with_machine_hash
from threadline.proof.options import Options
from threadline.proof.pipeline import REPEATED, Trials, open_job, plan_job, simulate, try_plan
from threadline.search.design_evaluate import AHEAD, FEW, THOROUGH, Effort, Evaluator, Tried
from threadline.search.design_judge import OtherRuns
from threadline.search.design_search import (
    TARGETS,
    Region,
    first_sample,
    known_points,
    least_change,
    pareto,
    region_of,
    with_settings,
)
from threadline.search.design_space import Space, design_space
from threadline.verdict import Spec, Verdict
from threadline.verdict.judge import Judge
from threadline.verdict.types import Level


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
        """Whether the machine, and every corner that was asked for, is in specification."""
        return self.verdict.passed and (self.corners is None or self.corners.passed)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DesignResult:
    """Result of a search for the smallest change.

    Parameters
    ----------
    machine, job
        The original machine, and the job read for it.
    found
        The proved design; None where no change within the bounds meets the specification.
    pareto
        Candidates by cost against margin, the cheapest first.
    known
        The best settings of each known answer, by its title.
    as_built
        The original machine with the best settings.
    region
        Candidates in spec around the design, over two parameters; None with fewer than two.
    nearest
        The candidate that came nearest to the specification.
    simulated
        Number of machines simulated in the search.
    level
        Level at which the design was asked for.
    screened
        Runs over which ``Candidate.ratio`` is the worst, in words.
    refused
        Why the proof refused candidates that the search accepted.
    """

    machine: Machine
    job: Job
    space: Space
    found: ProvedDesign | None
    pareto: tuple[Candidate, ...]
    known: Mapping[str, Candidate]
    as_built: Candidate
    region: Region | None
    nearest: Candidate
    simulated: int
    level: Level
    screened: str
    refused: tuple[str, ...]


_MOST_PROOFS = 12
_DELAYED = (
    "stitch_length_error",
    "stitch_speed_error",
    "stitch_placement_error",
    "seam_error",
)
_DIGITS = 3
_RETRIED = 8  # settings of a known answer that are tried over the tolerances


@dataclass(frozen=True, slots=True, kw_only=True)
class Wanted:
    """Requirements on a design, and options of its search.

    Parameters
    ----------
    trials
        The runs that prove the design: its level. The search tries candidates in as many runs.
        Other machines within the file's tolerances, or a yield, are left to the proof: the proof
        tries candidates along the trade of cost for margin, and the cheapest that passes is the
        design.
    corners
        Whether the design must hold at every corner of the parameter tolerances, too.
    plotted
        Two parameters for the region; None: the two that cost most.
    smoothing_s
        Widths of the feed-forward smoothing, of which all from the least to the largest are
        searched: the commands then go through the exact inverse of each candidate, and no filters
        are designed for it. Empty for no feed-forward.
    effort
        Effort of the search; None: as much as the kind of machine allows.
    """

    trials: Trials = REPEATED
    corners: bool = False
    plotted: tuple[str, str] | None = None
    smoothing_s: tuple[float, ...] = ()
    effort: Effort | None = None


_BY_DEFAULT = Wanted()


def design(
    job_file: Path,
    machine: Machine,
    spec: Spec,
    options: Options,
    wanted: Wanted = _BY_DEFAULT,
    progress: Progress | None = None,
) -> DesignResult:
    """Search the smallest change to ``machine`` that brings a job into ``spec``.

    Raises
    ------
    MachineError, JobError, PlanError, OptionError
        If the input is wrong, or no commands can be made for the original machine.
    """
    trials, corners, smoothing_s = wanted.trials, wanted.corners, wanted.smoothing_s
    check_dynamics("what a change of its parts would do", machine)
    kind_of(machine).check_options(machine, options)
    space = design_space(machine, smoothing_s)

    def read(for_machine: Machine) -> Job:
        return open_job(job_file, for_machine, options)

    def report(what: str, low: float, high: float) -> Callable[[float], None]:
        def at(fraction: float) -> None:
            if progress is not None:
                progress(what, low + (high - low) * fraction)

        return at

    evaluator = Evaluator(
        space,
        read,
        spec,
        options,
        OtherRuns.of(space, trials, corners=corners),
        wanted.effort or (AHEAD if smoothing_s else FEW if space.alone else THOROUGH),
    )
    tried = first_sample(space, evaluator, report("sampling", 0.0, 0.25))
    tried = least_change(space, evaluator, tried, report("narrowing", 0.25, 0.55))
    for turn, target in enumerate(TARGETS):
        at = 0.55 + 0.2 * turn / len(TARGETS)
        step = report("trading cost for margin", at, at + 0.2 / len(TARGETS))
        tried = least_change(space, evaluator, tried, step, target=target)
    found, refused = _proved(space, evaluator, tried, spec, trials, corners)
    nearest = _nearest(space, tried)
    centre = tried.points[nearest] if found is None else _point(space, found)
    level = int(tried.level[nearest]) if found is None else _level(space, found.candidate)
    # Candidates beyond the limit were not tried in other runs.
    front = pareto(space, tried, 1.0 + 1e-9 if evaluator.others.asked else 1.5)
    used = np.abs(tried.points[front[tried.ratio[front] <= 1.0], : space.parameters])
    region = region_of(
        space,
        evaluator,
        centre,
        level,
        np.median(used, axis=0) * space.weights if len(used) else space.weights,
        wanted.plotted,
        report("drawing the region", 0.75, 1.0),
    )
    return DesignResult(
        machine=machine,
        job=read(machine),
        space=space,
        found=found,
        pareto=tuple(_candidate(space, evaluator, tried, i) for i in front.tolist()),
        known={
            name: _best_of(space, evaluator, tried, point)
            for name, point in known_points(space).items()
        },
        as_built=_best_of(space, evaluator, tried, np.zeros(space.parameters)),
        region=region,
        nearest=_candidate(space, evaluator, tried, nearest),
        simulated=evaluator.simulated,
        level=trials.level,
        screened=evaluator.others.words,
        refused=refused,
    )


def _nearest(space: Space, tried: Tried) -> int:
    """Return the cheapest candidate in spec, else the candidate with the least ratio."""
    good = _cheapest_first(space, tried)
    return int(good[0]) if len(good) else int(np.argmin(tried.ratio))


def _cheapest_first(space: Space, tried: Tried) -> IntArray:
    """Return the candidates in spec, the cheapest first; at equal cost, the most margin first.

    Settings cost nothing: where settings alone are enough, many candidates cost the same.
    """
    good = np.flatnonzero(tried.ratio <= 1.0)
    return np.asarray(good[np.lexsort((tried.ratio[good], space.cost(tried.points[good])))])


def _best_of(space: Space, evaluator: Evaluator, tried: Tried, parameters: FloatArray) -> Candidate:
    """Return the best tried candidate that has these parameters, with any settings."""
    same = np.abs(tried.points[:, : space.parameters] - parameters).max(axis=1) < 1e-9
    own = tried.taken(np.flatnonzero(same))
    if evaluator.others.asked:
        # The first sample skipped the other runs of expensive candidates that pass one run.
        points = with_settings(space, parameters, evaluator.effort.settings_log2)
        for level in range(len(space.levels)):
            levels = np.full(len(points), level, dtype=np.int64)
            own = own.join(evaluator.tried(points, levels, beyond=-1.0))
        best = np.argsort(own.nominal, kind="stable")[:_RETRIED]
        own = evaluator.tried(own.points[best], own.level[best], beyond=np.inf)
    return _candidate(space, evaluator, own, int(np.argmin(own.ratio)))


def _candidate(space: Space, evaluator: Evaluator, tried: Tried, index: int) -> Candidate:
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


def _point(space: Space, found: ProvedDesign) -> FloatArray:
    candidate = found.candidate
    settings = []
    if candidate.crossover_hz is not None and candidate.phase_margin_deg is not None:
        settings = [np.log(candidate.crossover_hz), candidate.phase_margin_deg]
    if candidate.smoothing_s is not None:
        settings = [np.log(candidate.smoothing_s), candidate.acceleration]
    return np.array([*(np.log(candidate.factors[n]) for n in space.names), *settings])


def _level(space: Space, candidate: Candidate) -> int:
    return 0 if space.ahead else space.levels.index(candidate.acceleration)


def _proved(
    space: Space, evaluator: Evaluator, tried: Tried, spec: Spec, trials: Trials, corners: bool
) -> tuple[ProvedDesign | None, tuple[str, ...]]:
    """Return the cheapest candidate that the whole pipeline proves, and why others were refused."""
    refused: list[str] = []
    order = _cheapest_first(space, tried)
    if trials.machines or trials != trials.alone:
        # Many candidates cost nearly the same; if one fails, all of them fail by about as much.
        order = pareto(space, tried, 1.0 + 1e-9)
        # Spread evenly, from the cheapest to the largest margin, which passes if any passes.
        most = min(len(order), _MOST_PROOFS)
        order = order[np.linspace(0, len(order) - 1, most).round().astype(int)]
    for index in order[:_MOST_PROOFS]:
        own = tried.points[index]
        for point in (_rounded(space, own), own):
            once = evaluator.tried(point[None], tried.level[index : index + 1])
            if once.ratio[0] > 1.0:
                continue
            candidate = _candidate(space, evaluator, once, 0)
            try:
                found = _prove(space, evaluator, point, candidate, spec, trials, corners)
            except PlanError as error:
                refused.append(error.message)
                continue
            if found.passed:
                return found, tuple(refused)
            of = found.verdict if found.corners is None else found.corners
            failed = max(of.results, key=lambda r: r.severity)
            refused.append(f"{failed.name} {failed.axis}".strip())
    return None, tuple(refused)


def _rounded(space: Space, point: FloatArray) -> FloatArray:
    """Return the point with three digits of the factors and of the settings."""
    rounded = point.copy()
    count = space.parameters
    settings = space.designs_gains or space.ahead
    logs = [*range(count), *([count] if settings else [])]
    for k in logs:
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
    """Prove one candidate by the whole pipeline, and its corners where they are asked for.

    Raises
    ------
    PlanError
        If a loop is unstable, or no commands can be made for the machine.
    """
    machine = space.machine
    gains = {k: float(v[0]) for k, v in evaluator.gains(point[None])[0].items()}
    numbers = {k: float(v[0]) for k, v in space.numbers(point[None]).items()}
    numbers = {k: v for k, v in numbers.items() if v != number_at(machine, k).si} | gains
    numbers |= space.slower(candidate.acceleration)
    redesigned = with_numbers(machine, numbers)
    asked = with_delay(spec, candidate.delay_s)
    kind_of(redesigned).check(redesigned)
    plan = plan_job(evaluator.read(redesigned), redesigned, evaluator.options_at(point))
    try:
        verdict = try_plan(plan, asked, trials).verdict
        at_corners = None
        if corners and verdict.passed:
            at_corners = _at_corners(space, plan, redesigned, asked, point)
    except MachineError as error:
        raise PlanError(error.message) from error
    return ProvedDesign(
        candidate=candidate,
        machine=redesigned,
        spec=asked,
        numbers=numbers,
        verdict=verdict,
        corners=at_corners,
    )


def _at_corners(
    space: Space, plan: Plan, redesigned: Machine, spec: Spec, point: FloatArray
) -> Verdict:
    """Judge one run of each machine at the corners of the parameter tolerances."""
    recordings = []
    for corner in space.corners(point[None]):
        off = {k: float(v[0]) for k, v in space.numbers(corner[None]).items()}
        machine = with_numbers(redesigned, off)
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
