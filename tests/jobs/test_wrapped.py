"""Wrapped rotary axes: angles of one turn, whose sign is a direction, as in LinuxCNC."""

from __future__ import annotations

import random
import re
import shutil
from pathlib import Path

import pytest

import threadline as tl
from tests.jobs.controls_themselves import interpreted
from tests.jobs.in_dialects import millimetres, read
from tests.jobs.made_machines import made_machine
from threadline.errors import JobError, MachineError, PlanError
from threadline.machine import Machine
from threadline.machine.firmware.linuxcnc_ini import read_linuxcnc

_INI = """[EMC]
MACHINE = made
[TRAJ]
COORDINATES = X Y Z A
LINEAR_UNITS = mm
ANGULAR_UNITS = degree
[AXIS_A]
WRAPPED_ROTARY = 1
[RS274NGC]
PARAMETER_FILE = made.var
"""

_MORE = """wrapped = true
[programs.offsets]
G54 = { A = "5 deg exact, assumed" }
"""


@pytest.fixture(scope="module")
def wrapped(tmp_path_factory: pytest.TempPathFactory) -> Machine:
    return made_machine(tmp_path_factory.mktemp("xa"), "XYZ", "A", _MORE)


def _turns(folder: Path, machine: Machine, text: str) -> list[float]:
    job = read(folder, machine, f"F100\n{text}\nM2\n", "linuxcnc")
    return [point[-1] for point in millimetres(job)]


def test_a_wrapped_axis_turns_on_through_zero(tmp_path: Path, wrapped: Machine) -> None:
    """359 to 1 is 2 degrees on; -1 turns back; a rotary axis that is not wrapped turns back."""
    assert _turns(tmp_path, wrapped, "G1 A359\nA1\nA-359\nA-0\nA0") == pytest.approx(
        [359.0, 361.0, 359.0, 0.0, 0.0]
    )
    # Steps of G91 are as written; G92 A0 at a rest begins a new turn.
    turns = _turns(tmp_path, wrapped, "G1 A200\nG91 A400\nG90 G92 A0\nA30\nA20")
    assert turns == pytest.approx([200.0, 600.0, 630.0, 980.0])
    plain = made_machine(tmp_path, "XYZ", "A")
    assert _turns(tmp_path, plain, "G1 A359\nA1") == pytest.approx([359.0, 1.0])


def _random_program(rng: random.Random) -> list[str]:
    lines = ["G21 G90 G94", "G1 A1 F600"]
    for _ in range(40):
        kind = rng.random()
        angle = round(rng.uniform(-359.9, 359.9), 3)
        if kind < 0.1:
            lines.append(f"G92 A{angle}")
        elif kind < 0.2:
            lines.append(rng.choice(["G92.1", "G92.2", "G92.2\nG92.3"]))
        elif kind < 0.35:
            lines.append(f"G91 G1 A{round(rng.uniform(-900, 900), 3)}\nG90")
        elif kind < 0.45:
            lines.append(f"G1 A[{angle}]")
        elif kind < 0.5:
            lines.append(rng.choice(["G1 A0", "G1 A-0", "G1 X1"]))
        else:
            lines.append(f"G{rng.randint(0, 1)} X{rng.randint(0, 9)} A{angle}")
    return [*lines, "M2"]


@pytest.mark.linuxcnc
def test_linuxcnc_turns_a_wrapped_axis_likewise(tmp_path: Path, wrapped: Machine) -> None:
    rs274 = shutil.which("rs274")
    if rs274 is None:
        pytest.skip("rs274 (Debian's linuxcnc-uspace) is not installed")
    settings = tmp_path / "made.ini"
    settings.write_text(_INI)
    for seed in range(60):
        lines = _random_program(random.Random(seed))
        job = read(tmp_path, wrapped, "\n".join(lines) + "\n", "linuxcnc")
        program = tmp_path / "a.ngc"
        program.write_text("\n".join(lines) + "\n")
        output = interpreted(rs274, program, settings=settings)
        assert "PROGRAM_END" in output, (seed, output)
        theirs, shift = [], 0.0
        for row in output.splitlines():
            match = re.search(r"(STRAIGHT_\w+|SET_G92_OFFSET)\((.*)\)", row)
            if match is not None and match[1] == "SET_G92_OFFSET":
                shift = float(match[2].split(",")[3])
            elif match is not None:
                theirs.append(float(match[2].split(",")[3]) + shift)
        assert [point[-1] for point in millimetres(job)] == pytest.approx(theirs, abs=2e-3), seed


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("G1 A360", "angles of a wrapped axis between -360 and 360"),
        ("G53 G1 A5", "G53 with the wrapped axis A"),
        ("G1 X1\nG28", "G28 moves the wrapped axis A"),
        ("G1 A1\nG28 A0", "G28 moves the wrapped axis A"),
    ],
)
def test_impossible_moves_of_a_wrapped_axis_are_refused(
    tmp_path: Path, wrapped: Machine, text: str, message: str
) -> None:
    with pytest.raises(JobError, match=message):
        _turns(tmp_path, wrapped, text)


def test_linuxcnc_alone_wraps(tmp_path: Path, wrapped: Machine) -> None:
    with pytest.raises(MachineError, match=r"axes.A.wrapped: LinuxCNC alone .* read as grbl"):
        read(tmp_path, wrapped, "G21 G90 G94\nG1 A5 F100\nM2\n", "grbl")
    with pytest.raises(MachineError, match="wrapped is for a rotary axis"):
        made_machine(tmp_path, "AX", "", "wrapped = true\n")
    file = tmp_path / "on.nc"
    file.write_text("G1 A359 F600\nA1\nM2\n")
    with pytest.raises(
        PlanError, match=r"axes\.A is wrapped: its control reads angles within one turn"
    ):
        tl.compile(file, wrapped, target="linuxcnc", out=tmp_path / "on.ngc", dialect="linuxcnc")


def test_the_settings_of_linuxcnc_say_so(tmp_path: Path) -> None:
    lines = [*_INI.splitlines(), "[AXIS_X]", "MAX_VELOCITY = 10", "[JOINT_3]", "TYPE = ANGULAR"]
    settings = read_linuxcnc(lines, "made.ini")
    assert settings.axes["A"].wrapped and not settings.axes["X"].wrapped
    off = read_linuxcnc([one.replace("ROTARY = 1", "ROTARY = 0") for one in lines], "made.ini")
    assert not off.axes["A"].wrapped
