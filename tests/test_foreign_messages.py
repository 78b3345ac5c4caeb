"""Mistakes in files are reported in plain words with line and remedy, not in pydantic's words."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from threadline.base.wording import field_fault
from threadline.errors import MachineError
from threadline.machine import load_machine
from threadline.machine.numbers import schema

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
    '[bodies."1 x"]\nkind = "linear"': (
        "m.toml:2: bodies.1 x: must be a name of letters, digits, _ and -",
        "Name it like x_belt.",
    ),
    '[controllers.x]\nkind = "pd"\nki = "1 dac/count exact, assumed"': (
        "m.toml:4: unknown key 'controllers.x.ki'",
        "Kind 'pi' or 'pid' has it: change kind, or remove the key.",
    ),
    '[controllers.x]\nkind = "pd"\nkindd = "pd"': ("m.toml:4: ", "Did you mean 'kind'?"),
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
    message = str(caught.value)
    assert all(words in message for words in WRONG[text]), message
    assert "Input" not in message
    assert "instance of" not in message


def test_every_pattern_of_the_schema_is_told_in_words() -> None:
    """A regular expression is no message for a user who winds filaments."""
    text = json.dumps(schema())
    found = {json.loads(f'"{part}"') for part in re.findall(r'"(\^[^"]*\$)"', text)}
    assert len(found) == 10
    for pattern in found:
        error = {"type": "string_pattern_mismatch", "ctx": {"pattern": pattern}, "input": "1 x"}
        must, remedy = field_fault(error)
        assert must.endswith(", got '1 x'")
        assert "^" not in must
        assert " like " in remedy


def test_a_circle_of_bases_names_a_line_and_a_remedy(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text('base = "b.toml"\n')
    (tmp_path / "b.toml").write_text('# the other\nbase = "a.toml"\n')
    with pytest.raises(MachineError, match=r"b\.toml:2: .*in a circle.*Remove one base"):
        load_machine(str(tmp_path / "a.toml"))
