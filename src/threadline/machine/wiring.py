"""What somebody needs who wires a machine and sets up its drives: nothing of it is simulated."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from threadline.machine.parts import STRICT

Said = Annotated[str, Field(min_length=1, max_length=400)]
_Pin = Annotated[str, Field(pattern=r"^[A-Za-z0-9]{1,4}$")]


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Connector:
    """A connector: what and where it is, and the signal at each pin that is used."""

    title: Said
    pins: dict[_Pin, Said] = Field(min_length=1)


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Guide:
    """What ``threadline guide`` prints besides what follows from the other parts.

    ``presets`` are the steps that the drives ask for by their own manual, before the steps of
    calibration that are the same for every such drive.
    """

    presets: tuple[Said, ...] = ()
    connectors: dict[Annotated[str, Field(pattern=r"^[A-Za-z0-9-]{1,20}$")], Connector] = Field(
        default_factory=dict
    )
