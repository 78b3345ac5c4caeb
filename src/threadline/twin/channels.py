"""Channels of a recording of a machine with axes, and their samples from engine readings."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.errors import OptionError
from threadline.files import Channel, ChannelKind
from threadline.machine import Machine
from threadline.machine.parts import Encoder, Potentiometer
from threadline.twin.kernel import Reading, Signal

TENSION = Reading(Signal.TENSION, "tension")
"""The tension of the fibre, which the session simulates beside the engine."""


def tick_channels(
    machine: Machine, every: int, kinds: Collection[ChannelKind] = tuple(ChannelKind)
) -> tuple[Channel, ...]:
    """Return the channels of ``kinds`` of a recording with a sample every ``every`` ticks."""
    clock = machine.tick_clock
    found = []

    def add(name: str, kind: ChannelKind, unit: str, axis: str = "") -> None:
        found.append(Channel(name=name, kind=kind, unit=unit, clock=clock, axis=axis, stride=every))

    for name, axis in machine.axes.items():
        unit = "m" if axis.kind == "linear" else "rad"
        add(f"{name}.commanded", ChannelKind.COMMANDED, unit, name)
        add(f"{name}.measured", ChannelKind.MEASURED, unit, name)
        add(f"{name}.load", ChannelKind.LOAD, unit, name)
        add(f"{name}.velocity", ChannelKind.VELOCITY, f"{unit}/s", name)
        if axis.frame is not None:
            add(f"{name}.frame", ChannelKind.FRAME, unit, name)
        add(f"{name}.voltage", ChannelKind.VOLTAGE, "V", name)
        add(f"{name}.current", ChannelKind.CURRENT, "A", name)
        add(f"{name}.current_peak", ChannelKind.CURRENT, "A", name)
    for name in machine.observing:
        add(f"{name}.sensor", ChannelKind.SENSOR, unit_of(machine, name))
    if machine.unwinds:
        add("tension", ChannelKind.TENSION, "N")
    add("operation", ChannelKind.OPERATION, "")
    for name, switch in machine.inputs.items():
        add(name, ChannelKind.INPUT, "", switch.axis)
    return tuple(c for c in found if c.kind in kinds)


def unit_of(machine: Machine, name: str) -> str:
    """Return the unit of a sensor's readings."""
    sensor = machine.sensors[name]
    if isinstance(sensor, Encoder):
        return "count"
    if isinstance(sensor, Potentiometer):
        return "V"
    body = machine.bodies[next(iter(sensor.reads))]
    return "m/s^2" if body.kind == "linear" else "rad/s^2"


_SIGNALS = {
    "measured": Signal.READ,
    "load": Signal.LOAD,
    "velocity": Signal.RATE,
    "frame": Signal.FRAME,
    "voltage": Signal.VOLTS,
    "current": Signal.CURRENT,
    "current_peak": Signal.CURRENT_PEAK,
}


def readings_of(channels: Sequence[Channel]) -> dict[str, Reading]:
    """Return the engine reading of each channel that has one."""
    found = {}
    for channel in channels:
        ending = channel.name.rpartition(".")[2]
        if channel.kind is ChannelKind.TENSION:
            found[channel.name] = TENSION
        elif channel.kind is ChannelKind.INPUT:
            found[channel.name] = Reading(Signal.TRIPPED, channel.name)
        elif channel.kind is ChannelKind.SENSOR:
            found[channel.name] = Reading(Signal.OBSERVED, channel.name.removesuffix(".sensor"))
        elif channel.axis and ending in _SIGNALS:
            found[channel.name] = Reading(_SIGNALS[ending], channel.axis)
    return found


@dataclass(frozen=True, slots=True)
class Source:
    """Source of a channel.

    Parameters
    ----------
    name, kind
        Of the channel.
    reading
        Its engine reading; None for the command.
    axis
        Column of its axis for a position, else 0.
    scale, start
        Counts per m or rad of that axis, and its position in counts before the first row.
    """

    name: str
    kind: ChannelKind
    reading: Reading | None
    axis: int = 0
    scale: float = 1.0
    start: float = 0.0


