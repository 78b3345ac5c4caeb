"""``threadline yield``: the share of machines within the tolerances that are in specification."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, log
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from threadline import __version__
from threadline.base.arrays import finite
from threadline.base.writing import together
from threadline.cli import option_parameters
from threadline.cli.arguments import (
    JobArgument,
    JsonOption,
    MachineOption,
    ReportOption,
    keep_inputs,
)
from threadline.cli.found import command_line
from threadline.cli.output import check_outputs, print_json, print_table, progress_bar, say
from threadline.cli.warn import tell, warn
from threadline.cli.yield_tables import (
    Sensitivities,
    counted,
    sensitivities_of,
    sensitivity_content,
    set_content,
    show_sensitivities,
    show_set,
    yield_words,
)
from threadline.commands.plan import Plan
from threadline.errors import OptionError
from threadline.machine.variants import not_drawn
from threadline.proof.asked import Words
from threadline.proof.option_words import parse_yield
from threadline.proof.pipeline import check_machine, open_job, plan_job, with_product
from threadline.proof.proof_file import spec_sha256
from threadline.proof.worst_machine import Worst, worst_toml
from threadline.search.influence import MACHINES, cheapest_set
from threadline.search.machine_yield import (
    MachineYield,
    Yield,
    limited_rows,
    quantile,
)
from threadline.search.yield_state import YieldState
from threadline.verdict import CriterionRow, Spec
from threadline.verdict.each_run import CONFIDENCE, clopper_pearson
from threadline.verdict.rendering import shown
from threadline.verdict.types import Level


@dataclass(frozen=True, slots=True, kw_only=True)
class Drawing:
    """Options of ``threadline yield``: sample size, seed, sensitivity, wanted yield, files."""

    variants: Annotated[
        int, typer.Option(min=1, max=10_000_000, help="How many machines are drawn.")
    ] = 10_000
    seed: Annotated[int, typer.Option(min=0, help="Random seed of the drawn machines.")] = 1
    why: Annotated[
        bool,
        typer.Option(
            "--why",
            help="Also print what the yield depends on: the share of each tolerance in the "
            "variance, and the yield with that tolerance halved.",
        ),
    ] = False
    at_least: Annotated[
        str | None,
        typer.Option(
            help='The yield wanted, "99 %": if the lower end of the confidence interval is below '
            "it, the cheapest set of tolerances that reaches it is searched."
        ),
    ] = None
    worst: Annotated[
        Path | None,
        typer.Option(help="Write the worst machine found to this machine file."),
    ] = None
    resume: Annotated[
        Path | None,
        typer.Option(help="Keep the results of the machines in this file, and resume from it."),
    ] = None


def yield_(
    job: JobArgument,
    machine: MachineOption,
    words: Words,
    drawing: Drawing,
    report: ReportOption = None,
    json: JsonOption = False,
) -> None:
    """Draw machines within the tolerances of the machine file, and say how many are in spec.

    All machines get the commands of JOB as planned for the nominal machine. Encoders, friction and
    supply vary only within their own tolerances.

    Exit status: 0 when every drawn machine is in spec (with --at-least: when enough are), 1 when
    not, 2 wrong input.

    Example: threadline yield examples/x-180.prg -m lathe-winder --variants 1000
    """
    variants, seed, worst, resume = drawing.variants, drawing.seed, drawing.worst, drawing.resume
    at_least = drawing.at_least
    wanted = None if at_least is None else parse_yield(at_least)
    chosen = words.machine(machine)
    _check_files(worst, resume, report, [job, chosen.file, *words.files()])
    options = words.options()
    check_machine(chosen)
    plan = plan_job(open_job(job, chosen, options), chosen, options)
    asked = with_product(words.spec(chosen), chosen, options)
    judged = MachineYield(plan, asked)
    if wanted is not None:
        _check_reachable(variants, wanted, at_least or "")
    warn(chosen, plan.job, own_feed=options.own_feeds)
    state = None if resume is None else _opened(resume, plan, asked, seed)
    with progress_bar(not json) as progress:
        found = judged.drawn(
            variants, seed, counted(progress, "simulating and judging machines", variants), state
        )
        bad = judged.worst(found, counted(progress, "looking for the worst machine"))
        sensitivities = sensitivities_of(judged, variants, seed, progress) if drawing.why else None
        enough = found.passed == variants if wanted is None else found.interval[0] >= wanted
        better = None
        if wanted is not None and not enough:
            told_set = counted(progress, "looking for the cheapest set of tolerances")
            machines = MACHINES if judged.together else min(MACHINES, variants)
            better = cheapest_set(judged, wanted, seed, machines=machines, done=told_set)
        level = Level.DRAWN
        title = f"{plan.job.name} on {chosen.name}: {_words(found, level)}"
        drawn = None
        with together(worst):
            if worst is not None:
                worst.write_text(worst_toml(chosen, bad, worst.parent, "yield"), encoding="utf-8")
            if report is not None:
                drawn = _drawn(found, title, report)
    again = command_line(
        "prove", job, {"-m": machine, "--actual": worst, **words.typed(), "--nominal": ""}
    )
    if json:
        more: dict[str, Any] = {} if drawn is None else {"report": str(drawn)}
        more |= {} if worst is None else {"command": again}
        more |= {} if better is None else {"cheapest": set_content(better, judged)}
        print_json(_content(found, bad, judged, sensitivities, level) | more)
    else:
        _show(found, bad, judged, sensitivities, title)
        say(_words(found, level))
        if better is not None:
            show_set(better, judged, at_least or "")
        if worst is not None:
            say(f"Worst machine: {worst}, under the commands of {chosen.name}:")
            say(f"  {again}")
        if drawn is not None:
            say(f"Report: {drawn}")
    raise typer.Exit(0 if enough else 1)


def _check_files(
    worst: Path | None,
    resume: Path | None,
    report: Path | None,
    inputs: Sequence[Path | str | None],
) -> None:
    """Refuse outputs that would replace an input or each other, or that cannot be written."""
    keep_inputs(worst, *inputs, resume)
    keep_inputs(resume, *inputs)
    check_outputs(file=worst, folder=report)
    check_outputs(file=resume)
    if worst is not None and resume is not None and worst.resolve() == resume.resolve():
        raise OptionError(
            f"--worst and --resume are the same file {str(worst)!r}", remedy="Name two files."
        )


def _drawn(found: Yield, title: str, folder: Path) -> Path:
    """Draw the histograms of a yield into a folder; return the path of the picture."""
    from threadline.report.searches import write_yield  # slow to import: it draws

    return write_yield(found, title, folder)


def _check_reachable(variants: int, wanted: float, text: str) -> None:
    """Refuse a wanted yield that so few machines cannot prove, even if all are in spec."""
    best = clopper_pearson(variants, variants)[0]
    if best < wanted:
        tail = 0.5 * (1.0 - CONFIDENCE)
        raise OptionError(
            f"--at-least {text!r} cannot be proved by {variants} machines: if all of them are in "
            f"spec, at least {100.0 * best:.4g} % of all are",
            remedy=f"Draw more: --variants {ceil(log(tail) / log(wanted))}.",
        )


def _opened(file: Path, plan: Plan, spec: Spec, seed: int) -> YieldState:
    """Return the results already in ``file``; warn if its last line was cut short."""
    state = YieldState(file, _identity(plan, spec, seed))
    if state.cut:
        tell([f"{file.name}: its last line was cut short; that machine is simulated again"])
    return state


def _identity(plan: Plan, spec: Spec, seed: int) -> dict[str, str]:
    """Return everything that the results depend on: a file with other values is refused."""
    return {
        "job": plan.job.sha256,
        "machine": plan.machine.sha256,
        "spec": spec_sha256(spec),
        "plan": plan.commands.rows_sha256(),
        "seed": str(seed),
        "version of threadline": __version__,
    }


def _words(found: Yield, level: Level) -> str:
    """Return the count in spec, its confidence interval and the level, in words."""
    text = f"{found.passed} of {found.found.runs} machines in spec, {yield_words(found.interval)}"
    return f"{text} of all ({level}: one run of each)"


def grouped(reasons: dict[str, str]) -> dict[str, list[str]]:
    """Return names grouped by their reason.

    >>> grouped({"a": "exact", "b": "far", "c": "exact"})
    {'exact': ['a', 'c'], 'far': ['b']}
    """
    found: dict[str, list[str]] = {}
    for name, why in reasons.items():
        found.setdefault(why, []).append(name)
    return found


def _row(row: CriterionRow) -> list[str]:
    assert row.limit is not None
    values = [quantile(row, share) for share in (0.5, 0.99, 1.0)]
    told = ["-" if np.isnan(value) else shown(value, row.unit) for value in values]
    out = f"{int((row.failed | row.missed).sum())}"
    return [row.text, *told, shown(row.limit, row.unit), out]


def _show(
    found: Yield,
    bad: Worst,
    judged: MachineYield,
    sensitivities: Sensitivities | None,
    title: str,
) -> None:
    header = ["criterion", "half up to", "99 % up to", "most", "limit", "failed"]
    print_table(title, header, [_row(row) for row in limited_rows(found)])
    if sensitivities is not None:
        show_sensitivities(sensitivities, judged)
    how = "of all corners" if bad.of_corners else "found by steps from the worst drawn"
    say(f"worst machine, {how}: {bad.used}")
    if judged.left_out:
        say(f"not judged, because it compares runs of one machine: {', '.join(judged.left_out)}")
    for why, names in grouped(not_drawn(judged.plan.machine)).items():
        say(f"the same in every machine, {why}: {', '.join(names)}")


def _content(
    found: Yield,
    bad: Worst,
    judged: MachineYield,
    sensitivities: Sensitivities | None,
    level: Level,
) -> dict[str, Any]:
    low, high = found.interval
    content: dict[str, Any] = {
        "level": level.value,
        "runs": 1,
        "variants": found.found.runs,
        "seed": found.seed,
        "passed": found.passed,
        "yield": found.share,
        "interval": [low, high],
        "confidence": 0.95,
        "not_judged": list(judged.left_out),
        "not_drawn": not_drawn(judged.plan.machine),
        "criteria": [
            {
                "name": row.name,
                "axis": row.axis,
                "limit": row.limit,
                "unit": row.unit,
                "failed": int(row.failed.sum()),
                "not_measured": int(np.isnan(row.values).sum()),
                "quantiles": {
                    str(q): finite(quantile(row, q)) for q in (0.5, 0.9, 0.99, 0.999, 1.0)
                }
                if not np.isnan(row.values).all()
                else {},
            }
            for row in limited_rows(found)
        ],
        "worst": {
            "share_of_limit": bad.share if np.isfinite(bad.share) and not bad.beyond_zero else None,
            "criterion": bad.binding,
            "measured": None if bad.row is None else finite(float(bad.row.values[0])),
            "limit": None if bad.row is None else bad.row.limit,
            "of_corners": bad.of_corners,
            "numbers": bad.numbers,
        },
    }
    if sensitivities is not None:
        content["why"] = sensitivity_content(sensitivities, judged)
    return content


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    option_parameters.add(app, "yield", yield_)
