"""An even needle with an uneven head gives a warning on standard error."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from threadline.cli.main import main

# Half a circle of a stitch and a half between straight lines: within a wide tolerance `auto` cuts
# it, and adds points where it begins.
TABLE = "x [mm],y [mm],bulge\n0,0,0\n40,0,1\n40,4,0\n0,4,0\n"


def prove(tmp_path: Path, capsys: pytest.CaptureFixture[str], more: str, *options: str):
    (tmp_path / "line.csv").write_text(TABLE)
    seam = tmp_path / "line.seam.toml"
    seam.write_text(
        '[drawing]\nfile = "line.csv"\n[stitching]\nstitch_length = "2.5 mm"\n'
        f'needle_speed = "40 stitch/s"\nmotion = "discrete"\n{more}'
    )
    with pytest.raises(SystemExit):
        main(["prove", str(seam), "-m", "stitcher", "--tolerance", "1 mm", "--json", *options])
    out, err = capsys.readouterr()
    found = {c["name"]: c["measured"] for c in json.loads(out)["criteria"]}
    return found["needle_time_error"], err


def test_an_uneven_needle_is_told(tmp_path, capsys):
    """The warning is there exactly if the measure exceeds the limit of a stitch's length."""
    error, message = prove(tmp_path, capsys, "")
    assert error > 0.05
    assert "the needle should turn evenly" in message
    assert f"{100 * error:.2g} % more than a turn, limit 5 %" in message
    assert "--feed-forward" in message


@pytest.mark.parametrize(
    ("more", "options"),
    [
        ("", ["--interpolation", "linear"]),
        ("", ["--feed-forward"]),
        ('needle = "slowed"', []),
    ],
)
def test_an_even_or_slowed_needle_is_not(more, options, tmp_path, capsys):
    error, message = prove(tmp_path, capsys, more, *options)
    assert "needle should turn evenly" not in message
    assert error < 0.05 or more
