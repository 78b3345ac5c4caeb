"""Traces in MCAP: complete, and readable and judged after a crash."""

from __future__ import annotations

import io
import random
import struct
import tracemalloc
import zlib
from dataclasses import replace
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import Writer

from tests.live.bench import table_of_counts, there_and_back, winder
from threadline.errors import RecordingError
from threadline.files import Recording, RunEnd, Stream
from threadline.files.formats import read_recording, write_recording
from threadline.files.formats.recording_mcap import BROKEN_OFF, TraceWriter
from threadline.twin import simulate


@pytest.fixture(scope="module")
def recording() -> Recording:
    return short_recording()


def short_recording() -> Recording:
    whole = simulate(table_of_counts(there_and_back(cruise=20)), winder(), settle_s=0.1)
    blocks = []
    for block in whole:
        first = block.first_tick["servo"]
        for at in range(0, len(block.samples["operation"]), 25):
            part = {name: values[at : at + 25] for name, values in block.samples.items()}
            blocks.append(replace(block, first_tick={"servo": first + at}, samples=part, events=()))
        blocks[-1] = replace(blocks[-1], events=block.events)
    return replace(
        whole, blocks=Stream.of(blocks), origin={"job": "a.prg", "why": "\u00e4 \U0001f9f5"}
    )


def whole_file(recording: Recording) -> tuple[bytes, list[int]]:
    """Return the bytes of the file, and its length after each block."""
    file, lengths = io.BytesIO(), []
    writer = TraceWriter(file, recording)
    for block in recording:
        writer.write(block)
        lengths.append(file.tell())
    writer.finish()
    return file.getvalue(), lengths


def test_nothing_is_lost(recording: Recording, tmp_path: Path) -> None:
    write_recording(recording, tmp_path / "a.mcap")
    found = read_recording(tmp_path / "a.mcap")
    assert found.channels == recording.channels
    assert (found.origin, found.simulated) == (recording.origin, True)
    assert found.machine_sha256 == recording.machine_sha256
    for channel in recording.channels:
        for ours, theirs in zip(
            found.samples(channel.name), recording.samples(channel.name), strict=True
        ):
            assert np.array_equal(ours, theirs)
    assert [b.events for b in found] == [b.events for b in recording]
    assert found.outcome().ended is RunEnd.COMPLETED


def test_the_peers_reader_reads_it(recording: Recording) -> None:
    """The library of the format checks its own magic, index and statistics."""
    content, lengths = whole_file(recording)
    reader = make_reader(io.BytesIO(content), validate_crcs=True)
    summary = reader.get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == len(lengths)
    # Log times are the time of the machine, of 5 ms a tick.
    times = [message.log_time for _, _, message in reader.iter_messages()]
    assert times == [block.first_tick["servo"] * 5_000_000 for block in recording]


