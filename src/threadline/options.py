"""How a job is to be planned, and how that is written on a command line and in a recording."""

from __future__ import annotations

from dataclasses import dataclass, replace

from threadline.errors import OptionError, UnitError
from threadline.jobs.operations import Feed, FeedMode, Job
from threadline.machine import Machine
from threadline.path.plan import BY_LAW, CHORDS, DEFAULT_TOLERANCE_M
from threadline.plan import Following
from threadline.trajectory import Pace
from threadline.units import parse_quantity, same_dimension, split_quantity

DEFAULT_INTERPOLATION = "auto"
DEFAULT_LIMITS = "100 %"
DEFAULT_TOLERANCE = f"{DEFAULT_TOLERANCE_M * 1e3:g} mm"
FEED_FORWARD = "40 ms"
"""Over which feed-forward smooths the motion unless told otherwise."""
_UNITS = {FeedMode.COUNT_PER_TICK: "count/tick", FeedMode.SHAFT: "stitch/s"}
OF_AXES = ("interpolation", "feed", "dialect", "feed-mode", "radius", "tolerance", "limits")
"""What ``describe`` says of machines with axes, and means nothing on one that switches."""
LEAST_SHARE = 1e-3
"""Of the limits: no job is meant to speed up a thousand times more gently than its machine can, and
the search for its trajectory takes the longer the longer that trajectory is."""


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
    """

    pace: Pace
    law: str | None
    feed: Feed | None
    limit_share: float
    smoothing_s: float | None
    shaper: str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Options:
    """How a job is to be planned, as it is typed.

    ``path``, ``timing`` and ``following`` are the three choices that these words stand for: the
    words on a command line came first, and one of them may mean two choices at once.

    Parameters
    ----------
    interpolation
        Name of the interpolation.
    feed
        Replaces every programmed feed; None keeps the job's.
    dialect
        Name of the dialect of a part program; None is what the machine file says.
    feed_mode
        Text of what F of a part program means where axes of several kinds move together; None is
        the reader's default.
    radius
        Text of the radii at which rotary axes act on this job, ``"A=40 mm, B=2 mm"``; None is the
        machine's.
    tolerance_m
        Largest deviation of the planned from the programmed path, at the tool.
    limit_share
        Share of the machine's acceleration and jerk limits that the planner uses, in (0, 1].
    shaper
        Text of the shaper, or of one per axis, that the trajectory is convolved with; None
        leaves it as it was planned.
    feed_forward_s
        Command the exact inverses of the axes, so that the loads and not the motors follow the
        motion, smoothed over this time; ``auto`` then keeps every programmed time exactly. None
        commands the motion itself.
    shaper_mode, shaper_damping
        Text of the frequency, and damping ratio, of shapers of levels that name none; None is
        the machine's own.
    """

    interpolation: str = DEFAULT_INTERPOLATION
    feed: Feed | None = None
    dialect: str | None = None
    feed_mode: str | None = None
    radius: str | None = None
    tolerance_m: float = DEFAULT_TOLERANCE_M
    limit_share: float = 1.0
    shaper: str | None = None
    feed_forward_s: float | None = None
    shaper_mode: str | None = None
    shaper_damping: float | None = None

    @property
    def path(self) -> PathChoice:
        """The shape of the path; loads that follow take corners as the smoothing leaves them."""
        chords = self.feed_forward_s is not None and self.interpolation == DEFAULT_INTERPOLATION
        name = CHORDS if chords else self.interpolation  # one by a law is of the chords, too
        return PathChoice(interpolation=name, tolerance_m=self.tolerance_m)

    @property
    def timing(self) -> TimingChoice:
        """When the motion is where; chords keep their programmed times."""
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
        )

    @property
    def following(self) -> Following:
        """What is to be where the motion says."""
        return Following.MOTOR if self.feed_forward_s is None else Following.LOAD


def parse_number(subject: str, text: str, unit: str, example: str) -> float:
    """Return what an option says, in ``unit``.

    Parameters
    ----------
    subject
        The option, as an error names it.
    text
        A number with a unit, as it was written.
    unit
        The SI unit wanted; ``""`` for a plain number.
    example
        How such an option is written.

    Raises
    ------
    OptionError
        If it is not a quantity of that kind.
    """
    try:
        return parse_quantity(text, unit)
    except UnitError as error:
        raise OptionError(
            f"{subject} {text!r}: {error.message}", remedy=f'Write it like "{example}".'
        ) from error


def parse_feed(text: str) -> Feed:
    """Return the feed written in ``text``: ``"10 count/tick"``, ``"36 mm/s"``, ``"2 stitch/s"``.

    Raises
    ------
    OptionError
        If it is not a positive feed of a known kind.
    """
    try:
        _, unit = split_quantity(text)
        if same_dimension(unit, "count/tick") if unit else False:
            feed = Feed(FeedMode.COUNT_PER_TICK, parse_quantity(text, "count/tick"))
        elif same_dimension(unit, "stitch/s") if unit else False:
            feed = Feed(FeedMode.SHAFT, parse_quantity(text, "stitch/s"))
        else:
            feed = Feed(FeedMode.FASTEST_AXIS, parse_quantity(text, "m/s"))
    except UnitError as error:
        raise OptionError(
            f"feed {text!r}: {error.message}",
            remedy='Write it like "10 count/tick", "36 mm/s" or "500 mm/min"; of an embroidery '
            'machine like "120 stitch/min".',
        ) from error
    if feed.value <= 0:
        raise OptionError(f"feed {text!r} must be greater than zero")
    return feed


def parse_tolerance_m(text: str) -> float:
    """Return a tolerance such as ``"0.1 mm"`` in m.

    Raises
    ------
    OptionError
        If it is not a positive length.
    """
    value = parse_number("tolerance", text, "m", "0.1 mm")
    if value <= 0:
        raise OptionError(f"tolerance {text!r} must be greater than zero")
    return value


def parse_share(text: str) -> float:
    """Return a share such as ``"25 %"`` as a number.

    Raises
    ------
    OptionError
        If it is not at least ``LEAST_SHARE`` and at most 100 %.
    """
    value = parse_number("limits", text, "", "25 %")
    if not LEAST_SHARE <= value <= 1.0:
        raise OptionError(
            f"limits {text!r} must be at least {100.0 * LEAST_SHARE:g} % and at most 100 %",
            remedy='A quarter of the limits is "25 %".',
        )
    return value


def parse_margin(text: str) -> float:
    """Return a margin such as ``"20 %"`` as a number.

    Raises
    ------
    OptionError
        If it is not at least 0 % and below 100 %.
    """
    value = parse_number("margin", text, "", "20 %")
    if not 0.0 <= value < 1.0:
        raise OptionError(
            f"margin {text!r} must be at least 0 % and below 100 %",
            remedy='20 % of every limit kept free is "20 %".',
        )
    return value


def parse_width_s(text: str) -> float:
    """Return the width of a smoothing in time such as ``"36 ms"`` in s.

    Raises
    ------
    OptionError
        If it is not a time of at least 0.1 ms and at most 10 s.
    """
    value = parse_number("smoothing", text, "s", "36 ms")
    if not 1e-4 <= value <= 10.0:
        raise OptionError(f"smoothing {text!r} must be at least 0.1 ms and at most 10 s")
    return value


def options_of(
    interpolation: str,
    feed: str | None,
    tolerance: str,
    limits: str = DEFAULT_LIMITS,
    shaper: str | None = None,
    feed_forward: bool = False,
    smoothing: str | None = None,
    feed_mode: str | None = None,
    law: str | None = None,
    dialect: str | None = None,
    radius: str | None = None,
) -> Options:
    """Return the planning options, read from their text.

    Raises
    ------
    OptionError
        If one is unreadable, a smoothing is given without feed-forward, a meaning of F with a
        feed that replaces it, or a law with another interpolation.
    """
    if law is not None:
        if interpolation != DEFAULT_INTERPOLATION:
            raise OptionError(
                f"--law {law!r} is an interpolation of its own, and --interpolation "
                f"{interpolation!r} another",
                remedy="Leave one of them out.",
            )
        interpolation = f"{BY_LAW}{law}"
    if smoothing is not None and not feed_forward:
        raise OptionError(
            f"--smoothing {smoothing!r} is of feed-forward", remedy="Give --feed-forward too."
        )
    if feed is not None and feed_mode is not None:
        raise OptionError(
            f"--feed-mode {feed_mode!r} says what F means, and --feed replaces every F",
            remedy="Leave one of them out.",
        )
    return Options(
        interpolation=interpolation,
        feed=None if feed is None else parse_feed(feed),
        dialect=dialect,
        feed_mode=feed_mode,
        radius=radius,
        tolerance_m=parse_tolerance_m(tolerance),
        limit_share=parse_share(limits),
        shaper=shaper,
        feed_forward_s=parse_width_s(FEED_FORWARD if smoothing is None else smoothing)
        if feed_forward
        else None,
    )


def refuse_axis_options(machine: Machine, options: Options) -> None:
    """Refuse options that a schedule does not have; all but those of the shaper are such.

    Raises
    ------
    OptionError
        If one is given.
    """
    if replace(options, shaper=None, shaper_mode=None, shaper_damping=None) != Options():
        raise OptionError(
            f"{machine.name} switches on and off: it has no interpolation, feed, tolerance or "
            "share of limits to choose",
            remedy="Leave these options out; a shaper may be given.",
        )


def describe(job: Job, machine: Machine, options: Options) -> dict[str, str]:
    """Return the options as text: enough to make the same plan again."""
    feed = "programmed"
    if options.feed is not None:
        unit = _UNITS.get(options.feed.mode, "m/s")
        feed = f"{options.feed.value!r} {unit}"
    return {
        "job": job.file,
        "machine": machine.reference,
        **({"par": machine.parameters} if machine.parameters else {}),
        "interpolation": options.interpolation,
        "feed": feed,
        **({} if options.dialect is None else {"dialect": options.dialect}),
        **({} if options.feed_mode is None else {"feed-mode": options.feed_mode}),
        **({} if options.radius is None else {"radius": options.radius}),
        "tolerance": f"{options.tolerance_m!r} m",
        "limits": f"{options.limit_share * 100.0!r} %",
        **({} if options.shaper is None else {"shaper": options.shaper}),
        **({} if options.shaper_mode is None else {"mode": options.shaper_mode}),
        **({} if options.shaper_damping is None else {"damping": repr(options.shaper_damping)}),
        **(
            {}
            if options.feed_forward_s is None
            else {"feed-forward": f"{options.feed_forward_s!r} s"}
        ),
    }


def options_from(description: dict[str, str]) -> Options:
    """Return the options that ``describe`` wrote down.

    Raises
    ------
    OptionError
        If one of them is missing or unreadable.
    """
    try:
        feed_text = description["feed"]
        return Options(
            interpolation=description["interpolation"],
            feed=None if feed_text == "programmed" else parse_feed(feed_text),
            dialect=description.get("dialect"),
            feed_mode=description.get("feed-mode"),
            radius=description.get("radius"),
            tolerance_m=parse_tolerance_m(description["tolerance"]),
            limit_share=parse_share(description.get("limits", "100 %")),
            shaper=description.get("shaper"),
            shaper_mode=description.get("mode"),
            shaper_damping=None
            if "damping" not in description
            else parse_number("damping", description["damping"], "", "0.17"),
            feed_forward_s=None
            if "feed-forward" not in description
            else parse_width_s(description["feed-forward"]),
        )
    except KeyError as error:
        raise OptionError(
            f"the recording does not say with which {error.args[0]} its plan was made",
            remedy="Give the job, the machine and the options.",
        ) from error
