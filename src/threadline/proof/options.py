"""How a job is to be planned, and how that is written on a command line and in a recording."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from threadline.base.option_defaults import (
    AUTO,
    DEFAULT_CONTOUR_M,
    DEFAULT_INTERPOLATION,
    DEFAULT_TOLERANCE_M,
    FEED_FORWARD,
    OPTIMAL_FEED_FORWARD,
    UNSHAPED_WORD,
    USUAL,
)
from threadline.base.wording import nearest
from threadline.commands.plan import Following
from threadline.errors import OptionError
from threadline.jobs.operations import Feed, FeedMode, Job
from threadline.machine import Machine
from threadline.motion.path.interpolations import BY_LAW, CHORDS, FIRMWARE, OPTIMAL
from threadline.motion.timing import Pace
from threadline.proof.option_form import Group, Word
from threadline.proof.option_table import RECORDED, TABLE, option, planned_by
from threadline.proof.option_words import parse_feed, parse_width_s

_OF_SWITCHES = planned_by("switches")
OF_AXES = tuple(known.key for one, known in RECORDED if one.name not in _OF_SWITCHES)
"""Keys of ``describe`` that have a meaning only for machines with axes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PathChoice:
    """The first choice: the shape of the path.

    Parameters
    ----------
    interpolation
        Name of the interpolation, or ``CHORDS``.
    tolerance_m
        Largest deviation of the planned from the programmed path, at the tool.
    """

    interpolation: str
    tolerance_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class TimingChoice:
    """The second choice: when the motion is where on its path.

    Parameters
    ----------
    pace
        As fast as the limits and the feed allow, as programmed, or by a law.
    law
        Name of the motion law of each move; None where the pace is another.
    feed
        Replaces every programmed feed; None keeps the job's.
    limit_share
        Share of the machine's acceleration and jerk limits that may be used, in (0, 1].
    smoothing_s
        Width of the averages over time by which the motion is smoothed; None smoothes no more than
        the limits of jerk ask for.
    shaper
        Text of the shaper that it is convolved with; None shapes nothing.
    contour_m
        How far the loads may leave the path while their loops follow; infinite where the timing
        does not ask.
    ends_m
        How far the loads of ``optimal`` with feed-forward may leave their motion where its table
        begins and ends; None keeps the rests of their inverses.
    robust_share, change_s
        As ``Options`` has them.
    """

    pace: Pace
    law: str | None
    feed: Feed | None
    limit_share: float
    smoothing_s: float | None
    shaper: str | None
    contour_m: float
    ends_m: float | None = None
    robust_share: float | None = None
    change_s: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Options:
    """How a job is to be planned, as it is typed.

    ``path``, ``timing`` and ``following`` are the three choices that these words stand for: the
    words on a command line came first, and one of them may mean two choices at once.

    Parameters
    ----------
    interpolation
        Name of the interpolation; ``DEFAULT_INTERPOLATION`` until a machine is known: ``on``.
    feed
        Replaces every programmed feed, or multiplies it (an override); None keeps the job's.
    dialect
        Name of the dialect of a part program; None is what the machine file says.
    feed_mode
        Text of what F of a part program means where axes of several kinds move together; None is
        the reader's default.
    radius
        Text of the radii at which rotary axes act on this job, ``"A=40 mm, B=2 mm"``; None is the
        machine's.
    offset
        Text of where the zero of a part program lies on the machine, ``"X=12 mm, A=30 deg"``; None
        is the machine's zero.
    needle
        Text of the needle speed that replaces the speed of a seam; None keeps the seam's.
    tolerance_m
        Largest deviation of the planned from the programmed path, at the tool.
    limit_share
        Share of the machine's acceleration and jerk limits that the planner uses, in (0, 1].
    shaper
        Text of the shaper, or of one per axis, that the trajectory is convolved with, or None.
    feed_forward_s
        Command the exact inverses of the axes, so that the loads and not the motors follow the
        motion, smoothed over this time; ``auto`` then keeps every programmed time exactly. None
        commands the motion itself.
    shaper_mode, shaper_damping
        Text of the frequency, and damping ratio, of shapers of levels that name none; None is
        the machine's own.
    contour_m
        How far the loads may leave the path of ``optimal`` while their loops follow, at the tool;
        infinite for no such limit, None for ``DEFAULT_CONTOUR_M``.
    robust_share
        Share of the tolerances of loads and springs over all of which feed-forward is to hold, in
        place of its even averages; None plans for the machine as typed alone.
    change_s
        Time in which a robust plan may change the speed; None is what the needle of a seam leaves.
    """

    interpolation: str = DEFAULT_INTERPOLATION
    feed: Feed | None = None
    dialect: str | None = None
    feed_mode: str | None = None
    radius: str | None = None
    offset: str | None = None
    needle: str | None = None
    tolerance_m: float = DEFAULT_TOLERANCE_M
    limit_share: float = 1.0
    shaper: str | None = None
    feed_forward_s: float | None = None
    shaper_mode: str | None = None
    shaper_damping: float | None = None
    contour_m: float | None = None
    robust_share: float | None = None
    change_s: float | None = None

    def on(self, machine: Machine) -> Options:
        """Return the options with the interpolation that a machine has by default, if none is told.

        A firmware that plans by itself makes of a program what it makes of it: that is then what is
        to be proved. Commands for the loads do not come from it.
        """
        if self.interpolation != DEFAULT_INTERPOLATION:
            return self
        own = machine.planner is not None and self.following is Following.MOTOR
        return replace(self, interpolation=FIRMWARE if own else AUTO)

    @property
    def own_feeds(self) -> bool:
        """Whether the feeds of the job hold, as they are or times an override."""
        return self.feed is None or self.feed.mode is FeedMode.OVERRIDE

    @property
    def follows_contour(self) -> bool:
        """Whether the timing limits how far the loops leave the path: ``optimal`` for motors."""
        return self.interpolation == OPTIMAL and self.following is Following.MOTOR

    @property
    def path(self) -> PathChoice:
        """The shape of the path: with feed-forward ``auto`` stands for the programmed chords."""
        chords = self.feed_forward_s is not None and self.interpolation in USUAL
        name = CHORDS if chords else self.interpolation  # one by a law is of the chords, too
        return PathChoice(interpolation=name, tolerance_m=self.tolerance_m)

    @property
    def timing(self) -> TimingChoice:
        """When the motion is where on its path; chords keep their programmed times."""
        pace, law = Pace.LIMITED, None
        if self.interpolation.startswith(BY_LAW):
            pace, law = Pace.LAW, self.interpolation.removeprefix(BY_LAW)
        elif self.path.interpolation == CHORDS:
            pace = Pace.PROGRAMMED
        return TimingChoice(
            pace=pace,
            law=law,
            feed=self.feed,
            limit_share=self.limit_share,
            smoothing_s=self.feed_forward_s,
            shaper=self.shaper,
            contour_m=self.allowance_m if self.follows_contour else math.inf,
            ends_m=self._ends_m,
            robust_share=self.robust_share,
            change_s=self.change_s,
        )

    @property
    def allowance_m(self) -> float:
        """``contour_m``, or its default."""
        return DEFAULT_CONTOUR_M if self.contour_m is None else self.contour_m

    @property
    def _ends_m(self) -> float | None:
        if self.interpolation != OPTIMAL or self.following is Following.MOTOR:
            return None
        return None if math.isinf(self.allowance_m) else self.allowance_m

    @property
    def following(self) -> Following:
        """Whether the motors or the loads are to be where the motion says."""
        return Following.MOTOR if self.feed_forward_s is None else Following.LOAD


