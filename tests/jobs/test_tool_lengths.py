"""Tool lengths from the machine file, beside G53, between moves and in subroutines.

Source: LinuxCNC, G Codes: G43 adds the length of the tool to the zero of Z; G53 goes to a place of
the machine, without zero and length. ``rs274`` runs random programs with the same tool table.
"""

from __future__ import annotations

import random
import re
import shutil
from pathlib import Path

import pytest

from tests.jobs.controls_themselves import interpreted
from tests.jobs.in_dialects import millimetres, read
from tests.jobs.made_machines import made_machine
from threadline.errors import InputError, JobError
from threadline.jobs import Dwell, Move, ToolEvent
from threadline.machine import Machine

LENGTHS = {1: 7.0, 2: 52.3, 3: -1.25}
_MORE = """[programs.lengths]
H1 = "7 mm exact, assumed"
H2 = "52.3 mm exact, assumed"
H3 = "-1.25 mm exact, assumed"
"""
_OFFSETS = """[programs.offsets]
G54 = { X = "100 mm exact, assumed", Z = "-30 mm exact, assumed" }
G55 = { Y = "20 mm exact, assumed", Z = "-41.5 mm exact, assumed" }
"""
POSTED = (
    "G21 G90 G54\nG53 G0 Z0\nT1 M6\nG43 H1\nG0 X10 Y10\nZ15\nG1 Z-1 F300\nX20\nG53 G0 Z0\n"
    "T2 M6\nG0 X5 G43 H2 Z15\nG1 Z-2\nG49\nG53 G0 Z0\nM2\n"
)


@pytest.fixture(scope="module")
def with_lengths(tmp_path_factory: pytest.TempPathFactory) -> Machine:
    return made_machine(tmp_path_factory.mktemp("told"), "XYZ", "A", _MORE + _OFFSETS)


def heights_mm(folder: Path, machine: Machine, text: str) -> list[float]:
    return [point[2] for point in millimetres(read(folder, machine, text, "linuxcnc"))]


def test_posted_program_with_two_tools_has_the_right_heights(
    tmp_path: Path, with_lengths: Machine
) -> None:
    """G53 Z0 is 30 mm above the zero of G54 with any tool or none; the tools go 7, 52.3 up."""
    found = heights_mm(tmp_path, with_lengths, POSTED)
    assert found == pytest.approx([30.0, 30.0, 22.0, 6.0, 6.0, 30.0, 67.3, 50.3, 30.0])


def test_the_motion_rests_where_a_length_is_taken(tmp_path: Path, with_lengths: Machine) -> None:
    """LinuxCNC ends the motion there. The words have had their effect: none is written again."""
    operations = list(read(tmp_path, with_lengths, "G43 H1\nG0 Z1\nG49\nZ2\nM2\n", "linuxcnc"))
    assert [type(one) for one in operations[:4]] == [Dwell, Move, Dwell, Move]
    words = [act.words for one in operations if isinstance(one, Move) for act in one.acts]
    words += [one.words for one in operations if isinstance(one, ToolEvent)]
    assert not any(word.startswith("G4") for word in words)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("G43 H9\nG0 Z1\nG53 Z0\nM2\n", "a.nc:3: G53 goes to a place of the machine, and how far"),
        ("G53 G0 Z0\nG43 H9\nX1\nM2\n", "G43 H9 begins it between moves of Z"),
        ("G43 H9\nG0 Z1\nG43 H1\nZ2\nM2\n", "G43 H1 ends the tool length of line 1"),
        ("G43\nG0 Z1\n#1=0\nG53 Z#1\nM2\n", "a.nc:4: G53 goes to a place of the machine"),
    ],
)
def test_a_length_that_the_file_lacks_is_asked_for(
    tmp_path: Path, with_lengths: Machine, text: str, message: str
) -> None:
    """A control would leave the plan by the length of the tool."""
    with pytest.raises(JobError) as caught:
        list(read(tmp_path, with_lengths, text, "linuxcnc"))
    assert message in str(caught.value) and "[programs.lengths] H1 = " in str(caught.value)


