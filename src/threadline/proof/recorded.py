"""Judge recordings by the plan and specification that they name; warnings about job and plan."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from hashlib import file_digest
from itertools import islice
from pathlib import Path

from threadline.base.option_defaults import DEFAULT_INTERPOLATION, DEFAULT_TOLERANCE, FEED_FORWARD
from threadline.commands.learned import table_words
from threadline.commands.plan import Plan
from threadline.dynamics.plausibility import plausibility_warnings
from threadline.errors import OptionError
from threadline.files import Recording
from threadline.files.formats import read_recording
from threadline.jobs.operations import FeedMode, Job, MoveRun
from threadline.machine import Machine
from threadline.motion.path.interpolations import KEEPING_TOLERANCE, on_chords
from threadline.proof.option_table import RECORDED
from threadline.proof.option_words import parse_tolerance_m
from threadline.proof.options import options_from, options_of
from threadline.proof.pipeline import Proof, open_job, plan_job, with_shaping
from threadline.proof.request import Words, chosen_machine
from threadline.verdict import Spec, Verdict, judge
from threadline.verdict.deviation import measure_path_deviation
from threadline.verdict.registry import MEASURES

_ALWAYS_RECORDED = ("interpolation", "feed", "tolerance", "limits")
_PLANNED_WITH = tuple(recorded.key for _, recorded in RECORDED)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Judged:
    """Recordings of one job, the plan and specification they were judged by, and the verdict."""

    recordings: tuple[Recording, ...]
    plan: Plan
    spec: Spec
    verdict: Verdict


def judge_files(
    recordings: Sequence[Path],
    words: Words,
    *,
    job: Path | None = None,
    machine: str | Path | Machine | None = None,
    read_one: Callable[[Path], Recording] = read_recording,
) -> Judged:
    """Judge recordings of the same job.

    Parameters
    ----------
    recordings
        The files of the recordings.
    words
        Options of ``judge``. An option that is left out is taken from the recording; if the
        recording does not have it either, it has its default.
    job, machine
        The job and the machine, named or loaded, if the recording does not name them; None: as it
        names them.
    read_one
        Reads one file.

    Raises
    ------
    OptionError
        If a recording does not name its job and machine, or names others.
    InputError
        If a file cannot be read.
    """
    _refuse_copies(recordings)
    recordings_read = [read_one(path) for path in recordings]
    actual = words.values.get("actual")
    given = _given(words, job, machine, recordings_read[0].origin)
    origin = _origin(recordings[0], recordings_read[0], given)
    settings = Path(origin["par"]) if "par" in origin else None
    planned_machine = chosen_machine(_loaded(machine, origin["machine"]), settings)
    run_machine = (
        chosen_machine(_loaded(actual, origin["actual"]), settings)
        if "actual" in origin
        else planned_machine
    )
    options = options_from(origin)
    for path, recording in zip(recordings, recordings_read, strict=True):
        _refuse_other_options(path, recording.origin, origin)
    plan = plan_job(
        open_job(Path(origin["job"]), planned_machine, options), planned_machine, options
    )
    for path, recording in zip(recordings, recordings_read, strict=True):
        refuse_other_files(path, recording, plan.job, run_machine)
    spec = with_shaping(words.spec(planned_machine), planned_machine, options)
    verdict = judge(recordings_read, plan, spec)
    return Judged(recordings=tuple(recordings_read), plan=plan, spec=spec, verdict=verdict)


def _given(
    words: Words,
    job: Path | None,
    machine: str | Path | Machine | None,
    recorded: Mapping[str, str],
) -> dict[str, str | None]:
    """Return the given options, by the keys of ``describe``.

    Raises
    ------
    OptionError
        If a smoothing is given for a plan without feed-forward, or two options exclude each other.
    """
    given: dict[str, str | None] = {
        "job": None if job is None else str(job),
        "machine": _reference(machine),
        "par": words.text("par"),
        "actual": _reference(words.values.get("actual")),
    }
    for planning_option, file_form in RECORDED:
        text = words.text(planning_option.word)
        value = (
            None if text is None or planning_option.parse is None else planning_option.parse(text)
        )
        given[file_form.key] = value if isinstance(value, str) else text
    if (law := words.text("law")) is not None:
        law_options = options_of(interpolation=given["interpolation"], law=law)
        given["interpolation"] = law_options.interpolation
    smoothing = words.text("smoothing")
    of_loads = words.flag("feed_forward") or "feed-forward" in recorded
    if smoothing is not None and not of_loads:
        raise OptionError("--smoothing needs --feed-forward", remedy="Give that too.")
    robust = words.text("robust") is not None or "robust" in recorded
    given["change"] = smoothing if robust else None
    given["feed-forward"] = None if robust else smoothing
    if words.flag("feed_forward") and given["feed-forward"] is None:
        given["feed-forward"] = recorded.get("feed-forward", FEED_FORWARD)
    return given


def _reference(machine: object) -> str | None:
    """Return the name by which a machine is loaded again; None for none."""
    if machine is None:
        return None
    return machine.reference if isinstance(machine, Machine) else str(machine)


def _loaded(machine: object, name: str) -> str | Machine:
    """Return a machine that the caller has loaded, else the name of the machine to load."""
    return machine if isinstance(machine, Machine) else name


def _origin(path: Path, recording: Recording, given: Mapping[str, str | None]) -> dict[str, str]:
    """Return the options of the recorded plan: each as given, else as recorded, else default."""
    origin = {
        "interpolation": DEFAULT_INTERPOLATION,
        "feed": "programmed",
        "tolerance": DEFAULT_TOLERANCE,
        **recording.origin,
        **{key: text for key, text in given.items() if text is not None},
    }
    for key, option in (("job", "--job"), ("machine", "--machine")):
        if key not in origin:
            raise OptionError(
                f"{path.name} does not name its {key}",
                remedy=f"Give it with {option}.",
            )
    return origin


def refuse_other_files(path: Path, recording: Recording, job: Job, ran: Machine) -> None:
    """Refuse a job or a machine that differs in any byte from the recorded one."""
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
            remedy="Give the machine file of the run with --machine, and its other files with "
            "--par and --actual.",
        )


def _refuse_copies(recordings: Sequence[Path]) -> None:
    """Refuse a run that is given twice: it would look like perfect repeatability."""
    seen: dict[str, Path] = {}
    for path in recordings if len(recordings) > 1 else ():
        if path.is_file():
            with path.open("rb") as file:
                earlier = seen.setdefault(file_digest(file, "sha256").hexdigest(), path)
            if earlier is not path:
                raise OptionError(
                    f"{path.name} holds the same bytes as {earlier.name}: it is the same run",
                    remedy="Give every run once.",
                )


def _refuse_other_options(path: Path, recorded: Mapping[str, str], chosen: dict[str, str]) -> None:
    """Refuse options that differ from the options of the recorded run."""
    if not recorded:
        return  # a trace of another controller names no plan
    for key in _PLANNED_WITH:
        with_recorded = {name: text for name, text in chosen.items() if name != key}
        if key in recorded:
            with_recorded[key] = recorded[key]
        elif key in _ALWAYS_RECORDED:
            continue
        if options_from(with_recorded) != options_from(chosen):
            recorded_text, chosen_text = (texts.get(key, "none") for texts in (recorded, chosen))
            if key == "table":
                recorded_text, chosen_text = (
                    text if text == "none" else table_words(text)
                    for text in (recorded_text, chosen_text)
                )
            raise OptionError(
                f"{path.name} was recorded with {key} {recorded_text}, not {chosen_text}",
                remedy="Judge each run against its own plan: leave the option out, "
                "and give runs with other options apart.",
            )


LIMIT = 0.05
"""Relative error of a stitch's time up to which no warning is given, if the specification has no
limit of ``stitch_length_error``."""
_RUNS = 16
_ROUNDING = 1e-6  # relative rounding error of a deviation that is measured at points of the path


def warnings_of(proof: Proof) -> list[str]:
    """Return all warnings of a proof: about its machine, job, plan and verdict."""
    plan = proof.plan
    return [
        *plausibility_warnings(plan.machine),
        *(plan.machine.planner.left_out if plan.machine.planner is not None else []),
        *plan.job.suspicions(own_feed=plan.feed_override is not None),
        *plan.intent.warnings,
        *proof_warnings(proof),
        *needle_warnings(proof),
    ]


def warnings_of_all(proofs: Sequence[Proof]) -> list[str]:
    """Return the warnings of several proofs, without repetitions."""
    return list(dict.fromkeys(warning for proof in proofs for warning in warnings_of(proof)))


def tolerance_warnings(plan: Plan) -> list[str]:
    """Return a warning if the planned path deviates from the program by more than the tolerance."""
    if MEASURES["path_deviation"].of_plan(plan) is None or _keeps(plan):
        return []
    (worst,) = measure_path_deviation(plan)
    return _deviation_warnings(plan, worst.value, worst.job_line)


def proof_warnings(proof: Proof) -> list[str]:
    """Return the warning of ``tolerance_warnings``, with the deviation from a proof's verdict."""
    found = [r for r in proof.verdict.results if r.name == "path_deviation"]
    if not found or found[0].measured is None or _keeps(proof.plan):
        return []
    return _deviation_warnings(proof.plan, found[0].measured, found[0].job_line)


