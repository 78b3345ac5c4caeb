"""Comparison of one job with several interpolations, feeds and shapers, and the fastest feeds."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Sequence
from contextvars import Context
from dataclasses import dataclass, replace
from pathlib import Path

from threadline.base.progress import Progress
from threadline.base.summary import Summarised, Summary
from threadline.commands.plan import Plan
from threadline.errors import PlanError
from threadline.jobs.operations import Job
from threadline.machine import Machine
from threadline.motion.path.interpolations import FIRMWARE
from threadline.proof.kinds import kind_of
from threadline.proof.options import Options
from threadline.proof.pipeline import (
    NOMINAL,
    Proof,
    Trials,
    check_machine,
    plan_job,
    prove_plan,
    with_product,
)
from threadline.search.allowance import FastestJob
from threadline.search.least_limits import fastest_job
from threadline.search.paced import Question
from threadline.verdict import Spec, closing_of_all, in_a_word
from threadline.verdict.fibre import MEASURED, PLANNED

PLACEMENT = ("contour_error", "turning_point_error", *MEASURED, *PLANNED)


_COLUMNS = (
    ("tracking_error", "tracking mm"),
    ("contour_error", "contour mm"),
    ("turning_point_error", "turning point mm"),
    ("path_deviation", "plan misses mm"),
)
_STEP_COLUMNS = (
    ("cycle_time", "cycle s"),
    ("residual_vibration", "rings mm"),
    ("settling_time", "settles s"),
    ("end_position_error", "end missed mm"),
)

_WINDING_COLUMNS = (
    ("contour_error", "contour mm"),
    ("turning_point_error", "turning point mm"),
    ("slip_tendency", "slip %"),
    ("laid_error", "fibre off mm"),
    ("coverage_gap", "gap mm"),
    ("tension_variation", "tension varies %"),
)
"""Columns for a job with a product; the tension also needs a spool in the machine file."""
_STITCH_COLUMNS = (
    ("stitch_residual", "residual mm"),
    ("servo_force", "force %"),
    ("window_use", "window %"),
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Comparison(Summarised):
    """Result of a comparison; prints itself as a table.

    Parameters
    ----------
    proofs
        One proof per interpolation, feed and shaper, interpolations outermost.
    fastest
        Per interpolation: the fastest job within the placement criteria alone, as in the 1994
        experiment; empty when the fastest feeds were not asked for.
    refused
        Shapers that the machine cannot follow, each with the reason.
    as_run_s
        Per proof: duration of the written program under the planner of the machine's own firmware;
        None where there is no such program.
    """

    proofs: tuple[Proof, ...]
    fastest: dict[str, FastestJob]
    refused: tuple[tuple[str, str], ...] = ()
    as_run_s: tuple[float | None, ...] = ()

    def _summary(self) -> Summary:
        first = self.proofs[0].plan.options
        differing = [
            key
            for key in ("interpolation", "feed", "shaper")
            if any(one.plan.options.get(key) != first.get(key) for one in self.proofs)
        ]
        fastest = "; .fastest has the fastest job of each" if self.fastest else ""
        closing = f"{closing_of_all([one.verdict for one in self.proofs])}{fastest}"
        return Summary(*compared_table(self, differing or ["interpolation"]), closing)


def compared_table(
    found: Comparison, shown: Sequence[str] = ("interpolation", "feed")
) -> tuple[str, list[str], list[list[str]]]:
    """Return title, header and rows of the compared proofs; ``shown`` names compared options."""
    first = found.proofs[0].plan
    stepwise = any(result.step for proof in found.proofs for result in proof.verdict.results)
    sewn = any(result.name == _STITCH_COLUMNS[0][0] for result in found.proofs[0].verdict.results)
    columns: tuple[tuple[str, str], ...] = _COLUMNS
    if stepwise or sewn:
        columns = _STEP_COLUMNS if stepwise else _STITCH_COLUMNS
    wound = "product" in first.options
    if wound:
        columns = _WINDING_COLUMNS
    # Without dynamics no placement is measured, and without a spool no tension.
    if wound or first.machine.without_dynamics:
        columns = tuple(
            (name, title)
            for name, title in columns
            if any(_worst_text(proof, name) != "-" for proof in found.proofs)
        )
    as_run_header = ["as run s"] if any(found.as_run_s) else []
    header = [*shown, "time s", *as_run_header, *(title for _, title in columns), "verdict"]
    rows = [
        [
            *(_label(proof, key) for key in shown),
            f"{proof.plan.duration_s:.3f}",
            *(["-" if run_s is None else f"{run_s:.3f}"] if as_run_header else []),
            *(_worst_text(proof, name) for name, _ in columns),
            in_a_word(proof.verdict),
        ]
        for proof, run_s in zip(found.proofs, found.as_run_s, strict=True)
    ]
    if "shaper" in shown:
        blank = [""] * (len(header) - len(shown) - 1)
        for shaper, _ in found.refused:
            rows.append([*(shaper if k == "shaper" else "" for k in shown), *blank, "refused"])
    level = found.proofs[0].verdict.level
    actual = found.proofs[0].actual
    ran = "" if actual is None else f", run by {actual.name}"
    return f"{first.job.name} on {first.machine.name}{ran}, {level}", header, rows


def _label(proof: Proof, key: str) -> str:
    """Return the value of the compared option ``key`` in this proof."""
    if key == "interpolation":
        return proof.plan.interpolation
    return proof.plan.options.get(key, "none")


def _worst_text(proof: Proof, name: str) -> str:
    """Return the worst value of a criterion: length in mm, time in s, share in %.

    ``-`` if it was not measured.
    """
    sizes = [
        (abs(r.measured), r.unit)
        for r in proof.verdict.results
        if r.name == name and r.measured is not None and r.unit in {"m", "s", ""}
    ]
    if not sizes:
        return "-"
    size, unit = max(sizes)
    if math.isinf(size):
        return "never"
    return {"m": f"{size * 1e3:.3f}", "s": f"{size:.3f}"}.get(unit, f"{100.0 * size:.1f}")


def placement_spec(spec: Spec) -> Spec:
    """Return ``spec`` with limits on placement criteria only; the others are reported."""
    criteria = tuple(
        criterion if criterion.name in PLACEMENT else replace(criterion, limit=None, required=False)
        for criterion in spec.criteria
    )
    return replace(spec, name=f"{spec.name}, placement only", criteria=criteria)


def compare(
    job: Job,
    machine: Machine,
    spec: Spec,
    planned: Sequence[Options],
    *,
    with_fastest: bool = True,
    progress: Progress | None = None,
    trials: Trials = NOMINAL,
    actual: Machine | None = None,
) -> Comparison:
    """Prove ``job`` with each of ``planned``; find the fastest feed of each interpolation.

    A job paced by switchings or by a shaft has no feed to search. A machine without dynamics has no
    placement criteria to search within.

    Parameters
    ----------
    planned
        Planning options of each proof, interpolations outermost.
    trials
        Runs by which each plan is judged.
    actual
        The machine that runs every plan; None: ``machine``.

    Raises
    ------
    PlanError
        If a plan without a shaper fails, or the plans with all shapers fail.
    """
    check_machine(machine)
    planned = list(dict.fromkeys(one.on(machine) for one in planned))
    searchable = job.paced_by in ("feed", "needle") and not machine.without_dynamics
    with_fastest = with_fastest and searchable
    proofs = []
    refused: list[tuple[str, str]] = []
    last_refusal: PlanError | None = None
    by_interpolation = {one.interpolation: one for one in reversed(planned)}
    by_interpolation = dict(reversed(by_interpolation.items()))
    steps = len(planned) + (len(by_interpolation) if with_fastest else 0)
    done_count = 0

    def stepped(what: str) -> None:
        nonlocal done_count
        if progress is not None:
            progress(what, done_count / steps)
        done_count += 1

    for options in planned:
        stepped(options.shaper or options.interpolation)
        try:
            plan = plan_job(job, machine, options)
        except PlanError as error:
            if options.shaper is None:
                raise
            refused.append((options.shaper, error.message))
            last_refusal = error
            continue
        wanted = with_product(spec, machine, options)
        proofs.append(prove_plan(plan, wanted, trials=trials, actual=actual))
    if not proofs and last_refusal is not None:
        raise last_refusal
    fastest = {}
    if with_fastest:
        for interpolation, options in by_interpolation.items():
            stepped(f"fastest {interpolation}")
            chosen = replace(options, feed=None, shaper=None)
            fastest[interpolation] = fastest_job(
                Question(
                    job=job, machine=machine, options=chosen, trials=trials, actual=actual,
                    spec=placement_spec(with_product(spec, machine, options)),
                )
            )  # fmt: skip
    return Comparison(
        proofs=tuple(proofs),
        fastest=fastest,
        refused=tuple(refused),
        as_run_s=tuple(as_run_s(proof.plan) for proof in proofs),
    )


def as_run_s(plan: Plan) -> float | None:
    """Return the duration of a plan's written program under the machine's own firmware.

    None if the machine file names no planner, or if a program cannot state the plan: a plan with a
    shaper or feed-forward, or with words that the written program loses.
    """
    planner = plan.machine.planner
    if planner is None or planner.kind not in kind_of(plan.machine).targets:
        return None
    if plan.interpolation == FIRMWARE:
        return plan.duration_s
    if {"shaper", "feed-forward"} & plan.options.keys():
        return None
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "program"
        try:
            # A fresh context writes the file at once, and its messages do not reach the command's
            # output.
            written = Context().run(kind_of(plan.machine).targets[planner.kind].write, plan, file)
        except PlanError:
            return None
    return None if written[0].as_run_s is None else written[0].as_run_s[1]
