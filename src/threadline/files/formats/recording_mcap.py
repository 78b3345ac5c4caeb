"""Recordings in MCAP files, written block by block and readable after a crash of the writer.

MCAP (mcap.dev) is a container of messages. The schema holds the channels, their clocks and the
hashes of job and machine. Each block is one message in one chunk, which is complete in the file,
with its checksum, as soon as it is written. The end of the file holds a checksum of all chunks and
a checksum of the index that follows them. A file with a wrong checksum is refused. A file without
checksums is refused as well, because damage to it would not be noticed.
"""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import IO, Any

import lz4.frame
import numpy as np
import zstandard
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Chunk, Message, Schema
from mcap.stream_reader import breakup_chunk

from threadline.base.reading import KnownFile
from threadline.errors import Place, RecordingError
from threadline.files.clock import Event
from threadline.files.formats.common import (
    Written,
    atomic_file,
    clear_errors,
    in_si,
    parse_json,
    reading,
    written,
)
from threadline.files.formats.mcap_chunks import MAGIC, ChunkedMessages
from threadline.files.formats.recording_meta import (
    OPERATION_REMEDY,
    TITLE,
    event_from,
    event_item,
    operation_fault,
    recording_from,
    recording_meta,
)
from threadline.files.recording import Channel, ChannelKind, Recording, RecordingBlock

ENCODING = "threadline-block-1"
BROKEN_OFF = "the trace breaks off: the program that wrote it ended before the run ended"
_MOST_RECORD_BYTES = 1 << 28
_MOST_BLOCK_BYTES = _MOST_RECORD_BYTES - (2 << 20)  # leaves room for the description in the chunk
_LENGTH = struct.Struct("<I")
_RECORD = struct.Struct("<BQ")  # kind and length
_CRC = struct.Struct("<I")
_CHUNK_HEAD = struct.Struct("<QQQII")  # times, size, checksum, length of the compression's name
_SIZE = struct.Struct("<Q")
_FOOTER = _RECORD.pack(Opcode.FOOTER, 8 + 8 + _CRC.size)
_PROFILE = "threadline"
_UNREAD: dict[int, Any] = {
    Opcode.HEADER: records.Header,
    Opcode.CHANNEL: records.Channel,
    Opcode.MESSAGE_INDEX: records.MessageIndex,
    Opcode.ATTACHMENT: records.Attachment,
    Opcode.METADATA: records.Metadata,
}
"""Kinds of records that may occur in the data section and are ignored."""
_encoded = json.JSONEncoder(ensure_ascii=False, allow_nan=False).encode
_ENDING = len(_FOOTER) + 8 + 8 + _CRC.size + len(MAGIC)  # bytes of a footer and the magic after it


class TraceWriter:
    """Writes a recording during the run; each block is flushed to the file immediately.

    Parameters
    ----------
    file
        A file opened for writing; the caller closes it.
    recording
        Description of the recording: its channels and origin are written; its blocks are not read.
    """

    def __init__(self, file: IO[bytes], recording: Recording) -> None:
        self._file = file
        meta = {"format": TITLE, **recording_meta(recording)}
        text = json.dumps(meta, ensure_ascii=False, sort_keys=True, allow_nan=False)
        self._messages = ChunkedMessages(
            file, _PROFILE, "threadline", "recording", "threadline.recording", ENCODING,
            text.encode(),
        )  # fmt: skip
        self._names = [channel.name for channel in recording.channels]
        self._clock = recording.channels[0].clock
        period_ns = self._clock.period_s * 10**9
        self._period_ns = int(period_ns) if period_ns.denominator == 1 else period_ns

    def write(self, block: RecordingBlock) -> None:
        """Write a block.

        Raises
        ------
        RecordingError
            If the block is too large for one chunk.
        """
        samples = block.samples
        arrays = [np.ascontiguousarray(samples[name], "<f8") for name in self._names]
        head = {
            "first": dict(block.first_tick),
            "lengths": list(map(len, arrays)),
            "events": [event_item(event) for event in block.events],
        }
        text = _encoded(head).encode()
        data = b"".join([_LENGTH.pack(len(text)), text, *(array.data for array in arrays)])
        if len(data) > _MOST_BLOCK_BYTES:
            raise RecordingError(
                f"a block has {len(data)} bytes, limit {_MOST_BLOCK_BYTES}",
                remedy="Record in smaller blocks.",
            )
        tick = block.first_tick[self._clock.name]
        at_ns = max(round(self._period_ns * tick), 0)
        self._messages.write(at_ns, data)
        self._file.flush()

    def finish(self) -> None:
        """Write the end of the file; a file without this end counts as broken off."""
        self._messages.finish()
        self._file.flush()


