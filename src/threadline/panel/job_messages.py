"""Parts of messages about a job: its lines, stitches, steps, switchings and criteria."""

from __future__ import annotations

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
    """Whether the thread comes from the previous hole without travel in between."""
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
