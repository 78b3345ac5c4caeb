"""The Python interface: functions for most questions of the command line, and their answers.

``import threadline as tl`` provides all of them: ``tl.prove("x.prg", "lathe-winder").passed``. The
options have the names and defaults of the command line: ``option_table`` declares them,
``__init__.pyi`` declares their types, and ``docs/options.md`` lists them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from threadline.base.arguments import checked
from threadline.base.option_defaults import DEFAULT_INTERPOLATION
from threadline.errors import OptionError
from threadline.face.answers import Answer, FastestResult, PathLike, Proved
from threadline.face.loops import analyse, control, tune
from threadline.face.many import design, yields
from threadline.face.running import run
from threadline.identify.commissioning import fit, measure, trim
from threadline.machine import Machine
from threadline.motion.shaping.designs import shaper
from threadline.proof.option_form import Door, Word
from threadline.proof.option_table import options_for
from threadline.proof.python_arguments import with_options
from threadline.proof.request import Words, check_target, chosen_machine, with_radii_of

if TYPE_CHECKING:
    from threadline.files.formats import Written
    from threadline.jobs.winding.build_up import Laid
    from threadline.motion.timing.retime import retime
    from threadline.readback.equal import Equality
    from threadline.search import Comparison
    from threadline.search.learned_job import LearnedJob, LearnedRuns


__all__ = [
    "analyse", "compare", "compile", "control", "design", "equal", "fastest", "fit", "judge",
    "learn", "load_machine", "measure", "prove", "retime", "run", "shaper", "trim", "tune",
    "wind", "yields",
]  # fmt: skip


def __getattr__(name: str) -> object:
    """Return ``retime``, whose planner of optimal motions few of the other functions need."""
    if name != "retime":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from threadline.motion.timing.retime import retime

    return retime


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
        If there is no machine of that name, or the file does not describe a machine.
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
        The options of ``threadline prove``; ``spec`` may also be a specification object, and
        ``actual`` a machine object.

    Raises
    ------
    InputError
        If an argument is wrong; the message is the same as on the command line.
    """
    from threadline.proof.pipeline import prove as prove_job
    from threadline.proof.pipeline import with_shaping

    given = Words.of("prove", Door.PYTHON, words)
    trials, chosen, options = given.trials(), given.machine(machine), given.options(job)
    spec = with_shaping(given.spec(chosen), chosen, options)
    with given.judging():
        return Proved(prove_job(Path(job), chosen, spec, options, None, trials, given.actual()))


@with_options
@checked
def fastest(job: PathLike, machine: PathLike | Machine, **words: Word) -> FastestResult:
    """Find the fastest way to do a job in spec.

    The search varies the feed of a part program, the needle speed of a seam, the commands and
    waits of a move list, or the shaft speed of an embroidery design.

    Parameters
    ----------
    job, machine
        As ``prove`` takes them.
    **words
        The options of ``threadline fastest``. ``robust="100 %"`` asks for one plan that passes on
        every machine whose loads and springs are at the ends of this share of their tolerances.

    Raises
    ------
    InputError
        As on the command line.
    """
    from threadline.search import FastestJob
    from threadline.search.by_pace import answered, best_move_list
    from threadline.search.mismatch import CYCLE
    from threadline.search.question import question_of

    given = Words.of("fastest", Door.PYTHON, words)
    with given.judging():
        found = answered(question_of(given, Path(job), machine))
    proving = {one.word for one in options_for("prove", Door.PYTHON)}
    proving_words = {word: value for word, value in words.items() if word in proving}
    own_end = isinstance(found.of, FastestJob) and words.get("high") is None
    return FastestResult(
        found.best if found.over_band is None else found.over_band.cycle_s,
        found.unit,
        found.limited_by,
        found.of if found.over_band is None else found.over_band,
        found.again,
        best_move_list(found),
        found.certainty,
        found.mismatch,
        found.ended,
        partial(_prove_again, job, machine, proving_words),
        "the velocity limits of the axes" if own_end else "the end of the search",
        "" if found.searched is CYCLE else found.searched.name,
        Path(job),
    )


