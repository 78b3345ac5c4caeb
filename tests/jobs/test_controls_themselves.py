"""Random programs move as in the controls' own parsers, or are refused."""

from __future__ import annotations

import math
import re
import shutil
from collections.abc import Mapping
from pathlib import Path

import pytest

from tests.conftest import NO_FIRMWARE
from tests.jobs import controls_themselves as themselves
from tests.jobs.controls_themselves import Line, Point, Reading
from tests.jobs.fluidnc_itself import build_fluidnc, fluidnc_folder
from tests.jobs.made_machines import made_machine
from tests.jobs.random_blocks import random_blocks, random_commands
from tests.jobs.random_parametric import random_parametric
from threadline.errors import InputError
from threadline.jobs import Dwell, FeedMode, Move, read_job
from threadline.machine import Machine

LONG = 10_000
"""Programs in a long run; its figures stand in docs/part-programs.md."""


@pytest.fixture(scope="module")
def xyz(tmp_path_factory: pytest.TempPathFactory) -> Machine:
    return made_machine(tmp_path_factory.mktemp("xyz"), "XYZ", "")


def ours(folder: Path, machine: Machine, lines: list[str], dialect: str) -> Reading | None:
    """Return the reader's moves of a program, None if it refuses."""
    file = folder / "a.nc"
    file.write_text("\n".join(lines) + "\n")
    at: Point = (0.0, 0.0, 0.0)
    found: dict[int, Line] = {}
    dwells: list[float] = []
    try:
        for operation in read_job(file, machine, dialect=dialect):
            if isinstance(operation, Dwell):
                dwells.append(operation.duration_s)
            if not isinstance(operation, Move):
                continue
            x, y, z = (1e3 * value for value in operation.target)
            line = operation.source.line
            before = found[line].length_mm if line in found else 0.0
            assert operation.feed is not None
            feed = operation.feed
            found[line] = Line(
                before + math.dist(at, (x, y, z)),
                (x, y, z),
                0.0 if feed.mode is FeedMode.RAPID else 6e4 * feed.value,
            )
            at = (x, y, z)
    except InputError:
        return None
    return Reading(found, dwells, 0)


def moving(lines: Mapping[int, Line]) -> dict[int, Line]:
    return {number: line for number, line in lines.items() if line.length_mm > 1e-6}


def assert_same_moves(mine: Reading, theirs: Reading, feeds: bool) -> None:
    """Ends to 2 um, lengths of arcs to their chords."""
    one, other = moving(mine.lines), moving(theirs.lines)
    assert one.keys() == other.keys()
    for number, line in one.items():
        there = other[number]
        assert line.end_mm == pytest.approx(there.end_mm, abs=2e-3)
        assert line.length_mm == pytest.approx(there.length_mm, rel=2e-3, abs=0.02)
        if feeds:
            assert line.feed == pytest.approx(there.feed, rel=1e-3)


@pytest.mark.parametrize("kind", ["blocks", "loose words", "parameters"])
def test_fluidnc_itself_makes_the_same_moves(tmp_path: Path, xyz: Machine, kind: str) -> None:
    """Moves, feeds and dwells agree; a program with an error of FluidNC is refused."""
    source = fluidnc_folder()
    if source is None:
        pytest.skip(f"{NO_FIRMWARE}THREADLINE_FLUIDNC names the folder FluidNC/src of a checkout")
    if kind == "parameters":
        programs = [random_parametric(seed, fluidnc=True).splitlines() for seed in range(LONG)]
    else:
        loose = 0.08 if kind == "blocks" else 0.5
        programs = [random_blocks(seed, loose) for seed in range(LONG)]
    same = 0
    for lines, theirs in zip(
        programs, themselves.run(build_fluidnc(source, tmp_path), programs), strict=True
    ):
        mine = ours(tmp_path, xyz, lines, "fluidnc")
        if mine is None:
            continue
        assert not theirs.refused, lines
        assert_same_moves(mine, theirs, feeds=not any("G93" in line for line in lines))
        waits = [one for one in theirs.dwells_s if one]
        assert [one for one in mine.dwells_s if one] == pytest.approx(waits, abs=1e-3)
        same += 1
    print(f"{same} of {len(programs)} programs make the same moves; the others are refused")
    assert same > len(programs) // 5


@pytest.mark.parametrize("dialect", ["grbl", "fluidnc"])
def test_grbl_itself_makes_the_same_moves(tmp_path: Path, xyz: Machine, dialect: str) -> None:
    """FluidNC's parser came from grbl's: it also accepts P in arcs, which these programs lack.

    A program that grbl refuses is refused.
    """
    source = themselves.grbl_folder()
    if source is None:
        pytest.skip(f"{NO_FIRMWARE}THREADLINE_GRBL names the folder grbl of a checkout")
    count = LONG if dialect == "grbl" else LONG // 4
    programs = [random_blocks(seed, 0.08) for seed in range(count)]
    if dialect == "fluidnc":
        programs = [lines for lines in programs if " P2" not in "".join(lines)]
    same = 0
    for lines, theirs in zip(
        programs, themselves.run(themselves.build_grbl(source, tmp_path), programs), strict=True
    ):
        mine = ours(tmp_path, xyz, lines, dialect)
        if mine is None:
            continue
        assert not theirs.refused, lines
        assert_same_moves(mine, theirs, feeds=not any("G93" in line for line in lines))
        same += 1
    print(f"{same} of {len(programs)} programs make the same moves; the others are refused")
    assert same > len(programs) // 3


