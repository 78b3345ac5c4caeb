"""The shape of a kernel: which numbers of a machine can differ from zero."""

from __future__ import annotations

from math import ceil, factorial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import IntArray
from threadline.dynamics.network import PiecewiseLinear
from threadline.twin.kernel.shape import (
    AxisShape,
    BankShape,
    ControllerShape,
    GuardShape,
    Pattern,
    SensorShape,
    Shape,
)
from threadline.twin.kernel.tables import NET_GUARD, Bank, ControlTables, PlantTables, SensorTables

_SECTION_PER_RATE = 0.3
_REMAINDER = 1e-17


def shape_of(
    piece: PiecewiseLinear,
    plant: PlantTables,
    control: ControlTables,
    sensors: SensorTables,
    axis_controller: IntArray,
    *,
    cell: float,
    **rest: Any,
) -> Shape:
    """Return the shape of the kernel of a piece, the same for all of its modes and variants.

    Parameters
    ----------
    cell
        The fastest rate times the longest cell; at most 1/2 if there is a guard.
    rest
        Fields of the shape with these names.
    """
    matrix = _somewhere(plant.base)
    for e, count in enumerate(plant.modes):
        laws = _somewhere(plant.law[:, e, :count]).any(axis=0)
        matrix = matrix | (_somewhere(plant.direction[:, e])[:, None] & laws)
    guards = _guards(plant, matrix)
    if not guards:
        cell = 0.0  # without a guard no series is needed
    terms = next(k for k in range(4, 40) if cell ** (k + 1) / factorial(k + 1) < _REMAINDER)
    return Shape(
        matrix=tuple(_pattern(row) for row in matrix),
        drives=tuple(
            _pattern(_somewhere(plant.law[:, e]).any(axis=0)) for e in plant.drive_element
        ),
        controllers=tuple(
            ControllerShape(
                drive=int(control.drive[k]),
                sensor=_pattern(_somewhere(control.sensor_row[:, k])),
                feedback=bool(control.denominator[:, k, 0].any()),
                second=bool(control.numerator[:, k, 2].any() or control.denominator[:, k, 1].any()),
                reversal=bool(control.zero_on_reversal[k]),
                limited=bool(np.isfinite(control.limit[:, k]).any()),
                encoder=control.encoder[k],
                dac=control.dac[k],
                profile=control.profile[k],
                bank=_bank(control.banks[k]),
                banked=control.banked[k],
            )
            for k in range(len(control.drive))
        ),
        axes=tuple(
            AxisShape(
                controller=int(axis_controller[x]),
                load=_pattern(_somewhere(piece.load_rows[:, x])),
                frame=_pattern(_somewhere(piece.frame_rows[:, x])),
                rate=_pattern(_somewhere(piece.rate_rows[:, x])),
            )
            for x in range(len(axis_controller))
        ),
        guards=guards,
        inputs=len(piece.group.inputs),
        observing=tuple(_sensor(sensors, s) for s in range(len(sensors.names))),
        terms=terms,
        sections=max(1, ceil(cell / _SECTION_PER_RATE)),
        pulls=len(piece.group.axes) if piece.pulled else 0,
        **rest,
    )


def _bank(bank: Bank | None) -> BankShape | None:
    if bank is None:
        return None
    following, output = np.hstack([bank.A, bank.B]), np.hstack([bank.C, bank.D])
    return BankShape(
        loops=len(bank.D),
        sensors=bank.sensors,
        following=tuple(_pattern(row) for row in following),
        output=tuple(_pattern(row) for row in output),
        back=tuple(_pattern(row) for row in bank.L),
    )


def _sensor(sensors: SensorTables, s: int) -> SensorShape:
    return SensorShape(
        sees=_pattern(_somewhere(sensors.sees[:, s])),
        feels=_pattern(_somewhere(sensors.feels[:, s])),
        rounding=sensors.rounding[s],
        offset=sensors.offset[s],
        noisy=bool(sensors.noise[:, s].any()),
        limited=bool(np.isfinite(sensors.span[:, s]).any()),
    )


def _guards(plant: PlantTables, matrix: NDArray[np.bool_]) -> tuple[GuardShape, ...]:
    found = []
    for e, count in enumerate(plant.guards):
        for g in range(int(count)):
            row = np.array(_somewhere(plant.guard_row[:, e, :, g]).any(axis=0))
            for m in range(int(plant.modes[e])):
                if plant.guard_kind[e, m, g] == NET_GUARD:
                    row = row | matrix[plant.holds[e, m]]
            row[-1] = False
            below = bool(np.isfinite(plant.guard_low[:, e, :, g]).any())
            above = bool(np.isfinite(plant.guard_high[:, e, :, g]).any())
            if below or above:
                found.append(
                    GuardShape(row=_pattern(row), bounded_below=below, bounded_above=above)
                )
            else:
                found.append(GuardShape(row=(), bounded_below=False, bounded_above=True))
    return tuple(found)


def _somewhere(values: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return a mask of the numbers that differ from zero in any variant (first index)."""
    return np.asarray((values != 0.0).any(axis=0))


def _pattern(row: Any) -> Pattern:
    return tuple(int(j) for j in np.flatnonzero(row))