def options_of(
    interpolation: Word = None, feed: Word = None, tolerance: Word = None, **words: Word
) -> Options:
    """Return the planning options, read from their words as ``option_table`` declares them.

    Parameters
    ----------
    interpolation, feed, tolerance, **words
        By the words of the options; one that is left out, or None, has its default.

    Raises
    ------
    OptionError
        If one is unknown or unreadable, a smoothing is given without feed-forward, a meaning of F
        with a feed that replaces it, a law with another interpolation, or a contour with any but
        ``optimal`` followed by the motors.
    """
    for word in words:
        if word not in _PLANNING:
            raise OptionError(f"unknown option {word!r}", remedy=nearest(word, tuple(_PLANNING)))
    words |= {"interpolation": interpolation, "feed": feed, "tolerance": tolerance}
    given: dict[str, Word] = {word: one.default for word, one in _PLANNING.items()}
    given |= {word: value for word, value in words.items() if value is not None}
    given["interpolation"] = _interpolation(given)
    _refuse_pairs(given)
    read = {
        one.attribute: one.parse(given[word])
        for word, one in _PLANNING.items()
        if one.parse is not None and given[word] is not None
    }
    if given["feed_forward"]:
        width = given["smoothing"]
        if width is None or given["robust"] is not None:
            of_optimal = given["interpolation"] == OPTIMAL
            width = OPTIMAL_FEED_FORWARD if of_optimal else FEED_FORWARD
        read["feed_forward_s"] = parse_width_s(str(width))
    if given["smoothing"] is not None and given["robust"] is not None:
        read["change_s"] = parse_width_s(str(given["smoothing"]))
    return Options(**read)


_PLANNING = {one.word: one for one in TABLE if one.group is Group.PLAN}


