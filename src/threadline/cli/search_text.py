"""Texts about the result of a search: its limit, its resolution, the command that proves it."""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

from threadline.cli.output import print_table
from threadline.jobs.gcode.feeds import RULES, speed_of
from threadline.jobs.operations import FeedMode, Job
from threadline.machine import Machine
from threadline.machine.motion_planner import GrblPlanner, KlipperPlanner
from threadline.proof.option_form import Word
from threadline.search import FastestJob, Mismatch
from threadline.search.allowance import ALLOWED, LIMITS
from threadline.search.fastest import RANGE, Fastest
from threadline.search.feed_ranges import Forbidden
from threadline.search.mismatch import Certainty, Searched

END = "the end of the search (--high)"
VELOCITY_LIMITS = "the velocity limits of the axes"
"""Upper end of a search for a feed without --high: no axis can go faster."""
_ENDS = {LIMITS: "the limits of axes and drives", ALLOWED: "what --contour allows"}


def limit_words(limited_by: str, end: str = END) -> str:
    """Return the limit of a search in words: usually the name of a criterion.

    >>> limit_words("range"), limit_words("contour_error")
    ('the end of the search (--high)', 'contour_error')
    >>> limit_words("range", VELOCITY_LIMITS)
    'the velocity limits of the axes'

    Parameters
    ----------
    end
        Words for the upper end of the search.
    """
    if limited_by == RANGE:
        return end
    return _ENDS.get(limited_by, limited_by)


def resolution_words(found: Fastest) -> str:
    """Return the sentence on the steps of a search, and which intervals it can miss."""
    if not found.step:
        return "tried at both ends alone: the plan keeps the machine's limits at every feed between"
    edges = "the edges" if found.every else "the upper edge"
    slower_text = "; slower intervals are as the steps have them, down to the lowest feed listed"
    slower = "" if found.every else slower_text
    return (
        f"tried in steps of {100.0 * found.step:.2g} %, about {edges} of the fastest of "
        f"{100.0 * found.near_step:.2g} %: a narrower interval, or a gap in one, can be missed"
        f"{slower}"
    )


def isolated_words(found: Fastest, unit: str, per_unit: float = 1.0) -> str:
    """Return the sentence on isolated feeds, which pass while their neighbours fail; else "".

    Parameters
    ----------
    unit, per_unit
        Unit of the printed feeds, and the factor to it.
    """
    if found.fastest is None or not found.isolated:
        return ""
    feed_texts = ", ".join(typed(feed * per_unit) for feed in found.isolated)
    text = f"in spec alone, out of it within {found.edge:.1%} on both sides: {feed_texts} {unit}"
    return f"{text}; no range is in spec" if found.fastest.isolated else text


def typed(value: float) -> str:
    """Return a number with twelve digits, as it is typed into a command to get the same value.

    >>> typed(32.4437), typed(0.0395 * 1e3)
    ('32.4437', '39.5')
    """
    return f"{value:.12g}"


def forbidden_words(
    forbidden: Sequence[Forbidden], limited_by: str, feed_text: Callable[[float], str]
) -> Iterator[str]:
    """Yield a line on the criteria that fail, and one on feeds that pass in one run only.

    >>> from threadline.search.feed_ranges import Forbidden
    >>> slow = Forbidden(name="repeatability", low=1.0, high=5.0, feeds=9, repeated=9)
    >>> fast = Forbidden(name="contour_error", low=6.0, high=8.0, feeds=3, repeated=0)
    >>> first, second = forbidden_words([slow, fast], "repeatability", "F {:g}".format)
    >>> first
    'repeatability fails from F 1 to F 5, contour_error from F 6 to F 8'
    >>> second
    '9 of them pass in one run of the machine as its file says (--nominal) and fail over all runs'

    Parameters
    ----------
    limited_by
        Criterion that fails at the closest trial; named alone if no other criterion fails.
    feed_text
        Returns the text of a feed.
    """
    if len(forbidden) < 2:
        yield f"{limited_by} fails at every one"
    else:
        span_texts = (
            f"{one.name}{' fails' if one is forbidden[0] else ''} {_span_words(one, feed_text)}"
            for one in forbidden
        )
        yield ", ".join(span_texts)
    repeated = sum(one.repeated for one in forbidden)
    if repeated:
        yield (
            f"{repeated} of them pass in one run of the machine as its file says (--nominal) and "
            "fail over all runs"
        )


def _span_words(one: Forbidden, feed_text: Callable[[float], str]) -> str:
    low, high = feed_text(one.low), feed_text(one.high)
    return f"at {low}" if low == high else f"from {low} to {high}"


def certainty_words(sure: Certainty) -> str:
    """Return the sentence on the speed lost by passing at the ends of the tolerances."""
    texts = [
        "none" if best is None else f"{typed(best)} {sure.unit}" for best in (sure.sure, sure.alone)
    ]
    change = "" if sure.share is None else f": {abs(sure.share):.1%} slower"
    return (
        f"what certainty costs: {texts[0]} on all {sure.machines} machines, {texts[1]} planned "
        f"and judged for the machine as its file says{change}"
    )


def margin_words(margin: float) -> str:
    """Return the end of a title that names the margin; "" without a margin.

    >>> margin_words(0.2)
    ', 20 % of every limit kept free'
    """
    return f", {margin * 100.0:g} % of every limit kept free" if margin else ""


