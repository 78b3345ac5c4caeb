"""Archives of tick tables that are cut, damaged or made to harm."""

from __future__ import annotations

import io
import json
import pickle
import zipfile
from contextlib import suppress

import numpy as np
import pytest

from threadline.errors import RecordingError
from threadline.files import Event
from threadline.files.formats import read_recording, write_recording
from threadline.files.formats.tick_table import read_table_npz, write_table_npz

from .makers import content, recording_of, table_of


def test_numpy_reads_our_table(tmp_path) -> None:
    table = table_of([[1, -2], [3, 4]], operation=[5, 6])
    write_table_npz(table, tmp_path / "t.npz")
    with np.load(tmp_path / "t.npz", allow_pickle=False) as archive:
        assert archive["counts"].tolist() == [[1, -2], [3, 4]]
        assert archive["operation"].tolist() == [5, 6]
        assert json.loads(archive["meta.json"])["clock"] == ["servo", "1/200"]


@pytest.mark.parametrize("kind", ["table", "recording"])
def test_archives_notice_cuts_and_flipped_bytes(tmp_path, kind) -> None:
    """A cut never passes; a flipped byte is refused or leaves the content unchanged."""
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
    "raw pickle": (pickle.dumps(Harm()), "not an array of a known version"),
    "floats": (npy_bytes(np.zeros((3, 2))), "holds '<f8', expected '<i8'"),
    "big endian": (npy_bytes(np.zeros((3, 2), dtype=">i8")), "holds '>i8', expected '<i8'"),
    "fields": (npy_bytes(np.zeros(3, dtype=[("a", "<i8")])), "expected '<i8'"),
    "one axis": (npy_bytes(np.zeros((3, 1), dtype="<i8")), r"shape \(3, 1\)"),
    "flat": (npy_bytes(np.zeros(6, dtype="<i8")), r"shape \(6,\)"),
    "fortran": (npy_bytes(np.asfortranarray(np.zeros((3, 2), dtype="<i8"))), "has shape"),
    "other length": (npy_bytes(np.zeros((4, 2), dtype="<i8")), "counts has 4 rows, operation"),
    "promise": (
        npy_bytes(np.zeros((3, 2), dtype="<i8")).replace(b"(3, 2)", b"(9, 2)"),
        "claims 9 rows",
    ),
    "negative promise": (
        npy_bytes(np.zeros((33, 2), dtype="<i8")).replace(b"(33, 2)", b"(-3, 2)"),
        "header of column .* cannot be read",
    ),
    "huge": (npy_bytes(np.full((3, 2), 2**62)), "travels 4611686018427387904 counts in one tick"),
    "not npy": (b"hello", "not an array of a known version"),
    "no bytes": (b"", "not an array of a known version"),
    "header of code": (
        b"\x93NUMPY\x01\x00\x76\x00" + b"__import__('os').system('true')".ljust(117) + b"\n",
        "header of column .* cannot be read",
    ),
    "header version": (b"\x93NUMPY\x03\x00\x76\x00\x00\x00", "not an array of a known version"),
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
        ({"event_value": np.array([np.nan])}, "value nan"),
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
    """A column that promises more than deflate can pack, and a description of a gigabyte."""
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
    with pytest.raises(RecordingError, match="unknown compression"):
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
