"""The emitted text is strict IEC 61131-3: parsed by blark, checked where blark is lenient."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from tests.commands.plc.parts import read_in_parts
from tests.commands.plc.reading import IDENTIFIER, Unit, code_of, read
from tests.commands.plc.texts import emitted, text_of, units_of
from threadline.commands.schedule import compile_schedule
from threadline.commands.schedule_options import shaping_of
from threadline.commands.structured_text import (
    OPENPLC,
    plc_program,
    sized,
    structured_text,
    write_openplc,
    write_structured_text,
)
from threadline.jobs import read_job
from threadline.machine import load_machine

# Keywords and standard names of the standard's annex C that a sequence may collide with.
KEYWORD_TEXT = """
step initial_step action transition program task resource configuration with on at to from
retain constant var type struct array of case if then else elsif for while repeat until exit
return true false and or not xor mod function function_block int bool time real string date
ton tof tp r_trig f_trig rs sr sema ctu ctd left right mid len find limit max min move sel
mux abs add sub mul div eq ne gt ge lt le shl shr rol ror ld ldn st stn s r jmp cal ret in
pt q et clk single interval priority read_only read_write end_step by do
"""
KEYWORDS = frozenset(KEYWORD_TEXT.split())
TON_PINS = {"in": "BOOL", "pt": "TIME", "q": "BOOL", "et": "TIME"}


ASSIGNMENT = re.compile(r"^\s*(\w+) := ([^;]+);", re.MULTILINE)
EVERY_SHAPER = pytest.mark.parametrize("shaper", ["zv", "um-2ei"])


def pin_type(unit: Unit, used: str, units: dict[str, Unit]) -> str:
    instance, pin = used.split(".")
    kind = unit.declared[instance].type
    if kind == "TON":
        return TON_PINS[pin]
    block = units[kind.lower()]
    assert block.declared[pin].section in {"VAR_INPUT", "VAR_OUTPUT"}, used
    return block.declared[pin].type


@pytest.mark.long(shown_by="test_every_name_is_declared_once_typed_and_no_keyword")
def test_reading_in_parts_is_reading_the_whole(tmp_path: Path) -> None:
    """Every other test reads a text in parts; blark takes this short one in one piece."""
    file = tmp_path / "short.toml"
    file.write_text(
        '[[operation]]\nvalve = "main_air"\n[[operation]]\nmove = { X = "200 mm" }\n', "utf-8"
    )
    machine = load_machine("letter-placer")
    made = compile_schedule(read_job(file, machine), machine, shaping_of(machine, "um-zv"))
    text = structured_text(made).units
    whole, parts = read(text), read_in_parts(text)
    assert list(whole) == list(parts)
    for name, unit in whole.items():
        other = parts[name]
        assert (unit.kind, unit.declared, unit.twice, unit.mixed_blocks) == (
            other.kind, other.declared, other.twice, other.mixed_blocks,
        )  # fmt: skip
        code, again = code_of(unit), code_of(other)
        assert len(code.lines) > 10
        assert (code.lines, code.used, code.assigned) == (again.lines, again.used, again.assigned)


@EVERY_SHAPER
def test_every_name_is_declared_once_typed_and_no_keyword(shaper: str) -> None:
    units = units_of("letter-placer", shaper)
    assert sorted(unit.kind for unit in units.values()) == ["FUNCTION_BLOCK", "PROGRAM"]
    for unit in units.values():
        assert unit.twice == []
        assert unit.mixed_blocks == 0, "located and unlocated variables in one VAR block"
        for name, declared in unit.declared.items():
            assert IDENTIFIER.fullmatch(name), name
            assert name not in KEYWORDS
            assert name not in units
            known = declared.type in {"BOOL", "INT", "DINT", "STRING", "TIME", "TON"}
            assert known or declared.type.lower() in units, declared
        assert unit.name not in KEYWORDS
        code = code_of(unit)
        for used in code.used:
            if "." in used:
                pin_type(unit, used, units)
            else:
                assert used in unit.declared, f"{used} is not declared in {unit.name}"
        for name in code.assigned:
            assert unit.declared[name].section != "VAR_INPUT", name


@EVERY_SHAPER
def test_assignments_agree_with_their_types(shaper: str) -> None:
    """BOOL := BOOL, INT := INT, TIME := TIME; blark would accept anything."""
    units = units_of("letter-placer", shaper)
    values = {"BOOL", "INT", "DINT", "STRING", "TIME"}
    for unit in units.values():
        for line in ASSIGNMENT.findall(text_of("letter-placer", shaper)):
            target, source = line[0].lower(), line[1].strip()
            if target not in unit.declared or "." in source:
                continue
            expected = unit.declared[target].type
            if source in {"TRUE", "FALSE"}:
                assert expected == "BOOL", line
            elif source.startswith("T#"):
                assert expected == "TIME", line
            elif source.isdigit():
                assert expected in {"INT", "DINT"}, line
            elif source.startswith("'"):
                assert expected == "STRING", line
            elif source.lower() in unit.declared:
                assert unit.declared[source.lower()].type == expected, line
            else:
                assert expected in values


@EVERY_SHAPER
def test_outputs_are_off_by_default(shaper: str) -> None:
    (block,) = [u for u in units_of("letter-placer", shaper).values() if u.kind == "FUNCTION_BLOCK"]
    for name in block.of("VAR_OUTPUT"):
        declared = block.declared[name]
        assert declared.initial in {"BOOL": [False], "STRING": ["", "idle"]}.get(declared.type, [0])


@EVERY_SHAPER
def test_addresses_are_those_of_the_machine_and_unique(shaper: str) -> None:
    (program,) = [u for u in units_of("letter-placer", shaper).values() if u.kind == "PROGRAM"]
    addresses = [d.address for d in program.declared.values() if d.address]
    assert len(addresses) == len(set(addresses)) == 26
    assert program.declared["light_grid"].address == "%IX0.0"
    assert program.declared["x_right_a1"].address == "%QX0.2"


def test_configuration_runs_the_program_in_a_timed_task() -> None:
    text = emitted("letter-placer", "zv", "st")["configuration.st"].decode("ascii")
    found = re.fullmatch(
        r"CONFIGURATION (\w+)\s+RESOURCE (\w+) ON PLC\s+"
        r"TASK (\w+)\(INTERVAL := T#10ms, PRIORITY := 0\);\s+"
        r"PROGRAM (\w+) WITH (\w+) : (\w+);\s+END_RESOURCE\s+END_CONFIGURATION\s*",
        text,
    )
    assert found is not None
    names = [name.lower() for name in found.groups()]
    assert names[2] == names[4]
    assert names[5] in units_of("letter-placer", "zv")
    # A name that is the word behind ON would hide it.
    assert "plc" not in names
    assert not set(names) & KEYWORDS


PPX = "{http://www.plcopen.org/xml/tc6_0201}"
XHTML = "{http://www.w3.org/1999/xhtml}"


@EVERY_SHAPER
def test_plcopen_project_holds_the_same_units(shaper: str) -> None:
    """The shape of TC6 version 2.01, with body and variables equal to those of the text."""
    root = ET.fromstring(emitted("letter-placer", shaper, "plcopen")["st"])
    assert root.tag == f"{PPX}project"
    order = [child.tag.removeprefix(PPX) for child in root]
    assert order == ["fileHeader", "contentHeader", "types", "instances"]
    units = units_of("letter-placer", shaper)
    pous = {p.attrib["name"].lower(): p for p in root.iter(f"{PPX}pou")}
    assert set(pous) == set(units)
    for name, unit in units.items():
        pou = pous[name]
        expected = {"FUNCTION_BLOCK": "functionBlock", "PROGRAM": "program"}[unit.kind]
        assert pou.attrib["pouType"] == expected
        found = {}
        for variable in pou.iter(f"{PPX}variable"):
            (kind,) = variable.find(f"{PPX}type")  # type: ignore[misc]
            type_name = kind.attrib.get("name", kind.tag.removeprefix(PPX))
            found[variable.attrib["name"].lower()] = (
                type_name.upper(),
                variable.attrib.get("address", ""),
            )
        assert found == {n: (d.type, d.address) for n, d in unit.declared.items()}
        body = pou.find(f"{PPX}body/{PPX}ST/{XHTML}p")
        assert body is not None
        assert (body.text or "").strip() in text_of("letter-placer", shaper)
    task = next(root.iter(f"{PPX}task"))
    assert task.attrib["interval"] == "T#10ms"
    instance = next(task.iter(f"{PPX}pouInstance"))
    assert instance.attrib["typeName"].lower() in pous


def test_openplc_takes_one_file_with_the_names_of_its_build() -> None:
    """Its build compiles Config0.c and Res0.c; the compiler names them after the configuration."""
    files = emitted("letter-placer", "zv", "openplc")
    assert list(files) == ["st"]
    text = files["st"].decode("ascii")
    units, _, configuration = text.partition("CONFIGURATION ")
    assert units.rstrip() == text_of("letter-placer", "zv").rstrip()
    assert configuration.startswith("Config0\n  RESOURCE Res0 ON PLC\n")
    assert configuration.count("CONFIGURATION") == 1
    assert re.search(r"PROGRAM machine WITH timed : letter_placer_main;", configuration)


def test_a_job_called_as_the_configuration_gets_another_name(tmp_path: Path) -> None:
    file = tmp_path / "config0.toml"
    file.write_text('[[operation]]\nvalve = "main_air"\n', "utf-8")
    machine = load_machine("letter-placer")
    made = compile_schedule(read_job(file, machine), machine)
    text = structured_text(made, OPENPLC)
    assert text.units.startswith("FUNCTION_BLOCK config0_2\n")
    assert text.configuration.startswith("CONFIGURATION Config0\n")


@pytest.mark.parametrize("pairs", [1, 100])
def test_the_time_of_a_scan_is_told_and_a_long_list_takes_little_more(
    tmp_path: Path, pairs: int
) -> None:
    """A long list is tables: the controller has one loop, which runs three times in a scan."""
    down, up = (
        f'[[operation]]\nmove = {{ Z = "{to} mm" }}\n[[operation]]\nwait = "{switch}"\n'
        for to, switch in ((100, "z_is_down"), (0, "z_is_up"))
    )
    file = tmp_path / "list.toml"
    file.write_text('[[operation]]\nvalve = "main_air"\n' + pairs * (down + up), "utf-8")
    machine = load_machine("letter-placer")
    made = compile_schedule(read_job(file, machine), machine)
    for write in (write_structured_text, write_openplc):
        warning = write(made, tmp_path / "a.st")[0]
        (fact,) = warning.facts
        assert f"{(tmp_path / 'a.st').stat().st_size / 1e3:.0f} kB of text" in fact
        assert not any("the program is large" in one for one in warning.warnings)
        text = (tmp_path / "a.st").read_text("ascii")
        body = text.partition("(* The watchdog")[2].partition("END_FUNCTION_BLOCK")[0]
        branch = re.compile(r"^ *(?:IF|ELSIF|WHILE) ", re.MULTILINE)
        every = len(branch.findall(body))
        loop = body.partition("WHILE NOT stays")[2].partition("END_WHILE")[0]
        branches = int(fact.split()[0])
        assert ("ARRAY" in text) == (pairs > 1)
        if pairs == 1:
            assert branches == every
        else:
            assert branches == every + 2 * (len(branch.findall(loop)) + 1)
            assert branches < 200


def test_a_file_above_a_megabyte_is_called_large(tmp_path: Path) -> None:
    """A list of some ten thousand moves would be as long; blanks stand for it."""
    file, machine = tmp_path / "list.toml", load_machine("letter-placer")
    file.write_text('[[operation]]\nvalve = "main_air"\n', "utf-8")
    made = compile_schedule(read_job(file, machine), machine)
    out = tmp_path / "a.st"
    for size, large in ((1_000_000, False), (1_001_000, True)):
        out.write_bytes(b" " * size)
        told = sized(made, plc_program(made), out)
        text = f"the program is large: {size / 1000:.0f} kB of text"
        assert any(one.startswith(text) for one in told.warnings) == large


def test_no_time_stands_without_a_name() -> None:
    """Every time of a move is a constant; literals are 0, the timers' spans, and half a scan."""
    text = text_of("letter-placer", "zv")
    body = text.partition("(* The watchdog")[2]
    found = set(re.findall(r"T#\w+", body))
    assert found <= {"T#0ms", "T#24h", "T#25ms", "T#5ms"}
    assert re.search(r"t_x_early_across_1 : TIME := T#\d+ms; \(\* across: X cannot be", text)
    assert re.search(r"t_z_gone_lift_1 : TIME := T#\d+ms; \(\* lift: Z must have left", text)


