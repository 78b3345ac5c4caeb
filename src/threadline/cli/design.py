"""``threadline design``: the smallest change to the machine that meets the specification."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import typer

from threadline.base.writing import together
from threadline.cli import option_parameters
from threadline.cli.arguments import (
    JobArgument,
    JsonOption,
    MachineOption,
    ReportOption,
    keep_inputs,
)
from threadline.cli.found import command_line, typed
from threadline.cli.output import check_outputs, print_json, print_table, progress_bar, say
from threadline.errors import OptionError
from threadline.proof.asked import Words, level_option
from threadline.proof.option_words import parse_width_s
from threadline.proof.pipeline import with_shaping
from threadline.report.design import (
    candidate_rows,
    change_rows,
    corners_title,
    design_sentence,
    gain_rows,
    write_design_report,
)
from threadline.search.design import Candidate, DesignResult, Wanted
from threadline.search.design import design as search_design
from threadline.search.design_files import spec_file, write_design
from threadline.verdict import Verdict, closing, verdict_rows

_MOST_WIDTHS = 6
_SEARCHED = "10 ms, 80 ms"  # smoothing, where none is given


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
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "--out",
            "-o",
            help="Write the machine here (.toml) and its specification beside it (.spec.toml).",
        ),
    ] = None


def design(
    job: JobArgument,
    machine: MachineOption,
    words: Words,
    seeking: Seeking,
    report: ReportOption = None,
    json: JsonOption = False,
) -> None:
    """Find the smallest change to the machine with which JOB is within specification.

    The [design] table of the machine file lists the parameters that may change, their bounds and
    their costs. The design is proved in twenty runs, as prove does by default; --nominal proves one
    run, --tolerances other machines as well.

    Exit status: 0 when a design was found, 1 when there is none within the bounds, 2 wrong input.

    Example: threadline design examples/stitcher-test-path.seam.toml -m stitcher -o found.toml
    """
    trials = words.trials()
    chosen = words.machine(machine)
    output = seeking.output
    if output is not None:
        if output.suffix != ".toml" or output.name.endswith(".spec.toml"):
            raise OptionError(
                f"{str(output)!r} is no name for a machine file",
                remedy="Give one that ends in .toml and not in .spec.toml.",
            )
        for file in (output, spec_file(output)):
            keep_inputs(file, job, chosen.file, *words.files())
    check_outputs(file=output, folder=report)
    plotted = _plotted(seeking.plot, tuple(chosen.design.parameters) if chosen.design else None)
    forward, contour = words.flag("feed_forward"), words.text("contour")
    smoothing_s = _widths_s(forward, words.text("smoothing"))
    if forward and contour is not None:
        raise OptionError(
            f"--contour {contour!r} bounds the path error of the motors, but with "
            "--feed-forward the loads follow the path, not the motors",
            remedy="Leave one of them out.",
        )
    # The search tries each smoothing width; the rest of the plan stays the same.
    options = words.options(job, feed_forward=False, smoothing=None, robust=None)
    if words.text("robust") is not None:
        options = replace(options, robust_share=words.options(smoothing=None).robust_share)
    with progress_bar(not json) as progress:
        result = search_design(
            job,
            chosen,
            with_shaping(words.spec(chosen), chosen, options),
            options,
            Wanted(
                trials=trials,
                corners=seeking.corners,
                plotted=plotted,
                smoothing_s=smoothing_s,
            ),
            progress,
        )
    written = []
    with together(output if result.found is not None else None):
        if output is not None and result.found is not None:
            written = write_design(result, result.found, output)
        page = None if report is None else write_design_report(result, report)
    as_typed = words.typed(spec=None, feed_forward=False, smoothing=None)
    again = _again(job, written, result, {**as_typed, **level_option(trials)})
    if json:
        print_json(_content(result, [str(p) for p in written], page) | {"command": again})
    else:
        _show(result)
        for path in written:
            say(f"Wrote {path}")
        if result.found is not None:
            say(f"To prove it: {again or 'write the machine with -o FILE.toml first'}")
        if page is not None:
            say(f"Report: {page}")
    raise typer.Exit(0 if result.found is not None else 1)


def _again(
    job: Path, written: list[Path], result: DesignResult, words: Mapping[str, str | Path | None]
) -> str | None:
    """Return the command that proves the written design; None if none was found or written."""
    if result.found is None or not written:
        return None
    smoothing_s = result.found.candidate.smoothing_s
    ahead = {}
    if smoothing_s is not None:
        ahead = {"--feed-forward": "", "--smoothing": f"{typed(smoothing_s * 1e3)} ms"}
    return command_line("prove", job, {"-m": written[0], **words, **ahead})


def _plotted(text: str | None, known: tuple[str, ...] | None) -> tuple[str, str] | None:
    if text is None or known is None:
        return None
    names = tuple(part.strip() for part in text.split(","))
    if len(names) != 2 or names[0] == names[1] or any(name not in known for name in names):
        raise OptionError(
            f"cannot plot {text[:60]!r}", remedy=f"Give two of {', '.join(known)}, with a comma."
        )
    return names[0], names[1]


def _widths_s(feed_forward: bool, text: str | None) -> tuple[float, ...]:
    """Return smoothing widths, in s: all between them are tried; none without feed-forward."""
    if not feed_forward:
        if text is not None:
            raise OptionError(
                f"--smoothing {text!r} needs feed-forward", remedy="Give --feed-forward too."
            )
        return ()
    parts = (_SEARCHED if text is None else text).split(",")
    widths = tuple(dict.fromkeys(parse_width_s(part.strip()) for part in parts))
    if len(widths) > _MOST_WIDTHS:
        raise OptionError(f"{len(widths)} smoothing widths, at most {_MOST_WIDTHS}")
    return widths


def _show(result: DesignResult) -> None:
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
    say(design_sentence(result))
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
        "what_binds": design_sentence(result),
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
