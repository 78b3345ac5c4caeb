"""How the fastest way to do a job is searched, by what paces the job.

The command line and ``import threadline as tl`` both ask a ``Question``; each tells the answer in
its own way.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from threadline.base.option_defaults import NO_CONTOUR, UNSHAPED_WORD, USUAL
from threadline.errors import OptionError
from threadline.jobs.operations import Feed, FeedMode, Job, Pace
from threadline.machine import Machine
from threadline.proof.asked import Words, with_radii_of
from threadline.proof.option_form import Word
from threadline.proof.option_words import (
    feed_words,
    parse_margin,
    parse_robust,
    share_words,
    tolerance_words,
)
from threadline.proof.options import Options
from threadline.proof.pipeline import Trials, open_job
from threadline.search.allowance import FastestJob
from threadline.search.cycle import FastestCycle, cycle_s, fastest_cycle
from threadline.search.feed import fastest_needle
from threadline.search.least_limits import fastest_job
from threadline.search.shaft import FastestShaft, fastest_shaft
from threadline.verdict import Spec


@dataclass(frozen=True, slots=True, kw_only=True)
class Question:
    """What is asked of a search for the fastest.

    Parameters
    ----------
    file, job
        The job and its file; a seam is read again for every needle speed.
    machine, spec, options
        The machine that it is planned for, what is asked, and how to plan.
    margin
        Share of every limit of ``spec`` that is kept free already.
    actual
        The machine that runs it, where it is another one.
    trials
        Which runs every verdict is made of.
    words
        The options that plan the same, by word, without those that the search finds.
    """

    file: Path
    job: Job
    machine: Machine
    spec: Spec
    options: Options
    margin: float
    actual: Machine | None
    trials: Trials
    words: Mapping[str, Word]

    @classmethod
    def of(cls, words: Words, file: Path, machine: str | Path | Machine) -> Question:
        """Return the question that the words of ``fastest`` ask of a job.

        Raises
        ------
        InputError
            If the job, the machine or an option cannot be read, or an option has no meaning for
            the job.
        """
        robust = words.text("robust")
        share = None if robust is None else parse_robust(robust)
        trials = words.trials(ends=robust if share else None)
        planned = _planned_for(words)
        named, margin = words.machine(machine), parse_margin(words.text("margin") or "0 %")
        options = words.options(robust=planned)
        chosen = with_radii_of(named, options)
        options = options.on(chosen)
        job = open_job(file, chosen, options)
        given = {f"--{word}": words.text(word) for word in _NOT_EVERYWHERE}
        refuse_for_pace(job, given)
        return cls(
            file=file,
            job=job,
            machine=chosen,
            spec=words.spec(chosen).with_margin(margin),
            options=options,
            margin=margin,
            actual=words.actual(),
            trials=trials,
            words=words.changed(robust=planned),
        )


def _planned_for(words: Words) -> str | None:
    """Return the share of tolerances that plans are made for; None for the machine of the file.

    A plan without averages to choose is made for the machine of the file, and judged on the others.
    """
    plain = words.text("interpolation") in USUAL and words.text("law") is None
    return words.text("robust") if words.flag("feed_forward") and plain else None


class Answer(NamedTuple):
    """What a search found.

    Parameters
    ----------
    best, unit
        The best, or None, and its unit.
    limited_by
        The criterion that forbids more.
    of
        The result of the search with every try.
    words
        The planning options that the search found; None where nothing is in spec, or where only a
        move list can say it.
    """

    best: float | None
    unit: str
    limited_by: str
    of: Any
    words: Mapping[str, str] | None


def job_words(found: FastestJob) -> dict[str, str] | None:
    """Return the options that plan the best of a search by feed, or by allowance."""
    best = found.best
    if best.found.best is None:
        return None
    words = {"feed": feed_words(Feed(found.by, best.found.best))}
    if best.share != 1.0:
        words["limits"] = share_words(best.share)
    if best.contour_m is not None:
        endless = best.contour_m == float("inf")
        words["contour"] = NO_CONTOUR if endless else f"{best.contour_m!r} m"
    return words


def needle_words(best_hz: float | None) -> dict[str, str] | None:
    """Return the option that plans a seam at the best needle speed."""
    return None if best_hz is None else {"needle": f"{best_hz!r} stitch/s"}


def shaft_words(found: FastestShaft) -> dict[str, str] | None:
    """Return the option that plans the best of a design: a swing, or a constant speed."""
    if found.duration_s is None:
        return None
    if found.schedule is not None and found.schedule.plan.duration_s == found.duration_s:
        return {"tolerance": tolerance_words(found.tolerance_m)}
    assert found.constant.best is not None
    return {"feed": feed_words(Feed(FeedMode.SHAFT, found.constant.best))}


def cycle_words(found: FastestCycle) -> dict[str, str] | None:
    """Return the option that plans the shortest cycle; None where only a move list can say it."""
    if found.job is None:
        return None
    overlaps = cycle_s(found.base) < cycle_s(found.unshaped)
    by_axis: dict[str, set[str]] = {}
    for move in found.moves:
        by_axis.setdefault(move.axis, set()).add(move.how)
    one_each = all(len(how) == 1 for how in by_axis.values())
    if overlaps or not one_each or any(move.wait_s or " for " in move.how for move in found.moves):
        return None
    if all(how == {UNSHAPED_WORD} for how in by_axis.values()):
        return {}
    return {"shaper": ", ".join(f"{axis}={next(iter(how))}" for axis, how in by_axis.items())}


def _feed(asked: Question) -> Answer:
    result = fastest_job(
        asked.job, asked.machine, asked.spec, asked.options,
        actual=asked.actual, trials=asked.trials,
    )  # fmt: skip
    found = result.best.found
    unit = "" if result.by is FeedMode.OVERRIDE else "m/s"
    return Answer(found.best, unit, found.limited_by, result, job_words(result))


def _needle(asked: Question) -> Answer:
    seam = fastest_needle(
        asked.file, asked.machine, asked.spec, asked.options,
        actual=asked.actual, trials=asked.trials,
    )  # fmt: skip
    return Answer(seam.best, "stitch/s", seam.limited_by, seam, needle_words(seam.best))


def _shaft(asked: Question) -> Answer:
    sewn = fastest_shaft(
        asked.job, asked.machine, asked.spec, asked.options,
        actual=asked.actual, trials=asked.trials,
    )  # fmt: skip
    return Answer(sewn.duration_s, "s", sewn.limited_by, sewn, shaft_words(sewn))


def _switchings(asked: Question) -> Answer:
    cycle = fastest_cycle(
        asked.job, asked.machine, asked.spec, actual=asked.actual, trials=asked.trials
    )
    return Answer(cycle.cycle_s, "s", cycle.limited_by, cycle, cycle_words(cycle))


@dataclass(frozen=True, slots=True, kw_only=True)
class Search:
    """The search for the fastest way to do jobs of one pace.

    Parameters
    ----------
    find
        Answers a question.
    searched
        What is searched, with its verb, for a message.
    takes
        The options that it takes of those that not every search has, as typed.
    """

    find: Callable[[Question], Answer]
    searched: str
    takes: frozenset[str]


_SPAN = frozenset({"--low", "--high", "--robust", "--shaper"})
SEARCHES: Mapping[Pace, Search] = {
    "feed": Search(find=_feed, searched="the feed is", takes=_SPAN),
    "needle": Search(find=_needle, searched="the speed of the needle is", takes=_SPAN),
    "shaft": Search(find=_shaft, searched="the speed of the shaft is", takes=_SPAN),
    "switchings": Search(
        find=_switchings, searched="commands and waits are", takes=frozenset({"--band", "--out"})
    ),
}
"""By pace: the search for the fastest way to do a job in spec."""
_NOT_EVERYWHERE = ("low", "high", "band", "robust", "shaper")
_INSTEAD = {
    "--robust": "; --band finds commands for every mode within a share of its frequency",
    "--band": "; prove --tolerances judges other machines",
    "--out": "; the command that proves the answer is printed",
    "--shaper": "; the search chooses a shaper for every move",
}
"""What there is instead of an option that not every search has."""


def refuse_for_pace(job: Job, given: Mapping[str, object]) -> None:
    """Refuse options that the search for a job of this pace does not have.

    Parameters
    ----------
    given
        By their names as typed: what was given, None where nothing was.

    Raises
    ------
    OptionError
        Naming the option, and what there is instead.
    """
    search = SEARCHES[job.paced_by]
    for name, value in given.items():
        if value is not None and name not in search.takes:
            raise OptionError(
                f"{name} {str(value)!r} does not apply to {job.name}, of which "
                f"{search.searched} searched",
                remedy=f"Leave it out{_INSTEAD.get(name, '')}.",
            )
