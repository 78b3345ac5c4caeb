"""Recordings in ``.npz`` files: every channel, clock and event, without loss."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from threadline.base.reading import KnownFile
from threadline.errors import Place, RecordingError
from threadline.files.formats.archive import ColumnArchive, ColumnReader, ColumnSpool
from threadline.files.formats.common import (
    Written,
    atomic_file,
    clear_errors,
    in_si,
    reading,
    written,
)
from threadline.files.formats.recording_meta import (
    OPERATION_REMEDY,
    TITLE,
    EventColumns,
    EventSpool,
    operation_fault,
    recording_from,
    recording_meta,
)
from threadline.files.recording import Channel, ChannelKind, Recording, RecordingBlock

MAX_BLOCK_SAMPLES = 1 << 26
"""Largest number of samples in one block, over all channels: a block is kept in memory."""

_PLAIN = re.compile(r"[A-Za-z][A-Za-z0-9_.-]{0,60}")
_TAKEN = {"blocks", "event_tick", "event_kind", "event_operation", "event_name", "event_value"}


def _column_names(channels: tuple[Channel, ...]) -> list[str]:
    """Return a column name for each channel: the channel's name if it is a valid file name."""
    return [
        c.name
        if _PLAIN.fullmatch(c.name) and c.name not in _TAKEN and not c.name.startswith("channel-")
        else f"channel-{k}"
        for k, c in enumerate(channels)
    ]


def _clock_names(channels: tuple[Channel, ...]) -> list[str]:
    return list(dict.fromkeys(c.clock.name for c in channels))


def write_recording_npz(recording: Recording, path: Path) -> Written:
    """Write ``recording`` as an archive of columns: ``numpy.load(path)["X.load"]`` is (n,).

    Only one block is in memory; the columns grow in temporary files beside ``path``.

    Raises
    ------
    RecordingError
        If a block has too many samples, or the file cannot be written.
    """
    channels = recording.channels
    names, clocks = _column_names(channels), _clock_names(channels)
    meta = {"format": TITLE, **recording_meta(recording)}
    with atomic_file(path) as file, ColumnSpool(Path(file.name).parent) as spool:
        # One row per block: first tick of each clock, samples of each channel, events.
        spool.column("blocks", "<i8", (len(clocks) + len(channels) + 1,))
        for name in names:
            spool.column(name, "<f8")
        events = EventSpool(spool)
        for block in recording:
            arrays = [block.samples[channel.name] for channel in channels]
            lengths = [len(array) for array in arrays]
            if sum(lengths) > MAX_BLOCK_SAMPLES:
                raise RecordingError(
                    f"a block has {sum(lengths)} samples, limit {MAX_BLOCK_SAMPLES}",
                    remedy="Record in smaller blocks.",
                )
            first_ticks = [block.first_tick[clock] for clock in clocks]
            spool.append("blocks", np.array([*first_ticks, *lengths, len(block.events)]))
            for name, array in zip(names, arrays, strict=True):
                spool.append(name, array)
            events.append(block.events)
        spool.pack(file, {**meta, "event_names": events.names})
    return written(path)


def read_recording_npz(path: Path) -> Recording:
    """Read a file that ``write_recording_npz`` wrote; samples stay in the file until they are used.

    Raises
    ------
    RecordingError
        If it is damaged or not a recording.
    """
    with clear_errors(path), ColumnArchive(path) as archive:
        meta = archive.meta()
        if not isinstance(meta, dict) or meta.pop("format", None) != TITLE:
            raise RecordingError(
                "the archive does not hold a recording of a known version",
                place=Place(str(path)),
                remedy="Give a recording, not a tick table.",
            )
        event_names = meta.pop("event_names", None)
        if not isinstance(event_names, list) or not all(isinstance(n, str) for n in event_names):
            raise RecordingError("event_names is not a list of names", place=Place(str(path)))
        recording = recording_from(meta, path, _blocks, tuple(event_names))
        _open(archive, recording.channels, event_names, path)
        archive.verify()
    return in_si(recording, Place(str(path)))


def _open(
    archive: ColumnArchive, channels: tuple[Channel, ...], event_names: Sequence[str], path: Path
) -> tuple[ColumnReader, list[ColumnReader], EventColumns]:
    width = len(_clock_names(channels)) + len(channels) + 1
    blocks = archive.column("blocks", "<i8", (width,))
    columns = [archive.column(name, "<f8") for name in _column_names(channels)]
    return blocks, columns, EventColumns(archive, event_names, Place(str(path)))


def _blocks(
    known_file: KnownFile, channels: tuple[Channel, ...], event_names: tuple[str, ...]
) -> Iterator[RecordingBlock]:
    path, clocks = known_file.path, _clock_names(channels)
    with reading(known_file), ColumnArchive(path) as archive:
        blocks, columns, events = _open(archive, channels, event_names, path)
        left_counts = np.array([*(column.rows for column in columns), events.left])
        for rows in blocks.runs(1024):
            for row in rows:
                first_ticks, lengths = row[: len(clocks)], row[len(clocks) :]
                _check_block(lengths, left_counts, path)
                left_counts -= lengths
                yield RecordingBlock(
                    first_tick=dict(zip(clocks, first_ticks.tolist(), strict=True)),
                    samples=_samples(channels, columns, lengths, path),
                    events=tuple(events.take(int(lengths[-1]))),
                )
        if left_counts.any():
            raise RecordingError(
                f"{int(left_counts.sum())} samples or events belong to no block",
                place=Place(str(path)),
                remedy="The file is damaged.",
            )


def _samples(
    channels: tuple[Channel, ...], columns: list[ColumnReader], lengths: Any, path: Path
) -> dict[str, Any]:
    samples = {
        channel.name: column.take(int(length))
        for channel, column, length in zip(channels, columns, lengths[:-1], strict=True)
    }
    for channel in channels:
        if channel.kind is ChannelKind.OPERATION:
            # Each operation lasts many samples, so only a few distinct values need a check.
            for value in np.unique(samples[channel.name]).tolist():
                if (fault := operation_fault(value)) is not None:
                    raise RecordingError(fault, place=Place(str(path)), remedy=OPERATION_REMEDY)
    return samples


def _check_block(lengths: Any, left_counts: Any, path: Path) -> None:
    # No length may exceed the rows left in the file, so that the sum of lengths cannot overflow.
    if (
        (lengths >= 0).all()
        and (lengths <= left_counts).all()
        and lengths.sum() <= MAX_BLOCK_SAMPLES
    ):
        return
    raise RecordingError(
        f"a block claims {lengths.tolist()} samples; {left_counts.tolist()} are left, "
        f"limit {MAX_BLOCK_SAMPLES} at once",
        place=Place(str(path)),
        remedy="The file is damaged.",
    )
