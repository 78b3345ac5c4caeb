"""The tables of yield against speed in parts: merged to the same text as in one run, or refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from tools import yield_against_speed as tables


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[Any]:
    """Rows without machines, and a stand-in for the drawing of curves."""
    drawn: list[Any] = []
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(tables, "draw", lambda *words: drawn.append(words))
    monkeypatch.setattr(
        tables, "judged", lambda speed, *_: (speed, speed < 40, int(90 - speed), 100, 0.1, 0.9, "x")
    )
    return drawn


@pytest.mark.parametrize("which", ["winder", "stitcher"])
def test_merged_parts_are_one_run(
    which: str, quick: list[Any], capsys: pytest.CaptureFixture[str]
) -> None:
    tables.main([which])
    whole, drawn = capsys.readouterr().out, list(quick)
    assert whole.count("| in |") > 1 and drawn
    quick.clear()
    for k in 3, 1, 2:
        tables.main([which, "--part", f"{k}/3", "-o", f"{k}.part"])
    assert not quick  # a part has no picture
    capsys.readouterr()
    tables.main([which, "--merge", "2.part", "3.part", "1.part"])
    assert capsys.readouterr().out == whole and quick == drawn


def test_incomplete_parts_of_a_speed_table_are_named(capsys: pytest.CaptureFixture[str]) -> None:
    for k in 1, 2:
        tables.main(["stitcher", "--part", f"{k}/2", "-o", f"{k}.part"])
    Path("text.part").write_text("{}")
    other = json.loads(Path("2.part").read_text())
    other["identity"]["numpy"] = "1.0"
    Path("other.part").write_text(json.dumps(other))
    for files, says in (
        (["1.part"], "missing of 2: [2]"),
        (["1.part", "1.part", "2.part"], "part 1 is there twice"),
        (["1.part", "other.part"], "'other.part' was made with another numpy"),
        (["1.part", "text.part"], "'text.part' is no part"),
        (["1.part", "none.part"], "'none.part' is no part"),
    ):
        with pytest.raises(SystemExit) as ended:
            tables.main(["stitcher", "--merge", *files])
        assert ended.value.code == 2 and says in capsys.readouterr().err
    with pytest.raises(SystemExit):
        tables.main(["winder", "--merge", "1.part", "2.part"])
    assert "another which" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        tables.main(["stitcher", "--part", "1/60", "-o", "1.part"])
    errors = capsys.readouterr().err
    assert "12 speeds of a table are too few for 60 parts" in errors and "--variants" not in errors