def write_recording_mcap(recording: Recording, path: Path) -> Written:
    """Write ``recording`` as an MCAP file, block by block."""
    with atomic_file(path) as file:
        writer = TraceWriter(file, recording)
        for block in recording:
            writer.write(block)
        writer.finish()
    return written(path)


def read_recording_mcap(path: Path) -> Recording:
    """Read a file that ``TraceWriter`` wrote.

    If the file breaks off, a final event of the kind ``fault`` is added.

    Raises
    ------
    RecordingError
        If the file is damaged before its end, has no checksums, or is not a recording.
    """
    with clear_errors(path), path.open("rb") as file:
        schema = next((r for r, _ in _records(file, path) if isinstance(r, Schema)), None)
        if schema is None and _begins_like_a_trace(file):
            raise RecordingError(
                "the trace ends before its first sample: there is nothing to judge",
                place=Place(str(path)),
                remedy="Run the job again.",
            )
        if schema is None or schema.encoding != ENCODING:
            raise RecordingError(
                "the MCAP file does not hold a recording of Threadline",
                place=Place(str(path)),
                remedy="Write its channels as CSV.",
            )
        meta = parse_json(schema.data.decode(), Place(str(path)))
        if not isinstance(meta, dict) or meta.pop("format", None) != TITLE:
            raise RecordingError(
                "the file does not hold a recording of a known version", place=Place(str(path))
            )
        recording = recording_from(meta, path, _blocks)
        for _ in recording:  # find damage now, before the recording is judged
            pass
    return in_si(recording, Place(str(path)))


def _records(file: IO[bytes], path: Path) -> Iterator[tuple[Any, bool]]:
    """Yield (record, False) for the schemas and messages, then (None, True) at the regular end.

    An incomplete record must be the last record: the program that wrote the file ended there. Data
    without a checksum is refused, at the latest after the last record.
    """
    magic = file.read(len(MAGIC))
    if not MAGIC.startswith(magic):
        raise RecordingError("the file is not an MCAP file", place=Place(str(path)))
    crc, bare = zlib.crc32(MAGIC), False
    while len(head := file.read(_RECORD.size)) == _RECORD.size:
        kind, length = _RECORD.unpack(head)
        _check_length(length, path)
        content = file.read(length)
        if len(content) < length:
            _check_cut(kind, length, content, path)
            break
        if kind == Opcode.DATA_END:
            _check_end(content, crc, path, bare=bare)
            _check_summary(file.read(_MOST_RECORD_BYTES), path)
            yield None, True
            return
        if kind == Opcode.FOOTER:
            raise _damaged("a footer follows its records without an end of the data", path)
        crc = zlib.crc32(content, zlib.crc32(head, crc))
        parsed, checked = _parse_records(kind, content, path)
        bare = bare or (bool(parsed) and not checked)
        for record in parsed:
            yield record, False
    _check_broken_off(file, path, bare=bare)


def _begins_like_a_trace(file: IO[bytes]) -> bool:
    """Return whether a file begins like a file of ``TraceWriter``, or is still empty."""
    file.seek(0)
    head = file.read(len(MAGIC) + _RECORD.size + _CRC.size + len(_PROFILE))
    return MAGIC.startswith(head) or head.endswith(_PROFILE.encode())


def _damaged(why: str, path: Path) -> RecordingError:
    return RecordingError(
        f"the file is damaged: {why}", place=Place(str(path)), remedy="Write or fetch it again."
    )


