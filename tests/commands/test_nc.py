"""The writer of part programs against the reader: read, write, read changes nothing."""

from __future__ import annotations

import math
from collections.abc import Iterable
from decimal import Decimal
from fractions import Fraction
from pathlib import Path

import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from threadline.commands import nc
from threadline.commands.nc import (
    MAX_BODY,
    MAX_KEPT,
    Loop,
    fold,
    part_program_lines,
    write_part_program,
)
from threadline.commands.nc_blocks import OutBlock
from threadline.commands.nc_numbers import shortest
from threadline.errors import PlanError
from threadline.files import Stream
from threadline.jobs import Feed, FeedMode, Job, Move, Operation, SetOutput, Source, read_job
from threadline.machine import load_machine

MACHINE = load_machine("lathe-winder")


def words_of(operation: Operation) -> tuple[object, ...]:
    """Return the content of an operation without its place."""
    if isinstance(operation, Move):
        return ("move", operation.target, operation.feed, dict(operation.tags))
    fields = [
        getattr(operation, n)
        for n in ("duration_s", "final", "name", "value")
        if hasattr(operation, n)
    ]
    return (type(operation).__name__, *fields)


def number(decimals: int = 3) -> st.SearchStrategy[str]:
    """Numbers as people and machines write them, some with all the digits of a double."""
    short = st.integers(-(10**6), 10**6).map(lambda k: f"{k / 10**decimals:.{decimals}f}")
    long = st.floats(-400, 400, allow_nan=False).map(lambda x: f"{x:.15f}")
    return st.one_of(short, short, short, long)


@st.composite
def blocks(draw: st.DrawFn) -> str:
    """A block that moves, waits or changes a mode, valid wherever a feed and a G1 went before."""
    kind = draw(st.sampled_from(["move"] * 8 + ["dwell", "mode", "home", "stop", "spindle", "tag"]))
    if kind == "dwell":
        return f"G4 P{draw(st.integers(1, 999)) / 1000}"
    if kind == "mode":
        return draw(st.sampled_from(["G90", "G91", "G20", "G21", "G0", "G1", "F 777.7", "F1200"]))
    if kind == "home":
        return f"G28 X{draw(number())}"
    if kind == "stop":
        return "M0"
    if kind == "spindle":
        return "M5"
    names = draw(st.lists(st.sampled_from("AXY"), min_size=1, unique=True))
    words = " ".join(f"{name} {draw(number())}" for name in names)
    feed = draw(st.sampled_from(["", "", "", " F500", " F 33.3"]))
    return words + feed + (" ; tension=12.5" if kind == "tag" else "")


@st.composite
def programs(draw: st.DrawFn) -> str:
    """A main program calls two subroutines, and one of these calls the other."""
    body = st.lists(blocks(), min_size=1, max_size=6)
    lines = ["%", "O 7", *draw(body), "M99", "O 8", *draw(body)]
    lines += [f"M98 P7 L{draw(st.integers(1, 2))}", *draw(body), "M99", "O 1", "G91 G1 F600 A1"]
    for _ in range(draw(st.integers(0, 3))):
        lines += draw(body)
        lines.append(f"M98 P{draw(st.sampled_from([7, 8]))} L{draw(st.integers(1, 3))}")
    return "\n".join([*lines, "M30", "%"]) + "\n"


@pytest.mark.parametrize("subroutines", [False, True])
@settings(
    max_examples=30, phases=[Phase.explicit, Phase.generate]
)  # shrinking a program takes minutes
@given(text=programs())
def test_read_write_read_is_the_identity(
    tmp_path_factory: pytest.TempPathFactory, text: str, subroutines: bool
) -> None:
    """Every target is the same double, every feed the same number: no tolerance."""
    folder = tmp_path_factory.mktemp("nc")
    (folder / "a.nc").write_text(text)
    first = read_job(folder / "a.nc", MACHINE)
    write_part_program(first, MACHINE, folder / "b.nc", subroutines=subroutines)
    second = read_job(folder / "b.nc", MACHINE)

    assert [words_of(op) for op in second] == [words_of(op) for op in first]


def test_subroutines_come_back_as_calls(tmp_path: Path, examples: Path) -> None:
    """The listing is written with one body of 26 moves, called three times, as it was read."""
    job = read_job(examples / "cone-dome-cylinder.prg", MACHINE)
    write_part_program(job, MACHINE, tmp_path / "b.prg", subroutines=True)
    lines = (tmp_path / "b.prg").read_text().splitlines()

    assert sum(" A " in line for line in lines) == 26
    assert any("M 98 P 2 L 3" in line for line in lines)
    again = read_job(tmp_path / "b.prg", MACHINE)
    assert [op.source.passes for op in again] == [op.source.passes for op in job]
    assert "A 10.13 X 15.79" in lines[lines.index("O 2;") + 1]


