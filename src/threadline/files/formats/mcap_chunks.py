"""Write an MCAP file with one channel and one chunk per message, for runs of any length.

The file equals the output of ``mcap.writer.Writer`` with ``chunk_size=0`` and an index of chunks,
byte for byte. That class keeps an index object for each chunk, some 80 MB per hour of a run, and
takes three times as long for a message. This module keeps 24 bytes per chunk.

Format: https://mcap.dev/spec, "Records" and "Summary Section".
"""

from __future__ import annotations

import struct
import zlib
from array import array
from typing import IO

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Header, Schema, Statistics, SummaryOffset

MAGIC = b"\x89MCAP0\r\n"
_ID = 1  # of the schema, and of the channel
_MESSAGE = struct.Struct("<BQHIQQ")  # kind, length, channel, number, times of record and sending
_MESSAGE_HEAD = _MESSAGE.size - 9  # without kind and length
_CHUNK = struct.Struct("<BQQQQIIQ")
# kind, length, first and last time, size, checksum, length of the compression's name, size
_CHUNK_HEAD = _CHUNK.size - 9
_DATA_END = struct.Struct("<BQI")
_FOOTER = struct.Struct("<BQQQ")
_FOOTER_BYTES = 8 + 8 + 4


class ChunkedMessages:
    """Writes the messages of one channel; each is complete in the file, with its checksum.

    Parameters
    ----------
    file
        A file opened for writing; the caller flushes and closes it.
    profile, library
        Profile of the file, and the program that writes it.
    topic
        Topic of the channel.
    schema, encoding, description
        Name, encoding and content of the schema; the messages have the same encoding.
    """

    def __init__(
        self,
        file: IO[bytes],
        profile: str,
        library: str,
        topic: str,
        schema: str,
        encoding: str,
        description: bytes,
    ) -> None:
        self._file, self._crc, self._written = file, 0, 0
        self._schema = Schema(id=_ID, data=description, encoding=encoding, name=schema)
        self._channel = Channel(
            id=_ID, topic=topic, message_encoding=encoding, metadata={}, schema_id=_ID
        )
        self._index = array("Q")  # time, first byte and length of each chunk
        head_builder, schema_builder = RecordBuilder(), RecordBuilder()
        Header(profile, library).write(head_builder)
        for record in (self._schema, self._channel):
            record.write(schema_builder)
        self._before: bytes = _taken(schema_builder)  # bytes before the first message, in its chunk
        self._put(MAGIC)
        self._put(_taken(head_builder))

    def write(self, at_ns: int, data: bytes) -> None:
        """Write a message with its time."""
        number = len(self._index) // 3
        head = _MESSAGE.pack(Opcode.MESSAGE, _MESSAGE_HEAD + len(data), _ID, number, at_ns, at_ns)
        content = b"".join((self._before, head, data))
        self._before, size = b"", len(content)
        chunk = _CHUNK.pack(
            Opcode.CHUNK, _CHUNK_HEAD + size, at_ns, at_ns, size, zlib.crc32(content), 0, size
        )
        self._index.extend((at_ns, self._written, len(chunk) + size))
        self._put(chunk + content)

    def finish(self) -> None:
        """Write the end of the data, the index of the chunks, and the end of the file."""
        self._put(_DATA_END.pack(Opcode.DATA_END, 4, self._crc))
        summary_begin = self._written
        summary, offsets = RecordBuilder(), RecordBuilder()
        times = self._index[0::3]
        statistics = Statistics(
            attachment_count=0,
            channel_count=1,
            channel_message_counts={_ID: len(times)} if times else {},
            chunk_count=len(times),
            message_count=len(times),
            message_end_time=max(times, default=0),
            message_start_time=min(times, default=0),
            metadata_count=0,
            schema_count=1,
        )
        groups = (
            (Opcode.SCHEMA, [self._schema]),
            (Opcode.CHANNEL, [self._channel]),
            (Opcode.STATISTICS, [statistics]),
            (Opcode.CHUNK_INDEX, map(self._chunk, range(len(times)))),
        )
        for kind, group_records in groups:
            group_begin = summary.count
            for record in group_records:
                record.write(summary)
            SummaryOffset(
                group_opcode=kind,
                group_start=summary_begin + group_begin,
                group_length=summary.count - group_begin,
            ).write(offsets)
        offset_begin = summary_begin + summary.count
        content = _taken(summary) + _taken(offsets)
        footer = _FOOTER.pack(Opcode.FOOTER, _FOOTER_BYTES, summary_begin, offset_begin)
        crc = zlib.crc32(footer, zlib.crc32(content))
        self._file.write(content + footer + struct.pack("<I", crc) + MAGIC)

    def _chunk(self, k: int) -> ChunkIndex:
        at_ns, begin, length = self._index[3 * k : 3 * k + 3]
        size = length - _CHUNK.size
        return ChunkIndex(
            chunk_length=length,
            chunk_start_offset=begin,
            compression="",
            compressed_size=size,
            message_end_time=at_ns,
            message_index_length=0,
            message_index_offsets={},
            message_start_time=at_ns,
            uncompressed_size=size,
        )

    def _put(self, content: bytes) -> None:
        self._file.write(content)
        self._written += len(content)
        self._crc = zlib.crc32(content, self._crc)


def _taken(records: RecordBuilder) -> bytes:
    """Return the written bytes, and begin again."""
    content: bytes = records.end()  # type: ignore[no-untyped-call]  # the library leaves out "-> bytes"
    return content
