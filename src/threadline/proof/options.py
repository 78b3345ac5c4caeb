"""Planning options: how they are typed, recorded, and combined into three choices."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from threadline.base.option_defaults import (
    AUTO,
    DEFAULT_CONTOUR_M,
    DEFAULT_INTERPOLATION,
    DEFAULT_TOLERANCE,
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
from threadline.proof.option_words import (
    Narrow,
    Reserve,
    parse_feed,
    parse_outside_m,
    parse_tolerance_m,
    parse_width_s,
)

_OF_SWITCHES = planned_by("switches")
LEAVE_OUT = ("Leave it out.", "Leave them out.")
"""Remedy against one option, and against several."""
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
    outside_m
        Largest deviation on the outside of corners.
    narrow
        Line numbers of the program, each with the tolerance at the end of its move, m.
    """

    interpolation: str
    tolerance_m: float
    outside_m: float = 0.0
    narrow: Narrow = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class TimingChoice:
    """The second choice: the timing of the motion along its path.

    Parameters
    ----------
    pace
        Whether each move is as fast as limits and feed allow, as programmed, or follows a law.
    law
        Name of the motion law of each move; None if ``pace`` is not by a law.
    feed
        Replaces every programmed feed; None keeps the job's.
    limit_share
        Share of the machine's acceleration and jerk limits that may be used, in (0, 1].
    smoothing_s
        Width in s of the moving averages that smooth the motion; None: as wide as the jerk limits
        require.
    shaper
        Text of the shaper that the motion is convolved with; None for no shaper.
    contour_m
        Allowed path deviation of the loads due to the following error of the loops; infinite for
        no such limit.
    ends_m
        With ``optimal`` and feed-forward: allowed deviation of the loads from their motion at the
        start and end of the table. With None the table is extended until the inverse has settled.
    robust_share, change_s, reserve
        As in ``Options``.
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
    reserve: Reserve | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Options:
    """The planning options of a job, as typed.

    ``path``, ``timing`` and ``following`` are the three choices that follow from these options. One
    option of the command line may decide two choices at once.

    Parameters
    ----------
    interpolation
        Name of the interpolation; ``DEFAULT_INTERPOLATION`` is resolved by ``on`` for a machine.
    feed
        Replaces every programmed feed, or multiplies it (an override); None keeps the job's.
    dialect
        Name of the dialect of a part program; None: the machine file's.
    feed_mode
        Text of the rule for F of a part program if axes of several kinds move together; None: the
        reader's default.
    axes
        Text of the axis letters of the program for axes of the machine, ``"C=A,Z=X"``; None: the
        letters are the names of the axes.
    radius
        Text of the radii at which rotary axes act in this job, ``"A=40 mm, B=2 mm"``; None: the
        machine's.
    product
        Text of the product of a winder (``winding.product.product_text``); None for none.
    offset
        Text of the machine position of the program's zero, ``"X=12 mm, A=30 deg"``; None: the
        machine's zero.
    needle
        Text of the needle speed that replaces the speed of a seam; None keeps the seam's.
    long_stitches
        How stitches of a design that are longer than the machine's longest move are sewn:
        ``travel``, ``split`` or ``refuse``; None: ``travel``.
    tolerance_m
        Largest deviation of the planned from the programmed path, at the tool.
    limit_share
        Share of the machine's acceleration and jerk limits that the planner uses, in (0, 1].
    shaper
        Text of the shaper, or of one shaper per axis, that the trajectory is convolved with; None
        for no shaper.
    feed_forward_s
        Smoothing time in s of feed-forward. Feed-forward commands the exact inverses of the axes,
        so that the loads, and not the motors, follow the motion; ``auto`` then keeps every
        programmed time exactly. With None the references are the motion itself.
    shaper_mode, shaper_damping
        Text of the frequency, and damping ratio, for on/off shapers that name no mode; None: the
        mode of the machine.
    contour_m
        With ``optimal``: allowed path deviation of the loads, at the tool, due to the following
        error of the loops; infinite for no limit, None for ``DEFAULT_CONTOUR_M``.
    robust_share
        Share of the tolerances of loads and springs that feed-forward must cover. Optimised
        averages then replace its plain moving averages. None plans for the nominal machine only.
    change_s
        Time in which a robust plan may change the speed; None: derived from the needle of a seam.
    outside_m
        With ``optimal``: largest deviation of the path on the outside of corners, m.
    reserve
        With ``optimal``: shares of voltage and current that the plan reserves for the loops; None:
        the shares in the machine file.
    narrow
        With ``optimal``: line numbers of the program, each with the tolerance at the end of its
        move, m.
    table
        Text of a learned table (``commands.learned``) that replaces the planned table; None for
        none.
    """

    interpolation: str = DEFAULT_INTERPOLATION
    feed: Feed | None = None
    dialect: str | None = None
    feed_mode: str | None = None
    axes: str | None = None
    radius: str | None = None
    product: str | None = None
    offset: str | None = None
    needle: str | None = None
    long_stitches: str | None = None
    tolerance_m: float = DEFAULT_TOLERANCE_M
    limit_share: float = 1.0
    shaper: str | None = None
    feed_forward_s: float | None = None
    shaper_mode: str | None = None
    shaper_damping: float | None = None
    contour_m: float | None = None
    robust_share: float | None = None
    change_s: float | None = None
    outside_m: float = 0.0
    reserve: Reserve | None = None
    narrow: Narrow = ()
    table: str | None = None

    def on(self, machine: Machine) -> Options:
        """Return the options with the machine's default interpolation, if none was named.

        If the firmware of the machine plans the motion, the default is ``firmware``, because the
        firmware's motion has to be proved. With feed-forward the default is another one: firmware
        cannot compute references for the loads.
        """
        if self.interpolation != DEFAULT_INTERPOLATION:
            return self
        by_firmware = machine.planner is not None and self.following is Following.MOTOR
        return replace(self, interpolation=FIRMWARE if by_firmware else AUTO)

    @property
    def own_feeds(self) -> bool:
        """Whether the feeds of the job apply, with or without an override."""
        return self.feed is None or self.feed.mode is FeedMode.OVERRIDE

    @property
    def follows_contour(self) -> bool:
        """Whether the timing bounds the loops' path deviation: ``optimal`` for motors."""
        return self.interpolation == OPTIMAL and self.following is Following.MOTOR

    @property
    def path(self) -> PathChoice:
        """The choice of the path; with feed-forward ``auto`` means the programmed chords."""
        chords = self.feed_forward_s is not None and self.interpolation in USUAL
        name = CHORDS if chords else self.interpolation  # a motion law also follows chords
        return PathChoice(
            interpolation=name,
            tolerance_m=self.tolerance_m,
            outside_m=self.outside_m,
            narrow=self.narrow,
        )

    @property
    def timing(self) -> TimingChoice:
        """The choice of the timing along the path; chords keep their programmed times."""
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
            reserve=self.reserve,
        )

    @property
    def allowance_m(self) -> float:
        """Allowed path deviation: ``contour_m``, or its default."""
        return DEFAULT_CONTOUR_M if self.contour_m is None else self.contour_m

    @property
    def _ends_m(self) -> float | None:
        if self.interpolation != OPTIMAL or self.following is Following.MOTOR:
            return None
        return None if math.isinf(self.allowance_m) else self.allowance_m

    @property
    def following(self) -> Following:
        """The third choice: whether the motors or the loads follow the motion."""
        return Following.MOTOR if self.feed_forward_s is None else Following.LOAD


