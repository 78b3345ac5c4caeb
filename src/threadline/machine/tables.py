"""The tables ``[design]`` and ``[tolerances]``: numbers that may be redesigned, and that vary.

Only ``threadline design`` reads ``[design]``; it does not affect motions or simulations.

``+-`` is the half width of a number's interval. Unless ``[tolerances]`` says otherwise, numbers are
independent and uniformly distributed over their intervals.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from fnmatch import fnmatchcase
from typing import Annotated, Any

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
"""Largest number n of parameters with a tolerance: all 2^n corners are simulated."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class DesignParameter:
    """Numbers of the machine that are multiplied by a common factor."""

    of: tuple[NumberPath, ...] = Field(min_length=1)
    """Numbers that change together: ``["links.x_belt.stiffness"]``."""
    factor: tuple[Factor, Factor] | None = None
    """Smallest and largest factor on the numbers: ``[1, 100]``. Without it: ``range``."""
    range: tuple[str, str] | None = None
    """Smallest and largest value, ``["27 A", "60 A"]``; the numbers must be equal in the file.
    Without it: ``factor``."""
    weight: Annotated[float, Field(ge=0.0, le=1e6, strict=True)] = 1.0
    """Weight of a change in the cost: the cost is weight x abs(ln factor)."""
    tolerance: str | None = None
    """Relative tolerance of the numbers, ``"10 %"``, for ``--corners`` of ``design``. Without it:
    0."""
    note: str = ""
    """Remark for readers of the file."""

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
        """The tolerance as a number; 0 for none."""
        return 0.0 if self.tolerance is None else parse_quantity(self.tolerance, "")


Hertz = Annotated[Quantity, Units(("Hz",), positive=True)]
Degrees = Annotated[Quantity, Units(("rad",), positive=True)]
Share = Annotated[Quantity, Units(("",), positive=True, most=1.0)]
Seconds = Annotated[Quantity, Units(("s",), not_negative=True)]


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class DesignSettings:
    """Settings that a redesign may change at no cost, each with its smallest and largest value."""

    crossover: tuple[Hertz, Hertz] | None = None
    """Smallest and largest crossover frequency of all lead filters; ``phase_margin`` must be given
    as well. Without it: the gains do not change."""
    phase_margin: tuple[Degrees, Degrees] | None = None
    """Smallest and largest phase margin; ``crossover`` must be given as well. Without it: the gains
    do not change."""
    acceleration: tuple[Share, Share] | None = None
    """Smallest and largest share of acceleration and jerk limits that the planner uses. Without it:
    all."""
    needle_delay: tuple[Seconds, Seconds] | None = None
    """Smallest and largest time from the command of a stitch to its needle-down. Without it: the
    time in the specification."""

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
            largest_deg = math.degrees(self.phase_margin[1].si)
            if largest_deg > MOST_MARGIN_DEG * (1.0 + 1e-9):
                raise ValueError(
                    f"phase_margin: it reaches {largest_deg:g} deg, limit {MOST_MARGIN_DEG:g} deg"
                )
        return self


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class KnownDesign:
    """A published design, plotted together with the design found."""

    title: str
    """Title of the design, on one line."""
    factors: dict[Name, Factor] = Field(min_length=1)
    """Factor of each parameter; the factor of a parameter that is not named is 1."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Design:
    """The ``[design]`` table."""

    parameters: dict[Name, DesignParameter] = Field(min_length=1, max_length=MOST_PARAMETERS)
    """Parameters that may change, by name; at most eight."""
    settings: DesignSettings = Field(default_factory=DesignSettings)
    """Settings that may change at no cost, without a change of the machine. Without it: none."""
    known: dict[Name, KnownDesign] = Field(default_factory=dict)
    """Published designs by name, plotted beside the design found."""

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
                        f"known.{title}.factors: {name!r} is not a parameter; there are: "
                        f"{', '.join(self.parameters)}"
                    )
        toleranced = [name for name, parameter in self.parameters.items() if parameter.spread > 0]
        if len(toleranced) > MOST_TOLERANCES:
            raise ValueError(
                f"parameters.{toleranced[MOST_TOLERANCES]}.tolerance: {len(toleranced)} parameters "
                f"have a tolerance, limit {MOST_TOLERANCES}"
            )
        return self


NumberPattern = Annotated[
    str, Field(pattern=r"^[A-Za-z_]+(\.(\*|[A-Za-z0-9_-]+))+$", max_length=200)
]


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Tolerances:
    """How the numbers of a machine vary within their tolerances.

    Numbers are named by their dotted names in the file, such as ``"links.x_belt.stiffness"``; ``*``
    stands for any text in a name.
    """

    normal: tuple[NumberPattern, ...] = ()
    """Numbers with a normal distribution: ``+-`` is two standard deviations, and the distribution
    is truncated at three standard deviations."""
    exclude: tuple[NumberPattern, ...] = ()
    """Numbers that do not vary."""
    groups: dict[Name, tuple[NumberPattern, ...]] = Field(default_factory=dict)
    """Groups of numbers that vary together, by name of the group: all numbers of a group deviate by
    the same share of their tolerances. Either all numbers of a group are ``normal``, or none."""

    @model_validator(mode="after")
    def _each_in_one_group(self) -> Tolerances:
        for name, members in self.groups.items():
            if not members:
                raise ValueError(f"groups.{name}: the group has no numbers")
        return self

    def named(self) -> Iterator[tuple[str, str]]:
        """Yield the key of each pattern in the file, and the pattern."""
        for key, patterns in (("normal", self.normal), ("exclude", self.exclude)):
            yield from ((f"tolerances.{key}", pattern) for pattern in patterns)
        for name, members in self.groups.items():
            yield from ((f"tolerances.groups.{name}", pattern) for pattern in members)


def matches(path: str, patterns: tuple[str, ...]) -> bool:
    """Return whether one of ``patterns`` matches the dotted name ``path``."""
    return any(fnmatchcase(path, pattern) for pattern in patterns)


def check_named(tolerances: Tolerances, paths: Sequence[str]) -> None:
    """Refuse patterns that match none of the numbers ``paths``, and a number in two groups.

    Raises
    ------
    ValueError
        The message begins with the key in the file.
    """
    for where, pattern in tolerances.named():
        if not any(matches(path, (pattern,)) for path in paths):
            close = difflib.get_close_matches(pattern, paths, n=1)
            hint = f"did you mean {close[0]!r}?" if close else "name it by its place in the file."
            raise ValueError(f"{where} names the number {pattern!r}, which does not exist; {hint}")
    taken: dict[str, str] = {}
    for name, members in tolerances.groups.items():
        for path in (path for path in paths if matches(path, members)):
            if path in taken:
                raise ValueError(
                    f"tolerances.groups.{name}: {path} is in the group {taken[path]!r} already"
                )
            taken[path] = name


def quantities(part: Any, path: str = "") -> Iterator[tuple[str, Quantity]]:
    """Yield every number in ``part`` with its dotted name, in the order of the file."""
    if isinstance(part, Quantity):
        yield path, part
    elif isinstance(part, Mapping):
        for key, value in part.items():
            yield from quantities(value, f"{path}.{key}" if path else str(key))
    elif isinstance(part, tuple):
        for index, value in enumerate(part):
            yield from quantities(value, f"{path}.{index}")
    elif is_dataclass(part):
        for field in fields(part):
            field_path = f"{path}.{field.name}" if path else field.name
            yield from quantities(getattr(part, field.name), field_path)
