"""The shortest cycle of an on/off machine in spec: the command of every move, and the waits.

Cycles are proposed by a closed form of the vibration that commands leave, and run on the twin. What
the twin measures beyond the closed form (a piston that runs into its stop, friction, air that is
not linear) is added to the forecast of the next round, so that a handful of simulations suffice.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from threadline.errors import PlanError, RecordingError
from threadline.jobs.operations import Job
from threadline.proof.options import Options
from threadline.proof.pipeline import Proof, plan_job, try_plan
from threadline.search.cycle_forecast import Cycle, CycleForecast, MoveChoice
from threadline.search.fastest import RANGE
from threadline.search.move_list import overlapped, with_choices
from threadline.search.paced import Question
from threadline.search.until import as_far_as
from threadline.verdict import Status

_ROUNDS = 14


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FastestCycle:
    """What a search found.

    Parameters
    ----------
    job
        The job with the commands and waits of the fastest; None where no cycle is in spec.
    proof
        Proof of that job; where no cycle is in spec, of the one that came closest.
    unshaped
        Proof of the job as it is, without a shaper.
    base
        Proof of the unshaped job in which moves overlap where the list allows it.
    moves
        Every move, in order.
    limited_by
        What fails in the next faster cycle that was tried; ``"range"`` where none was.
    tried
        Cycles that the twin ran.
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
    """Return how long the cycle of a proof took, as it was simulated where that was measured."""
    found = [r.measured for r in proof.verdict.results if r.name == "cycle_time"]
    return found[0] if found and found[0] is not None else proof.plan.duration_s


def fastest_cycle(asked: Question) -> FastestCycle:
    """Search commands and waits of every move together; the shortest cycle in spec wins.

    The job is a move list. Shapers and levels that it gives to its moves are replaced; rests and
    what must not overlap are kept. The specification's limits of the residual vibration lead the
    search; the twin is judged by all of it. The job as it is, without a shaper, is judged however
    short the time is.

    Raises
    ------
    PlanError, RecordingError
        If the machine cannot do the job even without a shaper, or does not come to its end.
    """
    machine, spec, until = asked.machine, asked.spec, asked.until

    def proved(job: Job) -> Proof:
        return try_plan(plan_job(job, machine, Options()), spec, asked.trials, asked.actual)

    plain = with_choices(asked.job, {}, {})
    unshaped = proved(plain)
    free = overlapped(plain, machine)
    base = proved(free)
    forecast = CycleForecast(free, machine, spec, base, asked.actual or machine)
    best: tuple[Job, Proof, Cycle] | None = None
    closest: tuple[float, Proof, Cycle | None] = (_excess(base), base, None)
    limited_by = RANGE if base.verdict.passed else _failing(base)
    if base.verdict.passed:
        return FastestCycle(
            job=free,
            proof=base,
            unshaped=unshaped,
            base=base,
            moves=forecast.told(None),
            limited_by=RANGE,
            tried=1,
        )
    tried = 1
    with as_far_as(until, lambda: base):
        for round_ in range(_ROUNDS):
            if until is not None:
                until.check()
            if asked.progress is not None:
                asked.progress("cycles", round_ / _ROUNDS)
            cycle = forecast.next()
            if cycle is None or (best is not None and cycle.scans >= best[2].scans):
                break
            chosen = forecast.job_of(cycle)
            tried += 1
            try:
                proof = proved(chosen)
            except (PlanError, RecordingError):
                continue  # its valves cannot, or an input that it waits for never comes
            if proof.verdict.passed:
                # What was learned from it may show a way to a shorter one.
                best = chosen, proof, cycle
            else:
                limited_by = _failing(proof)
                if _excess(proof) < closest[0]:
                    closest = _excess(proof), proof, cycle
            forecast.learn(cycle, proof)
    if best is None:
        return FastestCycle(
            job=None,
            proof=closest[1],
            unshaped=unshaped,
            base=base,
            moves=forecast.told(closest[2]),
            limited_by=_failing(closest[1]),
            tried=tried,
        )
    return FastestCycle(
        job=best[0],
        proof=best[1],
        unshaped=unshaped,
        base=base,
        moves=forecast.told(best[2]),
        limited_by=limited_by,
        tried=tried,
    )


def _failing(proof: Proof) -> str:
    failed = [r for r in proof.verdict.results if r.status is Status.FAILED]
    worst = max(failed, key=lambda result: result.severity, default=None)
    lacking = [r for r in proof.verdict.results if r.required and r.measured is None]
    return worst.name if worst else lacking[0].name if lacking else ""


def _excess(proof: Proof) -> float:
    return max(
        (
            r.measured / r.limit if r.limit else np.inf
            for r in proof.verdict.results
            if r.status is Status.FAILED and r.measured is not None
        ),
        default=np.inf,
    )
