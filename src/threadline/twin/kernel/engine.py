"""The door of the engine: machines that can be run, and runs that can be advanced."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise
from types import TracebackType
from typing import NamedTuple

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.dynamics.network import piecewise_linear
from threadline.dynamics.values import Values
from threadline.machine import Machine
from threadline.twin.kernel.names import ClockEntry, Count, Field
from threadline.twin.kernel.piece import Piece, prepared
from threadline.twin.kernel.state import Snapshot, State, new_state

NEVER = 1 << 62
"""A tick that no run reaches."""


class Signal(StrEnum):
    """What can be read of a run."""

    READ = "read"  # what the axis' own encoder reads, counts from the start
    VOLTS = "volts"  # at the amplifier's input of the axis, V
    LOAD = "load"  # of the axis from its start, m or rad
    FRAME = "frame"  # of the axis, m or rad
    CURRENT = "current"  # in the motor of the axis, A
    CURRENT_PEAK = "current peak"  # of largest magnitude since the sample before, A
    TRIPPED = "tripped"  # 1 from the instant at which a limit switch has cut its drive


class Reading(NamedTuple):
    """A signal, and the axis or limit switch of which it is."""

    signal: Signal
    name: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Measures:
    """What was kept of every axis at every tick; (variants, axes) each, axes as in the file.

    Parameters
    ----------
    worst
        Largest |commanded - load|, m or rad.
    lowest, highest
        Load from the first tick of the window on, from the start of the axis, m or rad.
    last
        Load at the last tick, from the start of the axis, m or rad.
    current_peak
        Current of largest magnitude since the last sample, A.
    """

    worst: FloatArray
    lowest: FloatArray
    highest: FloatArray
    last: FloatArray
    current_peak: FloatArray


class Engine:
    """A machine, or many variants of it, that can be run any number of times.

    It owns equations, schedules and, through its runs, compiled code, tables and workspaces; the
    code for one shape of machine is compiled once in a process and shared by all engines.

    Parameters
    ----------
    machine
        Its structure, and every number that ``values`` does not replace.
    values
        The numbers of the variants.
    start_si
        (axes,) where the machine stands before the first tick, m or rad.
    least_rates
        Of each connected piece, 1/s: time steps are at least as fine as for that, in whatever
        company a variant is; those of the variants alone when empty.

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
        pieces = piecewise_linear(machine, values, start_si)
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
        # Another process makes its own: code, tables and workspaces cannot be sent.
        return Engine, self._made_of

    def start(
        self,
        phases: FloatArray,
        *,
        watch_current: bool = True,
        quantised: bool = True,
        threads: int = 1,
    ) -> Run:
        """Return a run: the machine at rest, nothing commanded.

        Parameters
        ----------
        phases
            (variants, axes) where between two counts each encoder stands, in [0, 1).
        watch_current
            False leaves out what ``CURRENT_PEAK`` tells, for speed.
        quantised
            False leaves out the rounding of encoders and DACs (not their limits).
        threads
            Cores to use. Results do not depend on it.
        """
        machine = self.machine
        owner = {axis.controller: i for i, axis in enumerate(machine.axes.values())}
        states = []
        for piece in self._pieces:
            at = [owner.get(c) for c in piece.equations.group.controllers]
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
        """Return everything that can be read of a run."""
        return tuple(reading for wiring in self._wired for reading in wiring.columns)


