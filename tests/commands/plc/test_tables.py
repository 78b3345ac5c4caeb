"""A long list as tables: the text is read, run scan by scan, and compared with text and plan.

The other tests read programs that name every place. Here the same list is written in both ways, and
a list too long for the first way is compared with its schedule.
"""

from __future__ import annotations

import random
import re
from functools import cache
from pathlib import Path

import pytest

from tests.commands.plc.driving import Bench, homed
from tests.commands.plc.machine import Plc
from tests.commands.plc.parts import read_in_parts
from tests.commands.plc.reading import IDENTIFIER, code_of
from tests.commands.plc.varied import MACHINE, SPEEDS, SWITCHES, Varied
from threadline.commands import structured_text as structured_text_module
from threadline.commands.intents import Scheduled
from threadline.commands.plcopen import plcopen_xml, scl_source
from threadline.commands.schedule import compile_schedule
from threadline.commands.schedule_options import shaping_of
from threadline.commands.structured_text import structured_text
from threadline.errors import PlanError
from threadline.jobs import read_job
from threadline.machine import load_machine

CYCLE = Path(__file__).resolve().parents[3] / "examples" / "letter-cycle.toml"
STEP = '[[operation]]\nstep = "{}"\n'
MOVES = (("Z", 100, "z_is_down"), ("Z", 0, "z_is_up"), ("X", 200, "x_is_right"),
         ("X", 0, "x_is_left"))  # fmt: skip
HOLD = '[[operation]]\nvacuum = "venturi"\n[[operation]]\nwait = "letter_held"\n'
LET_GO = '[[operation]]\nvacuum = "venturi"\non = false\n'


def long_list(rounds: int) -> str:
    """Return a list of four moves in each round; every third one holds a letter."""
    text = '[[operation]]\nvalve = "main_air"\n'
    for number in range(rounds):
        held = number % 3 == 0
        for axis, to, switch in MOVES:
            step = STEP.format(f"{axis.lower()}-{to}-{number % 7}").rstrip()
            text += f'{step}\nmove = {{ {axis} = "{to} mm" }}\n[[operation]]\nwait = "{switch}"\n'
            text += HOLD if held and switch == "z_is_down" else ""
            text += LET_GO if held and switch == "x_is_right" else ""
    return text


@cache
def scheduled_long(folder: Path, rounds: int) -> Scheduled:
    file = folder / "long.toml"
    file.write_text(long_list(rounds), "utf-8")
    machine = load_machine(MACHINE)
    return compile_schedule(read_job(file, machine), machine, shaping_of(machine, "um-zv"))


@cache
def both_ways() -> tuple[Plc, Plc]:
    """Return two controllers of one list: one that names its places, and one with tables."""
    machine = load_machine(MACHINE)
    made = compile_schedule(read_job(CYCLE, machine), machine)
    named = structured_text(made).units
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(structured_text_module, "LISTED", 0)
        tables = structured_text(made).units
    assert "ARRAY" in tables
    assert "ARRAY" not in named
    return Plc(read_in_parts(named)), Plc(read_in_parts(tables))


def states(bench: Bench) -> dict[str, object]:
    names = ("place", "step_text", "hint_text", "fault", "fault_code", "fault_place",
             "fault_step", "fault_contact", "contact_text", "homed", "finished", "count", "busy",
             "x_expected", "z_expected", "x_too_early", "z_must_be_gone")  # fmt: skip
    return {name: bench.block[name] for name in names}


def test_every_name_is_declared_and_valid(tmp_path: Path) -> None:
    units = read_in_parts(structured_text(scheduled_long(tmp_path, 30)).units)
    for unit in units.values():
        assert not unit.twice
        assert not unit.mixed_blocks
        used = {name.partition(".")[0] for name in code_of(unit).used}
        assert used <= unit.declared.keys() | {"now"}
        assert all(IDENTIFIER.fullmatch(name) for name in unit.declared)


