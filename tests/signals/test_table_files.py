"""Tick tables through files and back, and files that are damaged or made to harm."""

from __future__ import annotations

import csv
import io
import json
import pickle
import zipfile
from contextlib import suppress
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given

from tests.made import Made
from threadline.errors import RecordingError
from threadline.signals import Event, Stream, TickBlock, TickTable
from threadline.signals.files import (
    read_array,
    read_recording,
    read_table,
    read_table_csv,
    read_table_npz,
    write_array,
    write_recording,
    write_table_csv,
    write_table_npz,
)

from .makers import content, recording_of, table_of, tables

FORMATS = {
    "npz": (write_table_npz, read_table_npz),
    "csv": (write_table_csv, read_table_csv),
    "ticks": (write_array, read_array),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("tables")


@given(table=tables())
@pytest.mark.parametrize("ending", FORMATS)
def test_round_trip(folder, ending, table) -> None:
    """Rows, operations, events, hashes, scales: all come back, and the same file from them."""
    path, again = folder / f"t.{ending}", folder / f"u.{ending}"
    writer, _ = FORMATS[ending]
    done = writer(table, path)

    read = read_table(path)

    assert content(read) == content(table)
    if ending != "ticks":  # its lines end where blocks end, and blocks are not kept
        assert writer(read, again).sha256 == done.sha256


def test_numpy_reads_our_table(tmp_path) -> None:
    table = table_of([[1, -2], [3, 4]], operation=[5, 6])
    write_table_npz(table, tmp_path / "t.npz")
    with np.load(tmp_path / "t.npz", allow_pickle=False) as archive:
        assert archive["counts"].tolist() == [[1, -2], [3, 4]]
        assert archive["operation"].tolist() == [5, 6]
        assert json.loads(archive["meta.json"])["clock"] == ["servo", "1/200"]


def test_a_spreadsheet_reads_our_table(tmp_path) -> None:
    events = [Event(tick=1, kind="output", operation=2, name='a, "b"', value=1.0)]
    write_table_csv(table_of([[1, -2], [3, 4]], events=events), tmp_path / "t.csv")
    with (tmp_path / "t.csv").open(newline="") as file:
        rows = [row for row in csv.reader(file) if not row[0].startswith("#")]
    assert rows[0] == ["tick", "A [count]", "X [count]", "operation", "events"]
    assert rows[1] == ["0", "1", "-2", "0", ""]
    assert rows[2][:4] == ["1", "3", "4", "0"]
    assert json.loads(rows[2][4]) == [["output", 2, 'a, "b"', 1.0]]


def bresenham(total: int, ticks: int, phase: int) -> list[int]:
    ends = [(phase + total * k) // ticks for k in range(ticks + 1)]
    return [b - a for a, b in pairwise(ends)]


def test_constant_speeds_are_one_line_each(tmp_path) -> None:
    """As in the 1994 array: a segment is its travel ticks and its speeds, with the remainder."""
    one = zip(bresenham(481, 50, 25), bresenham(-1579, 50, 3), strict=True)
    two = zip(bresenham(100, 37, 0), bresenham(0, 37, 0), strict=True)
    table = table_of([*one, *two], operation=[1] * 50 + [2] * 37)
    write_array(table, tmp_path / "t.ticks")
    lines = (tmp_path / "t.ticks").read_text().splitlines()
    body = [line.split(",") for line in lines if line[0].isdigit()]
    assert [row[0] for row in body] == ["50", "37"]
    # 481 = 50 * 9 + 31 and -1579 = 50 * -32 + 21
    assert (body[0][1:3], body[0][4:6]) == (["9", "31"], ["-32", "21"])
    assert (body[1][1:3], body[1][4:6]) == (["2", "26"], ["0", "0"])
    assert content(read_array(tmp_path / "t.ticks")) == content(table)


def test_equal_rows_are_one_line(tmp_path) -> None:
    """A million ticks of standstill and of even speed take two lines in each block."""
    counts = np.zeros((500_000, 2), dtype=np.int64)
    counts[250_000:] = (3, -1)
    table = table_of(counts, operation=np.arange(500_000) // 250_000, rows=500_000)
    write_array(table, tmp_path / "t.ticks")
    text = (tmp_path / "t.ticks").read_text()
    assert sum(line[0].isdigit() for line in text.splitlines()) == 2
    read = read_array(tmp_path / "t.ticks")
    assert [len(b) for b in read][:2] == [65536, 65536]
    assert np.array_equal(np.concatenate([b.counts for b in read]), counts)


@pytest.mark.parametrize("ending", ["csv", "ticks"])
def test_text_tables_notice_every_cut(tmp_path, ending) -> None:
    writer, reader = FORMATS[ending]
    path = tmp_path / f"t.{ending}"
    events = [Event(tick=4, kind="end", operation=2)]
    writer(table_of([[1, -2], [3, 4], [9, 9], [0, 0]], operation=[0, 0, 1, 1], events=events), path)
    text = path.read_text()
    lines = text.splitlines(keepends=True)
    for k in range(len(lines)):
        path.write_text("".join(lines[:k] + lines[k + 1 :]))
        if lines[k].startswith(("# unit:", "# rows_sha256:")):
            continue  # what is for people; what older tables do not have
        with pytest.raises(RecordingError):
            list(reader(path))
    for size in range(len(text) - 1):
        path.write_text(text[:size])
        with pytest.raises(RecordingError):
            list(reader(path))


@pytest.mark.parametrize("kind", ["table", "recording"])
def test_archives_notice_cuts_and_flipped_bytes(tmp_path, kind) -> None:
    """A cut never passes; a flipped byte is refused or leaves the content as it was."""
    path = tmp_path / "t.npz"
    if kind == "table":
        made = table_of([[1, -2], [3, 4]] * 20, events=[Event(tick=1, kind="stop", operation=1)])
        write_table_npz(made, path)

        def read():
            return content(read_table_npz(path))
    else:
        recording = recording_of({"X.load": list(range(50))})
        write_recording(recording, path)

        def read():
            found = read_recording(path)
            return [b.samples["X.load"].tolist() for b in found]

    data = path.read_bytes()
    expected = read()
    for size in range(0, len(data), 17):
        path.write_bytes(data[:size])
        with pytest.raises(RecordingError):
            read()
    for at in range(0, len(data), 5):
        path.write_bytes(data[:at] + bytes([data[at] ^ 0x24]) + data[at + 1 :])
        with suppress(RecordingError):
            assert read() == expected, at


def npy_bytes(array, **options) -> bytes:
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, array, **options)
    return buffer.getvalue()


class Harm:
    """Leaves a mark when it is unpickled."""

    def __reduce__(self):
        return (open, ("harm.txt", "w"))


GOOD_META = {
    "format": "tick-table 1",
    "clock": ["servo", "1/200"],
    "axes": ["A", "X"],
    "counts_per_unit": [1.0, 2.0],
    "start_counts": [0, 0],
    "job_sha256": "",
    "machine_sha256": "",
    "event_names": [],
}
GOOD = {
    "counts": npy_bytes(np.zeros((3, 2), dtype="<i8")),
    "operation": npy_bytes(np.zeros(3, dtype="<i8")),
    "event_tick": npy_bytes(np.zeros(0, dtype="<i8")),
    "event_kind": npy_bytes(np.zeros(0, dtype="<u1")),
    "event_operation": npy_bytes(np.zeros(0, dtype="<i8")),
    "event_name": npy_bytes(np.zeros(0, dtype="<i4")),
    "event_value": npy_bytes(np.zeros(0, dtype="<f8")),
}


def archive(path, members=GOOD, meta=GOOD_META, **changes):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        if meta is not None:
            file.writestr("meta.json", meta if isinstance(meta, bytes) else json.dumps(meta))
        for name, data in {**members, **changes}.items():
            if data is not None:
                file.writestr(f"{name}.npy", data)
    return path


def test_the_archive_of_these_tests_is_good(tmp_path) -> None:
    assert read_table_npz(archive(tmp_path / "t.npz")).tick_count() == 3


BAD_COLUMNS = {
    "missing": (None, "no column 'counts'"),
    "pickle": (
        npy_bytes(np.array([[Harm(), 1]], dtype=object), allow_pickle=True),
        r"holds '\|O', expected '<i8'",
    ),
    "raw pickle": (pickle.dumps(Harm()), "no array of a known version"),
    "floats": (npy_bytes(np.zeros((3, 2))), "holds '<f8', expected '<i8'"),
    "big endian": (npy_bytes(np.zeros((3, 2), dtype=">i8")), "holds '>i8', expected '<i8'"),
    "fields": (npy_bytes(np.zeros(3, dtype=[("a", "<i8")])), "expected '<i8'"),
    "one axis": (npy_bytes(np.zeros((3, 1), dtype="<i8")), r"shape \(3, 1\)"),
    "flat": (npy_bytes(np.zeros(6, dtype="<i8")), r"shape \(6,\)"),
    "fortran": (npy_bytes(np.asfortranarray(np.zeros((3, 2), dtype="<i8"))), "has shape"),
    "other length": (npy_bytes(np.zeros((4, 2), dtype="<i8")), "counts has 4 rows, operation"),
    "promise": (
        npy_bytes(np.zeros((3, 2), dtype="<i8")).replace(b"(3, 2)", b"(9, 2)"),
        "promises 9 rows",
    ),
    "negative promise": (
        npy_bytes(np.zeros((33, 2), dtype="<i8")).replace(b"(33, 2)", b"(-3, 2)"),
        "header that cannot be read",
    ),
    "huge": (npy_bytes(np.full((3, 2), 2**62)), "travels 4611686018427387904 counts in one tick"),
    "not npy": (b"hello", "no array of a known version"),
    "no bytes": (b"", "no array of a known version"),
    "header of code": (
        b"\x93NUMPY\x01\x00\x76\x00" + b"__import__('os').system('true')".ljust(117) + b"\n",
        "header that cannot be read",
    ),
    "header version": (b"\x93NUMPY\x03\x00\x76\x00\x00\x00", "no array of a known version"),
}


@pytest.mark.parametrize("name", BAD_COLUMNS)
def test_bad_columns_are_refused(tmp_path, monkeypatch, name) -> None:
    monkeypatch.chdir(tmp_path)
    data, message = BAD_COLUMNS[name]
    path = archive(tmp_path / "t.npz", counts=data)
    with pytest.raises(RecordingError, match=message) as caught:
        list(read_table_npz(path))
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "harm.txt").exists()


BAD_META = {
    "missing": (None, "no meta.json"),
    "not json": (b"{", "is not JSON"),
    "deep": (b"[" * 100_000, "is not JSON"),
    "not text": (b"\xff", "not UTF-8"),
    "a list": (b"[]", "known version"),
    "other format": ({**GOOD_META, "format": "recording 1"}, "known version"),
    "unknown key": ({**GOOD_META, "extra": 1}, "wrong at 'extra'"),
    "no axes": ({**GOOD_META, "axes": []}, "wrong at 'axes'"),
    "an axis twice": ({**GOOD_META, "axes": ["X", "X"]}, "names an axis twice"),
    "short scale": ({**GOOD_META, "counts_per_unit": [1.0]}, "2 axes, 1 scales"),
    "infinite scale": (
        json.dumps(GOOD_META).replace("[1.0, 2.0]", "[1.0, Infinity]").encode(),
        "counts_per_unit.1",
    ),
    "fraction of a count": ({**GOOD_META, "start_counts": [0.5, 0]}, "start_counts.0"),
    "huge start": ({**GOOD_META, "start_counts": [10**30, 0]}, "start_counts.0"),
    "clock": ({**GOOD_META, "clock": ["servo", "0/1"]}, "must be greater than zero"),
    "clock by zero": ({**GOOD_META, "clock": ["servo", "1/0"]}, "must be greater than zero"),
    "clock as number": ({**GOOD_META, "clock": ["servo", 0.005]}, "clock.1"),
    "names": ({**GOOD_META, "event_names": [1]}, "event_names is not a list"),
}


@pytest.mark.parametrize("name", BAD_META)
def test_bad_descriptions_are_refused(tmp_path, name) -> None:
    meta, message = BAD_META[name]
    path = archive(tmp_path / "t.npz", meta=meta)
    with pytest.raises(RecordingError, match=message) as caught:
        list(read_table_npz(path))
    assert "\n" not in str(caught.value)


def events(**changes) -> dict[str, bytes]:
    """The columns of one event."""
    columns = {
        "event_tick": np.array([1], dtype="<i8"),
        "event_kind": np.array([0], dtype="<u1"),
        "event_operation": np.array([1], dtype="<i8"),
        "event_name": np.array([0], dtype="<i4"),
        "event_value": np.array([1.0]),
    }
    return {name: npy_bytes(changes.get(name, value)) for name, value in columns.items()}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"event_kind": np.array([99], dtype="<u1")}, "an event has kind 99"),
        ({"event_name": np.array([5], dtype="<i4")}, "name 5"),
        ({"event_name": np.array([-1], dtype="<i4")}, "name -1"),
        ({"event_tick": np.array([-1], dtype="<i8")}, "tick -1"),
        ({"event_value": np.array([np.nan])}, "the value nan"),
        ({"event_value": np.array([1.0, 2.0])}, "differ in length"),
    ],
)
def test_bad_events_are_refused(tmp_path, changes, message) -> None:
    meta = {**GOOD_META, "event_names": ["valve"]}
    assert len(list(read_table_npz(archive(tmp_path / "t.npz", meta=meta, **events())))) == 1
    path = archive(tmp_path / "t.npz", meta=meta, **events(**changes))
    with pytest.raises(RecordingError, match=message):
        list(read_table_npz(path))


