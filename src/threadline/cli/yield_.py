"""``threadline yield``: which share of the machines within the tolerances is in specification."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from threadline import __version__
from threadline.cli.cheapest import set_content, show_set
from threadline.cli.level import parse_yield
from threadline.cli.output import print_json, print_table, progress_bar, say
from threadline.cli.outputs import check_outputs
from threadline.cli.shared_options import (
    DEFAULT_INTERPOLATION_TEXT,
    DEFAULT_LIMITS_TEXT,
    DEFAULT_TOLERANCE_TEXT,
    FeedForwardOption,
    FeedOption,
    InterpolationOption,
    JobArgument,
    JsonOption,
    LawOption,
    LimitsOption,
    MachineOption,
    ParOption,
    ReportOption,
    RobustOption,
    SmoothingOption,
    SpecOption,
    ToleranceOption,
    keep_inputs,
    machine_from,
    options_of,
)
from threadline.cli.warn import tell, warn
from threadline.errors import OptionError
from threadline.pipeline import check_machine, open_job, plan_job
from threadline.plan import Plan
from threadline.proof_file import spec_sha256
from threadline.report.machine_yield import limited_rows, write_yield
from threadline.search.cheapest_set import cheapest_set
from threadline.search.influence import Influence, influence
from threadline.search.machine_yield import MachineYield, Worst, Yield, shares_of, worst_toml
from threadline.search.yield_state import YieldState
from threadline.verdict import CriterionRow, Spec, load_spec
from threadline.verdict.rendering import shown
from threadline.writing import together

_WHY_MACHINES = 2000
_WHY_SAMPLES = 256


def yield_(
    job: JobArgument,
    machine: MachineOption,
    spec: SpecOption = None,
    variants: Annotated[
        int, typer.Option(min=1, max=10_000_000, help="How many machines are drawn.")
    ] = 10_000,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the drawn machines.")] = 1,
    interpolation: InterpolationOption = DEFAULT_INTERPOLATION_TEXT,
    law: LawOption = None,
    feed: FeedOption = None,
    tolerance: ToleranceOption = DEFAULT_TOLERANCE_TEXT,
    limits: LimitsOption = DEFAULT_LIMITS_TEXT,
    feed_forward: FeedForwardOption = False,
    smoothing: SmoothingOption = None,
    robust: RobustOption = None,
    par: ParOption = None,
    why: Annotated[
        bool,
        typer.Option(
            "--why",
            help="Also tell what the yield depends on: the share of each number in the variance, "
            "and the yield with its tolerance halved.",
        ),
    ] = False,
    at_least: Annotated[
        str | None,
        typer.Option(
            help='The yield wanted, "99 %": where the lower end of the interval is below it, the '
            "cheapest set of tolerances that reaches it is searched."
        ),
    ] = None,
    worst: Annotated[
        Path | None,
        typer.Option(help="Write the worst machine found to this machine file."),
    ] = None,
    resume: Annotated[
        Path | None,
        typer.Option(
            help="Keep the results of the machines in this file, and go on from those it has."
        ),
    ] = None,
    report: ReportOption = None,
    json: JsonOption = False,
) -> None:
    """Draw machines within the tolerances of the machine file, and say how many are in spec.

    All get the commands of JOB as planned for the machine as its file says. Encoders, friction and
    supply are nominal but for their own tolerances.

    Exit status: 0 when every machine that was drawn is in spec (with --at-least: when so many are),
    1 when not, 2 wrong input.

    Example: threadline yield examples/x-180.prg -m lathe-winder --variants 1000
    """
    wished = None if at_least is None else parse_yield(at_least)
    chosen = machine_from(machine, par)
    keep_inputs(worst, job, chosen.file, par, spec, resume)
    keep_inputs(resume, job, chosen.file, par, spec)
    check_outputs(file=worst, folder=report)
    check_outputs(file=resume)
    if worst is not None and resume is not None and worst.resolve() == resume.resolve():
        raise OptionError(
            f"--worst and --resume are the same file {str(worst)!r}", remedy="Name two files."
        )
    options = options_of(
        interpolation,
        feed,
        tolerance,
        limits,
        feed_forward=feed_forward,
        smoothing=smoothing,
        law=law,
        robust=robust,
    )
    check_machine(chosen)
    plan = plan_job(open_job(job, chosen, options), chosen, options)
    asked = load_spec(spec, chosen)
    judged = MachineYield(plan, asked)
    warn(chosen, plan.job)
    state = None if resume is None else _opened(resume, plan, asked, seed)
    through = 0
    with progress_bar(not json) as progress:

        def done(count: int) -> None:
            nonlocal through
            through += count
            progress("simulating and judging machines", min(through / variants, 1.0))

        found = judged.drawn(variants, seed, done, state)
        bad = judged.worst(found)
        hangs = _why(judged, seed) if why else None
        enough = found.passed == variants if wished is None else found.interval[0] >= wished
        better = None if wished is None or enough else cheapest_set(judged, wished, seed)
        title = f"{plan.job.name} on {chosen.name}: {_words(found)}"
        drawn = None
        with together(worst):
            if worst is not None:
                worst.write_text(worst_toml(chosen, bad, chosen.reference), encoding="utf-8")
            if report is not None:
                drawn = write_yield(found, title, report)
    if json:
        told: dict[str, Any] = {} if drawn is None else {"report": str(drawn)}
        if better is not None:
            told |= {"cheapest": set_content(better, judged)}
        print_json(_content(found, bad, judged, hangs) | told)
    else:
        _show(found, bad, judged, hangs, title)
        if better is not None:
            show_set(better, judged, at_least or "")
        if worst is not None:
            say(f"Worst machine: {worst}")
        if drawn is not None:
            say(f"Report: {drawn}")
    raise typer.Exit(0 if enough else 1)


def _opened(file: Path, plan: Plan, spec: Spec, seed: int) -> YieldState:
    """Return the results that ``file`` has already; warn if its last line was cut short."""
    state = YieldState(file, _identity(plan, spec, seed))
    if state.cut:
        tell([f"{file.name}: its last line was cut short, and is worked out again"])
    return state


def _identity(plan: Plan, spec: Spec, seed: int) -> dict[str, str]:
    """Return all that the results depend on: a file with other values is refused."""
    return {
        "job": plan.job.sha256,
        "machine": plan.machine.sha256,
        "spec": spec_sha256(spec),
        "plan": plan.commands.rows_sha256(),
        "seed": str(seed),
        "version of threadline": __version__,
    }


def _why(judged: MachineYield, seed: int) -> tuple[Influence, np.ndarray, float]:
    """Return Sobol indices of the share that is used most, and yields with tolerances halved."""

    def result(parts: np.ndarray) -> np.ndarray:
        shares, _ = shares_of(judged.judged(parts))
        return np.minimum(shares, 10.0)

    normal = [number.normal for number in judged.numbers]
    indices = influence(result, normal, _WHY_SAMPLES, seed)
    own = judged.drawn(_WHY_MACHINES, seed).share
    return indices, judged.halved(_WHY_MACHINES, seed), own


def _words(found: Yield) -> str:
    low, high = found.interval
    text = f"{found.passed} of {found.found.runs} machines in spec"
    if found.passed == found.found.runs:
        return f"{text}, at least {100.0 * low:.5g} % of all"
    return f"{text}, {100.0 * low:.4g} to {100.0 * high:.4g} % of all"


def _row(row: CriterionRow) -> list[str]:
    known = row.values[np.isfinite(row.values)]
    middle, late, most = (
        (shown(float(np.quantile(known, q)), row.unit) for q in (0.5, 0.99, 1.0))
        if len(known)
        else ("-", "-", "-")
    )
    assert row.limit is not None
    return [row.text, middle, late, most, shown(row.limit, row.unit), f"{int(row.failed.sum())}"]


def _show(
    found: Yield,
    bad: Worst,
    judged: MachineYield,
    hangs: tuple[Influence, np.ndarray, float] | None,
    title: str,
) -> None:
    header = ["criterion", "half up to", "99 % up to", "most", "limit", "failed"]
    print_table(title, header, [_row(row) for row in limited_rows(found)])
    if hangs is not None:
        indices, halves, own = hangs
        rows = [
            [
                number.name,
                f"{indices.first[k]:.2f}",
                f"{indices.total[k]:.2f}",
                f"{100.0 * halves[k]:.2f} %",
            ]
            for k, number in enumerate(judged.numbers)
        ]
        rows.sort(key=lambda row: -float(row[2]))
        head = ["number", "alone", "with others", "yield if halved"]
        own_words = f"of {_WHY_MACHINES} machines {own:.2%} in spec"
        print_table(f"what the yield depends on; {own_words}", head, rows)
    how = "of all corners" if bad.of_corners else "found by steps from the worst drawn"
    uses = f"{100.0 * bad.share:.1f} % of {bad.binding}"
    if not np.isfinite(bad.share):
        uses = "it cannot be simulated, or never ends what it waits for"
    say(f"worst machine, {how}: {uses}")
    say(_words(found))


def _content(
    found: Yield,
    bad: Worst,
    judged: MachineYield,
    hangs: tuple[Influence, np.ndarray, float] | None,
) -> dict[str, Any]:
    low, high = found.interval
    content: dict[str, Any] = {
        "variants": found.found.runs,
        "seed": found.seed,
        "passed": found.passed,
        "yield": found.share,
        "interval": [low, high],
        "confidence": 0.95,
        "criteria": [
            {
                "name": row.name,
                "axis": row.axis,
                "limit": row.limit,
                "unit": row.unit,
                "failed": int(row.failed.sum()),
                "quantiles": {
                    str(q): float(np.quantile(row.values[np.isfinite(row.values)], q))
                    for q in (0.5, 0.9, 0.99, 0.999, 1.0)
                }
                if np.isfinite(row.values).any()
                else {},
            }
            for row in limited_rows(found)
        ],
        "worst": {
            "share_of_limit": bad.share if np.isfinite(bad.share) else None,
            "criterion": bad.binding,
            "of_corners": bad.of_corners,
            "numbers": bad.numbers,
        },
    }
    if hangs is not None:
        indices, halves, own = hangs
        content["why"] = {
            "machines": _WHY_MACHINES,
            "yield": own,
            "numbers": [
                {
                    "name": number.name,
                    "first": float(indices.first[k]),
                    "first_interval": indices.first_interval[:, k].tolist(),
                    "total": float(indices.total[k]),
                    "total_interval": indices.total_interval[:, k].tolist(),
                    "yield_if_halved": float(halves[k]),
                }
                for k, number in enumerate(judged.numbers)
            ],
        }
    return content


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    app.command("yield")(yield_)
