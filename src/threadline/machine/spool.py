"""The spool of a winder's fibre with its brake, the spring arm after it, and the mandrel."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass as plain
from typing import Annotated

from pydantic import GetCoreSchemaHandler, model_validator
from pydantic.dataclasses import dataclass
from pydantic_core import CoreSchema, core_schema

from threadline.base.arrays import FloatArray
from threadline.machine.parts import STRICT, Axis
from threadline.machine.quantity import Quantity, Units
from threadline.machine.tool import Tool

STRANDS = 2.0
"""Number of strands that pull at the roller of the arm: the fibre wraps round it and goes back."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class SpringArm:
    """A spring-loaded arm with a roller, round which the fibre runs between spool and eye.

    All numbers refer to the roller, in the direction in which the fibre pulls it. An arm of length
    l, with inertia J and torsional stiffness k about its pivot, has the mass J / l^2 and the
    stiffness k / l^2 at the roller.
    """

    mass: Annotated[Quantity, Units(("kg",), positive=True)]
    """Mass of the arm at its roller."""
    stiffness: Annotated[Quantity, Units(("N/m",), positive=True)]
    """Stiffness of the spring at the roller."""
    preload: Annotated[Quantity, Units(("N",), not_negative=True)]
    """Force of the spring while the arm lies on its lower stop, without fibre."""
    travel: Annotated[Quantity, Units(("m",), positive=True)]
    """Distance of the roller between the two stops of the arm. The arm can take up twice this
    length of fibre."""
    damping: Annotated[Quantity, Units(("N*s/m",), not_negative=True)] | None = None
    """Viscous damping at the roller. Without it: 0."""
    release: Annotated[Quantity, Units(("N*m/m",), not_negative=True)] | None = None
    """Decrease of the brake torque per distance by which the fibre pulls the roller; the brake has
    its ``torque`` while the arm is in the middle of its travel. Without it: the arm does not act on
    the brake."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Spool:
    """A braked spool, the spring arm after it, and the fibre to the mandrel."""

    radius: Annotated[Quantity, Units(("m",), positive=True)]
    """Radius at which the fibre leaves the spool; the tolerance covers the range from a full to an
    empty spool."""
    inertia: Annotated[Quantity, Units(("kg*m^2",), positive=True)]
    """Inertia of the spool with its fibre and of everything that turns with it."""
    torque: Annotated[Quantity, Units(("N*m",), positive=True)]
    """Torque of the brake while the spool turns."""
    stiction: Annotated[Quantity, Units(("N*m",), positive=True)] | None = None
    """Breakaway torque of the brake. Without it: ``torque``."""
    most_torque: Annotated[Quantity, Units(("N*m",), positive=True)] | None = None
    """Largest torque that the brake can be set to during winding. With this key the brake follows
    the tension that the job asks for, layer by layer. Without it: the brake keeps ``torque``."""
    friction: Annotated[Quantity, Units(("",), not_negative=True)] | None = None
    """Share by which rollers, bath and guides raise the tension between arm and eye. Without it:
    0."""
    stiffness: Annotated[Quantity, Units(("N/m",), positive=True)]
    """Stiffness of the fibre between spool and mandrel: modulus times section / length."""
    damping: Annotated[Quantity, Units(("N*s/m",), not_negative=True)] | None = None
    """Viscous damping of the fibre between spool and mandrel. Without it: 0."""
    arm: SpringArm
    """The spring arm."""

    @model_validator(mode="after")
    def _consistent(self) -> Spool:
        if self.stiction is not None and self.stiction.si < self.torque.si:
            raise ValueError(
                f"stiction, {self.stiction.si:g} N m, is below torque, {self.torque.si:g} N m: "
                "raise it, or leave it out"
            )
        if self.most_torque is not None and self.most_torque.si < self.torque.si:
            raise ValueError(
                f"most_torque, {self.most_torque.si:g} N m, is below torque, "
                f"{self.torque.si:g} N m: raise it, or leave it out"
            )
        return self

    @property
    def tension_n(self) -> float:
        """Tension between eye and mandrel at a constant speed of the fibre, N.

        The arm is in balance at ``2 T = preload + stiffness y`` and the brake at ``T r = torque -
        release (y - travel / 2)``, where y is the distance of the roller from its lower stop and T
        the tension at the spool. The guides raise T by the share ``friction``.
        """
        arm, r = self.arm, self.radius.si
        release = 0.0 if arm.release is None else arm.release.si
        torque = self.torque.si + release * 0.5 * arm.travel.si
        k = arm.stiffness.si
        balance_m = (STRANDS * torque / r - arm.preload.si) / (k + STRANDS * release / r)
        roller_m = min(max(balance_m, 0.0), arm.travel.si)
        share = 0.0 if self.friction is None else self.friction.si
        return (1.0 + share) * max(torque - release * roller_m, 0.0) / r

    @property
    def take_up_m(self) -> float:
        """Length of fibre that the arm can take up before it reaches its lower stop, m.

        The arm begins at its position at a constant speed of the fibre.
        """
        return STRANDS * self._way_m(self.tension_n)

    def take_up_at(self, tension_n: float) -> float:
        """Return ``take_up_m`` for a brake that is set to a tension between eye and mandrel, m."""
        return STRANDS * self._way_m(tension_n)

    def torque_for(self, tension_n: float) -> float:
        """Return the ``torque`` of the brake that gives a tension between eye and mandrel, N m.

        This is the inverse of ``tension_n``. The result is 0 or below if the arm would release the
        brake too much.
        """
        share = 0.0 if self.friction is None else self.friction.si
        release = 0.0 if self.arm.release is None else self.arm.release.si
        pull = tension_n / (1.0 + share)
        return pull * self.radius.si + release * (self._way_m(tension_n) - 0.5 * self._travel_m)

    @property
    def floats_n(self) -> tuple[float, float]:
        """Lowest and highest tension between eye and mandrel, N, with the arm off its stops."""
        arm, share = self.arm, 0.0 if self.friction is None else self.friction.si
        low, high = arm.preload.si, arm.preload.si + arm.stiffness.si * arm.travel.si
        return (1.0 + share) * low / STRANDS, (1.0 + share) * high / STRANDS

    @property
    def _travel_m(self) -> float:
        return self.arm.travel.si

    def _way_m(self, tension_n: float) -> float:
        """Return the roller's distance from its lower stop, m, at a tension after the eye, N."""
        share = 0.0 if self.friction is None else self.friction.si
        force = STRANDS * tension_n / (1.0 + share) - self.arm.preload.si
        return min(max(force / self.arm.stiffness.si, 0.0), self._travel_m)


