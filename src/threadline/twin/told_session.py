"""A simulated machine whose drives are told positions, which takes its rows piece by piece."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.errors import OptionError
from threadline.machine import Machine
from threadline.signals import Channel, ChannelKind, Ended, RecordingBlock
from threadline.twin.channels import encoder_phases
from threadline.twin.prescribed import Advance, Moving, advances_of, in_order
from threadline.twin.row_session import RowSession
from threadline.twin.session_part import Part


class ToldSession(RowSession):
    """One machine whose drives are told positions, under rows that arrive piece by piece.

    Channels, per axis: ``X.commanded``, ``X.load`` and, where it has one, ``X.frame`` in m or rad;
    ``X.torque_share``, the torque asked of the drive over what it has at its speed, its largest
    since the sample before. Then ``operation``. Of a machine without dynamics ``X.commanded`` and
    ``operation`` are all that is known.

    Where a run of a belt falls slack it has failed: it tells of a fault, and nothing is known from
    there on.

    Parameters
    ----------
    machine
        What is driven; it starts at rest.
    start_counts
        (axes,) commanded position before the first row; 0 when None.
    phases
        (axes,) where in a full step each stepper stands at the start, in [0, 1); 0.5 when None.
    record_every
        Ticks from sample to sample.
    advances
        Those of ``advances_of(machine)``, where they are there already; it saves time.

    Raises
    ------
    MachineError
        If an axis has a loop, or a part is not linear.
    OptionError
        If a number or a phase is out of range.
    """

    def __init__(
        self,
        machine: Machine,
        *,
        start_counts: IntArray | None = None,
        phases: FloatArray | None = None,
        record_every: int = 1,
        advances: Sequence[Advance] | None = None,
    ) -> None:
        if record_every < 1:
            raise OptionError(f"record_every must be at least 1, got {record_every}")
        super().__init__(machine, start_counts)
        at = encoder_phases(machine, phases)
        self._every = record_every
        found = advances_of(machine) if advances is None else advances
        self._pieces = [Moving(machine, advance, at) for advance in found]
        self.channels = told_channels(machine, record_every)
        self._tick = 0
        self._carried: FloatArray = np.zeros(len(machine.axes))

    @property
    def tick(self) -> int:
        """Ticks of the machine's clock so far."""
        return self._tick

    def _tripped(self, name: str) -> bool:
        raise OptionError(f"{self._machine.name} has no limit switch {name}")

    def _read(self, part: Part) -> Mapping[Any, FloatArray]:
        travelled = np.concatenate((part.travelled, self._position[None]))
        ran = [(piece.advance, *piece.run(travelled)) for piece in self._pieces]
        known, why = min(
            (far for _, _, _, far in ran), key=lambda far: far[0], default=(len(part.operation), "")
        )
        read: dict[str, FloatArray] = {}
        for advance, whole, share, _ in ran:
            piece = advance.piece
            for index, name in enumerate(piece.axes):
                axis, at = self._machine.axes[name], self._machine.axis_names.index(name)
                offset = self._start[at] / axis.counts.si
                read[f"{name}.load"] = offset + in_order(whole, piece.loads[index][None])[:known, 0]
                if piece.has_frame[index]:
                    read[f"{name}.frame"] = in_order(whole, piece.frames[index][None])[:known, 0]
                drive = piece.drives.index(axis.drive)
                read[f"{name}.torque_share"] = share[:known, drive]
        if why:
            self._fail(self._tick + known, int(part.operation[known]), why)
            part.travelled, part.operation = part.travelled[:known], part.operation[:known]
        self._tick += known
        return read

    def _fail(self, tick: int, operation: int, why: str) -> None:
        """Tell of the fault that ends everything at ``tick``, and of nothing behind it."""
        self._told = [event for event in self._told if event.tick < tick]
        self._rows.clear()
        self._events.clear()
        self.failed, self._operation = True, operation
        self._halted, self._held = None, False
        self._ended, self._final = (Ended.FAULT, why), True
        self._tell("fault", tick=tick, name=why)

    def _block(self, first: int, parts: list[Part]) -> RecordingBlock:
        begin = -(-first // self._every)
        kept = slice(begin * self._every - first, None, self._every)
        axes = len(self._machine.axes)
        nothing = np.zeros((0, axes), dtype=np.int64)
        position = self._start + np.concatenate([nothing, *(part.travelled for part in parts)])
        samples: dict[str, FloatArray] = {}
        for channel in self.channels[:-1]:
            name, at = channel.name, self._machine.axis_names.index(channel.axis)
            if channel.kind is ChannelKind.COMMANDED:
                samples[name] = position[kept, at] / self._machine.axes[channel.axis].counts.si
                continue
            values = np.concatenate([np.empty(0), *(part.read[name] for part in parts)])
            if channel.kind is ChannelKind.TORQUE_SHARE:
                samples[name], self._carried[at] = _since(values, kept, self._carried[at])
            else:
                samples[name] = values[kept]
        operation = np.concatenate([nothing[:, 0], *(part.operation for part in parts)])
        samples["operation"] = operation[kept].astype(np.float64)
        events, self._told = tuple(self._told), []
        clock = self._machine.tick_clock.name
        return RecordingBlock(
            first_tick={clock: begin * self._every}, samples=samples, events=events
        )


def told_channels(machine: Machine, every: int) -> tuple[Channel, ...]:
    """Return the channels of a machine whose drives are told positions."""
    return tuple(_channels(machine, every))


def _channels(machine: Machine, every: int) -> Iterator[Channel]:
    clock = machine.tick_clock
    for name, axis in machine.axes.items():
        unit = "m" if axis.kind == "linear" else "rad"
        kinds = [("commanded", ChannelKind.COMMANDED, unit)]
        if not machine.without_dynamics:
            kinds.append(("load", ChannelKind.LOAD, unit))
            if axis.frame is not None:
                kinds.append(("frame", ChannelKind.FRAME, unit))
            kinds.append(("torque_share", ChannelKind.TORQUE_SHARE, ""))
        for ending, kind, own in kinds:
            yield Channel(
                name=f"{name}.{ending}", kind=kind, unit=own, clock=clock, axis=name, stride=every
            )
    yield Channel(name="operation", kind=ChannelKind.OPERATION, unit="", clock=clock, stride=every)


def _since(share: FloatArray, kept: slice, carried: float) -> tuple[FloatArray, float]:
    """Return the largest share since the sample before, and since the last one of these."""
    at = np.arange(len(share))[kept]
    if not len(at):
        return np.empty(0), float(max(carried, share.max(initial=0.0)))
    begins = np.concatenate(([0], at[:-1] + 1))
    largest = np.maximum.reduceat(share[: at[-1] + 1], begins)
    largest[0] = max(largest[0], carried)
    return largest, float(share[at[-1] + 1 :].max(initial=0.0))