class Run:
    """A run of a machine, or of its variants: it takes rows, gives samples, and keeps the state.

    A context manager: its threads end with it. Made by ``Engine.start``.
    """

    def __init__(
        self, engine: Engine, wired: tuple[tuple[State, _Wiring], ...], threads: int
    ) -> None:
        self._engine, self._wired, self._threads = engine, wired, threads
        self._states = tuple(state for state, _ in wired)
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
        wanted: Collection[Reading],
        *,
        every: int = 1,
        window: int = NEVER,
    ) -> Mapping[Reading, FloatArray]:
        """Go on for as many ticks as ``travelled`` has rows; return what is wanted.

        The same rows in pieces of any length give the same samples, to the bit, as long as the
        other arguments stay the same.

        Parameters
        ----------
        travelled
            (ticks, axes) counts commanded at each tick, from the start.
        wanted
            What to sample at the ticks that are whole multiples of ``every``.
        window
            First tick of which the least and the greatest load are kept.

        Returns
        -------
        Mapping
            (samples, variants) of each reading.
        """
        first = self.tick
        samples = -(-(first + len(travelled)) // every) - -(-first // every)
        found, lying = self._room(tuple(wanted), samples)
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

    def _room(
        self, wanted: tuple[Reading, ...], samples: int
    ) -> tuple[dict[Reading, FloatArray], dict[Reading, tuple[int, int]]]:
        """Return (samples, lanes) for each reading: those of one signal are rows of one array.

        What is read of all axes then lies together, (samples, axes, lanes), axes as in the file,
        and nobody has to copy it there. Of each reading the address and the numbers from sample to
        sample come with it.
        """
        order = self._lying.get(wanted)
        if order is None:
            order = self._lying[wanted] = self._ordered(wanted)
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

    def _ordered(self, wanted: tuple[Reading, ...]) -> list[list[Reading]]:
        """Return the readings of each signal in the order in which they lie."""
        machine = self._engine.machine
        order = {name: at for at, name in enumerate((*machine.axis_names, *machine.inputs))}
        found: dict[Signal, list[Reading]] = {}
        for reading in sorted(wanted, key=lambda reading: order[reading.name]):
            found.setdefault(reading.signal, []).append(reading)
        return list(found.values())

    def _run(self, state: State, given: tuple[FloatArray, int, int, IntArray]) -> None:
        blocks = len(state.clock)
        if self._pool is None:
            state.run(0, blocks, *given)
            return
        # More parts than cores, so that a core busy with other programs does not delay the rest.
        cuts = np.linspace(0, blocks, 8 * self._threads + 1).astype(int)
        jobs = [
            self._pool.submit(state.run, int(a), int(b), *given) for a, b in pairwise(cuts) if a < b
        ]
        for job in jobs:
            job.result()

    def sample_bytes(self, wanted: Collection[Reading]) -> int:
        """Return how many bytes one sample of the readings ``wanted`` takes while it is made."""
        lanes = max((len(state.clock) * state.shape.lanes for state in self._states), default=0)
        return 8 * lanes * len(wanted)

    def failure(self) -> tuple[tuple[str, ...], str] | None:
        """Return which axes have no answer and why; None where all have one.

        Raises
        ------
        MachineError
            If modes take too much memory.
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
        """Return what was kept of every axis."""
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
        """Advances of all variants in which a mode changed or might have."""
        return sum(int(state.counts[:, Count.SLOW].sum()) for state in self._states)

    @property
    def events(self) -> int:
        """Changes of modes of all variants."""
        return sum(int(state.counts[:, Count.EVENTS].sum()) for state in self._states)

    def snapshot(self) -> tuple[Snapshot, ...]:
        """Return all that has changed so far; it can be pickled."""
        return tuple(state.snapshot() for state in self._states)

    def restore(self, kept: tuple[Snapshot, ...]) -> None:
        """Go on from ``kept``, of a run started in the same way, here or in another process.

        Raises
        ------
        ValueError
            If it is of another machine or of other variants.
        """
        if len(kept) != len(self._states):
            raise ValueError(
                f"the snapshot is of a machine of {len(kept)} connected pieces, this one has "
                f"{len(self._states)}"
            )
        for state, one in zip(self._states, kept, strict=True):
            state.restore(one)


class _Wiring:
    """How a piece hangs together with the axes of its machine.

    Attributes
    ----------
    columns
        Everything that can be read of the piece, and in which column of a sample.
    width
        Columns of a sample.
    references
        Axes, as in the machine file, and the controller that each tells where to be.
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
            self.columns[Reading(Signal.VOLTS, axis)] = at.volts(controller)
            self.columns[Reading(Signal.CURRENT, axis)] = at.current(drive)
            self.columns[Reading(Signal.CURRENT_PEAK, axis)] = at.peak(drive)
        for s, name in enumerate(group.inputs):
            self.columns[Reading(Signal.TRIPPED, name)] = at.tripped(s)
