"""``threadline yield``: the share of machines within the tolerances that are in specification."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil, log
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from threadline import __version__
from threadline.base.arrays import finite
from threadline.base.progress import Progress
from threadline.base.writing import together
from threadline.cli import option_parameters
from threadline.cli.arguments import (
    JobsArgument,
    JsonOption,
    ReportOption,
    ThisMachineOption,
    keep_inputs,
)
from threadline.cli.output import (
    check_outputs,
    print_json,
    print_table,
    progress_bar,
    say,
    tell,
    warn,
)
from threadline.cli.search_text import command_line
from threadline.cli.yield_sharing import (
    Question,
    check_part_options,
    finish_part,
    part_identity,
    question_from_parts,
    question_from_words,
    record_of,
)
from threadline.cli.yield_tables import (
    Sensitivities,
    counted,
    sensitivities_of,
    sensitivity_content,
    set_content,
    show_sensitivities,
    show_set,
)
from threadline.commands.plan import Plan
from threadline.errors import OptionError
from threadline.proof.option_words import parse_yield
from threadline.proof.proof_hash import spec_sha256
from threadline.proof.request import Words
from threadline.proof.worst_machine import Worst, write_worst
from threadline.search.influence import MACHINES, CheapestSet, cheapest_set
from threadline.search.machine_yield import (
    CRITERION_HEADER,
    MachineYield,
    Yield,
    criterion_cells,
    limited_rows,
    planned_yield,
    quantile,
    yield_words,
)
from threadline.search.yield_parts import Part, PartFile, check_same, merged, parse_part
from threadline.search.yield_state import YieldState
from threadline.verdict import Spec
from threadline.verdict.each_run import CONFIDENCE, clopper_pearson
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
    part: Annotated[
        str | None,
        typer.Option(
            help='Judge only this part of the machines, "3/16", and write it to the file of '
            "--output: parts may be made on different computers."
        ),
    ] = None
    merge: Annotated[
        bool,
        typer.Option(
            "--merge",
            help="Merge the files of all parts, given in place of JOB, into the answer of one run. "
            "Job, machine and options are taken from the parts.",
        ),
    ] = False
    output: Annotated[
        Path | None,
        typer.Option("--output", "--out", "-o", help="With --part: write the part to this file."),
    ] = None


_VARIANTS, _SEED = Drawing().variants, Drawing().seed


def yield_(
    job: JobsArgument,
    *,
    machine: ThisMachineOption = None,
    words: Words,
    drawing: Drawing,
    report: ReportOption = None,
    json: JsonOption = False,
) -> None:
    """Draw machines within the tolerances of the machine file, and say how many are in spec.

    All machines get the commands of JOB as planned for the nominal machine. Encoders, friction and
    supply vary only within their own tolerances.

    Exit status: 0 when every drawn machine is in spec (with --at-least: when enough are; with
    --part: when the part is written), 1 when not, 2 wrong input.

    Example: threadline yield examples/x-180.prg -m lathe-winder --variants 1000
    """
    worst, at_least = drawing.worst, drawing.at_least
    yield_goal = None if at_least is None else parse_yield(at_least)
    part = _part(drawing, report)
    question = _question(job, machine, words, drawing)
    variants, seed = question.variants, question.seed
    chosen = question.words.machine(question.machine)
    _check_files(drawing, report, [*job, question.job, chosen.file, *question.words.files()])
    judged, judged_spec = planned_yield(question.words, question.job, chosen)
    if yield_goal is not None:
        _check_reachable(variants, yield_goal, at_least or "")
    warn(chosen, judged.plan.job, own_feed=question.words.options().own_feeds)
    with progress_bar(not json) as progress:
        found = _found(question, part, (judged, judged_spec), drawing.resume, progress)
        if part is not None and drawing.output is not None:
            record = record_of(question, part_identity(judged.plan, judged_spec), part)
            finish_part(drawing.output, record, found, json=json)
            raise typer.Exit(0)
        worst_machine = judged.worst(found, counted(progress, "looking for the worst machine"))
        sensitivities = sensitivities_of(judged, variants, seed, progress) if drawing.why else None
        is_enough = (
            found.passed == variants if yield_goal is None else found.interval[0] >= yield_goal
        )
        cheapest = None
        if yield_goal is not None and not is_enough:
            cheapest = _cheapest(judged, yield_goal, question, progress)
        level = Level.DRAWN
        drawn_from = judged.plan.machine
        ran = "" if drawn_from.sha256 == chosen.sha256 else f", run by {drawn_from.name}"
        title = f"{judged.plan.job.name} on {chosen.name}{ran}: {_words(found, level)}"
        with together(worst):
            if worst is not None:
                write_worst(drawn_from, worst_machine, worst, "yield")
            picture = None if report is None else _drawn(found, title, report)
    prove_command = command_line(
        "prove",
        question.job,
        {"-m": question.machine, **question.words.typed(), "--actual": worst, "--nominal": ""},
    )
    if json:
        extra: dict[str, Any] = {} if picture is None else {"report": str(picture)}
        extra |= {} if worst is None else {"command": prove_command}
        extra |= {} if cheapest is None else {"cheapest": set_content(cheapest, judged)}
        print_json(_content(found, worst_machine, judged, sensitivities, level) | extra)
        raise typer.Exit(0 if is_enough else 1)
    _show(found, worst_machine, judged, sensitivities, title)
    say(_words(found, level))
    if cheapest is not None:
        show_set(cheapest, judged, at_least or "")
    if worst is not None:
        say(f"Worst machine: {worst}, under the commands of {chosen.name}:")
        say(f"  {prove_command}")
    if picture is not None:
        say(f"Report: {picture}")
    raise typer.Exit(0 if is_enough else 1)


def _cheapest(
    judged: MachineYield, yield_goal: float, question: Question, progress: Progress
) -> CheapestSet:
    done = counted(progress, "looking for the cheapest set of tolerances")
    machine_count = MACHINES if judged.together else min(MACHINES, question.variants)
    return cheapest_set(judged, yield_goal, question.seed, machines=machine_count, done=done)


def _found(
    question: Question,
    part: Part | None,
    judged_and_spec: tuple[MachineYield, Spec],
    resume: Path | None,
    progress: Progress,
) -> Yield:
    """Return the results of all machines, drawn or merged, or of the machines of one part."""
    judged, judged_spec = judged_and_spec
    if question.parts:
        return _merged(question.parts, judged, judged_spec, progress)
    seed, variants, state = question.seed, question.variants, None
    machines = range(variants) if part is None else part.machines(variants)
    if resume is not None:
        part_entry = {} if part is None else {"part": f"{part} of {variants}"}
        state = _opened(resume, _identity(judged.plan, judged_spec, seed) | part_entry)
    done = counted(progress, "simulating and judging machines", len(machines))
    return judged.drawn(len(machines), seed, done, state, first=machines.start)


def _merged(
    parts: Sequence[PartFile], judged: MachineYield, judged_spec: Spec, progress: Progress
) -> Yield:
    """Return the answer of all parts, if job, machine and versions here equal the parts'."""
    identity = part_identity(judged.plan, judged_spec)
    for part in parts:
        present_record = replace(part.record, identity=identity)
        check_same(part, present_record, "this Threadline and the files here")
    return merged(parts, judged, counted(progress, "judging the first of each part", len(parts)))


