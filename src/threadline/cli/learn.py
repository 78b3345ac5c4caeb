"""``threadline learn``: repeat a job and learn from the error of every run."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Annotated

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
from threadline.cli.output import check_outputs, print_json, print_table, progress_bar, say, tell
from threadline.cli.runs_ import DEFAULT_STORE, StoreOption
from threadline.cli.search_text import command_line
from threadline.errors import OptionError, StoreError
from threadline.files import Recording
from threadline.live.store.run_store import TRACE, opened
from threadline.live.store.whole_trace import whole_recording
from threadline.proof.recorded import warnings_of
from threadline.proof.request import Words, level_option
from threadline.search.learn import REPEATS
from threadline.search.learned_job import (
    LearnedJob,
    LearnedRuns,
    check_table_file,
    learned_from,
    learned_on_twins,
    refuse_simulated,
    rules_of,
    typed_options,
)
from threadline.search.repeats import GAIN, Rules
from threadline.verdict import closing


class Measured(StrEnum):
    """Where the error is measured."""

    HEAD = "head"
    MOTOR = "motor"


@dataclass(frozen=True, slots=True, kw_only=True)
class Learning:
    """Options of ``threadline learn``: repeats, gain, filter, sensor, runs, table."""

    repeats: Annotated[int, typer.Option(min=1, max=100, help="How often the job is repeated.")] = (
        REPEATS
    )
    gain: Annotated[
        str, typer.Option(help="Share of the error that is corrected after each run.")
    ] = f"{100 * GAIN:g} %"
    low_pass: Annotated[
        str | None,
        typer.Option(
            help='Errors above this frequency are not learned: "20 Hz". Default: the lowest '
            "frequency at which the loop answers with a tenth of its reference."
        ),
    ] = None
    measured: Annotated[
        Measured,
        typer.Option(help="Where the error is measured: at the head, or at the motor's encoder."),
    ] = Measured.HEAD
    runs: Annotated[
        list[str] | None,
        typer.Option(
            "--from",
            help="Learn from this run instead of a simulated machine: a recording, or the name of "
            "a run of the store (last); several in their order. A run that got worse is undone.",
        ),
    ] = None
    store: StoreOption = DEFAULT_STORE
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "--out", "-o", help="Write the learned table to this file (.npz, .csv)."
        ),
    ] = None


def learn(
    job: JobArgument,
    machine: MachineOption,
    learning: Learning,
    words: Words,
    report: ReportOption = None,
    json: JsonOption = False,
) -> None:
    """Repeat JOB and correct its references by the error of every run.

    After each run the references move by a share of the error, through the inverse of the machine's
    model. A run that got worse is undone. With -o the best table is written: prove, run and compile
    play it with --table FILE.

    Exit status: 0 in spec, 1 out of spec, 2 wrong input.

    Example: threadline learn examples/stitcher-even.seam.toml -m stitcher --feed-forward --robust
    "0 %" --needle "65 stitch/s" --ends "100 %"

    From runs of a machine: threadline learn seam.toml -m stitcher --from last -o learned.npz
    """
    rules = rules_of(learning.gain, learning.low_pass, learning.measured.value)
    output = learning.output
    keep_inputs(output, job, words.machine(machine).file, *words.files(), words.path("table"))
    check_outputs(file=output, folder=report)
    if output is not None:
        check_table_file(output)
        for several in ("ends", "band"):
            if words.text(several) is not None:
                raise OptionError(
                    f"-o {str(output)!r}: each of the machines of --{several} learns a table of "
                    "its own",
                    remedy=f"Leave --{several} out, and name the machine with --actual.",
                )
    if learning.runs:
        _from_runs(job, machine, learning, words, rules, report, json=json)
        return
    with progress_bar(not json) as progress:
        learned = learned_on_twins(words, job, machine, rules, learning.repeats, progress)
        page = None
        with together(output):
            if output is not None:
                learned.write(output)
            if report is not None:
                from threadline.report.learn import write_learning

                typed = {"-m": machine, **words.typed("learn"), **level_option(words.trials())}
                typed["--repeats"] = str(learning.repeats)
                page = write_learning(learned, report, command_line("learn", job, typed))
    tell(warnings_of(learned.machines[0][1].proof))
    if json:
        extra = {} if page is None else {"report": str(page)}
        print_json(learned.content() | ({} if output is None else {"table": str(output)}) | extra)
    else:
        show(learned)
        if page is not None:
            say(f"Report: {page}")
        if output is not None:
            say(f"Table: {output}")
            typed = {"-m": machine, **words.typed("prove"), "--table": output}
            say(f"  {command_line('prove', job, typed)}")
    raise typer.Exit(0 if learned.passed else 1)


def show(found: LearnedJob) -> None:
    """Print the repeats and the verdict on every best table."""
    from threadline.report.learn import HEADER, filter_facts, repeat_rows, table_name, verdicts

    for at, (name, one) in enumerate(found.machines):
        title = f"{found.base.job.name} on {found.base.machine.name}, learned on {name}"
        print_table(title, HEADER, repeat_rows(found, at))
        say(f"{table_name(one.best)}: {closing(one.proof.verdict)}")
    for subject, text in filter_facts(found):
        say(f"{subject}: {text}")
    if len(found.machines) > 1:
        say(verdicts(found)[0][0])


def _from_runs(
    job: Path, machine: str, learning: Learning, words: Words, rules: Rules, report: Path | None,
    *, json: bool,
) -> None:  # fmt: skip
    if report is not None:
        raise OptionError(
            "--from learns from recorded runs, and --report is about simulated ones",
            remedy="Leave --report out.",
        )
    refuse_simulated(words)
    recorded = {name: _recording(name, learning.store) for name in learning.runs or ()}
    if len(recorded) < len(learning.runs or ()):
        raise OptionError("--from names a run twice", remedy="Name each run once.")
    learned = learned_from(words, job, machine, rules, recorded)
    if learning.output is not None:
        learned.write(learning.output)
    if json:
        written = {} if learning.output is None else {"table": str(learning.output)}
        print_json(learned.content() | written)
    else:
        _show_runs(learned, list(recorded), learning.output, job, machine)
    raise typer.Exit(0 if learned.repeats[learned.best].verdict.passed else 1)


def _show_runs(
    found: LearnedRuns, names: list[str], output: Path | None, job: Path, machine: str
) -> None:
    rows = []
    for name, run in zip(names, found.repeats, strict=True):
        worst = run.verdict.tightest
        rows.append(
            [
                name,
                "yes" if run.verdict.passed else "no",
                f"{100.0 * run.share:.0f} %",
                "-" if worst is None else worst.name,
                f"{1e3 * run.error_m:.4g} mm",
                "" if run.followed else "worse: undone",
            ]
        )
    header = ("run", "in spec", "of the limit", "tightest", "error", "note")
    print_table(f"Runs of {found.base.job.name}", header, rows)
    next_text = f"gain {found.gain:.3g} after {names[found.best]}" if found.gain else found.note
    say(f"next table: {next_text}")
    if output is not None:
        say(f"Table: {output}")
        typed: dict[str, str | Path | None] = {"-m": machine, "--table": output}
        say(f"  {command_line('run', job, typed | typed_options(found.base.options))}")


def _recording(name: str, store: Path) -> Recording:
    """Return the recording in a file, or of a run of the store."""
    if Path(name).suffix and Path(name).exists() and Path(name).is_file():
        return whole_recording(Path(name))
    store_open = opened(store)
    if store_open is None:
        raise StoreError(
            f"there is no run {name[:60]!r} in {str(store)!r}, and no such file",
            remedy="Give a recording, or --store.",
        )
    return whole_recording(store_open.find(name) / TRACE)


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    option_parameters.add(app, "learn", learn)
