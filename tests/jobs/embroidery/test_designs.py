"""Designs of every format become the moves of the frame: merged, and travel kept apart."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pystitch
import pytest

from tests.conftest import NO_SAMPLES, SHARED_SAMPLES
from threadline.errors import JobError
from threadline.jobs import Job, Move, Stop, ToolEvent, read_job
from threadline.machine import load_machine
from threadline.machine.load import library_file
from threadline.proof.options import Options
from threadline.proof.pipeline import prove
from threadline.verdict import load_spec

MACHINE = load_machine("schiffli-frame")
SAMPLES = SHARED_SAMPLES / "embroidery"
STITCHES = [(0, 0), (30, 0), (30, 25), (-12, 40), (-50, 3)]  # 0.1 mm, Y up


def exp(*records: tuple[int, int] | bytes) -> bytes:
    """Return a design in EXP, two bytes for each stitch, written from the format's description."""
    return b"".join(r if isinstance(r, bytes) else struct.pack("bb", *r) for r in records)


def jump(x: int, y: int) -> bytes:
    return b"\x80\x04" + struct.pack("bb", x, y)


COLOUR = b"\x80\x01\x00\x00"
TRIM = b"\x80\x80\x07\x00"


def read(tmp_path: Path, content: bytes, name: str = "a.exp") -> Job:
    file = tmp_path / name
    file.write_bytes(content)
    return read_job(file, MACHINE)


def moves(job: Job) -> Iterator[tuple[float, float, int, int]]:
    """Yield x and y in 0.1 mm, number of the stitch and of its block."""
    for item in job:
        if isinstance(item, Move):
            x, y = (round(value / 1e-4, 6) for value in item.target)
            yield x, y, item.tags["stitch"], item.tags["block"]


@pytest.mark.parametrize("suffix", ["dst", "exp", "pes", "jef", "vp3", "xxx", "u01"])
def test_every_format_gives_the_same_places(suffix: str, tmp_path: Path) -> None:
    """Another library writes them; formats centre or begin elsewhere, and the ways are the same."""
    pattern = pystitch.EmbPattern()
    for x, y in STITCHES:
        pattern.add_stitch_absolute(pystitch.STITCH, x, -y)
    pattern.end()
    file = tmp_path / f"a.{suffix}"
    pystitch.write(pattern, str(file))
    places = [(x, y) for x, y, number, _ in moves(read_job(file, MACHINE)) if number]
    displacements = [way for way in np.diff(places, axis=0).tolist() if way != [0.0, 0.0]]
    assert displacements == np.diff(STITCHES, axis=0).tolist()


def test_jumps_before_a_stitch_are_one_move(tmp_path: Path) -> None:
    """16.5 mm in two records is one stitch; one unit more is travel, and a stitch in place."""
    begin = ((10, 0), (0, 0))  # to the first stitch: travel
    longest = read(tmp_path, exp(*begin, jump(120, 0), (45, 0)))
    assert list(moves(longest)) == [(10, 0, 0, 1), (10, 0, 1, 1), (10, 0, 2, 1), (175, 0, 3, 1)]
    longer = read(tmp_path, exp(*begin, jump(120, 0), (46, 0)))
    assert list(moves(longer))[3:] == [(176, 0, 0, 1), (176, 0, 3, 1)]


def test_a_run_without_a_stitch_is_travel_and_events_keep_their_place(tmp_path: Path) -> None:
    content = exp((0, 0), (5, 0), TRIM, jump(30, 7), COLOUR, jump(1, 1), (2, 2), jump(9, 9))
    job = read(tmp_path, content)
    assert list(moves(job)) == [
        (0, 0, 1, 1), (5, 0, 2, 1), (35, 7, 0, 1), (38, 10, 3, 2), (47, 19, 0, 2),
    ]  # fmt: skip
    kinds = [item.name if isinstance(item, ToolEvent) else type(item) for item in job]
    assert kinds == [Move, Move, "trim", Move, "colour", Move, Move, Stop]
    assert [item.source.line for item in job] == [1, 2, 3, 5, 5, 7, 9, 9]


