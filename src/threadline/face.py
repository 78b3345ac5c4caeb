"""The face: every question of the command line as a function, and the answers.

The file is long because it is read as a whole, and nearly half of its lines are docstrings.

``import threadline as tl`` has all of it: ``tl.prove("x.prg", "lathe-winder").passed``. Options are
the words of the command line, with the same defaults: ``option_table`` declares them,
``__init__.pyi`` has their types, and ``docs/options.md`` lists them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from threadline.base.arguments import checked
from threadline.base.arrays import FloatArray
from threadline.base.option_defaults import DEFAULT_INTERPOLATION
from threadline.base.wording import plain
from threadline.base.writing import check_machine_output
from threadline.errors import OptionError
from threadline.files.recording import columns_of
from threadline.identify.commissioning import fit, measure, trim
from threadline.machine import Machine
from threadline.motion.timing.retime import retime
from threadline.proof.asked import (
    Words,
    check_target,
    chosen_machine,
    in_arguments,
    with_options,
    with_radii_of,
)
from threadline.proof.option_form import Door, Word
from threadline.proof.option_table import options_for
from threadline.verdict import Result, Verdict, closing, verdict_json, verdict_rows

if TYPE_CHECKING:
    from threadline.commands.plan import Plan
    from threadline.files import Recording
    from threadline.files.formats import Written
    from threadline.jobs.winding.build_up import Laid
    from threadline.motion.shaping import Shaper
    from threadline.proof.pipeline import Proof
    from threadline.proof.recorded import Judged
    from threadline.search import Certainty, Comparison, Mismatch
    from threadline.search.controller_design import ControlDesign
    from threadline.search.equal import Equality
    from threadline.search.learned_job import LearnedJob, LearnedRuns
    from threadline.search.tune import Tuning


PathLike = str | Path
_MOST_ROWS = 7  # of the criteria that an answer prints: with the lines around them ten in all
_URGENCY = {"failed": 0, "not-measured (required)": 1, "passed": 2}


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Answer:
    """A verdict and its plan; prints itself in at most ten lines, in a notebook as a table.

    Parameters
    ----------
    of
        A proof; of recordings, the plan and the specification that they were judged by.
    """

    of: Proof | Judged

    @property
    def plan(self) -> Plan:
        """What was intended."""
        return self.of.plan

    @property
    def verdict(self) -> Verdict:
        """Every criterion, with what was measured."""
        return self.of.verdict

    @property
    def passed(self) -> bool:
        """Whether nothing failed and all that is required was measured."""
        return self.of.verdict.passed

    @checked
    def result(self, criterion: str, axis: str = "") -> Result:
        """Return the result of a criterion, of the worst axis where none is named.

        Raises
        ------
        KeyError
            If it was not judged.
        """
        return self.of.verdict.result(criterion, axis)

    def json(self) -> dict[str, Any]:
        """Return what the command line prints with ``--json``."""
        return verdict_json(self.of.verdict, self.of.plan)

    def __repr__(self) -> str:
        _, rows, more = self._summary()
        parts = [row[:4] for row in rows]
        widths = [max(map(len, column)) for column in zip(*parts, strict=True)]
        lines = [f"{self._title()}: {closing(self.of.verdict)}"]
        for (name, axis, measured, limit), row in zip(parts, rows, strict=True):
            figures = f"{measured:>{widths[2]}}  limit {limit:<{widths[3]}}"
            where = "" if row[6] == "-" else f", line {row[6]}"
            lines.append(f"  {name:<{widths[0]}}  {axis:<{widths[1]}}  {figures}  {row[4]}{where}")
        return "\n".join(plain(line) for line in [*lines, *([f"  {more}"] if more else [])])

    def _repr_html_(self) -> str:
        header, rows, more = self._summary()
        lines = [f"<table><caption>{escape(plain(self._title()))}</caption>"]
        for tag, row in [("th", header), *(("td", row) for row in rows)]:
            cells = "".join(f"<{tag}>{escape(plain(cell))}</{tag}>" for cell in row)
            lines.append(f"<tr>{cells}</tr>")
        below = "; ".join(filter(None, (closing(self.of.verdict), more)))
        return "\n".join([*lines, f"</table><p>{escape(plain(below))}</p>"])

    def _title(self) -> str:
        plan = self.of.plan
        return f"{plan.job.name} on {plan.machine.name}, {plan.duration_s:.4g} s"

    def _summary(self) -> tuple[list[str], list[list[str]], str]:
        """Return header and rows of the most urgent criteria, and a line about the others."""
        header, rows = verdict_rows(self.of.verdict)
        rows.sort(key=lambda row: _URGENCY.get(row[4], len(_URGENCY)))
        others = len(rows) - _MOST_ROWS
        more = f"and {others} more; .verdict.results has all of them" if others > 0 else ""
        return header, rows[:_MOST_ROWS], more


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Proved(Answer):
    """A proof: a plan, what the simulated machine made of it, and the verdict."""

    of: Proof

    @property
    def recording(self) -> Recording:
        """What happened on the simulated machine."""
        return self.of.recording

    @checked
    def columns(self, run: int = 1) -> dict[str, FloatArray]:
        """Return the channels of a judged run as columns, for plots and data frames.

        ``time [s]`` is the first one; all are of equal length. The others have the name and the
        unit of their channel, such as ``X.load [m]``. A channel with fewer samples holds each value
        until its next one, and is NaN before its first.

        Raises
        ------
        OptionError
            If there is no such run.
        """
        if not 1 <= run <= self.of.runs:
            raise OptionError(
                f"run={run} is none of the {self.of.runs} judged", remedy="Give run=1."
            )
        return columns_of(self.of.run(run))

    @checked
    def report(self, folder: PathLike) -> Path:
        """Write the report (HTML, PDF, PNG, SVG) into a folder; return its page."""
        from threadline.report.proof import write_report
        from threadline.search.studied import studied

        place = Path(folder)
        if place.exists() and not place.is_dir():
            raise OptionError(
                f"cannot write {str(place)!r}: it is a file, not a folder",
                remedy="Give the folder of the report.",
            )
        return write_report(studied(self.of), place)

    @checked
    def write(self, file: PathLike, sign: PathLike | None = None) -> Written:
        """Write the proof as a file, see ``docs/files.md``; ``sign`` is the file of a key."""
        from threadline.proof.proof_file import read_key, write_proof

        return write_proof(self.of, file, None if sign is None else read_key(sign))

    @checked
    def record(self, file: PathLike) -> Written:
        """Write the recording; the ending of the file says how."""
        from threadline.files.formats import write_recording

        return write_recording(self.of.recording, file)


@dataclass(frozen=True, slots=True, eq=False)
class FastestResult:
    """The result of a search for the fastest way to do a job in spec.

    Parameters
    ----------
    best
        The highest feed (m/s of the fastest axis, or a share of the program's feeds where these
        differ) or needle speed (stitch/s) in spec, the shortest cycle of a move list (s), or the
        shortest duration of an embroidery design (s); None where nothing is in spec.
    unit
        ``"m/s"``, ``"stitch/s"`` or ``"s"``; empty for a share.
    limited_by
        The criterion that forbids more.
    of
        The result of the search in ``threadline.search``, with every try; its type depends on the
        job (``docs/api.md``).
    best_options
        The options of planning with which ``prove`` plans the best: ``tl.prove(job, machine,
        **best_options)``. None where nothing is in spec, or where only a move list can say it.
    certainty
        What it costs to hold on the machines of ``ends``, ``band`` or ``robust``; None without.
    mismatch
        The fastest on machines at the ends of the tolerances, with ``mismatch``.
    """

    best: float | None
    unit: str
    limited_by: str
    of: Any
    best_options: Mapping[str, Any] | None = None
    certainty: Certainty | None = None
    mismatch: tuple[Mismatch, ...] = ()
    _asked: Callable[..., Proved] | None = None

    def prove(self, **words: Word) -> Proved:
        """Prove the best: the same job on the same machine, with ``best_options``.

        Parameters
        ----------
        **words
            Options of ``prove`` that replace those of the search, such as ``level="nominal"``.

        Raises
        ------
        OptionError
            If nothing was in spec, or where only a move list can say the best.
        """
        if self._asked is None or self.best_options is None:
            raise OptionError(
                "there is no best to prove: nothing was in spec"
                if self.best is None
                else "the best is commands that only a move list can say",
                remedy="Prove with a lower feed, or with less asked."
                if self.best is None
                else "threadline fastest -o FILE writes the move list; prove that.",
            )
        return self._asked(**{**self.best_options, **words})


__all__ = [
    "compare",
    "compile",
    "control",
    "equal",
    "fastest",
    "fit",
    "judge",
    "learn",
    "load_machine",
    "measure",
    "prove",
    "retime",
    "shaper",
    "trim",
    "tune",
    "wind",
]


@checked
def load_machine(machine: PathLike | Machine, par: PathLike | None = None) -> Machine:
    """Return a machine of the library or of a file, with overlays after plus signs.

    >>> load_machine("lathe-winder+physical").axis_names
    ('A', 'X', 'Y')

    Parameters
    ----------
    machine
        ``"lathe-winder"``, ``"mine.toml+heavy"``, or a machine.
    par
        An FW-CNC.PAR whose settings replace the machine's.

    Raises
    ------
    MachineError
        If there is none of that name, or the file does not describe one.
    """
    return chosen_machine(machine, par)


@with_options
@checked
def prove(job: PathLike, machine: PathLike | Machine, **words: Word) -> Proved:
    """Plan a job, simulate it on the machine, and judge it.

    Parameters
    ----------
    job
        Part program, seam, move list or embroidery design.
    machine
        As ``load_machine`` takes it.
    **words
        The options of ``threadline prove``; ``spec`` may be a specification, ``actual`` a machine.

    Raises
    ------
    InputError
        If anything that was given is wrong; the message is the one that the command line prints.
    """
    from threadline.proof.pipeline import prove as prove_job
    from threadline.proof.pipeline import with_shaping

    asked = Words.of("prove", Door.PYTHON, words)
    trials, chosen, options = asked.trials(), asked.machine(machine), asked.options(job)
    spec = with_shaping(asked.spec(chosen), chosen, options)
    return Proved(prove_job(Path(job), chosen, spec, options, None, trials, asked.actual()))


@with_options
@checked
def fastest(job: PathLike, machine: PathLike | Machine, **words: Word) -> FastestResult:
    """Find the fastest way to do a job in spec.

    Of a part program the feed is searched, of a seam the needle speed, of a move list the commands
    and waits, of an embroidery design the speed of the shaft.

    Parameters
    ----------
    job, machine
        As ``prove`` takes them.
    **words
        The options of ``threadline fastest``. ``robust`` asks for one plan that holds on every
        machine at the ends of that share of the tolerances of loads and springs.

    Raises
    ------
    InputError
        As on the command line.
    """
    from threadline.search.by_pace import answered
    from threadline.search.question import question_of

    found = answered(question_of(Words.of("fastest", Door.PYTHON, words), Path(job), machine))
    proving = {one.word for one in options_for("prove", Door.PYTHON)}
    kept = {word: value for word, value in words.items() if word in proving}
    return FastestResult(
        found.best if found.over_band is None else found.over_band.cycle_s,
        found.unit,
        found.limited_by,
        found.of if found.over_band is None else found.over_band,
        found.again,
        found.certainty,
        found.mismatch,
        partial(_prove_again, job, machine, kept),
    )


def _prove_again(
    job: PathLike, machine: PathLike | Machine, kept: Mapping[str, Word], **words: Word
) -> Proved:
    return prove(job, machine, **{**kept, **words})


@with_options
@checked
def compare(
    job: PathLike,
    machine: PathLike | Machine,
    interpolations: Sequence[str] = (DEFAULT_INTERPOLATION,),
    feeds: Sequence[str] = (),
    *,
    shapers: Sequence[str] = (),
    with_fastest: bool = False,
    **words: Word,
) -> Comparison:
    """Prove a job with several interpolations, feeds and shapers.

    Parameters
    ----------
    job, machine
        As ``prove`` takes them.
    interpolations, feeds
        Each interpolation is proved at each feed; without feeds, at the job's own.
    shapers
        Each pair of them is proved with each of these shapers; ``"none"`` shapes nothing.
    with_fastest
        Also search the fastest feed of each interpolation.
    **words
        The other options of ``threadline compare``.

    Raises
    ------
    InputError
        As on the command line.
    """
    from threadline.proof.pipeline import open_job
    from threadline.search import compare as compare_job

    asked = Words.of("compare", Door.PYTHON, words)
    trials, named = asked.trials(), asked.machine(machine)
    planned = asked.each_options(job, interpolations, feeds, shapers)
    chosen = with_radii_of(named, planned[0])
    return compare_job(
        open_job(Path(job), chosen, planned[0]),
        chosen,
        asked.spec(chosen),
        planned,
        with_fastest=with_fastest,
        trials=trials,
    )


@with_options
@checked
def judge(
    recordings: PathLike | Sequence[PathLike],
    *,
    job: PathLike | None = None,
    machine: str | None = None,
    **words: Word,
) -> Answer:
    """Judge what a machine did, from one recording or several of the same job.

    Parameters
    ----------
    recordings
        Files of any kind in ``docs/files.md``.
    job, machine
        The job and the machine. What is left out is read from the recording.
    **words
        How the plan was made, as on the command line. What is left out is read from the
        recording; ``spec`` is the machine's own then.

    Raises
    ------
    InputError
        As on the command line.
    """
    from threadline.proof.recorded import judge_files

    files = [recordings] if isinstance(recordings, str | Path) else list(recordings)
    if not files:
        raise OptionError("there is no recording to judge", remedy="Name one at least.")
    asked = Words.of("judge", Door.PYTHON, words)
    named = None if job is None else Path(job)
    return Answer(judge_files([Path(file) for file in files], asked, job=named, machine=machine))


@with_options
@checked
def compile(
    job: PathLike,
    machine: PathLike | Machine,
    target: str,
    out: PathLike,
    *,
    slower: bool = False,
    **words: Word,
) -> list[Written]:
    """Plan a job and write it for a controller; return the files with their hashes.

    Parameters
    ----------
    job, machine
        As ``prove`` takes them.
    target
        For a machine with axes ``csv``, ``npz``, ``ticks``, ``nc``, ``grbl``, ``fluidnc``,
        ``marlin``, ``klipper``, ``reprapfirmware``, ``linuxcnc`` or ``fanuc``; for an on/off
        machine ``st``, ``openplc``, ``plcopen`` or ``scl``; for an embroidery machine ``steps``,
        ``t15``, ``dst`` or ``u01``.
    out
        The file.
    slower
        Whether to write a program that takes longer on its firmware than the job as it stands.
    **words
        The options of ``threadline compile``; ``interpolation`` is ``"auto"`` unless given, on
        every machine.

    Raises
    ------
    InputError
        As on the command line; nothing is written then.
    """
    from threadline.proof.pipeline import open_job, plan_job, write

    asked = Words.of("compile", Door.PYTHON, words)
    chosen, options = asked.machine(machine), asked.options()
    check_target(target, chosen, options)
    plan = plan_job(open_job(Path(job), chosen, options), chosen, options)
    return write(plan, target, out, slower=slower)


@in_arguments
@checked
def control(
    machine: PathLike | Machine,
    design: str,
    out: PathLike,
    *,
    gain: float | None = None,
    sensors: Sequence[str] | None = None,
    ahead: int | None = None,
    smoothing: int | None = None,
    axes: Sequence[str] | None = None,
    direction: str | None = None,
    coupling: str | None = None,
) -> ControlDesign:
    """Design a state-space controller, and write the machine with it.

    Parameters
    ----------
    machine
        As ``load_machine`` takes it.
    design
        ``"lqg"``, ``"preview"``, ``"zpetc"`` or ``"cross-coupled"``.
    out
        Machine file to write, based on ``machine``.
    gain, sensors
        Not of ``"cross-coupled"``: gain at rest in gains of the present controllers, and sensors to
        read besides the encoders.
    ahead
        Of ``"preview"``: references to look ahead.
    smoothing
        Of ``"zpetc"``: references in each of its averages, an odd number.
    axes, direction, coupling
        Of ``"cross-coupled"``: the two axes, ``"45 deg"``, and ``"50 %"``.

    Raises
    ------
    InputError
        As on the command line; nothing is written then.
    """
    from threadline.search.controller_design import Wanted, design_controllers

    wanted = Wanted(
        design=design,
        gain=gain,
        sensors=None if sensors is None else tuple(sensors),
        ahead=ahead,
        smoothing=smoothing,
        axes=None if axes is None else tuple(axes),
        direction=direction,
        coupling=coupling,
    )
    return design_controllers(chosen_machine(machine), wanted, Path(out))


@with_options
@checked
def equal(
    job: PathLike,
    machine: PathLike | Machine,
    targets: Sequence[str] = (),
    *,
    files: Sequence[str] = (),
    slower: bool = False,
    **words: Word,
) -> Equality:
    """Say whether the files of controllers are the plan of a job.

    Each file is read by something that did not write it, and compared with the plan in place and
    time.

    Parameters
    ----------
    job, machine
        As ``prove`` takes them.
    targets
        Targets as ``compile`` takes them; without targets and files, all of the kind of machine.
    files
        ``"TARGET=FILE"`` each: a file on disk in place of one that is written for this.
    slower
        As for ``compile``.
    **words
        The options of ``threadline equal``, the same as for ``compile``.

    Raises
    ------
    InputError
        As on the command line: a file is of another job, machine or format, or no target could
        be compared.
    """
    from threadline.proof.pipeline import open_job, plan_job
    from threadline.search.equal import asked_of, equal_targets

    asked = Words.of("equal", Door.PYTHON, words)
    chosen, options = asked.machine(machine), asked.options()
    wanted = asked_of(chosen, options, targets, files, slower=slower)
    plan = plan_job(open_job(Path(job), chosen, options), chosen, options)
    return equal_targets(plan, options, wanted)


@with_options
@checked
def learn(
    job: PathLike,
    machine: PathLike | Machine,
    *,
    repeats: int = 5,
    gain: float | str = 0.9,
    low_pass: str | None = None,
    measured: str = "head",
    runs: Sequence[PathLike] = (),
    **words: Word,
) -> LearnedJob | LearnedRuns:
    """Repeat a job and correct its references by the error of every run.

    Parameters
    ----------
    job, machine
        As ``prove`` takes them.
    repeats
        How often the simulated machine repeats the job, 1 to 100.
    gain
        Share of the error that is corrected after each run.
    low_pass
        Frequency above which errors are not learned, ``"20 Hz"``.
    measured
        Where the error is measured: at the ``"head"`` or at the encoder of the ``"motor"``.
    runs
        Recordings of runs to learn from instead, the first one first; the answer is the next table.
    **words
        The options of ``threadline learn``. ``table=`` of ``prove`` plays what ``.write`` wrote.

    Raises
    ------
    InputError
        As on the command line.
    """
    from threadline.files.formats import read_recording
    from threadline.search.learned_job import learned_from, learned_on_twins, rules_of

    asked = Words.of("learn", Door.PYTHON, words)
    if measured not in ("head", "motor"):
        raise OptionError(f"unknown measured {measured!r}", remedy='Give "head" or "motor".')
    rules = rules_of(gain, low_pass, "motor" if measured == "motor" else "head")
    if not runs:
        return learned_on_twins(asked, Path(job), machine, rules, repeats)
    recorded = {str(file): read_recording(file) for file in runs}
    return learned_from(asked, Path(job), machine, rules, recorded)


@checked
def shaper(text: str) -> Shaper | dict[str, Shaper]:
    """Return the shaper that ``text`` describes, or one per axis where it names axes.

    >>> shaper("zv:10Hz").times_s.tolist()
    [0.0, 0.05]

    Raises
    ------
    OptionError
        If the text cannot be read, or no such shaper can be designed.
    """
    from threadline.motion.shaping import parse_shaper

    return parse_shaper(text)


@checked
def wind(job: PathLike) -> tuple[Laid, ...]:
    """Return the layers of a winding, each with its patterns, its circuit and its thickness.

    Parameters
    ----------
    job
        Product file with layers, ``NAME.wind.toml``, or FiberPath's ``NAME.wind``.

    Raises
    ------
    JobError
        If the file cannot be read, or a layer cannot be wound.
    """
    from threadline.jobs.winding.build_up import design
    from threadline.jobs.winding.layers import read_layers

    return design(read_layers(Path(job)))


@in_arguments
@checked
def tune(
    machine: PathLike | Machine,
    out: PathLike | None = None,
    *,
    axis: str | None = None,
    margin: str = "60 deg",
    crossover: str | None = None,
    jobs: Sequence[PathLike] = (),
    controller: str | None = None,
    rule: str = "margin",
) -> Tuning:
    """Tune the loops of a machine: controllers of five kinds by four rules; nothing moves.

    Parameters
    ----------
    machine
        As ``load_machine`` takes it.
    out
        Machine file to write, with the controllers that ``controller`` and ``rule`` name.
    axis
        Only this axis.
    margin
        Phase margin of the rule ``"margin"``.
    crossover
        Crossover of that rule, ``"13.5 Hz"``; None for the largest gain at low frequencies.
    jobs
        Jobs to simulate with each controller.
    controller
        ``"p"``, ``"pi"``, ``"pd"``, ``"pid"`` or ``"lead"``; None for the machine's own.
    rule
        ``"margin"``, ``"ultimate"``, ``"step"`` or ``"settling"``.

    Raises
    ------
    InputError
        As on the command line.
    """
    from threadline.search.tune import (
        asked,
        parse_controller,
        parse_rule,
        usual_controller,
    )
    from threadline.search.tune import tune as tune_machine
    from threadline.search.tuned_file import write_tuned

    chosen = chosen_machine(machine, None)
    kind = usual_controller(chosen) if controller is None else parse_controller(controller)
    by = parse_rule(rule)
    if out is not None:
        check_machine_output(Path(out))
    found = tune_machine(
        chosen, asked(chosen, axis, margin, crossover), [Path(job) for job in jobs]
    )
    if out is not None:
        write_tuned(found, kind, by, Path(out))
    return found