@pytest.mark.parametrize("mode", [FeedMode.BASE_AXES, FeedMode.PATH])
def test_other_meanings_of_f_come_back_too(tmp_path: Path, examples: Path, mode: FeedMode) -> None:
    """F as the speed of the base axes, or along the path, is the same number in the program."""
    options = {"feed_mode": mode, "base_axes": ("A", "X") if mode is FeedMode.BASE_AXES else ()}
    job = read_job(examples / "cone-dome-cylinder.prg", MACHINE, **options)
    write_part_program(job, MACHINE, tmp_path / "b.prg")
    again = read_job(tmp_path / "b.prg", MACHINE, **options)

    assert [words_of(op) for op in again] == [words_of(op) for op in job]
    assert next(iter(again)).feed == Feed(mode, 0.2, options["base_axes"])  # type: ignore[union-attr]


@given(radians=st.floats(-1e4, 1e4), metres=st.floats(-10, 10))
def test_any_position_is_written_to_the_last_digit(
    tmp_path_factory: pytest.TempPathFactory, radians: float, metres: float
) -> None:
    """Positions without an exact decimal are off by two units in the last place at most.

    Below 1e-12 m or rad the 17 decimals of the dialect are the limit, 1e-17 of its unit.
    """
    path = tmp_path_factory.mktemp("nc") / "a.nc"
    source = Source("made", 1)
    feed = Feed(FeedMode.FASTEST_AXIS, 0.01)
    operations = [Move((radians, metres, 0.0), feed, source)]
    job = Job(name="made", file="made", sha256="", axes=("A", "X", "Y"), start=(0.0,) * 3,
              operations=Stream.of(operations))  # fmt: skip
    if abs(metres) > 0.5:
        return
    write_part_program(job, MACHINE, path)
    move = next(iter(read_job(path, MACHINE)))

    assert isinstance(move, Move)
    for got, expected in zip(move.target, (radians, metres, 0.0), strict=True):
        assert abs(got - expected) <= 2 * math.ulp(expected) + 1e-17


def test_operation_without_a_word_in_part_programs_is_refused(tmp_path: Path) -> None:
    """An output has no word; no file is left, whole or in part."""
    job = Job(name="made", file="made", sha256="", axes=("A", "X", "Y"), start=(0.0,) * 3,
              operations=Stream.of([SetOutput("valve", 1.0, Source("made", 4))]))  # fmt: skip
    with pytest.raises(PlanError, match=r"made:4: .* has no word for the output 'valve'"):
        write_part_program(job, MACHINE, tmp_path / "b.nc")
    assert list(tmp_path.iterdir()) == []


def test_a_job_that_begins_elsewhere_is_refused(tmp_path: Path) -> None:
    """Part programs begin where all axes are 0: the first block would go somewhere else."""
    job = Job(name="made", file="made", sha256="", axes=("A", "X", "Y"), start=(0.0, 0.01, 0.0),
              operations=Stream.of([]))  # fmt: skip
    with pytest.raises(PlanError, match="does not begin at the start position"):
        write_part_program(job, MACHINE, tmp_path / "b.nc")
    assert list(tmp_path.iterdir()) == []


def test_blocks_are_as_in_the_printed_listing(examples: Path) -> None:
    """Blanks between letter and number and a semicolon at the end, as Figure 9-1 has them."""
    lines = list(part_program_lines(read_job(examples / "x-180.prg", MACHINE), MACHINE))

    assert lines[:4] == ["%", "O 1;", "N 5 G 90 G 21;", "N 10 G 94 G 1 X 25.716 F 2160;"]
    assert lines[-2:] == ["N 80 M 30;", "%"]


