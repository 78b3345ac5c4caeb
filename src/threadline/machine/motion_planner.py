"""Settings of the controller: its motion planner, and its reading of part programs."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Annotated, Literal, get_args

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
AxisAcceleration = Annotated[Quantity, Units(("m/s^2", "rad/s^2"), positive=True)]
Ring = Annotated[Quantity, Units(("",), positive=True, whole=True, most=4096)]


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Planner:
    """Common keys of the motion planners of all firmwares."""

    left_out: list[str] = Field(default_factory=list)
    """Functions of the controller that plans leave out (bed mesh, skew correction, input shaper);
    every proof names them."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class GrblPlanner(Planner):
    """The planner of grbl and FluidNC: trapezoidal speed, cornering by junction deviation."""

    kind: Literal["grbl"]
    """grbl, or FluidNC, which has the same planner."""
    junction_deviation: Deviation
    """Distance between a corner and the circle that sets the speed through it: ``$11``."""
    blocks: Ring | None = None
    """Size of the ring buffer of planned blocks, one of which is always empty. Without it: 16."""

    @property
    def look_ahead(self) -> int:
        """Number of blocks planned together, including the block in execution."""
        return max(1, (_RING if self.blocks is None else round(self.blocks.si)) - 1)


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class MarlinPlanner(Planner):
    """Marlin's planner: trapezoidal speed, cornering by junction deviation or by speed jumps."""

    kind: Literal["marlin"]
    """Marlin."""
    junction_deviation: Deviation | None = None
    """``M205 J``. Without it: ``jump``."""
    corner_axes: StrictBool = False
    """Whether the acceleration of each axis also bounds the speed through a corner by
    ``junction_deviation``: ``true`` for Marlin up to 2.1.2, and for bugfix-2.1.x up to summer
    2025."""
    jump: dict[str, Jump] = Field(default_factory=dict)
    """Largest step of the speed of each axis at a corner, by letter (``M205 X Y Z``, "jerk").
    Without it: ``junction_deviation``."""
    acceleration: Acceleration | None = None
    """Acceleration limit of every move (``M204 T``), besides the limits of the axes."""
    least_speed: Speed | None = None
    """Lowest speed of a move (``M205 T``)."""
    short_time: Annotated[Quantity, Units(("s",), not_negative=True)] | None = None
    """Shortest time of a move while few moves are queued: a shorter move is slowed down (``M205
    B``). Without it: 20 ms."""
    blocks: Ring | None = None
    """Size of the ring buffer of planned blocks. Without it: 16."""

    @model_validator(mode="after")
    def _one_rule(self) -> MarlinPlanner:
        if (self.junction_deviation is None) != bool(self.jump):
            raise ValueError(
                "corner speed follows junction_deviation (M205 J) or jump (M205 X Y Z): give "
                "exactly one of them"
            )
        if self.corner_axes and self.jump:
            raise ValueError(
                "corner_axes belongs to junction_deviation (M205 J): remove it beside jump"
            )
        return self

    @property
    def look_ahead(self) -> int:
        """Number of blocks that are planned together, without the block in execution."""
        return max(1, (_RING if self.blocks is None else round(self.blocks.si)) - 2)


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class KlipperPlanner(Planner):
    """Klipper's planner: trapezoids with a minimum cruise, cornering by square corner velocity."""

    kind: Literal["klipper"]
    """Klipper."""
    velocity: Annotated[Quantity, Units(("m/s",), positive=True)]
    """``max_velocity``."""
    acceleration: Acceleration
    """``max_accel``."""
    square_corner_velocity: Speed
    """Speed through a corner of 90 degrees."""
    minimum_cruise_ratio: Annotated[Quantity, Units(("",), not_negative=True)] | None = None
    """Smallest share of a move's length at constant speed. Without it: 0.5."""
    jump: dict[str, Jump] = Field(default_factory=dict)
    """Largest step of the speed at a corner, for each axis other than X, Y and Z, by letter
    (``INSTANTANEOUS_CORNER_VELOCITY``). Without it: 1 mm/s, 1 deg/s."""
    alone: dict[str, AxisAcceleration] = Field(default_factory=dict)
    """Acceleration limit in moves without X, Y and Z, for each other axis, by letter (``accel`` of
    ``[manual_stepper]``). Without it: the acceleration of the axis."""

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
class RepRapPlanner(Planner):
    """RepRapFirmware's planner: trapezoidal speed, cornering by a speed jump of each axis."""

    kind: Literal["reprapfirmware"]
    """RepRapFirmware."""
    jump: Annotated[dict[str, Jump], Field(min_length=1)]
    """Largest step of the speed of each axis at a corner, by letter (``M566``, in mm/min there)."""
    policy: Annotated[Quantity, Units(("",), not_negative=True, whole=True, most=1)] | None = None
    """``M566 P``: with 0 the machine stops between a move with X or Y and a move of other axes,
    with 1 it does not. Without it: 0."""
    acceleration: Acceleration | None = None
    """Acceleration limit of moves with X or Y (``M204 T``), besides the limits of the axes."""
    blocks: Ring | None = None
    """Size of the ring buffer of planned moves: 60 on a Duet 3, 40 on a Duet 2. Without it: 60."""

    @property
    def joins_all(self) -> bool:
        """Whether moves with and without X or Y follow each other without a stop."""
        return self.policy is not None and self.policy.si == 1.0

    @property
    def look_ahead(self) -> int:
        """Number of blocks that are planned together, without the block in execution."""
        return max(1, (_DUET_RING if self.blocks is None else round(self.blocks.si)) - 2)


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class LinuxCncPlanner(Planner):
    """LinuxCNC's trajectory planner: arcs in corners, overlapping moves, 50 moves of look-ahead."""

    kind: Literal["linuxcnc"]
    """LinuxCNC."""
    tolerance: Deviation | None = None
    """P of ``G64 P``: largest deviation from the path. Without it: only the accelerations limit the
    rounding of corners, as after ``G64``."""
    cam_tolerance: Deviation | None = None
    """Q of ``G64 P Q``: successive moves of X, Y and Z that deviate less from one straight line
    become one move; 0 for none. Without it: ``tolerance``."""
    exact_stop: StrictBool = False
    """Whether every move ends at rest, unless the next move goes straight on, as after ``G61``."""

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
    """Check that values by axis name existing axes, in m or rad followed by ``unit``.

    Raises
    ------
    ValueError
        As for ``check_by_axis``; the message begins with ``key``.
    """
    check_known(given, axes, key, "axis")
    for name, value in given.items():
        expected = f"{'rad' if name in rotary else 'm'}{unit}"
        if value.unit != expected:
            raise ValueError(f"{key}.{name} is in {value.unit}, but the axis needs {expected}")


