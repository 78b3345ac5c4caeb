"""What a recording of a machine with axes holds, and how it comes from what the engine reads."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.errors import OptionError
from threadline.machine import Machine
from threadline.signals import Channel, ChannelKind
from threadline.twin.kernel import Reading, Signal


def tick_channels(machine: Machine, every: int) -> tuple[Channel, ...]:
    """Return the channels of a recording with a sample every so many ticks."""
    clock = machine.tick_clock
    found = []

    def add(name: str, kind: ChannelKind, unit: str, axis: str = "") -> None:
        found.append(Channel(name=name, kind=kind, unit=unit, clock=clock, axis=axis, stride=every))

    for name, axis in machine.axes.items():
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
    for name, switch in machine.inputs.items():
        add(name, ChannelKind.INPUT, "", switch.axis)
    return tuple(found)


def samples_of(
    machine: Machine,
    start_counts: IntArray,
    read: Mapping[Reading, FloatArray],
    travelled: IntArray,
) -> dict[str, FloatArray]:
    """Return the samples of every channel but the operation.

    Parameters
    ----------
    start_counts
        (axes,) commanded position before the first row.
    read
        (n, 1) of every reading.
    travelled
        (n, axes) counts commanded since then.
    """
    samples: dict[str, FloatArray] = {}
    for at, (name, axis) in enumerate(machine.axes.items()):
        scale, start = axis.counts.si, float(start_counts[at])

        def of(signal: Signal, name: str = name) -> FloatArray:
            return read[Reading(signal, name)][:, 0]

        # Counts below 2^53 are exact as floats: one new array for a channel, divided in place.
        for channel, counts in (("commanded", travelled[:, at]), ("measured", of(Signal.READ))):
            whole = (counts + start).astype(np.float64, copy=False)
            whole /= scale
            samples[f"{name}.{channel}"] = whole
        samples[f"{name}.load"] = start / scale + of(Signal.LOAD)
        if axis.frame is not None:
            samples[f"{name}.frame"] = of(Signal.FRAME)
        samples[f"{name}.voltage"] = of(Signal.VOLTS)
        samples[f"{name}.current"] = of(Signal.CURRENT)
        samples[f"{name}.current_peak"] = of(Signal.CURRENT_PEAK)
    for name in machine.inputs:
        samples[name] = read[Reading(Signal.TRIPPED, name)][:, 0]
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
