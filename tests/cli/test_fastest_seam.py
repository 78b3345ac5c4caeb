"""``threadline fastest`` of a seam searches the needle speed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from threadline.cli.main import main

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
    """15 to 16 stitches a second are a quarter of what the drawing asks for: easy."""
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
