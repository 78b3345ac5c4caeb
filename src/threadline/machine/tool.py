"""The tool, a winder's eye, limits along the tool's path, and the limits of axes as arrays."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence, Sized
from typing import Annotated, Literal

import numpy as np
from pydantic import StrictBool, model_validator
from pydantic.dataclasses import dataclass

from threadline.base.arrays import FloatArray
from threadline.machine.mandrel import LocalRadii, local_radii
from threadline.machine.parts import STRICT, Axis, Position, check_known
from threadline.machine.quantity import Quantity, Units


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class EyeAxis:
    """An axis that moves the eye or turns the mandrel.

    The coordinate of the eye is ``zero`` plus the position of the axis; with ``reverse`` it is
    ``zero`` minus the position.
    """

    axis: str
    """Name of the axis of the machine."""
    reverse: StrictBool = False
    """Whether the eye moves in the negative direction when the axis moves in the positive."""
    zero: Position | None = None
    """Coordinate of the eye when the axis is at 0. Without it: 0."""

    @property
    def factor(self) -> float:
        """1, or -1 for a reversed axis."""
        return -1.0 if self.reverse else 1.0

    @property
    def zero_si(self) -> float:
        """Coordinate of the eye when the axis is at 0, m or rad."""
        return 0.0 if self.zero is None else self.zero.si


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Payout:
    """Pay-out point of the fibre relative to the eye's carrier, at yaw and roll 0."""

    along: Annotated[Quantity, Units(("m",))]
    """Distance from the eye's carrier along the mandrel."""
    across: Annotated[Quantity, Units(("m",))]
    """Distance from the eye's carrier in the direction away from the mandrel's axis."""
    up: Annotated[Quantity, Units(("m",))]
    """Distance from the eye's carrier upwards."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Roller:
    """The roller over which the fibre leaves the eye.

    The fibre runs in the middle of the roller. The point where it leaves moves round the roller as
    the direction of the fibre changes.
    """

    radius: Annotated[Quantity, Units(("m",))]
    """Radius of the roller; 0 is a plain eye."""
    axis: Literal["along", "up"]
    """Direction of the roller's axis at yaw and roll 0."""
    side: Literal["+", "-"] = "+"
    """Side of the roller on which the fibre passes: ``+`` is the upper side for a roller axis along
    the mandrel, and the side in the direction along for an upright roller axis."""

    @model_validator(mode="after")
    def _no_hole(self) -> Roller:
        if self.radius.si < 0.0:
            raise ValueError("radius of the roller must be 0, a plain eye, or above")
        return self


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Arm:
    """The arm of an eye: a round rod in the direction across, away from the mandrel."""

    radius: Annotated[Quantity, Units(("m",), positive=True)]
    """Radius of the rod."""
    length: Annotated[Quantity, Units(("m",), positive=True)]
    """Length of the rod from the pay-out point."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class EndStop:
    """Chuck or tailstock: a cylinder about the mandrel's axis, from its face outwards."""

    at: Annotated[Quantity, Units(("m",))]
    """Position along the machine of the face that points to the mandrel."""
    radius: Annotated[Quantity, Units(("m",), positive=True)]
    """Radius of the cylinder."""
    length: Annotated[Quantity, Units(("m",), positive=True)]
    """Length of the cylinder."""


