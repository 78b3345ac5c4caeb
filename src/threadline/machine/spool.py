"""The spool of a winder's fibre: its brake, the spring arm behind it, and the mandrel it feeds."""

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
"""Strands of fibre that pull at the roller of the arm: the fibre turns round it and goes back."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class SpringArm:
    """A spring-loaded arm whose roller the fibre passes on its way from the spool to the eye.

    All numbers are at the roller, along the way on which the fibre pulls it. An arm with inertia J
    about its pivot and length l has the mass J / l^2 and the stiffness k / l^2.
    """

    mass: Annotated[Quantity, Units(("kg",), positive=True)]
    """Mass of the arm at its roller."""
    stiffness: Annotated[Quantity, Units(("N/m",), positive=True)]
    """Stiffness of the spring at the roller."""
    preload: Annotated[Quantity, Units(("N",), not_negative=True)]
    """Force of the spring where the arm lies on its lower stop, without fibre."""
    travel: Annotated[Quantity, Units(("m",), positive=True)]
    """Distance between the two stops of the roller. The arm takes up twice that length of fibre."""
    damping: Annotated[Quantity, Units(("N*s/m",), not_negative=True)] | None = None
    """Viscous damping at the roller. Without it: 0."""
    release: Annotated[Quantity, Units(("N*m/m",), not_negative=True)] | None = None
    """Torque that the brake loses per distance that the fibre pulls the roller; the brake has
    its ``torque`` with the arm in the middle of its travel. Without it: the arm leaves the brake
    alone."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Spool:
    """A braked spool, the spring arm behind it, and the fibre from there to the mandrel."""

    radius: Annotated[Quantity, Units(("m",), positive=True)]
    """Radius at which the fibre leaves the spool; its tolerance covers a spool from full to
    empty."""
    inertia: Annotated[Quantity, Units(("kg*m^2",), positive=True)]
    """Inertia of the spool with its fibre and of everything that turns with it."""
    torque: Annotated[Quantity, Units(("N*m",), positive=True)]
    """Torque of the brake while the spool turns."""
    stiction: Annotated[Quantity, Units(("N*m",), positive=True)] | None = None
    """Torque that sets the spool in motion. Without it: ``torque``."""
    most_torque: Annotated[Quantity, Units(("N*m",), positive=True)] | None = None
    """Largest torque that the brake can be set to while the machine winds: with it the brake
    follows the tension that the job asks for, layer by layer. Without it: the brake keeps
    ``torque``."""
    friction: Annotated[Quantity, Units(("",), not_negative=True)] | None = None
    """Share by which rollers, bath and guides raise the tension between arm and eye. Without it:
    0."""
    stiffness: Annotated[Quantity, Units(("N/m",), positive=True)]
    """Stiffness of the fibre between spool and mandrel: modulus times section over length."""
    damping: Annotated[Quantity, Units(("N*s/m",), not_negative=True)] | None = None
    """Viscous damping of that fibre. Without it: 0."""
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
        """Tension behind the eye at a constant speed of the fibre, N.

        The arm balances ``2 T = preload + stiffness y``, and the brake ``T r = torque - release (y
        - travel / 2)``, where y is the distance of the roller from its lower stop.
        """
        arm, r = self.arm, self.radius.si
        release = 0.0 if arm.release is None else arm.release.si
        torque = self.torque.si + release * 0.5 * arm.travel.si
        k = arm.stiffness.si
        stands = (STRANDS * torque / r - arm.preload.si) / (k + STRANDS * release / r)
        way = min(max(stands, 0.0), arm.travel.si)
        share = 0.0 if self.friction is None else self.friction.si
        return (1.0 + share) * max(torque - release * way, 0.0) / r

    @property
    def take_up_m(self) -> float:
        """Fibre that the arm takes back from its place at a constant speed to its lower stop, m."""
        return STRANDS * self._way_m(self.tension_n)

    def take_up_at(self, tension_n: float) -> float:
        """Return ``take_up_m`` with the brake set to a tension behind the eye, m."""
        return STRANDS * self._way_m(tension_n)

    def torque_for(self, tension_n: float) -> float:
        """Return the ``torque`` of the brake that gives a tension behind the eye, N m.

        It is the inverse of ``tension_n``; 0 or below where the arm loosens the brake too much.
        """
        share = 0.0 if self.friction is None else self.friction.si
        release = 0.0 if self.arm.release is None else self.arm.release.si
        pull = tension_n / (1.0 + share)
        return pull * self.radius.si + release * (self._way_m(tension_n) - 0.5 * self._travel_m)

    @property
    def floats_n(self) -> tuple[float, float]:
        """Tensions behind the eye between which the arm is off its stops, N."""
        arm, share = self.arm, 0.0 if self.friction is None else self.friction.si
        low, high = arm.preload.si, arm.preload.si + arm.stiffness.si * arm.travel.si
        return (1.0 + share) * low / STRANDS, (1.0 + share) * high / STRANDS

    @property
    def _travel_m(self) -> float:
        return self.arm.travel.si

    def _way_m(self, tension_n: float) -> float:
        """Return the distance of the roller from its lower stop at a tension behind the eye."""
        share = 0.0 if self.friction is None else self.friction.si
        force = STRANDS * tension_n / (1.0 + share) - self.arm.preload.si
        return min(max(force / self.arm.stiffness.si, 0.0), self._travel_m)


@plain(frozen=True, slots=True, eq=False)
class Mounted:
    """The mandrel on a winder, for the twin; no machine file has it.

    Parameters
    ----------
    nodes, x, r
        The meridian, as ``winding.surface.Surface``.
    convex
        Whether no straight line touches it in two places.
    at_m
        Machine place of its left end.
    slip
        Share by which it stays behind the axis that turns it.
    friction
        Coefficient of friction between fibre and mandrel.
    tied_m
        Place along the meridian where the fibre is tied; None if unknown.
    leads
        Fibre per change of each coordinate of the eye (m per m or rad, in the order of
        ``EYE_PARTS``) where the winding begins: the fibre is tied in this direction, under tension.
        None if unknown: it is tied slack.
    brakes
        Operations of the job, increasing, from which on the brake of the spool has another torque,
        and the factor on its ``torque`` from there on; the first holds before them, too. Empty:
        the brake keeps its ``torque``.
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
    """Check that the machine of a spool has an eye, moved by control loops, that lays its fibre.

    Raises
    ------
    ValueError
        If it has none; begins with the key.
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