def test_bombs_are_refused_before_they_are_unpacked(tmp_path) -> None:
    """A column that promises more than deflate can pack, a description of a gigabyte."""
    path = archive(tmp_path / "t.npz")
    data = path.read_bytes()
    with zipfile.ZipFile(path) as file:
        info = file.getinfo("counts.npy")
        at = data.rindex(b"counts.npy") - 46  # its entry in the central directory
    size = info.file_size.to_bytes(4, "little")
    assert data[at + 24 : at + 28] == size
    path.write_bytes(data[: at + 24] + (2**31).to_bytes(4, "little") + data[at + 28 :])
    with pytest.raises(RecordingError, match="promises more than it can hold"):
        read_table_npz(path)
    big = json.dumps({**GOOD_META, "axes": ["x" * 3_000_000]}).encode()
    with pytest.raises(RecordingError, match=r"meta\.json has .* bytes, limit"):
        read_table_npz(archive(tmp_path / "t.npz", meta=big))


def test_strange_archives_are_refused(tmp_path) -> None:
    path = tmp_path / "t.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_LZMA) as file:
        file.writestr("meta.json", json.dumps(GOOD_META))
    with pytest.raises(RecordingError, match="packed in an unusual way"):
        read_table_npz(path)
    with zipfile.ZipFile(path, "w") as file:
        for k in range(600):
            file.writestr(f"{k}.npy", b"")
    with pytest.raises(RecordingError, match="too many"):
        read_table_npz(path)
    archive(path)
    with (
        zipfile.ZipFile(path, "a") as file,
        pytest.warns(UserWarning, match="Duplicate"),
    ):
        file.writestr("counts.npy", b"")
    with pytest.raises(RecordingError, match="repeated names"):
        read_table_npz(path)
    write_recording(recording_of({"X.load": [0.0, 1.0]}), path)
    with pytest.raises(RecordingError, match="does not hold a tick table"):
        read_table_npz(path)
    write_table_npz(table_of([[1, 2]]), path)
    with pytest.raises(RecordingError, match="not a tick table"):
        read_recording(path)


