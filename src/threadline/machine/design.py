"""The ``[design]`` table of a machine file: which numbers a redesign may change.

Nothing but ``threadline design`` reads this table: it changes no motion and no simulation.
"""

from __future__ import annotations

import math
from typing import Annotated

from pydantic import Field, model_validator
from pydantic.dataclasses import dataclass

from threadline.machine.parts import STRICT
from threadline.machine.quantity import Quantity, Units
from threadline.units import parse_quantity

Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]*$")]
NumberPath = Annotated[
    str,
    Field(pattern=r"^(bodies|links|drives|sensors|controllers)(\.[A-Za-z][A-Za-z0-9_-]*){2,3}$"),
]
Factor = Annotated[float, Field(gt=0.0, lt=1e6, strict=True)]
MOST_MARGIN_DEG = 90.0
MOST_PARAMETERS = 8
MOST_TOLERANCES = 4
"""Most parameters with a tolerance, since all 2 to this power corners are simulated."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class DesignParameter:
    """Numbers of the machine that change together by one factor.

    Parameters
    ----------
    of
        Dotted names of the numbers in the file, such as ``"links.x_belt.stiffness"``.
    factor
        Least and largest factor on the values of the file; ``range`` can be given in its place.
    range
        Least and largest value with their units; the numbers must then be equal in the file.
    weight
        A change by a factor costs ``weight |ln factor|``.
    tolerance
        Share by which the numbers may differ from the design; with ``--corners`` it is
        simulated at both ends.
    note
        Text for people.
    """

    of: tuple[NumberPath, ...] = Field(min_length=1)
    factor: tuple[Factor, Factor] | None = None
    range: tuple[str, str] | None = None
    weight: Annotated[float, Field(ge=0.0, le=1e6, strict=True)] = 1.0
    tolerance: str | None = None
    note: str = ""

    @model_validator(mode="after")
    def _consistent(self) -> DesignParameter:
        if (self.factor is None) == (self.range is None):
            raise ValueError("a parameter has either factor = [1, 100] or range = [low, high]")
        if self.factor is not None and self.factor[0] > self.factor[1]:
            raise ValueError(f"factor runs from {self.factor[0]:g} to {self.factor[1]:g}")
        if not 0.0 <= self.spread < 1.0:
            raise ValueError(f"tolerance {self.tolerance!r} must be at least 0 % and below 100 %")
        return self

    @property
    def spread(self) -> float:
        """The tolerance as a number; 0 where there is none."""
        return 0.0 if self.tolerance is None else parse_quantity(self.tolerance, "")


Hertz = Annotated[Quantity, Units(("Hz",), positive=True)]
Degrees = Annotated[Quantity, Units(("rad",), positive=True)]
Share = Annotated[Quantity, Units(("",), positive=True, most=1.0)]
Seconds = Annotated[Quantity, Units(("s",), not_negative=True)]


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class DesignSettings:
    """Settings that a redesign may change at no cost, each with its least and largest value.

    Parameters
    ----------
    crossover, phase_margin
        Crossover and phase margin for which the lead filters of all axes are designed. Without them
        the gains stay as they are.
    acceleration
        Share of the machine's acceleration and jerk limits that the planner uses.
    needle_delay
        Time from the command of a stitch to its needle.
    """

    crossover: tuple[Hertz, Hertz] | None = None
    phase_margin: tuple[Degrees, Degrees] | None = None
    acceleration: tuple[Share, Share] | None = None
    needle_delay: tuple[Seconds, Seconds] | None = None

    @model_validator(mode="after")
    def _in_order(self) -> DesignSettings:
        if (self.crossover is None) != (self.phase_margin is None):
            given = "crossover" if self.phase_margin is None else "phase_margin"
            raise ValueError(f"{given}: crossover and phase_margin come together")
        for name in ("crossover", "phase_margin", "acceleration", "needle_delay"):
            pair = getattr(self, name)
            if pair is not None and pair[0].si > pair[1].si:
                raise ValueError(
                    f"{name}: it runs from {pair[0].si:g} to {pair[1].si:g} {pair[0].unit}"
                )
        if self.phase_margin is not None:
            most = math.degrees(self.phase_margin[1].si)
            if most > MOST_MARGIN_DEG * (1.0 + 1e-9):
                raise ValueError(
                    f"phase_margin: it reaches {most:g} deg, at most {MOST_MARGIN_DEG:g} deg"
                )
        return self


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class KnownDesign:
    """A design from elsewhere, which is plotted beside the one that was found.

    ``factors`` maps names of parameters to their factors; those that are left out have the factor
    1.
    """

    title: str
    factors: dict[Name, Factor] = Field(min_length=1)


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Design:
    """The ``[design]`` table."""

    parameters: dict[Name, DesignParameter] = Field(min_length=1, max_length=MOST_PARAMETERS)
    settings: DesignSettings = Field(default_factory=DesignSettings)
    known: dict[Name, KnownDesign] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _references(self) -> Design:
        taken: dict[str, str] = {}
        for name, parameter in self.parameters.items():
            for path in parameter.of:
                if path in taken:
                    raise ValueError(
                        f"parameters.{name}.of: {path} is in both {taken[path]!r} and {name!r}"
                    )
                taken[path] = name
        for title, known in self.known.items():
            for name in known.factors:
                if name not in self.parameters:
                    raise ValueError(
                        f"known.{title}.factors: {name!r} is no parameter; there are: "
                        f"{', '.join(self.parameters)}"
                    )
        loose = [name for name, parameter in self.parameters.items() if parameter.spread > 0]
        if len(loose) > MOST_TOLERANCES:
            raise ValueError(
                f"parameters.{loose[MOST_TOLERANCES]}.tolerance: {len(loose)} parameters have a "
                f"tolerance, at most {MOST_TOLERANCES}"
            )
        return self