def options_of(
    interpolation: Word = None, feed: Word = None, tolerance: Word = None, **words: Word
) -> Options:
    """Return the planning options from their words, as declared in ``option_table``.

    Parameters
    ----------
    interpolation, feed, tolerance, **words
        Values by option; an option that is left out, or None, has its default.

    Raises
    ------
    OptionError
        If a word is unknown or unreadable, or excludes another word: a smoothing without
        feed-forward, a rule for F with a feed that replaces F, a law with another interpolation, or
        a contour limit without ``optimal`` for the motors.
    """
    for word in words:
        if word not in _PLANNING:
            raise OptionError(f"unknown option {word!r}", remedy=nearest(word, tuple(_PLANNING)))
    words |= {"interpolation": interpolation, "feed": feed, "tolerance": tolerance}
    given: dict[str, Word] = {word: entry.default for word, entry in _PLANNING.items()}
    given |= {word: value for word, value in words.items() if value is not None}
    given["interpolation"] = _interpolation(given)
    _refuse_pairs(given)
    values = {
        entry.attribute: entry.parse(given[word])
        for word, entry in _PLANNING.items()
        if entry.parse is not None and given[word] is not None
    }
    if given["feed_forward"]:
        smoothing = given["smoothing"]
        if smoothing is None or given["robust"] is not None:
            of_optimal = given["interpolation"] == OPTIMAL
            smoothing = OPTIMAL_FEED_FORWARD if of_optimal else FEED_FORWARD
        values["feed_forward_s"] = parse_width_s(str(smoothing))
    if given["smoothing"] is not None and given["robust"] is not None:
        values["change_s"] = parse_width_s(str(given["smoothing"]))
    return Options(**values)


_PLANNING = {one.word: one for one in TABLE if one.group is Group.PLAN}


