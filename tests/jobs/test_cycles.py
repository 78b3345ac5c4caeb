"""Drilling cycles: the moves of LinuxCNC's interpreter, and refused blocks."""

from __future__ import annotations

import math
import random
import re
import shutil
from pathlib import Path

import pytest

from tests.jobs.controls_themselves import interpreted
from tests.jobs.in_dialects import millimetres, read
from tests.jobs.made_machines import made_machine
from threadline.errors import JobError
from threadline.jobs import Dwell, Move
from threadline.machine import Machine

HEAD = "G21 G90 G17 F600\nG0 X0 Y0 Z10\n"


@pytest.fixture(scope="module")
def xyza(tmp_path_factory: pytest.TempPathFactory) -> Machine:
    return made_machine(tmp_path_factory.mktemp("xyza"), "XYZ", "A")


def places(job_text: str, folder: Path, machine: Machine) -> list[tuple[float, ...]]:
    """Return X, Y and Z in mm after every move of a program."""
    job = read(folder, machine, f"{HEAD}{job_text}\nM2\n", "linuxcnc")
    return [tuple(round(value, 6) for value in place[:3]) for place in millimetres(job)][1:]


def test_a_series_of_holes_retracts_to_the_height_where_it_began(
    tmp_path: Path, xyza: Machine
) -> None:
    """By the manual: over the place, down to R at the rapid, to Z at the feed, out."""
    text = "G98 G81 X10 Y20 Z-5 R2\nX20\nG80\nG0 Z20"
    assert places(text, tmp_path, xyza) == [
        (10, 20, 10), (10, 20, 2), (10, 20, -5), (10, 20, 10),
        (20, 20, 10), (20, 20, 2), (20, 20, -5), (20, 20, 10),
        (20, 20, 20),
    ]  # fmt: skip


def test_g99_retracts_to_r(tmp_path: Path, xyza: Machine) -> None:
    text = "G99 G82 X10 Z-5 R2 P0.5\nX20 Z-3"
    assert places(text, tmp_path, xyza) == [
        (10, 0, 10), (10, 0, 2), (10, 0, -5), (10, 0, 2), (20, 0, 2), (20, 0, -3), (20, 0, 2),
    ]  # fmt: skip
    job = read(tmp_path, xyza, f"{HEAD}{text}\nM2\n", "linuxcnc")
    assert [item.duration_s for item in job if isinstance(item, Dwell)] == [0.5, 0.5]


def test_only_the_way_down_is_at_the_feed(tmp_path: Path, xyza: Machine) -> None:
    job = read(tmp_path, xyza, f"{HEAD}G98 G83 X1 Z-5 R1 Q2.5\nM2\n", "linuxcnc")
    moves = [item for item in job if isinstance(item, Move)][1:]
    modes = [move.feed.mode.name == "RAPID" for move in moves if move.feed is not None]
    depths = [round(1e3 * move.target[2], 4) for move in moves]
    assert depths == [10, 1, -1.5, 1, -1.246, -4, 1, -3.746, -5, 10]
    assert modes == [True, True, False, True, True, False, True, True, False, True]


@pytest.mark.parametrize(
    ("block", "message"),
    [
        ("G81 X1 Z-5", "G81 has no R"),
        ("G81 X1 R2", "G81 has no Z"),
        ("G83 X1 Z-5 R2", "G83 has no Q"),
        ("G83 X1 Z-5 R2 Q0", "Q of G83 must be greater than 0"),
        ("G82 X1 Z-5 R2", "G82 has no P"),
        ("G82 X1 Z-5 R2 P-1", "P of G82 must not be negative"),
        ("G89 X1 Z-5 R2 P-0.5", "P of G89 must not be negative"),
        ("G81 X1 Z-5 R2 P1", "P has no use in G81"),
        ("G81 X1 Z-5 R2 Q1", "Q has no use in G81"),
        ("G81 X1 Z-5 R2 I1", "I has no use in G81"),
        ("G81 X1 Z5 R2", "R of G81 lies 3 mm deeper than Z"),
        ("G81 X1 A5 Z-5 R2", "A has no use in G81"),
        ("G93 G81 X1 Z-5 R2 F60", "G81 in G93, which linuxcnc refuses"),
        ("G81 X1 Z-5 R2\nG81", "G81 without the place of a hole"),
        ("G81 X1 Z-5 R2 L0", "L 0 drills no times"),
        ("G1 X1 L3", "L has no use in this block"),
        ("G91 G81 X1 Z-5 R-2 L1000000", "more than 100000 moves"),
        ("G83 X1 Z-5 R2 Q0.000001", "more than 100000 moves"),
        ("G81 X1 Z-5 R2\nG18 X2 Y-5", "G81 behind a change of plane or unit"),
        ("G84 X1 Z-5 R2", "G84 is a canned cycle that stops, turns or locks the spindle"),
    ],
)
def test_blocks_that_are_refused(tmp_path: Path, xyza: Machine, block: str, message: str) -> None:
    with pytest.raises(JobError, match=re.escape(message)) as caught:
        list(read(tmp_path, xyza, f"{HEAD}{block}\nG80\nM2\n", "linuxcnc"))
    assert caught.value.place is not None
    assert caught.value.place.line == 3 + block.count("\n")


