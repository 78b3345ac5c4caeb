"""Machine and variants -> everything that a kernel needs, allocated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from threadline.arrays import FloatArray
from threadline.errors import MachineError, OptionError
from threadline.machine import Machine
from threadline.plant.network import PiecewiseLinear
from threadline.plant.values import Values
from threadline.twin.kernel import Grid, Loop
from threadline.twin.modes import ModeCache
from threadline.twin.schedule import Schedule, make_schedule
from threadline.twin.tables import (
    ControlTables,
    OutputTables,
    PlantTables,
    control_tables,
    output_tables,
    plant_tables,
)

_CELL_PER_RATE = 0.25
_WATCH_PER_RATE = 1.0
_MOST_SLOTS = 64
_MOST_CELLS = 1 << 24


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Prepared:
    """A connected piece ready to be run."""

    piece: PiecewiseLinear
    schedule: Schedule
    plant: PlantTables
    control: ControlTables
    outputs: OutputTables
    grid: Grid
    cell_s: float
    halvings: int
    watched: int
    intervals: tuple[int, ...]

    @property
    def columns(self) -> int:
        """Columns of a record of the kernel."""
        group = self.piece.group
        return (
            2 * len(group.controllers)
            + 2 * len(group.axes)
            + 2 * len(group.drives)
            + len(group.inputs)
        )


def prepare(machine: Machine, piece: PiecewiseLinear, values: Values) -> Prepared:
    """Return ``piece`` with its schedule and tables.

    Raises
    ------
    MachineError
        If its clocks do not fit together, or it has a rate too fast for its ticks.
    """
    schedule = make_schedule(machine, piece.group)
    grid_s = float(schedule.grid_s)
    rate = _fastest_rate(piece)
    halvings = max(0, int(np.ceil(np.log2(max(grid_s * rate / _CELL_PER_RATE, 1.0)))))
    longest = int(schedule.lengths.max()) << halvings
    if longest > _MOST_CELLS:
        raise MachineError(
            f"a part of the machine responds at {rate:.4g} 1/s, too fast for ticks of "
            f"{grid_s * int(schedule.lengths.max()):.4g} s",
            remedy="Join bodies whose link is that stiff, or give the parts that are so light "
            "or damped their true numbers.",
        )
    cell_s = grid_s / 2**halvings
    intervals = []
    for length in schedule.lengths:
        wanted = int(np.ceil(grid_s * length * rate / _WATCH_PER_RATE))
        intervals.append(max(1, min(wanted, int(length) << halvings)))
    watched = 1 + max(0, int(np.floor(np.log2(max(_WATCH_PER_RATE / (rate * cell_s), 1.0)))))
    watched = min(watched, longest.bit_length())
    return Prepared(
        piece=piece,
        schedule=schedule,
        plant=plant_tables(piece),
        control=control_tables(machine, piece, values),
        outputs=output_tables(piece),
        grid=Grid(
            np.array(schedule.first_action), np.array(schedule.actions), np.array(schedule.length)
        ),
        cell_s=cell_s,
        halvings=halvings,
        watched=watched,
        intervals=tuple(intervals),
    )


def _fastest_rate(piece: PiecewiseLinear) -> float:
    """Return the largest spectral radius over the modes of every element, one at a time, in 1/s."""
    n = len(piece.states)
    start = piece.base.copy()
    for element in piece.elements:
        start += element.direction[:, :, None] * element.modes[0].law[:, None, :]
    fastest = 1e-3
    for element in piece.elements:
        for mode in element.modes:
            law = (mode.law - element.modes[0].law)[:, None, :]
            generator = (start + element.direction[:, :, None] * law)[:, :, :n]
            fastest = max(fastest, float(np.abs(np.linalg.eigvals(generator)).max()))
    if not piece.elements:
        fastest = max(fastest, float(np.abs(np.linalg.eigvals(start[:, :, :n])).max()))
    return fastest


def new_cache(prepared: Prepared, slots: int | None = None) -> ModeCache:
    """Return an empty cache of modes for one variant of ``prepared``."""
    plant = prepared.plant
    n, size = plant.base.shape[1:]
    count = len(plant.modes)
    guards = int(plant.guards.sum())
    if slots is None:
        slots = min(int(np.prod(plant.modes)), _MOST_SLOTS)
    lengths = prepared.schedule.lengths << prepared.halvings
    levels = int(lengths.max()).bit_length()
    rows = n + guards * (1 + 3 * max(prepared.intervals))
    return ModeCache(
        code=np.zeros((slots, count), dtype=np.int64),
        used=np.zeros(2, dtype=np.int64),
        generator=np.zeros((slots, n, size)),
        guard=np.zeros((slots, guards, size)),
        guard_rate=np.zeros((slots, guards, size)),
        low=np.zeros((slots, guards)),
        high=np.zeros((slots, guards)),
        owner=np.zeros((slots, guards, 2), dtype=np.int64),
        step=np.zeros((slots, levels, n, size)),
        fast=np.zeros((slots, len(lengths), rows, size)),
        lengths=np.array(lengths),
        intervals=np.array(prepared.intervals, dtype=np.int64),
        watched=np.array([prepared.watched], dtype=np.int64),
        cell_s=np.array([prepared.cell_s]),
    )


def new_loop(prepared: Prepared, phase: FloatArray) -> Loop:
    """Return the state at the start: at rest, nothing commanded.

    Parameters
    ----------
    phase
        (controllers,) of the encoder, in [0, 1).
    """
    plant, group = prepared.plant, prepared.piece.group
    size = plant.base.shape[2]
    controllers, in_flight = len(group.controllers), prepared.schedule.in_flight
    z = np.zeros(size)
    z[-1] = 1.0
    ring = int(in_flight.max(initial=0)) + 2
    head = np.zeros((controllers, 2), dtype=np.int64)
    head[:, 0] = in_flight
    return Loop(
        z=z,
        code=np.zeros(len(plant.modes), dtype=np.int64),
        where=np.zeros(3, dtype=np.int64),
        error=np.zeros((controllers, 2)),
        output=np.zeros((controllers, 2)),
        level=np.zeros(controllers),
        under_way=np.zeros((controllers, ring)),
        head=head,
        phase=np.array(phase, dtype=np.float64),
        reference=np.zeros(controllers),
        tripped=np.zeros(len(group.inputs), dtype=np.int64),
        counts=np.zeros(3, dtype=np.int64),
        peak=np.zeros(len(group.drives)),
    )


def encoder_phases(machine: Machine, phase: FloatArray | None) -> FloatArray:
    """Return the (axes,) encoder phases: where between two counts each encoder stands at rest.

    Raises
    ------
    OptionError
        If a phase is outside [0, 1), or their number is not that of the axes.
    """
    count = len(machine.axes)
    phases = np.full(count, 0.5) if phase is None else np.asarray(phase, dtype=np.float64)
    if phases.shape != (count,):
        raise OptionError(f"encoder_phase has shape {phases.shape}, expected {(count,)}")
    if not ((phases >= 0.0) & (phases < 1.0)).all():
        raise OptionError(f"encoder_phase must lie in [0, 1), got {phases.tolist()}")
    return phases