@plain(frozen=True, slots=True, eq=False)
class Mounted:
    """The mandrel on a winder, for the twin; no machine file has it.

    Parameters
    ----------
    nodes, x, r
        The meridian, as in ``winding.surface.Surface``.
    convex
        Whether the mandrel is convex: no straight line touches it in two places.
    at_m
        Position of the mandrel's left end along the machine.
    slip
        Share by which the mandrel turns less than the axis that turns it.
    friction
        Coefficient of friction between fibre and mandrel.
    tied_m
        Position along the meridian where the fibre is tied; None if unknown.
    leads
        Length of fibre per change of each coordinate of the eye (m per m or rad, in the order of
        ``EYE_PARTS``) at the beginning of the winding: the fibre is tied in this direction, under
        tension. None if unknown: the fibre is tied slack.
    brakes
        (operation, factor) pairs, in increasing order of the operations of the job: from this
        operation on the torque of the brake is ``torque`` times the factor. The first factor also
        holds before its operation. Empty: the brake keeps its ``torque``.
    """

    nodes: FloatArray
    x: FloatArray
    r: FloatArray
    convex: bool
    at_m: float
    slip: float
    friction: float
    tied_m: float | None
    leads: tuple[float, ...] | None = None
    brakes: tuple[tuple[int, float], ...] = ()

    @classmethod
    def __get_pydantic_core_schema__(
        cls, source: type[Mounted], handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        """Return the schema of a field that no file sets."""
        return core_schema.any_schema()


def check_spool(spool: Spool | None, tool: Tool | None, axes: Mapping[str, Axis]) -> None:
    """Check that a machine with a spool has an eye, and that all its axes have control loops.

    Raises
    ------
    ValueError
        If one of these is missing; the message begins with the key.
    """
    if spool is None:
        return
    if tool is None or tool.kind != "eye":
        raise ValueError(
            'spool: its fibre needs the eye of a winder: write [tool] kind = "eye", turn, along '
            "and across, or remove the spool"
        )
    for name, axis in axes.items():
        if axis.drive:
            raise ValueError(
                f"spool: the tension is simulated on axes with control loops, and axes.{name} has "
                f"the drive {axis.drive!r}, which takes positions: remove the spool"
            )
