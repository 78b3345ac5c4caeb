"""How the machine's own controller reads part programs."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator
from pydantic.dataclasses import dataclass

from threadline.machine.parts import STRICT
from threadline.machine.quantity import Quantity, Units

FeedRule = Literal[
    "fastest-axis", "base-axes", "path", "cadfil", "linuxcnc", "rs274", "grbl", "fluidnc",
    "marlin", "fanuc",
]  # fmt: skip
"""Rules for the meaning of an F word; ``threadline.jobs.gcode.f_words`` defines each."""
DialectName = Literal["winder", "linuxcnc", "grbl", "fluidnc", "marlin", "fanuc", "x-winder"]
"""Dialects of part programs; ``threadline.jobs.gcode.dialects`` defines each."""

System = Annotated[str, Field(pattern=r"^G5[4-9]$")]
Offset = Annotated[Quantity, Units(("m", "rad"))]


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Programs:
    """How the controller of the machine reads part programs.

    ``feed_mode`` is the rule for the meaning of F, that of the dialect when left out. ``base_axes``
    are the axes whose speed F is under the rule ``base-axes``, and are given with no other.
    ``offsets`` are the places of G54 to G59 in the machine's own system, by axis; what is not given
    is 0.
    """

    dialect: DialectName = "winder"
    feed_mode: FeedRule | None = None
    base_axes: tuple[Annotated[str, Field(pattern=r"^[A-Z]$")], ...] = ()
    offsets: dict[System, dict[str, Offset]] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _base(self) -> Programs:
        if (self.feed_mode == "base-axes") != bool(self.base_axes):
            raise ValueError(
                'base_axes go with feed_mode = "base-axes", and only with it: CADFIL\'s mode 1 '
                'has base_axes = ["A"], mode 2 ["A", "X"]'
            )
        return self