def test_stitches_that_lead_nowhere_are_told(tmp_path: Path) -> None:
    job = read(tmp_path, exp((5, 0), (0, 0), (0, 0), (1, 0)))
    assert [number for *_, number, _ in moves(job)] == [0, 1, 2, 3, 4]
    assert "2 stitches lead nowhere" in job.warnings[0]
    assert "1 stitch leads" in read(tmp_path, exp((5, 0), (0, 0), (1, 0))).warnings[0]


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.exp", b"", "no stitch in the design"),
        ("a.exp", exp(jump(5, 5)), "no stitch in the design"),
        ("a.dst", b"LA:x" + b"\x20" * 600, "without the mark of its end"),
        ("a.dst", b"", "without the mark of its end"),
        ("a.exp", exp((1, 1), (2, 2)) + b"\x01", "byte 3 of 5 is no record"),
        ("a.exp", exp((1, 1), b"\x80\x55\x00\x00", (2, 2)), "byte 4 of 8 is no record"),
        ("a.hus", b"\x5b\xaf\xc8\x00" * 3, "cannot be read as HUS"),
        ("a.vp3", b"%vsm%", "cannot be read as VP3"),
    ],
)
def test_file_without_a_design_is_refused_in_one_line(
    name: str, content: bytes, message: str, tmp_path: Path
) -> None:
    with pytest.raises(JobError, match=message) as refused:
        read(tmp_path, content, name)
    assert "\n" not in str(refused.value)


def long_stitch(folder: Path, suffix: str, x: int, y: int) -> Path:
    """Write a design whose third stitch is long, of even units for the writer of VP3.

    VP3 holds the stitch in one record, DST as jumps and a stitch.
    """
    pattern = pystitch.EmbPattern()
    for at in ((0, 0), (10, 0), (10 + x, y), (20 + x, y)):
        pattern.add_stitch_absolute(pystitch.STITCH, at[0], -at[1])
    pattern.end()
    file = folder / f"a.{suffix}"
    kept = {
        "vp3": pystitch.CONTINGENCY_LONG_STITCH_NONE,
        "dst": pystitch.CONTINGENCY_LONG_STITCH_JUMP_NEEDLE,
    }
    pystitch.write(pattern, str(file), {"long_stitch_contingency": kept[suffix]})
    return file


@pytest.mark.parametrize("suffix", ["vp3", "dst"])
def test_a_long_stitch_is_refused_by_its_record_where_that_is_asked(
    suffix: str, tmp_path: Path
) -> None:
    file = long_stitch(tmp_path, suffix, 224, 100)
    with pytest.raises(JobError, match=r"a\.\w+:\d: a stitch of 22\.4 mm, the longest.*16\.5 mm"):
        read_job(file, MACHINE, long_stitches="refuse")


def test_a_stitch_of_half_a_metre_is_travel(tmp_path: Path) -> None:
    """In VP3 it is one record, and in DST several jumps, which are a trim, too."""
    for suffix in ("vp3", "dst"):
        job = read_job(long_stitch(tmp_path, suffix, 5000, 0), MACHINE)
        assert 0 in [number for *_, number, _ in moves(job)][1:]


@pytest.mark.parametrize(
    ("asked", "parts"),
    [
        (None, [((224, 100), 0), ((224, 100), 3), ((234, 100), 4)]),
        ("travel", [((224, 100), 0), ((224, 100), 3), ((234, 100), 4)]),
        ("split", [((112, 50), 3), ((224, 100), 4), ((234, 100), 5)]),
    ],
)
def test_a_long_stitch_is_sewn_alike_with_jumps_and_without(
    asked: str | None, parts: list[tuple[tuple[int, int], int]], tmp_path: Path
) -> None:
    """22.4 mm of at most 16.5: one record of VP3, two of DST; once, VP3 was refused."""
    options = {} if asked is None else {"long_stitches": asked}
    for suffix in ("vp3", "dst"):
        job = read_job(long_stitch(tmp_path, suffix, 224, 100), MACHINE, **options)
        found = list(moves(job))[-5:]
        second = found[1] if asked != "split" else found[-4]
        origin = (second[0], second[1])
        last_stitches = [((x - origin[0], y - origin[1]), n) for x, y, n, _ in found[-3:]]
        assert last_stitches == parts
        assert any("--long-stitches" in warning for warning in job.warnings) == (
            suffix == "vp3" or asked == "split"
        )