def _unconfirmed(path: Path) -> RecordingError:
    return RecordingError(
        "the MCAP file has no checksums, so damage would go unnoticed",
        place=Place(str(path)),
        remedy="Record it again; or, if you trust it, add checksums: "
        f"mcap recover {path.name} -o checked.mcap",
    )


def _check_length(length: int, path: Path) -> None:
    if length > _MOST_RECORD_BYTES:
        raise RecordingError(
            f"a record claims {length} bytes, limit {_MOST_RECORD_BYTES}",
            place=Place(str(path)),
            remedy="The file is damaged.",
        )


def _check_crc(stored: int, computed: int, what: str, path: Path) -> None:
    """Refuse bytes with a wrong checksum; 0 means that no checksum was written."""
    if stored not in {0, computed}:
        raise _damaged(
            f"the checksum of {what} is {computed:08x}, the file says {stored:08x}", path
        )


def _check_end(content: bytes, crc: int, path: Path, *, bare: bool) -> None:
    """Check the whole data section against the checksum in its last record."""
    if len(content) != _CRC.size:
        raise _damaged("the end of its data section has no checksum", path)
    (stored,) = _CRC.unpack(content)
    _check_crc(stored, crc, "its data", path)
    if bare and not stored:
        raise _unconfirmed(path)


def _check_summary(summary: bytes, path: Path) -> None:
    """Check the index after the data; it may be unfinished if the writer was interrupted.

    No result depends on the index.
    """
    ending = summary[-_ENDING:]
    complete = ending.startswith(_FOOTER), summary.endswith(MAGIC)
    if not any(complete):
        return
    if not all(complete):
        raise _damaged("its footer or its last bytes are missing", path)
    body = summary[: -len(MAGIC) - _CRC.size]
    (stored,) = _CRC.unpack_from(summary, len(body))
    _check_crc(stored, zlib.crc32(body), "its index", path)


def _check_cut(kind: int, length: int, content: bytes, path: Path) -> None:
    """Refuse an incomplete last record whose length disagrees with the chunk in it."""
    if kind != Opcode.CHUNK or len(content) < _CHUNK_HEAD.size:
        return
    name_end = _CHUNK_HEAD.size + _CHUNK_HEAD.unpack_from(content)[-1]
    if len(content) >= name_end + _SIZE.size and length != (
        name_end + _SIZE.size + _SIZE.unpack_from(content, name_end)[0]
    ):
        raise _damaged(
            f"a record claims {length} bytes, but the chunk in it a different number", path
        )


def _check_broken_off(file: IO[bytes], path: Path, *, bare: bool) -> None:
    """Refuse a file that has the last bytes of a complete file although its records end earlier."""
    file.seek(max(file.seek(0, 2) - len(MAGIC), 0))
    if file.read() == MAGIC and file.tell() > len(MAGIC):
        raise _damaged("its records do not lead to its end", path)
    if bare:
        raise _unconfirmed(path)


def _parse_records(kind: int, content: bytes, path: Path) -> tuple[list[Any], bool]:
    """Return the schemas and messages in a record, or in the chunk that the record holds.

    The second value is True if a checksum of the chunk itself confirms them.
    """
    stream = ReadDataStream(BytesIO(content))
    parsed: list[Any] = []
    checked = True
    try:
        if kind == Opcode.SCHEMA:
            parsed, checked = [Schema.read(stream)], False
        elif kind == Opcode.MESSAGE:
            parsed, checked = [Message.read(stream, len(content))], False
        elif kind == Opcode.CHUNK:
            chunk = Chunk.read(stream)
            _check_length(chunk.uncompressed_size, path)
            data = _unpacked(chunk)
            _check_crc(chunk.uncompressed_crc, zlib.crc32(data), "a chunk", path)
            parsed = breakup_chunk(replace(chunk, compression="", data=data))
            checked = chunk.uncompressed_crc != 0
        elif kind in _UNREAD:  # its content is ignored, but it must be valid
            _UNREAD[kind].read(stream)
        else:
            raise _damaged(f"its data section contains a record of kind {kind}", path)
        if stream.count != len(content):
            raise McapError(f"it has {len(content)} bytes, but its content fills {stream.count}")
    except (struct.error, McapError, zstandard.ZstdError) as error:
        raise RecordingError(
            f"a record is damaged: {str(error)[:200] or type(error).__name__}",
            place=Place(str(path)),
            remedy="Write or fetch it again.",
        ) from error
    if kind == Opcode.ATTACHMENT:
        (stored,) = _CRC.unpack(content[-_CRC.size :])
        _check_crc(stored, zlib.crc32(content[: -_CRC.size]), "an attachment", path)
    return parsed, checked


