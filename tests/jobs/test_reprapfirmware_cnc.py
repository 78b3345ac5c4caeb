"""RepRapFirmware as a CNC machine (M453): comments in parentheses, axis words alone, fast G0.

Source: RepRapFirmware 3.5, ``StringParser.cpp`` (a bracket begins a comment; a line that begins
with an axis letter repeats the command before it, if that is one of G0 to G3, and is an error
behind any other) and ``GCodes.cpp`` (G0 has the highest feed, which the axes limit).
"""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.jobs.in_dialects import millimetres, read
from tests.jobs.made_machines import made_machine
from threadline.cli.main import main
from threadline.errors import InputError
from threadline.jobs import FeedMode, Move, read_job
from threadline.jobs.gcode.dialects import DIALECTS
from threadline.machine import Machine
from threadline.machine.firmware.read import read_settings

CNC = "reprapfirmware-cnc"
POSTED = (
    "(Fusion's post for Duet; G1 X99)\nG90 G94\nG21 (millimetres\nM3 S12000 (on)\nG0 X10 Y5\n"
    "X20 (Y99)\nG1 Z-1 F300\ny7 x21\nG2 X23 I1 J0\nX25 I1 J0\nG0 Z5\nM5\nM2\n"
)


@pytest.fixture(scope="module")
def xyza(tmp_path_factory: pytest.TempPathFactory) -> Machine:
    return made_machine(tmp_path_factory.mktemp("xyza"), "XYZ", "A")


def test_a_cnc_program_is_read(tmp_path: Path, xyza: Machine) -> None:
    job = read(tmp_path, xyza, POSTED, CNC)
    ends = [tuple(round(v, 6) for v in p[:3]) for p in millimetres(job)]
    begins = [(10, 5, 0), (20, 5, 0), (20, 5, -1), (21, 7, -1)]
    assert ends[:4] == begins and (23, 7, -1) in ends and ends[-2:] == [(25, 7, -1), (25, 7, 5)]
    modes = [m.feed.mode for m in job if isinstance(m, Move) and m.feed is not None]
    assert [mode is FeedMode.RAPID for mode in modes[:4]] == [True, True, False, False]
    assert modes[-1] is FeedMode.RAPID


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("G1 X5 F600\nM400\nX9\n", "axis words without a G word"),
        ("G1 X5 F600\nG90\nX9\n", "axis words without a G word"),
        ("X9\n", "axis words before any G0 or G1|axis words without a G word"),
        ("G1 X5 F600\nF900\n", "answers to 'F900' with an error"),
        ("M451\nG1 X5 F600\n", "another kind of machine"),
        ("G1 X{1}\n", "expressions in braces"),
    ],
)
def test_program_that_reprapfirmware_refuses_is_refused(
    tmp_path: Path, xyza: Machine, text: str, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        millimetres(read(tmp_path, xyza, text, CNC))


def ran(words: list[str]) -> int:
    with pytest.raises(SystemExit) as ended:
        main(words)
    assert isinstance(ended.value.code, int)
    return ended.value.code


def test_m453_tells_the_dialect(tmp_path: Path, xyza: Machine) -> None:
    """In a program and in a ``config.g``; for a printer the message names the right dialect."""
    file = tmp_path / "a.gcode"
    file.write_text("M453\n(a)\nG0 X9\nX5\n")
    job = read_job(file, xyza)
    assert job.dialect == CNC and [p[0] for p in millimetres(job)] == [9, 5]
    with pytest.raises(InputError, match=f"use --dialect {CNC}"):
        read_job(file, xyza, dialect="reprapfirmware")
    config = tmp_path / "config.g"
    config.write_text(
        "M453\nM584 X0 Y1 Z2\nM350 X16 Y16 Z16 I1\nM92 X80 Y80 Z400\nM201 X500 Y500 Z100\n"
        "M203 X6000 Y6000 Z600\nM566 X300 Y300 Z20\nM208 X0:300 Y0:200 Z-80:0\n"
    )
    assert read_settings(config).dialect in DIALECTS
    assert ran(["new", "rrf", str(tmp_path / "m"), "--from", str(config), "--limits-only"]) == 0
    mill = tmp_path / "m" / "machine.toml"
    file.write_text("(drill)\nG0 X9\nX5\nG1 Z-3 F300\nG0 Z0\nM5\n")
    assert ran(["prove", str(file), "-m", str(mill), "--nominal"]) == 0
    out = tmp_path / "out.gcode"
    write = ["compile", str(file), "-m", str(mill), "--target", "reprapfirmware", "-o", str(out)]
    assert ran([*write, "--slower"]) == 0
    assert "Z-3" in out.read_text() and "M5" in out.read_text()
