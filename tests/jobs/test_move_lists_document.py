"""``docs/move-lists.md`` against the reader: every key is there, and its list can be read."""

from __future__ import annotations

import re
from pathlib import Path

from threadline.commands.schedule import compile_schedule
from threadline.jobs import read_job
from threadline.jobs.moves import DEFAULT_TIMEOUT_S, OPERATION_KEYS
from threadline.machine import load_machine
from threadline.machine.pneumatics import REST_LAGS

TEXT = (Path(__file__).resolve().parents[2] / "docs" / "move-lists.md").read_text(encoding="utf-8")


def test_the_table_has_every_key_and_no_other() -> None:
    rows = dict(re.findall(r"^\| `(\w+)` \|(.*)\|$", TEXT, flags=re.MULTILINE))
    assert list(rows) == list(OPERATION_KEYS)
    every = {key for keys in OPERATION_KEYS.values() for key in keys} - set(OPERATION_KEYS)
    for verb, keys in OPERATION_KEYS.items():
        beside = set(re.findall(r"`(\w+)(?: = [^`]+)?`", rows[verb])) & every
        assert beside == set(keys) - {verb}
    assert f"{DEFAULT_TIMEOUT_S:g} s where it is left out" in rows["wait"]
    assert REST_LAGS == 4.0
    assert "four lags" in rows["move"]


def test_the_list_can_be_read_and_scheduled(tmp_path: Path) -> None:
    (block,) = re.findall(r"```toml\n(.*?)```", TEXT, flags=re.DOTALL)
    file = tmp_path / "pick.toml"
    file.write_text(block, encoding="utf-8")
    machine = load_machine("letter-placer")
    made = compile_schedule(read_job(file, machine), machine)
    lift, slide = (m for m in made.moves if m.step == "out")
    assert (lift.axis, slide.axis) == ("Z", "X")
    assert slide.first_tick > lift.last_tick
