"""Messages about a controller's board: its settings, how full it is, the lines of its console."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel


class Fill(BaseModel):
    """How full a controller is: blocks of its planner, characters of its receive buffer."""

    blocks: int
    of_blocks: int
    characters: int
    of_characters: int


class BoardSetting(BaseModel):
    """A setting of a controller beside the machine file."""

    number: int
    name: str
    unit: str
    board: str
    words: str
    """Meaning of a code."""
    file: str
    """Value of the machine file; empty if it has none."""
    mark: Literal["", "same", "lower", "other", "refused"]
    """Result of the comparison: a speed may be ``lower``; a ``refused`` value blocks all motion."""


class Board(BaseModel):
    """The settings of a controller; sent each time that they are read."""

    type: Literal["board"] = "board"
    firmware: str
    settings: list[BoardSetting]


class Exchange(BaseModel):
    """A line to a controller, or from it."""

    at_s: float
    """s since 1970."""
    kind: Literal["typed", "sent", "program", "heard"]
    text: str
    words: str
    """Meaning of a code."""


class Console(BaseModel):
    """Lines to a controller and from it, as they pass."""

    type: Literal["console"] = "console"
    lines: list[Exchange]
    left_out: int = 0
    """Number of program lines that are left out before these."""
    whole: bool = False
    """Whether these are all kept lines: a client gets them after its hello."""
