"""The tool of a machine: a radius at which rotary axes act, or the eye of a winder."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Annotated, Literal

from pydantic import StrictBool, model_validator
from pydantic.dataclasses import dataclass

from threadline.machine.parts import STRICT, Axis, Position, check_known
from threadline.machine.quantity import Quantity, Units


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class EyeAxis:
    """An axis that moves the eye or turns the mandrel.

    The eye's coordinate is ``zero`` plus the position of the axis; minus it with ``reverse``.
    """

    axis: str
    reverse: StrictBool = False
    zero: Position | None = None

    @property
    def factor(self) -> float:
        """1, or -1 for a reversed axis."""
        return -1.0 if self.reverse else 1.0

    @property
    def zero_si(self) -> float:
        """Coordinate of the eye where the axis is at 0, m or rad."""
        return 0.0 if self.zero is None else self.zero.si


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Payout:
    """Pay-out point of the fibre from the eye's carrier, at yaw and roll 0."""

    along: Annotated[Quantity, Units(("m",))]
    across: Annotated[Quantity, Units(("m",))]
    up: Annotated[Quantity, Units(("m",))]


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Roller:
    """The roller over which the fibre leaves the eye; ``payout`` is its centre.

    Its axis is along the mandrel or up at yaw and roll 0. The fibre passes it on the plus side,
    which is up for an axis along the mandrel and along the mandrel for an upright axis, or on the
    minus side.
    """

    radius: Annotated[Quantity, Units(("m",))]
    axis: Literal["along", "up"]
    side: Literal["+", "-"] = "+"

    @model_validator(mode="after")
    def _no_hole(self) -> Roller:
        if self.radius.si < 0.0:
            raise ValueError("radius of the roller must be 0, a plain eye, or above")
        return self


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Arm:
    """The arm of an eye: a round rod that goes across, away from the mandrel."""

    radius: Annotated[Quantity, Units(("m",), positive=True)]
    length: Annotated[Quantity, Units(("m",), positive=True)]


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class EndStop:
    """Chuck or tailstock: a cylinder about the axis; ``at`` is the face towards the mandrel."""

    at: Annotated[Quantity, Units(("m",))]
    radius: Annotated[Quantity, Units(("m",), positive=True)]
    length: Annotated[Quantity, Units(("m",), positive=True)]


_TURNS = ("turn", "yaw", "roll")
EYE_PARTS = ("turn", "along", "across", "up", "yaw", "roll")
"""Coordinates of an eye, in the order of all arrays."""
EYE_BODY = ("payout", "roller", "body", "arm", "chuck", "tailstock")
"""Keys of an eye that name no axis."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Tool:
    """The tool; ``radius`` is the distance at which rotary axes act on the work.

    ``kind = "eye"`` is the eye of a winder. ``turn`` names the axis that turns the mandrel;
    ``along`` moves the eye along the mandrel, ``across`` away from its axis and ``up``. ``yaw``
    turns the eye about the upright from along to across, ``roll`` about the direction across from
    up to along. A missing coordinate is 0. ``payout`` is the point where the fibre leaves the eye,
    or the centre of its ``roller``. ``body`` is the radius of the eye about that point; ``arm``,
    ``chuck`` and ``tailstock`` are what it may run into.
    """

    kind: Literal["radius", "eye"] = "radius"
    radius: Annotated[Quantity, Units(("m",), positive=True)]
    turn: EyeAxis | None = None
    along: EyeAxis | None = None
    across: EyeAxis | None = None
    up: EyeAxis | None = None
    yaw: EyeAxis | None = None
    roll: EyeAxis | None = None
    payout: Payout | None = None
    roller: Roller | None = None
    body: Annotated[Quantity, Units(("m",), positive=True)] | None = None
    arm: Arm | None = None
    chuck: EndStop | None = None
    tailstock: EndStop | None = None

    @model_validator(mode="after")
    def _of_its_kind(self) -> Tool:
        if self.kind == "radius":
            for name in (*EYE_PARTS, *EYE_BODY):
                if getattr(self, name) is not None:
                    raise ValueError(f'{name} belongs to an eye: write kind = "eye", or remove it')
            return self
        for name in ("turn", "along"):
            if getattr(self, name) is None:
                raise ValueError(f'an eye needs {name}, like {name} = {{ axis = "A" }}')
        if self.across is None and self.payout is None:
            raise ValueError('an eye needs across, like across = { axis = "Y" }, or a payout')
        for name, part in zip(EYE_PARTS, self.parts, strict=True):
            wanted = "rad" if name in _TURNS else "m"
            if part is not None and part.zero is not None and part.zero.unit != wanted:
                raise ValueError(f"{name}.zero is in {wanted}, not {part.zero.unit}")
        return self

    @property
    def parts(self) -> tuple[EyeAxis | None, ...]:
        """The axes of ``EYE_PARTS``."""
        return self.turn, self.along, self.across, self.up, self.yaw, self.roll

    @property
    def payout_m(self) -> tuple[float, float, float]:
        """Pay-out point along, across and up from the eye's carrier."""
        point = self.payout
        return (0.0, 0.0, 0.0) if point is None else (point.along.si, point.across.si, point.up.si)

    @property
    def roller_m(self) -> tuple[float, float, float, float]:
        """Axis of the roller along, across and up, and its radius, m.

        The radius is negative where the fibre passes on the minus side, and 0 for a plain eye.
        """
        roller = self.roller
        if roller is None:
            return 1.0, 0.0, 0.0, 0.0
        # Axis x across is up for an axis along the mandrel, and against along for an upright one.
        plus = (roller.side == "+") == (roller.axis == "along")
        size = roller.radius.si if plus else -roller.radius.si
        return (1.0, 0.0, 0.0, size) if roller.axis == "along" else (0.0, 0.0, 1.0, size)

    @property
    def body_m(self) -> float:
        """Radius of the eye about its pay-out point, at least the radius of its roller."""
        own = 0.0 if self.body is None else self.body.si
        return max(own, abs(self.roller_m[3]))

    @property
    def arm_m(self) -> tuple[float, float]:
        """Radius and length of the arm; 0 without one."""
        return (0.0, 0.0) if self.arm is None else (self.arm.radius.si, self.arm.length.si)


def eye_within(tool: Tool | None, axes: Iterable[str]) -> Tool | None:
    """Return the tool of a machine with some axes alone: without all its axes it is no eye."""
    known = set(axes)
    if tool is None or all(part is None or part.axis in known for part in tool.parts):
        return tool
    return Tool(radius=tool.radius)


def check_eye(tool: Tool | None, axes: Mapping[str, Axis]) -> None:
    """Check that the axes of an eye exist and are of the right kind.

    Raises
    ------
    ValueError
        If one is missing, rotary instead of linear, or used twice; begins with the key.
    """
    if tool is None:
        return
    used: dict[str, str] = {}
    for name, part in zip(EYE_PARTS, tool.parts, strict=True):
        if part is None:
            continue
        at = f"tool.{name}.axis"
        check_known([part.axis], axes, at, "axis")
        kind = "rotary" if name in _TURNS else "linear"
        if axes[part.axis].kind != kind:
            raise ValueError(f"{at}: {part.axis} is a {axes[part.axis].kind} axis, not {kind}")
        if part.axis in used:
            raise ValueError(f"{at}: {part.axis} is the axis of {used[part.axis]} already")
        used[part.axis] = name
