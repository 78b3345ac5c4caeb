"""Tick-exact simulation of one machine: commands in, recording out, block by block."""

from __future__ import annotations

from collections.abc import Iterator
from math import ceil

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.errors import MachineError, OptionError
from threadline.machine import Machine
from threadline.plant.network import piecewise_linear
from threadline.plant.values import Values
from threadline.signals import (
    Channel,
    ChannelKind,
    Event,
    Recording,
    RecordingBlock,
    Stream,
    TickTable,
)
from threadline.twin.prepare import Prepared, State, new_state, prepare

DEFAULT_SETTLE_S = 0.5
_MOST_ROWS = 1 << 16


def simulate(
    commands: TickTable,
    machine: Machine,
    *,
    encoder_phase: FloatArray | None = None,
    record_every: int = 1,
    settle_s: float = DEFAULT_SETTLE_S,
    quantised: bool = True,
) -> Recording:
    """Simulate ``machine`` under ``commands``; nothing runs until the recording is read.

    The machine starts at rest at ``commands.start_counts``. Sample k is taken at the instant of
    tick ``k * record_every``, before the controllers act on it; the commanded position at that
    instant is the sum of the rows before it, and the controllers follow it from then on. After
    the last row the command stands still for ``settle_s``.

    Channels, per axis: ``X.commanded``, ``X.measured``, ``X.load`` and, where it has one,
    ``X.frame`` in m or rad; ``X.voltage`` at the amplifier's input in V; ``X.current`` in A and
    ``X.current_peak``, the value of largest magnitude since the sample before. Then ``operation``
    and one channel for each input, 1 from the instant at which a switch has cut its drive.

    Parameters
    ----------
    encoder_phase
        (axes,) where between two counts each encoder stands at the start, in [0, 1); 0.5, the
        middle, when None.
    record_every
        Ticks from sample to sample.
    settle_s
        How long to go on after the last row.
    quantised
        False leaves out the rounding of encoders and DACs (not their limits): for comparisons.

    Raises
    ------
    MachineError
        If the machine's clocks or parts cannot be simulated.
    OptionError
        If the commands are not for this machine, or an option is out of range.
    """
    check_commands(commands, machine, record_every, settle_s)
    phases = encoder_phases(machine, encoder_phase)
    values = Values.of(machine)
    start_si = commands.start_counts / commands.counts_per_unit
    pieces = tuple(
        prepare(machine, piece, values) for piece in piecewise_linear(machine, values, start_si)
    )
    run = _Run(commands, machine, pieces, phases, record_every, settle_s, quantised)
    return Recording(
        channels=run.channels(),
        blocks=Stream(run.blocks),
        job_sha256=commands.job_sha256,
        machine_sha256=machine.sha256,
        simulated=True,
    )


def check_commands(
    commands: TickTable, machine: Machine, record_every: int, settle_s: float
) -> None:
    """Refuse commands that are not for this machine, and options out of range."""
    if commands.axes != machine.axis_names:
        raise OptionError(
            f"the commands are for axes {', '.join(commands.axes)}, "
            f"the machine {machine.name} has {', '.join(machine.axis_names) or 'none with a loop'}",
            remedy="Give one with the same axes.",
        )
    if commands.clock.period_s != machine.tick_clock.period_s:
        raise OptionError(
            f"the commands have a tick of {float(commands.clock.period_s)} s, "
            f"the machine one of {float(machine.tick_clock.period_s)} s"
        )
    if not np.allclose(commands.counts_per_unit, machine.counts_per_unit, rtol=1e-12, atol=0):
        raise OptionError("the commands have other counts per unit than the machine")
    if record_every < 1:
        raise OptionError(f"record_every must be at least 1, got {record_every}")
    if not 0 <= settle_s <= 3600:
        raise OptionError(f"settle_s must lie in 0 ... 3600 s, got {settle_s}")


