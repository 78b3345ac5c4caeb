"""Programmed and planned paths, in axis space, as streams of blocks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from threadline.arrays import FloatArray, IntArray, Locked, read_only, read_only_int
from threadline.signals import Stream


class Timing(StrEnum):
    """What the parameter of a planned piece is."""

    TIME = "time"  # the piece lasts nominal_s and its parameter runs evenly in time
    GEOMETRIC = "geometric"  # only the shape is settled; the trajectory finds the timing
    FASTEST = "fastest"  # the same, and the timing is the fastest within all limits
    FIRMWARE = "firmware"  # the same, and the machine's own firmware finds the timing


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class VertexBlock(Locked):
    """A run of programmed vertices; the chord into a vertex belongs to the vertex.

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
        (n,) time spent at rest at the vertex before going on.
    line
        (n,) int: line of the job file, 0 for the start.
    slowed
        How many of these moves were programmed faster than the operator's normal feed and take
        that one instead.
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
    """What the job says: vertices joined by chords. The first vertex is the start position.

    Parameters
    ----------
    axes
        Names, in the order of the columns.
    radius_m
        (axes,) 1 for a linear axis; for a rotary one the radius at which it acts, so that
        ``radius_m * difference`` is a length at the tool for every axis.
    blocks
        Re-iterable. A path holds motion only; outputs and waits stay with the job, found again
        by the index of their operation.
    """

    axes: tuple[str, ...]
    radius_m: FloatArray
    blocks: Stream[VertexBlock]

    def __iter__(self) -> Iterator[VertexBlock]:
        return iter(self.blocks)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PieceBlock(Locked):
    """A run of consecutive polynomial pieces.

    Parameters
    ----------
    coefficients
        (n, order, axes): position of piece i at u in [0, 1] is
        ``sum(coefficients[i, k] * u**k)``, m or rad.
    operation
        (n,) int.
    nominal_s
        (n,) time at the programmed feed, the least that a geometric piece may take; 0 where only
        the limits bind.
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
    """What will be followed, within the stated tolerance of the programmed path.

    Parameters
    ----------
    axes, radius_m
        As for the programmed path.
    interpolation
        Name of the interpolation that made it.
    timing
        What the parameter of the pieces means.
    historical
        True for the interpolations of the 1994 controller, which ask for more acceleration and
        jerk than the machine has; their demands are reported, not limited.
    blocks
        Re-iterable.
    summary
        What the planner reports of itself: points added, scale and the like.
    smoothing_m
        What is left of the tolerance, at the tool, for smoothing a geometric path in time.
    """

    axes: tuple[str, ...]
    radius_m: FloatArray
    interpolation: str
    timing: Timing
    historical: bool
    blocks: Stream[PieceBlock]
    summary: Mapping[str, float] = field(default_factory=dict)
    smoothing_m: float = 0.0

    def __iter__(self) -> Iterator[PieceBlock]:
        return iter(self.blocks)