def _part(drawing: Drawing, report: Path | None) -> Part | None:
    """Return the wanted part; None for the whole yield."""
    if drawing.part is None:
        if drawing.output is not None:
            raise OptionError(
                "--output is the file of a part, and there is no --part",
                remedy="Give --part, or --worst FILE for the worst machine.",
            )
        return None
    if drawing.merge:
        raise OptionError("--part and --merge exclude each other", remedy="Give one of them.")
    part = parse_part(drawing.part)
    part.machines(drawing.variants)  # refuses too few machines before a long plan
    whole = {
        "--why": drawing.why,
        "--at-least": drawing.at_least,
        "--worst": drawing.worst,
        "--report": report,
    }
    check_part_options(drawing.output, whole)
    return part


def _question(
    files: Sequence[Path], machine: str | None, words: Words, drawing: Drawing
) -> Question:
    """Return job, machine and options from the command line, or with --merge from the parts."""
    if not drawing.merge:
        return question_from_words(files, machine, words, drawing.variants, drawing.seed)
    given = {
        "--resume": drawing.resume,
        "--variants": None if drawing.variants == _VARIANTS else drawing.variants,
        "--seed": None if drawing.seed == _SEED else drawing.seed,
    }
    return question_from_parts(files, machine, words, given)


def _check_files(
    drawing: Drawing, report: Path | None, inputs: Sequence[Path | str | None]
) -> None:
    """Refuse outputs that would replace an input or each other, or that cannot be written."""
    worst, resume, output = drawing.worst, drawing.resume, drawing.output
    for file in (worst, output):
        keep_inputs(file, *inputs, resume)
    keep_inputs(resume, *inputs)
    check_outputs(file=worst, folder=report, worst=worst)
    check_outputs(file=resume)
    check_outputs(file=output)
    for name, file in ("--worst", worst), ("--output", output):
        if file is not None and resume is not None and file.resolve() == resume.resolve():
            raise OptionError(
                f"{name} and --resume are the same file {str(file)!r}", remedy="Name two files."
            )


def _drawn(found: Yield, title: str, folder: Path) -> Path:
    """Draw the histograms of a yield into a folder; return the path of the picture."""
    from threadline.report.searches import write_yield  # slow to import: it draws

    return write_yield(found, title, folder)


def _check_reachable(variants: int, yield_goal: float, text: str) -> None:
    """Refuse a wanted yield that so few machines cannot prove, even if all are in spec."""
    best = clopper_pearson(variants, variants)[0]
    if best < yield_goal:
        tail = 0.5 * (1.0 - CONFIDENCE)
        raise OptionError(
            f"--at-least {text!r} cannot be proved by {variants} machines: if all of them are in "
            f"spec, at least {100.0 * best:.4g} % of all are",
            remedy=f"Draw more: --variants {ceil(log(tail) / log(yield_goal))}.",
        )


def _opened(file: Path, identity: dict[str, str]) -> YieldState:
    """Return the results already in ``file``; warn if its last line was cut short."""
    state = YieldState(file, identity)
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
    by_reason: dict[str, list[str]] = {}
    for name, why in reasons.items():
        by_reason.setdefault(why, []).append(name)
    return by_reason


def _show(
    found: Yield,
    bad: Worst,
    judged: MachineYield,
    sensitivities: Sensitivities | None,
    title: str,
) -> None:
    print_table(title, CRITERION_HEADER, [*map(criterion_cells, limited_rows(found))])
    if sensitivities is not None:
        show_sensitivities(sensitivities, judged)
    how = "of all corners" if bad.of_corners else "found by steps from the worst drawn"
    say(f"worst machine, {how}: {bad.used}")
    if judged.left_out:
        say(f"not judged, because it compares runs of one machine: {', '.join(judged.left_out)}")
    for why, names in grouped(judged.same).items():
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
        "not_drawn": judged.same,
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
