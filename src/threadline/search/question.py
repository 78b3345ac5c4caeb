"""Read the options of ``fastest`` from their texts, and return a ``Question``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from threadline.base.option_defaults import USUAL
from threadline.errors import OptionError, UnitError
from threadline.jobs.gcode.feeds import as_f_words
from threadline.jobs.operations import FeedMode, Job
from threadline.jobs.seam.settings import LEAST_NEEDLE_HZ, MOST_NEEDLE_HZ
from threadline.machine import Machine
from threadline.motion.path.interpolations import OPTIMAL
from threadline.proof.kinds import kind_of
from threadline.proof.option_words import parse_feed, parse_margin, parse_robust
from threadline.proof.options import Options
from threadline.proof.pipeline import open_job, with_product, with_shaping
from threadline.proof.request import Words, with_radii_of
from threadline.search.choices import CHOSEN
from threadline.search.deadline import Deadline
from threadline.search.feed import searched_by
from threadline.search.learn import MOST_REPEATS, check_learnable
from threadline.search.paced import Question
from threadline.units import parse_number, parse_quantity

Span = tuple[float | None, float | None, FeedMode | None]
"""The lowest and highest feed of the search, and their feed mode."""


def metres_per_second(text: str) -> float:
    """Return a feed from ``--low`` or ``--high`` in m/s of the fastest axis.

    Raises
    ------
    OptionError
        If the feed has another unit than a speed.
    """
    feed = parse_feed(text)
    if feed.mode != "fastest-axis":
        raise OptionError(f"{text!r}: the search runs in mm/s", remedy='Write it like "36 mm/s".')
    return feed.value


def _feeds(job: Job, machine: Machine, low: str | None, high: str | None) -> Span:
    """Return the ends of a feed search, in the unit of its feed mode, and the mode."""
    ends = [None if text is None else parse_feed(text) for text in (low, high)]
    modes = {end.mode for end in ends if end is not None} or {searched_by(job, machine)}
    if modes == {FeedMode.F_WORD}:
        as_f_words(1.0, job.feed_rule)
    elif modes not in ({FeedMode.FASTEST_AXIS}, {FeedMode.OVERRIDE}):
        if len(modes) > 1:
            raise OptionError(
                f"--low {low!r} and --high {high!r} are feeds of different kinds",
                remedy='Write both like "36 mm/s", both like "F 3000", or both like "120 %".',
            )
        metres_per_second(str(high if low is None else low))
    values = [None if end is None else end.value for end in ends]
    return values[0], values[1], modes.pop()


def _capped(_job: Job, _machine: Machine, _low: str | None, high: str | None) -> Span:
    return None, None if high is None else metres_per_second(high), None


def _needles(_job: Job, _machine: Machine, low: str | None, high: str | None) -> Span:
    return _hz(low, needle_hz), _hz(high, needle_hz), None


def _hz(text: str | None, parse: Callable[[str], float]) -> float | None:
    return None if text is None else parse(text)


def needle_hz(text: str) -> float:
    """Return a needle speed in stitches a second.

    Raises
    ------
    OptionError
        If the text has another unit, or the speed is out of the range of needles.
    """
    try:
        speed_hz = parse_quantity(text, "stitch/s")
    except UnitError as error:
        raise OptionError(
            f"{text!r}: {error.message}",
            remedy='The search of a seam runs in stitches: "40 stitch/s".',
        ) from error
    if not LEAST_NEEDLE_HZ <= speed_hz <= MOST_NEEDLE_HZ:
        raise OptionError(
            f"{text!r} is no needle speed: it must be at least {LEAST_NEEDLE_HZ:g} and at most "
            f"{MOST_NEEDLE_HZ:g} stitch/s",
            remedy="Correct --low or --high.",
        )
    return speed_hz


def _shaft_speeds(_job: Job, _machine: Machine, low: str | None, high: str | None) -> Span:
    return _hz(low, _shaft_hz), _hz(high, _shaft_hz), None


def _shaft_hz(text: str) -> float:
    feed = parse_feed(text)
    if feed.mode is not FeedMode.SHAFT:
        raise OptionError(
            f"speed {text!r} is not in stitches",
            remedy='The search of a design runs in stitches: "120 stitch/min".',
        )
    return feed.value


@dataclass(frozen=True, slots=True, kw_only=True)
class PaceOptions:
    """The options of a search by one pace.

    Parameters
    ----------
    searched
        Name of the searched quantity with its verb, for a message.
    takes
        Options of this search that other searches do not take, as typed.
    span
        Reads ``--low`` and ``--high``.
    """

    searched: str
    takes: frozenset[str]
    span: Callable[[Job, Machine, str | None, str | None], Span]


_SPAN = frozenset({"--low", "--high", "--robust", "--shaper", "--mismatch", "--learned"})
PACE_OPTIONS: Mapping[str, PaceOptions] = {
    "feed": PaceOptions(searched="the feed is", takes=_SPAN, span=_feeds),
    OPTIMAL: PaceOptions(
        searched="no feed is", takes=frozenset({"--high", "--robust", "--shaper"}), span=_capped
    ),
    "needle": PaceOptions(searched="the speed of the needle is", takes=_SPAN, span=_needles),
    "shaft": PaceOptions(searched="the speed of the shaft is", takes=_SPAN, span=_shaft_speeds),
    "switchings": PaceOptions(
        searched="commands and waits are",
        takes=frozenset({"--out", "--mismatch"}),
        span=lambda *_: (None, None, None),
    ),
}
"""Options of each kind of search, by the result of ``searched_as``."""
_INSTEAD = {
    "--low": "; it bounds a search by feed or speed",
    "--high": "; it bounds a search by feed or speed",
    "--robust": "; --band finds commands for every mode within a share of its frequency",
    "--out": "; the command that proves the answer is printed",
    "--shaper": "; the search chooses a shaper for every move",
    "--mismatch": "; prove --tolerances judges its plan on other machines",
    "--learned": "; a feed or the speed of a needle is searched with it",
}
"""Alternatives to options that only some searches take, for messages."""
_NOT_EVERYWHERE = ("low", "high", "robust", "shaper", "mismatch", "learned")


def searched_as(job: Job, options: Options) -> str:
    """Return the kind of search: the job's pace, or ``OPTIMAL`` for a search without a feed."""
    without_feed = job.paced_by == "feed" and options.interpolation == OPTIMAL
    return OPTIMAL if without_feed else job.paced_by