def test_marlin_itself_makes_the_same_moves(tmp_path: Path, xyz: Machine) -> None:
    """Moves, feeds and dwells agree; words that Marlin ignores, or runs otherwise, are refused."""
    source = themselves.marlin_folder()
    if source is None:
        pytest.skip(f"{NO_FIRMWARE}THREADLINE_MARLIN names the folder Marlin of a checkout")
    programs = [random_commands(seed, 0.1) for seed in range(LONG)]
    same = 0
    for lines, theirs in zip(
        programs, themselves.run(themselves.build_marlin(source, tmp_path), programs), strict=True
    ):
        mine = ours(tmp_path, xyz, lines, "marlin")
        if mine is None:
            continue
        assert_same_moves(mine, theirs, feeds=True)
        waits = [one for one in theirs.dwells_s if one]
        assert [one for one in mine.dwells_s if one] == pytest.approx(waits)
        same += 1
    print(f"{same} of {len(programs)} programs make the same moves; the others are refused")
    assert same > len(programs) // 3


def test_klipper_itself_makes_the_same_moves(tmp_path: Path, xyz: Machine) -> None:
    """Moves, feeds and dwells agree with ``gcode.py``; a program with its errors is refused."""
    source = themselves.klippy_folder()
    if source is None:
        pytest.skip(f"{NO_FIRMWARE}THREADLINE_KLIPPER names a checkout of Klipper")
    programs = [random_commands(seed, 0.1, klipper=True) for seed in range(LONG)]
    same = 0
    for lines, theirs in zip(
        programs, themselves.run(themselves.build_klipper(source, tmp_path), programs), strict=True
    ):
        mine = ours(tmp_path, xyz, lines, "klipper")
        if mine is None:
            continue
        moves = [
            line for line in lines if line.strip().upper().startswith(("G0", "G1", "G2", "G3"))
        ]
        assert not theirs.refused or lines[theirs.refused - 1] not in moves, lines
        assert_same_moves(mine, theirs, feeds=not any("G28" in line.upper() for line in lines))
        waits = [one for one in theirs.dwells_s if one]
        assert [one for one in mine.dwells_s if one] == pytest.approx(waits)
        same += 1
    print(f"{same} of {len(programs)} programs make the same moves; the others are refused")
    assert same > len(programs) // 6  # R of arcs, S of G4 and unknown commands are refused


def end_of_rs274(output: str) -> Point:
    """Return the ends of the canonical commands of LinuxCNC's interpreter, from the first zero."""
    plane, scale = "XY", 1.0
    last, shift = [0.0] * 3, [0.0] * 3
    for row in output.splitlines():
        command = re.search(r"([A-Z]\w+)\((.*)\)", row)
        if command is None:
            continue
        name, operands = command[1], command[2]
        if name == "USE_LENGTH_UNITS":
            scale = 25.4 if "INCHES" in operands else 1.0
        elif name == "SELECT_PLANE":
            plane = operands[-2:]
        elif name == "SET_G92_OFFSET":
            shift = [float(number) * scale for number in operands.split(",")[:3]]
        elif name in {"STRAIGHT_TRAVERSE", "STRAIGHT_FEED"}:
            last = [float(number) * scale for number in operands.split(",")[:3]]
        elif name == "ARC_FEED":
            v = [float(number) * scale for number in operands.split(",")]
            ends = {"XY": (0, 1, 5), "YZ": (5, 0, 1), "XZ": (1, 5, 0)}[plane]
            last = [v[k] for k in ends]
    x, y, z = (a + b for a, b in zip(last, shift, strict=True))
    return x, y, z


@pytest.mark.linuxcnc
def test_linuxcnc_itself_ends_there(tmp_path: Path, xyz: Machine) -> None:
    """A program that ``rs274`` refuses is refused."""
    rs274 = shutil.which("rs274")
    if rs274 is None:
        pytest.skip("rs274 (Debian's linuxcnc-uspace) is not installed")
    same = refused = 0
    for seed in range(150):
        lines = [*random_blocks(seed, 0.1), "M2"]
        mine = ours(tmp_path, xyz, lines, "linuxcnc")
        if mine is None:
            refused += 1
            continue
        output = themselves.interpreted(rs274, tmp_path / "a.nc")
        assert "PROGRAM_END" in output, (seed, output)
        end = mine.lines[max(mine.lines)].end_mm
        assert end == pytest.approx(end_of_rs274(output), abs=2e-3), seed
        same += 1
    assert same > 60 and refused > 20
