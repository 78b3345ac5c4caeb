"""The shortest cycle of an on/off machine in spec: the command of every move, and the waits.

A closed form of the vibration after each command proposes cycles, and the twin runs them. The twin
also shows effects beyond the closed form: a piston that runs into its stop, friction, nonlinear
air. The forecast of the next round includes the measured difference, so that a handful of
simulations suffice.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from threadline.errors import PlanError, RecordingError
from threadline.jobs.operations import Job
from threadline.proof.options import Options
from threadline.proof.pipeline import Proof, plan_job, try_plan
from threadline.search.cycle_forecast import Cycle, CycleForecast, MoveChoice
from threadline.search.deadline import until_deadline
from threadline.search.fastest import RANGE
from threadline.search.move_list import overlapped, with_choices
from threadline.search.paced import Question
from threadline.verdict import Status

_ROUNDS = 14


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FastestCycle:
    """Result of a cycle search.

    Parameters
    ----------
    job
        The job with the commands and waits of the fastest cycle; None where no cycle is in spec.
    proof
        Proof of this job; where no cycle is in spec, proof of the cycle that came closest.
    unshaped
        Proof of the given job without a shaper.
    base
        Proof of the unshaped job with overlapping moves where the list allows overlap.
    moves
        Every move, in order.
    limited_by
        Criterion that fails in the next faster trial; ``"range"`` where no faster cycle was tried.
    tried
        Number of cycles that the twin ran.
    """

    job: Job | None
    proof: Proof
    unshaped: Proof
    base: Proof
    moves: tuple[MoveChoice, ...]
    limited_by: str
    tried: int

    @property
    def cycle_s(self) -> float | None:
        """Duration of the fastest cycle in spec."""
        return None if self.job is None else cycle_s(self.proof)


def cycle_s(proof: Proof) -> float:
    """Return the cycle time of a proof: simulated where it was measured, else planned."""
    cycle_times_s = [r.measured for r in proof.verdict.results if r.name == "cycle_time"]
    return (
        cycle_times_s[0]
        if cycle_times_s and cycle_times_s[0] is not None
        else proof.plan.duration_s
    )


def fastest_cycle(question: Question) -> FastestCycle:
    """Search commands and waits of every move together; the shortest cycle in spec wins.

    The job is a move list. The search replaces the shapers and levels of the moves. Rests and
    overlap rules are kept. The limits on the residual vibration guide the search; the twin is
    judged by the whole specification. The given job without a shaper is judged even if the time is
    short.

    Raises
    ------
    PlanError, RecordingError
        If the machine cannot do the job even without a shaper, or does not finish it.
    """
    machine, spec, until = question.machine, question.spec, question.until

    def proved(job: Job) -> Proof:
        plan = plan_job(job, machine, Options())
        proof = try_plan(plan, spec, question.trials, question.actual, question.suspects)
        return replace(proof, verdict=question.searched(plan, proof.verdict))

    plain_job = with_choices(question.job, {}, {})
    unshaped = proved(plain_job)
    overlapped_job = overlapped(plain_job, machine)
    base = proved(overlapped_job)
    forecast = CycleForecast(overlapped_job, machine, spec, base, question.actual or machine)
    best: tuple[Job, Proof, Cycle] | None = None
    closest: tuple[float, Proof, Cycle | None] = (_worst_ratio(base), base, None)
    limited_by = RANGE if base.verdict.passed else _failed_criterion(base)
    if base.verdict.passed:
        return FastestCycle(
            job=overlapped_job,
            proof=base,
            unshaped=unshaped,
            base=base,
            moves=forecast.move_choices(None),
            limited_by=RANGE,
            tried=1,
        )
    tried = 1
    with until_deadline(until, lambda: base):
        for round_ in range(_ROUNDS):
            if until is not None:
                until.check()
            if question.progress is not None:
                question.progress("cycles", round_ / _ROUNDS)
            cycle = forecast.next()
            if cycle is None or (best is not None and cycle.scans >= best[2].scans):
                break
            chosen = forecast.job_of(cycle)
            tried += 1
            try:
                proof = proved(chosen)
            except (PlanError, RecordingError):
                continue  # impossible command, or an awaited input that never comes
            if proof.verdict.passed:
                # The corrected forecast may find a shorter cycle.
                best = chosen, proof, cycle
            else:
                limited_by = _failed_criterion(proof)
                if _worst_ratio(proof) < closest[0]:
                    closest = _worst_ratio(proof), proof, cycle
            forecast.learn(cycle, proof)
    if best is None:
        return FastestCycle(
            job=None,
            proof=closest[1],
            unshaped=unshaped,
            base=base,
            moves=forecast.move_choices(closest[2]),
            limited_by=_failed_criterion(closest[1]),
            tried=tried,
        )
    return FastestCycle(
        job=best[0],
        proof=best[1],
        unshaped=unshaped,
        base=base,
        moves=forecast.move_choices(best[2]),
        limited_by=limited_by,
        tried=tried,
    )


def _failed_criterion(proof: Proof) -> str:
    failed = [r for r in proof.verdict.results if r.status is Status.FAILED]
    worst = max(failed, key=lambda result: result.severity, default=None)
    not_measured = [r for r in proof.verdict.results if r.required and r.measured is None]
    return worst.name if worst else not_measured[0].name if not_measured else ""


def _worst_ratio(proof: Proof) -> float:
    return max(
        (
            r.measured / r.limit if r.limit else np.inf
            for r in proof.verdict.results
            if r.status is Status.FAILED and r.measured is not None
        ),
        default=np.inf,
    )