def question_of(words: Words, file: Path, machine: str | Path | Machine) -> Question:
    """Return the ``Question`` from the options of ``fastest`` about a job.

    Raises
    ------
    InputError
        If the job, the machine or an option cannot be read, or an option does not apply to the job.
    """
    robust = words.text("robust")
    share = None if robust is None else parse_robust(robust)
    trials = words.trials(ends=robust if share and words.text("ends") is None else None)
    file_machine, margin = words.machine(machine), parse_margin(words.text("margin") or "0 %")
    planned_for = _planned_for(words, file_machine)
    options = words.options(file, robust=planned_for)
    machine_with_radii = with_radii_of(file_machine, options)
    options = options.on(machine_with_radii)
    job = open_job(file, machine_with_radii, options)
    given = {f"--{word}": words.values.get(word) or None for word in _NOT_EVERYWHERE}
    refuse_others(job, options, given)
    search = searched_as(job, options)
    learned = _learned(words, job, machine_with_radii, options)
    low, high, by = PACE_OPTIONS[search].span(
        job, machine_with_radii, words.text("low"), words.text("high")
    )
    spec = with_product(words.spec(machine_with_radii), machine_with_radii, options).with_margin(
        margin
    )
    actual, mismatch, band = words.actual(), words.flag("mismatch"), None
    if job.paced_by == "switchings":  # commands made for a band are judged over the whole band
        trials, band = replace(trials, band=None), trials.band
    if mismatch and actual is not None:
        raise OptionError("--mismatch and --actual exclude each other", remedy="Give one of them.")
    if band is not None and (mismatch or actual is not None):
        raise OptionError(
            "--band already chooses the simulated machines, all over its band",
            remedy="Leave --actual and --mismatch out.",
        )
    return Question(
        job=job,
        machine=machine_with_radii,
        spec=with_shaping(spec, machine_with_radii, options) if search == OPTIMAL else spec,
        options=options,
        actual=actual,
        trials=trials,
        low=low,
        high=high,
        by=by,
        until=_until(words.text("within")),
        margin=margin,
        band=band,
        mismatch=mismatch,
        words=words.changed(robust=planned_for),
        free=_free(words) if search == OPTIMAL else frozenset(),
        learned=learned,
    )


