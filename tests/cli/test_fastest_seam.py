"""``threadline fastest`` of a seam searches the needle speed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from threadline.cli.main import main
from threadline.proof.option_words import parse_share
from threadline.search.fastest import Grid
from threadline.search.paced import Effort, searching_with

pytestmark = pytest.mark.usefixtures("coarse_search")

PLACE = Path(__file__).parents[2] / "examples" / "stitcher-place.spec.toml"

SEAM = """
[stitching]
stitch_length = "0.1 in"
needle_speed = "75 stitch/s"
motion = "discrete"

[[contour]]
unit = "mm"
points = [[0, 0], [20, 0]]
"""


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as stopped:
        main(["fastest", *arguments, "-m", "stitcher"])
    captured = capsys.readouterr()
    code = stopped.value.code
    return (0 if code is None else int(code)), captured.out, captured.err


def test_intervals_are_of_the_needle(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """15 to 16 stitches a second are a quarter of the drawing's speed, so they are easy."""
    file = tmp_path / "short.seam.toml"
    file.write_text(SEAM)
    span = ("--low", "15 stitch/s", "--high", "16 stitch/s")
    code, out, _ = run(capsys, str(file), *span, "-s", str(PLACE), "--json")
    content = json.loads(out)
    assert code == 0
    assert content["unit"] == "stitch/s"
    assert content["intervals"] == [[pytest.approx(15.0), pytest.approx(16.0)]]
    assert (content["best"], content["limited_by"]) == (pytest.approx(16.0), "range")
    code, _, err = run(capsys, str(file), "--low", "3 mm/s")
    assert code == 2
    assert "stitch/s" in err


def test_a_search_that_finds_nothing_says_at_which_level(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """The line below its verdict is the same as in ``prove``, for feeds and needle speeds."""
    seam, program = tmp_path / "short.seam.toml", tmp_path / "turn.prg"
    seam.write_text(SEAM)
    program.write_text("G91\nG1 X25.714 F2160\nG1 X-25.714\nM30\n")
    for words in (
        [str(seam), "-m", "stitcher", "-s", str(PLACE), "--low", "110 stitch/s"],
        [str(program), "-m", "lathe-winder", "--interpolation", "linear", "--low", "200 mm/s"],
    ):
        high = "111 stitch/s" if words[0] == str(seam) else "201 mm/s"
        with pytest.raises(SystemExit) as stopped:
            main(["fastest", *words, "--high", high, "--nominal"])
        assert stopped.value.code == 1
        last = capsys.readouterr().out.splitlines()[-1]
        assert last.startswith("OUT OF SPEC (nominal: 1 run; ")


def test_the_share_of_the_limits_can_be_typed_back(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """17.6777 % was printed as 17.7 %, a plan that was never tried."""
    program = tmp_path / "turn.prg"
    program.write_text("G91\nG1 X25.714 F2160\nG1 X-25.714\nM30\n")
    words = ["-m", "lathe-winder", "--low", "100 mm/s", "--high", "101 mm/s", "--nominal"]
    few = Effort(shares=(0.176777,), finest=Grid(points=8))
    with searching_with(few), pytest.raises(SystemExit):
        main(["fastest", str(program), *words])
    out = " ".join(capsys.readouterr().out.split())
    share = out.partition(" with ")[2].partition(" of the acceleration")[0]
    assert parse_share(share) == 0.176777
    assert " 0.176777 100 " in out
