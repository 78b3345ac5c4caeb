"""``threadline design``: the smallest change to the machine that meets the specification."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from threadline.base.writing import check_machine_name, together
from threadline.cli import option_parameters
from threadline.cli.arguments import (
    JobsArgument,
    JsonOption,
    ReportOption,
    ThisMachineOption,
    keep_inputs,
)
from threadline.cli.design_sharing import (
    DesignRequest,
    design_of_parts,
    make_part,
    merged_design,
    tell_part,
)
from threadline.cli.output import check_outputs, print_json, print_table, progress_bar, say
from threadline.cli.search_text import command_line, typed
from threadline.cli.yield_sharing import check_part_options, question_from_words
from threadline.errors import OptionError
from threadline.proof.request import Words, level_option
from threadline.report.design import (
    candidate_rows,
    change_rows,
    corners_title,
    front_rows,
    front_title,
    gain_rows,
    write_design_report,
)
from threadline.search.design import DesignResult, spec_file, write_design
from threadline.search.design import design as search_design
from threadline.search.design_parts import searches_of
from threadline.search.design_proof import Candidate
from threadline.search.design_question import MOST_FRONT, DesignAims, design_question
from threadline.search.design_searches import MOST_SEARCHES
from threadline.search.yield_parts import Part, parse_part
from threadline.verdict import Verdict, closing, verdict_rows


@dataclass(frozen=True, slots=True, kw_only=True)
class Seeking:
    """Options of ``threadline design``: required tolerances, region plot, output file."""

    corners: Annotated[
        bool,
        typer.Option(
            "--corners",
            help="The design must also hold at every corner of the tolerances of [design].",
        ),
    ] = False
    plot: Annotated[
        str | None, typer.Option(help='Plot the feasible region over two parameters: "belt,load".')
    ] = None
    front: Annotated[
        int,
        typer.Option(
            min=0,
            max=MOST_FRONT,
            help="Draw this many machines within the tolerances of each candidate that trades cost "
            "for margin, and give the front of cost against yield; 0: none.",
        ),
    ] = 0
    searches: Annotated[
        int,
        typer.Option(
            min=1,
            max=MOST_SEARCHES,
            help="Number of searches, each from other random numbers; the best design counts. "
            "With --part: by default the number of parts.",
        ),
    ] = 1
    part: Annotated[
        str | None,
        typer.Option(
            help='Make only this part of the searches, "3/16", and write it to the file of '
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
        typer.Option(
            "--output",
            "--out",
            "-o",
            help="Write the machine here (.toml) and its specification beside it (.spec.toml); "
            "with --part, the part.",
        ),
    ] = None


def design(
    job: JobsArgument,
    *,
    machine: ThisMachineOption = None,
    words: Words,
    seeking: Seeking,
    report: ReportOption = None,
    json: JsonOption = False,
) -> None:
    """Find the smallest change to the machine with which JOB is within specification.

    The [design] table of the machine file lists the parameters that may change, their bounds and
    their costs. The design is proved in twenty runs, as prove does by default; --nominal proves one
    run, --tolerances other machines as well.

    Exit status: 0 when a design was found (with --part: when the part is written), 1 when there is
    none within the bounds, 2 wrong input.

    Example: threadline design examples/stitcher-test-path.seam.toml -m stitcher -o found.toml
    """
    part = _part(seeking, report)
    request = _asked(job, machine, words, seeking, part)
    words, job_file = request.words, request.job
    chosen = words.machine(request.machine)
    output = seeking.output
    _check_output(output, [*job, job_file, chosen.file, *words.files()], part)
    check_outputs(file=output, folder=report)
    question = design_question(words, job_file, chosen, request.aims)
    trials = question.requirements.trials
    with progress_bar(not json) as progress:
        if part is not None and output is not None:
            record = make_part(output, part, request, question, progress)
            tell_part(output, record, json=json)
            raise typer.Exit(0)
        if request.parts:
            result = merged_design(request.parts, question, progress)
        else:
            result = search_design(
                job_file, chosen, question.spec, question.options, question.requirements, progress
            )
    written = []
    with together(output if result.found is not None else None):
        if output is not None and result.found is not None:
            written = write_design(result, result.found, output)
        page = None if report is None else write_design_report(result, report)
    as_typed = words.typed(spec=None, feed_forward=False, smoothing=None)
    prove_command = _prove_command(job_file, written, result, {**as_typed, **level_option(trials)})
    if json:
        print_json(_content(result, [str(p) for p in written], page) | {"command": prove_command})
    else:
        show_design(result)
        for path in written:
            say(f"Wrote {path}")
        if result.found is not None:
            say(f"To prove it: {prove_command or 'write the machine with -o FILE.toml first'}")
        if page is not None:
            say(f"Report: {page}")
    raise typer.Exit(0 if result.found is not None else 1)


def _part(seeking: Seeking, report: Path | None) -> Part | None:
    """Return the wanted part; None for the whole redesign."""
    if seeking.part is None:
        return None
    if seeking.merge:
        raise OptionError("--part and --merge exclude each other", remedy="Give one of them.")
    part = parse_part(seeking.part)
    whole_only = {"--plot": seeking.plot, "--report": report}
    check_part_options(seeking.output, whole_only, "redesign", "searches")
    return part


def _asked(
    files: Sequence[Path], machine: str | None, words: Words, seeking: Seeking, part: Part | None
) -> DesignRequest:
    """Return job, machine and options from the command line, or with --merge from the parts."""
    searches = seeking.searches
    if part is not None:
        searches = part.count if searches == 1 else searches
        searches_of(part, searches)  # raises an error if there are fewer searches than parts
    aims = DesignAims(
        corners=seeking.corners, plot=seeking.plot, front=seeking.front, searches=searches
    )
    if seeking.merge:
        return design_of_parts(files, machine, words, aims)
    question = question_from_words(files, machine, words)
    return DesignRequest(job=question.job, machine=question.machine, words=words, aims=aims)


def _check_output(
    output: Path | None, inputs: Sequence[Path | str | None], part: Part | None
) -> None:
    """Refuse an output that would replace an input, or that is not the name of a machine file."""
    if output is None:
        return
    if part is not None:
        keep_inputs(output, *inputs)
        return
    check_machine_name(output)
    for file in (output, spec_file(output)):
        keep_inputs(file, *inputs)


def _prove_command(
    job: Path, written: list[Path], result: DesignResult, words: Mapping[str, str | Path | None]
) -> str | None:
    """Return the command that proves the written design; None if none was found or written."""
    if result.found is None or not written:
        return None
    smoothing_s = result.found.candidate.smoothing_s
    feed_forward = {}
    if smoothing_s is not None:
        feed_forward = {"--feed-forward": "", "--smoothing": f"{typed(smoothing_s * 1e3)} ms"}
    return command_line("prove", job, {"-m": written[0], **words, **feed_forward})


def show_design(result: DesignResult) -> None:
    """Print the smallest change, its proof, and the other machines that were found."""
    title = f"{result.job.name} on {result.machine.name}"
    if result.found is not None:
        print_table(f"{title}: the smallest change", *change_rows(result))
        print_table("Settings that go with it", *gain_rows(result.found))
        print_table("Verdict, proved by the whole pipeline", *verdict_rows(result.found.verdict))
        if result.found.corners is not None:
            title = corners_title(result.found.corners)
            print_table(title, *verdict_rows(result.found.corners))
        say(closing(result.found.verdict))
    print_table("Cost against margin, and other machines", *candidate_rows(result))
    if result.front:
        print_table(front_title(result), *front_rows(result))
    say(result.sentence())
    say(f"{result.simulated} machines simulated")


def _content(result: DesignResult, written: list[str], page: Path | None) -> dict[str, Any]:
    found = result.found
    content: dict[str, Any] = {
        "found": None,
        "level": result.level.value,
        "screened": result.screened,
        "as_built": _candidate(result.as_built),
        "nearest": _candidate(result.nearest),
        "known": {name: _candidate(c) for name, c in result.known.items()},
        "pareto": [_candidate(c) for c in result.pareto],
        "what_binds": result.sentence(),
        "refused": list(result.refused),
        "simulated": result.simulated,
        "written": written,
    }
    if found is not None:
        content["found"] = {
            **_candidate(found.candidate),
            "passed": found.verdict.passed,
            "level": found.verdict.level.value,
            "runs": found.verdict.runs,
            "machines": found.verdict.machines,
            "numbers": dict(found.numbers),
            "worst": _worst(found.verdict),
            "worst_at_corners": None if found.corners is None else _worst(found.corners),
        }
    if result.region is not None:
        region = result.region
        content["region"] = {
            "parameters": list(region.names),
            "factors": [line.tolist() for line in region.factors],
            "ratio": region.found.tolist(),
            "ratio_others_unchanged": region.unchanged.tolist(),
        }
    if result.front:
        content["front"] = [
            {
                "cost": one.cost,
                "factors": dict(one.factors),
                "machines": one.machines,
                "passed": one.passed,
                "yield": one.share,
                "interval": list(one.interval),
                "on_front": one.on_front,
            }
            for one in result.front
        ]
    if page is not None:
        content["report"] = str(page)
    return content


def _worst(verdict: Verdict) -> dict[str, float | None]:
    return {
        f"{r.name} {r.axis}".strip(): r.measured for r in verdict.results if r.limit is not None
    }


def _candidate(candidate: Candidate) -> dict[str, Any]:
    return {
        "factors": dict(candidate.factors),
        "cost": candidate.cost,
        "share_of_limit": candidate.ratio,
        "share_of_limit_nominal": candidate.nominal,
        "binding": candidate.binding,
        "crossover_hz": candidate.crossover_hz,
        "phase_margin_deg": candidate.phase_margin_deg,
        "acceleration": candidate.acceleration,
        "smoothing_s": candidate.smoothing_s,
        "needle_delay_s": candidate.delay_s,
    }


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    option_parameters.add(app, "design", design)