class _Run:
    """What the blocks of one recording share; every reading starts anew."""

    def __init__(
        self,
        commands: TickTable,
        machine: Machine,
        pieces: tuple[Prepared, ...],
        phases: FloatArray,
        every: int,
        settle_s: float,
        quantised: bool,
    ) -> None:
        self.commands, self.machine, self.pieces = commands, machine, pieces
        self.phases = dict(zip(machine.axis_names, phases, strict=True))
        self.every, self.quantised = every, quantised
        self.settle_ticks = ceil(settle_s / float(machine.tick_clock.period_s))

    def channels(self) -> tuple[Channel, ...]:
        clock = self.machine.tick_clock
        found = []

        def add(name: str, kind: ChannelKind, unit: str, axis: str = "") -> None:
            found.append(
                Channel(
                    name=name,
                    kind=kind,
                    unit=unit,
                    clock=clock,
                    axis=axis,
                    stride=self.every,
                )
            )

        for name, axis in self.machine.axes.items():
            unit = "m" if axis.kind == "linear" else "rad"
            add(f"{name}.commanded", ChannelKind.COMMANDED, unit, name)
            add(f"{name}.measured", ChannelKind.MEASURED, unit, name)
            add(f"{name}.load", ChannelKind.LOAD, unit, name)
            if axis.frame is not None:
                add(f"{name}.frame", ChannelKind.FRAME, unit, name)
            add(f"{name}.voltage", ChannelKind.VOLTAGE, "V", name)
            add(f"{name}.current", ChannelKind.CURRENT, "A", name)
            add(f"{name}.current_peak", ChannelKind.CURRENT, "A", name)
        add("operation", ChannelKind.OPERATION, "")
        for name, switch in self.machine.inputs.items():
            add(name, ChannelKind.INPUT, "", switch.axis)
        return tuple(found)

    def blocks(self) -> Iterator[RecordingBlock]:
        states = [
            new_state(self.machine, p, self._phases(p), 1, 1, quantised=self.quantised)
            for p in self.pieces
        ]
        start = self.commands.start_counts
        for tick, position, operation, events in self._rows():
            columns = []
            first = -(-tick // self.every)
            count = -(-(tick + len(position)) // self.every) - first
            for state in states:
                columns.append(self._advance(state, position - start, count))
            if not count:
                continue
            kept = slice(first * self.every - tick, None, self.every)
            samples = self._samples(columns, position[kept])
            samples["operation"] = operation[kept].astype(np.float64)
            yield RecordingBlock(
                first_tick={self.machine.tick_clock.name: first * self.every},
                samples=samples,
                events=events,
            )

    def _rows(self) -> Iterator[tuple[int, IntArray, IntArray, tuple[Event, ...]]]:
        """Yield first tick, (n, axes) commanded counts at the ticks, operations and events."""
        tick, last = 0, 0
        position = self.commands.start_counts.copy()
        for block in self.commands:
            for at in range(0, len(block), _MOST_ROWS):
                counts = block.counts[at : at + _MOST_ROWS]
                operation = block.operation[at : at + _MOST_ROWS]
                end = tick + len(counts)
                after = position + np.cumsum(counts, axis=0)
                rows = np.concatenate((position[None], after[:-1]))
                events = tuple(e for e in block.events if tick <= e.tick < end)
                yield tick, rows, operation, events
                position, tick, last = after[-1], end, int(operation[-1])
        # One more than the settling ticks: the instant at which the last of them ends.
        left = self.settle_ticks + 1
        while left:
            count = min(left, _MOST_ROWS)
            still = np.broadcast_to(position, (count, len(position)))
            yield tick, still, np.full(count, last), ()
            tick, left = tick + count, left - count

    def _phases(self, piece: Prepared) -> FloatArray:
        owner = {axis.controller: name for name, axis in self.machine.axes.items()}
        names = [owner.get(c) for c in piece.piece.group.controllers]
        return np.array([[0.5 if n is None else self.phases[n] for n in names]])

    def _advance(self, state: State, travelled: IntArray, count: int) -> FloatArray:
        group = state.prepared.piece.group
        names = self.machine.axis_names
        references = np.zeros((len(travelled), len(group.controllers)))
        for axis, controller in zip(group.axes, state.prepared.axis_controller, strict=True):
            references[:, controller] = travelled[:, names.index(axis)]
        records = np.zeros((1, count, state.prepared.columns, 1))
        state.run(0, 1, references, self.every, 0, records)
        why = state.failure()
        if why:
            raise MachineError(
                f"axes {', '.join(group.axes)}: the simulation has no answer, {why}",
                remedy="Check stiffness, friction and gains in the machine file.",
            )
        return records[0, :, :, 0]

    def _samples(self, columns: list[FloatArray], commanded: IntArray) -> dict[str, FloatArray]:
        samples: dict[str, FloatArray] = {}
        names = self.machine.axis_names
        for piece, records in zip(self.pieces, columns, strict=True):
            group = piece.piece.group
            loads = 2 * len(group.controllers)
            currents = loads + 2 * len(group.axes)
            for index, name in enumerate(group.axes):
                axis, at = self.machine.axes[name], names.index(name)
                scale = axis.counts.si
                start = int(self.commands.start_counts[at])
                controller = int(piece.axis_controller[index])
                drive = int(piece.control.drive[controller])
                samples[f"{name}.commanded"] = commanded[:, at] / scale
                samples[f"{name}.measured"] = (start + records[:, 2 * controller]) / scale
                samples[f"{name}.load"] = start / scale + records[:, loads + 2 * index]
                if axis.frame is not None:
                    samples[f"{name}.frame"] = records[:, loads + 2 * index + 1]
                samples[f"{name}.voltage"] = records[:, 2 * controller + 1]
                samples[f"{name}.current"] = records[:, currents + 2 * drive]
                samples[f"{name}.current_peak"] = records[:, currents + 2 * drive + 1]
            for index, name in enumerate(group.inputs):
                samples[name] = records[:, currents + 2 * len(group.drives) + index]
        return samples


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
