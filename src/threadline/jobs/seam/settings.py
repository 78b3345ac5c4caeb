"""The settings of a seam, each with its unit, range, default and meaning."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from threadline.base.wording import nearest
from threadline.errors import JobError, Place, UnitError
from threadline.geometry.offset import Allowance
from threadline.units import parse_quantity

EXAMPLE = (
    'Write a file NAME.seam.toml with [drawing] file = "..." and [stitching] '
    'stitch_length = "0.1 in", needle_speed = "75 stitch/s".'
)

LEAST_NEEDLE_HZ, MOST_NEEDLE_HZ = 1e-3, 1000.0
"""Lowest and highest needle speed of a seam."""

MOST_SETTLE_S = 60.0
"""Longest rest before a contour and for a trim."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Stitching:
    """The settings of a seam.

    Parameters
    ----------
    stitch_length_m, needle_speed_hz
        Wanted length of the stitches, and number of stitches per second.
    tolerance
        Allowed difference of a stitch from the stitch length, as a share of that length. Two
        stitches on each side of a corner or reversal, and at each end, are exempt.
    placement_m
        Allowed distance of the head from the seam. With a slowed needle and interpolated motion
        this distance sets the speed at corners.
    bow_m, least_stitch_m
        Stitches are shortened where the drawn line would bow out of them by more than ``bow_m``
        (None: half of the placement), but not below the least stitch or the wanted length,
        whichever is less.
    corner_angle_rad
        A turn of at least this angle within the least stitch is a corner, and gets a stitch.
    motion
        ``interpolated``: a leg begins before the leg before it ends, which rounds the corner;
        ``discrete``: the head rests at each corner.
    needle
        ``constant``: the needle has constant speed; ``slowed``: the needle slows down with the
        head, so that stitches keep their length; ``follow``: the needle turns with the path length
        of the head, and the planner times the head.
    needle_slowest_hz
        Lowest speed of a needle that follows, stitch/s, except for turns beside a rest of the head.
    acceleration_m_s2
        Acceleration of the head along the seam; None: the two-stitch rule,
        ``v^2 / (2 stitch length)``.
    deceleration_m_s2
        Deceleration of the head along the seam; None: equal to the acceleration.
    needle_acceleration_hz_s
        Largest acceleration of the sewing motor, stitch/s^2; infinite for no limit.
    swing
        Largest speed at which a robust plan lets the head swing before it departs and after it
        has stopped, as a share of its speed; infinite for no limit.
    allowance_m, side, join, mitre_limit
        Distance of the stitches from the drawn line; side: ``inside`` or ``outside`` a closed
        contour, ``left`` or ``right`` of an open contour; shape of corners: ``mitre`` or ``round``;
        a mitre longer than ``mitre_limit`` allowances is rounded.
    lock_start, lock_end
        Number of stitches sewn forth and back to lock the thread at the start and at the end.
    start_m, end_m
        Lengths along the contour of the start and the end of the seam; None: the whole contour.
    reverse
        Whether to sew the contour against its drawn direction.
    travel_speed_m_s, settle_s
        Speed of the head on the way to a contour, and rest of the head before the first stitch.
        None: the machine's modes give the values (see ``with_journeys``). An infinite speed
        (``"fastest"``) means the highest speed of the machine.
    trim_s
        Rest of the head at the end of a contour for the thread trim.
    """

    stitch_length_m: float
    needle_speed_hz: float
    tolerance: float = 0.05
    placement_m: float = 5e-4
    bow_m: float | None = None
    least_stitch_m: float = 5e-4
    corner_angle_rad: float = math.radians(15.0)
    motion: str = "interpolated"
    needle: str = "constant"
    acceleration_m_s2: float | None = None
    deceleration_m_s2: float | None = None
    needle_slowest_hz: float = 0.0
    needle_acceleration_hz_s: float = math.inf
    swing: float = math.inf
    allowance_m: float = 0.0
    side: str = "inside"
    join: str = "mitre"
    mitre_limit: float = 4.0
    lock_start: int = 0
    lock_end: int = 0
    start_m: float | None = None
    end_m: float | None = None
    reverse: bool = False
    travel_speed_m_s: float | None = None
    settle_s: float | None = None
    trim_s: float = 0.0

    @property
    def follows(self) -> bool:
        """Whether the needle turns with the path length of the head."""
        return self.needle == "follow"

    @property
    def bow_limit_m(self) -> float:
        """Allowed distance of the drawn line from the chord of a stitch."""
        return 0.5 * self.placement_m if self.bow_m is None else self.bow_m

    @property
    def least_m(self) -> float:
        """Least length of stitches at bends."""
        return min(self.least_stitch_m, self.stitch_length_m)

    @property
    def allowance(self) -> Allowance:
        """Offset of the stitches from the drawn line."""
        return Allowance(self.allowance_m, self.side, self.join, self.mitre_limit)

    @property
    def speed_m_s(self) -> float:
        """Speed of the head at full needle speed: eq 2.3 of the stitcher thesis."""
        return self.stitch_length_m * self.needle_speed_hz


class Accelerations(NamedTuple):
    """Acceleration (``up``) and deceleration (``down``) of the head along the seam, m/s^2."""

    up: float
    down: float


@dataclass(frozen=True, slots=True)
class _Setting:
    field: str
    unit: str | None = None  # None: a choice, a whole number or a truth value
    choices: tuple[str, ...] = ()
    kind: type = str
    low: float = 0.0
    high: float = math.inf
    open_low: bool = False
    endless: str = ""  # word for an infinite value


