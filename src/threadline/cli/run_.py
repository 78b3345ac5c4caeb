"""``threadline run``: prove, execute, record, judge."""

from __future__ import annotations

import tempfile
from contextlib import closing as closed
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from threadline.base.reading import inputs_read
from threadline.cli import option_parameters
from threadline.cli.arguments import (
    JobArgument,
    JsonOption,
    KeyOption,
    MachineOption,
    RecordingOption,
    keep_inputs,
    key_of,
)
from threadline.cli.messages import note, warning
from threadline.cli.operator_keys import (
    AtOption,
    ConfirmedOption,
    ContinueOption,
    at_the_keys,
    check_continued,
    continued_run,
    somebody_at_the_keys,
)
from threadline.cli.output import (
    check_outputs,
    print_json,
    print_table,
    progress_bar,
    report_failed_print,
    say,
    tell,
)
from threadline.cli.prove import plot_every
from threadline.cli.runs_ import DEFAULT_STORE, StoreOption
from threadline.commands.plan import Plan
from threadline.files import RunEnd
from threadline.files.formats import write_recording
from threadline.live.job_run import (
    Executed,
    JudgedRun,
    Manner,
    checked_speed,
    execute,
    fault_of,
    judge_run,
)
from threadline.live.links import link_of
from threadline.live.sim_machine import SimFault, parse_fault
from threadline.live.sim_process import REAL_TIME
from threadline.live.states import Hold
from threadline.live.store.run_store import RunStore, check_folder
from threadline.live.store.whole_trace import as_one
from threadline.live.supervised import check_halts, check_override, check_runnable, interventions
from threadline.proof.pipeline import check_machine, open_job, plan_job, prove_plan, with_shaping
from threadline.proof.proof_file import read_proof, write_proof
from threadline.proof.recorded import warnings_of
from threadline.proof.request import Words
from threadline.verdict import (
    closing,
    happened_lines,
    verdict_rows,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Execution:
    """Options of ``threadline run``: link, store, proof, overrides and confirmations."""

    link: Annotated[
        str,
        typer.Option(
            help="Link to the machine: sim is a simulated one, in its own process; sim:slower runs "
            "slower where the computer is too busy for real time; grbl:HOST:PORT or "
            "grbl:/dev/ttyUSB0 is a controller with grbl; hal:loopback and "
            "hal:plant are LinuxCNC's HAL without a machine."
        ),
    ] = "sim"
    speed: Annotated[
        float,
        typer.Option(
            callback=checked_speed,
            help="With sim: simulated seconds per second; 1 is real time, 0 as fast as possible.",
        ),
    ] = REAL_TIME
    store: StoreOption = DEFAULT_STORE
    proof_file: Annotated[
        Path | None,
        typer.Option(
            "--proof",
            help="Run by this proof (prove --proof FILE), which must match the files as they "
            "are now; default: prove the job first.",
        ),
    ] = None
    key: KeyOption = None
    override: Annotated[
        str | None,
        typer.Option(help="Why the job runs although out of specification; kept with the run."),
    ] = None
    inject: Annotated[
        str | None,
        typer.Option(
            help="With sim: inject a fault at a time, to test the guards: stuck-encoder:X@1.2 s, "
            "switch-hit:x_high@1 s, lost-link@1 s, late-ticks@1 s, power-loss@1 s."
        ),
    ] = None
    continue_: ContinueOption = None
    at: AtOption = None
    confirmed: ConfirmedOption = False
    approach: Annotated[
        bool,
        typer.Option(
            "--approach",
            help="With grbl: move the axes to where the program begins, one after the other at "
            "their manual feeds, linear axes first.",
        ),
    ] = False
    pass_stops: Annotated[
        bool, typer.Option("--pass-stops", help="Pass M00 without waiting for a key.")
    ] = False


def run(
    job: JobArgument,
    machine: MachineOption,
    execution: Execution,
    words: Words,
    recording: RecordingOption = None,
    json: JsonOption = False,
) -> None:
    """Run JOB on the machine: prove it, execute it, record it, and judge the recording.

    Ctrl-C brakes along the path to a standstill; a second Ctrl-C leaves the machine to its own
    braking. On a terminal: h holds on the path, r resumes, - and + override the feed by 10 %, any
    other key stops. None of them is an emergency stop, which must be a circuit of the machine.

    Exit status: 0 in spec, 1 out of spec or stopped, 2 wrong input, 3 a fault of machine or link.

    Example: threadline run examples/x-180.prg -m lathe-winder --link sim --speed 0
    """
    check_override(execution.override)
    trials = words.trials()
    chosen = words.machine(machine)
    inject, proof_file = execution.inject, execution.proof_file
    secret = key_of("--key", execution.key, proof_file)
    fault = None if inject is None else parse_fault(inject, chosen)
    run_link = link_of(
        execution.link, chosen, execution.speed, fault,
        approach=execution.approach, actual=words.actual(),
    )  # fmt: skip
    store, confirmed = execution.store, execution.confirmed
    check_folder(store)
    check_continued(store, execution.continue_, execution.at, confirmed=confirmed)
    keep_inputs(recording, job, chosen.file, *words.files(), proof_file)
    check_outputs(file=recording)
    options = words.options(job)
    spec_asked = with_shaping(words.spec(chosen), chosen, options)
    check_machine(chosen)
    if proof_file is not None:
        read_proof(proof_file, secret)  # fail on an unreadable proof before planning
    with (
        progress_bar(not json) as progress,
        tempfile.TemporaryDirectory() as folder,
        closed(run_link),
    ):
        plan = plan_job(open_job(job, chosen, options), chosen, options)
        check_halts(plan, answered=execution.pass_stops or somebody_at_the_keys())
        if proof_file is None:
            proof_file = Path(folder) / "proof.json"
            proof = prove_plan(plan, spec_asked, progress, trials)
            tell(warnings_of(proof))
            write_proof(proof, proof_file)
        proof_read = check_runnable(proof_file, plan, spec_asked, execution.override, secret)
        for line in run_link.prepare(plan):
            note(line)
        allowed = interventions(plan, spec_asked)
        allowed = allowed.at_once() if run_link.holds_at_once else allowed
        for line in allowed.notes:
            note(line)
        recorded = {
            "link": execution.link,
            **({} if (twin_name := words.text("actual")) is None else {"simulated": twin_name}),
            **({"label": run_link.label} if run_link.label else {}),
            **({"override": execution.override} if execution.override else {}),
        }
        continued, continued_entries = continued_run(
            store,
            execution.continue_,
            execution.at,
            plan,
            lambda operation: run_link.rest(plan, operation, at_rest=allowed.hold is Hold.AT_REST),
            asks=not confirmed,
        )
        recorded |= continued_entries
        inputs = [file for file in inputs_read() if not file.samefile(proof_file)]
        manner = Manner(
            may=allowed,
            recorded=recorded,
            pass_stops=execution.pass_stops,
            again=continued,
            confirmed=confirmed,
        )
        open_run = RunStore(store).begin(
            plan, proof_read, recorded, execution.speed, inputs, run_link.sent
        )
        executed = execute(
            run_link,
            plan,
            open_run,
            manner,
            lambda desk: at_the_keys(desk, plan.duration_s, progress),
        )
        _warn_unreached(executed, plan, fault)
    judged = judge_run(executed, plan, spec_asked, manner)
    if judged.warned:
        warning(judged.warned)
    if recording is not None and judged.verdict is not None:
        write_recording(judged.recording, recording, plot_every=plot_every(chosen))
    _show(executed, judged, plan, run_link.label, json=json)
    if executed.ended is RunEnd.FAULT:
        raise fault_of(executed, run_link)
    raise typer.Exit(0 if judged.verdict is not None and judged.verdict.passed else 1)


def _warn_unreached(done: Executed, plan: Plan, fault: SimFault | None) -> None:
    """Warn if a run ended before the injected fault."""
    period_s = float(plan.machine.command_clock.period_s)
    if fault is not None and done.ended is not RunEnd.FAULT and done.time_s < fault.tick * period_s:
        fault_text = f"{fault.kind} at {fault.tick * period_s:g} s"
        warning(f"--inject: {fault_text} never came: the run ended at {done.time_s:.6g} s")


def _show(executed: Executed, judged: JudgedRun, plan: Plan, label: str, *, json: bool) -> None:
    """Print the verdict; after a fault the error message gives the rest."""
    fault, content, verdict = executed.ended is RunEnd.FAULT, judged.content, judged.verdict
    if verdict is None:
        if executed.ended is RunEnd.COMPLETED:
            note(judged.text)
        elif not fault:
            note(f"{judged.text}: nothing was recorded to be judged")
        return
    with report_failed_print(f"the verdict is in {executed.open_run.path}"):
        if json:
            if not fault:
                print_json(content)
            return
        header, rows = verdict_rows(verdict)
        print_table(f"{plan.job.name} run on {plan.machine.name}, link {content['link']}",
                    header, rows)  # fmt: skip
        for line in happened_lines(verdict):
            say(line)
        say(closing(verdict) + (f"; {label}" if label else ""))
        if judged.before:
            say(as_one(judged.before))
        if not fault:
            say(f"Run: {executed.open_run.path}")


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    option_parameters.add(app, "run", run)
