"""The fastest way to sew a design in spec: at one speed of the shaft, and with a speed per stitch.

What earlier stitches leave swinging may help or hurt, so that passing is not monotone in speed: the
speeds are scanned as feeds are. A schedule is made for a tolerance of the swing; the largest with
which its verdict passes gives the fastest.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from threadline.base.progress import Progress
from threadline.commands.plan import Plan
from threadline.jobs.operations import Feed, FeedMode, Job
from threadline.machine import Machine
from threadline.proof.option_words import parse_tolerance_m, tolerance_words
from threadline.proof.options import Options
from threadline.proof.pipeline import NOMINAL, Proof, Trials, check_machine, plan_job, try_plan
from threadline.search.fastest import Fastest, find_fastest
from threadline.search.until import Until, as_far_as
from threadline.verdict import Spec, Verdict

_POINTS, _NEAR = 24, 3
_EDGE = 5e-3
_RANGE = (0.5, 1.5)
"""Of the limit of the residual: tolerances between which a schedule is searched."""
_HALVINGS = 6
_OF_THE_SLOWEST = 0.5
_FAR = 0.8  # of a limit


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FastestShaft:
    """What was found.

    Parameters
    ----------
    constant
        Speeds of the shaft in spec, stitches a second.
    schedule
        The fastest with a speed for each stitch; None where the spindle cannot change its speed,
        or none is in spec.
    tolerance_m
        The tolerance of the residual with which that schedule was planned.
    duration_s
        The shorter time of schedule and constant speed; None where neither is in spec.
    constant_s
        Time at the highest constant speed in spec; None where there is none.
    verdict
        Verdict of the faster of the two.
    """

    constant: Fastest
    schedule: Proof | None
    tolerance_m: float
    duration_s: float | None
    constant_s: float | None
    verdict: Verdict

    @property
    def limited_by(self) -> str:
        """What limits the constant speed."""
        return self.constant.limited_by


def fastest_shaft(
    job: Job,
    machine: Machine,
    spec: Spec,
    options: Options,
    *,
    low: float | None = None,
    high: float | None = None,
    progress: Progress | None = None,
    actual: Machine | None = None,
    trials: Trials = NOMINAL,
    until: Until | None = None,
) -> FastestShaft:
    """Search the speeds of the shaft, and the schedule of speeds.

    Parameters
    ----------
    low, high
        Constant speeds to search between, stitches a second; unless given the highest of the
        machine, and half of that from which on down the slowest stitch, alone, is still enough.
    actual
        The machine that sews, where it isn't the one that plans are made for.
    trials
        Which runs a speed is judged by.
    until
        When the search has to come to an answer, as ``find_fastest`` takes it.

    Raises
    ------
    HaltError
        If the time is over before a speed was judged.
    """
    check_machine(machine)
    constant = constant_speeds(
        job,
        machine,
        spec,
        options,
        low=low,
        high=high,
        progress=progress,
        actual=actual,
        trials=trials,
        until=until,
    )
    constant_s = None
    if constant.best is not None:
        constant_s = plan_job(job, machine, _at_speed(options, constant.best)).duration_s
    schedule = None
    assert machine.shaft is not None
    if machine.shaft.acceleration is not None and constant.complete:
        schedule = _schedule(job, machine, spec, options, actual, trials, progress, until)
    times = [constant_s, None if schedule is None else schedule.plan.duration_s]
    best = min((t for t in times if t is not None), default=None)
    by_schedule = schedule is not None and best == schedule.plan.duration_s
    return FastestShaft(
        constant=constant,
        schedule=schedule,
        tolerance_m=options.tolerance_m
        if schedule is None
        else schedule.plan.stitched.pace.tolerance_m,
        duration_s=best,
        constant_s=constant_s,
        verdict=schedule.verdict if by_schedule and schedule is not None else constant.verdict,
    )


def constant_speeds(
    job: Job,
    machine: Machine,
    spec: Spec,
    options: Options,
    *,
    low: float | None = None,
    high: float | None = None,
    points: int = _POINTS,
    near: int = _NEAR,
    progress: Progress | None = None,
    actual: Machine | None = None,
    trials: Trials = NOMINAL,
    until: Until | None = None,
) -> Fastest:
    """Search the constant speeds of the shaft, in stitches a second, as ``fastest_shaft`` does.

    Parameters
    ----------
    points, near
        Speeds of the scan, and those in each of its gaps about an edge.
    """
    lowest_hz, fastest_hz = speed_range_hz(machine)
    if low is None:
        low = max(lowest_hz, _lowest_of_interest_hz(job, machine, options))

    whole: dict[float, Verdict] = {}

    def judged(speed_hz: float, *, shorten: bool = True) -> Verdict:
        plan = plan_job(job, machine, _at_speed(options, speed_hz))
        # Of other machines neither one run nor the forecast of this one says anything.
        if shorten and trials.repeats > 1 and not trials.machines and actual is None:
            first = try_plan(plan, spec, NOMINAL).verdict
            if not first.passed or _far_within(plan, first, spec):
                return first
        whole[speed_hz] = try_plan(plan, spec, trials, actual).verdict
        return whole[speed_hz]

    def searched(judge: Callable[[float], Verdict]) -> Fastest:
        return find_fastest(
            judge,
            low,
            fastest_hz if high is None else high,
            points=points,
            near=near,
            edge_relative=_EDGE,
            progress=progress,
            unit="stitch/s",
            until=until,
        )

    found = searched(judged)
    for interval in found.intervals:
        for end in (interval.low, interval.high):
            if end not in whole:
                judged(end, shorten=False)
    ends = [whole[end] for one in found.intervals for end in (one.low, one.high)]
    if not found.complete:
        held = tuple(i for i in found.intervals if whole[i.low].passed and whole[i.high].passed)
        found = replace(found, intervals=held)
    elif not all(verdict.passed for verdict in ends):
        return searched(lambda speed_hz: judged(speed_hz, shorten=False))
    return found if found.best is None else replace(found, verdict=whole[found.best])


def _far_within(plan: Plan, first: Verdict, spec: Spec) -> bool:
    """Say whether one run and the forecast of any day leave a fifth of every limit.

    Then twenty runs, which differ in damping alone, are in spec, too: the forecast is right to
    6 %. Ends of what a search answers are judged by all its runs whatever this says.
    """
    limits = [c.limit for c in spec.criteria if c.name == "stitch_residual" and c.limit]
    if not limits:
        return False
    used = [
        abs(result.measured) / result.limit
        for result in first.results
        if result.limit and result.measured is not None
    ]
    turns = plan.stitched.turns
    forecast = plan.stitched.pace.most_swings_m(turns.moves, turns.turn_s).max()
    return max(used) <= _FAR and bool(forecast <= _FAR * min(limits))


def _lowest_of_interest_hz(job: Job, machine: Machine, options: Options) -> float:
    """Return half of the speed from which on down the slowest stitch alone is still enough.

    What is slower takes longest to simulate, and the fastest is looked for.
    """
    stitched = plan_job(job, machine, _at_speed(options, speed_range_hz(machine)[1])).stitched
    return _OF_THE_SLOWEST * len(stitched.turns) / stitched.slowest_s


def speed_range_hz(machine: Machine) -> tuple[float, float]:
    """Return the lowest and the highest constant speed of the shaft, in stitches a second."""
    assert machine.shaft is not None
    return 1.0 / machine.shaft.slowest_turn.si, 1.0 / float(machine.shaft.turn_s)


def _at_speed(options: Options, speed_hz: float) -> Options:
    return replace(options, feed=Feed(FeedMode.SHAFT, speed_hz))


def _schedule(
    job: Job,
    machine: Machine,
    spec: Spec,
    options: Options,
    actual: Machine | None,
    trials: Trials,
    progress: Progress | None,
    until: Until | None,
) -> Proof | None:
    """Return the fastest schedule in spec, by the tolerance that it is planned with.

    Where the time is over first, it is the fastest of those that were tried.
    """
    limits = [c.limit for c in spec.criteria if c.name == "stitch_residual" and c.limit]
    limit = min(limits, default=options.tolerance_m)
    tried = 0

    def proof_at(share: float) -> Proof:
        nonlocal tried
        # What was found is typed back in millimetres, and is to mean the same.
        chosen = replace(options, tolerance_m=parse_tolerance_m(tolerance_words(share * limit)))
        proof = try_plan(plan_job(job, machine, chosen), spec, trials, actual)
        tried += 1
        if progress is not None:
            progress("searching schedules", tried / (_HALVINGS + 2.0))
        return proof

    low, high = _RANGE
    best = proof_at(low)
    if not best.verdict.passed:
        return None
    with as_far_as(until, lambda: best):
        for _ in range(_HALVINGS):
            if until is not None:
                until.check()
            middle = 0.5 * (low + high)
            proof = proof_at(middle)
            if proof.verdict.passed:
                low, best = middle, proof
            else:
                high = middle
    return best
