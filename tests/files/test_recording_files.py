"""Recordings through files and back, whole and not half-written."""

from __future__ import annotations

import csv
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.made import Made
from threadline.errors import RecordingError
from threadline.files import Channel, ChannelKind, Clock, Event, Recording, RecordingBlock, Stream
from threadline.files.formats import read_recording, write_recording
from threadline.files.formats.common import simplest_between

from .makers import recording_of, story

ANY_FLOAT = st.floats(allow_nan=True, allow_infinity=True)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("recordings")


@given(
    values=st.lists(st.tuples(ANY_FLOAT, ANY_FLOAT, ANY_FLOAT), min_size=1, max_size=30),
    stride=st.integers(1, 40),
    first=st.integers(0, 10**6),
    rows=st.integers(1, 40),
    period=st.fractions(Fraction(1, 10**8), 1, max_denominator=10**9).filter(bool),
    ticks=st.lists(st.integers(0, 10**7), max_size=3),
)
@pytest.mark.parametrize("ending", ["npz", "csv"])
def test_round_trip(folder, ending, values, stride, first, rows, period, ticks) -> None:
    """Every bit, every exact period, every event comes back, and the file's own description."""
    columns = dict(
        zip(("X.load", "A.measured", "X.voltage"), zip(*values, strict=True), strict=True)
    )
    end = first + stride * len(values)
    events = [
        Event(tick=t, kind="output", operation=3, name="valve, 1", value=0.1)
        for t in sorted(ticks)
        if first <= t < end
    ]
    recording = recording_of(
        columns,
        clock=Clock("fast", period),
        stride=stride,
        first=first,
        rows=rows,
        events=events,
    )
    path = folder / f"r.{ending}"
    write_recording(recording, path)
    assert story(read_recording(path)) == story(recording)


