"""The fastest way to sew a design in spec: at one shaft speed, and with a speed per stitch.

The swing from earlier stitches may help or hurt, so passing is not monotone in speed: shaft speeds
are scanned like feeds. A schedule is planned for a tolerance of the swing. The largest tolerance
whose schedule passes gives the fastest schedule.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

from threadline.commands.plan import Plan
from threadline.jobs.operations import Feed, FeedMode
from threadline.machine import Machine
from threadline.proof.option_words import parse_tolerance_m, tolerance_words
from threadline.proof.pipeline import NOMINAL, Proof, check_machine, plan_job, try_plan
from threadline.search.deadline import until_deadline
from threadline.search.fastest import Fastest, Grid
from threadline.search.paced import Paced, Question, fastest_paced
from threadline.search.searched_edges import with_searched_edges
from threadline.verdict import Spec, Verdict

GRID = Grid(points=24, near=3, edge=5e-3)
_RANGE = (0.5, 1.5)
"""Least and largest tolerance of a schedule search, as shares of the limit of the residual."""
_HALVINGS = 6
_OF_THE_SLOWEST = 0.5
FAR = 0.8
"""Largest used share of a limit that counts as far within the limit."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FastestShaft:
    """Result of a search over shaft speeds.

    Parameters
    ----------
    constant
        Shaft speeds in spec, stitches a second.
    schedule
        Proof of the fastest plan with a speed for each stitch; None where the spindle cannot change
        its speed, or no schedule is in spec.
    tolerance_m
        Tolerance of the residual that the schedule was planned with.
    duration_s
        The shorter time of schedule and constant speed; None where neither is in spec.
    constant_s
        Time at the highest constant speed in spec; None where there is none.
    verdict
        Verdict on the faster of the two plans.
    """

    constant: Fastest
    schedule: Proof | None
    tolerance_m: float
    duration_s: float | None
    constant_s: float | None
    verdict: Verdict

    @property
    def limited_by(self) -> str:
        """The criterion that limits the constant speed."""
        return self.constant.limited_by

    @property
    def by_schedule(self) -> bool:
        """Whether the schedule is the faster plan."""
        return self.schedule is not None and self.schedule.plan.duration_s == self.duration_s


def fastest_shaft(question: Question) -> FastestShaft:
    """Search the constant shaft speeds, and the schedule of speeds.

    ``Question.low`` and ``high`` are constant speeds, stitches a second. By default the search ends
    at the machine's highest speed. It begins at half the constant speed that the slowest stitch
    needs by itself.

    Raises
    ------
    HaltError
        If the time is over before a speed was judged.
    """
    machine = question.machine
    check_machine(machine)
    constant = constant_speeds(question)
    if constant.complete and question.searches:
        answer = [constant]
        with until_deadline(question.until, lambda: answer):
            answer[0] = _searched_edges(question, constant)
        constant = answer[0]
    constant_s = None
    if constant.best is not None:
        constant_s = at_speed(question, constant.best).duration_s
    schedule = None
    assert machine.shaft is not None
    if machine.shaft.acceleration is not None and constant.complete:
        schedule = fastest_schedule(question)
    durations_s = [constant_s, None if schedule is None else schedule.plan.duration_s]
    best_s = min((t for t in durations_s if t is not None), default=None)
    by_schedule = schedule is not None and best_s == schedule.plan.duration_s
    return FastestShaft(
        constant=constant,
        schedule=schedule,
        tolerance_m=question.options.tolerance_m
        if schedule is None
        else schedule.plan.stitched.pace.tolerance_m,
        duration_s=best_s,
        constant_s=constant_s,
        verdict=schedule.verdict if by_schedule and schedule is not None else constant.verdict,
    )


