"""State of a running piece, and the calls into its machine code."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray, IntArray
from threadline.machine import Machine
from threadline.twin.kernel.layout import Layout, aligned
from threadline.twin.kernel.mode_tables import ModeTables
from threadline.twin.kernel.names import ClockEntry, Count, Do, Field, Row, Slot
from threadline.twin.kernel.piece import Piece
from threadline.twin.kernel.run import kernel
from threadline.twin.kernel.sensing import NOISE_PRIME
from threadline.twin.kernel.shape import Shape

_NOT_UNIFORM = (Field.LOWEST, Field.HIGHEST, Field.SEED)  # they change
_FEW = 64  # the initial state of up to so many variants is cached for the next run


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Snapshot:
    """State of a piece for bit-exact continuation in any process; arrays as in ``State``.

    Parameters
    ----------
    shape
        Shape of the kernel; a state of another shape cannot restore it.
    """

    shape: Shape
    work: FloatArray
    ring: FloatArray
    clock: IntArray
    counts: IntArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class State:
    """Everything that a kernel changes, for all variants, padded to whole blocks of lanes.

    Parameters
    ----------
    shape, layout
        Shape of the kernel, and layout of its rows.
    piece
        Equations, instants and tables.
    kernel
        The machine code: first and last block, address of the slots.
    modes
        Tables of the modes entered so far.
    work
        (groups, rows, width), see ``Layout``; a block consists of groups.
    ring
        (blocks, controllers, K, lanes) levels in the dead times.
    clock
        (blocks, entries), see ``ClockEntry``.
    counts
        (blocks, 4), see ``Count``.
    cell_s
        (lengths,) length of the cells of each advance, s.
    slots
        (slots,) arguments of the machine code, see ``Slot``; 0 for those that change from call to
        call.
    """

    shape: Shape
    layout: Layout
    piece: Piece
    kernel: Callable[[int, int, int], None]
    modes: ModeTables
    work: FloatArray
    ring: FloatArray
    clock: IntArray
    counts: IntArray
    cell_s: FloatArray = field(init=False)
    slots: IntArray = field(init=False)

    def __post_init__(self) -> None:
        steps, modes = self.piece.steps, self.modes
        object.__setattr__(self, "cell_s", np.array(steps.lengths_s) / steps.cells)
        slots = np.zeros(len(Slot), dtype=np.int64)
        lying: dict[Slot, NDArray[Any]] = {
            Slot.WORK: self.work,
            Slot.CLOCK: self.clock,
            Slot.COUNTS: self.counts,
            Slot.TABLES: modes.tables,
            Slot.PLANS: modes.plans,
            Slot.CELLS: steps.cells,
            Slot.CELL_S: self.cell_s,
            Slot.KINDS: steps.kind,
            Slot.LENGTHS: steps.length,
            Slot.RING: self.ring,
        }
        for slot, array in lying.items():
            slots[slot] = array.ctypes.data
        slots[Slot.MEET] = modes.address
        slots[Slot.STEPS] = len(steps.kind)
        slots[Slot.RING_LENGTH] = self.ring.shape[2]
        object.__setattr__(self, "slots", slots)

    def run(
        self, begin: int, end: int, references: FloatArray, every: int, window: int,
        records: IntArray,
    ) -> None:  # fmt: skip
        """Run the blocks from ``begin`` up to ``end`` for as many ticks as references.

        Parameters
        ----------
        references
            (ticks, controllers) counts, contiguous.
        every
            Ticks from sample to sample, 0 for none.
        window
            First tick of the window of smallest and largest load.
        records
            (columns, 2) address of the samples of each column, 0 for none, and stride in numbers.
        """
        slots = self.slots.copy()
        slots[Slot.REFERENCES] = references.ctypes.data
        slots[Slot.ROWS] = len(references)
        slots[Slot.EVERY] = every
        slots[Slot.WINDOW] = window
        slots[Slot.RECORDS] = records.ctypes.data
        self.kernel(begin, end, slots.ctypes.data)

    def failure(self) -> str:
        """Return why the simulation has no solution; empty if it has one.

        Raises
        ------
        MachineError
            If its modes need too much memory.
        """
        if self.counts[:, Count.UNMET].any() and self.modes.failure is not None:
            raise self.modes.failure
        if self.counts[:, Count.ENDLESS].any():
            return "modes change without end"
        if not np.isfinite(self.work[:, : self.shape.states]).all():
            return "the motion grows without bound"
        return ""

    def of_axes(self, field: Field) -> FloatArray:
        """Return the (V, axes) rows of a field of the axes."""
        return self._rows([self.layout[field, x] for x in range(len(self.shape.axes))])

    def worst(self) -> FloatArray:
        """Return the largest |commanded - load|, (V, axes), m or rad."""
        worst = self.of_axes(Field.WORST)
        return worst * self.of_axes(Field.SCALE) if self.shape.shared else worst

    def peaks(self) -> FloatArray:
        """Return the current of largest magnitude, (V, drives), A."""
        return self._rows([self.layout[Field.PEAK, d] for d in range(len(self.shape.drives))])

    def _rows(self, rows: list[int]) -> FloatArray:
        return self.work[:, rows].transpose(0, 2, 1).reshape(-1, len(rows)).copy()

    def column(self, j: int) -> FloatArray:
        """Return the (groups, width) rows of a column of ``[states, inputs]``, as a view."""
        view: FloatArray = self.work[:, self.layout[Field.COLUMN, j]]
        return view

    @property
    def ticks_of_hyperperiod(self) -> int:
        """Number of ticks after which the steps repeat."""
        steps = self.piece.steps
        ticks = [any(action.do == Do.TICK for action in kind) for kind in steps.kinds]
        return int(np.count_nonzero(np.array(ticks)[steps.kind]))

    def begin_again(self) -> None:
        """Count ticks and extremes from here on; the machine stays as it is."""
        self.clock[:, ClockEntry.NOW] = 0
        for x in range(len(self.shape.axes)):
            self.work[:, self.layout[Field.WORST, x]] = 0.0
        for d in range(len(self.shape.drives)):
            self.work[:, self.layout[Field.PEAK, d]] = 0.0

    def snapshot(self) -> Snapshot:
        """Return a copy of the present state."""
        return Snapshot(
            shape=self.shape,
            work=self.work.copy(),
            ring=self.ring.copy(),
            clock=self.clock.copy(),
            counts=self.counts.copy(),
        )

    def restore(self, saved: Snapshot) -> None:
        """Continue from ``mode_tables``, made from the same piece in any process.

        Raises
        ------
        ValueError
            If it belongs to a piece of another shape.
        """
        if saved.shape != self.shape or saved.work.shape != self.work.shape:
            raise ValueError("the snapshot is of a machine of another shape, or of other variants")
        for mine, other in (
            (self.work, saved.work), (self.ring, saved.ring),
            (self.clock, saved.clock), (self.counts, saved.counts),
        ):  # fmt: skip
            mine[:] = other
        # The code assumes that the table of its initial mode exists.
        for mode in np.unique(self.work[:, self.layout[Field.MODE,]]):
            self.modes.meet(int(mode))
        self._find_sources()

    def _find_sources(self) -> None:
        """Set the address of the rows of advances: in the table of a mode, 0 for several modes."""
        if (Field.SOURCE,) not in self.layout.row:
            return
        layout, width = self.layout, self.shape.width
        modes = self.work[:, layout[Field.MODE,]].astype(np.int64)
        sources = self.work.view(np.int64)[:, layout[Field.SOURCE,], 0]
        before = 8 * width * (layout.first_length - layout.fixed)
        for group, mode in enumerate(modes):
            table = self.modes.meet(int(mode[0]))
            alike = bool((mode == mode[0]).all())
            sources[group] = table[group].ctypes.data + before if alike else 0


def _numbers(machine: Machine, piece: Piece) -> dict[Row, FloatArray]:
    """Return the rows of the workspace that are equal in every run: (variants,) or (1,) each."""
    control, equations = piece.control, piece.equations
    found: dict[Row, FloatArray] = {}
    for c in range(len(control.drive)):
        found[Field.B0, c], found[Field.B1, c], found[Field.B2, c] = control.numerator[:, c].T
        found[Field.A1, c], found[Field.A2, c] = control.denominator[:, c].T
        found[Field.LEVEL_LOW, c] = control.level_low[:, c]
        found[Field.LEVEL_HIGH, c] = control.level_high[:, c]
        found[Field.VOLT, c] = control.volt_per_level[:, c]
        found[Field.GAIN, c] = control.volt_per_level[:, c] * control.gain[:, c]
        found[Field.LIMIT, c] = control.limit[:, c]
        found[Field.ACCELERATION, c] = control.acceleration[:, c]
        found[Field.FASTEST, c] = control.fastest[:, c]
        found[Field.PER_TICK, c] = control.per_tick[:, c]
        for j, values in enumerate(control.sensor_row[:, c].T):
            found[Field.SENSOR, c, j] = values
        bank = control.banks[c]
        if bank is not None:
            for field, matrix in (
                (Field.NEXT, np.hstack([bank.A, bank.B])),
                (Field.OUT, np.hstack([bank.C, bank.D])),
                (Field.BACK, bank.L),
            ):
                for (i, j), number in np.ndenumerate(matrix):
                    found[field, c, i, j] = np.full(1, number)
    sensors = piece.sensors
    for s in range(len(sensors.names)):
        for j, values in enumerate(sensors.sees[:, s].T):
            found[Field.SEES, s, j] = values
        for i, values in enumerate(sensors.feels[:, s].T):
            found[Field.FEELS, s, i] = values
        found[Field.GRAIN, s] = sensors.grain[:, s]
        found[Field.SPAN, s] = sensors.span[:, s]
        found[Field.NOISE, s] = sensors.noise[:, s]
    for x, axis in enumerate(equations.group.axes):
        found[Field.LOWEST, x], found[Field.HIGHEST, x] = np.full(1, np.inf), np.full(1, -np.inf)
        found[Field.SCALE, x] = np.full(1, 1.0 / machine.axes[axis].counts.si)
        for j in range(equations.base.shape[2]):
            found[Field.LOAD, x, j] = equations.load_rows[:, x, j]
            found[Field.FRAME, x, j] = equations.frame_rows[:, x, j]
            found[Field.RATE, x, j] = equations.rate_rows[:, x, j]
    return found


def new_state(
    machine: Machine, piece: Piece, phases: FloatArray, lanes: int, width: int, *,
    peak: bool, quantised: bool,
) -> State:  # fmt: skip
    """Return the initial state: at rest, before any command.

    Parameters
    ----------
    phases
        (variants, controllers) phases of the encoders, in [0, 1).
    lanes, width
        Variants in one block, and in one vector.
    peak
        Whether currents are watched.
    quantised
        False omits the rounding of encoders and DACs.
    """
    variants = piece.equations.variants
    blocks = -(-variants // lanes)
    which = np.minimum(np.arange(blocks * lanes), variants - 1)
    # Only encoder phases differ from run to run; the rest is prepared once.
    sizes = lanes, width, peak, quantised, tuple((phases == phases[0]).all(axis=0).tolist())
    begun = piece.begun.get(sizes)
    if begun is None:
        shape_of = partial(piece.shape, lanes, width, peak=peak, quantised=quantised)
        begun = _begun(machine, piece, phases, which, width, shape_of)
        if variants <= _FEW:
            piece.begun[sizes] = begun
    modes, first = begun
    layout = modes.layout
    shape = layout.shape
    work = aligned(first.shape)
    work[:] = first
    for row, values in _standing(piece, phases).items():
        if row in layout.row:
            work[:, layout[row]] = values[which].reshape(-1, width)
    clock = np.zeros((blocks, ClockEntry.HEADS + 2 * len(shape.controllers)), dtype=np.int64)
    clock[:, ClockEntry.HEADS :: 2] = piece.schedule.in_flight
    longest = int(piece.schedule.in_flight.max(initial=0)) + 2
    state = State(
        shape=shape,
        layout=layout,
        piece=piece,
        kernel=kernel(shape),
        modes=modes,
        work=work,
        ring=aligned((blocks, len(shape.controllers), longest, lanes)),
        clock=clock,
        counts=np.zeros((blocks, len(Count)), dtype=np.int64),
    )
    state._find_sources()
    return state


def _begun(
    machine: Machine, piece: Piece, phases: FloatArray, which: IntArray, width: int,
    shape_of: Callable[..., Shape],
) -> tuple[ModeTables, FloatArray]:  # fmt: skip
    """Return the tables of modes, and the initial workspace.

    Parameters
    ----------
    which
        (lanes,) variant in each lane.
    shape_of
        Returns the shape of the kernel, given its ``uniform`` rows.
    """
    numbers = _numbers(machine, piece) | _standing(piece, phases)
    uniform = tuple(
        row
        for row, values in numbers.items()
        if width > 1 and row[0] not in _NOT_UNIFORM and _alike(values)
    )
    shape = shape_of(uniform=uniform)
    modes = piece.mode_tables.get(shape)
    if modes is None:
        modes = ModeTables(piece.plant, which, Layout(shape), piece.steps.lengths_s, piece.rate)
        piece.mode_tables[shape] = modes
    layout = modes.layout
    work = aligned((len(which) // width, layout.stride, width))
    for row, values in numbers.items():
        if row in layout.row:
            at = layout[row]
            work[:, at] = values[0] if len(values) == 1 else values[which].reshape(-1, width)
    table = modes.meet(0)
    work[:, layout.fixed : layout.fixed + layout.copied] = table[:, : layout.copied]
    return modes, work


def _alike(values: FloatArray) -> bool:
    return len(values) == 1 or bool((values == values[0]).all())


def _standing(piece: Piece, phases: FloatArray) -> dict[Row, FloatArray]:
    """Return the rows of the encoder phases, (variants,) each."""
    # A phase of 0.5 means that the axis starts on a whole count: rounding to the nearest is the
    # floor of the position + 0.5.
    offset = {"nearest": 0.0, "floor": 0.5, "truncate": 0.5}
    found: dict[Row, FloatArray] = {
        (Field.PHASE, c): phases[:, c] - offset[piece.control.encoder[c]]
        for c in range(phases.shape[1])
    }
    return found | {
        (Field.SEED, s): _seeds(phases, piece.sensors.names[s])
        for s in range(len(piece.sensors.names))
    }


def _seeds(phases: FloatArray, sensor: str) -> FloatArray:
    """Return the (variants,) first numbers of a sensor's noise, whole, 1 to ``NOISE_PRIME`` - 1.

    The numbers follow from the phases of the encoders, which differ from run to run, so a repeated
    run repeats its noise to the bit.
    """
    found = np.empty(len(phases))
    for v, own in enumerate(np.ascontiguousarray(phases)):
        digest = hashlib.sha256(own.tobytes() + sensor.encode()).digest()
        found[v] = 1 + int.from_bytes(digest[:8], "big") % (NOISE_PRIME - 1)
    return found
