"""What an operator sets for the feed and the share of the limits that a search has found."""

from __future__ import annotations

import math
from collections.abc import Iterator

from threadline.cli.found import typed
from threadline.jobs.gcode.f_words import RULES, of_which
from threadline.jobs.operations import FeedMode, Job
from threadline.machine import Machine
from threadline.machine.motion_planner import GrblPlanner, KlipperPlanner
from threadline.search import FastestJob

_GRBL_FIRST = 120  # $120 to $122: the accelerations of X, Y and Z; A, B and C follow
_GRBL_AXES = "XYZABC"
_SEARCHED = 2  # shares of the limits that were tried, where they make a difference


def settings_words(job: Job, machine: Machine, result: FastestJob) -> Iterator[str]:
    """Yield lines with F and the accelerations of the axes, as the machine's controller has them.

    Firmwares count in mm and degrees. Nothing is said where no feed passes.
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
        yield f"to set: F {f_word}, the speed {of_which(rule)}, in mm/min{mode}"
    of_another = job.feed_rule.partition(":")[0] in RULES and job.feed_rule != rule
    if result.by is FeedMode.FASTEST_AXIS and of_another:
        other = f"{of_which(job.feed_rule)} (feed mode {job.feed_rule})"
        yield f"F of this job is another speed: {other}"
    if len(result.rungs) + len(result.left_out) < _SEARCHED:
        return
    shares = []
    for name, axis in machine.axes.items():
        turns = axis.kind == "rotary"
        value = axis.acceleration.si * best.share * (math.degrees(1.0) if turns else 1e3)
        unit = "deg/s^2" if turns else "mm/s^2"
        told = f"{name} {value:.4g} {unit}"
        if isinstance(machine.planner, GrblPlanner) and name in _GRBL_AXES:
            told = f"${_GRBL_FIRST + _GRBL_AXES.index(name)}={value:.3f} ({name}, {unit})"
        shares.append(told)
    where = ""
    if machine.planner is not None and not isinstance(machine.planner, GrblPlanner):
        where = " (max_accel)" if isinstance(machine.planner, KlipperPlanner) else " (M201)"
    yield f"accelerations{where}: {', '.join(shares)}"