def _prove_again(
    job: PathLike,
    machine: PathLike | Machine,
    proving_words: Mapping[str, Word],
    in_place: Path | None,
    **words: Word,
) -> Proved:
    """Prove a job, or a file ``in_place`` of it, with the proving_words words of its search."""
    return prove(job if in_place is None else in_place, machine, **{**proving_words, **words})


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
        Each interpolation is proved at each feed; without feeds, at the programmed feeds of the
        job.
    shapers
        Each pair of interpolation and feed is proved with each shaper; ``"none"``: no shaper.
    with_fastest
        Whether to search the fastest feed of each interpolation as well.
    **words
        The other options of ``threadline compare``.

    Raises
    ------
    InputError
        As on the command line.
    """
    from threadline.proof.pipeline import open_job
    from threadline.search import compare as compare_job

    given = Words.of("compare", Door.PYTHON, words)
    trials, named = given.trials(), given.machine(machine)
    planned = given.each_options(job, interpolations, feeds, shapers)
    chosen = with_radii_of(named, planned[0])
    with given.judging():
        return compare_job(
            open_job(Path(job), chosen, planned[0]),
            chosen,
            given.spec(chosen),
            planned,
            with_fastest=with_fastest,
            trials=trials,
            actual=given.actual(),
        )


@with_options
@checked
def judge(
    recordings: PathLike | Sequence[PathLike],
    *,
    job: PathLike | None = None,
    machine: PathLike | Machine | None = None,
    **words: Word,
) -> Answer:
    """Judge the motion of a machine, from one or several recordings of the same job.

    Parameters
    ----------
    recordings
        Recording files, in any format of ``docs/files.md``.
    job, machine
        The job and the machine, as ``prove`` takes them; None: the names in the recording.
    **words
        The options with which the plan was made, as on the command line. An option that is left
        out is read from the recording; without ``spec`` the specification of the machine applies.

    Raises
    ------
    InputError
        As on the command line.
    """
    from threadline.proof.recorded import judge_files

    files = [recordings] if isinstance(recordings, str | Path) else list(recordings)
    if not files:
        raise OptionError("there is no recording to judge", remedy="Name one at least.")
    given = Words.of("judge", Door.PYTHON, words)
    named = None if job is None else Path(job)
    return Answer(judge_files([Path(file) for file in files], given, job=named, machine=machine))


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
        The file to write.
    slower
        Whether to write a program even if the firmware needs more time for it than for the
        original job.
    **words
        The options of ``threadline compile``; ``interpolation`` is ``"auto"`` unless given, on
        every machine.

    Raises
    ------
    InputError
        As on the command line; nothing is written then.
    """
    from threadline.proof.pipeline import open_job, plan_job, write

    given = Words.of("compile", Door.PYTHON, words)
    chosen, options = given.machine(machine), given.options()
    check_target(target, chosen, options)
    plan = plan_job(open_job(Path(job), chosen, options), chosen, options)
    return write(plan, target, out, slower=slower)


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
    """Check that the files for controllers give the planned motion of a job.

    Each file is read by code that did not write it, and its positions and times are compared with
    the plan.

    Parameters
    ----------
    job, machine
        As ``prove`` takes them.
    targets
        Targets as ``compile`` takes them; without targets and files, all targets of this kind of
        machine.
    files
        Existing files to check, each as ``"TARGET=FILE"``. For any other target a temporary file is
        written and checked.
    slower
        As for ``compile``.
    **words
        The options of ``threadline equal``, the same as for ``compile``.

    Raises
    ------
    InputError
        As on the command line; for example if a file belongs to another job or machine, has another
        format, or no target could be compared.
    """
    from threadline.proof.pipeline import open_job, plan_job
    from threadline.readback.equal import asked_of, equal_targets

    given = Words.of("equal", Door.PYTHON, words)
    chosen, options = given.machine(machine), given.options()
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
    """Repeat a job and correct its references after each run by the error of this run.

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
        Recordings of real runs, in the order of the runs, to learn from instead of simulated runs;
        the result then holds the table for the next run.
    **words
        The options of ``threadline learn``. ``prove(..., table=FILE)`` plays a table that
        ``.write`` of the result has written.

    Raises
    ------
    InputError
        As on the command line.
    """
    from threadline.files.formats import read_recording
    from threadline.search.learned_job import (
        learned_from,
        learned_on_twins,
        refuse_simulated,
        rules_of,
    )

    given = Words.of("learn", Door.PYTHON, words)
    if measured not in ("head", "motor"):
        raise OptionError(f"unknown measured {measured!r}", remedy='Give "head" or "motor".')
    rules = rules_of(gain, low_pass, "motor" if measured == "motor" else "head")
    if not runs:
        with given.judging():
            return learned_on_twins(given, Path(job), machine, rules, repeats)
    refuse_simulated(given)
    recorded = {str(file): read_recording(file) for file in runs}
    return learned_from(given, Path(job), machine, rules, recorded)


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