HEAD = """# threadline tick-table 1
# clock: ["servo", "1/200"]
# axes: ["X"]
# counts_per_unit: [55358.0]
# start_counts: [0]
# job_sha256: ""
# machine_sha256: ""
"""
COLUMNS = "tick,X [count],operation,events\n"
END = "# end after ticks: 2\n"
ROWS = "0,10,0,\n1,11,0,\n"

BAD_TABLES = {
    "title": ("tick,X\n", r"t\.csv:1: the file begins with 'tick,X'"),
    "empty": ("", "begins with ''"),
    "no columns": (HEAD, "ends before its columns"),
    "key twice": (
        HEAD + '# axes: ["Y"]\n' + COLUMNS + ROWS + END,
        r"t\.csv:8: 'axes' stands twice",
    ),
    "no value": (HEAD + "# nonsense\n" + COLUMNS + ROWS + END, "not a '# key: value' line"),
    "bad value": (HEAD + "# key: {\n" + COLUMNS + ROWS + END, r"t\.csv:8: .* is not JSON"),
    "unknown key": (HEAD + "# key: 1\n" + COLUMNS + ROWS + END, "wrong at 'key'"),
    "unknown column": (
        HEAD + "tick,Y [count],operation,events\n",
        "unknown column 'Y.*'X",
    ),
    "order": (HEAD + "X [count],tick,operation,events\n", "the columns are"),
    "short": (HEAD + COLUMNS + "0,10,0\n" + END, r"t\.csv:9: the line has 3 cells, expected 4"),
    "fraction": (HEAD + COLUMNS + "0,1.5,0,\n", "'1.5' is not a whole number"),
    "word": (HEAD + COLUMNS + "0,ten,0,\n", "'ten' is not a whole number"),
    "other digits": (HEAD + COLUMNS + "0,\u0663,0,\n", "is not a whole number"),
    "endless": (HEAD + COLUMNS + f"0,{'9' * 5000},0,\n", "is not a whole number"),
    "too large": (HEAD + COLUMNS + f"0,{10**17},0,\n", "is beyond"),
    "too fast": (HEAD + COLUMNS + f"0,{2**45},0,\n1,0,0,\n" + END, "counts in one tick"),
    "doubled row": (HEAD + COLUMNS + "0,1,0,\n0,1,0,\n", r"t\.csv:10: tick 0 follows tick 0"),
    "row lost": (HEAD + COLUMNS + "0,1,0,\n2,1,0,\n", "tick 2 follows tick 0.*missing"),
    "events": (HEAD + COLUMNS + "0,1,0,stop\n", "'stop' is not a list of events"),
    "event form": (HEAD + COLUMNS + '0,1,0,"[[""stop""]]"\n', "is not an event.*kind, operation"),
    "event kind": (
        HEAD + COLUMNS + '0,1,0,"[[""stopp"",0,"""",0]]"\n',
        "unknown kind of event 'stopp'. Did you mean 'stop'",
    ),
    "event value": (HEAD + COLUMNS + '0,1,0,"[[""stop"",0,"""",NaN]]"\n', "an event has the value"),
    "event json": (HEAD + COLUMNS + '0,1,0,"[["\n', "is not JSON"),
    "event tick": (HEAD + COLUMNS + ROWS + "0,,,\n" + END, "tick 0 stands twice"),
    "no counts": (HEAD + COLUMNS + ROWS + "2,,,\n" + END, "no counts and no events"),
    "row after events": (
        HEAD + COLUMNS + '5,,,"[[""end"",0,"""",0]]"\n0,1,0,\n' + END,
        "follows the events",
    ),
    "wrong end": (HEAD + COLUMNS + ROWS + "# end after ticks: 3\n", "has 2 ticks, its end says 3"),
    "no end": (HEAD + COLUMNS + ROWS, "the table is cut off"),
    "after the end": (HEAD + COLUMNS + ROWS + END + "2,1,0,\n", "goes on after its end"),
}