def _learned(words: Words, job: Job, machine: Machine, options: Options) -> int | None:
    """Return the number of learning repeats before a plan is judged; None to judge the plan itself.

    Raises
    ------
    OptionError
        If the job cannot be learned, or the options choose machines that do not learn.
    """
    repeats = words.values.get("learned")
    if repeats is None:
        return None
    if not isinstance(repeats, int) or not 1 <= repeats <= MOST_REPEATS:
        raise OptionError(
            f"--learned {str(repeats)[:20]} is not from 1 to {MOST_REPEATS}",
            remedy="Five repeats are often enough.",
        )
    for other in ("mismatch", "band", "tolerances", "yield_"):
        if words.values.get(other):
            raise OptionError(
                f"--learned and --{other.strip('_')} exclude each other: every machine learns its "
                "own table",
                remedy='Give --ends "100 %" for machines at the ends of the tolerances.',
            )
    check_learnable(job, machine, options.following)
    return repeats


def _free(words: Words) -> frozenset[str]:
    """Return the options of ``CHOSEN`` that the user did not give.

    If ``--contour`` is given without ``--feed-forward``, feed-forward counts as given, so that the
    motors follow the path.
    """
    free = {word for word in CHOSEN if words.values.get(word) in (None, False)}
    if words.text("contour") is not None:
        free -= {"feed_forward"}
    return frozenset(free)


def _planned_for(words: Words, machine: Machine) -> str | None:
    """Return the share of the tolerances for which plans are made robust; None if not wanted.

    If a kind of work has feed-forward, only plans with feed-forward are made robust. Plans without
    it are made for the file's machine, and judged on the other machines, too.
    """
    planning_options = kind_of(machine).planned_by
    if "robust" in planning_options and "feed-forward" not in planning_options:
        return words.text("robust")
    usual = words.text("interpolation") in USUAL and words.text("law") is None
    return words.text("robust") if words.flag("feed_forward") and usual else None


def refuse_others(job: Job, options: Options, given: Mapping[str, object]) -> None:
    """Refuse options that do not apply to the search for a job.

    Parameters
    ----------
    values
        By typed name: the given value, None where none was given.

    Raises
    ------
    OptionError
        If an option does not apply; the message names the option and the alternative.
    """
    search = PACE_OPTIONS[searched_as(job, options)]
    for name, value in given.items():
        if value is not None and name not in search.takes:
            typed = name if value is True else f"{name} {str(value)!r}"
            raise OptionError(
                f"{typed} does not apply to {job.name}: {search.searched} searched",
                remedy=f"Leave it out{_INSTEAD.get(name, '')}.",
            )


def _until(within: str | None) -> Deadline | None:
    if within is None:
        return None
    within_s = parse_number("--within", within, "s", "5 min")
    if not within_s > 0.0:
        raise OptionError(
            f"--within {within!r} must be greater than 0",
            remedy="Give how long the search may take, like '5 min', or leave it out.",
        )
    return Deadline.within(within_s)
