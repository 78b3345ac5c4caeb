"""Interface of the engine: machines to run, and runs to advance."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from itertools import pairwise
from math import ceil, lcm
from types import TracebackType
from typing import NamedTuple

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.dynamics.matrix_controller import loop_parts
from threadline.dynamics.network import piecewise_linear
from threadline.dynamics.values import Values
from threadline.machine import Machine
from threadline.twin.kernel.names import ClockEntry, Count, Field
from threadline.twin.kernel.piece import Piece, prepared
from threadline.twin.kernel.state import Snapshot, State, new_state

NEVER = 1 << 62
"""A tick beyond any run."""


class Signal(StrEnum):
    """A quantity that can be sampled in a run."""

    READ = "read"  # of the axis' encoder, counts from the start
    VOLTS = "volts"  # at the amplifier's input of the axis, V
    LOAD = "load"  # of the axis from its start, m or rad
    FRAME = "frame"  # of the axis, m or rad
    RATE = "rate"  # of the axis: velocity of its load, m/s or rad/s
    CURRENT = "current"  # in the motor of the axis, A
    CURRENT_PEAK = "current peak"  # of largest magnitude since the preceding sample, A
    TRIPPED = "tripped"  # 1 after a limit switch has cut its drive
    OBSERVED = "observed"  # of an observing sensor, in its unit
    TENSION = "tension"  # of the fibre at the eye, N; no run of the engine has it


class Reading(NamedTuple):
    """A signal and the name of its axis, limit switch or sensor."""

    signal: Signal
    name: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Measures:
    """Extremes of every axis over all ticks; each (variants, axes), axes as in the file.

    Parameters
    ----------
    worst
        Largest |commanded - load|, m or rad.
    lowest, highest
        Load position in the window, relative to the start of the axis, m or rad.
    last
        Load position at the last tick, relative to the start of the axis, m or rad.
    current_peak
        Current of largest magnitude since the last sample, A.
    """

    worst: FloatArray
    lowest: FloatArray
    highest: FloatArray
    last: FloatArray
    current_peak: FloatArray


class Engine:
    """A machine, or many variants of it, for any number of runs.

    It owns equations, schedules and, through its runs, compiled code, tables and workspaces. The
    code for one shape of machine is compiled once per process and shared by all engines.

    Parameters
    ----------
    machine
        Structure and all numbers not in ``values``.
    values
        The numbers of the variants.
    start_si
        (axes,) position before the first tick, m or rad.
    least_rates
        Per connected piece, 1/s: time steps are at least as fine as for this rate, independent of
        the other variants in the batch; empty: the rates of these variants.

    Raises
    ------
    MachineError
        If its clocks or parts cannot be simulated.
    """

    def __init__(
        self,
        machine: Machine,
        values: Values,
        start_si: FloatArray,
        least_rates: tuple[float, ...] = (),
    ) -> None:
        self.machine, self.variants = machine, values.count
        self._made_of = machine, values, start_si, least_rates
        pulled = machine.spool is not None and machine.mounted is not None
        pieces = piecewise_linear(machine, values, start_si, pulled=pulled)
        self._pieces = tuple(
            prepared(machine, equations, values, rate)
            for equations, rate in zip(pieces, least_rates or (0.0,) * len(pieces), strict=True)
        )
        self._wired = tuple(_Wiring(machine, piece) for piece in self._pieces)

    @property
    def rates(self) -> tuple[FloatArray, ...]:
        """(variants,) the fastest rate of each variant in each connected piece, 1/s."""
        return tuple(piece.rates for piece in self._pieces)

    def __reduce__(
        self,
    ) -> tuple[type[Engine], tuple[Machine, Values, FloatArray, tuple[float, ...]]]:
        # Code, tables and workspaces cannot be pickled, so another process makes them again.
        return Engine, self._made_of

    def start(
        self,
        phases: FloatArray,
        *,
        watch_current: bool = True,
        quantised: bool = True,
        threads: int = 1,
    ) -> Run:
        """Return a run: the machine at rest, before any command.

        Parameters
        ----------
        phases
            (variants, axes) position of each encoder between two counts, in [0, 1).
        watch_current
            False omits ``CURRENT_PEAK``, for speed.
        quantised
            False omits the rounding of encoders and DACs (not their limits).
        threads
            Cores to use. Results do not depend on it.
        """
        machine = self.machine
        owner = {name: i for i, name in enumerate(machine.axes)}
        states = []
        for piece in self._pieces:
            parts = loop_parts(machine, piece.equations.group.controllers)
            at = [owner.get(part.axis) for part in parts]
            middle = np.full(self.variants, 0.5)
            own = np.stack([middle if i is None else phases[:, i] for i in at], 1)
            lanes, width = piece.lanes_of(watch_current, quantised)
            states.append(
                new_state(
                    machine, piece, own, lanes, width, peak=watch_current, quantised=quantised
                )
            )
        return Run(self, tuple(zip(states, self._wired, strict=True)), threads)

    def readings(self) -> tuple[Reading, ...]:
        """Return all readings of a run."""
        return tuple(reading for wiring in self._wired for reading in wiring.columns)


class Run:
    """A run of a machine or its variants: it takes rows, returns samples, and holds the state.

    A context manager, which ends its threads. Made by ``Engine.start``.
    """

    def __init__(
        self, engine: Engine, wired: tuple[tuple[State, _Wiring], ...], threads: int
    ) -> None:
        self._engine, self._wired, self._threads = engine, wired, threads
        self._states = tuple(state for state, _ in wired)
        self._tick_s = float(engine.machine.tick_clock.period_s)
        self._lying: dict[tuple[Reading, ...], list[list[Reading]]] = {}
        self._pool = ThreadPoolExecutor(threads) if threads > 1 else None

    def __enter__(self) -> Run:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._pool is not None:
            self._pool.shutdown()

    @property
    def tick(self) -> int:
        """Ticks so far."""
        return int(self._states[0].clock[0, ClockEntry.NOW]) if self._states else 0

    def advance(
        self,
        travelled: IntArray,
        readings: Collection[Reading],
        *,
        every: int = 1,
        window: int = NEVER,
    ) -> Mapping[Reading, FloatArray]:
        """Advance by as many ticks as ``travelled`` has rows; return the wanted samples.

        The samples are the same bit by bit however the rows are divided into calls, if the other
        arguments stay the same.

        Parameters
        ----------
        travelled
            (ticks, axes) commanded counts at each tick, from the start.
        readings
            Readings to sample at ticks that are multiples of ``every``.
        window
            First tick of the window for the smallest and largest load position.

        Returns
        -------
        Mapping
            (samples, variants) of each reading.
        """
        first = self.tick
        samples = -(-(first + len(travelled)) // every) - -(-first // every)
        found, lying = self._room(tuple(readings), samples)
        for state, wiring in self._wired:
            references = np.zeros((len(travelled), len(state.shape.controllers)))
            for axis, controller in wiring.references:
                references[:, controller] = travelled[:, axis]
            places = [(0, 0)] * wiring.width
            for reading, at in wiring.columns.items():
                places[at] = lying.get(reading, places[at])
            records = np.array(places, dtype=np.int64)
            self._run(state, (references, every if records.any() else 0, window, records))
        return {reading: lanes[:, : self._engine.variants] for reading, lanes in found.items()}

    def loads(self) -> tuple[FloatArray, FloatArray]:
        """Return the present (variants, axes) loads from their start, m or rad, and velocities."""
        variants = self._engine.variants
        found = np.zeros((2, variants, len(self._engine.machine.axes)))
        # In order, as the kernel adds them: the same bits for any number of runs.
        for which, axis, weight, column in self._terms:
            if column is None:
                found[which, :, axis] += weight
            else:
                found[which, :, axis] += weight * column.reshape(-1)[:variants]
        return found[0], found[1]

    @cached_property
    def _terms(self) -> list[tuple[int, int, FloatArray, FloatArray | None]]:
        """Terms of ``loads``: 0 load or 1 velocity, axis, weight, rows of a column; None for 1."""
        found = []
        for state, wiring in self._wired:
            equations, last = state.piece.equations, state.shape.columns - 1
            for which, rows in enumerate((equations.load_rows, equations.rate_rows)):
                for x, (axis, _) in enumerate(wiring.references):
                    for j in np.flatnonzero(rows[:, x].any(axis=0)).tolist():
                        column = None if j == last else state.column(j)
                        found.append((which, axis, rows[:, x, j].copy(), column))
        return found

    def pull(self, forces: FloatArray) -> None:
        """Set the (variants, axes) forces on the axes from outside, N or N m, from now on.

        Only for a machine with a spool and a mandrel; see ``PiecewiseLinear.pulled``.
        """
        for axis, column in self._pulled:
            # Lanes beyond the variants take the last one.
            lanes, own = column.size, forces[:, axis]
            whole = own if lanes == len(own) else np.pad(own, (0, lanes - len(own)), mode="edge")
            column[:] = whole.reshape(column.shape)

    @cached_property
    def _pulled(self) -> list[tuple[int, FloatArray]]:
        """Axis and rows of the column of each force from outside."""
        return [
            (axis, state.column(state.shape.states + len(state.shape.drives) + x))
            for state, wiring in self._wired
            for x, (axis, _) in enumerate(wiring.references[: state.shape.pulls])
        ]

    def settle(self, forces: FloatArray, time_s: float) -> None:
        """Let the machine settle at its start under (variants, axes) forces, before the first tick.

        Loops may deviate from the command then, as they do after somebody has tied the fibre.
        """
        self.pull(forces)
        if not forces.any():
            return
        hyperperiod = lcm(*(state.ticks_of_hyperperiod for state in self._states))
        ticks = hyperperiod * ceil(time_s / (self._tick_s * hyperperiod))
        self.advance(np.zeros((ticks, len(self._engine.machine.axes)), dtype=np.int64), ())
        for state in self._states:
            state.begin_again()

    def _room(
        self, readings: tuple[Reading, ...], samples: int
    ) -> tuple[dict[Reading, FloatArray], dict[Reading, tuple[int, int]]]:
        """Return (samples, lanes) for each reading; readings of one signal share an array.

        The readings of all axes are then adjacent, (samples, axes, lanes), axes as in the file,
        without copying. The second result gives the address of each reading and its stride in
        numbers.
        """
        order = self._lying.get(readings)
        if order is None:
            order = self._lying[readings] = self._ordered(readings)
        lanes = max((len(state.clock) * state.shape.lanes for state in self._states), default=0)
        found: dict[Reading, FloatArray] = {}
        lying: dict[Reading, tuple[int, int]] = {}
        for own in order:
            room = np.empty((samples, len(own), lanes))
            begins, apart = room.ctypes.data, len(own) * lanes
            for at, reading in enumerate(own):
                found[reading] = room[:, at]
                lying[reading] = begins + room.itemsize * lanes * at, apart
        return found, lying

    def _ordered(self, readings: tuple[Reading, ...]) -> list[list[Reading]]:
        """Return the readings of each signal in memory order."""
        machine = self._engine.machine
        names = *machine.axis_names, *machine.inputs, *machine.sensors
        order = {name: at for at, name in enumerate(names)}
        found: dict[Signal, list[Reading]] = {}
        for reading in sorted(readings, key=lambda reading: order[reading.name]):
            found.setdefault(reading.signal, []).append(reading)
        return list(found.values())

    def _run(self, state: State, given: tuple[FloatArray, int, int, IntArray]) -> None:
        blocks = len(state.clock)
        if self._pool is None:
            state.run(0, blocks, *given)
            return
        # More parts than cores, so that a busy core does not delay the others.
        cuts = np.linspace(0, blocks, 8 * self._threads + 1).astype(int)
        jobs = [
            self._pool.submit(state.run, int(a), int(b), *given) for a, b in pairwise(cuts) if a < b
        ]
        for job in jobs:
            job.result()

    def sample_bytes(self, readings: Collection[Reading]) -> int:
        """Return the memory in bytes of one sample of the readings ``readings``."""
        lanes = max((len(state.clock) * state.shape.lanes for state in self._states), default=0)
        return 8 * lanes * len(readings)

    def failure(self) -> tuple[tuple[str, ...], str] | None:
        """Return the axes without a solution, and the reason; None if all have one.

        Raises
        ------
        MachineError
            If modes need too much memory.
        """
        for state in self._states:
            why = state.failure()
            if why:
                return state.piece.equations.group.axes, why
        return None

    def tripped(self, name: str) -> bool:
        """Return whether a limit switch has cut its drive, in the first variant."""
        for state in self._states:
            inputs = state.piece.equations.group.inputs
            if name in inputs:
                row = state.layout[Field.TRIPPED, inputs.index(name)]
                return bool(state.work[0, row, 0])
        raise ValueError(f"no limit switch {name!r}")

    def measures(self) -> Measures:
        """Return the extremes of every axis so far."""
        machine, variants = self._engine.machine, self._engine.variants
        shape = (variants, len(machine.axes))
        found = Measures(
            worst=np.zeros(shape), lowest=np.zeros(shape), highest=np.zeros(shape),
            last=np.zeros(shape), current_peak=np.zeros(shape),
        )  # fmt: skip
        for state in self._states:
            piece = state.piece
            at = [machine.axis_names.index(axis) for axis in piece.equations.group.axes]
            found.worst[:, at] = state.worst()[:variants]
            found.lowest[:, at] = state.of_axes(Field.LOWEST)[:variants]
            found.highest[:, at] = state.of_axes(Field.HIGHEST)[:variants]
            found.last[:, at] = state.of_axes(Field.LAST)[:variants]
            drives = piece.control.drive[piece.axis_controller]
            found.current_peak[:, at] = state.peaks()[:variants][:, drives]
        return found

    @property
    def slow_ticks(self) -> int:
        """Advances of all variants with a possible change of mode."""
        return sum(int(state.counts[:, Count.SLOW].sum()) for state in self._states)

    @property
    def events(self) -> int:
        """Mode changes of all variants."""
        return sum(int(state.counts[:, Count.EVENTS].sum()) for state in self._states)

    def snapshot(self) -> tuple[Snapshot, ...]:
        """Return the state of the run, which can be pickled."""
        return tuple(state.snapshot() for state in self._states)

    def restore(self, saved: tuple[Snapshot, ...]) -> None:
        """Continue from ``saved``, of a run started in the same way in any process.

        Raises
        ------
        ValueError
            If it belongs to another machine or other variants.
        """
        if len(saved) != len(self._states):
            raise ValueError(
                f"the snapshot is of a machine of {len(saved)} connected pieces, this one has "
                f"{len(self._states)}"
            )
        for state, one in zip(self._states, saved, strict=True):
            state.restore(one)


class _Wiring:
    """Connections between a piece and the axes of its machine.

    Attributes
    ----------
    columns
        Readings of the piece, and their columns in a sample.
    width
        Columns of a sample.
    references
        Index of each axis in the machine file, and of the controller that takes its reference.
    """

    def __init__(self, machine: Machine, piece: Piece) -> None:
        group, at = piece.equations.group, piece.sample
        self.columns: dict[Reading, int] = {}
        self.width = at.columns
        self.references: list[tuple[int, int]] = []
        for x, axis in enumerate(group.axes):
            controller = int(piece.axis_controller[x])
            drive = int(piece.control.drive[controller])
            self.references.append((machine.axis_names.index(axis), controller))
            self.columns[Reading(Signal.READ, axis)] = at.read(controller)
            self.columns[Reading(Signal.LOAD, axis)] = at.load(x)
            self.columns[Reading(Signal.FRAME, axis)] = at.frame(x)
            self.columns[Reading(Signal.RATE, axis)] = at.rate(x)
            self.columns[Reading(Signal.VOLTS, axis)] = at.volts(controller)
            self.columns[Reading(Signal.CURRENT, axis)] = at.current(drive)
            self.columns[Reading(Signal.CURRENT_PEAK, axis)] = at.peak(drive)
        for s, name in enumerate(group.inputs):
            self.columns[Reading(Signal.TRIPPED, name)] = at.tripped(s)
        for s, name in enumerate(piece.sensors.names):
            self.columns[Reading(Signal.OBSERVED, name)] = at.observed(s)
