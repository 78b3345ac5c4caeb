"""All missing keys of a machine file are reported at once, each with a possible value."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

from threadline.errors import MachineError
from threadline.machine import load_machine

BARE = """name = "mine"
title = "one axis"
sources = []

[bodies.x]
kind = "rotary"

[drives.x]
kind = "dc-motor"
acts_on = { x = "1 exact, assumed" }
amplifier = { mode = "current" }

[controllers.x]
clock = "servo"

[axes.X]
kind = "linear"
controller = "x"
endless = true
"""
LINES = {line: number for number, line in enumerate(BARE.splitlines(), 1)}


def refused(tmp_path: Path, text: str) -> str:
    file = tmp_path / "mine.toml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(MachineError) as caught:
        load_machine(file)
    return str(caught.value)


def test_all_that_is_missing_is_told_at_once_with_lines(tmp_path: Path) -> None:
    message = refused(tmp_path, BARE)

    matches = dict(re.findall(r"'([\w.]+)' \((?:line (\d+), )?like", message))
    assert matches == {
        "tick_budget": "",
        "clocks": "",
        "bodies.x.inertia": str(LINES["[bodies.x]"]),
        "drives.x.torque_constant": str(LINES["[drives.x]"]),
        "drives.x.back_emf": str(LINES["[drives.x]"]),
        "drives.x.resistance": str(LINES["[drives.x]"]),
        "drives.x.amplifier.gain": str(LINES['amplifier = { mode = "current" }']),
        "controllers.x.kind": str(LINES["[controllers.x]"]),
        "axes.X.counts": str(LINES["[axes.X]"]),
        "axes.X.velocity": str(LINES["[axes.X]"]),
        "axes.X.acceleration": str(LINES["[axes.X]"]),
    }
    assert f"mine.toml: {len(matches)} keys are missing" in message
    assert "\n" not in message


@pytest.mark.parametrize(
    "form",
    [
        'tick_budget = "1e8 tick exact, assumed"',
        '[clocks] name = "5 ms exact, assumed"',
        # The unit fits the kind of the part.
        'inertia = "1 kg*m^2 exact, assumed"',
        'gain = "1 A/V exact, assumed"',
        'counts = "100 count/mm exact, assumed"',
        'velocity = "1 m/s exact, assumed"',
        '"p" or "pd" or "pi"',
    ],
)
def test_a_missing_key_comes_with_a_value_that_would_do(tmp_path: Path, form: str) -> None:
    assert form in refused(tmp_path, BARE)


def test_a_tool_is_among_what_is_missing_where_an_axis_turns(tmp_path: Path) -> None:
    """A linear axis needs no tool; a rotary axis reports it with the rest."""
    assert "tool" not in refused(tmp_path, BARE)
    turning = BARE.replace('kind = "linear"', 'kind = "rotary"')
    assert "'tool' (like [tool] radius = \"100 mm exact, assumed\")" in refused(tmp_path, turning)


def test_proposed_lines_for_missing_keys_are_accepted(tmp_path: Path) -> None:
    """Adding the proposals of every message leads to a machine: the forms are right."""
    tables = {key: value for key, value in tomllib.loads(BARE).items()}
    for _ in range(12):
        file = tmp_path / "mine.toml"
        file.write_text(_written(tables), encoding="utf-8")
        try:
            machine = load_machine(file)
            break
        except MachineError as error:
            _add(tables, str(error))
    assert machine.axes["X"].counts.si == pytest.approx(100e3)
    assert machine.bodies["x"].inertia.unit == "kg*m^2"


def test_one_that_is_missing_is_told_alone(tmp_path: Path) -> None:
    message = refused(tmp_path, 'base = "lathe-winder"\ntool = "none"\n')
    assert message.endswith(
        "'tool' is missing: it gives the radius of the rotary axis A, "
        'like [tool] radius = "100 mm exact, assumed"; or give the axis a radius.'
    )


def test_a_machine_without_axes_and_more_is_told_of_both(tmp_path: Path) -> None:
    message = refused(tmp_path, 'name = "x"\n')
    assert "'axes' (like [axes.X] with kind, counts, velocity, acceleration)" in message
    assert "'bodies' (like [bodies.name] with kind, inertia)" in message


def _add(tables: dict, message: str) -> None:
    """Put the proposal of a message into ``tables``."""
    proposed = re.findall(r"'([\w.]+)' \((?:line \d+, )?like (.+?)\)(?:,|\.| Add)", message)
    proposed += re.findall(r"'([\w.]+)' is missing. Add it, like (.+)$", message)
    for key, form in proposed:
        *parts, last = key.split(".")
        node = tables
        for part in parts:
            node = node[part]
        header = re.match(r"\[(\w+)\] (.*)", form)
        chosen = 'kind = "pd"' if '"pd"' in form else form
        row = tomllib.loads(header[2] if header else chosen)
        node[last] = row if header else row[last]
    # The author chooses these names; no proposal can know them.
    named = re.search(r"names the (\w+) '(\w+)'", message)
    if named and named[1] == "clock":
        tables["clocks"][named[2]] = "5 ms exact, assumed"
    elif named and named[1] == "encoder":
        reads = {"x": "4000 count/rev exact, assumed"}
        tables["sensors"] = {named[2]: {"kind": "encoder", "reads": reads}}
    elif named and named[1] == "drive":
        tables["drives"][named[2]] = tables["drives"]["x"]


def _written(tables: dict) -> str:
    lines = [f"{key} = {_value(value)}" for key, value in tables.items()]
    return "\n".join(lines) + "\n"


def _value(value: object) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{k} = {_value(v)}" for k, v in value.items()) + " }"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        return "[" + ", ".join(_value(v) for v in value) + "]"
    return f'"{value}"'