def test_lengths_are_lengths(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"programs\.lengths\.H1"):
        made_machine(tmp_path, "XYZ", "", _MORE.replace("7 mm", "7 deg"))


def _variables() -> str:
    """Return the file of the control's parameters: the zeros of G54 and G55, in inches."""
    zeros_mm = {5221: 100.0, 5223: -30.0, 5242: 20.0, 5243: -41.5}
    systems = [first + k for first in range(5221, 5400, 20) for k in range(10)]
    numbers = (*range(5161, 5170), *range(5181, 5190), *range(5210, 5221), *systems)
    return "".join(f"{n} {1 if n == 5220 else zeros_mm.get(n, 0.0) / 25.4}\n" for n in numbers)


def _random_program(rng: random.Random) -> list[str]:
    def place() -> str:
        words = [f"{axis}{round(rng.uniform(-40, 40), 3)}" for axis in "XYZ" if rng.random() < 0.6]
        return " ".join(words) or "Z1"

    lines = ["G21 G90 G94", "G1 X1 Y1 Z1 F600"]
    for _ in range(40):
        lines.append(
            rng.choice(
                (
                    f"G43 H{rng.randint(1, 3)}",
                    f"G0 G43 H{rng.randint(1, 3)} {place()}",
                    "G49",
                    f"G49 G1 {place()}",
                    f"G53 G0 {place()}",
                    f"G53 G1 {place()}",
                    f"G{rng.randint(54, 55)}",
                    f"G55 G43 H2 G1 {place()}",
                    f"G92 {place()}",
                    rng.choice(("G92.1", "G92.2", "G92.2\nG92.3")),
                    f"G91 G1 {place()}\nG90",
                    f"G1 {place()}",
                    f"G0 Z[{rng.randint(1, 9)} + 1]",
                )
            )
        )
    return [*lines, "M2"]


@pytest.mark.linuxcnc
def test_linuxcnc_goes_to_the_same_places(tmp_path: Path, with_lengths: Machine) -> None:
    rs274 = shutil.which("rs274")
    if rs274 is None:
        pytest.skip("rs274 (Debian's linuxcnc-uspace) is not installed")
    rows = [f"T{tool} P{tool} Z{long / 25.4:.9f}\n" for tool, long in LENGTHS.items()]
    (tmp_path / "made.tbl").write_text("".join(rows))
    for seed in range(100):
        lines = _random_program(random.Random(seed))
        job = read(tmp_path, with_lengths, "\n".join(lines) + "\n", "linuxcnc")
        program = tmp_path / "a.ngc"
        program.write_text("\n".join(lines) + "\n")
        (tmp_path / "made.var").write_text(_variables())
        output = interpreted(rs274, program, more=("-t", "made.tbl", "-v", "made.var"))
        assert "PROGRAM_END" in output, (seed, output)
        theirs: list[list[float]] = []
        shifts = {"G5X": [0.0] * 3, "G92": [0.0] * 3, "TOOL": [0.0] * 3}
        for row in output.splitlines():
            call = re.search(r"(STRAIGHT_\w+|SET_(G5X|G92)_OFFSET|USE_(TOOL)_\w+)\((.*)\)", row)
            if call is None:
                continue
            values = [float(number) for number in re.findall(r"-?\d+\.\d+", call[4])][:3]
            if call[1].startswith("STRAIGHT"):
                theirs.append([v + sum(s) for v, *s in zip(values, *shifts.values(), strict=True)])
            else:
                shifts[call[2] or call[3]] = values
        ours = [[x + 100.0, y, z - 30.0] for x, y, z, *_ in millimetres(job)]
        assert len(ours) == len(theirs), seed
        for mine, its in zip(ours, theirs, strict=True):
            assert mine == pytest.approx(its, abs=5e-4), (seed, lines)
