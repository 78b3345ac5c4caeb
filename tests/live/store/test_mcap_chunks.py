"""The writer of traces, compared with the writer of the MCAP library."""

from __future__ import annotations

import gc
import io
import tracemalloc

import pytest
from mcap.writer import CompressionType, IndexType, Writer

from threadline.files.formats.mcap_chunks import ChunkedMessages


def written_by_the_library(messages: list[tuple[int, bytes]]) -> bytes:
    file = io.BytesIO()
    writer = Writer(
        file,
        chunk_size=0,
        compression=CompressionType.NONE,
        index_types=IndexType.CHUNK,
        enable_crcs=True,
        enable_data_crcs=True,
    )
    writer.start(profile="here", library="a test")
    schema = writer.register_schema("blocks", "raw", b"described")
    channel = writer.register_channel("recording", "raw", schema)
    for number, (at_ns, data) in enumerate(messages):
        writer.add_message(channel, at_ns, data, at_ns, number)
    writer.finish()  # type: ignore[no-untyped-call]  # the library leaves out "-> None"
    return file.getvalue()


def begun(file: io.BufferedIOBase | io.BytesIO) -> ChunkedMessages:
    return ChunkedMessages(
        file,  # type: ignore[arg-type]  # IO[bytes], which they are
        "here", "a test", "recording", "blocks", "raw", b"described",
    )  # fmt: skip


@pytest.mark.parametrize("count", [0, 1, 40])
def test_chunk_writer_equals_the_library_byte_by_byte(count: int) -> None:
    messages = [(1000 * k + 5, bytes(range(k))) for k in range(count)]
    file = io.BytesIO()
    writer = begun(file)
    for message in messages:
        writer.write(*message)
    writer.finish()
    assert file.getvalue() == written_by_the_library(messages)


def test_a_long_run_takes_little_memory() -> None:
    """An hour has 140 000 blocks, and the library keeps 600 bytes for each."""
    blocks = 20_000
    writer = begun(_Nowhere())
    tracemalloc.start()
    try:
        for k in range(blocks):
            writer.write(k, b"data")
        gc.collect()
        memory_before, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert memory_before < 40 * blocks


class _Nowhere(io.BufferedIOBase):
    def write(self, content: object, /) -> int:
        return len(bytes(content))  # type: ignore[call-overload]
