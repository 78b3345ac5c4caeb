"""Machine and variants -> everything that a kernel needs, allocated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import ceil

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.errors import MachineError
from threadline.machine import Machine
from threadline.machine.controllers import ProfileController
from threadline.plant.network import PiecewiseLinear
from threadline.plant.values import Values
from threadline.twin.kernel import ADVANCE, HEADS, kernel
from threadline.twin.lanes import CONTEXT, COUNTS, ENDLESS, UNMET
from threadline.twin.modes import Modes
from threadline.twin.patterns import shape_of
from threadline.twin.schedule import TICK, Schedule, make_schedule
from threadline.twin.shape import AXIS_ROWS, Layout, Shape, aligned
from threadline.twin.tables import ControlTables, PlantTables, control_tables, plant_tables

_WATCH_PER_RATE = 1.0
_CELL_PER_RATE = 0.5
_MOST_RATE = float(1 << 20)
_MOST_PIECES = 1 << 12
_MOST_MODES = 1 << 20
_MOST_KINDS = 12


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Steps:
    """One hyperperiod as a kernel sees it.

    Parameters
    ----------
    kinds
        Distinct lists of actions; an advance is the last of one. Those with a tick come first.
    kind, length
        (steps,) which of the kinds, and which of the lengths its advance has.
    lengths_s
        Distinct advances.
    cells
        (lengths,) pieces of each in which the state is a short Taylor series.
    """

    kinds: tuple[tuple[tuple[int, int], ...], ...]
    kind: IntArray
    length: IntArray
    lengths_s: tuple[float, ...]
    cells: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Prepared:
    """A connected piece ready to be run.

    Parameters
    ----------
    piece, schedule, plant, control
        Equations, instants and tables; every array has the variants first.
    steps
        The schedule cut so that guards can be watched.
    axis_controller
        (axes,) of the piece.
    shared
        Whether at every tick each controller, one for each axis in order, reads its axis' load.
    rate
        The fastest rate, 1/s.
    """

    piece: PiecewiseLinear
    schedule: Schedule
    plant: PlantTables
    control: ControlTables
    steps: Steps
    axis_controller: IntArray
    shared: bool
    rate: float

    @property
    def columns(self) -> int:
        """Columns of a sample of the kernel."""
        group = self.piece.group
        pairs = len(group.controllers) + len(group.axes) + len(group.drives)
        return 2 * pairs + len(group.inputs)

    def shape(
        self,
        lanes: int,
        width: int,
        *,
        peak: bool,
        quantised: bool,
        uniform: tuple[tuple[object, ...], ...] = (),
    ) -> Shape:
        """Return the shape of the kernel that runs this piece."""
        return shape_of(
            self.piece,
            self.plant,
            self.control,
            self.axis_controller,
            lanes=lanes,
            width=width,
            kinds=self.steps.kinds,
            lengths=len(self.steps.lengths_s),
            cell=max(
                self.rate * s / c
                for s, c in zip(self.steps.lengths_s, self.steps.cells, strict=True)
            ),
            peak=peak,
            quantised=quantised,
            delayed=self.schedule.delayed,
            shared=self.shared,
            uniform=uniform,
        )


def prepare(machine: Machine, piece: PiecewiseLinear, values: Values) -> Prepared:
    """Return ``piece`` with its schedule and tables.

    Raises
    ------
    MachineError
        If its clocks do not fit together, it has a rate too fast for its ticks, or too many modes.
    """
    schedule = make_schedule(machine, piece.group)
    longest_s = float(schedule.grid_s * int(schedule.lengths.max()))
    rate = _fastest_rate(piece)
    plant = plant_tables(piece)
    guarded = bool(plant.guards.sum())
    if rate * longest_s > (_MOST_PIECES if guarded else _MOST_RATE):
        raise MachineError(
            f"a part of the machine responds at {rate:.4g} 1/s, too fast for ticks of "
            f"{longest_s:.4g} s",
            remedy="Join bodies whose link is that stiff, or correct parts that are too light.",
        )
    if np.prod(plant.modes, dtype=np.float64) > _MOST_MODES:
        raise MachineError(
            f"limits, belts, play and friction combine to {np.prod(plant.modes)} modes, "
            f"limit {_MOST_MODES}",
            remedy="Leave out those that do not matter.",
        )
    group, axes = piece.group, machine.axes
    return Prepared(
        piece=piece,
        schedule=schedule,
        plant=plant,
        control=control_tables(machine, piece, values),
        steps=_steps(schedule, rate if guarded else 0.0),
        axis_controller=np.array(
            [group.controllers.index(axes[a].controller) for a in group.axes],
            dtype=np.int64,
        ),
        shared=_shared(machine, piece),
        rate=rate,
    )


def _steps(schedule: Schedule, rate: float) -> Steps:
    """Cut every advance into equal pieces of at most one period of the fastest rate."""
    whole = [float(schedule.grid_s * int(x)) for x in schedule.lengths]
    pieces = [max(1, ceil(rate * s / _WATCH_PER_RATE)) for s in whole]
    lengths_s = tuple(s / p for s, p in zip(whole, pieces, strict=True))
    cells = [float(max(1, ceil(rate * s / _CELL_PER_RATE))) for s in lengths_s]
    bounds = schedule.first_action.tolist()
    actions = [tuple(a) for a in schedule.actions.tolist()]
    advance = (ADVANCE, 0)
    steps: list[tuple[tuple[tuple[int, int], ...], int]] = []
    for first, last, x in zip(bounds, bounds[1:], schedule.length.tolist(), strict=False):
        steps.append(((*actions[first:last], advance), x))
        steps += [((advance,), x)] * (pieces[x] - 1)
    if len({actions for actions, _ in steps}) > _MOST_KINDS:
        steps = [((action,), x) for actions, x in steps for action in actions]
    kinds = sorted({a for a, _ in steps}, key=lambda a: (TICK not in [w for w, _ in a], a))
    return Steps(
        kinds=tuple(kinds),
        kind=np.array([kinds.index(a) for a, _ in steps], dtype=np.int64),
        length=np.array([x for _, x in steps], dtype=np.int64),
        lengths_s=lengths_s,
        cells=np.array(cells),
    )


def _shared(machine: Machine, piece: PiecewiseLinear) -> bool:
    group, tick_s = piece.group, machine.tick_clock.period_s
    return [machine.axes[a].controller for a in group.axes] == list(group.controllers) and all(
        machine.axes[axis].load is None
        and not isinstance(machine.controllers[name], ProfileController)
        and machine.clock(machine.controllers[name].clock).period_s == tick_s
        for axis, name in zip(group.axes, group.controllers, strict=True)
    )


def _fastest_rate(piece: PiecewiseLinear) -> float:
    """Return the largest spectral radius over the modes of every element, one at a time, in 1/s."""
    n = len(piece.states)
    start = piece.base.copy()
    for element in piece.elements:
        start += element.direction[:, :, None] * element.modes[0].law[:, None, :]
    laws = [(np.zeros((1, n)), np.zeros((1, start.shape[2])))]
    for element in piece.elements:
        # Modes that differ in constants alone have the same rates.
        known = [element.modes[0].law[:, :n]]
        for mode in element.modes[1:]:
            if not any(np.array_equal(mode.law[:, :n], law) for law in known):
                known.append(mode.law[:, :n])
                laws.append((element.direction, mode.law - element.modes[0].law))
    fastest = 1e-3
    for direction, law in laws:
        generator = (start + direction[:, :, None] * law[:, None, :])[:, :, :n]
        fastest = max(fastest, float(np.abs(np.linalg.eigvals(generator)).max()))
    return fastest


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class State:
    """Everything that a kernel changes, for all variants; V is padded to whole blocks of lanes.

    Parameters
    ----------
    work
        (groups, rows, width), see ``shape.Layout``; a block is some groups.
    ring
        (blocks, controllers, K, lanes) levels in the dead times.
    clock
        (blocks, 3 + 2 controllers), see ``kernel``.
    counts
        (blocks, 4), see ``lanes``.
    """

    shape: Shape
    layout: Layout
    prepared: Prepared
    kernel: Callable[[int, int, int], None]
    modes: Modes
    work: FloatArray
    ring: FloatArray
    clock: IntArray
    counts: IntArray
    frozen: tuple[IntArray, ...]

    def run(
        self, begin: int, end: int, references: FloatArray, every: int, window: int,
        records: FloatArray,
    ) -> None:  # fmt: skip
        """Run the blocks of lanes from ``begin`` up to ``end`` for as many ticks as references.

        Parameters
        ----------
        references
            (ticks, controllers) counts, contiguous.
        every
            Ticks from sample to sample, 0 for none.
        window
            First tick of which the least and the greatest load are kept.
        records
            (blocks, samples, columns, lanes), filled.
        """
        kind, length = self.frozen
        steps, modes = self.prepared.steps, self.modes
        spans = np.array(steps.lengths_s) / steps.cells
        known = {
            "work": self.work, "clock": self.clock, "counts": self.counts,
            "tables": modes.tables, "plans": modes.plans, "cells": steps.cells, "cell s": spans,
            "kinds": kind, "lengths": length, "references": references, "records": records,
            "ring": self.ring,
        }  # fmt: skip
        numbers = {
            "meet": modes.address, "steps": len(kind), "rows": len(references), "every": every,
            "window": window, "samples": records.shape[1], "ring length": self.ring.shape[2],
        }  # fmt: skip
        context = np.array(
            [known[n].ctypes.data if n in known else numbers[n] for n in CONTEXT], dtype=np.int64
        )
        self.kernel(begin, end, context.ctypes.data)

    def failure(self) -> str:
        """Return why the simulation has no answer, empty when it has one.

        Raises
        ------
        MachineError
            If its modes take too much memory.
        """
        if self.counts[:, UNMET].any() and self.modes.failure is not None:
            raise self.modes.failure
        if self.counts[:, ENDLESS].any():
            return "modes change without end"
        if not np.isfinite(self.work[:, : self.shape.states]).all():
            return "the motion grows without bound"
        return ""

    def measures(self) -> FloatArray:
        """Return (V, axes, 5): worst error, least, greatest and last load, and the scale."""
        rows = [[self.layout[name, x] for name in AXIS_ROWS] for x in range(len(self.shape.axes))]
        part = self.work[:, rows]
        table = part.transpose(0, 3, 1, 2).reshape(-1, len(rows), len(AXIS_ROWS)).copy()
        if self.shape.shared:
            table[:, :, 0] *= table[:, :, AXIS_ROWS.index("scale")]
        return table

    def peaks(self) -> FloatArray:
        """Return (V, drives): the current of largest magnitude."""
        rows = [self.layout["peak", d] for d in range(len(self.shape.drives))]
        return self.work[:, rows].transpose(0, 2, 1).reshape(-1, len(rows)).copy()


_CHANGING = ("lowest", "highest")


def _numbers(
    machine: Machine, prepared: Prepared, phases: FloatArray
) -> dict[tuple[object, ...], FloatArray]:
    """Return what rows of the workspace hold at the start: (variants,) or (1,) each."""
    control, piece = prepared.control, prepared.piece
    found: dict[tuple[object, ...], FloatArray] = {}
    for c in range(phases.shape[1]):
        found["b0", c], found["b1", c], found["b2", c] = control.numerator[:, c].T
        found["a1", c], found["a2", c] = control.denominator[:, c].T
        found["level low", c], found["level high", c] = (
            control.level_low[:, c],
            control.level_high[:, c],
        )
        found["volt", c] = control.volt_per_level[:, c]
        found["gain", c] = control.volt_per_level[:, c] * control.gain[:, c]
        found["limit", c] = control.limit[:, c]
        found["phase", c] = phases[:, c]
        found["acceleration", c] = control.acceleration[:, c]
        found["fastest", c], found["per tick", c] = control.fastest[:, c], control.per_tick[:, c]
        for j, values in enumerate(control.sensor_row[:, c].T):
            found["sensor", c, j] = values
    for x, axis in enumerate(piece.group.axes):
        found["lowest", x], found["highest", x] = np.full(1, np.inf), np.full(1, -np.inf)
        found["scale", x] = np.full(1, 1.0 / machine.axes[axis].counts.si)
        for j in range(piece.base.shape[2]):
            found["load", x, j] = piece.load_rows[:, x, j]
            found["frame", x, j] = piece.frame_rows[:, x, j]
    return found


def new_state(
    machine: Machine, prepared: Prepared, phases: FloatArray, lanes: int, width: int, *,
    peak: bool = True, quantised: bool = True,
) -> State:  # fmt: skip
    """Return the state at the start: at rest, nothing commanded.

    Parameters
    ----------
    phases
        (variants, controllers) of the encoders, in [0, 1).
    lanes, width
        Variants in one block, and in one vector.
    """
    numbers = _numbers(machine, prepared, phases)
    uniform = tuple(
        name
        for name, values in numbers.items()
        if width > 1 and name[0] not in _CHANGING and (values == values[0]).all()
    )
    shape = prepared.shape(lanes, width, peak=peak, quantised=quantised, uniform=uniform)
    layout = Layout(shape)
    variants, steps = prepared.piece.variants, prepared.steps
    blocks = -(-variants // lanes)
    which = np.minimum(np.arange(blocks * lanes), variants - 1)
    modes = Modes(prepared.plant, which, layout, steps.lengths_s, prepared.rate)
    work = aligned((blocks * (lanes // width), layout.stride, width))

    for name, values in numbers.items():
        if name in layout.row:
            full = np.broadcast_to(values, (variants,))[which]
            work[:, layout[name]] = full.reshape(-1, width)
    table = modes.meet(0)
    work[:, layout.fixed : layout.fixed + layout.copied] = table[:, : layout.copied]
    if ("source",) in layout.row:
        rows_before = layout.first_length - layout.fixed
        first = table.ctypes.data + 8 * width * rows_before
        work.view(np.int64)[:, layout["source",], 0] = (
            first + np.arange(len(table)) * table[0].nbytes
        )
    clock = np.zeros((blocks, HEADS + 2 * len(shape.controllers)), dtype=np.int64)
    clock[:, HEADS::2] = prepared.schedule.in_flight
    longest = int(prepared.schedule.in_flight.max(initial=0)) + 2
    return State(
        shape=shape,
        layout=layout,
        prepared=prepared,
        kernel=kernel(shape),
        modes=modes,
        work=work,
        ring=aligned((blocks, len(shape.controllers), longest, lanes)),
        clock=clock,
        counts=np.zeros((blocks, COUNTS), dtype=np.int64),
        frozen=(np.ascontiguousarray(steps.kind), np.ascontiguousarray(steps.length)),
    )