_PLACES = (ChannelKind.COMMANDED, ChannelKind.MEASURED, ChannelKind.LOAD)


def sources_of(
    machine: Machine, channels: Sequence[Channel], start_counts: IntArray
) -> tuple[Source, ...]:
    """Return the source of every channel except the operation.

    Parameters
    ----------
    start_counts
        (axes,) commanded position before the first row.
    """
    readings, names, found = readings_of(channels), machine.axis_names, []
    for channel in channels:
        reading = readings.get(channel.name)
        if channel.kind in _PLACES:
            at = names.index(channel.axis)
            scale, start = machine.axes[channel.axis].counts.si, float(start_counts[at])
            found.append(Source(channel.name, channel.kind, reading, at, scale, start))
        elif reading is not None:
            found.append(Source(channel.name, channel.kind, reading))
    return tuple(found)


def samples_of(
    sources: Sequence[Source], read: Mapping[Reading, FloatArray], travelled: IntArray
) -> dict[str, FloatArray]:
    """Return the samples of every channel except the operation.

    Parameters
    ----------
    sources
        Sources of the channels.
    read
        (n, runs) values of every reading.
    travelled
        (n, axes) commanded counts since the first row, the same for all runs.

    Returns
    -------
    dict
        (n,) per channel; with several runs (n, runs), except for common channels.
    """
    samples: dict[str, FloatArray] = {}
    for source in sources:
        if source.reading is None:
            counts: FloatArray | IntArray = travelled[:, source.axis]
        else:
            values = read[source.reading]
            samples[source.name] = counts = values[:, 0] if values.shape[1] == 1 else values
        if source.kind is ChannelKind.LOAD:
            # Readings are not shared, so the sum is in place and keeps the memory order. With many
            # runs the array exceeds the cache, so a sum with 0 is skipped.
            if source.start or counts.ndim == 1:
                samples[source.name] = np.add(source.start / source.scale, counts, out=counts)
        elif source.kind in _PLACES:
            # Counts below 2^53 are exact as floats: one new array, divided in place.
            whole = (counts + source.start).astype(np.float64, copy=False)
            whole /= source.scale
            samples[source.name] = whole
    return samples


def encoder_phases(machine: Machine, phase: FloatArray | None) -> FloatArray:
    """Return the (axes,) encoder phases: position of each encoder between two counts at rest.

    Raises
    ------
    OptionError
        If a phase is outside [0, 1), or the number of phases is wrong.
    """
    count = len(machine.axes)
    phases = np.full(count, 0.5) if phase is None else np.asarray(phase, dtype=np.float64)
    if phases.shape != (count,):
        raise OptionError(f"encoder_phase has shape {phases.shape}, expected {(count,)}")
    if not ((phases >= 0.0) & (phases < 1.0)).all():
        raise OptionError(f"encoder_phase must lie in [0, 1), got {phases.tolist()}")
    return phases


def run_phases(machine: Machine, phase: FloatArray | None, runs: int) -> FloatArray:
    """Return (runs, axes) encoder phases; phases of shape (axes,) apply to all runs.

    Raises
    ------
    OptionError
        As ``encoder_phases``; or if the number of runs differs.
    """
    given = None if phase is None else np.asarray(phase, dtype=np.float64)
    if given is None or given.ndim == 1:
        return np.broadcast_to(encoder_phases(machine, given), (runs, len(machine.axes)))
    if given.shape != (runs, len(machine.axes)):
        raise OptionError(
            f"encoder_phase has shape {given.shape}, expected {(runs, len(machine.axes))}"
        )
    if not ((given >= 0.0) & (given < 1.0)).all():
        raise OptionError("encoder_phase must lie in [0, 1)")
    return given