def constant_speeds(question: Question, grid: Grid = GRID, *, far: float = FAR) -> Fastest:
    """Search the constant speeds of the shaft, in stitches a second, as ``fastest_shaft`` does.

    Parameters
    ----------
    grid
        Resolution of the search.
    far
        One run decides at a speed inside an interval at which the run and the forecast use at most
        this share of every limit.
    """
    trials = question.trials
    low, high = speed_range_hz(question.machine)
    if question.low is None:
        low = max(low, _lowest_of_interest_hz(question))
    verdicts_of_all_runs: dict[float, Verdict] = {}

    def judged_by_all_runs(speed_hz: float, plan: Plan) -> Verdict:
        verdicts_of_all_runs[speed_hz] = question.judged(plan)
        return verdicts_of_all_runs[speed_hz]

    def shortened(speed_hz: float, plan: Plan) -> Verdict:
        # One run and the forecast are valid only for the file's machine, not for others.
        if trials.repeats > 1 and not trials.machines and question.actual is None:
            first_run = replace(question, trials=NOMINAL).judged(plan)
            if not first_run.passed or _far_within(plan, first_run, question.spec, far):
                return first_run
        return judged_by_all_runs(speed_hz, plan)

    planned_at = partial(at_speed, question)
    paced = Paced(low=low, high=high, unit="stitch/s", planned_at=[planned_at], judged=shortened)
    found = fastest_paced(question, paced, grid)
    for interval in found.intervals:
        for end in (interval.low, interval.high):
            if end not in verdicts_of_all_runs:
                judged_by_all_runs(end, planned_at(end))
    ends = [verdicts_of_all_runs[end] for one in found.intervals for end in (one.low, one.high)]
    if not found.complete:
        held_intervals = tuple(
            i
            for i in found.intervals
            if verdicts_of_all_runs[i.low].passed and verdicts_of_all_runs[i.high].passed
        )
        found = replace(found, intervals=held_intervals)
    elif not all(verdict.passed for verdict in ends):
        return fastest_paced(question, replace(paced, judged=judged_by_all_runs), grid)
    return found if found.best is None else replace(found, verdict=verdicts_of_all_runs[found.best])


def _searched_edges(question: Question, found: Fastest) -> Fastest:
    """Return the constant speeds whose ends also pass a search for a failing run."""
    return with_searched_edges(
        found,
        lambda speed_hz: question.judged(at_speed(question, speed_hz)),
        lambda speed_hz, verdict: question.searched(at_speed(question, speed_hz), verdict),
        until=question.until,
    )


def _far_within(plan: Plan, first: Verdict, spec: Spec, far: float) -> bool:
    """Return whether one run and the forecast over all dampings use at most ``far`` of every limit.

    If they leave a fifth free, all twenty runs are in spec, too, because the runs differ only in
    damping and the forecast is accurate to 6 %. The ends of the found intervals are judged by all
    runs in any case.
    """
    limits = [c.limit for c in spec.criteria if c.name == "stitch_residual" and c.limit]
    if not limits:
        return False
    shares_used = [
        abs(result.measured) / result.limit
        for result in first.results
        if result.limit and result.measured is not None
    ]
    turns = plan.stitched.turns
    forecast = plan.stitched.pace.most_swings_m(turns.moves, turns.turn_s).max()
    return max(shares_used) <= far and bool(forecast <= far * min(limits))


def _lowest_of_interest_hz(question: Question) -> float:
    """Return the lowest speed of the search, stitches a second.

    It is half the constant speed that the slowest stitch needs by itself. Lower speeds take longest
    to simulate, and are not the answer to a search for the fastest.
    """
    stitched = at_speed(question, speed_range_hz(question.machine)[1]).stitched
    return _OF_THE_SLOWEST * len(stitched.turns) / stitched.slowest_s


def speed_range_hz(machine: Machine) -> tuple[float, float]:
    """Return the lowest and the highest constant speed of the shaft, in stitches a second."""
    assert machine.shaft is not None
    return 1.0 / machine.shaft.slowest_turn.si, 1.0 / float(machine.shaft.turn_s)


def at_speed(question: Question, speed_hz: float) -> Plan:
    """Return the plan of a design at a constant speed of the shaft, stitches a second."""
    options = replace(question.options, feed=Feed(FeedMode.SHAFT, speed_hz))
    return plan_job(question.job, question.machine, options)


def fastest_schedule(question: Question) -> Proof | None:
    """Return the proof of the fastest schedule in spec; None if no schedule is in spec.

    The search varies the tolerance of the swing with which a schedule is planned. If its time is
    over, the result is the fastest tried schedule.
    """
    spec, options, until = question.spec, question.options, question.until
    limits = [c.limit for c in spec.criteria if c.name == "stitch_residual" and c.limit]
    limit = min(limits, default=options.tolerance_m)
    tried = 0

    def proof_at(share: float) -> Proof:
        nonlocal tried
        # The tolerance is rounded to its text in millimetres, which a user types to get the same
        # plan.
        schedule_options = replace(
            options, tolerance_m=parse_tolerance_m(tolerance_words(share * limit))
        )
        plan = plan_job(question.job, question.machine, schedule_options)
        proof = try_plan(plan, spec, question.trials, question.actual, question.suspects)
        proof = replace(proof, verdict=question.searched(plan, proof.verdict))
        tried += 1
        if question.progress is not None:
            question.progress("searching schedules", tried / (_HALVINGS + 2.0))
        return proof

    low, high = _RANGE
    best = proof_at(low)
    if not best.verdict.passed:
        return None
    with until_deadline(until, lambda: best):
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