def test_another_control_says_who_reads_cycles(tmp_path: Path, xyza: Machine) -> None:
    with pytest.raises(JobError, match=r"a canned cycle .* which is read for linuxcnc alone"):
        read(tmp_path, xyza, f"{HEAD}G81 X1 Z-5 R2\nM2\n", "grbl")


def _random_program(seed: int) -> str:
    rng = random.Random(seed)
    number = lambda low, high: f"{rng.uniform(low, high):.3f}"  # noqa: E731
    lines = [rng.choice(("G21", "G21", "G20")) + " G90 F300", f"G0 X1 Y2 Z{number(-3, 30)}"]
    for _ in range(rng.randint(2, 9)):
        cycle = rng.choice((73, 81, 82, 83, 85, 89, -1, -1, -1))
        words = [f"{axis}{number(-20, 20)}" for axis in rng.sample("XY", rng.randint(0, 2))]
        if cycle != -1:
            words += [f"G{cycle}", f"Z{number(-20, 2)}", f"R{number(-1, 12)}"]
            words += [f"Q{number(1, 9)}"] if cycle in (73, 83) else []
            words += [f"P{number(0, 1)}"] if cycle in (82, 89) else []
            words += rng.choice(([], [], [f"L{rng.randint(1, 3)}"]))
            rng.shuffle(words)
        elif not words:
            words = [
                rng.choice(("G80", "G0 Z7", "G0 X4 Z5", "G54", "G80 G17", "G80 G18", "G80 G19"))
            ]
        head = rng.choice(("", "", "G98 ", "G99 ", "G90 ", "G91 "))
        lines.append(head + " ".join(words))
    return "\n".join([*lines, "G80", "G90 G0 X0", "M2", ""])


@pytest.mark.parametrize("first", range(0, 60, 20))
def test_linuxcnc_itself_makes_the_same_moves(tmp_path: Path, xyza: Machine, first: int) -> None:
    """Random programs: the same ends of moves and dwells as ``rs274``, or refused here, too.

    ``rs274`` prints four decimals of a millimetre.
    """
    rs274 = shutil.which("rs274")
    if rs274 is None:
        pytest.skip("rs274 (Debian's linuxcnc-uspace) is not installed")
    drilled = refused = 0
    for seed in range(first, first + 20):
        text = _random_program(seed)
        program = tmp_path / "a.ngc"
        program.write_text(text)
        output = interpreted(rs274, program)
        if "PROGRAM_END" not in output:
            refused += 1
            with pytest.raises(JobError):
                list(read(tmp_path, xyza, text, "linuxcnc"))
            continue
        scale = 25.4 if "G20" in text else 1.0
        theirs = [
            ("DWELL" in line, [float(n) for n in re.findall(r"[-+]?[0-9]+\.[0-9]+", line)[:3]])
            for line in output.splitlines()
            if "STRAIGHT_" in line or "DWELL" in line
        ]
        try:
            job = read(tmp_path, xyza, text, "linuxcnc")
            ours = [
                (True, [item.duration_s])
                if isinstance(item, Dwell)
                else (False, [1e3 * value for value in item.target[:3]])
                for item in job
                if isinstance(item, Dwell | Move)
            ]
        except JobError as error:
            raise AssertionError(f"{seed}: {error}\n{text}") from None
        assert len(ours) == len(theirs), (seed, text)
        for (dwells, mine), (waits, other) in zip(ours, theirs, strict=True):
            assert dwells == waits, (seed, text)
            unit = 1.0 if dwells else scale
            assert all(
                math.isclose(a, b * unit, abs_tol=3e-3 * unit if unit > 1 else 6e-5)
                for a, b in zip(mine, other, strict=True)
            ), (seed, text, mine, other)
        drilled += len(ours)
    assert drilled > 100
    assert refused < 15
