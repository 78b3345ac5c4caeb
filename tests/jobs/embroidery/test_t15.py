"""Saurer T15 cards, decoded by handwritten tables, and compared with the design in DST."""

from __future__ import annotations

import random
import struct
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import NO_SAMPLES, SHARED_SAMPLES
from threadline.errors import JobError
from threadline.jobs import Move, ToolEvent, read_job
from threadline.jobs.embroidery.t15 import t15_bytes
from threadline.machine import load_machine
from threadline.proof.options import Options
from threadline.proof.pipeline import open_job, plan_job, write

MACHINE = load_machine("schiffli-frame")
SAMPLES = SHARED_SAMPLES / "embroidery"


def card(records: bytes) -> bytes:
    body = bytes(384) + records + b"\xd0\0\0\0"
    body += bytes(-len(body) % 12)
    return struct.pack("<3I", 1 + len(body) // 12, 15, 0) + body


def places(job) -> list[tuple[int, int, int]]:
    return [
        (round(m.target[0] * 1e4), round(m.target[1] * 1e4), m.tags["stitch"])
        for m in job
        if isinstance(m, Move)
    ]


DOWN, UP = b"\xc8\0\0\0\xca\0\0\0", b"\xca\0\0\0\xc8\0\0\0"


def test_a_card_that_was_punched_by_hand(tmp_path: Path) -> None:
    """Digits in base 7, a negative one as its complement: 6 is -1, 5 is -2, 3 is -3."""
    records = (
        b"\xc0\x01\x00\x00"  # x + 1, needle up
        + DOWN
        + b"\xc0\x14\x00\x00"  # x + 3 + 2 x 7 = 17
        + b"\xc0\x26\x29\x06"  # x - 1 + 3 x 7 + 49 = 69; y (digits 5, 6, 0) - 2 - 7 = -9
        + UP
        + b"\xc6\0\0\0"
    )
    file = tmp_path / "a.t15"
    file.write_bytes(card(records))
    job = read_job(file, MACHINE)
    assert places(job) == [(1, 0, 0), (1, 0, 1), (18, 0, 2), (87, -9, 3)]
    assert [o.name for o in job if isinstance(o, ToolEvent)] == ["trim"]


def test_written_t15_reads_back_equal(tmp_path: Path) -> None:
    numbers = random.Random(4)
    units = np.array([[numbers.randint(-171, 171) for _ in "XY"] for _ in range(500)])
    units[0] = (400, -3)
    sewn = np.ones(500, dtype=int)
    sewn[[0, 100, 101, 300]] = 0
    file = tmp_path / "a.t15"
    file.write_bytes(t15_bytes(units, sewn, {100, 500}))
    big = load_machine("schiffli-frame")
    from dataclasses import replace

    longest = replace(big.tables.longest, si=0.0171)
    big = replace(big, tables=replace(big.tables, longest=longest))
    stitches = [p for p in places(read_job(file, big)) if p[2]]
    expected_values = np.cumsum(units, axis=0)
    expected = [tuple(expected_values[k]) for k in range(500) if sewn[k]]
    assert [p[:2] for p in stitches] == expected


def test_the_example_as_a_card_is_the_same_design(examples: Path, tmp_path: Path) -> None:
    plan = plan_job(open_job(examples / "rosette.dst", MACHINE, Options()), MACHINE, Options())
    (made,) = write(plan, "t15", tmp_path / "rosette.t15")
    back = read_job(made.path, MACHINE)
    assert places(back) == places(plan.job)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "0 bytes"),
        (bytes(600), "its header says 0, 0, 0"),
        (card(b"\xc0\x07\0\0"), "byte 0x07 at 0x18d is no displacement"),
        (card(b"\xc0\0\0\x40"), "byte 0x40 at 0x18f is no displacement"),
        (card(b"\xc1\0\0\0"), "function 0xc1 at 0x18c is not known"),
        (card(DOWN + DOWN), "function 0xca at 0x198 is out of turn"),
        (card(b"\xc8\x01\0\0"), "function 0xc8 at 0x18c moves"),
        (card(DOWN + UP)[:-4] + b"\0\0\0\1", "byte 0x01 at"),
        (
            struct.pack("<3I", 34, 15, 0) + bytes(384) + b"\xc0\0\0\0" * 3,
            "at 0x198 without the record of its end",
        ),
    ],
)
def test_unknown_t15_code_is_refused_with_offset_and_byte(
    content: bytes, message: str, tmp_path: Path
) -> None:
    file = tmp_path / "a.t15"
    file.write_bytes(content)
    with pytest.raises(JobError, match=message):
        read_job(file, MACHINE)


@pytest.mark.skipif(not SAMPLES.is_dir(), reason=NO_SAMPLES)
def test_star_is_the_same_design_as_in_dst() -> None:
    """Every place of the card is one of DST's, in order, except for divided stitches."""
    one = [p[:2] for p in places(read_job(SAMPLES / "Star.T15", MACHINE)) if p[2]]
    other = [p[:2] for p in places(read_job(SAMPLES / "Star.DST", MACHINE)) if p[2]]

    def without_repeats(found):
        return [p for k, p in enumerate(found) if k == 0 or p != found[k - 1]]

    one, other = without_repeats(one), without_repeats(other)
    assert (len(one), len(other)) == (2538, 2540)
    assert one[0] == other[0] and one[-1] == other[-1]
    from difflib import SequenceMatcher

    same = sum(b.size for b in SequenceMatcher(None, one, other, False).get_matching_blocks())
    assert same >= 2535
    low, high = np.min(one, axis=0), np.max(one, axis=0)
    assert (low.tolist(), high.tolist()) == ([-295, -312], [296, 311])
