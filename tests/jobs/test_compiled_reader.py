"""The compiled reader of part programs, compared with the plain one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from random import Random
from unittest.mock import patch

import numpy as np
import pytest

from tests.jobs.test_part_program import MACHINE, moves, read
from threadline.errors import InputError
from threadline.jobs import Move, read_job
from threadline.jobs.gcode import plain_blocks
from threadline.jobs.gcode.plain_blocks import PlainReader
from threadline.jobs.operations import MoveRun

# --- the compiled reader equals the interpreter -------------------------------------------------

WORDS = (
    ["X1", "X-.5", "Y 2.25", "A+3.", "A -0.001", "X 0.1234567", "X0.12345678", "X12345678901.5",
     "A99999999999", "F600", "F 1.5", "G0", "G01", "G1", "G90", "G91", "N5", "N 10", "(note)",
     "; end", ";", "; a=1", "G20", "G21", "G93", "G94", "X1 X2", "x7", "g1", "\t", "  ", "Z1", "F0",
     "G4 P1", "M0", "G28 Y1", "E5", "X", "5", "X1e5", "; X5", "(", ")", "\u00e9", "; \u00e9", "\r",
     "X900719925.5", "G1.0", "N1.5", "N-1", "G91G1", "X1Y2A3F40", "M98 P2", "%", "(a\tb)"]
)  # fmt: skip


PLAIN = (
    ["X1", "X-.5 Y.25", "A-0.001", "X 0.123 F600", "G0 X1", "G1 Y 2", "G90 X3", "G91", "G20", "G21",
     "G93", "G94", "Y1 F2", "X0.1 ; a=1", "G1 X7.1234 (c) A3 ; d", "G4 P.1", "G28 X1", "A720.5",
     "X2 ; a=-2.50, bb=+.125", "Y.5 ; bb=7 a=3.", "X1 (t=1) ; a_b-3=-0", "X-1 ;width = 5 a=2",
     "G90 ; a=4"]
)  # fmt: skip


def right(draw: Random) -> str:
    return draw.choice(PLAIN)


def words(draw: Random) -> str:
    return " ".join(draw.choices(WORDS, k=draw.randint(0, 5)))


def drawn(draw: Random, *kinds: Callable[[Random], str]) -> list[str]:
    """Return up to twelve lines, each of one of the kinds."""
    return [draw.choice(kinds)(draw) for _ in range(draw.randint(0, 12))]


def outcome(path: Path, kernel: bool) -> tuple[list[object], str]:
    """Return all operations up to the error, and the error; with the kernel or without it."""
    done: list[object] = []
    with patch.object(PlainReader, "worth_trying", lambda *_: kernel):
        try:
            job = read_job(path, MACHINE)
            done += [job.suspicions(own_feed=True)]
            for operation in job:
                done.append(operation)
        except InputError as error:
            return done, str(error)
    return done, ""


def test_the_kernel_does_what_the_interpreter_does(tmp_path: Path) -> None:
    """The same warnings and operations to the last bit, with the same places, or the same error."""
    path = tmp_path / "kernel.nc"
    for seed in range(600):
        draw = Random(seed)
        lines = drawn(draw, words)
        text = draw.choice(["\n", "\r\n"]).join(
            ["G1 F100 X0", *lines, "M30", "O2", "X1", "G1 Y1 F5", "M99"]
        )
        path.write_bytes(text.encode())
        assert outcome(path, kernel=True) == outcome(path, kernel=False), text


def test_the_kernel_follows_modes_as_the_interpreter_does(tmp_path: Path) -> None:
    """The same holds for programs that are right for most of their length."""
    path = tmp_path / "kernel.nc"
    for seed in range(300):
        lines = drawn(Random(seed), right, right, right, words)
        text = "\n".join(["G1 F100 X0", *lines, "M98 P2 L2", "M30", "O2", *lines, "M99"])
        path.write_bytes(text.encode())
        assert outcome(path, kernel=True) == outcome(path, kernel=False), text


NAMES = ["a", "A", "_b", "tension_N", "x-1", "n5", "stitch", "q" * 32, "q" * 33]
BLANKS = ["", "", "", " "]  # a blank before the sign makes it a comment for people
NUMBERS = [
    "-0", "+7", ".5", "-.25", "3.", "", ".", "-", "1e3", "1;2", "(4)", "x", "=5",
    "0.000000000000001", "123456789.123456", "\t6", "\xb5", "1.2.3",
]  # fmt: skip


GAPS = [" ", ", ", ",", "\t", "  ", ",,", "; ", " to "]
BEFORE = ["X1", "G1 Y.5 F60", "G90", "N7", "(c)", "", "G92 X1"]


def number(draw: Random) -> str:
    """Return thousandths, an integer of up to seventeen digits, or a wrong number."""
    kind = draw.randrange(3)
    if kind == 0:
        return f"{draw.randint(-999_000, 999_000) / 1000:.3f}"
    if kind == 1:
        return str(draw.randint(-(10 ** draw.randint(0, 16)), 10 ** draw.randint(0, 16)))
    return draw.choice(NUMBERS)


def tagged(draw: Random) -> str:
    """Return a block with a comment of up to five tags."""
    tags = (
        f"{draw.choice(NAMES)}{draw.choice(BLANKS)}={number(draw)}{draw.choice(GAPS)}"
        for _ in range(draw.randint(0, 5))
    )
    sign = draw.choice([";", " ; ", ";\t", "; ,", " ; note "])
    return "".join([draw.choice(BEFORE), sign, *tags])


@pytest.mark.long(shown_by="test_the_kernel_does_what_the_interpreter_does")
def test_the_kernel_names_the_numbers_that_the_interpreter_names(tmp_path: Path) -> None:
    """Every tag of every move is the same, signs of zero included, or the error is."""
    path = tmp_path / "tags.nc"
    for seed in range(1000):
        draw = Random(seed)
        lines = drawn(draw, tagged, tagged, right)
        text = draw.choice(["\n", "\r\n"]).join(
            ["G1 F100 X0", *lines, "M98 P2 L2", "M30", "O2", *lines, "M99"]
        )
        path.write_bytes(text.encode())

        ours, plainly = outcome(path, kernel=True), outcome(path, kernel=False)
        assert ours == plainly, text
        assert repr([dict(sorted(o.tags.items())) for o in ours[0] if isinstance(o, Move)]) == repr(
            [dict(sorted(o.tags.items())) for o in plainly[0] if isinstance(o, Move)]
        )


def test_tags_do_not_leave_the_kernel(tmp_path: Path) -> None:
    """Moves with tags arrive in runs, with an array for each tag; NaN for a move without it."""
    lines = [f"X{1 - 2 * (k % 2)} ; layer={k // 100} tension_N={k % 7 - 3}.5" for k in range(3000)]
    lines[2500] = "X1"
    job = read(tmp_path, "G91 G1 F100 Y1", *lines, "M30")

    runs = [item for item in job.runs() if isinstance(item, MoveRun)]

    assert len(runs) <= 3
    layer = np.concatenate([run.columns["layer"] for run in runs])
    tension = np.concatenate([run.columns["tension_N"] for run in runs])
    expected = np.arange(3000.0)
    written = np.array([float(f"{k % 7 - 3}.5") for k in range(3000)])
    expected[2500] = written[2500] = np.nan
    assert np.array_equal(layer, [np.nan, *expected // 100], equal_nan=True)
    assert np.array_equal(tension, [np.nan, *written], equal_nan=True)


def test_more_names_than_the_kernel_keeps(tmp_path: Path) -> None:
    """The seventeenth name and later ones are read block by block, and nothing is lost."""
    lines = [f"X1 ; name{k}={k} other{k}=1" for k in range(12)]
    found = moves(read(tmp_path, "G91 G1 F100", *lines, "X1 ; name3=8", "M30"))
    assert [dict(move.tags) for move in found] == [
        *[{f"name{k}": float(k), f"other{k}": 1.0} for k in range(12)],
        {"name3": 8.0},
    ]


@pytest.mark.parametrize(("lines", "compiled"), [(40, False), (60, True)])
def test_a_short_program_needs_no_compiled_reader(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, lines: int, compiled: bool
) -> None:
    """Compiling takes seconds: the first 50 lines are read without it, with the same result."""
    program = ["G91 G1 F100 Y1", *(f"X{k % 3} F{k + 1} ; layer={k}" for k in range(lines)), "M30"]
    expected = list(read(tmp_path, *program))
    used: list[int] = []
    follow = plain_blocks.follow_plain

    def noted(*of: object) -> int:
        used.append(1)
        return int(follow(*of))

    monkeypatch.setattr(plain_blocks, "FIRST_LINES", 50)
    monkeypatch.setattr(plain_blocks, "follow_plain", noted)
    assert list(read(tmp_path, *program)) == expected
    assert bool(used) is compiled