SETTINGS = {
    "stitch_length": _Setting("stitch_length_m", "m", low=1e-5, high=0.1),
    "needle_speed": _Setting(
        "needle_speed_hz", "stitch/s", low=LEAST_NEEDLE_HZ, high=MOST_NEEDLE_HZ
    ),
    "tolerance": _Setting("tolerance", "", low=1e-4, high=0.5),
    "placement": _Setting("placement_m", "m", low=1e-6, high=0.1),
    "bow": _Setting("bow_m", "m", low=1e-6, high=0.1),
    "least_stitch": _Setting("least_stitch_m", "m", low=1e-5, high=0.1),
    "corner_angle": _Setting(
        "corner_angle_rad", "rad", low=math.radians(2.0), high=math.radians(170.0)
    ),
    "motion": _Setting("motion", choices=("interpolated", "discrete")),
    "needle": _Setting("needle", choices=("constant", "slowed", "follow")),
    "acceleration": _Setting("acceleration_m_s2", "m/s^2", low=1e-3, high=1e6),
    "deceleration": _Setting("deceleration_m_s2", "m/s^2", low=1e-3, high=1e6),
    "needle_slowest": _Setting("needle_slowest_hz", "stitch/s", high=MOST_NEEDLE_HZ),
    "needle_acceleration": _Setting("needle_acceleration_hz_s", "stitch/s^2", low=0.1),
    "swing": _Setting("swing", "", low=1e-3, high=1.0),
    "allowance": _Setting("allowance_m", "m"),
    "side": _Setting("side", choices=("inside", "outside", "left", "right")),
    "join": _Setting("join", choices=("mitre", "round")),
    "mitre_limit": _Setting("mitre_limit", "", low=1.0),
    "lock_start": _Setting("lock_start", kind=int, high=50),
    "lock_end": _Setting("lock_end", kind=int, high=50),
    "start": _Setting("start_m", "m"),
    "end": _Setting("end_m", "m", open_low=True),
    "reverse": _Setting("reverse", kind=bool),
    "travel_speed": _Setting("travel_speed_m_s", "m/s", low=1e-4, high=10.0, endless="fastest"),
    "settle": _Setting("settle_s", "s", high=MOST_SETTLE_S),
    "trim": _Setting("trim_s", "s", high=MOST_SETTLE_S),
}
"""Settings of a seam, by key."""
STITCHING_KEYS = tuple(SETTINGS)


def stitching(settings: Mapping[str, Any], places: Mapping[str, Place], place: Place) -> Stitching:
    """Return the settings of a seam from their texts.

    Parameters
    ----------
    settings
        Values by the names in ``STITCHING_KEYS``; quantities are texts with a unit.
    places
        Place of each setting in its file, for errors.
    place
        Place for the error about a missing setting.

    Raises
    ------
    JobError
        If a setting is unknown, malformed, out of range or missing.
    """
    values: dict[str, Any] = {}
    for key, value in settings.items():
        key_place = places.get(key, place)
        setting = SETTINGS.get(key)
        if setting is None:
            raise JobError(
                f"unknown key {key!r}", place=key_place, remedy=nearest(key, STITCHING_KEYS)
            )
        values[setting.field] = _value(key, value, setting, key_place)
    for key in ("stitch_length", "needle_speed"):
        if SETTINGS[key].field not in values:
            raise JobError(f"{key} is not given", place=place, remedy=EXAMPLE)
    settings_read = Stitching(**values)
    _check_needle(settings_read, places, place)
    if settings_read.end_m is not None and settings_read.end_m <= (settings_read.start_m or 0.0):
        raise JobError(
            f"the seam ends at {settings_read.end_m * 1e3:.6g} mm, before it starts",
            place=places.get("end", place),
        )
    return settings_read


def _check_needle(settings: Stitching, places: Mapping[str, Place], place: Place) -> None:
    """Refuse ``needle_slowest`` for a needle that does not follow, or above ``needle_speed``."""
    slowest = settings.needle_slowest_hz
    if not slowest:
        return
    key_place = places.get("needle_slowest", place)
    if not settings.follows:
        raise JobError(
            f"needle_slowest is {slowest:g} stitch/s, and needle is {settings.needle!r}",
            place=key_place,
            remedy='It is of needle = "follow".',
        )
    if slowest > settings.needle_speed_hz:
        raise JobError(
            f"needle_slowest is {slowest:g} stitch/s, above needle_speed, "
            f"{settings.needle_speed_hz:g} stitch/s",
            place=key_place,
            remedy="The needle turns between them: lower the one, or raise the other.",
        )


def _value(key: str, value: Any, setting: _Setting, place: Place) -> Any:
    if setting.endless and value == setting.endless:
        return math.inf
    if setting.choices:
        if value not in setting.choices:
            raise JobError(
                f"{key} is {value!r}", place=place, remedy=f"Use {' or '.join(setting.choices)}."
            )
        return value
    if setting.unit is None:
        # bool is an int in Python; here a truth value is not a number.
        if type(value) is not setting.kind:
            raise JobError(f"{key} is {value!r}, not of type {setting.kind.__name__}", place=place)
        number: Any = value
        shown = value
    elif isinstance(value, str):
        try:
            number = parse_quantity(value, setting.unit)
        except UnitError as error:
            raise JobError(f"{key}: {error.message}", place=place, remedy=error.remedy) from error
        shown = value
    elif setting.unit == "" and isinstance(value, int | float) and not isinstance(value, bool):
        number = shown = float(value)
    else:
        raise JobError(
            f"{key} is {value!r}, which has no unit",
            place=place,
            remedy=f'Write it like "1 {setting.unit}".',
        )
    if not setting.low <= number <= setting.high or (setting.open_low and number <= setting.low):
        raise JobError(
            f"{key} is {shown!r}; it must be {'above' if setting.open_low else 'at least'} "
            f"{setting.low:g} and at most {setting.high:g} {setting.unit or ''}".rstrip(),
            place=place,
        )
    return number
