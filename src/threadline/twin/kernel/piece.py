"""One connected piece of a machine, ready to run: equations, instants, tables, and its shape."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import ceil, factorial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray, IntArray
from threadline.dynamics.matrix_controller import loop_parts
from threadline.dynamics.network import PiecewiseLinear
from threadline.dynamics.values import Values
from threadline.errors import MachineError
from threadline.machine import Machine
from threadline.machine.controllers import ProfileController, StateSpaceController
from threadline.twin.kernel.layout import Layout
from threadline.twin.kernel.mode_tables import ModeTables
from threadline.twin.kernel.names import Action, Do, Row, SampleLayout
from threadline.twin.kernel.shape import (
    AxisShape,
    BankShape,
    ControllerShape,
    GuardShape,
    Pattern,
    SensorShape,
    Shape,
)
from threadline.twin.kernel.tables import (
    NET_GUARD,
    Bank,
    ControlTables,
    PlantTables,
    SensorTables,
    control_tables,
    plant_tables,
    sensor_tables,
)
from threadline.twin.timeline import Schedule, make_schedule

_CACHE_BYTES = 16_000
"""Largest memory of a block of variants, which should stay in the fastest cache."""
_WIDTH = 8
_WATCH_PER_RATE = 1.0
_CELL_PER_RATE = 0.5
_MOST_RATE = float(1 << 20)
_MOST_PIECES = 1 << 12
_MOST_MODES = 1 << 20
_MOST_KINDS = 12
# The number of lengths depends on dead times. It is rounded up to a multiple of this, so that
# machines with different dead times share kernels.
_LENGTHS_AT_ONCE = 8
_SECTION_PER_RATE = 0.3
_REMAINDER = 1e-17


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Steps:
    """One hyperperiod in the form of kernels.

    Parameters
    ----------
    kinds
        Distinct lists of actions; an advance is the last action. Kinds with a tick come first.
    kind, length
        (steps,) index of the kind, and of the length of the advance.
    lengths_s
        Distinct advances; more than eight are padded to a multiple of eight by repeating the last.
    cells
        (lengths,) number of cells of each, in which the state is a short Taylor series.
    """

    kinds: tuple[tuple[Action, ...], ...]
    kind: IntArray
    length: IntArray
    lengths_s: tuple[float, ...]
    cells: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Piece:
    """A connected piece, ready to run.

    Parameters
    ----------
    equations, schedule, plant, control, sensors
        Equations, instants and tables; every array has the variants first.
    steps
        The schedule, divided so that guards can be checked.
    axis_controller
        (axes,) index of the controller of each axis.
    shared
        Whether there is one controller per axis, in order, that reads its axis' load at every tick.
    rate
        The fastest rate, 1/s, for which its tables are made.
    rates
        (V,) the fastest rate of each variant.
    mode_tables
        Tables of its modes for each kernel that has run it, shared by all runs.
    begun
        These tables and the initial workspace of a run, by lanes, width, options, and the encoders
        with equal phases in all variants.
    lanes
        Variants in a block and in a vector, by options.
    """

    equations: PiecewiseLinear
    schedule: Schedule
    plant: PlantTables
    control: ControlTables
    sensors: SensorTables
    steps: Steps
    axis_controller: IntArray
    shared: bool
    rate: float
    rates: FloatArray
    mode_tables: dict[Shape, ModeTables] = field(default_factory=dict)
    begun: dict[tuple[int, int, bool, bool, tuple[bool, ...]], tuple[ModeTables, FloatArray]] = (
        field(default_factory=dict)
    )
    lanes: dict[tuple[bool, bool], tuple[int, int]] = field(default_factory=dict)

    @property
    def sample(self) -> SampleLayout:
        """Columns of a sample."""
        group = self.equations.group
        return SampleLayout(
            len(self.control.drive), len(group.axes), len(group.drives), len(group.inputs),
            len(self.sensors.names),
        )  # fmt: skip

    def lanes_of(self, peak: bool, quantised: bool) -> tuple[int, int]:
        """Return the number of variants in a block, limited by the cache, and in a vector."""
        if self.equations.variants < _WIDTH:
            return 1, 1
        known = self.lanes.get((peak, quantised))
        if known is None:
            rows = Layout(self.shape(1, 1, peak=peak, quantised=quantised)).rows
            fitting = (lanes for lanes in (64, 32, 16) if 8 * rows * lanes <= _CACHE_BYTES)
            known = self.lanes[peak, quantised] = next(fitting, _WIDTH), _WIDTH
        return known

    def shape(
        self, lanes: int, width: int, *, peak: bool, quantised: bool, uniform: tuple[Row, ...] = ()
    ) -> Shape:
        """Return the shape of the kernel that runs this piece."""
        return shape_of(
            self.equations,
            self.plant,
            self.control,
            self.sensors,
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


def prepared(
    machine: Machine, piece: PiecewiseLinear, values: Values, least_rate: float = 0.0
) -> Piece:
    """Return ``piece`` with its schedule and tables.

    Parameters
    ----------
    least_rate
        1/s: time steps are at least as fine as for this rate. If no variant is faster, the result
        of a variant does not depend on the others in the batch.

    Raises
    ------
    MachineError
        If its clocks are incompatible, a rate is too fast for its ticks, or it has too many modes.
    """
    schedule = make_schedule(machine, piece.group)
    longest_s = float(schedule.grid_s * int(schedule.lengths.max()))
    rates = _fastest_rates(piece)
    rate = max(float(rates.max()), least_rate)
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
            remedy="Leave out limits, belts, play or friction that hardly matter.",
        )
    owners = [part.axis for part in loop_parts(machine, piece.group.controllers)]
    return Piece(
        equations=piece,
        schedule=schedule,
        plant=plant,
        control=control_tables(machine, piece, values),
        sensors=sensor_tables(machine, piece, values),
        steps=_steps(schedule, rate if guarded else 0.0),
        axis_controller=np.array([owners.index(axis) for axis in piece.group.axes], dtype=np.int64),
        shared=_shared(machine, piece, values),
        rate=rate,
        rates=rates,
    )


def _steps(schedule: Schedule, rate: float) -> Steps:
    """Divide every advance into equal parts of at most one period of the fastest rate."""
    whole = [float(schedule.grid_s * int(x)) for x in schedule.lengths]
    if len(whole) > _LENGTHS_AT_ONCE:
        whole += whole[-1:] * (-len(whole) % _LENGTHS_AT_ONCE)
    pieces = [max(1, ceil(rate * s / _WATCH_PER_RATE)) for s in whole]
    lengths_s = tuple(s / p for s, p in zip(whole, pieces, strict=True))
    cells = [float(max(1, ceil(rate * s / _CELL_PER_RATE))) for s in lengths_s]
    bounds = schedule.first_action.tolist()
    actions = [Action(Do(what), c) for what, c in schedule.actions.tolist()]
    advance = Action(Do.ADVANCE)
    steps: list[tuple[tuple[Action, ...], int]] = []
    for first, last, x in zip(bounds, bounds[1:], schedule.length.tolist(), strict=False):
        steps.append(((*actions[first:last], advance), x))
        steps += [((advance,), x)] * (pieces[x] - 1)
    if len({actions for actions, _ in steps}) > _MOST_KINDS:
        steps = [((action,), x) for actions, x in steps for action in actions]
    kinds = sorted({a for a, _ in steps}, key=lambda a: (Do.TICK not in [one.do for one in a], a))
    return Steps(
        kinds=tuple(kinds),
        kind=np.array([kinds.index(a) for a, _ in steps], dtype=np.int64),
        length=np.array([x for _, x in steps], dtype=np.int64),
        lengths_s=lengths_s,
        cells=np.array(cells),
    )


def _shared(machine: Machine, piece: PiecewiseLinear, values: Values) -> bool:
    group, tick_s = piece.group, machine.tick_clock.period_s
    if any(f"axes.{axis}.counts" in values.replaced for axis in group.axes):
        return False
    return [machine.axes[a].controller for a in group.axes] == list(group.controllers) and all(
        machine.axes[axis].load is None
        and not isinstance(machine.controllers[name], ProfileController | StateSpaceController)
        and machine.clock(machine.controllers[name].clock).period_s == tick_s
        for axis, name in zip(group.axes, group.controllers, strict=True)
    )


def _fastest_rates(piece: PiecewiseLinear) -> FloatArray:
    """Return the (V,) largest spectral radius over the modes of every element, in 1/s.

    One element at a time takes each of its modes, all others are in their first mode.
    """
    n = len(piece.states)
    start = piece.base.copy()
    for element in piece.elements:
        start += element.direction[:, :, None] * element.modes[0].law[:, None, :]
    laws = [(np.zeros((1, n)), np.zeros((1, start.shape[2])))]
    for element in piece.elements:
        # Modes that differ only in constants have equal rates and are skipped, compared by bytes,
        # because an eccentric gear has thousands. Adding 0.0 turns -0.0 into 0.0.
        known = {(element.modes[0].law[:, :n] + 0.0).tobytes()}
        for mode in element.modes[1:]:
            rows = (mode.law[:, :n] + 0.0).tobytes()
            if rows not in known:
                known.add(rows)
                laws.append((element.direction, mode.law - element.modes[0].law))
    fastest = np.full(piece.variants, 1e-3)
    for direction, law in laws:
        generator = (start + direction[:, :, None] * law[:, None, :])[:, :, :n]
        fastest = np.maximum(fastest, np.abs(np.linalg.eigvals(generator)).max(axis=1))
    return fastest


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
