"""Mistakes in files are told in words for people, with line and remedy, and not in pydantic's."""

from __future__ import annotations

from pathlib import Path

import pytest

from threadline.errors import MachineError
from threadline.machine import load_machine

BASE = 'base = "lathe-winder"\n'

WRONG = {
    "name = 1": ("m.toml:2: name: must be a text, got 1", "in quotes"),
    "sources = true": ("m.toml:2: sources: must be a list, got true", "in brackets"),
    "clocks = 3": ("m.toml:2: clocks: must be a table, got 3", "[table]"),
    "[bodies]\nx = 5": ("m.toml:3: bodies.x: must be a table, got 5", "[table]"),
    '[bodies.x]\nkind = "lineal"': (
        "m.toml:3: bodies.x.kind: must be 'linear' or 'rotary', got 'lineal'",
        "Did you mean 'linear'?",
    ),
    '[sensors.x]\nkind = "encodr"': ("kind must be one of 'encoder', ", "Did you mean 'encoder'?"),
    '[axes.X]\nendless = "no"': (
        "axes.X.endless: must be true or false, got 'no'",
        "true or false",
    ),
    '[axes.xx]\nkind = "linear"': ("must be one capital letter, got 'xx'", "Name it like A"),
    "[axes.X": ("m.toml:2: not valid TOML: ", "Correct that line."),
    'x = [1,\n2,\n"a': ("m.toml:4: not valid TOML: ", "may be truncated"),
}


@pytest.mark.parametrize("text", WRONG)
def test_the_line_the_value_and_the_remedy(text: str, tmp_path: Path) -> None:
    file = tmp_path / "m.toml"
    file.write_text(BASE + text)
    with pytest.raises(MachineError) as caught:
        load_machine(str(file))
    said = str(caught.value)
    assert all(words in said for words in WRONG[text]), said
    assert "Input" not in said
    assert "instance of" not in said


def test_a_circle_of_bases_names_a_line_and_a_remedy(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text('base = "b.toml"\n')
    (tmp_path / "b.toml").write_text('# the other\nbase = "a.toml"\n')
    with pytest.raises(MachineError, match=r"b\.toml:2: .*in a circle.*Take one base out"):
        load_machine(str(tmp_path / "a.toml"))
