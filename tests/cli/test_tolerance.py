"""An interpolation that does not keep the tolerance says by how much, on standard error."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from threadline.cli.main import main
from threadline.path import interpolation_names
from threadline.path.plan import KEEPING_TOLERANCE

# Long moves at an angle: a polynomial in time that passes the corner moving leaves the chords, and
# a B-spline cuts the corner by a third of the way to the middle of its neighbours.
CORNER = "G21 G90\nG1 X60 Y10 F1500\nX90 Y60\nX180 Y70\nM30\n"
SAYS = re.compile(
    r"warning: ([\w-]+) does not keep the tolerance of 0\.1 mm: the planned path is "
    r"([\d.]+) mm off the programmed one at line \d+; auto and parabolic keep it"
)


def run(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> tuple[int, str, str]:
    """Run the program in this process; returns exit status, output and errors."""
    with pytest.raises(SystemExit) as stopped:
        main([str(a) for a in arguments])
    captured = capsys.readouterr()
    return int(stopped.value.code or 0), captured.out, captured.err


@pytest.mark.parametrize("interpolation", sorted(interpolation_names()))
def test_what_leaves_the_tolerance_is_told(
    interpolation: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    job = tmp_path / "corner.prg"
    job.write_text(CORNER)
    code, out, err = run(
        capsys, "prove", job, "-m", "lathe-winder", "--interpolation", interpolation, "--json"
    )
    deviation = next(
        c["measured"] for c in json.loads(out)["criteria"] if c["name"] == "path_deviation"
    )
    told = SAYS.search(err)

    assert code in (0, 1)
    assert (told is not None) == (deviation > 1e-4 * (1 + 1e-6))
    if told:
        assert told[1] == interpolation
        assert float(told[2]) == pytest.approx(deviation * 1e3, rel=5e-3)  # three digits
    if interpolation in KEEPING_TOLERANCE:
        assert deviation <= 1e-4
    if interpolation in {"b-spline", "quintic"}:
        assert told is not None


def test_a_wider_tolerance_is_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    job = tmp_path / "corner.prg"
    job.write_text(CORNER)
    arguments = ["-m", "lathe-winder", "--interpolation", "b-spline", "--tolerance", "100 mm"]
    assert "tolerance" not in run(capsys, "prove", job, *arguments)[2]


def test_compile_and_compare_say_it_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    job, table = tmp_path / "corner.prg", tmp_path / "ticks.csv"
    job.write_text(CORNER)
    planning = ["-m", "lathe-winder", "--interpolation"]
    writing = ["--target", "csv", "-o", table]
    _, _, err = run(capsys, "compile", job, *planning, "b-spline", *writing)
    assert len(SAYS.findall(err)) == 1
    _, _, err = run(capsys, "compare", job, *planning, "linear,b-spline", "--no-fastest")
    assert [name for name, _ in SAYS.findall(err)] == ["b-spline"]
