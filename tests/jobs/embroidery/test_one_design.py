"""One design in every format: the needle enters at the same places, in the same order."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import NamedTuple

import pystitch
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pystitch import EmbThreadJef, EmbThreadPec
from tools import fuzz_designs

from threadline.errors import JobError, Place
from threadline.jobs.embroidery.job import read_design
from threadline.jobs.embroidery.pes import read_pes
from threadline.jobs.embroidery.records import UNIT_M, Act, read_records
from threadline.jobs.embroidery.threads import hus_threads
from threadline.jobs.operations import Thread
from threadline.machine import load_machine

FRAME = load_machine("schiffli-frame")

WRITTEN = {
    "dst": {},
    "exp": {},
    "jef": {},
    "vp3": {},
    "xxx": {},
    "u01": {},
    "pes": {"version": 1},
    "6.pes": {"version": 6},
    "1t.pes": {"version": "1t"},
    "6t.pes": {"version": "6t"},
    "pec": {},
}
"""Ending of the file, and settings of pystitch's writer."""


class Way(NamedTuple):
    """The way to the next place: a stitch, a jump and a stitch, or another thread as well."""

    act: str
    x: int
    y: int


_UNITS = st.integers(-100, 100) | st.sampled_from((0, 62, 63, 64, -63, -64, -65))
DESIGNS = st.lists(
    st.builds(Way, st.sampled_from(("stitch", "stitch", "jump", "colour")), _UNITS, _UNITS),
    min_size=2,
    max_size=12,
)


def pattern_of(moves: list[Way]) -> tuple[pystitch.EmbPattern, list[tuple[int, int]]]:
    """Return a pattern, and X and Y (up) of its stitches in 0.1 mm."""
    pattern = pystitch.EmbPattern()
    pattern.add_thread(pystitch.EmbThread(0xFF0000))
    x = y = 0
    places = []
    for number, way in enumerate(moves):
        x, y = x + way.x, y + way.y
        if way.act != "stitch":
            pattern.add_stitch_absolute(pystitch.JUMP, x, -y)
        if way.act == "colour" and number:
            pattern.add_command(pystitch.COLOR_CHANGE)
            pattern.add_thread(pystitch.EmbThread((0x00FF00, 0xFF0000)[number % 2]))
        pattern.add_stitch_absolute(pystitch.STITCH, x, -y)
        places.append((x, y))
    pattern.end()
    return pattern, places


