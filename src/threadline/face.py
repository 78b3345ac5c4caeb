"""The face of the package: each question of the command line as a function, for every machine.

``import threadline as tl`` has all of it: ``tl.prove("x.prg", "lathe-winder").passed``. Options are
the words of the command line, with the same defaults: ``option_table`` declares them,
``__init__.pyi`` has their types, and ``docs/options.md`` lists them.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from threadline.answers import Answer as Answer  # noqa: PLC0414 - callers name the type of an answer
from threadline.answers import Found as Found  # noqa: PLC0414
from threadline.answers import PathLike as PathLike  # noqa: PLC0414
from threadline.answers import Proved as Proved  # noqa: PLC0414
from threadline.arguments import checked
from threadline.asked import Words, check_target, chosen_machine, python_type, with_radii_of
from threadline.errors import OptionError
from threadline.machine import Machine
from threadline.option_defaults import DEFAULT_INTERPOLATION
from threadline.option_form import Door, Word
from threadline.option_table import (
    options_for,
)
from threadline.trajectory import retime

if TYPE_CHECKING:
    from threadline.search import Comparison
    from threadline.shaping import Shaper
    from threadline.signals.files import Written

__all__ = ["compare", "compile", "fastest", "judge", "load_machine", "prove", "retime", "shaper"]

VerbT = TypeVar("VerbT", bound=Callable[..., object])


def _with_options(verb: VerbT) -> VerbT:
    """Give a function the signature that lists every option of its verb, with its default."""
    own = inspect.signature(verb)
    first = [one for one in own.parameters.values() if one.kind is not one.VAR_KEYWORD]
    listed = [
        inspect.Parameter(
            one.word,
            inspect.Parameter.KEYWORD_ONLY,
            default=one.default_of(verb.__name__),
            annotation=python_type(one, verb.__name__),
        )
        for one in options_for(verb.__name__, Door.PYTHON)
        if one.word not in own.parameters
    ]
    verb.__signature__ = own.replace(parameters=[*first, *listed])  # type: ignore[attr-defined]
    verb.words = tuple(one.name for one in listed)  # type: ignore[attr-defined]
    return verb


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


@_with_options
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
    from threadline.pipeline import prove as prove_job
    from threadline.pipeline import with_shaping

    asked = Words.of("prove", Door.PYTHON, words)
    trials, chosen, options = asked.trials(), asked.machine(machine), asked.options()
    spec = with_shaping(asked.spec(chosen), chosen, options)
    return Proved(prove_job(Path(job), chosen, spec, options, None, trials, asked.actual()))


@_with_options
@checked
def fastest(job: PathLike, machine: PathLike | Machine, **words: Word) -> Found:
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
    from threadline.search.by_pace import SEARCHES, Question

    question = Question.of(Words.of("fastest", Door.PYTHON, words), Path(job), machine)
    found = SEARCHES[question.job.paced_by].find(question)
    best = None if found.words is None else {**question.words, **found.words}
    return Found(found.best, found.unit, found.limited_by, found.of, best)


@_with_options
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
    from threadline.pipeline import open_job
    from threadline.search import compare as compare_job

    asked = Words.of("compare", Door.PYTHON, words)
    trials, named = asked.trials(), asked.machine(machine)
    planned = asked.each_options(interpolations, feeds, shapers)
    chosen = with_radii_of(named, planned[0])
    return compare_job(
        open_job(Path(job), chosen, planned[0]),
        chosen,
        asked.spec(chosen),
        planned,
        with_fastest=with_fastest,
        trials=trials,
    )


@_with_options
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
    from threadline.recorded import judge_files

    files = [recordings] if isinstance(recordings, str | Path) else list(recordings)
    if not files:
        raise OptionError("there is no recording to judge", remedy="Name one at least.")
    asked = Words.of("judge", Door.PYTHON, words)
    named = None if job is None else Path(job)
    return Answer(judge_files([Path(file) for file in files], asked, job=named, machine=machine))


@_with_options
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
        machine ``st``, ``plcopen`` or ``scl``; for an embroidery machine ``steps`` or ``t15``.
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
    from threadline.pipeline import open_job, plan_job, write

    asked = Words.of("compile", Door.PYTHON, words)
    chosen, options = asked.machine(machine), asked.options()
    check_target(target, chosen, options)
    plan = plan_job(open_job(Path(job), chosen, options), chosen, options)
    return write(plan, target, out, slower=slower)


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
    from threadline.shaping import parse_shaper

    return parse_shaper(text)
