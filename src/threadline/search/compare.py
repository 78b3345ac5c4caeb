"""The same job with several interpolations, feeds and shapers, and the fastest of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from threadline.errors import PlanError
from threadline.jobs.operations import Feed, Job
from threadline.machine import Machine
from threadline.options import Options
from threadline.pipeline import (
    NOMINAL,
    Proof,
    Trials,
    check_machine,
    plan_job,
    prove_plan,
)
from threadline.progress_call import Progress
from threadline.search.gentle import fastest_job
from threadline.search.rungs import FastestJob
from threadline.verdict import Spec

PLACEMENT = ("contour_error", "turning_point_error")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Comparison:
    """What was compared.

    Parameters
    ----------
    proofs
        One per interpolation, feed and shaper, interpolations outermost.
    fastest
        Per interpolation: the fastest job within the placement criteria alone, which is how the
        1994 experiment was judged; empty when it was not asked for.
    refused
        Shapers that the machine cannot follow, each with why.
    """

    proofs: tuple[Proof, ...]
    fastest: dict[str, FastestJob]
    refused: tuple[tuple[str, str], ...] = ()


def placement_spec(spec: Spec) -> Spec:
    """Return ``spec`` with its placement criteria only; every other is reported, not limited."""
    criteria = tuple(
        criterion if criterion.name in PLACEMENT else replace(criterion, limit=None, required=False)
        for criterion in spec.criteria
    )
    return replace(spec, name=f"{spec.name}, placement only", criteria=criteria)


def compare(
    job: Job,
    machine: Machine,
    spec: Spec,
    interpolations: Sequence[str],
    feeds: Sequence[Feed | None],
    options: Options,
    *,
    shapers: Sequence[str | None] = (None,),
    with_fastest: bool = True,
    progress: Progress | None = None,
    trials: Trials = NOMINAL,
) -> Comparison:
    """Prove ``job`` with every interpolation, feed and shaper; find the fastest feed of each.

    A job that is paced by switchings or by a shaft has no feed to search, and a machine without
    dynamics none within criteria of placement.

    Parameters
    ----------
    trials
        Which runs each is judged by.

    Raises
    ------
    PlanError
        If a plan without a shaper fails, or those of all shapers do.
    """
    check_machine(machine)
    named = (replace(options, interpolation=name).on(machine) for name in interpolations)
    interpolations = list(dict.fromkeys(one.interpolation for one in named))
    searched = job.paced_by in ("feed", "needle") and not machine.without_dynamics
    with_fastest = with_fastest and searched
    proofs = []
    refused: list[tuple[str, str]] = []
    why: PlanError | None = None
    steps = len(interpolations) * (len(feeds) * len(shapers) + (1 if with_fastest else 0))
    done = 0

    def stepped(what: str) -> None:
        nonlocal done
        if progress is not None:
            progress(what, done / steps)
        done += 1

    for interpolation in interpolations:
        for feed in feeds:
            for shaper in shapers:
                stepped(shaper or interpolation)
                chosen = replace(options, interpolation=interpolation, feed=feed, shaper=shaper)
                try:
                    plan = plan_job(job, machine, chosen)
                except PlanError as error:
                    if shaper is None:
                        raise
                    refused.append((shaper, error.message))
                    why = error
                    continue
                proofs.append(prove_plan(plan, spec, trials=trials))
    if not proofs and why is not None:
        raise why
    fastest = {}
    if with_fastest:
        for interpolation in interpolations:
            stepped(f"fastest {interpolation}")
            chosen = replace(options, interpolation=interpolation)
            fastest[interpolation] = fastest_job(
                job, machine, placement_spec(spec), chosen, trials=trials
            )
    return Comparison(proofs=tuple(proofs), fastest=fastest, refused=tuple(refused))
