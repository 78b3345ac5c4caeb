"""LinuxCNC's own interpreter as the reference for writer and reader.

``rs274 -g`` prints the canonical moves that a program would send to the machine, with four
decimals; ends are compared to half of the last one. In CI its absence is a failure.
"""

from __future__ import annotations

import math
import random
import re
import shutil
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.jobs.controls_themselves import interpreted
from threadline.commands.nc import NcStyle, write_part_program
from threadline.jobs import Dwell, FeedMode, Move, Stop, read_job
from threadline.machine import load_machine
from threadline.motion.path import programmed_path

pytestmark = pytest.mark.linuxcnc

MACHINE = load_machine("lathe-winder")
LETTERS = "XYZABC"
PRINTED = 0.5001e-4  # mm, degrees, s: half of the last printed decimal
STEP = 3e-3  # mm: a change of units moves an end by the rounding of four decimals of an inch
_CALL = re.compile(r"\b([A-Z_]+)\(([^()]*)\)")


@dataclass(frozen=True)
class Canonical:
    """A canonical call: end in mm and degrees by letter, and the feed rate in force."""

    name: str
    end: dict[str, float]
    rate: float
    value: float = 0.0


@pytest.fixture(scope="module")
def rs274() -> str:
    found = shutil.which("rs274")
    if found is None:
        pytest.skip("rs274 (Debian's linuxcnc-uspace) is not installed")
    return found


def interpret(rs274: str, program: Path) -> list[Canonical]:
    """Run LinuxCNC's interpreter; return moves, dwells and stops in millimetres."""
    output = interpreted(rs274, program)
    assert "PROGRAM_END()" in output, output
    calls: list[Canonical] = []
    unit, rate = 1.0, 0.0
    for name, arguments in _CALL.findall(output):
        if name == "USE_LENGTH_UNITS":
            unit = 25.4 if "INCHES" in arguments else 1.0
        elif name == "SET_FEED_RATE":
            rate = float(arguments)
        elif name in {"STRAIGHT_FEED", "STRAIGHT_TRAVERSE"}:
            numbers = [float(text) for text in arguments.split(",")]
            scale = [unit] * 3 + [1.0] * 3
            end = {k: v * s for k, v, s in zip(LETTERS, numbers, scale, strict=True)}
            calls.append(Canonical(name, end, rate * unit))
        elif name == "DWELL":
            calls.append(Canonical(name, {}, 0.0, float(arguments)))
        elif name == "PROGRAM_STOP":
            calls.append(Canonical(name, {}, 0.0))
    return calls


def moves_of(calls: list[Canonical]) -> list[Canonical]:
    """The calls that move: LinuxCNC repeats the end for a G1 without axis words."""
    kept: list[Canonical] = []
    last = dict.fromkeys(LETTERS, 0.0)
    for call in calls:
        if call.end and any(abs(call.end[k] - last[k]) > STEP for k in LETTERS):
            kept.append(call)
            last = call.end
    return kept


def assert_same_end(call: Canonical, operation: Move, unit: float = 1.0) -> None:
    for name, target in zip(MACHINE.axis_names, operation.target, strict=True):
        rotary = MACHINE.axes[name].kind == "rotary"
        expected = math.degrees(target) if rotary else 1e3 * target
        tolerance = PRINTED if rotary else PRINTED * unit
        assert call.end[name] == pytest.approx(expected, abs=tolerance, rel=0), operation.source
    assert call.end["Z"] == call.end["B"] == call.end["C"] == 0.0


