"""The face of the package: each question of the command line as a function, for every machine.

``import threadline as tl`` has all of it: ``tl.prove("x.prg", "lathe-winder").passed``. Options are
the words of the command line, with the same defaults; ``docs/api.md`` lists them.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from threadline.answers import Answer as Answer  # noqa: PLC0414 - callers name the type of an answer
from threadline.answers import Found as Found  # noqa: PLC0414
from threadline.answers import PathLike as PathLike  # noqa: PLC0414
from threadline.answers import Proved as Proved  # noqa: PLC0414
from threadline.arguments import check_argument, checked
from threadline.errors import OptionError
from threadline.machine import Machine
from threadline.machine import load_machine as load_machine_file
from threadline.machine.par import read_parameters
from threadline.option_defaults import (
    AUTO,
    DEFAULT_INTERPOLATION,
    DEFAULT_LIMITS,
    DEFAULT_TOLERANCE,
    MOST_REPEATS,
)
from threadline.option_words import parse_ends, parse_feed, parse_margin
from threadline.options import Options, options_of, robust_plan
from threadline.trajectory import retime
from threadline.verdict import Spec, load_spec

if TYPE_CHECKING:
    from threadline.pipeline import Trials
    from threadline.search import Comparison
    from threadline.shaping import Shaper
    from threadline.signals.files import Written

__all__ = ["compare", "compile", "fastest", "judge", "load_machine", "prove", "retime", "shaper"]


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
    found = machine if isinstance(machine, Machine) else load_machine_file(machine)
    return found if par is None else read_parameters(par, found)


@checked
def prove(
    job: PathLike,
    machine: PathLike | Machine,
    *,
    spec: PathLike | Spec | None = None,
    par: PathLike | None = None,
    actual: PathLike | Machine | None = None,
    level: str = "repeated",
    repeats: int | None = None,
    ends: str | None = None,
    **words: Any,
) -> Proved:
    """Plan a job, simulate it on the machine, and judge it.

    Parameters
    ----------
    job
        Part program, seam, move list or embroidery design.
    machine, par
        As ``load_machine`` takes them.
    spec
        A file or a specification; None is the machine's own.
    actual
        The machine that runs the plan, where it isn't the one that it was made for.
    level
        How far the verdict reaches: ``"nominal"`` is one run; ``"repeated"`` is 20 runs with other
        encoder phases, friction and supply; ``"over tolerances"`` adds other machines within the
        tolerances of the machine file.
    repeats
        Number of runs of the machine itself; None takes that of the level.
    ends
        Share of the tolerances of loads and springs, ``"100 %"``: the machines at their ends are
        judged as well, in one run each; None judges none of them.
    **words
        ``interpolation``, ``feed``, ``dialect``, ``feed_mode``, ``radius``, ``tolerance``,
        ``limits``, ``shaper``, ``feed_forward``, ``smoothing``, ``robust``, ``law``,
        ``contour``: as on the command line.

    Raises
    ------
    InputError
        If anything that was given is wrong; the message is the one that the command line prints.
    """
    from threadline.pipeline import prove as prove_job
    from threadline.pipeline import with_shaping

    trials = _trials(level, repeats, ends)
    chosen, options = load_machine(machine, par), _options(words)
    asked = with_shaping(_spec(spec, chosen), chosen, options)
    other = None if actual is None else load_machine(actual, par)
    return Proved(prove_job(Path(job), chosen, asked, options, None, trials, other))


@checked
def fastest(
    job: PathLike,
    machine: PathLike | Machine,
    *,
    spec: PathLike | Spec | None = None,
    par: PathLike | None = None,
    actual: PathLike | Machine | None = None,
    margin: str = "0 %",
    level: str = "repeated",
    robust: str | None = None,
    **words: Any,
) -> Found:
    """Find the fastest way to do a job in spec.

    Of a part program the feed is searched, of a seam the needle speed, of a move list the commands
    and waits, of an embroidery design the speed of the shaft.

    Parameters
    ----------
    job, machine, par, spec, actual
        As ``prove`` takes them.
    margin
        Share of every limit to keep free.
    level
        Level at which every try is proved, as ``prove`` takes it.
    robust
        Share of the tolerances of loads and springs, ``"100 %"``: one plan has to hold on every
        machine at their ends, each judged in one run. With ``feed_forward`` alone it is planned
        for all of them.
    **words
        ``interpolation``, ``tolerance``, ``feed_forward``, ``smoothing``: as on the command line.

    Raises
    ------
    InputError
        As on the command line.
    """
    from threadline.jobs import read_job
    from threadline.kinds import kind_of
    from threadline.search.by_pace import SEARCHES, Question

    trials = _trials(level, None, robust)
    _check_words(words, tuple(_WORDS))
    way = words.get("interpolation", DEFAULT_INTERPOLATION), words.get("feed_forward", False)
    planned = {"robust": robust_plan(robust, *way)} if robust is not None else {}
    chosen, options = load_machine(machine, par), _options({**words, **planned})
    options = options.on(chosen)
    asked = _spec(spec, chosen).with_margin(parse_margin(margin))
    other = None if actual is None else load_machine(actual, par)
    kind_of(chosen).check_options(chosen, options)
    read = read_job(job, chosen)
    question = Question(
        file=Path(job), job=read, machine=chosen, spec=asked, options=options, actual=other,
        trials=trials,
    )  # fmt: skip
    return Found(*SEARCHES[read.paced_by](question))


@checked
def compare(
    job: PathLike,
    machine: PathLike | Machine,
    interpolations: Sequence[str] = (DEFAULT_INTERPOLATION,),
    feeds: Sequence[str] = (),
    *,
    shapers: Sequence[str] = (),
    spec: PathLike | Spec | None = None,
    par: PathLike | None = None,
    with_fastest: bool = False,
    level: str = "repeated",
    **words: Any,
) -> Comparison:
    """Prove a job with several interpolations, feeds and shapers.

    Parameters
    ----------
    job, machine, par, spec
        As ``prove`` takes them.
    interpolations, feeds
        Each interpolation is proved at each feed; without feeds, at the job's own.
    shapers
        Each pair of them is proved with each of these shapers; ``"none"`` shapes nothing.
    with_fastest
        Also search the fastest feed of each interpolation.
    level
        Level at which each is proved, as ``prove`` takes it.
    **words
        ``tolerance``: as on the command line.

    Raises
    ------
    InputError
        As on the command line.
    """
    from threadline.jobs import read_job
    from threadline.search import compare as compare_job

    trials = _trials(level, None)
    chosen = load_machine(machine, par)
    if not interpolations:
        raise OptionError("there is no interpolation to compare", remedy="Name one at least.")
    return compare_job(
        read_job(job, chosen),
        chosen,
        _spec(spec, chosen),
        interpolations,
        [parse_feed(feed) for feed in feeds] or [None],
        _options({"interpolation": interpolations[0], **words}),
        shapers=[None if text == "none" else text for text in shapers] or [None],
        with_fastest=with_fastest,
        trials=trials,
    )


@checked
def judge(
    recordings: PathLike | Sequence[PathLike],
    *,
    job: PathLike | None = None,
    machine: str | None = None,
    spec: PathLike | None = None,
    par: PathLike | None = None,
    actual: str | None = None,
    feed_forward: bool = False,
    smoothing: str | None = None,
    **words: str,
) -> Answer:
    """Judge what a machine did, from one recording or several of the same job.

    Parameters
    ----------
    recordings
        Files of any kind in ``docs/files.md``.
    job, machine, par, actual
        Files and names. What is left out is read from the recording.
    spec
        The file of the specification; None is the machine's own.
    feed_forward, smoothing, **words
        How the plan was made, as on the command line. What is left out is read from the
        recording.

    Raises
    ------
    InputError
        As on the command line.
    """
    from threadline.recorded import judge_files

    files = [recordings] if isinstance(recordings, str | Path) else list(recordings)
    if not files:
        raise OptionError("there is no recording to judge", remedy="Name one at least.")
    _check_words(words, _OF_A_PLAN)
    given = {
        **{name.replace("_", "-"): text for name, text in words.items()},
        "job": None if job is None else str(job),
        "machine": machine,
        "par": None if par is None else str(par),
        "actual": actual,
    }
    return Answer(
        judge_files(
            [Path(file) for file in files],
            given,
            None if spec is None else Path(spec),
            feed_forward=feed_forward,
            smoothing=smoothing,
        )
    )


@checked
def compile(
    job: PathLike,
    machine: PathLike | Machine,
    target: str,
    out: PathLike,
    *,
    par: PathLike | None = None,
    slower: bool = False,
    **words: Any,
) -> list[Written]:
    """Plan a job and write it for a controller; return the files with their hashes.

    Parameters
    ----------
    job, machine, par
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
        As ``prove`` takes them; ``interpolation`` is ``"auto"`` unless given, on every machine.

    Raises
    ------
    InputError
        As on the command line; nothing is written then.
    """
    from threadline.pipeline import open_job, plan_job, target_of, write

    chosen, options = load_machine(machine, par), _options({"interpolation": AUTO, **words})
    target_of(target, chosen)
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


_OF_A_PLAN = (
    "interpolation", "feed", "dialect", "feed_mode", "radius", "tolerance", "limits", "shaper",
)  # fmt: skip


def _trials(level: str, repeats: int | None, ends: str | None = None) -> Trials:
    """Return the trials of a level, with ``repeats`` runs of the machine itself if given.

    ``ends`` is the share of the tolerances at whose ends machines are judged as well.
    """
    from dataclasses import replace

    from threadline.foreign_messages import nearest
    from threadline.pipeline import NOMINAL, REPEATED, TOLERANCES, Trials

    levels = {"nominal": NOMINAL, "repeated": REPEATED, "over tolerances": TOLERANCES}
    if level not in levels:
        raise OptionError(f"unknown level {level!r}", remedy=nearest(level, tuple(levels)))
    found = levels[level]
    if repeats is not None:
        if repeats < 1:
            raise OptionError(f"repeats must be at least 1, got {repeats}")
        if repeats > MOST_REPEATS:
            raise OptionError(f"repeats must be at most {MOST_REPEATS}, got {_short(repeats)}")
        found = Trials(repeats=repeats, machines=found.machines)
    return found if ends is None else replace(found, ends=parse_ends(ends))


def _short(number: int) -> str:
    return str(number) if abs(number) < 10**12 else "a number of many digits"


_WORDS = {
    "interpolation": DEFAULT_INTERPOLATION,
    "feed": None,
    "tolerance": DEFAULT_TOLERANCE,
    "limits": DEFAULT_LIMITS,
    "shaper": None,
    "feed_forward": False,
    "smoothing": None,
    "dialect": None,
    "feed_mode": None,
    "radius": None,
    "law": None,
    "contour": None,
    "robust": None,
}


def _options(words: dict[str, Any]) -> Options:
    _check_words(words, tuple(_WORDS))
    return options_of(**{**_WORDS, **words})


def _check_words(words: dict[str, Any], known: tuple[str, ...]) -> None:
    from threadline.foreign_messages import nearest

    for name, value in words.items():
        if name not in known:
            raise OptionError(f"unknown option {name!r}", remedy=nearest(name, known))
        default = _WORDS[name]
        text: Any = str | None if default is None or known is _OF_A_PLAN else str
        check_argument(name, value, bool if default is False else text)


def _spec(spec: PathLike | Spec | None, machine: Machine) -> Spec:
    return spec if isinstance(spec, Spec) else load_spec(spec, machine)