_TURNS = ("turn", "yaw", "roll")
EYE_PARTS = ("turn", "along", "across", "up", "yaw", "roll")
"""Coordinates of an eye, in the order of all arrays."""
EYE_BODY = ("payout", "roller", "body", "arm", "chuck", "tailstock")
"""Keys of an eye that are not axes."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Tool:
    """The tool, or with ``kind = "eye"`` the eye of a winder.

    Along, across and up are right-handed, with the origin on the axis of the mandrel.
    """

    kind: Literal["radius", "eye"] = "radius"
    """``radius``, or ``eye`` for a winder whose fibre is [replayed](winding.md)."""
    radius: Annotated[Quantity, Units(("m",), positive=True)]
    """Radius at which rotary axes without a radius of their own act: an angle times this radius is
    a length at the tool, for feeds and for errors."""
    turn: EyeAxis | None = None
    """For an eye: the axis that turns the mandrel. Without it: no eye."""
    along: EyeAxis | None = None
    """For an eye: the axis that moves the eye along the mandrel. Without it: no eye."""
    across: EyeAxis | None = None
    """The axis that moves the eye away from the mandrel's axis. Without it: ``payout``."""
    up: EyeAxis | None = None
    """The axis that lifts the eye. Without it: 0."""
    yaw: EyeAxis | None = None
    """The axis that turns the eye about the upright direction, from along to across. Without it:
    0."""
    roll: EyeAxis | None = None
    """The axis that turns the eye about the direction across, from up to along. Without it: 0."""
    payout: Payout | None = None
    """Point where the fibre leaves the eye, or centre of the eye's roller, relative to the carrier
    at yaw and roll 0. Without it: the carrier."""
    roller: Roller | None = None
    """The roller over which the fibre leaves the eye. Without it: a plain eye."""
    body: Annotated[Quantity, Units(("m",), positive=True)] | None = None
    """Radius of the eye about its pay-out point. Without it: the roller's."""
    arm: Arm | None = None
    """The arm that holds the eye. Without it: none."""
    chuck: EndStop | None = None
    """The chuck that turns the mandrel's shaft, on the left. Without it: none."""
    tailstock: EndStop | None = None
    """The tailstock that holds the shaft on the right. Without it: none."""

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
            unit = "rad" if name in _TURNS else "m"
            if part is not None and part.zero is not None and part.zero.unit != unit:
                raise ValueError(f"{name}.zero is in {unit}, not {part.zero.unit}")
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
        """Direction of the roller's axis (along, across, up), and radius of the roller, m.

        The radius is negative if the fibre passes on the minus side, and 0 for a plain eye.
        """
        roller = self.roller
        if roller is None:
            return 1.0, 0.0, 0.0, 0.0
        # Axis x across is up for an axis along the mandrel, and against along for an upright one.
        on_plus_side = (roller.side == "+") == (roller.axis == "along")
        signed_radius_m = roller.radius.si if on_plus_side else -roller.radius.si
        return (
            (1.0, 0.0, 0.0, signed_radius_m)
            if roller.axis == "along"
            else (0.0, 0.0, 1.0, signed_radius_m)
        )

    @property
    def body_m(self) -> float:
        """Radius of the eye about its pay-out point, at least the radius of its roller."""
        own_radius_m = 0.0 if self.body is None else self.body.si
        return max(own_radius_m, abs(self.roller_m[3]))

    @property
    def arm_m(self) -> tuple[float, float]:
        """Radius and length of the arm; 0 without one."""
        return (0.0, 0.0) if self.arm is None else (self.arm.radius.si, self.arm.length.si)


def eye_within(tool: Tool | None, axes: Iterable[str]) -> Tool | None:
    """Return the tool of a machine that keeps only ``axes``.

    An eye that lacks one of its axes becomes a plain radius.
    """
    known = set(axes)
    if tool is None or all(part is None or part.axis in known for part in tool.parts):
        return tool
    return Tool(radius=tool.radius)


def check_eye(tool: Tool | None, axes: Mapping[str, Axis]) -> None:
    """Check that the axes of an eye exist and are of the right kind.

    Raises
    ------
    ValueError
        If an axis is missing, used twice, or linear instead of rotary or vice versa; the message
        begins with the key.
    """
    if tool is None:
        return
    used: dict[str, str] = {}
    for name, part in zip(EYE_PARTS, tool.parts, strict=True):
        if part is None:
            continue
        key = f"tool.{name}.axis"
        check_known([part.axis], axes, key, "axis")
        kind = "rotary" if name in _TURNS else "linear"
        if axes[part.axis].kind != kind:
            raise ValueError(f"{key}: {part.axis} is a {axes[part.axis].kind} axis, not {kind}")
        if part.axis in used:
            raise ValueError(f"{key}: {part.axis} is the axis of {used[part.axis]} already")
        used[part.axis] = name


def check_radii(axes: Mapping[str, Axis], tool: Tool | None) -> None:
    """Check that every rotary axis has a radius, and every profile a linear axis.

    Raises
    ------
    ValueError
        If an axis has neither; names the axis.
    """
    rotary = sorted(name for name, axis in axes.items() if axis.kind == "rotary")
    for name in rotary:
        axis = axes[name]
        if axis.profile is not None:
            along = axis.profile.along
            check_known([along], axes, f"axes.{name}.profile.along", "axis")
            if along in rotary:
                raise ValueError(
                    f"axes.{name}.profile is along {along}, a rotary axis; name a linear axis"
                )
        elif axis.radius is None and tool is None:
            raise ValueError(
                f"'tool' is missing: it gives the radius of the rotary axis {name}, like "
                '[tool] radius = "100 mm exact, assumed"; or give the axis a radius'
            )


def acts_at_m(axis: Axis, tool: Tool | None) -> float:
    """Return 1 for a linear axis; for a rotary axis its (largest) radius in m."""
    if axis.kind == "linear":
        return 1.0
    if axis.profile is not None:
        return axis.profile.largest_m
    if axis.radius is not None:
        return axis.radius.si
    # ``check_radii`` ensures a tool if a rotary axis has no radius.
    return 1.0 if tool is None else tool.radius.si