def test_a_subroutine_too_long_to_be_held_is_written_out_whole() -> None:
    """Both passes, block by block; with one block less it is held, and folded."""
    for length, folded in ((MAX_BODY + 1, False), (MAX_BODY, True)):
        blocks = [
            OutBlock(1, f"X{k % length}", passes=(k // length + 1,)) for k in range(2 * length)
        ]
        found = list(fold(blocks))
        assert isinstance(found[0], Loop) == folded
        written = [
            block.words
            for one in found
            for block in (one.body * one.passes if isinstance(one, Loop) else (one,))
        ]
        assert written == [block.words for block in blocks]


def written(blocks: Iterable[OutBlock], most_kept: int = MAX_KEPT) -> list[int]:
    """Return the number of passes of each loop, and 0 for each block outside of loops."""
    folded = fold(blocks, most_kept=most_kept)
    return [one.passes if isinstance(one, Loop) else 0 for one in folded]


def passes(count: int, *words: str, feed: int | None = None) -> list[OutBlock]:
    """Return the blocks of equal passes of a subroutine."""
    return [
        OutBlock(1, one, inverse_time=feed is not None, feed=feed, passes=(k,))
        for k in range(1, count + 1)
        for one in words
    ]


def test_bodies_that_are_held_together_are_not_too_long() -> None:
    """A body that does not fit beside those kept is written out; a body that still fits is kept."""
    first, second = passes(2, "X1", "X2", "X3"), passes(2, "X4", "X5", "X6")
    assert written([*first, *second, *passes(2, "X7", "X8")], most_kept=5) == [2, *[0] * 6, 2]


def test_passes_whose_times_differ_by_rounding_alone_are_one_loop() -> None:
    """Two units in the ninth digit, no more."""
    (one,) = passes(1, "X1", feed=10**18)
    for digits, expected in ((2, [2]), (3, [1, 1])):
        other = one._replace(feed=10**18 + digits * 10**10, passes=(2,))
        assert written([one, other]) == expected


def test_each_call_stays_a_call_with_its_own_count(tmp_path: Path) -> None:
    """The operator who looks for a call of the job finds it in the program; one pass has no L."""
    text = "%\nO7\nX1\nM99\nO1\nG91 G1 F600 A1\nM98 P7 L2\nM98 P7 L3\nA1\nM98 P7\nM30\n%\n"
    (tmp_path / "a.nc").write_text(text)
    job = read_job(tmp_path / "a.nc", MACHINE)
    lines = list(part_program_lines(job, MACHINE, subroutines=True))
    calls = [line.partition("M 98 ")[2] for line in lines if "M 98 " in line]
    assert calls == ["P 2 L 2;", "P 2 L 3;", "P 2;"]


def test_fanuc_has_as_many_subprograms_as_four_digits_leave(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The main program is number 1, so the last number belongs to the one before it."""
    (tmp_path / "a.nc").write_text("%\nO1\nG91 G1 F600 A1\nM30\n%\n")
    job = read_job(tmp_path / "a.nc", MACHINE)
    for count in (7998, 7999):
        calls = [
            one
            for k in range(count)
            for one in (*passes(1, f"X{k}"), OutBlock(1, "A1", inverse_time=False, feed=None))
        ]
        monkeypatch.setattr(nc, "blocks_of", lambda *_, calls=calls: iter(calls))
        lines = part_program_lines(job, MACHINE, style="fanuc", subroutines=True)
        if count == 7998:
            assert sum(line.startswith("O") for line in lines) == 1 + count
        else:
            with pytest.raises(PlanError, match="more than 7999 different subprograms"):
                list(lines)


@settings(max_examples=300, phases=(Phase.generate,))
@given(
    st.one_of(
        st.floats(-1e6, 1e6, allow_nan=False),
        st.integers(-(10**9), 10**9).map(lambda k: k / 1e5),
        st.integers(-(10**9), 10**9).map(lambda k: math.radians(k / 1e5)),
    ),
    st.sampled_from([Fraction(1), Fraction(1000), Fraction(60), None]),
)
def test_the_shortest_number_is_that_of_every_count_of_decimals(
    expected: float, factor: Fraction | None
) -> None:
    """Python's own decimals are the reference."""

    def read(value: int) -> float:
        return math.radians(value / 10**18) if factor is None else value / (10**18 * int(factor))

    found = shortest(expected, factor, read)
    approximate = math.degrees(expected) if factor is None else expected * float(factor)
    for decimals in range(17):
        value = int(Decimal(f"{approximate:.{decimals}f}") * 10**18)
        if read(value) == expected:
            assert found == value
            return
    assert abs(read(found) - expected) <= max(2e-17, 2 * math.ulp(expected))


def test_decimals_that_cannot_read_back_are_not_tried() -> None:
    read: list[int] = []

    def reader(value: int) -> float:
        read.append(value)
        return value / 10**18

    assert shortest(12.3456789012345, Fraction(1), reader) == 12345678901234500000
    assert len(read) <= 2