@pytest.mark.parametrize("name", BAD_TABLES)
def test_bad_tables_are_refused_in_one_line(tmp_path, name) -> None:
    text, message = BAD_TABLES[name]
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises(RecordingError, match=message) as caught:
        list(read_table(tmp_path / "t.csv"))
    assert "\n" not in str(caught.value)


ARRAY = HEAD.replace("tick-table", "trajectory-array") + (
    "ticks,X [count/tick],X remainder,X phase,operation,events\n"
)

BAD_ARRAYS = {
    "remainder": ("4,1,4,0,0,\n", "remainders and phases must lie between 0 and 3"),
    "negative remainder": ("4,1,-1,0,0,\n", "must lie between"),
    "phase": ("4,1,1,4,0,\n", "must lie between"),
    "too long": (f"{2**31 + 1},1,0,0,0,\n", "2147483649 ticks, limit"),
    "negative": ("-4,1,0,0,0,\n", "-4 ticks, limit"),
    "short": ("4,1,0,0\n", "has 4 cells, expected 6"),
    "word": ("four,1,0,0,0,\n", "'four' is not a whole number"),
    "wrong end": ("3,1,0,0,0,\n" + END, "has 3 ticks, its end says 2"),
    "no end": ("2,1,0,0,0,\n", "cut off"),
    "beyond the end": (f"1,1,0,0,0,\n{2**31},1,0,0,0,\n" + END, "until tick 2147483649, and"),
    "long without end": (f"{2**31},1,0,0,0,\n", "cut off"),
}