_Acceleration = Annotated[Quantity, Units(("m/s^2",), positive=True)]


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class PathLimits:
    """Limits of the tool's motion along its path, with rotary axes at their radii."""

    velocity: Annotated[Quantity, Units(("m/s",), positive=True)] | None = None
    """Limit of the tool's speed."""
    acceleration: _Acceleration | None = None
    """Limit of the tool's acceleration along the path."""
    deceleration: _Acceleration | None = None
    """Limit of braking along the path. Without it: ``acceleration``."""
    jerk: Annotated[Quantity, Units(("m/s^3",), positive=True)] | None = None
    """Limit of the tool's jerk along the path."""
    centripetal: _Acceleration | None = None
    """Limit of the tool's acceleration across the path."""

    @property
    def asks_for_rests(self) -> bool:
        """Whether the tool must stop where its path turns back, because its speed has a kink there.

        It must if the acceleration or the jerk along the path is limited.
        """
        return self.acceleration is not None or self.jerk is not None

    @model_validator(mode="after")
    def _consistent(self) -> PathLimits:
        if self.deceleration is not None and self.acceleration is None:
            raise ValueError("a deceleration along the path needs an acceleration: give both")
        if not any((self.velocity, self.acceleration, self.jerk, self.centripetal)):
            raise ValueError(
                "a [path] without limits: give velocity, acceleration, jerk or centripetal, or "
                "remove the table"
            )
        return self


def check_path_limits(
    path: PathLimits | None, axes: Mapping[str, Axis], cylinders: Sized, tables: object
) -> None:
    """Refuse path limits on machines that follow no path; ``ValueError`` begins with the key."""
    if path is not None and not axes:
        raise ValueError(
            "path: limits along the path need [axes.X]; cylinders are switched: remove it"
        )
    if path is not None and cylinders:
        raise ValueError(
            "path: limits along the path have no meaning for [cylinders.X], which are switched "
            "and follow no path: remove it"
        )
    if tables is None:
        return
    if path is not None:
        raise ValueError(
            "path: step tables move each axis separately between two stitches, along no path: "
            "remove it"
        )
    for name, axis in axes.items():
        if axis.deceleration is not None:
            raise ValueError(
                f"axes.{name}.deceleration: the laws of step tables brake as they speed up: "
                "remove it"
            )


class AxisArrays:
    """Arrays over the axes of a machine."""

    __slots__ = ()
    axes: dict[str, Axis]
    path: PathLimits | None
    tool: Tool | None

    def _column(self, field: Literal["counts", "velocity", "acceleration"]) -> FloatArray:
        return np.array([getattr(axis, field).si for axis in self.axes.values()])

    @property
    def counts_per_unit(self) -> FloatArray:
        """(axes,) counts per m or rad."""
        return self._column("counts")

    @property
    def velocity_limit(self) -> FloatArray:
        """(axes,) m/s or rad/s."""
        return self._column("velocity")

    @property
    def acceleration_limit(self) -> FloatArray:
        """(axes,) m/s^2 or rad/s^2: the lower of the limits of speeding up and braking."""
        return np.minimum(*self.accelerations)

    @property
    def accelerations(self) -> tuple[FloatArray, FloatArray]:
        """(axes,) m/s^2 or rad/s^2: the limits of speeding up, and of braking."""
        braking_limits = [axis.deceleration or axis.acceleration for axis in self.axes.values()]
        return self._column("acceleration"), np.array([limit.si for limit in braking_limits])

    def least_acceleration(self, axes: Sequence[str]) -> float:
        """Return the lowest acceleration or deceleration limit of ``axes`` and the path, m/s^2."""
        columns = [list(self.axes).index(axis) for axis in axes]
        path_limits = [] if self.path is None else [self.path.acceleration, self.path.deceleration]
        path_limits_m_s2 = [limit.si for limit in path_limits if limit is not None]
        return min([float(self.acceleration_limit[columns].min()), *path_limits_m_s2])

    @property
    def jerk_limit(self) -> FloatArray:
        """(axes,) m/s^3 or rad/s^3; infinite if the file gives none."""
        return np.array(
            [np.inf if axis.jerk is None else axis.jerk.si for axis in self.axes.values()]
        )

    @property
    def travel(self) -> FloatArray:
        """(axes, 2) lowest and highest position, m or rad; infinite for an endless axis."""
        return np.array(
            [
                (-np.inf, np.inf) if axis.travel is None else [end.si for end in axis.travel]
                for axis in self.axes.values()
            ]
        )

    @property
    def radius_m(self) -> FloatArray:
        """(axes,) 1 for a linear axis; for a rotary axis its radius, else the tool's, in m.

        With a profile it is the largest radius.
        """
        return np.array([acts_at_m(axis, self.tool) for axis in self.axes.values()])

    def local_radii(self, axes: Sequence[str]) -> LocalRadii | None:
        """Return the local radii as shares of the largest radii, for a path of ``axes``."""
        profiles = {
            name: axis.profile for name, axis in self.axes.items() if axis.profile is not None
        }
        return local_radii(profiles, axes)
