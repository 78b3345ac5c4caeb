"""Readers of PLC program files: structured text, PLCopen XML and Siemens SCL, as units to run."""

from __future__ import annotations

import csv
import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from threadline.readback.scan_language import (
    TIMER,
    Declared,
    Parser,
    Unit,
    add,
    read_body,
    read_units,
)
from threadline.readback.scan_words import ScanError, time_us, tokens_of

_INTERVAL = re.compile(r"\bINTERVAL\s*:=\s*(T(?:IME)?#\w+)", re.IGNORECASE)
_SCL_DECORATION = re.compile(
    r"(?P<kept>'[^'\n]*'|//[^\n]*|\(\*.*?\*\))|\{[^}\n]*\}|\"(?P<tag>\w+)\"|(?<!\w)#(?P<own>\w+)",
    re.DOTALL,
)
_POUS = {"functionBlock": "function_block", "program": "program"}
_SECTIONS = {"inputVars": "var_input", "outputVars": "var_output", "localVars": "var"}


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadProgram:
    """A program that was read from a file.

    Parameters
    ----------
    units
        Programs and function blocks.
    interval_us
        Interval of its task; None if the file does not say it.
    addresses
        Addresses from a separate file, by name of a variable; None if they stand in the program.
    """

    units: list[Unit]
    interval_us: int | None = None
    addresses: Mapping[str, str] | None = None


def of_text(path: Path) -> ReadProgram:
    """Read structured text; its task may stand in ``NAME.configuration.st`` beside it.

    Raises
    ------
    ScanError, UnicodeDecodeError
        If the file is no such text.
    """
    text = path.read_text(encoding="utf-8")
    units = list(read_units(text))
    configuration = path.with_name(f"{path.stem}.configuration.st")
    if configuration.is_file() and not _INTERVAL.search(text):
        text += "\n" + configuration.read_text(encoding="utf-8")
    return ReadProgram(units=units, interval_us=_interval_us(text))


def _interval_us(text: str) -> int | None:
    match = _INTERVAL.search(text)
    return None if match is None else time_us(match[1])


def of_plcopen(path: Path) -> ReadProgram:
    """Read PLCopen XML.

    Raises
    ------
    ScanError, UnicodeDecodeError
        If the file is no such project.
    """
    content = path.read_text(encoding="utf-8")
    if "<!DOCTYPE" in content or "<!ENTITY" in content:
        raise ScanError("it declares a document type, which PLCopen XML never does")
    try:
        root = ET.fromstring(content.encode())  # noqa: S314 (it has no entities, see above)
    except ET.ParseError as error:
        raise ScanError(f"it is no XML: {error}", error.position[0]) from error
    except (LookupError, ValueError) as error:
        raise ScanError(f"it names an encoding that XML does not have: {error}", 1) from error
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
    units = [_pou(pou) for pou in root.iter("pou")]
    task = root.find(".//task")
    interval = None if task is None else _interval_of(task.get("interval", ""))
    return ReadProgram(units=units, interval_us=interval)


def _interval_of(text: str) -> int:
    """Return an interval in us from its form in XML: ``PT0.01S``, or ``T#10ms``."""
    match = re.fullmatch(r"PT(\d{1,9}(?:\.\d{1,9})?)S", text)
    return round(1e6 * float(match[1])) if match else time_us(text)


def _pou(element: ET.Element) -> Unit:
    kind, name = element.get("pouType", ""), element.get("name", "").lower()
    if kind not in _POUS or not name:
        raise ScanError(f"its unit {name!r} is of the unknown kind {kind!r}")
    unit = Unit(kind=_POUS[kind], name=name)
    for section in element.iterfind("interface/*"):
        if section.tag in _SECTIONS:
            for variable in section.iterfind("variable"):
                add(unit, _variable(variable, _SECTIONS[section.tag]))
    body = element.find("body/ST")
    if body is None:
        raise ScanError(f"{name} has no body in structured text")
    unit.body = read_body("".join(body.itertext()))
    return unit