def once(places: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return places from the first on, without repeated needle-downs.

    A writer may add a stitch in place after a jump or at the end of a thread.
    """
    first = places[0]
    moved = [(round(x - first[0], 6), round(y - first[1], 6)) for x, y in places]
    return [one for at, one in enumerate(moved) if not at or one != moved[at - 1]]


def read_back(file: Path) -> list[tuple[float, float]]:
    records = read_records(file)
    sewn = records.position_m[records.act == Act.STITCH] / UNIT_M
    return [(round(x, 6), round(y, 6)) for x, y in sewn.tolist()]


@pytest.mark.parametrize("ending", list(WRITTEN))
@settings(max_examples=25)
@given(moves=DESIGNS)
def test_every_format_has_the_same_stitches(
    ending: str, tmp_path_factory: pytest.TempPathFactory, moves: list[Way]
) -> None:
    """pystitch's writer of VP3 truncates half units, so that all lengths are even there."""
    if ending == "vp3":
        moves = [Way(act, 2 * x, 2 * y) for act, x, y in moves]
    pattern, places = pattern_of(moves)
    file = tmp_path_factory.getbasetemp() / f"design{ending if '.' in ending else '.' + ending}"
    pystitch.write(pattern, str(file), dict(WRITTEN[ending]))
    assert once(read_back(file)) == once([(float(x), float(y)) for x, y in places])


def test_a_thread_of_vp3_may_begin_on_an_axis(tmp_path: Path) -> None:
    """A block that begins at X 0 is reached by travel, like any other."""
    pattern, places = pattern_of(
        [Way("stitch", 40, 20), Way("stitch", 20, 0), Way("colour", -60, 30), Way("stitch", 8, 8)]
    )
    file = tmp_path / "a.vp3"
    pystitch.write(pattern, str(file))
    assert once(read_back(file)) == once([(float(x), float(y)) for x, y in places])


# --- threads --------------------------------------------------------------------------------------


@pytest.mark.parametrize("ending", [".pes", ".pec", ".jef", ".xxx", ".vp3"])
def test_each_block_has_the_thread_that_the_file_says(ending: str, tmp_path: Path) -> None:
    """pystitch writes the file, with colours of its palette."""
    palette = (EmbThreadJef if ending == ".jef" else EmbThreadPec).get_thread_set()
    first, second = palette[5], palette[20]
    pattern = pystitch.EmbPattern()
    pattern.add_thread(first)
    pattern.add_thread(second)
    for act, x, y in ((pystitch.STITCH, 40, 20), (pystitch.STITCH, 60, 20)):
        pattern.add_stitch_absolute(act, x, y)
    pattern.add_command(pystitch.COLOR_CHANGE)
    for act, x, y in ((pystitch.STITCH, 10, 20), (pystitch.STITCH, 10, 60)):
        pattern.add_stitch_absolute(act, x, y)
    pattern.end()
    file = tmp_path / f"a{ending}"
    pystitch.write(pattern, str(file))
    threads = read_design(file, machine=FRAME).threads
    assert [one and one.rgb for one in threads] == [first.hex_color(), second.hex_color()]
    if ending != ".xxx":  # the format has no names
        assert [one and one.name for one in threads] == [first.description, second.description]


def test_a_hus_file_names_its_threads() -> None:
    """No writer of the format is available: a made file has indices after its header.

    An index outside the palette is no thread.
    """
    content = bytearray(fuzz_designs.hus_seed())
    struct.pack_into("<I", content, 8, 3)
    content[42:42] = struct.pack("<3H", 3, 12, 999)
    for at in (20, 24, 28):  # the columns are behind the indices
        struct.pack_into("<I", content, at, struct.unpack_from("<I", content, at)[0] + 6)
    found = hus_threads(bytes(content), Place("a.hus"))
    assert found == [Thread("#ff0000", "Red"), Thread("#ffffff", "White"), None]


def test_dst_has_threads_where_its_header_does(tmp_path: Path) -> None:
    pattern, _ = pattern_of([Way("stitch", 40, 20), Way("stitch", 20, 0)])
    pattern.threadlist[0].description = "Poppy"
    bare, full = tmp_path / "bare.dst", tmp_path / "full.dst"
    pystitch.write(pattern, str(bare))
    pystitch.write(pattern, str(full), {"extended header": True})
    assert read_design(bare, machine=FRAME).threads == (None,)
    assert read_design(full, machine=FRAME).threads == (Thread("#ff0000", "Poppy"),)


def test_a_thread_change_before_the_first_stitch_begins_no_block(tmp_path: Path) -> None:
    """The block has the new thread: here the second of red and lime green."""
    file = tmp_path / "a.pes"
    change = b"\xfe\xb0\x02"
    stitches = b"".join(number(units) for units in (0, 0, 30, 0))
    file.write_bytes(pes(change + stitches + b"\xff", colours=b"\x05\x0e"))
    assert read_design(file, machine=FRAME).threads == (Thread("#70bc1f", "Lime Green"),)


# --- PES, written from its description ------------------------------------------------------------


def number(units: int, flag: int = 0) -> bytes:
    if not flag and -64 <= units <= 63:
        return bytes([units & 0x7F])
    return struct.pack(">H", 0x8000 | flag << 8 | units & 0xFFF)


def pes(records: bytes, colours: bytes = b"\x05", version: bytes = b"0001") -> bytes:
    """Return a PES without a drawing, and with pictures after its stitches."""
    header = b"#PES" + version + struct.pack("<I", 22) + bytes(10)
    block = b"LA:" + b"a".ljust(16) + b"\r" + b" " * 12 + b"\xff\x00\x06\x26" + b" " * 12
    block += bytes([len(colours) - 1]) + colours
    block = block.ljust(512, b" ")
    stitches = b"\x31\xff\xf0" + struct.pack("<4H", 100, 70, 0x1E0, 0x1B0) + records
    block += b"\x00\x00" + (len(stitches) + 5).to_bytes(3, "little") + stitches
    return header + block + bytes(6 * 38 * 2)


@pytest.mark.parametrize("first", [(0, 0), (62, 40), (63, 40), (100, -3), (5, -64), (-65, 2047)])
@pytest.mark.parametrize("corner", [False, True])
@pytest.mark.parametrize("version", [b"0001", b"0022", b"0060", b"0100"])
def test_the_first_stitch_of_a_pes_is_not_lost(
    corner: bool, first: tuple[int, int], version: bytes
) -> None:
    """Writers begin with a jump from the corner, or with the first stitch, short or long."""
    moves = [first, (60, 40), (40, -40), (-160, 5)]
    places = [
        [sum(way[k] for way in moves[: end + 1]) for k in (0, 1)] for end in range(len(moves))
    ]
    records = b"".join(number(x) + number(y) for x, y in moves) + b"\xff"
    if corner:
        left, top = (min(place[k] for place in places) for k in (0, 1))
        records = number(-left, 0x10) + number(-top, 0x10) + records
    found = read_pes(pes(records, version=version), Place("a.pes"))
    assert found == [[*place, Act.STITCH] for place in places] + [[*places[-1], Act.END]]


def test_jumps_trims_and_colours_of_a_pes_keep_their_places() -> None:
    """A jump from elsewhere than the corner leads to the first stitch; a repeated colour stops."""
    records = (
        number(7, 0x10) + number(9, 0x10) + number(1) + number(2)
        + b"\xfe\xb0\x02" + number(-300, 0x20) + number(0, 0x20) + number(0) + number(0)
        + b"\xfe\xb0\x01" + number(3) + number(4) + b"\xff"
    )  # fmt: skip
    found = read_pes(pes(records, b"\x05\x05\x0e"), Place("a.pes"))
    assert found == [
        [7, 9, Act.JUMP], [8, 11, Act.STITCH], [8, 11, Act.STOP], [8, 11, Act.TRIM],
        [-292, 11, Act.JUMP], [-292, 11, Act.STITCH], [-292, 11, Act.COLOUR],
        [-289, 15, Act.STITCH], [-289, 15, Act.END],
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"#PES0001", "it is cut off at byte 8, in its header"),
        (b"not a design at all", "does not begin with #PES"),
        (pes(b"\x01\x01\xff")[:400], "cut off at byte 400: its stitches begin at byte 550"),
        (b"#PES0001" + struct.pack("<I", 23) + pes(b"\xff")[12:], "no PEC block begins at byte 23"),
        (pes(b"\x01\x01\xc1\x02\x03\xff"), "the byte 0xc1 at 552 begins no record"),
        (pes(b"\x01\x01")[:552], "its records are cut off at byte 552"),
        (pes(b"\x01\x01\x80")[:553], "its records are cut off at byte 553"),
        (pes(b"\x01\x01\xfe\xb0")[:554], "its records are cut off at byte 554"),
    ],
)
def test_malformed_pes_is_refused_with_the_byte(content: bytes, message: str) -> None:
    with pytest.raises(JobError, match=message):
        read_pes(content, Place("a.pes"))


# --- DST that says two things ---------------------------------------------------------------------


def test_a_dst_whose_records_reach_elsewhere_than_its_header_says_is_warned_of(
    tmp_path: Path, examples: Path
) -> None:
    """One bit in a record moves all stitches after it."""
    content = bytearray((examples / "rosette.dst").read_bytes())
    file = tmp_path / "a.dst"
    file.write_bytes(content)
    assert read_records(file).warnings == ()
    content[512 + 3 * 40] ^= 0x04  # 9 units of X
    file.write_bytes(content)
    (warning,) = read_records(file).warnings
    assert "reaches X -17.5 to 17.5" in warning and "may be damaged" in warning


def test_bytes_behind_the_end_of_a_dst_are_told(tmp_path: Path, examples: Path) -> None:
    content = (examples / "rosette.dst").read_bytes()
    file = tmp_path / "a.dst"
    file.write_bytes(content + b"\x1a" * 30)  # as tapes are filled up
    assert read_records(file).warnings == ()
    file.write_bytes(content + b"hello")
    assert "5 bytes behind the mark of its end" in read_records(file).warnings[0]
