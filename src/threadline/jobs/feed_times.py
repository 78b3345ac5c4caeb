"""Times of moves and of whole jobs at their programmed feeds."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from threadline.base.arrays import FloatArray, largest_of_axes
from threadline.errors import Place, PlanError
from threadline.jobs.gcode.feeds import as_f_words
from threadline.jobs.operations import Dwell, Feed, FeedMode, Job, Move, MoveRun, Pace, gathered
from threadline.machine import Machine

_MM_AS_DEGREE_M = 1e-3 * 180.0 / math.pi  # m per rad: a degree counts as a millimetre
_LETTER_GROUPS = ("XYZ", "UVW", "ABC")


def dwells_s(job: Job) -> float:
    """Return the total time that a job dwells (G4), s."""
    return sum(item.duration_s for item in job.runs() if isinstance(item, Dwell))


def check_feed(feed: Feed, axes: tuple[str, ...], place: Place | None) -> None:
    """Refuse a feed that is not above 0, or has base axes that the job lacks.

    Raises
    ------
    PlanError
        If the value is not a finite number greater than 0, or a base axis is unknown.
    """
    if feed.mode is FeedMode.RAPID:
        return
    if not (math.isfinite(feed.value) and feed.value > 0):
        raise PlanError(
            f"feed is {feed.value:g} ({feed.mode.value}); it must be greater than 0",
            place=place,
            remedy="Program a feed (F) before the first move.",
        )
    unknown = set(feed.base_axes) - set(axes)
    if feed.mode is FeedMode.BASE_AXES and (unknown or not feed.base_axes):
        raise PlanError(
            f"feed of base axes {feed.base_axes} on a job with axes {axes}",
            place=place,
            remedy="Name axes of the job as the base.",
        )


def feed_time_s(
    displacement: FloatArray, feed: Feed, axes: tuple[str, ...], machine: Machine
) -> FloatArray:
    """Return the (n,) time of moves by (n, axes) ``displacement`` (m or rad) at ``feed``.

    A move of length zero takes no time, and a rapid move has no nominal time; both give 0.

    Notes
    -----
    * fastest axis: largest displacement / feed, with rotary axes at the tool's radius;
    * count per tick: largest displacement in counts / feed, in ticks;
    * path: Euclidean length of the linear axes / feed; for a move of rotary axes alone, the length
      at the tool / feed;
    * base axes (CADFIL): Euclidean length of the base axes at the tool / feed; if the base axes
      rest, the length of all axes / feed;
    * all axes: Euclidean length of all axes / feed, with a degree as a millimetre;
    * in turn: Euclidean length of X Y Z / feed; if X Y Z rest, the length of U V W; if U V W rest,
      too, the length of A B C with a degree as a millimetre;
    * inverse time: 1 / feed.
    """
    column = [machine.axis_names.index(axis) for axis in axes]
    radius = machine.radius_m[column]
    displacement_size = np.abs(displacement)
    tool_displacement = displacement_size * radius
    if feed.mode is FeedMode.RAPID:
        return np.zeros(len(displacement_size))
    if feed.mode is FeedMode.INVERSE_TIME:
        return np.where(displacement_size.max(axis=1) > 0, 1.0 / feed.value, 0.0)
    if feed.mode is FeedMode.COUNT_PER_TICK:
        counts = largest_of_axes(displacement_size * machine.counts_per_unit[column])
        return np.asarray(counts * float(machine.tick_clock.period_s) / feed.value)
    if feed.mode is FeedMode.FASTEST_AXIS:
        return np.asarray(largest_of_axes(tool_displacement) / feed.value)
    if feed.mode in (FeedMode.ALL_AXES, FeedMode.IN_TURN):
        linear = np.array([machine.axes[axis].kind == "linear" for axis in axes])
        written_size = displacement_size * np.where(linear, 1.0, _MM_AS_DEGREE_M)
        if feed.mode is FeedMode.ALL_AXES:
            return np.asarray(_lengths(written_size) / feed.value)
        distance = np.zeros(len(displacement_size))
        for letters in _LETTER_GROUPS:
            group = _lengths(written_size[:, [axis in letters for axis in axes]])
            distance = np.where(distance > 0, distance, group)
        return np.asarray(distance / feed.value)
    if feed.mode is FeedMode.PATH:
        is_base = np.array([machine.axes[axis].kind == "linear" for axis in axes])
    else:
        is_base = np.array([axis in feed.base_axes for axis in axes])
    length, whole_length = _lengths(tool_displacement[:, is_base]), _lengths(tool_displacement)
    return np.asarray(np.where(length > 0, length, whole_length) / feed.value)


def _lengths(displacement: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt((displacement**2).sum(axis=1)))


def feed_of_move(
    programmed: Feed | None,
    option_feed: Feed | None,
    place: Place | None,
    job: Job,
    machine: Machine,
) -> Feed:
    """Return the feed that applies to a move.

    A rapid move stays rapid. For any other move ``option_feed`` applies, else ``programmed``, else
    the operator's normal feed. An override multiplies the feed that applies without the override,
    so that the feeds keep their ratios.

    Raises
    ------
    PlanError
        If no feed applies, or the feed is not above 0.
    OptionError
        If ``option_feed`` is a value of F words, and no F word of the job is a speed.
    """
    if programmed is not None and programmed.mode is FeedMode.RAPID:
        return programmed
    if option_feed is not None and option_feed.mode is FeedMode.OVERRIDE:
        own_feed = feed_of_move(programmed, None, place, job, machine)
        most = None if own_feed.most is None else own_feed.most * option_feed.value
        return replace(own_feed, value=own_feed.value * option_feed.value, most=most)
    if option_feed is not None:
        if option_feed.mode is FeedMode.F_WORD:
            return as_f_words(option_feed.value, job.feed_rule)
        return option_feed
    if programmed is None:
        if machine.operator is None:
            raise PlanError(
                "a move has no feed", place=place, remedy="Program a feed (F), or give one."
            )
        return Feed(FeedMode.COUNT_PER_TICK, machine.operator.normal_feed.si)
    check_feed(programmed, job.axes, place)
    return programmed


def nominal_time_s(
    displacement: FloatArray, feed: Feed, option_feed: Feed | None, job: Job, machine: Machine
) -> tuple[FloatArray, int]:
    """Return the (n,) times in s at ``feed``, and the number of slowed moves.

    Without ``option_feed``, moves are slowed to the operator's normal feed; an override
    multiplies the normal feed, too.
    """
    nominal = feed_time_s(displacement, feed, job.axes, machine)
    operator = machine.operator
    override = option_feed is None or option_feed.mode is FeedMode.OVERRIDE
    if not override or operator is None or feed.mode is FeedMode.RAPID:
        return nominal, 0
    share = 1.0 if option_feed is None else option_feed.value
    normal = Feed(FeedMode.COUNT_PER_TICK, share * operator.normal_feed.si)
    slowest = feed_time_s(displacement, normal, job.axes, machine)
    return np.maximum(nominal, slowest), int((slowest > nominal * (1 + 1e-9)).sum())


def programmed_time_s(job: Job, machine: Machine, feed: Feed | None = None) -> float:
    """Return the nominal time of a job, in s.

    Every move takes the time of its feed, as if the machine had no inertia; every rapid move takes
    its time at the velocity limits of the axes. Dwells take their own time, and stops take no time.
    The operator's normal feed is ignored. A CAM program that knows only feeds reports this time.

    Parameters
    ----------
    feed
        Feed in place of the programmed feeds; None: the programmed feeds.

    Raises
    ------
    JobError
        If a block lacks a feed or a mode of motion.
    PlanError
        If a feed is missing or is not above 0.
    """
    column = [machine.axis_names.index(axis) for axis in job.axes]
    velocity = machine.velocity_limit[column]
    position = np.array(job.start)
    total = 0.0
    for operation, times, _ in job.folded():
        if isinstance(operation, Dwell):
            total += times * operation.duration_s
            continue
        run = gathered([operation]) if isinstance(operation, Move) else operation
        if not isinstance(run, MoveRun):
            continue
        displacements = np.diff(run.targets, axis=0, prepend=position[None])
        position = run.targets[-1]
        ends = [begin for begin, _ in run.feeds[1:]] + [len(displacements)]
        for (begin, programmed), end in zip(run.feeds, ends, strict=True):
            place = Place(run.file, int(run.line[begin]))
            move_feed = feed_of_move(programmed, feed, place, job, machine)
            if move_feed.mode is FeedMode.RAPID:
                moves_s = (np.abs(displacements[begin:end]) / velocity).max(axis=1)
            else:
                moves_s = feed_time_s(displacements[begin:end], move_feed, job.axes, machine)
            total += times * float(moves_s.sum())
    return total


SLOWER: Mapping[Pace, str] = {
    "feed": "Lower the feed",
    "needle": "Lower the speed of the needle",
    "shaft": "Lower the speed of the shaft",
    "switchings": "Shape its moves (--shaper), or let it rest longer",
}
"""Beginning of the remedy that slows a job down, by ``Job.paced_by``."""
