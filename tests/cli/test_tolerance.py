"""An interpolation that exceeds the tolerance says by how much, on standard error."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import pytest

from tests.with_firmware import winder_with_grbl_file
from threadline.cli.main import main
from threadline.motion.path import interpolation_names
from threadline.motion.path.interpolations import KEEPING_TOLERANCE
from threadline.search import Grid, by_pace
from threadline.search.fastest import RANGE, Fastest, Interval
from threadline.search.paced import Effort, searching_with
from threadline.verdict import Verdict

pytestmark = pytest.mark.usefixtures("coarse_search")

# Long moves at an angle: a polynomial in time that passes the corner moving leaves the chords, and
# a B-spline cuts the corner by a third of the way to the middle of its neighbours.
CORNER = "G21 G90\nG1 X60 Y10 F1500\nX90 Y60\nX180 Y70\nM30\n"
SEAM = """
[stitching]
stitch_length = "0.1 in"
needle_speed = "20 stitch/s"
motion = "interpolated"

[[contour]]
unit = "in"
points = [[0, 0], [1, 0], [1, 0.8]]
"""
SAYS = re.compile(
    r"warning: ([\w-]+) does not keep the tolerance of 0\.1 mm: the planned path is "
    r"([\d.]+) mm off the programmed one at line \d+; auto, optimal and parabolic keep it"
)


def run(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> tuple[int, str, str]:
    """Run the program in this process; returns exit status, output and errors."""
    with pytest.raises(SystemExit) as stopped:
        main([str(a) for a in arguments])
    captured = capsys.readouterr()
    return int(stopped.value.code or 0), captured.out, captured.err


@pytest.mark.parametrize("interpolation", sorted(interpolation_names()))
def test_prove_warns_of_a_path_outside_the_tolerance(
    interpolation: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    job = tmp_path / "corner.prg"
    job.write_text(CORNER)
    code, out, err = run(
        capsys, "prove", job, "-m", winder_with_grbl_file(tmp_path), "--interpolation",
        interpolation, "--json",
    )  # fmt: skip
    deviation = next(
        c["measured"] for c in json.loads(out)["criteria"] if c["name"] == "path_deviation"
    )
    match = SAYS.search(err)

    assert code in (0, 1)
    assert (match is not None) == (deviation > 1e-4 * (1 + 1e-6))
    if match:
        assert match[1] == interpolation
        assert float(match[2]) == pytest.approx(deviation * 1e3, rel=5e-3)  # three digits
    if interpolation in KEEPING_TOLERANCE:
        assert deviation <= 1e-4
    if interpolation in {"b-spline", "quintic"}:
        assert match is not None


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


@pytest.mark.long(shown_by="test_compile_and_compare_say_it_too")
def test_fastest_says_it_of_the_plan_that_it_found(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Once, for the plan of the printed feed: ``prove`` with this feed says the same."""
    job = tmp_path / "corner.prg"
    job.write_text(CORNER)
    anything = tmp_path / "anything.spec.toml"
    anything.write_text('name = "anything"\n[[criteria]]\nname = "contour_error"\nlimit = "1 m"\n')
    planning = ["-m", "lathe-winder", "--interpolation", "b-spline"]
    span = ["-s", str(anything), "--low", "1 mm/s", "--high", "5 mm/s", "--json"]
    with searching_with(Effort(shares=(1.0,), finest=Grid(points=2))):
        _, out, err = run(capsys, "fastest", job, *planning, *span)
        (matches,) = SAYS.findall(err)
        again = shlex.split(json.loads(out)["command"])[1:]
        assert SAYS.findall(run(capsys, *again)[2]) == [matches]
        assert not SAYS.search(run(capsys, "fastest", job, *planning[:2], *span)[2])


def test_fastest_of_a_seam_says_it_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """This holds for every needle speed; the search itself is not tested here."""
    seam, speed_hz = tmp_path / "corner.seam.toml", 12.0
    seam.write_text(SEAM)
    passed = Fastest(
        intervals=(Interval(low=speed_hz, high=speed_hz),),
        limited_by=RANGE,
        verdict=Verdict(results=(), simulated=True),
        tried=1,
    )
    monkeypatch.setattr(by_pace, "fastest_needle", lambda _: passed)
    for name, count in (("b-spline", 1), ("auto", 0)):
        arguments = ["-m", "stitcher", "--interpolation", name, "--json"]
        code, _, err = run(capsys, "fastest", seam, *arguments)
        assert (code, len(SAYS.findall(err))) == (0, count)
