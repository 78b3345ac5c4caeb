"""Recordings through files and back, and traces that others wrote."""

from __future__ import annotations

import csv
from fractions import Fraction
from math import radians

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.made import Made
from threadline.errors import RecordingError
from threadline.signals import (
    Channel,
    ChannelKind,
    Clock,
    Event,
    Recording,
    RecordingBlock,
    Stream,
)
from threadline.signals.files import read_recording, write_plt, write_recording
from threadline.signals.files.grid import simplest_between

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
    """Every bit, every exact period, every event comes back; so does what the file says of it."""
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


def test_a_spreadsheet_reads_our_csv(tmp_path) -> None:
    recording = recording_of({"X.load": [1.5, -2.25]}, stride=20)
    write_recording(recording, tmp_path / "r.csv")
    with (tmp_path / "r.csv").open(newline="") as file:
        rows = [row for row in csv.reader(file) if not row[0].startswith("#")]
    assert rows == [["time [s]", "X.load [m]", "events"], ["0.0", "1.5", ""], ["0.1", "-2.25", ""]]


def test_plt_is_what_the_winder_wrote(tmp_path) -> None:
    """X, Y, A in mm and degrees on a line, every 20 ticks; values by hand."""
    x = [k * 1e-3 for k in range(101)]
    recording = recording_of(
        {"A.measured": [radians(90)] * 101, "X.measured": x, "Y.measured": [0.0] * 101}, rows=7
    )
    path = tmp_path / "r.plt"
    done = write_plt(recording, path, every=20)
    assert path.read_text().splitlines() == [
        "X [mm]\tY [mm]\tA [deg]\tevery 20 ticks of 5 ms",
        *(f"{k}.0000\t0.0000\t90.0000" for k in (0, 20, 40, 60, 80, 100)),
    ]
    assert done.warnings == ()

    again = read_recording(path)
    times, values = again.samples("X.measured")
    assert np.allclose(times, np.arange(6) * 0.1, rtol=1e-15)
    assert np.allclose(values, np.arange(6) * 0.02, atol=5e-8)  # four decimals of a mm
    assert again.samples("A.measured")[1] == pytest.approx([radians(90)] * 6)
    assert again.channels[0].stride == 20
    assert not again.simulated


def test_plt_may_be_cut_as_in_1994_but_says_so(tmp_path) -> None:
    recording = recording_of({"X.measured": np.zeros(6000)}, rows=999)
    cut = write_plt(recording, tmp_path / "r.plt", limit_lines=5000)
    assert cut.warnings == ("r.plt was cut after 5000 lines",)
    assert len((tmp_path / "r.plt").read_text().splitlines()) == 5001
    whole = write_plt(recording, tmp_path / "r.plt")
    assert whole.warnings == ()
    assert len((tmp_path / "r.plt").read_text().splitlines()) == 6001


@pytest.mark.parametrize("period", [Fraction(1, 60), Fraction(17, 125000), Fraction(1, 3 * 10**9)])
def test_plt_keeps_the_tick_exact(tmp_path, period) -> None:
    recording = recording_of({"X.measured": [0.0, 1e-3]}, clock=Clock("servo", period))
    write_recording(recording, tmp_path / "r.plt")
    assert read_recording(tmp_path / "r.plt").channels[0].clock.period_s == period


def test_plt_refuses_lines_between_samples(tmp_path) -> None:
    recording = recording_of({"X.measured": [0.0, 1e-3]}, stride=20)
    with pytest.raises(RecordingError, match=r"every 30 ticks.*20 ticks apart.*multiple of 20"):
        write_plt(recording, tmp_path / "r.plt", every=30)
    with pytest.raises(RecordingError, match="no load position"):
        write_plt(recording, tmp_path / "r.plt", kind=ChannelKind.LOAD)


FOREIGN = "time [{t}],X [mm],A.load [deg],operation\n"


