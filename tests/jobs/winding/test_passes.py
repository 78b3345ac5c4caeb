"""A winding written as a subroutine and passes, and read back."""

from __future__ import annotations

import re
from itertools import groupby
from pathlib import Path

import numpy as np
import pytest

from threadline.cli.main import main
from threadline.jobs import Job, Move, read_job
from threadline.jobs.gcode import read_part_program
from threadline.jobs.operations import Dwell
from threadline.machine import load_machine

TUBE = """name = "tube"
[mandrel]
at = "-110 mm"
[[part]]
kind = "cylinder"
radius = "50 mm"
length = "470 mm"
[band]
width = "6.05 mm"
thickness = "0.25 mm"
[friction]
value = 0.2
[coverage]
begin = "110 mm"
end = "360 mm"
[[layer]]
angle = "55 deg"
circuits = 30
[[layer]]
angle = "50 deg"
circuits = 34
"""


def run(*words: object) -> int:
    """Return the exit status of the program."""
    with pytest.raises(SystemExit) as ended:
        main([str(word) for word in words])
    return int(ended.value.code or 0)


def _said(job: Job) -> tuple[list[tuple[float, ...]], list[object]]:
    """Return the targets of the moves in the order of A X Y, and the other operations."""
    order = [job.axes.index(name) for name in "AXY"]
    targets = [tuple(o.target[k] for k in order) for o in job if isinstance(o, Move)]
    return targets, [o.duration_s for o in job if isinstance(o, Dwell)]


@pytest.mark.long(shown_by="test_both_programs_of_one_winding_move_alike")
@pytest.mark.parametrize("dialect", ["winder", "linuxcnc", "fanuc"])
def test_one_circuit_and_its_passes_are_the_whole_motion(tmp_path: Path, dialect: str) -> None:
    """Each layer is one body; circuits that begin or end at a rest have bodies of their own."""
    product, program = tmp_path / "tube.wind.toml", tmp_path / "tube.prg"
    product.write_text(TUBE)
    words = ("-m", "lathe-winder", "--dialect", dialect, "-o", program)
    assert run("wind", product, *words) == 0

    machine = load_machine("lathe-winder")
    job = read_job(product, machine)
    again = read_part_program(program, machine=machine, dialect=dialect)
    expected, found = _said(job), _said(again)
    assert found[1] == expected[1]
    radius = np.array([0.1, 1.0, 1.0])  # m, at the mandrel and the eye beside it
    off = (np.array(found[0]) - np.array(expected[0])) * radius
    assert np.abs(off).max() < 1e-5
    # Whole turns by G91 add up: the passes of a layer turn as far as the design.
    text = program.read_text().replace(" ", "").splitlines()
    calls = [line.partition("M98P")[2].rstrip(";").partition("L") for line in text if "M98" in line]
    passes = [int(count or 1) for _, _, count in calls]
    if dialect == "fanuc":  # these controls write the number of passes in different ways
        assert not any(count for _, _, count in calls)
        passes = [len(list(group)) for _, group in groupby(label for label, _, _ in calls)]
        numbers = re.findall(r"[AXYF]([-\d.]+)", "".join(text))
        assert all("." in number and len(number.partition(".")[2]) <= 4 for number in numbers)
    per_layer = sorted(passes)[-2:]
    moves = sum(isinstance(operation, Move) for operation in job)
    assert sum(passes) == len({o.source.passes for o in job if isinstance(o, Move)} - {()})
    assert per_layer == [28, 33]
    blocks = sum("A" in line and "X" in line for line in text)
    assert blocks < 0.25 * moves


def test_both_programs_of_one_winding_move_alike(tmp_path: Path, examples: Path) -> None:
    """Targets and feeds agree, and the program has less than 5 bytes per move of the winding."""
    product, program = examples / "vessel.wind.toml", tmp_path / "vessel.prg"
    assert run("wind", product, "-m", "lathe-winder", "-o", program) == 0
    machine = load_machine("lathe-winder")
    moves = [o for o in read_job(product, machine) if isinstance(o, Move)]
    again = [o for o in read_job(program, machine) if isinstance(o, Move)]
    assert [o.feed for o in again] == [o.feed for o in moves]
    assert [o.target for o in again] == [o.target for o in moves]
    assert program.stat().st_size < 20 * len(moves) / 4


