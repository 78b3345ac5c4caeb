"""Settings of the controller: its motion planner, and how it reads part programs."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Annotated, Literal

from pydantic import Field, StrictBool, model_validator
from pydantic.dataclasses import dataclass

from threadline.machine.parts import STRICT, check_known
from threadline.machine.quantity import Quantity, Units

_RING = 16  # default BLOCK_BUFFER_SIZE of grbl 1.1 and Marlin 2.1
_DUET_RING = 60  # default number of moves in the queue of a Duet 3
_CRUISE_RATIO = 0.5  # Klipper's default

Deviation = Annotated[Quantity, Units(("m",), not_negative=True)]
Speed = Annotated[Quantity, Units(("m/s",), not_negative=True)]
Jump = Annotated[Quantity, Units(("m/s", "rad/s"), not_negative=True)]
Acceleration = Annotated[Quantity, Units(("m/s^2",), positive=True)]
AloneAcceleration = Annotated[Quantity, Units(("m/s^2", "rad/s^2"), positive=True)]
Ring = Annotated[Quantity, Units(("",), positive=True, whole=True, most=4096)]


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class GrblPlanner:
    """The planner of grbl and FluidNC: trapezoidal speed, cornering by junction deviation.

    ``blocks`` is the size of the ring buffer of blocks, 16 by default; one block in it is always
    empty. ``left_out``, in every planner, lists functions of the firmware that change the motion
    but are not planned; every plan reports them.
    """

    kind: Literal["grbl"]
    junction_deviation: Deviation
    blocks: Ring | None = None
    left_out: list[str] = Field(default_factory=list)

    @property
    def look_ahead(self) -> int:
        """Number of blocks planned together, including the current one."""
        return max(1, (_RING if self.blocks is None else round(self.blocks.si)) - 1)


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class MarlinPlanner:
    """Marlin's planner: trapezoidal speed, cornering by junction deviation or speed jumps.

    ``jump`` is the speed jump of an axis at a corner, which Marlin calls jerk (``M205 X Y Z``), by
    the axis' letter. ``acceleration`` limits every move (``M204 T``) in addition to the limits of
    the axes. ``least_speed`` is the lowest speed of a move (``M205 T``). Moves shorter than
    ``short_time`` (``M205 B``), 20 ms by default, are slowed down while few moves are queued.
    """

    kind: Literal["marlin"]
    junction_deviation: Deviation | None = None
    jump: dict[str, Jump] = Field(default_factory=dict)
    acceleration: Acceleration | None = None
    least_speed: Speed | None = None
    short_time: Annotated[Quantity, Units(("s",), not_negative=True)] | None = None
    blocks: Ring | None = None
    left_out: list[str] = Field(default_factory=list)

    @model_validator(mode="after")
    def _one_rule(self) -> MarlinPlanner:
        if (self.junction_deviation is None) != bool(self.jump):
            raise ValueError(
                "corner speed follows junction_deviation (M205 J) or jump (M205 X Y Z): give "
                "exactly one of them"
            )
        return self

    @property
    def look_ahead(self) -> int:
        """Number of blocks that are planned together, without the one under way."""
        return max(1, (_RING if self.blocks is None else round(self.blocks.si)) - 2)


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class KlipperPlanner:
    """Klipper's planner: trapezoids with a minimum cruise, cornering by square corner velocity.

    ``velocity`` and ``acceleration`` are ``max_velocity`` and ``max_accel`` of Klipper's
    ``[printer]``; ``minimum_cruise_ratio`` is 50 % by default, as in Klipper. ``jump`` is the speed
    jump of an axis other than X, Y and Z (``INSTANTANEOUS_CORNER_VELOCITY``), by the axis' letter,
    1 mm/s or deg/s by default; ``alone`` is its acceleration in moves without X, Y and Z (``accel``
    of ``[manual_stepper]``).
    """

    kind: Literal["klipper"]
    velocity: Annotated[Quantity, Units(("m/s",), positive=True)]
    acceleration: Acceleration
    square_corner_velocity: Speed
    minimum_cruise_ratio: Annotated[Quantity, Units(("",), not_negative=True)] | None = None
    jump: dict[str, Jump] = Field(default_factory=dict)
    alone: dict[str, AloneAcceleration] = Field(default_factory=dict)
    left_out: list[str] = Field(default_factory=list)

    @model_validator(mode="after")
    def _below_one(self) -> KlipperPlanner:
        if self.cruise_ratio >= 1.0:
            raise ValueError(
                f"minimum_cruise_ratio is {self.cruise_ratio:g}; it must be below 1 (100 %)"
            )
        return self

    @property
    def cruise_ratio(self) -> float:
        """Minimum share of a move's length at constant speed."""
        return _CRUISE_RATIO if self.minimum_cruise_ratio is None else self.minimum_cruise_ratio.si


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class RepRapPlanner:
    """RepRapFirmware's planner: trapezoidal speed, cornering by a speed jump of each axis.

    ``jump`` is the "maximum instantaneous speed change" of an axis (``M566``), by the axis' letter.
    ``policy`` is ``P`` of ``M566``: with 0, the default, the machine stops between a move with X or
    Y and a move of other axes only; with 1 it does not. ``acceleration`` limits the moves of X and
    Y (``M204 T``). ``blocks`` is the length of the move queue, 60 by default.
    """

    kind: Literal["reprapfirmware"]
    jump: Annotated[dict[str, Jump], Field(min_length=1)]
    policy: Annotated[Quantity, Units(("",), not_negative=True, whole=True, most=1)] | None = None
    acceleration: Acceleration | None = None
    blocks: Ring | None = None
    left_out: list[str] = Field(default_factory=list)

    @property
    def joins_all(self) -> bool:
        """Whether moves with and without X or Y follow each other without a stop."""
        return self.policy is not None and self.policy.si == 1.0

    @property
    def look_ahead(self) -> int:
        """Number of blocks that are planned together, without the one under way."""
        return max(1, (_DUET_RING if self.blocks is None else round(self.blocks.si)) - 2)


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class LinuxCncPlanner:
    """LinuxCNC's trajectory planner: arcs in corners, overlapping moves, 50 moves of look-ahead.

    ``tolerance`` is P of G64; without it only the accelerations limit the rounding of corners.
    ``cam_tolerance`` is Q, within which moves are merged: P by default, 0 for none. With
    ``exact_stop`` (G61) every move ends at rest, unless the next move continues straight.
    """

    kind: Literal["linuxcnc"]
    tolerance: Deviation | None = None
    cam_tolerance: Deviation | None = None
    exact_stop: StrictBool = False
    left_out: list[str] = Field(default_factory=list)

    @model_validator(mode="after")
    def _one_mode(self) -> LinuxCncPlanner:
        if self.exact_stop and self.tolerance is not None:
            raise ValueError("exact_stop (G61) excludes a tolerance (G64 P): remove one of them")
        if self.exact_stop and self.cam_tolerance is not None:
            raise ValueError(
                "exact_stop (G61) excludes a cam_tolerance (G64 Q): remove one of them"
            )
        return self

    @property
    def tolerance_m(self) -> float:
        """P, 0 for none."""
        return 0.0 if self.tolerance is None else self.tolerance.si

    @property
    def cam_tolerance_m(self) -> float:
        """Q, 0 for none."""
        return self.tolerance_m if self.cam_tolerance is None else self.cam_tolerance.si


