"""A winding written as subroutine and passes, and read back."""

from __future__ import annotations

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


@pytest.mark.parametrize("dialect", ["winder", "linuxcnc"])
def test_one_circuit_and_its_passes_are_the_whole_motion(tmp_path: Path, dialect: str) -> None:
    """Each layer is one body; the first circuit of all has a body of its own: it starts slowly."""
    product, program = tmp_path / "tube.wind.toml", tmp_path / "tube.prg"
    product.write_text(TUBE)
    words = ("-m", "lathe-winder", "--dialect", dialect, "-o", program)
    assert run("wind", product, *words) == 0

    machine = load_machine("lathe-winder")
    job = read_job(product, machine)
    again = read_part_program(program, machine=machine, dialect=dialect)
    wanted, found = _said(job), _said(again)
    assert found[1] == wanted[1]
    radius = np.array([0.1, 1.0, 1.0])  # m, of the mandrel and the eye beside it
    off = (np.array(found[0]) - np.array(wanted[0])) * radius
    assert np.abs(off).max() < 1e-5
    # Whole turns by G91 add up: what the passes of a layer add is that of the design.
    text = program.read_text().replace(" ", "").splitlines()
    calls = [line.partition("M98")[2] for line in text if "M98" in line]
    passes = [int(call.partition("L")[2].rstrip(";") or 1) for call in calls]
    per_layer = sorted(passes)[-2:]
    moves = sum(isinstance(operation, Move) for operation in job)
    assert sum(passes) == len({o.source.passes for o in job if isinstance(o, Move)} - {()})
    assert per_layer == [29, 34]
    blocks = sum("A" in line and "X" in line for line in text)
    assert blocks < 0.25 * moves


def test_both_programs_of_one_winding_move_alike(tmp_path: Path, examples: Path) -> None:
    """The times of the moves too, and the size: at most a twentieth of all moves written out."""
    product, program = examples / "vessel.wind.toml", tmp_path / "vessel.prg"
    assert run("wind", product, "-m", "lathe-winder", "-o", program) == 0
    machine = load_machine("lathe-winder")
    moves = [o for o in read_job(product, machine) if isinstance(o, Move)]
    again = [o for o in read_job(program, machine) if isinstance(o, Move)]
    assert [o.feed for o in again] == [o.feed for o in moves]
    assert [o.target for o in again] == [o.target for o in moves]
    assert program.stat().st_size < 20 * len(moves) / 4


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("-o", "a.prg"), "--out and --machine belong together"),
        (("-m", "lathe-winder"), "--out and --machine belong together"),
        (("--dialect", "winder"), "--out and --machine belong together"),
        (("-m", "lathe-winder", "-o", "a.prg", "--bare", "b.csv"), "without --bare"),
        (("-m", "lathe-winder", "-o", "a.prg", "--dialect", "marlin"), "not for 'marlin'"),
        (("-m", "stitcher", "-o", "a.prg"), "a winding needs the eye of a winder"),
    ],
)
def test_what_cannot_be_written_is_refused(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    words: tuple[str, ...],
    said: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("tube.wind.toml").write_text(TUBE)
    assert run("wind", "tube.wind.toml", *words) == 2
    assert said in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["tube.wind.toml"]
