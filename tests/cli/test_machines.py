"""The library, listed and printed."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import pytest

from threadline.cli.main import main
from threadline.machine import library_names, load_machine


def run(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> tuple[int, str, str]:
    """Run the program in this process; returns exit status, output and errors."""
    with pytest.raises(SystemExit) as stopped:
        main([str(a) for a in arguments])
    captured = capsys.readouterr()
    return int(stopped.value.code or 0), captured.out, captured.err


def test_the_list_has_every_machine(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = run(capsys, "machines", "--json")
    entries = {entry["name"]: entry for entry in json.loads(out)["machines"]}

    assert (code, err) == (0, "")
    assert set(entries) == set(library_names())
    winder = entries["lathe-winder"]
    assert winder["axes"] == {"A": "rotary", "X": "linear", "Y": "linear"}
    assert winder["controllers"] == ["pd every 5 ms"]
    assert "physical" in winder["overlays"]
    assert entries["letter-placer"]["axes"] == {"X": "cylinder", "Z": "cylinder"}
    assert entries["letter-placer"]["controllers"] == ["PLC, a scan every 10 ms"]
    # The rigid stitcher has no belts that its base's overlays could change.
    assert "slack-belt" in entries["stitcher"]["overlays"]
    assert "slack-belt" not in entries["stitcher-rigid"]["overlays"]
    for name, entry in entries.items():
        for overlay in entry["overlays"]:
            assert load_machine(f"{name}+{overlay}").name == f"{name}+{overlay}"


def test_the_list_for_people_says_the_same(capsys: pytest.CaptureFixture[str]) -> None:
    _, out, _ = run(capsys, "machines")
    for name in library_names():
        machine = load_machine(name)
        assert name in out
        assert machine.title in out
    assert "A rotary, X linear, Y linear" in out
    assert "overlays    physical, current" in out


def test_a_machine_is_printed_as_it_stands(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The output is a machine file; standard error names its place."""
    code, out, err = run(capsys, "machines", "--show", "lathe-winder")
    mine = tmp_path / "mine.toml"
    mine.write_text(out, encoding="utf-8")

    assert code == 0
    assert tomllib.loads(out)["name"] == "lathe-winder"
    assert load_machine(mine).sha256 == load_machine("lathe-winder").sha256
    assert Path(err.strip()).read_text(encoding="utf-8") == out

    content = json.loads(run(capsys, "machines", "--show", "lathe-winder", "--json")[1])
    assert content["text"] == out
    assert content["file"] == err.strip()


def test_an_unknown_machine_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = run(capsys, "machines", "--show", "lathe-winer")
    assert (code, out) == (2, "")
    assert "Did you mean 'lathe-winder'?" in err
