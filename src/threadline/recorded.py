"""What a recording is judged by: the plan that it says it was made with, or that is named."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from hashlib import file_digest
from pathlib import Path

from threadline.asked import Words, chosen_machine
from threadline.described import options_from
from threadline.errors import OptionError
from threadline.jobs.operations import Job
from threadline.machine import Machine
from threadline.option_defaults import DEFAULT_INTERPOLATION, DEFAULT_TOLERANCE, FEED_FORWARD
from threadline.option_table import (
    RECORDED,
)
from threadline.options import options_of
from threadline.pipeline import open_job, plan_job, with_shaping
from threadline.plan import Plan
from threadline.signals import Recording
from threadline.signals.files import read_recording
from threadline.verdict import Spec, Verdict, judge

_ALWAYS_SAID = ("interpolation", "feed", "tolerance", "limits")
_PLANNED_WITH = tuple(recorded.key for _, recorded in RECORDED)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Judged:
    """Recordings of one job, the plan that they were judged by, what was asked, and the verdict."""

    recordings: tuple[Recording, ...]
    plan: Plan
    spec: Spec
    verdict: Verdict


def judge_files(
    recordings: Sequence[Path],
    words: Words,
    *,
    job: Path | None = None,
    machine: str | None = None,
    read_one: Callable[[Path], Recording] = read_recording,
) -> Judged:
    """Judge recordings of one and the same job.

    Parameters
    ----------
    recordings
        Their files.
    words
        What was asked of ``judge``. An option that is left out is what the recording says of
        itself, else the default.
    job, machine
        The job and the machine, where the recording does not name them or others are meant.
    read_one
        Reads a file.

    Raises
    ------
    OptionError
        If a recording does not say of which job and machine it is, or says that it is of others.
    InputError
        If a file cannot be read.
    """
    _refuse_copies(recordings)
    read = [read_one(path) for path in recordings]
    given = _given(words, job, machine, read[0].origin)
    origin = _origin(recordings[0], read[0], given)
    settings = Path(origin["par"]) if "par" in origin else None
    chosen = chosen_machine(origin["machine"], settings)
    ran = chosen_machine(origin["actual"], settings) if "actual" in origin else chosen
    options = options_from(origin)
    for path, recording in zip(recordings, read, strict=True):
        _refuse_other_options(path, recording.origin, origin)
    plan = plan_job(open_job(Path(origin["job"]), chosen, options), chosen, options)
    for path, recording in zip(recordings, read, strict=True):
        _refuse_other_files(path, recording, plan.job, ran)
    asked = with_shaping(words.spec(chosen), chosen, options)
    verdict = judge(read, plan, asked)
    return Judged(recordings=tuple(read), plan=plan, spec=asked, verdict=verdict)


def _given(
    words: Words, job: Path | None, machine: str | None, recorded: Mapping[str, str]
) -> dict[str, str | None]:
    """Return the options that were given, by the keys of ``describe``.

    Raises
    ------
    OptionError
        If a smoothing is given to a plan without feed-forward, or two options exclude each other.
    """
    given: dict[str, str | None] = {
        "job": None if job is None else str(job),
        "machine": machine,
        "par": words.text("par"),
        "actual": words.text("actual"),
    }
    for one, known in RECORDED:
        text = words.text(one.word)
        read = None if text is None or one.parse is None else one.parse(text)
        given[known.key] = read if isinstance(read, str) else text
    if (law := words.text("law")) is not None:
        of_law = options_of(interpolation=given["interpolation"], law=law)
        given["interpolation"] = of_law.interpolation
    smoothing = words.text("smoothing")
    of_loads = words.flag("feed_forward") or "feed-forward" in recorded
    if smoothing is not None and not of_loads:
        raise OptionError("--smoothing is of --feed-forward", remedy="Give that too.")
    robust = words.text("robust") is not None or "robust" in recorded
    given["change"] = smoothing if robust else None
    given["feed-forward"] = None if robust else smoothing
    if words.flag("feed_forward") and given["feed-forward"] is None:
        given["feed-forward"] = recorded.get("feed-forward", FEED_FORWARD)
    return given


def _origin(path: Path, recording: Recording, given: Mapping[str, str | None]) -> dict[str, str]:
    """Return the options of the recorded plan: given, else recorded, else the defaults."""
    found = {
        "interpolation": DEFAULT_INTERPOLATION,
        "feed": "programmed",
        "tolerance": DEFAULT_TOLERANCE,
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
    """Refuse one run given twice: it would pass for perfect repeatability."""
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
