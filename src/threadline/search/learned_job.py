"""The answers of ``threadline learn``: from simulated machines, or from recorded runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from threadline.base.arrays import finite
from threadline.base.option_defaults import FEED_FORWARD, OPTIMAL_FEED_FORWARD, USUAL
from threadline.base.progress import Progress
from threadline.base.summary import Summarised, Summary
from threadline.commands.learned import learned_commands, learned_plan
from threadline.commands.plan import Plan
from threadline.errors import OptionError
from threadline.files import Recording, TickTable, tick_table
from threadline.files.formats import Written
from threadline.machine import Machine
from threadline.motion.path.interpolations import OPTIMAL
from threadline.proof.option_form import Type
from threadline.proof.option_table import RECORDED
from threadline.proof.options import Options, options_from
from threadline.proof.pipeline import check_machine, open_job, plan_job, with_shaping
from threadline.proof.recorded import refuse_other_files
from threadline.proof.request import Words, with_radii_of
from threadline.search.learn import MOST_REPEATS, Learner, check_learnable, learn
from threadline.search.repeats import (
    Learned,
    Repeat,
    Rules,
    Sensed,
    Tried,
    best_table,
    with_followed,
)
from threadline.units import parse_number
from threadline.verdict import Judge, Spec, closing, verdict_json


def check_table_file(file: Path) -> None:
    """Refuse the name of a learned table unless its ending names a format that can hold it.

    Raises
    ------
    OptionError
        If no format that can hold the table has this ending; the message names the possible
        endings.
    """
    if file.suffix.lower() not in {".npz", ".csv"}:
        raise OptionError(
            f"-o {str(file)!r}: the name of a learned table ends in .npz or .csv",
            remedy=f"Write -o {file.stem}.npz.",
        )


def write_table(table: TickTable, file: Path) -> Written:
    """Write a learned table in the format of the ending.

    Raises
    ------
    OptionError
        If the ending names no format for it.
    RecordingError
        If the file cannot be written.
    """
    from threadline.files.formats.tick_table import write_table_csv, write_table_npz

    check_table_file(file)
    return (write_table_npz if file.suffix.lower() == ".npz" else write_table_csv)(table, file)


def rules_of(gain: str | float, low_pass: str | None, sensed: Sensed) -> Rules:
    """Return the rules of learning from the words of the command line.

    Raises
    ------
    OptionError
        If a number cannot be read, or the gain is not a share.
    """
    share = parse_number("--gain", gain, "", "90 %") if isinstance(gain, str) else gain
    if not 0.0 < share <= 1.0:
        raise OptionError(
            f"--gain {gain!r} must be above 0 and at most 100 %", remedy='Give "90 %".'
        )
    hz = None if low_pass is None else parse_number("--low-pass", low_pass, "Hz", "20 Hz")
    return Rules(gain=share, low_pass_hz=hz, sensed=sensed)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class LearnedJob(Summarised):
    """A job learned on one simulated machine or on several, each with its own table.

    Parameters
    ----------
    base
        The plan that learning began with.
    spec
        The specification.
    machines
        The result of each machine, by the description of the machine.
    """

    base: Plan
    spec: Spec
    machines: tuple[tuple[str, Learned], ...]

    @property
    def passed(self) -> bool:
        """Whether the best table of every machine is in specification."""
        return all(one.passed for _, one in self.machines)

    @property
    def table(self) -> TickTable:
        """The best table of the only machine.

        Raises
        ------
        OptionError
            If several machines learned a table each.
        """
        if len(self.machines) > 1:
            raise OptionError(
                f"each of the {len(self.machines)} machines learned a table of its own",
                remedy="Leave --ends and --band out, and give the machine with --actual.",
            )
        return tick_table(self.machines[0][1].plan.commands)

    def write(self, file: str | Path) -> Written:
        """Write the best table of the only machine (.npz, .csv), for ``--table``."""
        return write_table(self.table, Path(file))

    def _summary(self) -> Summary:
        rows = [
            [name, str(one.best), str(len(one.repeats) - 1), closing(one.proof.verdict)]
            for name, one in self.machines
        ]
        title = f"{self.base.job.name} on {self.base.machine.name}, learned"
        return Summary(title, ["machine", "best run", "repeats", "verdict"], rows)

    def content(self) -> dict[str, Any]:
        """Return the answer for JSON."""
        return {
            "job": self.base.job.name,
            "machine": self.base.machine.name,
            "passed": self.passed,
            "level": self.machines[0][1].proof.verdict.level,
            "machines": [
                {
                    "name": name,
                    "machine_sha256": one.actual.sha256,
                    "passed": one.passed,
                    "best": one.best,
                    "within": one.within,
                    "repeats": [repeat_content(self.base, run) for run in one.repeats],
                    "verdict": verdict_json(one.proof.verdict, one.plan),
                }
                for name, one in self.machines
            ],
            "filters": filter_content(self.machines[0][1]),
        }


def filter_content(learned: Learned) -> dict[str, Any]:
    """Return the learning filters for JSON, by axis."""
    return {
        one.axis: {
            "gain": learned.rules.gain,
            "low_pass_hz": one.low_pass_hz,
            "sensed": learned.rules.sensed,
            "unlearned_hz": None if one.unlearned_hz is None else list(one.unlearned_hz),
        }
        for one in learned.filters
    }


def repeat_content(plan: Plan, run: Repeat) -> dict[str, Any]:
    """Return a repeat for JSON, in SI units."""
    worst = run.verdict.tightest
    return {
        "number": run.number,
        "passed": run.verdict.passed,
        "share": finite(run.share),
        "tightest": None if worst is None else worst.name,
        "error_rms": dict(zip(plan.axes, run.error_si.tolist(), strict=True)),
        "error_peak": dict(zip(plan.axes, run.peak_si.tolist(), strict=True)),
        "error_rms_m": run.error_m,
        "current": run.current,
        "gain": run.gain,
        "followed": run.followed,
        "note": run.note,
    }


def learned_on_twins(
    words: Words,
    file: Path,
    machine: str | Path | Machine,
    rules: Rules,
    repeats: int,
    progress: Progress | None = None,
) -> LearnedJob:
    """Repeat a job on the simulated machines that the words name, and learn from every run.

    Raises
    ------
    InputError
        If the job, the machine or an option cannot be read, or the job cannot be learned.
    """
    if not 1 <= repeats <= MOST_REPEATS:
        raise OptionError(
            f"--repeats {repeats} is not from 1 to {MOST_REPEATS}",
            remedy="Five repeats are often enough.",
        )
    trials, chosen, actual = words.trials(), words.machine(machine), words.actual()
    several = {"--ends": trials.ends, "--band": trials.band, "--actual": actual}
    if len(given := [name for name, value in several.items() if value is not None]) > 1:
        raise OptionError(
            f"{' and '.join(given)} exclude each other: each names the machines that learn",
            remedy="Give one of them.",
        )
    options = words.options()
    spec = with_shaping(words.spec(chosen), chosen, options)
    check_machine(chosen)
    machine_with_radii = with_radii_of(chosen, options)
    run_machines: Sequence[tuple[str, Machine]]
    if others := trials.others(chosen):
        run_machines = next(iter(others.values())).machines
    else:
        run_machines = [((actual or chosen).name, actual or chosen)]
    job = open_job(file, machine_with_radii, options)
    check_learnable(job, machine_with_radii, options.on(machine_with_radii).following)
    plan = plan_job(job, machine_with_radii, options)
    learner = Learner(plan, rules)
    learned_machines = []
    for machine_index, (name, run_machine) in enumerate(run_machines):

        def of_all(activity: str, fraction: float, machine_index: int = machine_index) -> None:
            if progress is not None:
                progress(activity, (machine_index + fraction) / len(run_machines))

        learned = learn(
            learner, spec, actual=None if run_machine is chosen else run_machine,
            repeats=repeats, trials=trials, progress=of_all,
        )  # fmt: skip
        learned_machines.append((name, learned))
    return LearnedJob(base=plan, spec=spec, machines=tuple(learned_machines))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class LearnedRuns(Summarised):
    """The next table of a job, learned from recorded runs.

    Parameters
    ----------
    base
        The plan, with its own table.
    plan
        The plan with the next table.
    repeats
        Every recorded run, in the given order.
    gain, note
        Gain of the change after the best run, and the limit that shortened the change.
    """

    base: Plan
    plan: Plan
    repeats: tuple[Repeat, ...]
    gain: float
    note: str

    @property
    def best(self) -> int:
        """Number of the recorded run that is best in specification."""
        return best_table(self.repeats)

    @property
    def table(self) -> TickTable:
        """The next table."""
        return tick_table(self.plan.commands)

    @property
    def passed(self) -> bool:
        """Whether the best recorded run is in specification."""
        return self.repeats[self.best].verdict.passed

    def write(self, file: str | Path) -> Written:
        """Write the next table (.npz, .csv), for ``--table``."""
        return write_table(self.table, Path(file))

    def _summary(self) -> Summary:
        rows = [
            [str(number), "yes" if run.verdict.passed else "no", f"{100.0 * run.share:.0f} %",
             f"{1e3 * run.error_m:.4g} mm", "" if run.followed else "worse: undone"]
            for number, run in enumerate(self.repeats)
        ]  # fmt: skip
        title = f"{self.base.job.name} on {self.base.machine.name}, learned from recorded runs"
        header = ["run", "in spec", "of the limit", "error", "note"]
        closing = f"gain {self.gain:.3g} after run {self.best}" if self.gain else self.note
        return Summary(title, header, rows, f"next table: {closing}")

    def content(self) -> dict[str, Any]:
        """Return the answer for JSON."""
        return {
            "job": self.base.job.name,
            "machine": self.base.machine.name,
            "passed": self.passed,
            "best": self.best,
            "repeats": [repeat_content(self.base, run) for run in self.repeats],
            "gain": self.gain,
            "note": self.note,
        }


def refuse_simulated(words: Words) -> None:
    """Refuse options that ask for simulated machines, for learning from recorded runs.

    Raises
    ------
    OptionError
        If one is given.
    """
    trials = words.trials()
    simulated = {
        "--tolerances": trials.machines and trials.wanted_yield is None,
        "--yield": trials.wanted_yield,
        "--ends": trials.ends,
        "--band": trials.band,
        "--actual": words.values.get("actual"),
    }
    for name, value in simulated.items():
        if value:
            raise OptionError(
                f"--from judges recorded runs, and {name} asks for simulated machines",
                remedy=f"Leave {name} out.",
            )


def learned_from(
    words: Words,
    file: Path,
    machine: str | Path | Machine,
    rules: Rules,
    recorded: Mapping[str, Recording],
) -> LearnedRuns:
    """Learn the next table from recordings of runs, the first one first.

    The options of the plan are taken from the first recording.

    Raises
    ------
    OptionError
        If there is no recording, if one belongs to another job, machine or plan, or if a given
        planning option differs from the recording's.
    """
    if not recorded:
        raise OptionError("there is no run to learn from", remedy="Name one with --from.")
    chosen = words.machine(machine)
    origins = [
        {"interpolation": "default", "feed": "programmed", "tolerance": "0.1 mm", **one.origin}
        for one in recorded.values()
    ]
    options = options_from(_without_table(origins[0]))
    if words.text("table") is not None:
        raise OptionError(
            "--table and --from exclude each other: every recording names the table that it played",
            remedy="Leave --table out.",
        )
    if words.options().on(chosen) != options.on(chosen) and words.changed():
        raise OptionError(
            f"the options of planning differ from {next(iter(recorded))}",
            remedy="Leave them out: they are read from the recording.",
        )
    machine_with_radii = with_radii_of(chosen, options)
    job = open_job(file, machine_with_radii, options)
    for (name, recording), origin in zip(recorded.items(), origins, strict=True):
        refuse_other_files(Path(name), recording, job, chosen)
        if options_from(_without_table(origin)) != options:
            raise OptionError(
                f"{name} was planned with other options than {next(iter(recorded))}",
                remedy="Give runs of one plan.",
            )
    plan = plan_job(job, machine_with_radii, options)
    base = tick_table(plan.commands)
    spec = with_shaping(words.spec(chosen), chosen, options)
    learner = Learner(plan, rules)
    runs: list[Tried] = []
    repeats: list[Repeat] = []
    for number, (recording, origin) in enumerate(zip(recorded.values(), origins, strict=True)):
        table = base if "table" not in origin else learned_commands(base, origin["table"])
        recording_in_memory = replace(recording, blocks=tuple(recording.blocks))
        verdict = Judge(replace(plan, commands=table), spec).verdict(
            [recording_in_memory], recorded=True
        )
        run = learner.tried(recording_in_memory, learner.offset_of(table), passed=verdict.passed)
        runs.append(run)
        repeats.append(learner.account(run, recording_in_memory, verdict, (number, 0.0, "")))
    offset, gain, note = learner.next(runs)
    return LearnedRuns(
        base=plan, plan=learned_plan(plan, learner.commands(offset)),
        repeats=tuple(with_followed(repeats)), gain=gain, note=note,
    )  # fmt: skip


def typed_options(origin: Mapping[str, str]) -> dict[str, str]:
    """Return the options, as typed, for ``prove`` and ``run`` to make the plan of a recording.

    The learned table is left out.
    """
    typed: dict[str, str] = {}
    for option, recorded_as in RECORDED:
        text = origin.get(recorded_as.key)
        if text is None or option.name in {"table", "smoothing"} or text in USUAL:
            continue
        if option.type is Type.FLAG:
            typed[option.typed] = ""
            default_text = (
                OPTIMAL_FEED_FORWARD if origin["interpolation"] == OPTIMAL else FEED_FORWARD
            )
            if "robust" not in origin and recorded_as.read(text) != recorded_as.read(default_text):
                typed["--smoothing"] = text
        elif recorded_as.read(text) != getattr(_PLAIN, option.attribute):
            typed[option.typed] = text
    return typed | ({"--smoothing": origin["change"]} if "change" in origin else {})


_PLAIN = Options()


def _without_table(origin: Mapping[str, str]) -> dict[str, str]:
    return {key: text for key, text in origin.items() if key != "table"}