@pytest.mark.parametrize("separator", [",", ";", "\t"])
@pytest.mark.parametrize(("unit", "factor"), [("s", 1.0), ("ms", 1e3)])
@pytest.mark.parametrize("first", [0, 7])
def test_traces_from_anywhere(tmp_path, separator, unit, factor, first) -> None:
    """Units, separators, a start after 0, comments, blank lines; compared in SI, by hand."""
    lines = ["# written by something else", FOREIGN.format(t=unit).strip(), ""]
    for k in range(50):
        lines.append(f"{(first + k) * 0.005 * factor:.6f},{k * 0.5},{k * 2},{k // 10}")
    path = tmp_path / "t.csv"
    path.write_text("\n".join(lines).replace(",", separator) + "\n")

    recording = read_recording(path)

    times, x = recording.samples("X.measured")
    assert recording.channels[0].clock.period_s == Fraction(1, 200)
    assert np.array_equal(times, (first + np.arange(50)) * 5 / 1000)
    assert x == pytest.approx(np.arange(50) * 0.0005)
    assert recording.samples("A.load")[1] == pytest.approx(np.radians(np.arange(50) * 2))
    assert recording.samples("operation")[1][-1] == 4.0
    assert recording.find(ChannelKind.LOAD, "A").unit == "rad"
    assert not recording.simulated
    assert recording.job_sha256 == ""


@pytest.mark.parametrize("decimals", [4, 6, 9])
def test_times_that_were_rounded_in_print_lie_on_the_grid(tmp_path, decimals) -> None:
    """40 us printed with four decimals is out by half a step at most 0.05 ms: only 1 ms stands."""
    path = tmp_path / "t.csv"
    rows = [f"{k * 0.001:.{decimals}f},{k}" for k in range(2000)]
    path.write_text("time [s],X [mm]\n" + "\n".join(rows) + "\n")
    assert read_recording(path).channels[0].clock.period_s == Fraction(1, 1000)


def test_jitter_is_tolerated_up_to_what_is_stated(tmp_path) -> None:
    """4 % of a period passes, 8 % does not; drift counts like jitter."""
    rng = np.random.default_rng(8)
    noise = rng.uniform(-1, 1, 400)
    noise[[0, -1]] = 0.0

    def write(size: float, drift: float = 0.0) -> None:
        k = np.arange(400)
        bend = drift * np.sin(np.pi * k / 399)
        times = (k + size * noise + bend) * 0.005
        text = "\n".join(f"{t!r},0" for t in times.tolist())
        (tmp_path / "t.csv").write_text(f"time [s],X [mm]\n{text}\n")

    write(0.04)
    assert read_recording(tmp_path / "t.csv").channels[0].clock.period_s == Fraction(1, 200)
    write(0.08)
    with pytest.raises(RecordingError, match=r"t\.csv:\d+.*at most 5% of a period"):
        read_recording(tmp_path / "t.csv")
    write(0.0, drift=0.5)  # each step is even to 0.4 %, the middle is half a period late
    with pytest.raises(RecordingError, match="Record at a fixed rate"):
        read_recording(tmp_path / "t.csv")


BAD_TRACES = {
    "empty": ("", "the file is empty"),
    "only comments": ("# a\n# b\n", "the file is empty"),
    "no unit": ("time [s],X\n0,1\n1,1\n", r"t\.csv:1: column 'X' has no unit.*X \[mm\]"),
    "time without unit": ("time,X [mm]\n0,1\n1,1\n", "column 'time' has no unit"),
    "wrong unit": ("time [s],X [kg]\n0,1\n1,1\n", "column 'X' is in 'kg'.*unit like m or rad"),
    "time in mm": ("time [mm],X [mm]\n0,1\n1,1\n", "column 'time' is in 'mm'"),
    "unknown column": ("time [s],X [mm],Xx [mm]\n0,1,1\n", "unknown column 'Xx'.*'X'"),
    "unknown kind": ("time [s],X.laod [mm]\n0,1\n", "unknown column 'X.laod'.*'X.load'"),
    "misspelt time": ("tmie [s],X [mm]\n0,1\n", "unknown column 'tmie'.*'time'"),
    "twice": ("time [s],X [mm],X [mm]\n0,1,1\n1,1,1\n", "column 'X.measured' stands twice"),
    "no time": ("X [mm],Y [mm]\n0,1\n1,1\n", "needs a column of time"),
    "time alone": ("time [s]\n0\n1\n", "needs a column of time and one of positions"),
    "one row": ("time [s],X [mm]\n0,1\n", "1 row.*at least 2"),
    "no row": ("time [s],X [mm]\n", "0 row.*at least 2"),
    "same time": ("time [s],X [mm]\n0,1\n1,1\n1,2\n", r"t\.csv:4: time goes from 1 s to 1 s"),
    "backwards": ("time [s],X [mm]\n0,1\n2,1\n1,2\n", r"t\.csv:4: time goes from 2 s to 1 s"),
    "nan": ("time [s],X [mm]\n0,1\n1,nan\n", r"t\.csv:3: 'nan' is not a finite number"),
    "infinite": ("time [s],X [mm]\n0,1\n1,1e999\n", "'1e999' is not a finite number"),
    "underscore": ("time [s],X [mm]\n0,1\n1,1_0\n", "'1_0' is not a finite number"),
    "gap in a row": ("time [s],X [mm],Y [mm]\n0,1,1\n1,,1\n", r"t\.csv:3: '' is not a finite"),
    "decimal comma": ("time [s];X [mm]\n0;1\n1;1,5\n", "'1,5' is not a finite number.*point"),
    "short row": ("time [s],X [mm]\n0,1\n1\n", r"t\.csv:3: the line has 1 cells"),
    "long row": ("time [s],X [mm]\n0,1\n1,2,3\n", r"t\.csv:3: the line has 3 cells"),
    "missing row": (
        "time [s],X [mm]\n" + "".join(f"{k},0\n" for k in range(90) if k != 50),
        r"t\.csv:\d+: the row is at .* even period.*a row may be missing",
    ),
    "odd start": (
        "time [s],X [mm]\n0.4,1\n1.4,1\n2.4,1\n",
        "begins at 0.4 s, which is not",
    ),
    "negative start": ("time [s],X [mm]\n-2,1\n-1,1\n0,1\n", "begins at -2 s"),
    "unit of operation": ("time [s],operation [mm]\n0,1\n1,1\n", "'operation' has no unit"),
    "half an operation": (
        "time [s],X [mm],operation\n0,1,0\n1,1,0.5\n",
        r"t\.csv:3: the operation 0\.5 is no whole number.*leave the column out",
    ),
    "operation below none": ("time [s],operation,X [mm]\n0,-1,1\n1,-2,1\n", r"csv:3: .*-2 is no"),
    "endless operation": ("time [s],operation,X [mm]\n0,1e300,1\n1,1,1\n", r"csv:2: .*1e\+300"),
    "brackets": ("time [s],X [[mm]\n0,1\n1,1\n", "is not the name of a column"),
}