@given(st.data())
def test_cut_recording_keeps_its_whole_blocks_and_ends_in_a_fault(
    recording: Recording, tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    """Cut after its first block: every whole block is there, and the trace says it broke off."""
    content, lengths = whole_file(recording)
    cut = data.draw(st.integers(lengths[0], lengths[-1] + 4))
    path = tmp_path_factory.mktemp("cut") / "a.mcap"
    path.write_bytes(content[:cut])
    found = read_recording(path)
    blocks = list(found)
    whole = sum(length <= cut for length in lengths)
    assert len(blocks) == whole + 1
    for ours, theirs in zip(blocks, recording, strict=False):
        if ours is not blocks[-1]:
            assert np.array_equal(ours.samples["X.load"], theirs.samples["X.load"])
    assert blocks[-1].events[-1].name == BROKEN_OFF
    assert found.outcome().ended is RunEnd.FAULT


def figures(path: Path) -> tuple[object, ...]:
    """Return the whole content of a recording, or the line of its refusal."""
    try:
        found = read_recording(path)
        samples = {c.name: found.samples(c.name)[1].tobytes() for c in found.channels}
        return found.channels, found.origin, found.outcome(), samples
    except RecordingError as error:
        return (str(error),)


@pytest.mark.long(but="True")
@pytest.mark.parametrize("finished", [True, False])
def test_no_flipped_bit_changes_a_figure_unnoticed(
    recording: Recording, tmp_path: Path, finished: bool
) -> None:
    """Every bit of a head, and a thousand others, of a whole trace and of a broken-off one."""
    content, lengths = whole_file(replace(recording, blocks=Stream.of(list(recording)[:4])))
    content = content if finished else content[: lengths[-1] - 7]
    path = tmp_path / "flipped.mcap"
    path.write_bytes(content)
    good = figures(path)
    drawn = random.Random(39)
    framing = [
        8 * at + bit for end in (0, lengths[0]) for at in range(end, end + 48) for bit in range(8)
    ]
    for at in framing + [drawn.randrange(8 * len(content)) for _ in range(1000)]:
        changed = bytearray(content)
        changed[at // 8] ^= 1 << at % 8
        path.write_bytes(changed)
        found = figures(path)
        refused = len(found) == 1 and "\n" not in str(found[0])
        assert refused or found == good, f"bit {at}"


def test_a_trace_without_checksums_is_refused_with_what_to_do(
    recording: Recording, tmp_path: Path
) -> None:
    """Whole, or broken off: nobody could tell whether a bit was flipped."""
    content = bare_file(recording)
    path = tmp_path / "bare.mcap"
    for part in (content, content[: len(content) // 2]):
        path.write_bytes(part)
        with pytest.raises(RecordingError, match=r"bare\.mcap: .*no checksums.*mcap recover bare"):
            read_recording(path)


def test_a_block_that_is_missing_between_two_others_is_told(
    recording: Recording, tmp_path: Path
) -> None:
    content, lengths = whole_file(recording)
    path = tmp_path / "gap.mcap"
    path.write_bytes(content[: lengths[1]] + content[lengths[2] : lengths[-1]])
    with pytest.raises(RecordingError, match="block 2 is missing"):
        read_recording(path)


@pytest.mark.parametrize("finished", [True, False])
def test_a_trace_without_samples_says_so(
    recording: Recording, tmp_path: Path, finished: bool
) -> None:
    file = io.BytesIO()
    writer = TraceWriter(file, recording)
    if finished:
        writer.finish()
    path = tmp_path / "empty.mcap"
    path.write_bytes(file.getvalue())
    with pytest.raises(RecordingError, match="ends before its first sample"):
        read_recording(path)


@given(st.data())
def test_a_damaged_file_is_refused_in_one_line_or_reads(
    recording: Recording, tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    content = bytearray(whole_file(recording)[0])
    at = data.draw(st.integers(0, len(content) - 1))
    content[at] ^= data.draw(st.integers(1, 255))
    path = tmp_path_factory.mktemp("damaged") / "a.mcap"
    path.write_bytes(content)
    try:
        for block in read_recording(path):
            assert len(block.samples) == len(recording.channels)
    except RecordingError as error:
        assert "\n" not in str(error)


@pytest.mark.parametrize(
    "content", [b"", b"\x89MCAP0\r\n", b"PK\x03\x04" * 9, b"\x89MCAP0\r\n\x03" + b"\xff" * 8]
)
def test_other_files_are_refused(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "other.mcap"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=r"other\.mcap"):
        read_recording(path)


def bare_file(recording: Recording) -> bytes:
    """Return the file as a writer without chunks and checksums writes it."""
    file = io.BytesIO()
    writer = Writer(file, use_chunking=False, enable_crcs=False)
    writer.start(profile="threadline", library="threadline")
    topic = None
    for schema, channel, message in make_reader(
        io.BytesIO(whole_file(recording)[0])
    ).iter_messages():
        assert schema is not None
        if topic is None:
            of = writer.register_schema(schema.name, schema.encoding, schema.data)
            topic = writer.register_channel(channel.topic, channel.message_encoding, of)
        writer.add_message(
            topic, message.log_time, message.data, message.publish_time, message.sequence
        )
    writer.finish()  # type: ignore[no-untyped-call]  # the library leaves out "-> None"
    return file.getvalue()


def packed(recording: Recording, compression: str, size: int, more: bytes = b"") -> bytes:
    """Return the file with everything after its head in one chunk of the stated ``size``."""
    content = bare_file(recording)
    at = 8 + 9 + int.from_bytes(content[9:17], "little")  # behind magic and header
    end = content.index(b"\x0f" + (4).to_bytes(8, "little"), at)
    inside = content[at:end] + more
    pack = {"lz4": lz4.frame.compress, "zstd": zstandard.compress, "": bytes}[compression]
    data = pack(inside)
    name = compression.encode()
    size = size if size >= 0 else len(inside)
    body = struct.pack("<QQQII", 0, 0, size, zlib.crc32(inside), len(name)) + name
    body += struct.pack("<Q", len(data)) + data
    return content[:at] + b"\x06" + struct.pack("<Q", len(body)) + body + content[end:]


@pytest.mark.parametrize("compression", ["", "lz4", "zstd"])
def test_recording_compressed_by_another_tool_is_read(
    recording: Recording, tmp_path: Path, compression: str
) -> None:
    path = tmp_path / "packed.mcap"
    path.write_bytes(packed(recording, compression, -1))
    found = read_recording(path)
    assert np.array_equal(found.samples("X.load")[1], recording.samples("X.load")[1])
    assert found.outcome().ended is RunEnd.COMPLETED


@pytest.mark.parametrize("compression", ["", "lz4", "zstd"])
@pytest.mark.parametrize("size", [0, 1000, 1 << 27, 1 << 40, (1 << 64) - 1])
def test_a_chunk_that_lies_is_refused_before_it_is_unpacked(
    recording: Recording, tmp_path: Path, compression: str, size: int
) -> None:
    """A gigabyte of zeros is 4 MB packed; memory is reserved for the stated size, if at all."""
    path = tmp_path / "bomb.mcap"
    path.write_bytes(packed(recording, compression, size, bytes(1 << 24)))
    tracemalloc.start()
    with pytest.raises(RecordingError, match=r"bomb\.mcap.*claims"):
        read_recording(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < (5 << 24) + (size if size < 1 << 28 else 0)


def test_records_that_are_cut_short_inside_are_refused(
    recording: Recording, tmp_path: Path
) -> None:
    """Their lengths are right, but some of their fields are missing."""
    content = whole_file(recording)[0]
    head = 8 + 9 + int.from_bytes(content[9:17], "little")
    for kind in (b"\x03", b"\x05", b"\x06"):
        path = tmp_path / "short.mcap"
        path.write_bytes(content[:head] + kind + struct.pack("<Q", 1) + b"\x00" + content[head:])
        with pytest.raises(RecordingError, match=r"short\.mcap: a record is damaged"):
            read_recording(path)
