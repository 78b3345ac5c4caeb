"""Machine and variants -> everything that a kernel needs, allocated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.errors import MachineError
from threadline.machine import Machine
from threadline.plant.network import PiecewiseLinear
from threadline.plant.values import Values
from threadline.twin import shape as k
from threadline.twin.lanes import lanes_kernel
from threadline.twin.modes import Modes, Plant, new_modes, pack_plant
from threadline.twin.schedule import Schedule, make_schedule
from threadline.twin.tables import (
    ControlTables,
    PlantTables,
    control_tables,
    plant_tables,
)

_CELL_PER_RATE = 0.25
_WATCH_PER_RATE = 1.0
_MOST_SLOTS = 64
_MOST_CELLS = 1 << 20
_MOST_MODES = 1 << 20


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Prepared:
    """A connected piece ready to be run.

    Parameters
    ----------
    piece, schedule, plant, control
        Equations, instants and tables; every array has the variants first.
    shared
        Whether at every tick each controller, one for each axis in order, reads its axis' load.
    cell_s
        The shortest advance that is tabulated; a power of two of them make a grid period.
    halvings
        That power.
    intervals
        Pieces of an advance in which guards are watched.
    watched
        Powers of two of a cell that a slow advance may use.
    """

    piece: PiecewiseLinear
    schedule: Schedule
    plant: PlantTables
    control: ControlTables
    axis_controller: IntArray
    shared: bool
    cell_s: float
    halvings: int
    intervals: int
    watched: int

    @property
    def columns(self) -> int:
        """Columns of a sample of the kernel."""
        group = self.piece.group
        pairs = len(group.controllers) + len(group.axes) + len(group.drives)
        return 2 * pairs + len(group.inputs)

    def shape(self, lanes: int, guards: int, *, peak: bool, quantised: bool) -> k.Shape:
        """Return the shape of the kernel that runs this piece."""
        return k.Shape(
            states=len(self.piece.states),
            drives=len(self.piece.group.drives),
            controllers=len(self.piece.group.controllers),
            axes=len(self.piece.group.axes),
            guards=guards,
            checks=1 + 3 * self.intervals,
            lengths=len(self.schedule.lengths),
            lanes=lanes,
            feedback=bool(self.control.denominator[:, :, 0].any()),
            second=bool(
                self.control.numerator[:, :, 2].any() or self.control.denominator[:, :, 1].any()
            ),
            peak=peak,
            quantised=quantised,
            delayed=self.schedule.delayed,
            limited=bool(np.isfinite(self.control.limit).any()),
            bodies=len(self.piece.group.bodies),
            reversal=bool(self.control.zero_on_reversal.all()),
            shared=self.shared,
        )


def prepare(machine: Machine, piece: PiecewiseLinear, values: Values) -> Prepared:
    """Return ``piece`` with its schedule and tables.

    Raises
    ------
    MachineError
        If its clocks do not fit together, it has a rate too fast for its ticks, or too many modes.
    """
    schedule = make_schedule(machine, piece.group)
    grid_s, longest = float(schedule.grid_s), int(schedule.lengths.max())
    if longest > _MOST_CELLS:
        raise MachineError(
            f"clocks and dead times meet only on a grid of {grid_s:.4g} s, {longest} of which make "
            f"a tick, limit {_MOST_CELLS}",
            remedy="Choose clock periods and dead times with a coarser common grid.",
        )
    rate = _fastest_rate(piece)
    halvings = max(0, int(np.ceil(np.log2(max(grid_s * rate / _CELL_PER_RATE, 1.0)))))
    if longest << halvings > _MOST_CELLS:
        raise MachineError(
            f"a part of the machine responds at {rate:.4g} 1/s, too fast for ticks of "
            f"{grid_s * longest:.4g} s",
            remedy="Join bodies whose link is that stiff, or correct parts that are too light.",
        )
    plant = plant_tables(piece)
    if np.prod(plant.modes, dtype=np.float64) > _MOST_MODES:
        raise MachineError(
            f"limits, belts, play and friction combine to {np.prod(plant.modes)} modes, "
            f"limit {_MOST_MODES}",
            remedy="Leave out those that do not matter.",
        )
    cell_s = grid_s / 2**halvings
    group, axes = piece.group, machine.axes
    return Prepared(
        piece=piece,
        schedule=schedule,
        plant=plant,
        control=control_tables(machine, piece, values),
        axis_controller=np.array(
            [group.controllers.index(axes[a].controller) for a in group.axes],
            dtype=np.int64,
        ),
        shared=_shared(machine, piece),
        cell_s=cell_s,
        halvings=halvings,
        intervals=max(1, int(np.ceil(grid_s * longest * rate / _WATCH_PER_RATE))),
        watched=1 + max(0, int(np.floor(np.log2(max(_WATCH_PER_RATE / (rate * cell_s), 1.0))))),
    )


def _shared(machine: Machine, piece: PiecewiseLinear) -> bool:
    group, tick_s = piece.group, machine.tick_clock.period_s
    return [machine.axes[a].controller for a in group.axes] == list(group.controllers) and all(
        machine.axes[axis].load is None
        and machine.clock(machine.controllers[name].clock).period_s == tick_s
        for axis, name in zip(group.axes, group.controllers, strict=True)
    )


def _fastest_rate(piece: PiecewiseLinear) -> float:
    """Return the largest spectral radius over the modes of every element, one at a time, in 1/s."""
    n = len(piece.states)
    start = piece.base.copy()
    for element in piece.elements:
        start += element.direction[:, :, None] * element.modes[0].law[:, None, :]
    laws = [
        (element.direction, mode.law - element.modes[0].law)
        for element in piece.elements
        for mode in element.modes
    ]
    fastest = 1e-3
    for direction, law in laws or [(np.zeros((1, n)), np.zeros((1, start.shape[2])))]:
        generator = (start + direction[:, :, None] * law[:, None, :])[:, :, :n]
        fastest = max(fastest, float(np.abs(np.linalg.eigvals(generator)).max()))
    return fastest


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class State:
    """Everything that a kernel changes, for all variants; V is padded to whole blocks of lanes."""

    shape: k.Shape
    prepared: Prepared
    plant: Plant
    frame: FloatArray
    kernel: Callable[..., None]
    numbers: IntArray
    modes: Modes
    work: FloatArray
    ring: FloatArray
    mode: IntArray
    clock: IntArray
    tripped: IntArray
    counts: IntArray

    def run(
        self, begin: int, end: int, references: FloatArray, every: int, window: int,
        records: FloatArray,
    ) -> None:  # fmt: skip
        """Run the blocks of lanes from ``begin`` up to ``end`` for as many ticks as references."""
        schedule = self.prepared.schedule
        self.kernel(
            begin, end, self.numbers, self.work, self.ring, self.mode, self.clock,
            schedule.first_action, schedule.actions, schedule.length, references, every, window,
            self.plant, self.modes, self.frame, self.prepared.control.drive,
            self.prepared.axis_controller, records, self.tripped, self.counts,
        )  # fmt: skip

    def specialised(self) -> State:
        """Return the same state under a kernel that is compiled for its very shape."""
        return replace(self, kernel=lanes_kernel(self.shape, fixed=True))

    def measures(self) -> FloatArray:
        """Return (V, axes, 5): see the rows of an axis in ``lanes``."""
        at, lanes = self.shape.layout()["measure"], self.shape.lanes
        part = self.work.reshape(len(self.work), -1, lanes)[:, at : at + 5 * self.shape.axes]
        parted = part.reshape(len(self.work), self.shape.axes, 5, lanes)
        table = np.ascontiguousarray(parted.transpose(0, 3, 1, 2).reshape(-1, self.shape.axes, 5))
        if self.shape.shared:
            table[:, :, k.WORST] *= table[:, :, k.SCALE]
        return table

    def peaks(self) -> FloatArray:
        """Return (V, drives): the current of largest magnitude."""
        at, lanes = self.shape.layout()["peak"], self.shape.lanes
        part = self.work.reshape(len(self.work), -1, lanes)[:, at : at + self.shape.drives]
        return np.ascontiguousarray(part.transpose(0, 2, 1).reshape(-1, self.shape.drives))


def common_guards(pieces: tuple[Prepared, ...]) -> int:
    """Return how many guards the kernels of all pieces have: pieces of one size share a kernel."""
    most = max(int(piece.plant.guards.sum()) for piece in pieces)
    return most if most < 2 else 2 * -(-most // 2)


def new_state(
    machine: Machine,
    prepared: Prepared,
    phases: FloatArray,
    lanes: int,
    guards: int,
    *,
    peak: bool = True,
    quantised: bool = True,
    fixed: bool = False,
    slots: int = _MOST_SLOTS,
) -> State:
    """Return the state at the start: at rest, nothing commanded.

    Parameters
    ----------
    phases
        (variants, controllers) of the encoders, in [0, 1).
    lanes
        Variants side by side in one block.
    guards
        Guards that the kernel has room for, see ``common_guards``.
    fixed
        Whether to compile for this very shape.
    slots
        Modes remembered per variant.
    """
    shape = prepared.shape(lanes, guards, peak=peak, quantised=quantised)
    variants = prepared.piece.variants
    blocks = -(-variants // lanes)
    which = np.minimum(np.arange(blocks * lanes), variants - 1)
    schedule = prepared.schedule
    modes = new_modes(
        prepared.plant,
        len(which),
        slots=min(slots, int(np.prod(prepared.plant.modes))),
        guards=guards,
        lengths=schedule.lengths << prepared.halvings,
        parts=prepared.intervals,
        watched=prepared.watched,
        cell_s=prepared.cell_s,
    )
    layout = shape.layout()
    work = np.zeros((blocks, layout["rows"], lanes))

    def put(row: int, values: FloatArray) -> None:
        work[:, row] = np.broadcast_to(values, (variants,))[which].reshape(blocks, lanes)

    put(layout["z"] + prepared.plant.base.shape[2] - 1, np.ones(1))
    control = prepared.control
    for c in range(shape.controllers):
        o = layout["control"] + 18 * c
        for row, values in (
            (k.B0, control.numerator[:, c, 0]),
            (k.B1, control.numerator[:, c, 1]),
            (k.B2, control.numerator[:, c, 2]),
            (k.A1, control.denominator[:, c, 0]),
            (k.A2, control.denominator[:, c, 1]),
            (k.LOW, control.level_low[:, c]),
            (k.HIGH, control.level_high[:, c]),
            (k.VOLT, control.volt_per_level[:, c]),
            (k.GAIN, control.volt_per_level[:, c] * control.gain[:, c]),
            (k.LIMIT, control.limit[:, c]),
            (k.PHASE, phases[:, c]),
            (k.ZERO, np.full(1, float(control.zero_on_reversal[c]))),
        ):
            put(o + row, values)
        for i in range(shape.bodies):
            put(layout["sensor"] + c * shape.bodies + i, control.sensor_row[:, c, i])
    for x, axis in enumerate(prepared.piece.group.axes):
        o = layout["measure"] + 5 * x
        put(o + k.LOWEST, np.full(1, np.inf))
        put(o + k.HIGHEST, np.full(1, -np.inf))
        put(o + k.SCALE, np.full(1, 1.0 / machine.axes[axis].counts.si))
        for i in range(shape.bodies):
            put(layout["load"] + x * shape.bodies + i, prepared.piece.load_rows[:, x, i])
    clock = np.zeros((blocks, k.HEADS + 2 * shape.controllers), dtype=np.int64)
    clock[:, k.HEADS :: 2] = schedule.in_flight
    return State(
        shape=shape,
        prepared=prepared,
        plant=pack_plant(prepared.plant, which),
        frame=np.ascontiguousarray(prepared.piece.frame_rows[which]),
        kernel=lanes_kernel(shape, fixed=fixed),
        numbers=np.array(shape.numbers()),
        modes=modes,
        work=work.reshape(blocks, -1),
        ring=np.zeros(
            (
                blocks,
                shape.controllers,
                int(schedule.in_flight.max(initial=0)) + 2,
                lanes,
            )
        ),
        mode=np.full((blocks, lanes), -1, dtype=np.int64),
        clock=clock,
        tripped=np.zeros((len(which), len(prepared.piece.group.inputs)), dtype=np.int64),
        counts=np.zeros((blocks, 5), dtype=np.int64),
    )
