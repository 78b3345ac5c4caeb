"""A proof with what its report sets beside it, for each kind of work.

All that is simulated for a report is simulated here: a report draws, and asks no machine.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from threadline.commands.plan import Motion, Scheduled, Stitched
from threadline.proof.options import Options
from threadline.proof.pipeline import Proof, plan_job, prove_plan
from threadline.search.broken_beam import BrokenBeam, broken_beam


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Studied:
    """A proof, and what stands beside it in a report.

    Parameters
    ----------
    unshaped
        The same job without a shaper; None where none was asked for.
    beam
        What a broken beam leaves; None where nothing has a light grid or moves.
    """

    proof: Proof
    unshaped: Proof | None = None
    beam: BrokenBeam | None = None


def _alone(proof: Proof) -> Studied:
    return Studied(proof=proof)


def _schedule(proof: Proof) -> Studied:
    plan = proof.plan
    unshaped = None
    if "shaper" in plan.options:
        unshaped = prove_plan(plan_job(plan.job, plan.machine, Options()), proof.spec)
    return Studied(proof=proof, unshaped=unshaped, beam=broken_beam(plan.scheduled))


STUDIES: Mapping[type, Callable[[Proof], Studied]] = {
    Motion: _alone,
    Scheduled: _schedule,
    Stitched: _alone,
}
"""By the type of ``Plan.intent``; one for every ``Kind.intent`` in ``KINDS``."""


def studied(proof: Proof) -> Studied:
    """Return ``proof`` with what a report sets beside it, simulated in one run each."""
    return STUDIES[type(proof.plan.intent)](proof)