@pytest.mark.parametrize("name", BAD_ARRAYS)
def test_bad_arrays_are_refused_in_one_line(tmp_path, name) -> None:
    text, message = BAD_ARRAYS[name]
    (tmp_path / "t.ticks").write_text(ARRAY + text)
    with pytest.raises(RecordingError, match=message):
        list(read_table(tmp_path / "t.ticks"))


def test_a_long_line_of_the_array_comes_in_parts(tmp_path) -> None:
    """Two thousand million ticks in one line do not have to fit into memory."""
    (tmp_path / "t.ticks").write_text(f"{ARRAY}{2**31},1,0,0,0,\n# end after ticks: {2**31}\n")
    block = next(iter(read_table(tmp_path / "t.ticks")))
    assert len(block) == 65536
    assert (block.counts == 1).all()


def test_the_scale_of_a_table_says_what_it_is_per(tmp_path) -> None:
    """Older tables have no such line; another unit is refused, and not converted."""
    path = tmp_path / "t.csv"
    write_table_csv(table_of([[1, 2]]), path)
    text = path.read_text()
    line = '# unit: "count/m of a linear axis, count/rad of a rotary one"\n'
    assert text.splitlines(keepends=True)[4] == line
    path.write_text(text.replace(line, ""))
    assert read_table_csv(path).axes == table_of([[1, 2]]).axes
    path.write_text(text.replace("count/m of", "count/mm of"))
    with pytest.raises(RecordingError):
        read_table_csv(path)