def _unpacked(chunk: Chunk) -> bytes:
    """Return the decompressed bytes of a chunk, not more than its header claims."""
    size = chunk.uncompressed_size
    if chunk.compression == "zstd":
        reader = zstandard.ZstdDecompressor().stream_reader(chunk.data)
        data = reader.read(size + 1)
    elif chunk.compression == "lz4":
        data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, size + 1)
    elif chunk.compression:
        raise McapError(f"a chunk has the unknown compression {chunk.compression[:40]!r}")
    else:
        data = chunk.data
    if len(data) != size:
        raise McapError(f"a chunk claims {size} bytes but holds a different number")
    return bytes(data)


def _blocks(known_file: KnownFile, channels: tuple[Channel, ...]) -> Iterator[RecordingBlock]:
    place = Place(str(known_file.path))
    last_ticks: Mapping[str, int] = {channel.clock.name: 0 for channel in channels}
    number = 0
    with reading(known_file), known_file.path.open("rb") as file:
        for record, is_end in _records(file, known_file.path):
            if isinstance(record, Message):
                if record.sequence != number % (1 << 32):
                    raise _damaged(f"block {number} is missing", known_file.path)
                number += 1
                block = _block(bytes(record.data), channels, place)
                last_ticks = block.first_tick
                yield block
            if is_end:
                return
    no_samples = {channel.name: np.empty(0) for channel in channels}
    tick = max(last_ticks.values())
    fault = Event(tick=tick, kind="fault", operation=-1, name=BROKEN_OFF)
    yield RecordingBlock(first_tick=dict(last_ticks), samples=no_samples, events=(fault,))


def _block(data: bytes, channels: tuple[Channel, ...], place: Place) -> RecordingBlock:
    def damaged(why: str) -> RecordingError:
        return RecordingError(f"a block is damaged: {why}", place=place, remedy="Fetch it again.")

    if len(data) < _LENGTH.size:
        raise damaged("it has no head")
    (size,) = _LENGTH.unpack_from(data)
    head = parse_json(data[_LENGTH.size : _LENGTH.size + size].decode(errors="replace"), place)
    try:
        first_ticks = {str(name): int(tick) for name, tick in head["first"].items()}
        lengths = [int(n) for n in head["lengths"]]
        items = list(head["events"])
    except (TypeError, KeyError, AttributeError, ValueError) as error:
        raise damaged("its head cannot be read") from error
    clocks = {channel.clock.name for channel in channels}
    sample_bytes = len(data) - _LENGTH.size - size
    if set(first_ticks) != clocks or min(lengths, default=0) < 0 or len(lengths) != len(channels):
        raise damaged("its clocks or channels differ from the clocks or channels of the file")
    if sample_bytes != 8 * sum(lengths) or min(first_ticks.values()) < 0:
        raise damaged(f"it has {sample_bytes} bytes of samples, its head claims {8 * sum(lengths)}")
    samples = {}
    offset = _LENGTH.size + size
    for channel, n in zip(channels, lengths, strict=True):
        values = np.frombuffer(data, "<f8", n, offset).astype(np.float64)
        offset += 8 * n
        if not np.isfinite(values).all():
            raise damaged(f"channel {channel.name!r} has samples that are not finite numbers")
        if channel.kind is ChannelKind.OPERATION:
            for value in np.unique(values).tolist():
                if (fault := operation_fault(value)) is not None:
                    raise RecordingError(fault, place=place, remedy=OPERATION_REMEDY)
        samples[channel.name] = values
    events = tuple(event_from(item, place) for item in items)
    return RecordingBlock(first_tick=first_ticks, samples=samples, events=events)