@pytest.mark.long(but="3")
@pytest.mark.parametrize("seed", range(4))
def test_tables_do_what_named_places_do(seed: int) -> None:
    """Every output, fault and text of each jittered scan: creeping machines, failing inputs."""
    draw = random.Random(seed)
    speeds = {name: 1.0 + draw.uniform(-0.03, 0.03) for name in SPEEDS}
    moved = {name: draw.uniform(-2.0, 2.0) for name in SWITCHES}
    benches = [
        Bench(plc.fork(), 10_000, 0.2, seed, cell=Varied(speeds, moved)) for plc in both_ways()
    ]
    stopped, finished = set(), 0
    for scan in range(5 * 3000):
        part = scan % 3000
        given: dict[str, bool | int] = {
            "acknowledge": part == 1,
            "home_button": part == 3,
            "start_button": part == 1500,
            "continuous": scan % 6000 > 3000,
            "manual": part > 2900,
            "jog": scan // 20 % 9,
        }
        if part > 1600 and draw.random() < 0.0005:
            given[draw.choice(("light_grid", "enable"))] = False
        if part > 1500 and draw.random() < 0.0005:
            stuck = {draw.choice(SWITCHES): draw.random() < 0.5}
            for bench in benches:
                bench.cell.stuck = stuck
        if part == 0:
            for bench in benches:
                bench.cell.stuck = {}
        one, other = (bench.scan(**given) for bench in benches)
        assert one == other, scan
        assert states(benches[0]) == states(benches[1]), scan
        stopped.add(benches[0].block["fault_code"])
        finished += bool(benches[0].block["finished"])
    assert len(stopped) > 1, "no fault was compared"
    assert finished, "no cycle ran to its end"


@pytest.mark.long(shown_by="test_tables_do_what_named_places_do")
def test_a_long_list_plays_its_schedule(tmp_path: Path) -> None:
    """800 moves: each switching in order, at its time after the last input as in the schedule."""
    made = scheduled_long(tmp_path, 200)
    text = structured_text(made).units
    assert len(text) < 100_000
    bench = homed(Plc(read_in_parts(text)))
    commands = made.commands
    rows = [
        {n for n, on in zip(commands.outputs, row, strict=True) if on}
        for row in commands.levels.tolist()
    ]
    waits = [event.tick for event in commands.events if event.kind == "wait"]
    on, played, at = set[str](), [], []
    bench.press("start_button")
    while bench.block["busy"]:
        if bench.on != on:
            on = set(bench.on)
            played.append(on)
            at.append(bench.count)
        bench.scan()
    assert bench.block["finished"], bench.block["fault_text"]
    # At the end every output goes off, main air with them; the schedule leaves it on.
    assert played == rows[: len(played)]
    assert len(rows) - len(played) <= 1
    for k in range(1, len(played)):
        first, then = int(commands.ticks[k - 1]), int(commands.ticks[k])
        if not any(first <= wait < then for wait in waits):
            assert at[k] - at[k - 1] == then - first, k


def test_the_tables_in_xml_and_scl_have_the_same_values(tmp_path: Path) -> None:
    made = scheduled_long(tmp_path, 30)
    units = read_in_parts(structured_text(made).units)
    (block,) = (unit for unit in units.values() if unit.kind == "FUNCTION_BLOCK")
    arrays = {n: d for n, d in block.declared.items() if isinstance(d.initial, list)}
    xml = plcopen_xml(made).decode("utf-8")
    source = scl_source(made)
    table = source[: source.index("END_DATA_BLOCK")]
    assert table.startswith('DATA_BLOCK "long_table"')
    for name, array in arrays.items():
        upper = len(array.initial) - 1
        (element,) = re.findall(rf'<variable name="{name}">.*?</variable>', xml, re.DOTALL)
        assert f'<dimension lower="0" upper="{upper}" />' in element
        found: list[str] = []
        for count, value in re.findall(
            r'<value(?: repetitionValue="(\d+)")?>\s*<simpleValue value="(.*?)" />', element
        ):
            found += [value] * int(count or 1)
        assert [literal(one) for one in found] == array.initial, name
        assert f"{name} : Array[0..{upper}] of " in table
        given = dict(re.findall(rf"^  {name}\[(\d+)\] := (.*);$", table, re.MULTILINE))
        default = {"BOOL": "FALSE", "INT": "0", "TIME": "T#0ms", "STRING": "''"}[array.type]
        literals = [literal(given.get(str(k), default)) for k in range(upper + 1)]
        assert literals == array.initial, name
        assert not re.search(rf"(?<![\".\w]){name}\[", source[source.index("END_DATA_BLOCK") :])
        assert f'"long_table".{name}[' in source


def test_a_list_of_more_places_than_an_int_counts_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(structured_text_module, "MOST_PLACES", 100)
    with pytest.raises(PlanError, match=r"\d+ places, and a PLC numbers 100 at most"):
        structured_text(scheduled_long(tmp_path, 30))


def literal(text: str) -> object:
    if text in {"TRUE", "FALSE"}:
        return text == "TRUE"
    if text.startswith("T#"):
        return 1000 * int(text.removeprefix("T#").removesuffix("ms"))
    return text[1:-1] if text.startswith("'") else int(text)