def _variable(element: ET.Element, section: str) -> Declared:
    name, kind = element.get("name", "").lower(), element.find("type/*")
    if kind is None or not name:
        raise ScanError(f"the variable {name!r} has no type")
    if kind.tag == "array":
        kind = kind.find("baseType/*")
    if kind is None:
        raise ScanError(f"the array {name!r} has no type")
    type_name = kind.get("name", "") if kind.tag == "derived" else kind.tag
    initial: object = None
    single = element.find("initialValue/simpleValue")
    if single is not None:
        initial = _literal(single)
    values = element.find("initialValue/arrayValue")
    if values is not None:
        initial = [
            _literal(element_value)
            for value in values.iterfind("value")
            for element_value in value.iterfind("simpleValue")
            for _ in range(_count(value.get("repetitionValue", "1")))
        ]
    address = element.get("address", "").upper()
    return Declared(
        name=name, type=type_name.lower(), section=section, address=address, initial=initial
    )


def _count(text: str) -> int:
    if not text.isdecimal() or len(text) > 6:
        raise ScanError(f"{text[:40]!r} is not a number of values")
    return int(text)


def _literal(element: ET.Element) -> object:
    return Parser(tokens_of(element.get("value", ""))).literal()


def of_scl(path: Path) -> ReadProgram:
    """Read a source for Siemens' S7; addresses stand in ``NAME.tags.csv`` beside it.

    Raises
    ------
    ScanError, UnicodeDecodeError
        If the file is no such source.
    """
    text = path.read_text(encoding="utf-8")
    tags = path.with_name(f"{path.stem}.tags.csv")
    if not tags.is_file():
        raise ScanError(f"the table of its tags is missing: {tags.name}")
    with tags.open(encoding="utf-8", newline="") as file:
        rows = [row for row in csv.reader(file) if len(row) > 2]
    addresses = {
        name.lower(): re.sub(r"^%([IQ])(?=\d)", r"%\1X", address)
        for name, _, address, *_ in rows[1:]
    }
    match = re.search(r"cyclic interrupt of (\d{1,9}) ms", text)
    return ReadProgram(
        units=_scl_units(text, addresses),
        interval_us=None if match is None else 1000 * int(match[1]),
        addresses=addresses,
    )


def _bare_word(match: re.Match[str]) -> str:
    """Return a word of SCL without the ``#`` or the quotes that IEC 61131-3 does not have."""
    return match["kept"] or match["tag"] or match["own"] or ""


def _scl_units(text: str, addresses: Mapping[str, str]) -> list[Unit]:
    parser = Parser(tokens_of(_SCL_DECORATION.sub(_bare_word, text)))
    units, instances = list[Unit](), dict[str, str]()
    while not parser.done:
        word = parser.take("data_block", "function_block", "organization_block").lower()
        unit = Unit(kind=word, name=parser.name())
        for expected in ("version", ":", "0", ".", "1"):
            parser.take(expected)
        parser.sections(unit)
        if word == "data_block":
            _data_block(parser, unit, instances)
            units += [unit] if unit.declared else []
            continue
        parser.take("begin")
        unit.body = parser.statements(f"end_{word}")
        parser.take(f"end_{word}")
        units.append(unit)
        if word == "organization_block":
            unit.kind = "program"
            for name, address in addresses.items():
                add(unit, Declared(name=name, type="bool", section="var", address=address))
            for name, block in instances.items():
                add(unit, Declared(name=name, type=block, section="var"))
    tables = [unit.name for unit in units if unit.kind == "data_block"]
    for unit in units:
        unit.declared = {
            name: replace(variable, type=TIMER) if variable.type == "ton_time" else variable
            for name, variable in unit.declared.items()
        }
        if unit.kind == "function_block":
            for name in tables:
                add(unit, Declared(name=name, type=name, section="var"))
    return units


def _data_block(parser: Parser, unit: Unit, instances: dict[str, str]) -> None:
    """Read the rest of a data block: tables with their values, or the instance of a block."""
    if parser.peek() == "non_retain":
        parser.take()
        parser.sections(unit)
    if not unit.declared:
        instances[unit.name] = parser.name()
    parser.take("begin")
    while parser.peek() != "end_data_block":
        line, name = parser.line, parser.name()
        values = unit.declared[name].initial if name in unit.declared else None
        parser.take("[")
        index = parser.whole(len(values or ()) - 1)
        parser.take("]")
        parser.take(":=")
        if not isinstance(values, list):
            raise ScanError(f"{name} is no table of {unit.name}", line)
        values[index] = parser.literal()
        parser.take(";")
    parser.take("end_data_block")
    unit.body = lambda _, __: None
