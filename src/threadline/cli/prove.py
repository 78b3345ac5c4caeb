"""``threadline prove``: plan, simulate, judge."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from threadline.base.writing import together
from threadline.cli import option_parameters
from threadline.cli.arguments import (
    JobArgument,
    JsonOption,
    MachineOption,
    RecordingOption,
    ReportOption,
    SignOption,
    keep_inputs,
    key_of,
)
from threadline.cli.output import check_outputs, print_json, print_table, progress_bar, say, tell
from threadline.errors import OptionError
from threadline.files.formats import write_recording
from threadline.machine import Machine
from threadline.proof.kinds.kind import WRITING, Share
from threadline.proof.pipeline import Proof, with_shaping
from threadline.proof.pipeline import prove as prove_job
from threadline.proof.recorded import warnings_of
from threadline.proof.request import Words
from threadline.report.lines import about
from threadline.verdict import (
    Verdict,
    closing,
    happened_lines,
    step_rows,
    verdict_json,
    verdict_rows,
)


def prove(
    job: JobArgument,
    machine: MachineOption,
    words: Words,
    report: ReportOption = None,
    recording: RecordingOption = None,
    proof_file: Annotated[
        Path | None,
        typer.Option(
            "--proof",
            help="Write the proof to this file (JSON): hashes of all its inputs, and "
            "the verdict; threadline verify reads it.",
        ),
    ] = None,
    sign: SignOption = None,
    worst: Annotated[
        Path | None,
        typer.Option(
            help="With --tolerances: write the worst machine found within them to this machine "
            "file, for --actual. A report has it as worst.toml.",
        ),
    ] = None,
    json: JsonOption = False,
) -> None:
    """Plan JOB, simulate it on the machine, and say whether it is within specification.

    Twenty runs are judged, each with other encoder phases, friction and supply, and the worst
    counts; --nominal judges one run, --tolerances the worst machine within the tolerances and
    drawn ones as well.

    Exit status: 0 in spec, 1 out of spec, 2 wrong input.

    Example: threadline prove examples/x-180.prg -m lathe-winder --feed "10 count/tick"

    With feed-forward through the inverse of the loads:
    threadline prove examples/stitcher-test-path.seam.toml -m stitcher --feed-forward

    On an on/off machine: threadline prove examples/letter-cycle.toml
    -m letter-placer+whole-scans+own-damping --shaper zv
    """
    trials = words.trials()
    key = key_of("--sign", sign, proof_file)
    chosen = words.machine(machine)
    if worst is not None and (not trials.machines or trials.wanted_yield is not None):
        raise OptionError(
            f"--worst {str(worst)!r} is the worst machine within the tolerances, and this level "
            "searches none",
            remedy="Give --tolerances as well, or use threadline yield --worst.",
        )
    for output in (recording, proof_file, worst):
        keep_inputs(output, job, chosen.file, *words.files(), sign)
        check_outputs(file=output, folder=report, worst=worst)
    options = words.options(job)
    spec_asked = with_shaping(words.spec(chosen), chosen, options)
    with progress_bar(not json) as progress:
        proof = prove_job(job, chosen, spec_asked, options, progress, trials, words.actual())
        with together(recording, proof_file, worst):
            if recording is not None:
                # A recording is a recipe: writing it simulates that run again.
                reported = Share(proof.plan, progress, 1, WRITING).of([proof.recording])
                write_recording(reported[0], recording, plot_every=plot_every(chosen))
            if proof_file is not None or worst is not None:
                _write_files(proof, proof_file, key, worst)
            written = None
            if report is not None:
                # Searches take a while to load, and most proofs have no report.
                from threadline.proof.proof_file import write_worst_beside
                from threadline.report.proof import write_report
                from threadline.search.report_data import report_data

                progress("drawing the report", 0.0)
                written = write_report(report_data(proof), report)
                beside = write_worst_beside(proof, report)
                worst = worst or beside
    tell(warnings_of(proof))
    if json:
        content = verdict_json(proof.verdict, proof.plan)
        if written is not None:
            content["report"] = str(written)
        if proof_file is not None:
            content["proof"] = str(proof_file)
        if worst is not None:
            worst_facts = {
                "command": worst_machine_command(job, machine, words, worst),
                "product": worst_product(proof),
            }
            content["worst"] = {"file": str(worst), **worst_facts}
        print_json(content)
    else:
        show_proof(proof)
        if written is not None:
            say(f"Report: {written}")
        if proof_file is not None:
            say(f"Proof: {proof_file}")
        if worst is not None:
            say(f"Worst machine: {worst}, under the commands of {chosen.name}:")
            for line in (
                f"  {worst_machine_command(job, machine, words, worst)}",
                *product_lines(proof),
            ):
                say(line)
    raise typer.Exit(0 if proof.verdict.passed else 1)


def _write_files(
    proof: Proof, proof_file: Path | None, key: bytes | None, worst: Path | None
) -> None:
    """Write the proof file and the file of the worst machine, where they are asked for."""
    from threadline.proof.proof_file import write_proof, write_worst

    if proof_file is not None:
        write_proof(proof, proof_file, key)
    if worst is not None:
        write_worst(proof, worst)


def worst_product(proof: Proof) -> str:
    """Return how the product of the worst machine differs from the file's; empty if equal."""
    from threadline.verdict.replayed import product_of, product_words

    product = product_of(proof.plan)
    if product is None or proof.worst is None:
        return ""
    return product_words(product, proof.worst.product)


def product_lines(proof: Proof) -> list[str]:
    """Return a line with the product of the worst machine; empty if it is the file's product."""
    product = worst_product(proof)
    return [f"Its product, as numbers for the file of --product: {product}"] if product else []


def worst_machine_command(job: Path, machine: str, words: Words, worst: Path) -> str:
    """Return the command that proves the plan on the worst machine with the same options."""
    from threadline.cli.search_text import command_line  # loads the searches

    return command_line("prove", job, {"-m": machine, **words.typed(), "--actual": worst})


def plot_every(machine: Machine) -> int | None:
    """Return the number of ticks between two lines of a plot file; None without ``[operator]``."""
    return None if machine.operator is None else round(machine.operator.record_every.si)


def show_proof(proof: Proof) -> None:
    """Print the verdict of a proof for people."""
    plan = proof.plan
    header, rows = verdict_rows(proof.verdict)
    print_table(f"{plan.job.name} on {plan.machine.name}, {plan.planned_with}", header, rows)
    show_steps(proof.verdict, f", shaper {plan.options.get('shaper', 'none')}")
    for line in (*about(proof), *happened_lines(proof.verdict)):
        say(line)
    say(closing(proof.verdict))


def show_steps(verdict: Verdict, how: str = "") -> None:
    """Print the residual vibration after each step, if the job has steps."""
    header, rows = step_rows(verdict)
    if rows:
        print_table(f"Step by step{how}", header, rows)


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    option_parameters.add(app, "prove", prove)