@pytest.mark.parametrize("name", BAD_TRACES)
def test_bad_traces_are_refused_in_one_line(tmp_path, name) -> None:
    text, message = BAD_TRACES[name]
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises(RecordingError, match=message) as caught:
        read_recording(tmp_path / "t.csv")
    assert "\n" not in str(caught.value)


def test_an_archive_with_half_an_operation_is_refused(tmp_path) -> None:
    """What no table says, no archive may say: of the same kind of channel by another name too."""
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
    with pytest.raises(RecordingError, match=r"r\.npz: the operation 1\.5 is no whole number"):
        list(read_recording(tmp_path / "r.npz"))


BAD_PLT = {
    "empty": ("", "first line is ''"),
    "no heading": ("1.0\t2.0\t3.0\n", "must name columns, units and rate"),
    "no rate": ("X [mm]\tY [mm]\n1\t2\n", "must name columns, units and rate"),
    "rate alone": ("every 20 ticks of 5 ms\n", "must name columns"),
    "rate of nothing": ("X [mm]\tevery 20 ticks of 0 ms\n1\n", "tick '0 ms' cannot be read"),
    "no unit": ("X\tevery 20 ticks of 5 ms\n1\n", "'X' has no unit"),
    "a voltage": ("X.voltage [V]\tevery 2 ticks of 5 ms\n1\n", "position of an axis"),
    "the time": ("time [s]\tevery 2 ticks of 5 ms\n1\n", "position of an axis"),
    "twice": ("X [mm]\tX [mm]\tevery 2 ticks of 5 ms\n1\t1\n", "stands twice"),
    "short": ("X [mm]\tY [mm]\tevery 2 ticks of 5 ms\n1\t2\n1\n", r"t\.plt:3: the line has 1 n"),
    "nan": ("X [mm]\tevery 2 ticks of 5 ms\nnan\n", r"t\.plt:2: 'nan'"),
    "no rows": ("X [mm]\tevery 2 ticks of 5 ms\n", "no rows"),
}


@pytest.mark.parametrize("name", BAD_PLT)
def test_bad_plots_are_refused_in_one_line(tmp_path, name) -> None:
    text, message = BAD_PLT[name]
    (tmp_path / "t.plt").write_text(text)
    with pytest.raises(RecordingError, match=message) as caught:
        read_recording(tmp_path / "t.plt")
    assert "\n" not in str(caught.value)


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
    with pytest.raises(RecordingError, match=r"does not end like a recording.*Known: \.npz, \.csv"):
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
    """A recording that fails half-way leaves the old file as it was, and no other."""
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
    """A million samples pass while the blocks in hand stay small."""
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
