"""What the latest report of a machine says of its axes, inputs and outputs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from threadline.arrays import IntArray
from threadline.machine import Machine
from threadline.signals import Channel, ChannelKind

_STATES = (ChannelKind.INPUT, ChannelKind.OUTPUT)
_PLACES = (ChannelKind.COMMANDED, ChannelKind.MEASURED, ChannelKind.LOAD)


def positions(
    channels: Iterable[Channel],
    latest: Mapping[str, float],
    machine: Machine,
    stands: IntArray | None,
) -> dict[str, list[float | None]]:
    """Return commanded, measured and load position of all that moves, SI; None where not known.

    Of an axis that is not homed no position is known, whatever its encoder counts.

    Parameters
    ----------
    channels
        Channels that the machine reports.
    latest
        The last sample of each, by its name.
    machine, stands
        The machine, and its (axes,) commanded position in counts, for what was not reported yet;
        None where it is not homed.
    """
    found: dict[str, list[float | None]] = {name: [None, None, None] for name in machine.axes}
    if stands is not None:
        for name, at in zip(machine.axes, (stands / machine.counts_per_unit).tolist(), strict=True):
            found[name][0] = at
    for channel in channels:
        if stands is None and channel.axis in machine.axes:
            continue
        if channel.kind in _PLACES and channel.axis:
            row = found.setdefault(channel.axis, [None, None, None])
            column = _PLACES.index(channel.kind)
            row[column] = latest.get(channel.name, row[column])
    return found


def signals(channels: Iterable[Channel], latest: Mapping[str, float]) -> dict[str, float]:
    """Return the state of every input and output that was reported."""
    return {
        channel.name: latest[channel.name]
        for channel in channels
        if channel.kind in _STATES and not channel.axis and channel.name in latest
    }
