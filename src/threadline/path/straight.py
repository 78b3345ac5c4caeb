"""The straight interpolations of the 1994 controller: linear, and point to point."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from threadline.arrays import FloatArray
from threadline.durations.chord_times import chord_time_s, rest_to_rest_s, whole_ticks_s
from threadline.machine import Machine
from threadline.path.types import PieceBlock, ProgrammedPath, VertexBlock


def velocity_limit_of(programmed: ProgrammedPath, machine: Machine) -> FloatArray:
    """Return the (axes,) velocity limits in the order of the path's axes."""
    return machine.velocity_limit[[machine.axis_names.index(axis) for axis in programmed.axes]]


def chords(programmed: ProgrammedPath) -> Iterator[PieceBlock]:
    """Yield one straight piece per move, with the time at its feed (0 for a rapid move)."""
    for block, start in with_previous(programmed):
        displacement = np.diff(block.positions, axis=0, prepend=start)
        coefficients = np.stack([block.positions - displacement, displacement], axis=1)
        yield _pieces(block, coefficients, block.nominal_s, rest_after=block.rest)


def linear_pieces(programmed: ProgrammedPath, machine: Machine) -> Iterator[PieceBlock]:
    """Yield one straight piece per move, at constant velocity, all axes arriving together.

    The travel time is of whole ticks (``whole_ticks_s``).
    """
    tick_s = float(machine.tick_clock.period_s)
    limit = velocity_limit_of(programmed, machine)
    for block, start in with_previous(programmed):
        displacement = np.diff(block.positions, axis=0, prepend=start)
        time_s = whole_ticks_s(chord_time_s(displacement, block.nominal_s, limit), tick_s)
        begin = block.positions - displacement
        coefficients = np.stack([begin, displacement], axis=1)
        yield _pieces(block, coefficients, time_s, rest_after=block.rest)


def point_to_point_pieces(programmed: ProgrammedPath, machine: Machine) -> Iterator[PieceBlock]:
    """Yield one straight piece per move that starts and ends at rest.

    The velocity is a parabola over time whose peak is the feed (``rest_to_rest_s``).
    """
    limit = velocity_limit_of(programmed, machine)
    for block, start in with_previous(programmed):
        displacement = np.diff(block.positions, axis=0, prepend=start)
        time_s = rest_to_rest_s(chord_time_s(displacement, block.nominal_s, limit))
        begin = block.positions - displacement
        zero = np.zeros_like(begin)
        coefficients = np.stack([begin, zero, 3.0 * displacement, -2.0 * displacement], axis=1)
        yield _pieces(block, coefficients, time_s, rest_after=np.ones(len(block), dtype=np.int64))


def with_previous(programmed: ProgrammedPath) -> Iterator[tuple[VertexBlock, FloatArray]]:
    """Yield every block with the (1, axes) position before it, which for the first is the start."""
    previous: FloatArray | None = None
    for block in programmed:
        yield block, block.positions[:1] if previous is None else previous
        previous = block.positions[-1:]


def _pieces(
    block: VertexBlock, coefficients: FloatArray, time_s: FloatArray, *, rest_after: object
) -> PieceBlock:
    return PieceBlock(
        coefficients=coefficients,
        operation=block.operation,
        nominal_s=time_s,
        rest_after=np.asarray(rest_after),
        dwell_s=block.dwell_s,
        line=block.line,
    )
