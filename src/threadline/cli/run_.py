"""``threadline run``: prove, execute, record, judge."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping
from contextlib import closing as closed
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from threadline.base.arrays import finite
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
from threadline.errors import LinkFaultError, OptionError, RecordingError, StoreError
from threadline.files import Recording, RunEnd
from threadline.files.formats import write_recording
from threadline.live.links import Link, link_of
from threadline.live.sim_machine import SimFault, parse_fault
from threadline.live.sim_process import LEAST_SPEED, REAL_TIME
from threadline.live.states import Desk
from threadline.live.store.run_store import OpenRun, RunStore, check_folder
from threadline.live.store.whole_trace import as_one, joined_with, whole_recording
from threadline.live.supervised import (
    check_halts,
    check_override,
    check_runnable,
    interventions,
)
from threadline.proof.asked import Words
from threadline.proof.pipeline import check_machine, open_job, plan_job, prove_plan, with_shaping
from threadline.proof.proof_file import read_proof, write_proof
from threadline.proof.recorded import warnings_of
from threadline.verdict import (
    Spec,
    Verdict,
    closing,
    happened_lines,
    judge,
    verdict_json,
    verdict_rows,
)

_MOST_SPEED = 1e6


def _checked_speed(speed: float) -> float:
    if not 0.0 <= speed <= _MOST_SPEED:
        raise OptionError(
            f"--speed {speed:g} is not between 0 and {_MOST_SPEED:g}",
            remedy="1 is real time, 0 is as fast as it can.",
        )
    if 0.0 < speed < LEAST_SPEED:
        raise OptionError(
            f"--speed {speed:g} is slower than the link can wait",
            remedy=f"Give {LEAST_SPEED:g} or more, or 0 for as fast as it can.",
        )
    return speed


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
            callback=_checked_speed,
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
            "their manual feeds, linear ones first.",
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
    over = link_of(
        execution.link, chosen, execution.speed, fault,
        approach=execution.approach, actual=words.actual(),
    )  # fmt: skip
    store, confirmed = execution.store, execution.confirmed
    check_folder(store)
    check_continued(store, execution.continue_, execution.at, confirmed=confirmed)
    keep_inputs(recording, job, chosen.file, *words.files(), proof_file)
    check_outputs(file=recording)
    options = words.options(job)
    asked = with_shaping(words.spec(chosen), chosen, options)
    check_machine(chosen)
    if proof_file is not None:
        read_proof(proof_file, secret)  # fail on an unreadable proof before planning
    with (
        progress_bar(not json) as progress,
        tempfile.TemporaryDirectory() as folder,
        closed(over),
    ):
        plan = plan_job(open_job(job, chosen, options), chosen, options)
        check_halts(plan, answered=execution.pass_stops or somebody_at_the_keys())
        if proof_file is None:
            proof_file = Path(folder) / "proof.json"
            proof = prove_plan(plan, asked, progress, trials)
            tell(warnings_of(proof))
            write_proof(proof, proof_file)
        known = check_runnable(proof_file, plan, asked, execution.override, secret)
        for line in over.prepare(plan):
            note(line)
        may = interventions(plan, asked)
        for line in may.notes:
            note(line)
        told = {
            "link": execution.link,
            **({} if (twin := words.text("actual")) is None else {"simulated": twin}),
            **({"label": over.label} if over.label else {}),
            **({"override": execution.override} if execution.override else {}),
        }
        again, known_of = continued_run(
            store,
            execution.continue_,
            execution.at,
            plan,
            lambda operation: over.rest(plan, operation, at_rest=may.hold_at_rest),
            asks=not confirmed,
        )
        told |= known_of
        inputs = [file for file in inputs_read() if not file.samefile(proof_file)]
        kept = RunStore(store).begin(plan, known, told, execution.speed, inputs, over.sent)
        with (
            _moved(kept),
            closed(Desk()) as desk,
            at_the_keys(desk, plan.duration_s, progress) as keys,
            kept,
        ):
            ended, text = over.run(
                plan, desk, kept, pass_stops=execution.pass_stops,
                hold_at_rest=may.hold_at_rest, no_override=may.no_override,
                watch=keys.step, again=again,
                confirmed=(lambda: True) if confirmed else keys.confirmed,
            )  # fmt: skip
        _is_over(kept, ended, text, plan, fault, keys.time_s)
    before = () if again is None else joined_with(kept.trace)
    happened = whole_recording(kept.trace)
    verdict = _verdict(happened, plan, asked, kept, (ended, text), over, whole=again is None)
    content = {
        **verdict_json(verdict, plan),
        **told,
        "run": kept.path.name,
        "trace": str(kept.trace),
        "ended": ended.value,
        "hold_deviation_m": finite(may.hold_deviation_m),
        "hold_waits_for_rest": may.hold_at_rest,
        "spoiled_by_holds": [
            {"name": r.name, "axis": r.axis, "measured": r.measured, "limit": r.limit}
            for r in may.spoiled_by_holds
        ],
        "no_feed_override": may.no_override,
        **({"judged_with": before} if before else {}),
    }
    _judged(kept, content, ended, text)
    if recording is not None:
        write_recording(happened, recording, plot_every=plot_every(chosen))
    _show(verdict, plan, content, over.label, kept, json=json)
    if ended is RunEnd.FAULT:
        raise _fault(kept, text, over)
    raise typer.Exit(0 if verdict.passed else 1)


def _verdict(
    happened: Recording,
    plan: Plan,
    spec: Spec,
    kept: OpenRun,
    outcome: tuple[RunEnd, str],
    over: Link,
    *,
    whole: bool,
) -> Verdict:
    """Return the verdict; end the program if the run ended before there was anything to judge."""
    try:
        return judge([happened], plan, spec)
    except RecordingError as error:
        ended, text = outcome
        if ended is RunEnd.COMPLETED and whole:
            raise
        text = text or f"NOT PROVEN: the rest of a job alone is not judged ({error.message})"
    with _moved(kept):
        kept.unjudged(ended.value, text)
    if ended is RunEnd.FAULT:
        raise _fault(kept, text, over)
    note(text if ended is RunEnd.COMPLETED else f"{text}: nothing was recorded to be judged")
    raise typer.Exit(1)


def _is_over(
    kept: OpenRun, ended: RunEnd, text: str, plan: Plan, fault: SimFault | None, until_s: float
) -> None:
    """Store how a run ended; warn if it ended before the injected fault."""
    with suppress(StoreError):  # a locked index may be free when the verdict is stored
        kept.over(ended.value, text)
    period_s = float(plan.machine.command_clock.period_s)
    if fault is not None and ended is not RunEnd.FAULT and until_s < fault.tick * period_s:
        at = f"{fault.kind} at {fault.tick * period_s:g} s"
        warning(f"--inject: {at} never came: the run ended at {until_s:.6g} s")


def _judged(kept: OpenRun, content: Mapping[str, Any], ended: RunEnd, text: str) -> None:
    with _moved(kept):
        if said := kept.judged(content, ended.value, text):
            warning(said)


@contextmanager
def _moved(kept: OpenRun) -> Iterator[None]:
    """Report a failure to store a run as a fault of the machine, since it may have moved.

    Errors of the executor from before any motion pass unchanged.
    """
    try:
        yield
    except (OSError, StoreError) as error:
        why = error.message if isinstance(error, StoreError) else error.strerror or str(error)
        raise LinkFaultError(
            f"the run could not be kept in {kept.path}: {why}",
            remedy="The machine may have moved: look at it, then home it. Make room, or give "
            "another folder with --store.",
        ) from error


def _fault(kept: OpenRun, text: str, over: Link) -> LinkFaultError:
    return LinkFaultError(
        text,
        remedy=f"What was recorded is in {kept.path}. {over.after_fault} Look at the machine, "
        "then home it.",
    )


def _show(
    verdict: Verdict, plan: Plan, content: Mapping[str, Any], label: str, kept: OpenRun, *,
    json: bool,
) -> None:  # fmt: skip
    """Print the verdict; after a fault the error message gives the rest."""
    fault = content["ended"] == RunEnd.FAULT
    with report_failed_print(f"the verdict is in {kept.path}"):
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
        if before := content.get("judged_with"):
            say(as_one(before))
        if not fault:
            say(f"Run: {kept.path}")


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    option_parameters.add(app, "run", run)
