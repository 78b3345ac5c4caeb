"""A proof with the further results of its report, for each kind of work.

All simulations for a report run here; the report itself only draws.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from threadline.commands.plan import Motion, Scheduled, Stitched
from threadline.proof.options import Options
from threadline.proof.pipeline import Proof, plan_job, prove_plan
from threadline.search.broken_beam import BrokenBeam, broken_beam


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReportData:
    """A proof, and the further results of its report.

    Parameters
    ----------
    unshaped
        Proof of the same job without a shaper; None where the job is unshaped.
    beam
        Vibration after a broken beam; None where the machine has no light grid or no moves.
    """

    proof: Proof
    unshaped: Proof | None = None
    beam: BrokenBeam | None = None


def _proof_only(proof: Proof) -> ReportData:
    return ReportData(proof=proof)


def _schedule(proof: Proof) -> ReportData:
    plan = proof.plan
    unshaped = None
    if "shaper" in plan.options:
        unshaped = prove_plan(plan_job(plan.job, plan.machine, Options()), proof.spec)
    return ReportData(proof=proof, unshaped=unshaped, beam=broken_beam(plan.scheduled))


REPORT_DATA: Mapping[type, Callable[[Proof], ReportData]] = {
    Motion: _proof_only,
    Scheduled: _schedule,
    Stitched: _proof_only,
}
"""By type of ``Plan.intent``; one entry for every ``Kind.intent`` in ``KINDS``."""


def report_data(proof: Proof) -> ReportData:
    """Return ``proof`` with the further results of its report, simulated in one run each."""
    return REPORT_DATA[type(proof.plan.intent)](proof)