def _interpolation(given: Mapping[str, Word]) -> str:
    """Return the interpolation; a motion law counts as an interpolation.

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
            f"--law {law!r} and --interpolation {interpolation!r} both choose the interpolation",
            remedy="Leave one of them out.",
        )
    return f"{BY_LAW}{law}"


def _refuse_pairs(given: Mapping[str, Word]) -> None:
    """Refuse options that exclude each other.

    Raises
    ------
    OptionError
        Names the pair.
    """
    interpolation, feed_forward = given["interpolation"], given["feed_forward"]
    smoothing, contour = given["smoothing"], given["contour"]
    if smoothing is not None and not feed_forward:
        raise OptionError(
            f"--smoothing {smoothing!r} needs feed-forward", remedy="Give --feed-forward too."
        )
    feed, rule = given["feed"], given["feed_mode"]
    feed_and_rule = feed is not None and rule is not None
    if feed_and_rule and parse_feed(str(feed)).mode not in {FeedMode.F_WORD, FeedMode.OVERRIDE}:
        raise OptionError(
            f"--feed-mode {rule!r} is a rule for F, and --feed {feed!r} replaces every F",
            remedy='Leave one of them out, or give the feed as an F, like "F 3000".',
        )
    if contour is not None and interpolation != OPTIMAL:
        raise OptionError(
            f"--contour {contour!r} bounds the path deviation with {OPTIMAL}, and not with "
            f"{interpolation}",
            remedy=f"Leave it out, or give --interpolation {OPTIMAL}.",
        )
    for name in ("outside", "reserve", "narrow"):
        if given[name] is not None and interpolation != OPTIMAL:
            raise OptionError(
                f"--{name} {given[name]!r} is an option of {OPTIMAL}, and not of {interpolation}",
                remedy=f"Leave it out, or give --interpolation {OPTIMAL}.",
            )
    if given["outside"] is not None:
        tolerance = str(given["tolerance"] or DEFAULT_TOLERANCE)
        if parse_outside_m(str(given["outside"])) > parse_tolerance_m(tolerance):
            raise OptionError(
                f"--outside {given['outside']!r} is more than --tolerance {tolerance!r}, the "
                "largest deviation from the programmed path",
                remedy="Lower it, or raise the tolerance.",
            )
    shaped = given["shaper"] not in (None, UNSHAPED_WORD)
    if not shaped and (given["mode"] is not None or given["damping"] is not None):
        raise OptionError(
            "--mode and --damping name the mode of a shaper", remedy="Give --shaper too."
        )


def foreign_options(kind: str, machine: Machine, options: Options) -> list[str]:
    """Return the given options, as typed, that do not apply to a kind of work."""
    options, defaults, foreign = options.on(machine), Options().on(machine), []
    for entry in _PLANNING.values():
        if kind in entry.kinds or not entry.attribute:
            continue
        if getattr(options, entry.attribute) != getattr(defaults, entry.attribute):
            foreign.append(entry.typed)
    if options.interpolation.startswith(BY_LAW):
        law = kind in option("law").kinds
        foreign = [("--law" if name == "--interpolation" else name) for name in foreign]
        foreign = [name for name in foreign if not (law and name == "--law")]
    return foreign


def refuse_axis_options(machine: Machine, options: Options) -> None:
    """Refuse options that apply only to axes: a schedule accepts only the options of shapers.

    Raises
    ------
    OptionError
        If one is given.
    """
    if names := foreign_options("switches", machine, options):
        raise OptionError(
            f"{machine.name} takes no {' or '.join(names)}, because it switches cylinders on and "
            "off, without a path, a feed or a law to choose",
            remedy=LEAVE_OUT[len(names) > 1],
        )


_CONTOUR = "contour"


def describe(job: Job, machine: Machine, options: Options) -> dict[str, str]:
    """Return the options as text, complete enough to make the same plan again."""
    texts = {"job": job.file, "machine": machine.reference}
    if machine.parameters:
        texts["par"] = machine.parameters
    for entry, recorded in RECORDED:
        value = getattr(options, entry.attribute)
        if recorded.key == _CONTOUR:  # write also the default, but nothing if it has no effect
            bounds_loops = options.interpolation == OPTIMAL and not machine.takes_positions
            value = options.allowance_m if bounds_loops else None
        if (text := recorded.write(value)) is not None:
            texts[recorded.key] = text
    return texts


def options_from(description: dict[str, str]) -> Options:
    """Return the options that ``describe`` wrote down.

    Raises
    ------
    OptionError
        If one of them is missing or unreadable.
    """
    values = {}
    for entry, recorded in RECORDED:
        if recorded.key in description:
            values[entry.attribute] = recorded.read(description[recorded.key])
        elif recorded.required:
            raise OptionError(
                f"the recording does not name the {recorded.key} of its plan",
                remedy="Give the job, the machine and the options.",
            )
    of_loads = "feed-forward" in description and description["interpolation"] == OPTIMAL
    if _CONTOUR not in description and of_loads:
        # A recording without a contour limit comes from a plan whose table is extended until the
        # inverses have settled.
        values["contour_m"] = math.inf
    return Options(**values)
