"""What deserves a second look before a proof or a plan is relied on, in words."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice

from threadline.jobs.operations import FeedMode, Job, MoveRun
from threadline.option_words import parse_tolerance_m
from threadline.path.interpolations import KEEPING_TOLERANCE, on_chords
from threadline.pipeline import Proof
from threadline.plan import Plan
from threadline.plant.suspicions import suspicions
from threadline.verdict.deviation import measure_path_deviation
from threadline.verdict.registry import MEASURES

LIMIT = 0.05
"""Relative error of the time of a stitch up to which no warning is given, where the specification
has no limit of ``stitch_length_error``."""
_RUNS = 16
_ROUNDING = 1e-6  # relative: of what is measured on points of the path


def doubts(proof: Proof) -> list[str]:
    """Return every warning of a proof: of its machine, its job, its plan and its verdict."""
    plan = proof.plan
    return [
        *suspicions(plan.machine),
        *(plan.machine.planner.left_out if plan.machine.planner is not None else []),
        *plan.job.suspicions(own_feed=plan.feed_override is not None),
        *plan.intent.warnings,
        *proof_warnings(proof),
        *needle_warnings(proof),
    ]


def doubts_of_all(proofs: Sequence[Proof]) -> list[str]:
    """Return the warnings of several proofs, each once."""
    return list(dict.fromkeys(said for proof in proofs for said in doubts(proof)))


def tolerance_warnings(plan: Plan) -> list[str]:
    """Return a line if the planned path leaves the programmed one by more than the tolerance."""
    if MEASURES["path_deviation"].of_plan(plan) is None or _keeps(plan):
        return []
    (worst,) = measure_path_deviation(plan)
    return _told(plan, worst.value, worst.job_line)


def proof_warnings(proof: Proof) -> list[str]:
    """Return the line of ``tolerance_warnings`` for a proof, whose verdict has the deviation."""
    found = [r for r in proof.verdict.results if r.name == "path_deviation"]
    if not found or found[0].measured is None or _keeps(proof.plan):
        return []
    return _told(proof.plan, found[0].measured, found[0].job_line)


def _keeps(plan: Plan) -> bool:
    name = plan.motion.path.interpolation
    return name in KEEPING_TOLERANCE or on_chords(name)


def _told(plan: Plan, deviation_m: float | None, line: int | None) -> list[str]:
    tolerance_m = parse_tolerance_m(plan.options["tolerance"])
    if deviation_m is None or deviation_m <= tolerance_m * (1.0 + _ROUNDING):
        return []
    at = f" at line {line}" if line else ""
    return [
        f"{plan.motion.path.interpolation} does not keep the tolerance of "
        f"{tolerance_m * 1e3:g} mm: the planned path is "
        f"{deviation_m * 1e3:.3g} mm off the programmed one{at}; "
        f"{', '.join(KEEPING_TOLERANCE[:-1])} and {KEEPING_TOLERANCE[-1]} keep it"
    ]


def needle_warnings(proof: Proof) -> list[str]:
    """Return a line if a stitch takes much more or less than a turn of an even needle.

    The limit is that of ``stitch_length_error``: with a needle that turned evenly the error of
    time would be an error of length of the same share.
    """
    found = {result.name: result for result in proof.verdict.results}
    time, length = found.get("needle_time_error"), found.get("stitch_length_error")
    limit = LIMIT if length is None or length.limit is None else length.limit
    if time is None or time.measured is None or time.measured <= limit:
        return []
    if not _even(proof.plan.job):
        return []
    way = "more" if time.note == "too long" else "less"
    at = f" at line {time.job_line}" if time.job_line else ""
    return [
        f"the needle is to turn evenly, but {proof.plan.motion.path.interpolation} gives a "
        f"stitch{at} "
        f"{100.0 * time.measured:.2g} % {way} than a turn, limit {100.0 * limit:g} %: stitches are "
        f"judged as if it waited for the head; --feed-forward and --interpolation linear keep "
        f"its time"
    ]


def _even(job: Job) -> bool:
    """Say whether the stitches at the beginning of a job all take one time."""
    times = {
        feed.value
        for run in islice(job.runs(), _RUNS)
        if isinstance(run, MoveRun)
        for _, feed in run.feeds
        if feed is not None and feed.mode is FeedMode.INVERSE_TIME
    }
    return len(times) == 1