@pytest.mark.parametrize("subroutines", [False, True])
@pytest.mark.parametrize("name", ["cone-dome-cylinder.prg", "x-180.prg"])
def test_linuxcnc_ends_every_move_where_we_do(
    rs274: str, tmp_path: Path, examples: Path, name: str, subroutines: bool
) -> None:
    """Each straight feed has the same end and the same time as here.

    LinuxCNC turns G93 into a rate along X Y Z (A alone: along A); length over rate is the time, to
    the 4 decimals with which the rate is printed.
    """
    job = read_job(examples / name, MACHINE)
    write_part_program(
        job, MACHINE, tmp_path / "a.ngc", style=NcStyle.LINUXCNC, subroutines=subroutines
    )
    calls = interpret(rs274, tmp_path / "a.ngc")
    theirs = [call for call in calls if call.end]
    ours = [operation for operation in job if isinstance(operation, Move)]
    times_s = [t for block in programmed_path(job, MACHINE) for t in block.nominal_s.tolist()][1:]

    assert len(theirs) == len(ours) == len(times_s)
    assert {call.name for call in theirs} == {"STRAIGHT_FEED"}
    at = dict.fromkeys(LETTERS, 0.0)
    for call, operation, time_s in zip(theirs, ours, times_s, strict=True):
        assert_same_end(call, operation)
        step = [call.end[k] - at[k] for k in LETTERS]
        length = math.hypot(*step[:3]) or math.hypot(*step[3:])
        # Ends and rates are printed to 1e-4; the shortest move of the listing is 3.8 mm.
        assert 60.0 * length / call.rate == pytest.approx(time_s, rel=1e-4)
        at = call.end
    stops = [op for op in job if isinstance(op, Stop) and not op.final]
    assert sum(call.name == "PROGRAM_STOP" for call in calls) == len(stops)


def random_program(rng: random.Random) -> str:
    """A program in the words of both dialects, calls of nested subroutines included."""

    def body(count: int) -> list[str]:
        lines = []
        for _ in range(count):
            kind = rng.random()
            if kind < 0.1:
                lines.append(rng.choice(["G90", "G91", "G20", "G21", "G90 G21", "G91 (inc) G20"]))
            elif kind < 0.15:
                lines.append(f"G4 P{rng.randint(1, 50) / 100}")
            elif kind < 0.2:
                # Absolute only: LinuxCNC reads the words of an incremental G28 in its own way.
                lines.append("G90 G28" + rng.choice(["", " X3", " A12.5 Y-1"]))
            else:
                names = rng.sample("AXY", rng.randint(1, 3))
                words = " ".join(f"{n}{rng.uniform(-90, 90):.3f}" for n in names)
                mode = rng.choice(["", "", "G0 ", "G1 ", "g1 "])
                lines.append(f"N{rng.randint(1, 99)} {mode}{words}" + rng.choice(["", " F321.5"]))
        return lines

    lines = ["%", "O1", "G21 G90 G94 G1 F600 A1", *body(6), "M98 P2 L3", *body(3), "M98 P3"]
    lines += [*body(4), "G94 G1 F100 A0 X0", "G93 G1 X5 F30", "M30"]
    lines += ["O2", *body(4), "M98 P3 L2", *body(3), "M99", "O3", *body(4), "M99", "%"]
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("seed", range(25))
def test_random_program_reads_alike_in_linuxcnc(rs274: str, tmp_path: Path, seed: int) -> None:
    """Moves, dwells and rapid moves of a random program are the same in both readers."""
    program = tmp_path / "a.ngc"
    program.write_text(random_program(random.Random(seed)))
    ours = list(read_job(program, MACHINE))
    calls = interpret(rs274, program)
    theirs = moves_of(calls)
    moves = moving([op for op in ours if isinstance(op, Move)])

    assert len(theirs) == len(moves), program.read_text()
    for call, operation in zip(theirs, moves, strict=True):
        # In inches the printed decimals are 25.4 times as coarse.
        assert_same_end(call, operation, unit=25.4)
        rapid = operation.feed is not None and operation.feed.mode is FeedMode.RAPID
        assert (call.name == "STRAIGHT_TRAVERSE") == rapid, operation.source
    dwells = [op.duration_s for op in ours if isinstance(op, Dwell)]
    assert [c.value for c in calls if c.name == "DWELL"] == pytest.approx(dwells, abs=PRINTED)


def moving(moves: list[Move]) -> list[Move]:
    """Return the moves with motion, like ``moves_of`` for the other side."""
    kept: list[Move] = []
    last: tuple[float, ...] = (0.0, 0.0, 0.0)
    for operation in moves:
        if operation.target != last:
            kept.append(operation)
        last = operation.target
    return kept
