"""Conversion of the channels of a recording that was read to SI units."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

from threadline.errors import Place, RecordingError, UnitError
from threadline.signals.files.columns import units_of
from threadline.signals.recording import Channel, Recording, RecordingBlock
from threadline.signals.stream import Stream
from threadline.units import unit_factor


def in_si(recording: Recording, place: Place) -> Recording:
    """Return ``recording`` with every channel in the SI unit of its kind.

    A file may give positions in mm or deg, voltages in mV and currents in mA; such samples are
    multiplied while they are read. A recording in SI units is returned as it is.

    Raises
    ------
    RecordingError
        If the unit of a channel does not suit its kind, or its kind has no unit.
    """
    factors: dict[str, float] = {}
    channels = []
    for channel in recording.channels:
        unit, factor = _si(channel, place)
        channels.append(replace(channel, unit=unit))
        if factor != 1.0:
            factors[channel.name] = factor
    if factors:
        recording = replace(recording, blocks=Stream(_scaled, recording.blocks, factors))
    return replace(recording, channels=tuple(channels))


def _si(channel: Channel, place: Place) -> tuple[str, float]:
    units = units_of(channel.kind)
    if not units:
        if channel.unit:
            raise RecordingError(
                f"channel {channel.name!r} is of kind {channel.kind.value}, which has no unit; "
                f"it is in {channel.unit!r}",
                place=place,
                remedy="Leave its unit empty.",
            )
        return "", 1.0
    for unit in units:
        try:
            return unit, unit_factor(channel.unit, unit)
        except UnitError:
            continue
    raise RecordingError(
        f"channel {channel.name!r} is of kind {channel.kind.value} and in {channel.unit!r}, "
        f"which is not a unit like {' or '.join(units)}",
        place=place,
        remedy="Give its samples in such a unit, and name it.",
    )


def _scaled(
    blocks: Iterable[RecordingBlock], factors: Mapping[str, float]
) -> Iterator[RecordingBlock]:
    for block in blocks:
        samples = {
            name: values * factors[name] if name in factors else values
            for name, values in block.samples.items()
        }
        yield replace(block, samples=samples)
