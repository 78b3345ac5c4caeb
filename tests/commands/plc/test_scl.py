"""The SCL source is the structured text in another form: complete, with every name declared.

No compiler of Siemens is used here. These checks need none: the frame of an external source, every
``#name`` declared in the block, every quoted tag in the table of tags, only types of S7; and the
body, converted back, read by blark and run on the same cell.
"""

from __future__ import annotations

import re

import pytest

from tests.commands.plc.driving import homed
from tests.commands.plc.machine import Plc
from tests.commands.plc.parts import read_in_parts
from tests.commands.plc.stuck import forbidden
from tests.commands.plc.texts import emitted, text_of

TYPES = {"Bool": "BOOL", "Int": "INT", "DInt": "DINT", "Time": "TIME", "String": "STRING",
         "TON_TIME": "TON"}  # fmt: skip


def source() -> str:
    return emitted("letter-placer", "zv", "scl")["st"].decode("ascii")


def undressed(scl: str) -> str:
    """Return the block as IEC structured text, with the structured text's program beside it."""
    block = scl[: scl.index("DATA_BLOCK")]
    block = re.sub(r"//.*", "", block).replace("\nBEGIN\n", "\n")
    block = re.sub(r"\{.*?\}\nVERSION : [0-9.]+\n", "", block)
    block = re.sub(r'FUNCTION_BLOCK "(\w+)"', r"FUNCTION_BLOCK \1", block)
    for mine, standard in TYPES.items():
        block = re.sub(rf" : {mine}\b", f" : {standard}", block)
    whole = text_of("letter-placer", "zv")
    return re.sub(r"(?<!T)#", "", block) + whole[whole.index("PROGRAM ") :]


def test_the_frame_of_the_source() -> None:
    text = source()
    assert re.match(
        r'FUNCTION_BLOCK "letter_cycle"\n\{ S7_Optimized_Access := \'TRUE\' \}\nVERSION : 0\.1\n',
        text,
    )
    order = ["FUNCTION_BLOCK", "VAR_INPUT", "VAR_OUTPUT", "VAR CONSTANT", "BEGIN",
             "END_FUNCTION_BLOCK", "DATA_BLOCK", "END_DATA_BLOCK", "ORGANIZATION_BLOCK",
             "END_ORGANIZATION_BLOCK"]  # fmt: skip
    places = [re.search(rf"^\s*{word}\b", text, re.MULTILINE) for word in order]
    starts = [match.start() for match in places if match]
    assert len(starts) == len(order)
    assert starts == sorted(starts)
    assert "%" not in re.sub(r"'[^']*'", "", text), "tags are symbolic"
    assert "contact_address := '%I0.3'" in text


def test_every_name_is_declared_and_every_tag_is_in_the_table() -> None:
    text = source()
    block = text[: text.index("END_FUNCTION_BLOCK")]
    declared = dict(re.findall(r"^    (\w+) : (\w+)", block, re.MULTILINE))
    assert set(declared.values()) <= set(TYPES)
    body = re.sub(r"'[^']*'", "''", block[block.index("\nBEGIN\n") :])
    used = set(re.findall(r"(?<!T)#(\w+)", body))
    assert used <= set(declared)
    bare = re.sub(r"\(\*.*?\*\)|#\w+(\.\w+)?|T#\w+", "", body)
    assert not set(re.findall(r"\b[a-z]\w*", bare)), "a local name without its #"
    tags = emitted("letter-placer", "zv", "scl")["tags.csv"].decode("ascii").splitlines()[1:]
    named = {line.split(",")[0]: line.split(",")[2] for line in tags}
    call = text[text.index("ORGANIZATION_BLOCK") :]
    assert set(re.findall(r'[:=]=?>? "(\w+)"', call)) == set(named)
    assert named["light_grid"] == "%I0.0"
    assert named["x_right_a1"] == "%Q0.2"
    assert len(set(named.values())) == 26


def test_the_tables_for_a_panel_hold_every_alarm_and_every_variable_without_an_address() -> None:
    files = emitted("letter-placer", "zv", "scl")
    text = source()
    codes = re.findall(r"^    f_\w+ : Int := (\d+);  // (.*)", text, re.MULTILINE)
    alarms = files["alarms.csv"].decode("ascii").splitlines()
    assert alarms[0] == "ID,Alarm text,Trigger variable"
    assert alarms[1:] == [f"{c},{message},letter_cycle_data.fault_code" for c, message in codes]
    tagged = {line.split(",")[0] for line in files["tags.csv"].decode("ascii").splitlines()[1:]}
    expected = []
    for block, access in (("VAR_INPUT", "write"), ("VAR_OUTPUT", "read")):
        part = text[text.index(f"  {block}") :].partition("END_VAR")[0]
        for name, kind in re.findall(r"^    (\w+) : (\w+)", part, re.MULTILINE):
            if name not in tagged:
                expected.append(f"{name},{kind},{access},letter_cycle_data.{name}")
    assert files["hmi.csv"].decode("ascii").splitlines()[1:] == expected
    assert "fault_text,String,read,letter_cycle_data.fault_text" in expected


@pytest.mark.parametrize("jitter", [0.0, 0.2])
def test_the_body_runs_the_cycle_as_the_structured_text_does(jitter: float) -> None:
    units = read_in_parts(undressed(source()))
    bench = homed(Plc(units), 10_000, jitter)
    bench.press("start_button")
    seen: list[set[str]] = []
    while bench.block["busy"]:
        seen.append(bench.scan())
        assert not forbidden(seen[-1], bench.cell)
    assert bench.block["finished"]
    other = homed(Plc(read_in_parts(text_of("letter-placer", "zv"))), 10_000, jitter)
    other.press("start_button")
    assert seen == [other.scan() for _ in seen]
