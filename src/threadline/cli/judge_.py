"""``threadline judge``: recordings from anywhere, judged by the same judge."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from hashlib import file_digest
from pathlib import Path
from typing import Annotated

import typer

from threadline.cli.options import (
    DEFAULT_TOLERANCE_TEXT,
    FEED_FORWARD,
    JsonOption,
    SpecOption,
    machine_from,
)
from threadline.cli.output import print_json, print_table
from threadline.errors import OptionError
from threadline.jobs.operations import Job
from threadline.machine import Machine
from threadline.options import DEFAULT_INTERPOLATION, options_from
from threadline.pipeline import open_job, plan_job, plan_switching, with_shaping
from threadline.signals import Recording
from threadline.signals.files import read_recording
from threadline.verdict import closing, load_spec, step_rows, verdict_json, verdict_rows
from threadline.verdict import judge as judge_recordings

_ALWAYS_SAID = ("interpolation", "feed", "tolerance", "limits")
_PLANNED_WITH = (*_ALWAYS_SAID, "feed-mode", "shaper", "feed-forward")


def judge(
    recordings: Annotated[
        list[Path], typer.Argument(help="Recordings (.npz, .csv, .plt) of one and the same job.")
    ],
    spec: SpecOption = None,
    job: Annotated[
        Path | None, typer.Option(help="The job; default: what the recording names.")
    ] = None,
    machine: Annotated[
        str | None, typer.Option("--machine", "-m", help="The machine; default: likewise.")
    ] = None,
    interpolation: Annotated[str | None, typer.Option(help="Default: likewise.")] = None,
    feed: Annotated[str | None, typer.Option(help="Default: likewise.")] = None,
    feed_mode: Annotated[str | None, typer.Option(help="Default: likewise.")] = None,
    tolerance: Annotated[str | None, typer.Option(help="Default: likewise.")] = None,
    limits: Annotated[str | None, typer.Option(help="Default: likewise.")] = None,
    par: Annotated[Path | None, typer.Option(help="FW-CNC.PAR; default: likewise.")] = None,
    actual: Annotated[
        str | None, typer.Option(help="The machine that ran the plan; default: likewise.")
    ] = None,
    shaper: Annotated[str | None, typer.Option(help="As with prove; default: likewise.")] = None,
    feed_forward: Annotated[
        bool,
        typer.Option(
            "--feed-forward", help="The table was made with it; the recording may say so itself."
        ),
    ] = False,
    smoothing: Annotated[
        str | None, typer.Option(help=f'Of feed-forward: likewise, else "{FEED_FORWARD}".')
    ] = None,
    json: JsonOption = False,
) -> None:
    """Judge what a machine did, recorded by Threadline or by anything that writes a table.

    Exit status: 0 in spec, 1 out of spec, 2 wrong input.

    Example: threadline judge run.npz, or: threadline judge trace.csv --job x-180.prg
    -m lathe-winder --interpolation linear
    """
    _refuse_copies(recordings)
    read = [read_recording(path) for path in recordings]
    given = {
        "interpolation": interpolation,
        "feed": feed,
        "feed-mode": feed_mode,
        "tolerance": tolerance,
        "limits": limits,
        "shaper": shaper,
        "feed-forward": smoothing,
        "job": None if job is None else str(job),
        "machine": machine,
        "par": None if par is None else str(par),
        "actual": actual,
    }
    if smoothing is not None and not feed_forward and "feed-forward" not in read[0].origin:
        raise OptionError("--smoothing is of --feed-forward", remedy="Give that too.")
    if feed_forward and smoothing is None:
        given["feed-forward"] = read[0].origin.get("feed-forward", FEED_FORWARD)
    origin = _origin(recordings[0], read[0], given)
    settings = Path(origin["par"]) if "par" in origin else None
    chosen = machine_from(origin["machine"], settings)
    ran = machine_from(origin["actual"], settings) if "actual" in origin else chosen
    options = options_from(origin)
    for path, recording in zip(recordings, read, strict=True):
        _refuse_other_options(path, recording.origin, origin)
    made = plan_switching if chosen.cylinders else plan_job
    plan = made(open_job(Path(origin["job"]), chosen, options), chosen, options)
    for path, recording in zip(recordings, read, strict=True):
        _refuse_other_files(path, recording, plan.job, ran)
    verdict = judge_recordings(read, plan, with_shaping(load_spec(spec, chosen), chosen, options))
    if json:
        print_json(verdict_json(verdict, plan))
    else:
        header, rows = verdict_rows(verdict)
        print_table(
            f"{', '.join(p.name for p in recordings)} against {plan.job.name}", header, rows
        )
        if chosen.cylinders:
            print_table("Step by step", *step_rows(verdict))
        typer.echo(closing(verdict))
    raise typer.Exit(0 if verdict.passed else 1)


def _origin(path: Path, recording: Recording, given: Mapping[str, str | None]) -> dict[str, str]:
    """Return of what it is a recording: what was given, what it says itself, the defaults."""
    found = {
        "interpolation": DEFAULT_INTERPOLATION,
        "feed": "programmed",
        "tolerance": DEFAULT_TOLERANCE_TEXT,
        **recording.origin,
        **{key: text for key, text in given.items() if text is not None},
    }
    for key, option in (("job", "--job"), ("machine", "--machine")):
        if key not in found:
            raise OptionError(
                f"{path.name} does not say which {key} it is a recording of",
                remedy=f"Give it with {option}.",
            )
    return found


def _refuse_other_files(path: Path, recording: Recording, job: Job, ran: Machine) -> None:
    """Refuse a job or a machine that is not, to the byte, the one that was run."""
    if recording.job_sha256 and recording.job_sha256 != job.sha256:
        raise OptionError(
            f"{path.name} was recorded from another version of {job.name} "
            f"(sha256 {recording.job_sha256[:12]}, now {job.sha256[:12]})",
            remedy="Give the job file that was run with --job.",
        )
    if recording.machine_sha256 and recording.machine_sha256 != ran.sha256:
        raise OptionError(
            f"{path.name} was recorded on another machine, or another version of its file, "
            f"than {ran.name} (sha256 {recording.machine_sha256[:12]}, now {ran.sha256[:12]})",
            remedy="Give the machine file of the run with --machine, and what else it was made "
            "with: --par, --actual.",
        )


def _refuse_copies(recordings: Sequence[Path]) -> None:
    """Refuse one run given twice: copies repeat themselves perfectly, machines do not."""
    seen: dict[str, Path] = {}
    for path in recordings if len(recordings) > 1 else ():
        if path.is_file():
            with path.open("rb") as file:
                other = seen.setdefault(file_digest(file, "sha256").hexdigest(), path)
            if other is not path:
                raise OptionError(
                    f"{path.name} holds the same bytes as {other.name}: it is the same run",
                    remedy="Give every run once.",
                )


def _refuse_other_options(path: Path, recorded: Mapping[str, str], chosen: dict[str, str]) -> None:
    """Refuse a plan made with other options than the run that is to be judged by it."""
    if not recorded:
        return  # of another controller: it says nothing of a plan
    for key in _PLANNED_WITH:
        ours = {name: text for name, text in chosen.items() if name != key}
        if key in recorded:
            ours[key] = recorded[key]
        elif key in _ALWAYS_SAID:
            continue
        if options_from(ours) != options_from(chosen):
            raise OptionError(
                f"{path.name} was recorded with {key} {recorded.get(key, 'none')}, "
                f"not {chosen.get(key, 'none')}",
                remedy="Judge each run against its own plan: leave the option out, "
                "and give runs with other options apart.",
            )


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    app.command("judge")(judge)