def test_the_layers_are_designed_once(
    tmp_path: Path, examples: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def again(_: object) -> None:
        raise AssertionError("designed again for the program")

    monkeypatch.setattr("threadline.jobs.winding.job.design", again)
    program = tmp_path / "vessel.prg"
    assert run("wind", examples / "vessel.wind.toml", "-m", "lathe-winder", "-o", program) == 0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("-o", "a.prg"), "--out and --machine belong together"),
        (("-m", "lathe-winder"), "--out and --machine belong together"),
        (("--dialect", "winder"), "--out and --machine belong together"),
        (("-m", "lathe-winder", "-o", "a.prg", "--bare", "b.csv"), "without --bare"),
        (
            ("-m", "lathe-winder", "-o", "a.prg", "--dialect", "marlin"),
            "Marlin has no subprograms within a program",
        ),
        (("-m", "stitcher", "-o", "a.prg"), "a winding needs the eye of a winder"),
    ],
)
def test_passes_that_cannot_be_written_are_refused(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    words: tuple[str, ...],
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("tube.wind.toml").write_text(TUBE)
    assert run("wind", "tube.wind.toml", *words) == 2
    assert message in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["tube.wind.toml"]


@pytest.mark.parametrize(
    ("target", "message"),
    [
        ("grbl", "grbl has no subprograms"),
        ("fluidnc", "FluidNC has no subprograms"),
        ("marlin", "Marlin has no subprograms within a program"),
        ("klipper", "Klipper has no subprograms within a program"),
        ("reprapfirmware", "RepRapFirmware has no subprograms within a program"),
        ("csv", "'csv' is no format of a part program"),
    ],
)
def test_a_firmware_without_subprograms_is_named(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    target: str,
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("tube.wind.toml").write_text(TUBE)
    words = ("-m", "lathe-winder", "--target", target, "--passes", "-o", "a.out")
    assert run("compile", "tube.wind.toml", *words) == 2
    error = capsys.readouterr().err
    assert message in error and "winder, linuxcnc and fanuc" in error
    assert [path.name for path in tmp_path.iterdir()] == ["tube.wind.toml"]


@pytest.mark.long(but="linuxcnc")
@pytest.mark.parametrize("target", ["nc", "linuxcnc", "fanuc"])
def test_compile_writes_passes_too(tmp_path: Path, target: str) -> None:
    """It writes the same bytes as ``wind -o``, but checks the limits of the plan first."""
    product = tmp_path / "short.wind.toml"
    short = TUBE.partition('[[layer]]\nangle = "50 deg"')[0]
    product.write_text(short.replace("circuits = 30", "circuits = 30\nshift = 7"))
    dialect = "linuxcnc" if target == "nc" else target
    one, other = tmp_path / "one.ngc", tmp_path / "other.ngc"
    assert run("wind", product, "-m", "lathe-winder", "--dialect", dialect, "-o", one) == 0
    words = ("-m", "lathe-winder", "--target", target, "--passes", "-o", other)
    assert run("compile", product, *words) == 0
    assert one.read_bytes() == other.read_bytes()
    assert b"M98" in one.read_bytes()


def test_a_program_that_passes_do_not_shorten_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    program, written = tmp_path / "a.prg", tmp_path / "a.nc"
    program.write_text("G91 G1 X2 A10 F600\nX-3 A-5\nM30\n")
    words = ("-m", "lathe-winder", "--target", "fanuc", "--passes", "-o", written)
    assert run("compile", program, *words) == 0
    assert b"M98" not in written.read_bytes()
    assert "passes save nothing" in capsys.readouterr().err