FirmwarePlanner = Annotated[
    GrblPlanner | MarlinPlanner | KlipperPlanner | RepRapPlanner | LinuxCncPlanner,
    Field(discriminator="kind"),
]


def check_by_axis(planner: FirmwarePlanner, axes: Collection[str], rotary: Collection[str]) -> None:
    """Check that a planner's values by axis name existing axes and have their units.

    Raises
    ------
    ValueError
        If an axis does not exist, or the unit is linear for a rotary axis or vice versa.
    """
    for key, unit in (("jump", "/s"), ("alone", "/s^2")):
        given: dict[str, Quantity] = getattr(planner, key, {})
        check_units_of_axes(given, f"planner.{key}", unit, axes, rotary)


def check_units_of_axes(
    given: Mapping[str, Quantity],
    key: str,
    unit: str,
    axes: Collection[str],
    rotary: Collection[str],
) -> None:
    """Check values by axis, whose unit is m or rad followed by ``unit``, as ``check_by_axis``."""
    check_known(given, axes, key, "axis")
    for name, value in given.items():
        own = f"{'rad' if name in rotary else 'm'}{unit}"
        if value.unit != own:
            raise ValueError(f"{key}.{name} is in {value.unit}, but the axis needs {own}")


FeedRule = Literal[
    "fastest-axis", "base-axes", "path", "cadfil", "linuxcnc", "rs274", "grbl", "fluidnc",
    "marlin", "fanuc",
]  # fmt: skip
"""Rules for the meaning of an F word; ``threadline.jobs.gcode.feeds`` defines each."""
DialectName = Literal["winder", "linuxcnc", "grbl", "fluidnc", "marlin", "fanuc", "x-winder"]
"""Dialects of part programs; ``threadline.jobs.gcode.dialects`` defines each."""

System = Annotated[str, Field(pattern=r"^G5[4-9]$")]
Offset = Annotated[Quantity, Units(("m", "rad"))]


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Programs:
    """How the controller of the machine reads part programs.

    ``feed_mode`` is the rule for the meaning of F, by default the dialect's rule. ``base_axes`` are
    the axes whose speed F gives under the rule ``base-axes``; other rules have none. ``offsets``
    are the origins of G54 to G59 in machine coordinates, by axis; a missing offset is 0.
    """

    dialect: DialectName = "winder"
    feed_mode: FeedRule | None = None
    base_axes: tuple[Annotated[str, Field(pattern=r"^[A-Z]$")], ...] = ()
    offsets: dict[System, dict[str, Offset]] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _base(self) -> Programs:
        if (self.feed_mode == "base-axes") != bool(self.base_axes):
            raise ValueError(
                'base_axes and feed_mode = "base-axes" need each other: CADFIL\'s mode 1 '
                'has base_axes = ["A"], mode 2 ["A", "X"]'
            )
        return self
