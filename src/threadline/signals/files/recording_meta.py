"""The description of a recording, which its files hold besides the samples."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import ConfigDict, Field, TypeAdapter
from pydantic.dataclasses import dataclass

from threadline import __version__
from threadline.errors import Place, RecordingError
from threadline.input_files import KnownFile
from threadline.signals.clock import Clock
from threadline.signals.files.common import (
    FractionText,
    Hash,
    Label,
    checked_meta,
    fraction_text,
    positive_fraction,
)
from threadline.signals.recording import Channel, ChannelKind, Recording, RecordingBlock
from threadline.signals.stream import Stream

TITLE = "recording 1"
OPERATION_REMEDY = (
    "Write the number of the operation that is under way, or leave the column out: "
    "see docs/files.md."
)
_MOST_OPERATIONS = float(2**53)
_STRICT = ConfigDict(extra="forbid")


@dataclass(frozen=True, config=_STRICT)
class ChannelMeta:
    """A channel as it stands in a file."""

    name: Label
    kind: ChannelKind
    unit: Annotated[str, Field(max_length=20)]
    clock: Label
    axis: Annotated[str, Field(max_length=20)]
    stride: Annotated[int, Field(strict=True, ge=1, le=2**40)]


@dataclass(frozen=True, config=_STRICT)
class RecordingMeta:
    """The description of a recording as it stands in a file."""

    version: Label
    clocks: dict[Label, FractionText]
    channels: Annotated[tuple[ChannelMeta, ...], Field(max_length=400)]
    simulated: Annotated[bool, Field(strict=True)]
    job_sha256: Hash
    machine_sha256: Hash
    origin: Mapping[str, str]


_META = TypeAdapter(RecordingMeta)


def recording_meta(recording: Recording) -> dict[str, Any]:
    """Return the description of ``recording`` for a file.

    Raises
    ------
    RecordingError
        If channels share a name, or clocks of different periods do.
    """
    clocks: dict[str, str] = {}
    names: set[str] = set()
    for channel in recording.channels:
        period = fraction_text(channel.clock.period_s)
        if clocks.setdefault(channel.clock.name, period) != period:
            raise RecordingError(f"clock {channel.clock.name!r} has two periods")
        if channel.name in names:
            raise RecordingError(f"two channels are called {channel.name!r}")
        names.add(channel.name)
    return {
        "version": __version__,
        "clocks": clocks,
        "channels": [
            {
                "name": c.name,
                "kind": c.kind.value,
                "unit": c.unit,
                "clock": c.clock.name,
                "axis": c.axis,
                "stride": c.stride,
            }
            for c in recording.channels
        ],
        "simulated": recording.simulated,
        "job_sha256": recording.job_sha256,
        "machine_sha256": recording.machine_sha256,
        "origin": dict(recording.origin),
    }


def operation_fault(value: float) -> str | None:
    """Return what is wrong with a sample of a channel of operations, or None.

    Operations are counted from 0; -1 stands for none.
    """
    if -1.0 <= value <= _MOST_OPERATIONS and value.is_integer():
        return None
    return f"the operation {value:.12g} is no whole number from 0 on, nor -1 for none"


def recording_from(
    meta: Any, path: Path, samples: Callable[..., Iterator[RecordingBlock]], *given: object
) -> Recording:
    """Return the recording of a file's description and samples.

    Parameters
    ----------
    meta
        The description, as it was read.
    path
        The file.
    samples
        Called for each reading with the file and its hash, the channels, and the arguments
        ``given``; it yields the blocks.

    Raises
    ------
    RecordingError
        If the description is wrong.
    """
    found = checked_meta(_META, meta, path)
    place = Place(str(path))
    clocks = {n: Clock(n, positive_fraction(p, place)) for n, p in found.clocks.items()}
    channels = []
    for channel in found.channels:
        if channel.clock not in clocks:
            raise RecordingError(
                f"channel {channel.name!r} is on the clock {channel.clock!r}, which is not given",
                place=place,
            )
        channels.append(
            Channel(
                name=channel.name,
                kind=channel.kind,
                unit=channel.unit,
                clock=clocks[channel.clock],
                axis=channel.axis,
                stride=channel.stride,
            )
        )
    if len({channel.name for channel in channels}) < len(channels):
        raise RecordingError("two channels have the same name", place=place)
    return Recording(
        channels=tuple(channels),
        blocks=Stream(samples, KnownFile.of(path), tuple(channels), *given),
        job_sha256=found.job_sha256,
        machine_sha256=found.machine_sha256,
        simulated=found.simulated,
        origin=dict(found.origin),
    )