def two_clock_recording() -> Recording:
    """136 us and 1 ms on one machine, blocks of unequal length, one channel with a stride."""
    filters, reference = (
        Clock("filter", Fraction(17, 125000)),
        Clock("reference", Fraction(1, 1000)),
    )

    def channel(name: str, kind: ChannelKind, clock: Clock, stride: int = 1) -> Channel:
        return Channel(name=name, kind=kind, unit="m", clock=clock, axis="X", stride=stride)

    channels = (
        channel("X.commanded", ChannelKind.COMMANDED, reference),
        channel("X.measured", ChannelKind.MEASURED, filters),
        channel("every/second one", ChannelKind.LOAD, filters, 2),
        channel("blocks", ChannelKind.FRAME, reference),
    )
    rng = np.random.default_rng(3)
    blocks = []
    for first, length in (((0, 0), 68), ((500, 68), 34), ((750, 102), 0)):
        fast = length * 125 // 17
        blocks.append(
            RecordingBlock(
                first_tick={"filter": first[0], "reference": first[1]},
                samples={
                    "X.commanded": rng.normal(size=length),
                    "X.measured": rng.normal(size=fast),
                    "every/second one": rng.normal(size=fast // 2),
                    "blocks": rng.normal(size=length),
                },
                events=(Event(tick=first[1], kind="stop", operation=1),) if length else (),
            )
        )
    return Recording(
        channels=channels,
        blocks=Stream.of(blocks),
        job_sha256="",
        machine_sha256="",
        simulated=False,
    )


def test_npz_keeps_several_clocks_and_blocks_and_csv_refuses(tmp_path) -> None:
    recording = two_clock_recording()
    write_recording(recording, tmp_path / "r.npz")
    again = read_recording(tmp_path / "r.npz")
    assert story(again) == story(recording)
    for ours, theirs in zip(again, recording, strict=True):
        assert dict(ours.first_tick) == dict(theirs.first_tick)
        assert {k: len(v) for k, v in ours.samples.items()} == {
            k: len(v) for k, v in theirs.samples.items()
        }
    with pytest.raises(RecordingError, match=r"3 clocks or strides.*\.npz"):
        write_recording(recording, tmp_path / "r.csv")
    assert [p.name for p in tmp_path.iterdir()] == ["r.npz"]


def test_numpy_reads_our_archive(tmp_path) -> None:
    """The same file, read by numpy itself."""
    recording = recording_of({"X.load": [1.5, -2.25], "operation": [3.0, 4.0]}, stride=20)
    write_recording(recording, tmp_path / "r.npz")
    with np.load(tmp_path / "r.npz", allow_pickle=False) as archive:
        assert archive["X.load"].tolist() == [1.5, -2.25]
        assert archive["operation"].tolist() == [3.0, 4.0]
        assert b'"servo": "1/200"' in archive["meta.json"]


def test_kinds_of_events_in_archives_of_before_keep_their_numbers(tmp_path) -> None:
    """An archive has a number for each kind: a new kind must not change the older ones."""
    kinds = (
        "output", "wait", "stop", "dwell", "tool", "end",
        "hold", "resume", "late", "completed", "stopped", "fault", "plan",
    )  # fmt: skip
    events = [Event(tick=k, kind=kind, operation=-1) for k, kind in enumerate(kinds)]
    recording = recording_of(
        {"X.load": np.zeros(20)}, clock=Clock("fast", Fraction(1, 100)), events=events
    )
    write_recording(recording, tmp_path / "r.npz")
    with np.load(tmp_path / "r.npz") as archive:
        assert archive["event_kind"].tolist() == list(range(len(kinds)))


def test_a_spreadsheet_reads_our_csv(tmp_path) -> None:
    recording = recording_of({"X.load": [1.5, -2.25]}, stride=20)
    write_recording(recording, tmp_path / "r.csv")
    with (tmp_path / "r.csv").open(newline="") as file:
        rows = [row for row in csv.reader(file) if not row[0].startswith("#")]
    assert rows == [["time [s]", "X.load [m]", "events"], ["0.0", "1.5", ""], ["0.1", "-2.25", ""]]


def test_an_archive_with_half_an_operation_is_refused(tmp_path) -> None:
    """An archive refuses what a table refuses, also under another name of the channel."""
    channel = Channel(
        name="op", kind=ChannelKind.OPERATION, unit="", clock=Clock("c", Fraction(1, 200))
    )
    block = RecordingBlock(first_tick={"c": 0}, samples={"op": np.array([-1.0, 0.0, 1.5])})
    made = Recording(
        channels=(channel,),
        blocks=Stream.of([block]),
        job_sha256="",
        machine_sha256="",
        simulated=False,
    )
    write_recording(made, tmp_path / "r.npz")
    with pytest.raises(
        RecordingError, match=r"r\.npz: the operation 1\.5 is neither a whole number"
    ):
        list(read_recording(tmp_path / "r.npz"))


def test_our_csv_notices_what_is_missing(tmp_path) -> None:
    """Any one line less, or a cut at any byte, is noticed."""
    recording = recording_of({"X.load": [0.0, 0.25, 0.5, 0.75]})
    path = tmp_path / "r.csv"
    write_recording(recording, path)
    text = path.read_text()
    lines = text.splitlines(keepends=True)
    for k in range(len(lines)):
        path.write_text("".join(lines[:k] + lines[k + 1 :]))
        with pytest.raises(RecordingError):
            read_recording(path)
    for size in range(len(text) - 1):
        path.write_text(text[:size])
        with pytest.raises(RecordingError):
            read_recording(path)


def test_no_file_and_other_files(tmp_path) -> None:
    with pytest.raises(RecordingError, match="cannot read"):
        read_recording(tmp_path / "none.csv")
    (tmp_path / "a.xls").write_bytes(b"x")
    with pytest.raises(
        RecordingError, match=r"has no extension of a recording.*Known: \.npz, \.csv"
    ):
        read_recording(tmp_path / "a.xls")
    (tmp_path / "b.npz").write_bytes(b"PK\3\4 but no archive")
    with pytest.raises(RecordingError, match="damaged"):
        read_recording(tmp_path / "b.npz")
    (tmp_path / "d.csv").mkdir()
    with pytest.raises(RecordingError, match="cannot read"):
        read_recording(tmp_path / "d.csv")
    (tmp_path / "e.csv").write_bytes(b"time [s],X [mm]\n0,\xff\n")
    with pytest.raises(RecordingError, match=r"e\.csv:2: the line is not UTF-8"):
        read_recording(tmp_path / "e.csv")
    (tmp_path / "f.csv").write_bytes(b"\x93NUMPY\0\0")
    with pytest.raises(RecordingError, match="binary, not text"):
        read_recording(tmp_path / "f.csv")
    (tmp_path / "g.csv").write_bytes(b"x" * (1 << 20) + b"xx")
    with pytest.raises(RecordingError, match="longer than 1048576 bytes"):
        read_recording(tmp_path / "g.csv")


def test_writing_is_all_or_nothing(tmp_path) -> None:
    """A recording that fails half-way leaves the old file unchanged, and no other file."""
    good = recording_of({"X.measured": [0.0, 1.0]})

    def broken():
        yield next(iter(good))
        raise RecordingError("the link broke")

    bad = Recording(
        channels=good.channels,
        blocks=Made(broken),
        job_sha256="",
        machine_sha256="",
        simulated=True,
    )
    for ending in ("npz", "csv", "plt"):
        path = tmp_path / f"r.{ending}"
        path.write_text("old")
        with pytest.raises(RecordingError, match="the link broke"):
            write_recording(bad, path)
        assert path.read_text() == "old"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["r.csv", "r.npz", "r.plt"]
    with pytest.raises(RecordingError, match="cannot write"):
        write_recording(good, tmp_path / "r.csv" / "below.csv")


@pytest.mark.parametrize("ending", ["npz", "csv", "plt"])
def test_the_hash_is_of_the_file_and_repeats(tmp_path, ending) -> None:
    import hashlib

    recording = recording_of({"X.measured": [0.0, 1.0, 0.5]})
    one = write_recording(recording, tmp_path / f"a.{ending}")
    two = write_recording(recording, tmp_path / f"b.{ending}")
    assert one.sha256 == two.sha256 == hashlib.sha256(one.path.read_bytes()).hexdigest()


@given(low=st.fractions(Fraction(1, 1000), 1000), width=st.fractions(0, 1))
def test_simplest_fraction(low: Fraction, width: Fraction) -> None:
    """Against a search over all smaller denominators."""
    found = simplest_between(low, low + width)
    assert low <= found <= low + width
    for denominator in range(1, min(found.denominator, 400)):
        numerator = -(-low.numerator * denominator // low.denominator)
        assert Fraction(numerator, denominator) > low + width


def test_samples_are_not_kept_in_memory(tmp_path) -> None:
    """A million samples pass while the blocks in memory stay small."""
    import tracemalloc

    def blocks():
        for k in range(128):
            yield RecordingBlock(
                first_tick={"servo": k * 8192}, samples={"X.measured": np.full(8192, k / 7)}
            )

    channel = recording_of({"X.measured": [0.0]}).channels[0]
    recording = Recording(
        channels=(channel,),
        blocks=Made(blocks),
        job_sha256="",
        machine_sha256="",
        simulated=True,
    )
    tracemalloc.start()
    write_recording(recording, tmp_path / "r.npz")
    total = sum(float(b.samples["X.measured"].sum()) for b in read_recording(tmp_path / "r.npz"))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert total == pytest.approx(8192 * sum(range(128)) / 7, rel=1e-12)
    assert peak < 4e6  # the samples are 8.4 MB


def test_a_damaged_archive_is_refused_before_a_sample_is_given(tmp_path) -> None:
    """A byte in the packed samples: the check sum is wrong, and nothing is computed from them."""
    file = tmp_path / "r.npz"
    write_recording(recording_of({"X.measured": list(np.sin(np.arange(5000.0)))}), file)
    whole = file.read_bytes()
    for at in range(2000, 20_000, 3000):
        file.write_bytes(whole[:at] + bytes([whole[at] ^ 0x55]) + whole[at + 1 :])
        with pytest.raises(RecordingError, match=r"r\.npz: the file is damaged"):
            read_recording(file)
