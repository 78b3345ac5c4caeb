"""``threadline prove``: plan, simulate, judge."""

from __future__ import annotations

from typing import Annotated

import typer

from threadline.cli.feed_forward import feed_forward_lines, feed_forward_warnings
from threadline.cli.needle import needle_warnings
from threadline.cli.options import (
    DEFAULT_INTERPOLATION_TEXT,
    DEFAULT_LIMITS_TEXT,
    DEFAULT_TOLERANCE_TEXT,
    ActualOption,
    FeedForwardOption,
    FeedModeOption,
    FeedOption,
    InterpolationOption,
    JobArgument,
    JsonOption,
    LimitsOption,
    MachineOption,
    ParOption,
    RecordingOption,
    ReportOption,
    ShaperOption,
    SmoothingOption,
    SpecOption,
    ToleranceOption,
    keep_inputs,
    machine_from,
    options_of,
)
from threadline.cli.output import note, print_json, print_table, progress_bar
from threadline.cli.outputs import appearing, check_outputs
from threadline.cli.tolerance import proof_warnings
from threadline.cli.warn import warn
from threadline.errors import OptionError
from threadline.machine import Machine
from threadline.pipeline import Proof, SwitchProof, prove_switching, with_shaping
from threadline.pipeline import prove as prove_job
from threadline.report import write_report, write_switching
from threadline.signals.files import write_recording
from threadline.targets import calculate
from threadline.verdict import (
    closing,
    load_spec,
    motion_lines,
    shaping_rows,
    step_rows,
    verdict_json,
    verdict_rows,
)


def prove(
    job: JobArgument,
    machine: MachineOption,
    spec: SpecOption = None,
    interpolation: InterpolationOption = DEFAULT_INTERPOLATION_TEXT,
    feed: FeedOption = None,
    feed_mode: FeedModeOption = None,
    tolerance: ToleranceOption = DEFAULT_TOLERANCE_TEXT,
    limits: LimitsOption = DEFAULT_LIMITS_TEXT,
    shaper: ShaperOption = None,
    feed_forward: FeedForwardOption = False,
    smoothing: SmoothingOption = None,
    par: ParOption = None,
    actual: ActualOption = None,
    report: ReportOption = None,
    recording: RecordingOption = None,
    repeats: Annotated[
        int,
        typer.Option(
            min=1, max=1000, help="Runs with other encoder phase, friction, supply: repeatability."
        ),
    ] = 1,
    json: JsonOption = False,
) -> None:
    """Plan JOB, simulate it on the machine, and say whether it is within specification.

    Exit status: 0 in spec, 1 out of spec, 2 wrong input.

    Example: threadline prove examples/x-180.prg -m lathe-winder --feed "10 count/tick"

    With the loads' own inverse: threadline prove examples/stitcher-test-path.seam.toml
    -m stitcher --feed-forward

    Of an on/off machine: threadline prove examples/letter-cycle.toml
    -m letter-placer+whole-scans+own-damping --shaper zv
    """
    chosen = machine_from(machine, par)
    keep_inputs(recording, job, chosen.file, par, spec)
    check_outputs(file=recording, folder=report)
    options = options_of(
        interpolation, feed, tolerance, limits, shaper, feed_forward, smoothing, feed_mode
    )
    asked = with_shaping(load_spec(spec, chosen), chosen, options)
    if chosen.cylinders and actual is not None:
        raise OptionError(f"--actual is of machines with loops, which {chosen.name} does not have")
    if chosen.cylinders and repeats > 1:
        raise OptionError(
            f"--repeats varies loops and encoders, which {chosen.name} does not have",
            remedy="Leave it out; overlays like +hysteresis vary an on/off machine.",
        )
    with progress_bar(not json) as progress:
        proof: Proof | SwitchProof
        if chosen.cylinders:
            proof = prove_switching(job, chosen, asked, options)
        else:
            other = None if actual is None else machine_from(actual, par)
            proof = prove_job(job, chosen, asked, options, progress, repeats, other)
        with appearing(recording) as temporary:
            if temporary is not None:
                write_recording(proof.recording, temporary, plot_every=_plot_every(chosen))
            written = None
            if report is not None and isinstance(proof, SwitchProof):
                written = write_switching(proof, report)
            elif report is not None and isinstance(proof, Proof):
                written = write_report(proof, report)
    if isinstance(proof, SwitchProof):
        for warning in proof.plan.scheduled.warnings:
            note(f"warning: {warning}")
    else:
        warn(
            chosen,
            proof.plan.job,
            [
                *feed_forward_warnings(proof.plan.feed_forward),
                *proof_warnings(proof),
                *needle_warnings(proof),
            ],
        )
    if json:
        content = verdict_json(proof.verdict, proof.plan)
        if written is not None:
            content["report"] = str(written)
        print_json(content)
    else:
        if isinstance(proof, SwitchProof):
            show_switching(proof)
        else:
            show_proof(proof)
        if written is not None:
            typer.echo(f"Report: {written}")
    raise typer.Exit(0 if proof.verdict.passed else 1)


def _plot_every(machine: Machine) -> int | None:
    """Return the ticks from line to line of a plot file: the operator's setting."""
    return None if machine.operator is None else round(machine.operator.record_every.si)


def show_proof(proof: Proof) -> None:
    """Print the verdict of a proof for people."""
    plan = proof.plan
    header, rows = verdict_rows(proof.verdict)
    print_table(f"{plan.job.name} on {plan.machine.name}, {plan.planned_with}", header, rows)
    about = [
        *feed_forward_lines(plan.feed_forward),
        *motion_lines(plan),
        *calculate(plan).lines(),
    ]
    for line in about:
        typer.echo(line)
    added = plan.path.summary.get("points_added")
    if added is not None:
        typer.echo(f"Points added:         {added:.0f} (path_deviation is what is left, and where)")
    typer.echo(closing(proof.verdict))


def show_switching(proof: SwitchProof) -> None:
    """Print the verdict of a proof on an on/off machine for people."""
    plan = proof.plan
    header, rows = verdict_rows(proof.verdict)
    print_table(f"{plan.job.name} on {plan.machine.name}, switched", header, rows)
    header, rows = step_rows(proof.verdict)
    print_table(f"Step by step, shaper {plan.options.get('shaper', 'none')}", header, rows)
    for axis, words in shaping_rows(plan):
        typer.echo(f"Cylinder {axis}:".ljust(22) + words)
    typer.echo(closing(proof.verdict))


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    app.command("prove")(prove)