def test_the_comment_of_each_place_names_what_is_on_there(tmp_path: Path) -> None:
    """Compared with the schedule itself: each set of outputs of its rows, and no other."""
    file = tmp_path / "short.toml"
    file.write_text(
        '[[operation]]\nvalve = "main_air"\n[[operation]]\nmove = { X = "200 mm" }\n', "utf-8"
    )
    machine = load_machine("letter-placer")
    made = compile_schedule(read_job(file, machine), machine, shaping_of(machine, "um-zv"))
    text = structured_text(made).units
    matches = re.findall(r"s_cycle_\d+ : INT := \d+; \(\* on: (.*) \*\)", text)
    outputs, levels = made.commands.outputs, made.commands.levels.tolist()
    scheduled = [{name for name, on in zip(outputs, row, strict=True) if on} for row in levels]
    assert matches[0] == "main_air"
    assert [set(names.split(", ")) for names in matches] == scheduled


def test_the_notes_say_when_a_circuit_is_under_pressure() -> None:
    """The air of the letter placer takes 1.5 s; no other wait is a ramp."""
    text = text_of("letter-placer", "none")
    noted = re.findall(r"t_(\w+) : TIME := T#(\d+)ms; \(\* .* is under pressure", text)
    assert noted == [("start_1", "1500")]