def _keeps(plan: Plan) -> bool:
    name = plan.motion.path.interpolation
    leaves_outside = "outside" in plan.options  # the deviations of adjacent corners may then add up
    return (name in KEEPING_TOLERANCE and not leaves_outside) or on_chords(name)


def _deviation_warnings(plan: Plan, deviation_m: float | None, line: int | None) -> list[str]:
    tolerance_m = parse_tolerance_m(plan.options["tolerance"])
    if deviation_m is None or deviation_m <= tolerance_m * (1.0 + _ROUNDING):
        return []
    line_text = f" at line {line}" if line else ""
    return [
        f"{plan.motion.path.interpolation} does not keep the tolerance of "
        f"{tolerance_m * 1e3:g} mm: the planned path is "
        f"{deviation_m * 1e3:.3g} mm off the programmed one{line_text}; "
        f"{', '.join(KEEPING_TOLERANCE[:-1])} and {KEEPING_TOLERANCE[-1]} keep it"
    ]


def needle_warnings(proof: Proof) -> list[str]:
    """Return a warning if the time of a stitch differs much from a turn of an even needle.

    The limit is the limit of ``stitch_length_error``: if the needle turns evenly, a relative error
    of a stitch's time causes the same relative error of its length.
    """
    by_name = {result.name: result for result in proof.verdict.results}
    time, length = by_name.get("needle_time_error"), by_name.get("stitch_length_error")
    limit = LIMIT if length is None or length.limit is None else length.limit
    if time is None or time.measured is None or time.measured <= limit:
        return []
    if not _even(proof.plan.job):
        return []
    relation = "more" if time.note == "too long" else "less"
    line_text = f" at line {time.job_line}" if time.job_line else ""
    return [
        f"the needle should turn evenly, but {proof.plan.motion.path.interpolation} makes a "
        f"stitch{line_text} "
        f"{100.0 * time.measured:.2g} % {relation} than a turn, limit {100.0 * limit:g} %: "
        f"stitches are judged as if it waited for the head; --feed-forward and --interpolation "
        f"linear keep its time"
    ]


def _even(job: Job) -> bool:
    """Return whether the first stitches of a job all take the same time."""
    times = {
        feed.value
        for run in islice(job.runs(), _RUNS)
        if isinstance(run, MoveRun)
        for _, feed in run.feeds
        if feed is not None and feed.mode is FeedMode.INVERSE_TIME
    }
    return len(times) == 1