FeedRule = Literal[
    "fastest-axis", "base-axes", "path", "cadfil", "linuxcnc", "rs274", "grbl", "fluidnc",
    "marlin", "fanuc",
]  # fmt: skip
"""Rules for the meaning of an F word; ``threadline.jobs.gcode.feeds`` defines each."""
FEED_RULES: tuple[str, ...] = get_args(FeedRule)
"""Their names."""
DialectName = Literal[
    "winder", "linuxcnc", "grbl", "fluidnc", "marlin", "klipper", "reprapfirmware",
    "reprapfirmware-cnc", "fanuc", "x-winder",
]  # fmt: skip
"""Dialects of part programs; ``threadline.jobs.gcode.dialects`` defines each."""
DIALECT_NAMES: tuple[str, ...] = get_args(DialectName)
"""Their names, X-Winder's included."""

System = Annotated[str, Field(pattern=r"^G5[4-9]$")]
Offset = Annotated[Quantity, Units(("m", "rad"))]
ToolNumber = Annotated[str, Field(pattern=r"^H(0|[1-9][0-9]{0,5})$")]
ToolLength = Annotated[Quantity, Units(("m",))]


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Programs:
    """Settings with which the controller of the machine reads part programs."""

    dialect: DialectName = "winder"
    """Dialect: the meaning of the words of a program."""
    feed_mode: FeedRule | None = None
    """Rule that turns an F word into a speed. Without it: the rule of the dialect."""
    base_axes: tuple[Annotated[str, Field(pattern=r"^[A-Z]$")], ...] = ()
    """Axes whose joint speed F gives under the rule ``base-axes``: ``["A", "X"]``."""
    offsets: dict[System, dict[str, Offset]] = Field(default_factory=dict)
    """Origins of G54 to G59 in machine coordinates: ``G55 = { X = "120 mm exact, assumed" }``. The
    offset of an axis that is not named is 0."""
    lengths: dict[ToolNumber, ToolLength] = Field(default_factory=dict)
    """Lengths of the tools of ``G43 H``, as in the tool table of the control:
    ``H1 = "52.3 mm exact, measured: tool table"``."""

    @model_validator(mode="after")
    def _base(self) -> Programs:
        if (self.feed_mode == "base-axes") != bool(self.base_axes):
            raise ValueError(
                'base_axes and feed_mode = "base-axes" need each other: CADFIL\'s mode 1 '
                'has base_axes = ["A"], mode 2 ["A", "X"]'
            )
        return self