def test_the_parts_of_a_long_stitch_are_short_enough_and_on_the_grid(tmp_path: Path) -> None:
    for x, y in ((166, 166), (330, 2), (332, -331), (1000, 7)):
        job = read(tmp_path, exp((1, 0), (1, 0), *[jump(x // 10, y // 10)] * 9,
                                 (x - 9 * (x // 10), y - 9 * (y // 10))))  # fmt: skip
        assert 0 in [number for *_, number, _ in moves(job)][1:]
        split = read_job(tmp_path / "a.exp", MACHINE, long_stitches="split")
        places = np.array([(0, 0), *((x, y) for x, y, *_ in moves(split))])
        displacements = np.abs(np.diff(places, axis=0)).max(axis=1)
        assert displacements.max() <= 165
        assert np.array_equal(places, np.rint(places))
        assert tuple(places[-1]) == (2 + x, y)
        assert len(places) == 1 + 3 + -(-max(abs(x), abs(y)) // 165)


def test_behind_a_trim_or_another_thread_no_way_is_split(tmp_path: Path) -> None:
    for event in (TRIM, COLOUR):
        read(tmp_path, exp((1, 0), (1, 0), event, jump(100, 0), (100, 0), (1, 0)))
        for asked in ("split", "refuse"):
            job = read_job(tmp_path / "a.exp", MACHINE, long_stitches=asked)
            assert [(x, number) for x, _, number, _ in moves(job)][-3:] == [
                (202, 0), (202, 3), (203, 4),
            ]  # fmt: skip


def test_a_machine_without_tables_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.exp").write_bytes(exp((1, 1)))
    with pytest.raises(JobError, match="'lathe-winder' does not embroider"):
        read_job(tmp_path / "a.exp", load_machine("lathe-winder"))


def test_the_example_has_all_that_a_frame_does(examples: Path) -> None:
    """Known from its maker: 184 moves, the longest 16.5 mm, a trim and a colour."""
    job = read_job(examples / "rosette.dst", MACHINE)
    sewn = [(x, y) for x, y, number, _ in moves(job) if number]
    assert len(sewn) == 185
    assert np.abs(np.diff(sewn, axis=0)).max() == 165
    assert [i.name for i in job if isinstance(i, ToolEvent)] == ["trim", "colour"]


@pytest.mark.skipif(not SAMPLES.is_dir(), reason=NO_SAMPLES)
@pytest.mark.parametrize(
    ("name", "count", "longest"),
    [("tree.dst", 614, 68), ("peace.dst", 773, 101), ("Star.DST", 2549, 35)],
)
def test_real_designs_have_as_many_moves_as_were_counted(
    name: str, count: int, longest: int
) -> None:
    """Counted by hand from the records, for another study: moves after the first stitch."""
    sewn = [(x, y) for x, y, number, _ in moves(read_job(SAMPLES / name, MACHINE)) if number]
    displacements = np.abs(np.diff(sewn, axis=0)).max(axis=1)
    assert len(displacements) == count
    assert displacements.max() == longest


def test_the_order_of_the_axes_in_a_machine_file_changes_no_design(tmp_path: Path) -> None:
    """A machine with Y before X was refused as if it had no step tables for X and Y."""
    text = library_file("schiffli-frame").read_text(encoding="utf-8")
    x, y = text.index("[axes.X]"), text.index("[axes.Y]")
    end = text.index("\n[", y) + 1
    file = tmp_path / "turned.toml"
    file.write_text(text[:x] + text[y:end] + text[x:y] + text[end:])
    turned = load_machine(str(file))
    assert turned.axis_names == ("Y", "X")
    design = tmp_path / "a.exp"
    design.write_bytes(exp((30, 0), (20, 10), (-12, 40), (-50, 3)))
    loads, values = [], []
    for machine in (MACHINE, turned):
        proof = prove(design, machine, load_spec(None, machine), Options())
        loads.append({a: proof.recording.samples(f"{a}.load")[1] for a in "XY"})
        values.append({(r.name, r.axis): r.measured for r in proof.verdict.results})
    assert values[0] == values[1]
    for axis in "XY":
        np.testing.assert_array_equal(loads[0][axis], loads[1][axis])
    assert np.abs(loads[0]["X"] - loads[0]["Y"]).max() > 1e-3