def until_words(ended: str) -> Iterator[str]:
    """Yield the line on why a search stopped early; nothing if it did not."""
    if ended:
        yield f"{ended}: this is the best result so far"


def command_line(verb: str, job: Path, options: Mapping[str, str | Path | None]) -> str:
    """Return a shell command; an option with the value "" is a flag, None leaves it out.

    >>> command_line("prove", Path("a b.prg"), {"-m": "lathe-winder", "--feed": "1 mm/s"})
    "threadline prove 'a b.prg' -m lathe-winder --feed '1 mm/s'"
    """
    words = ["threadline", verb, str(job)]
    for name, value in options.items():
        if value is not None:
            words += [name] if value == "" else [name, str(value)]
    return shlex.join(words)


def as_typed(words: Mapping[str, Word]) -> dict[str, str]:
    """Return planning options by their names on the command line; a flag has the value "".

    >>> as_typed({"feed": "1 mm/s"})
    {'--feed': '1 mm/s'}
    """
    return {
        f"--{word.replace('_', '-')}": "" if value is True else str(value)
        for word, value in words.items()
    }


def merged(rows: Sequence[Sequence[str]]) -> list[list[str]]:
    """Join neighbouring rows that differ only in their first cell.

    >>> merged([["100 %", "a"], ["50 %", "a"], ["25 %", "b"]])
    [['100 % to 50 %', 'a'], ['25 %', 'b']]
    """
    runs: list[tuple[str, str, list[str]]] = []  # first, last, common cells
    for head, *rest in rows:
        if runs and runs[-1][2] == rest:
            runs[-1] = (runs[-1][0], head, rest)
        else:
            runs.append((head, head, rest))
    return [[first if first == last else f"{first} to {last}", *rest] for first, last, rest in runs]


_GRBL_FIRST = 120  # $120 to $122: the accelerations of X, Y and Z; A, B and C follow
_GRBL_AXES = "XYZABC"
_SEARCHED = 2  # least number of tried shares of the limits that makes the best share a result


def settings_words(job: Job, machine: Machine, result: FastestJob) -> Iterator[str]:
    """Yield lines with F and the axes' accelerations in the units of the machine's controller.

    Firmwares use mm and degrees. Yields nothing if no feed passes.
    """
    best = result.best
    if best.found.best is None:
        return
    by_word = result.by is FeedMode.F_WORD
    rule = job.feed_rule if by_word else result.by.value
    mode = f" (feed mode {rule})" if by_word else ""
    if result.by is FeedMode.OVERRIDE:
        yield f"to set: feed override {typed(100.0 * best.found.best)} %; every F keeps its ratio"
    else:
        f_word = typed(60_000.0 * best.found.best)
        yield f"to set: F {f_word}, the speed {speed_of(rule)}, in mm/min{mode}"
    is_other_rule = job.feed_rule.partition(":")[0] in RULES and job.feed_rule != rule
    if result.by is FeedMode.FASTEST_AXIS and is_other_rule:
        other = f"{speed_of(job.feed_rule)} (feed mode {job.feed_rule})"
        yield f"F of this job is another speed: {other}"
    if len(result.candidates) + len(result.left_out) < _SEARCHED:
        return
    shares = []
    for name, axis in machine.axes.items():
        is_rotary = axis.kind == "rotary"
        value = axis.acceleration.si * best.share * (math.degrees(1.0) if is_rotary else 1e3)
        unit = "deg/s^2" if is_rotary else "mm/s^2"
        setting = f"{name} {value:.4g} {unit}"
        if isinstance(machine.planner, GrblPlanner) and name in _GRBL_AXES:
            setting = f"${_GRBL_FIRST + _GRBL_AXES.index(name)}={value:.3f} ({name}, {unit})"
        shares.append(setting)
    command_text = ""
    if machine.planner is not None and not isinstance(machine.planner, GrblPlanner):
        command_text = " (max_accel)" if isinstance(machine.planner, KlipperPlanner) else " (M201)"
    yield f"accelerations{command_text}: {', '.join(shares)}"


def show_mismatch(cells: Sequence[Mismatch], title: str, searched: Searched) -> None:
    """Print the fastest result for masses and stiffnesses at the ends of their tolerances."""
    names = {-1.0: "lower end", 0.0: "as in the file", 1.0: "upper end"}
    has_ranges = any(cell.intervals for cell in cells)
    rows = [
        [
            names[cell.mass],
            names[cell.stiffness],
            "none" if cell.best is None else f"{searched.per_unit * cell.best:.2f}",
            *([_in_spec(cell, searched)] if has_ranges else []),
            limit_words(cell.limited_by),
        ]
        for cell in cells
    ]
    best = f"{searched.best} {searched.unit}"
    range_header = [f"in spec {searched.unit}"] if has_ranges else []
    header = ["mass of loads", "stiffness of springs", best, *range_header, "limited by"]
    print_table(
        f"{title}: planned for the file, {searched.done} off its tolerances, one run each",
        header,
        rows,
    )


def _in_spec(cell: Mismatch, searched: Searched) -> str:
    """Return all intervals in spec: there may be gaps below the fastest."""
    scale = searched.per_unit
    return ", ".join(
        f"{scale * one.low:.2f}"
        if one.low == one.high
        else f"{scale * one.low:.2f} to {scale * one.high:.2f}"
        for one in sorted(cell.intervals, key=lambda one: one.low)
    )