def test_writing_is_all_or_nothing(tmp_path) -> None:
    good = table_of([[1, 2]])

    def broken():
        yield from good
        raise RecordingError("out of ticks")

    bad = TickTable(
        clock=good.clock,
        axes=good.axes,
        counts_per_unit=good.counts_per_unit,
        start_counts=good.start_counts,
        blocks=Made(broken),
        job_sha256="",
        machine_sha256="",
    )
    for ending, (writer, _) in FORMATS.items():
        with pytest.raises(RecordingError, match="out of ticks"):
            writer(bad, tmp_path / f"t.{ending}")
    assert list(tmp_path.iterdir()) == []


def test_an_event_outside_its_block_is_not_lost_silently(tmp_path) -> None:
    block = TickBlock(
        first_tick=0,
        counts=np.zeros((2, 2), dtype=np.int64),
        operation=np.zeros(2, dtype=np.int64),
        events=(Event(tick=9, kind="stop", operation=0),),
    )
    good = table_of([[1, 2]])
    table = TickTable(
        clock=good.clock,
        axes=good.axes,
        counts_per_unit=good.counts_per_unit,
        start_counts=good.start_counts,
        blocks=Stream.of([block]),
        job_sha256="",
        machine_sha256="",
    )
    with pytest.raises(ValueError, match="outside its block"):
        write_array(table, tmp_path / "t.ticks")
    assert list(tmp_path.iterdir()) == []
