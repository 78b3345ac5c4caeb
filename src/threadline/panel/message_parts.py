"""Parts of messages: a job with its lines, stitches and criteria, a board, and cylinders."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel


class Lines(BaseModel):
    """Lines and circuits of the job, and the time at which each begins, s."""

    times_s: list[float]
    line: list[int]
    circuit: list[int]
    """The circuit, from 1; 0 outside of any."""


class Stitches(BaseModel):
    """Holes of a seam or a design in order, thinned if there are many; m and s."""

    x: list[float]
    y: list[float]
    joined: list[bool]
    """Whether the thread leads here from the previous hole without a travel move."""
    block: list[int]
    """Number of the thread, from 1; 0 for a seam."""
    threads: list[str | None]
    """Colour of each thread; None where the file does not say it."""
    number: list[int]
    count: int
    times_s: list[float]
    use: list[float]
    """Share of a limit that each stitch uses; empty without such a limit."""
    use_of: str


class NamedStep(BaseModel):
    """A step of a move list."""

    name: str
    line: int
    begin_s: float


class Lane(BaseModel):
    """An input or output over the time of the plan: its first state, and when it changes, s."""

    name: str
    input: bool
    on: bool
    changes_s: list[float]


class TurnRounds(BaseModel):
    """Instants of the plan, s, and places, m, at which the axis along the mandrel turns round."""

    axis: str
    times_s: list[float]
    at: list[float]


class Criterion(BaseModel):
    """A criterion of the specification and its result, as ``prove --json`` has it."""

    name: str
    axis: str
    step: str = ""
    measured: float | None
    limit: float | None
    unit: str
    status: str
    time_s: float | None = None
    job_line: int | None = None
    passes: list[int] = []
    operation: int | None = None
    position: list[float] | None = None
    run: int | None = None
    of: str = "run"
    required: bool = False
    note: str = ""


class Tension(BaseModel):
    """The tension of the fibre in the simulated run, N, where the machine has a spool."""

    times_s: list[float]
    """Instants of the plan, s."""
    mean: list[float]
    """Mean tension from each instant to the next."""
    least: float
    most: float


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


class EndSwitch(BaseModel):
    """A contact that closes where its cylinder is ``beyond`` a position, SI."""

    name: str
    at: float
    beyond: Literal["below", "above"]


class Cylinder(BaseModel):
    """A cylinder, from 0 to its stroke, SI; the outputs that move it, and its contacts."""

    name: str
    unit: Literal["m", "rad"]
    stroke: float
    forward: list[str]
    """Valve and flow controls of the outward stroke."""
    back: list[str]
    contacts: list[EndSwitch]