def _interpolation(given: Mapping[str, Word]) -> str:
    """Return the interpolation; a motion law is one of its own.

    Raises
    ------
    OptionError
        If a law and another interpolation are given.
    """
    law, interpolation = given["law"], str(given["interpolation"])
    if law is None:
        return interpolation
    if interpolation not in USUAL:
        raise OptionError(
            f"--law {law!r} is an interpolation of its own, and --interpolation "
            f"{interpolation!r} another",
            remedy="Leave one of them out.",
        )
    return f"{BY_LAW}{law}"


def _refuse_pairs(given: Mapping[str, Word]) -> None:
    """Refuse options that do not go together.

    Raises
    ------
    OptionError
        Naming the pair.
    """
    interpolation, forward = given["interpolation"], given["feed_forward"]
    smoothing, contour, robust = given["smoothing"], given["contour"], given["robust"]
    if smoothing is not None and not forward:
        raise OptionError(
            f"--smoothing {smoothing!r} is of feed-forward", remedy="Give --feed-forward too."
        )
    feed, rule = given["feed"], given["feed_mode"]
    both = feed is not None and rule is not None
    if both and parse_feed(str(feed)).mode not in {FeedMode.F_WORD, FeedMode.OVERRIDE}:
        raise OptionError(
            f"--feed-mode {rule!r} says what F means, and --feed {feed!r} replaces every F",
            remedy='Leave one of them out, or give the feed as an F, like "F 3000".',
        )
    if contour is not None and interpolation != OPTIMAL:
        raise OptionError(
            f"--contour {contour!r} bounds what loops make of {OPTIMAL}, and nothing of "
            f"{interpolation}",
            remedy=f"Leave it out, or give --interpolation {OPTIMAL}.",
        )
    if robust is not None and (not forward or interpolation not in USUAL):
        raise OptionError(
            f"--robust {robust!r} is of feed-forward along the programmed chords and times",
            remedy="Give --feed-forward too, and no other --interpolation.",
        )
    shaped = given["shaper"] not in (None, UNSHAPED_WORD)
    if not shaped and (given["mode"] is not None or given["damping"] is not None):
        raise OptionError(
            "--mode and --damping name the mode of a shaper", remedy="Give --shaper too."
        )


def foreign_options(kind: str, machine: Machine, options: Options) -> list[str]:
    """Return the options that are given, as typed, and have no meaning for a kind of work."""
    options, plain, found = options.on(machine), Options().on(machine), []
    for one in _PLANNING.values():
        if kind in one.kinds or not one.attribute:
            continue
        if getattr(options, one.attribute) != getattr(plain, one.attribute):
            found.append(one.typed)
    if options.interpolation.startswith(BY_LAW):
        law = kind in option("law").kinds
        found = [("--law" if name == "--interpolation" else name) for name in found]
        found = [name for name in found if not (law and name == "--law")]
    return found


def refuse_axis_options(machine: Machine, options: Options) -> None:
    """Refuse options of machines with axes: a schedule has only the options of the shaper.

    Raises
    ------
    OptionError
        If one is given.
    """
    if names := foreign_options("switches", machine, options):
        raise OptionError(
            f"{', '.join(names)}: {machine.name} switches cylinders on and off, without a path, a "
            "feed or a law to choose",
            remedy="Leave it out; --shaper may be given.",
        )


_CONTOUR = "contour"


def describe(job: Job, machine: Machine, options: Options) -> dict[str, str]:
    """Return the options as text: enough to make the same plan again."""
    said = {"job": job.file, "machine": machine.reference}
    if machine.parameters:
        said["par"] = machine.parameters
    for one, recorded in RECORDED:
        value = getattr(options, one.attribute)
        if (
            recorded.key == _CONTOUR
        ):  # its default is said, too, and nothing where it bounds nothing
            value = options.allowance_m if options.interpolation == OPTIMAL else None
        if (text := recorded.write(value)) is not None:
            said[recorded.key] = text
    return said


def options_from(description: dict[str, str]) -> Options:
    """Return the options that ``describe`` wrote down.

    Raises
    ------
    OptionError
        If one of them is missing or unreadable.
    """
    read = {}
    for one, recorded in RECORDED:
        if recorded.key in description:
            read[one.attribute] = recorded.read(description[recorded.key])
        elif recorded.required:
            raise OptionError(
                f"the recording does not say with which {recorded.key} its plan was made",
                remedy="Give the job, the machine and the options.",
            )
    of_loads = "feed-forward" in description and description["interpolation"] == OPTIMAL
    if _CONTOUR not in description and of_loads:
        # A recording without a contour is of a plan that kept the rests of the inverses.
        read["contour_m"] = math.inf
    return Options(**read)
