"""Programmed and planned paths, in axis space, as streams of blocks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING

from threadline.base.arrays import FloatArray, IntArray, Locked, read_only, read_only_int
from threadline.files import Stream

if TYPE_CHECKING:
    from threadline.jobs.program_limits import ProgramLimits
    from threadline.machine.mandrel import LocalRadii


class Timing(StrEnum):
    """How a planned path gets its timing."""

    TIME = "time"  # a piece lasts nominal_s, and its parameter is proportional to time
    GEOMETRIC = "geometric"  # only a shape; the trajectory finds the timing
    FASTEST = "fastest"  # only a shape; the timing is the fastest within all limits
    FIRMWARE = "firmware"  # only a shape; the machine's own firmware sets the timing


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class VertexBlock(Locked):
    """Consecutive programmed vertices; row i of a column belongs to vertex i or its chord.

    Parameters
    ----------
    positions
        (n, axes) m or rad.
    operation
        (n,) int: the operation that moves to the vertex.
    nominal_s
        (n,) time that the move to the vertex takes at its programmed feed; 0 for a rapid move
        (as fast as the limits allow) and for the start.
    rest
        (n,) int 0/1: the motion comes to rest at this vertex, because a dwell, a stop, an output
        or the end follows.
    dwell_s
        (n,) time spent at rest at the vertex.
    line
        (n,) int: line of the job file, 0 for the start.
    slowed
        Number of these moves that were slowed to the operator's normal feed.
    """

    positions: FloatArray
    operation: IntArray
    nominal_s: FloatArray
    rest: IntArray
    dwell_s: FloatArray
    line: IntArray
    slowed: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "positions", read_only(self.positions, "positions", ndim=2))
        for name in ("nominal_s", "dwell_s"):
            object.__setattr__(self, name, read_only(getattr(self, name), name, ndim=1))
        for name in ("operation", "rest", "line"):
            object.__setattr__(self, name, read_only_int(getattr(self, name), name, ndim=1))
        lengths = {
            name: len(getattr(self, name))
            for name in ("positions", "operation", "nominal_s", "rest", "dwell_s", "line")
        }
        if len(set(lengths.values())) > 1:
            raise ValueError(f"vertex block has columns of unequal length: {lengths}")

    def __len__(self) -> int:
        return len(self.positions)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ProgrammedPath:
    """The path programmed by the job: vertices joined by chords, starting at the start position.

    Parameters
    ----------
    axes
        Names, in the order of the columns.
    radius_m
        (axes,) 1 for a linear axis; for a rotary one the radius at which it acts, so that
        ``radius_m * difference`` is a length at the tool for every axis.
    blocks
        Re-iterable blocks of vertices. A path holds motion only; outputs and waits stay in the job
        and are found by the index of their operation.
    local
        Reduction of the radii from place to place, for a mandrel with a profile.
    limits
        Limits that the program sets for the firmware's own planner; None if it sets none.
    """

    axes: tuple[str, ...]
    radius_m: FloatArray
    blocks: Stream[VertexBlock]
    local: LocalRadii | None = None
    limits: ProgramLimits | None = None

    def __iter__(self) -> Iterator[VertexBlock]:
        return iter(self.blocks)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PieceBlock(Locked):
    """Consecutive polynomial pieces of a path.

    Parameters
    ----------
    coefficients
        (n, order, axes): position of piece i at u in [0, 1] is
        ``sum(coefficients[i, k] * u**k)``, m or rad.
    operation
        (n,) int: operation of the job that the piece belongs to.
    nominal_s
        (n,) time at the programmed feed, the least that a geometric piece may take; 0 if only the
        limits of the axes bound it.
    rest_after
        (n,) int 0/1: the motion is at rest at the end of the piece.
    dwell_s
        (n,) pause after the piece.
    line
        (n,) int: line of the job file.
    """

    coefficients: FloatArray
    operation: IntArray
    nominal_s: FloatArray
    rest_after: IntArray
    dwell_s: FloatArray
    line: IntArray

    def __post_init__(self) -> None:
        object.__setattr__(
            self, "coefficients", read_only(self.coefficients, "coefficients", ndim=3)
        )
        for name in ("nominal_s", "dwell_s"):
            object.__setattr__(self, name, read_only(getattr(self, name), name, ndim=1))
        for name in ("operation", "rest_after", "line"):
            object.__setattr__(self, name, read_only_int(getattr(self, name), name, ndim=1))

    def __len__(self) -> int:
        return len(self.coefficients)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlannedPath:
    """The path to follow, made from the programmed path by an interpolation.

    Parameters
    ----------
    axes, radius_m
        As in ``ProgrammedPath``.
    interpolation
        Name of the interpolation.
    timing
        Kind of timing.
    historical
        True for the interpolations of the 1994 controller and of firmware: their accelerations and
        jerks are reported, but not limited.
    blocks
        Re-iterable blocks of pieces.
    summary
        Numbers that the planner reports, such as points added and largest deviation.
    smoothing_m
        Part of the tolerance, at the tool, that is left for smoothing a geometric path in time.
    limits
        As in ``ProgrammedPath``, of a path that the firmware plans; else None.
    """

    axes: tuple[str, ...]
    radius_m: FloatArray
    interpolation: str
    timing: Timing
    historical: bool
    blocks: Stream[PieceBlock]
    summary: Mapping[str, float] = field(default_factory=dict)
    smoothing_m: float = 0.0
    limits: ProgramLimits | None = None

    def __iter__(self) -> Iterator[PieceBlock]:
        return iter(self.blocks)
