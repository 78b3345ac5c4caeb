"""Tick tables through files and back, and text tables that are damaged."""

from __future__ import annotations

import csv
import json
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given

from tests.made import Made
from threadline.errors import RecordingError
from threadline.files import Event, Stream, TickBlock, TickTable
from threadline.files.formats import read_table
from threadline.files.formats.table_text import read_table_csv
from threadline.files.formats.tick_table import read_table_npz, write_table_csv, write_table_npz
from threadline.files.formats.trajectory_array import read_array, write_array

from .makers import content, table_of, tables

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
            continue  # text for people; lines that older tables do not have
        with pytest.raises(RecordingError):
            list(reader(path))
    for size in range(len(text) - 1):
        path.write_text(text[:size])
        with pytest.raises(RecordingError):
            list(reader(path))


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
        r"t\.csv:8: 'axes' occurs twice",
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
    "event value": (HEAD + COLUMNS + '0,1,0,"[[""stop"",0,"""",NaN]]"\n', "an event has value"),
    "event json": (HEAD + COLUMNS + '0,1,0,"[["\n', "is not JSON"),
    "event tick": (HEAD + COLUMNS + ROWS + "0,,,\n" + END, "tick 0 occurs twice"),
    "no counts": (HEAD + COLUMNS + ROWS + "2,,,\n" + END, "no counts and no events"),
    "row after events": (
        HEAD + COLUMNS + '5,,,"[[""end"",0,"""",0]]"\n0,1,0,\n' + END,
        "follows the events",
    ),
    "wrong end": (HEAD + COLUMNS + ROWS + "# end after ticks: 3\n", "has 2 ticks, its end says 3"),
    "no end": (HEAD + COLUMNS + ROWS, "the table is cut off"),
    "after the end": (HEAD + COLUMNS + ROWS + END + "2,1,0,\n", "rows follow the end of the table"),
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
    "beyond the end": (f"1,1,0,0,0,\n{2**31},1,0,0,0,\n" + END, "to tick 2147483649, but"),
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
