"""A schedule as PLCopen XML and as Siemens SCL, with the same units as its structured text.

The SCL source is for TIA Portal (S7-1200, S7-1500). It contains the function block with interface,
BEGIN and body, an instance data block, and an organisation block for a cyclic interrupt that calls
the function block with symbolic tags. Tables of these tags, of the alarm texts and of the variables
for a panel are files beside the source. The body
has the lines of the structured text; local names start with ``#``, tags stand in quotes, and timers
are IEC timers.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path

from threadline import __version__
from threadline.base.wording import plain, st_comment
from threadline.base.writing import together
from threadline.commands.intents import Scheduled
from threadline.commands.plc_sequence import FAULTS, Block, PlcProgram, Pou, Variable
from threadline.commands.structured_text import plc_program, sized
from threadline.files.formats.common import Written, atomic_file, written

_TYPES = {
    "BOOL": "Bool", "INT": "Int", "DINT": "DInt", "TIME": "Time", "STRING": "String",
    "TON": "TON_TIME",
}  # fmt: skip
_BY_ITSELF = {"BOOL": "FALSE", "INT": "0", "TIME": "T#0ms", "STRING": "''"}
"""Values that a data block has by default."""
_ARRAY = re.compile(r"(?<![#\w.])[a-z]\w*(?=\[)")
_NAME = re.compile(r"'[^']*'|\(\*.*?\*\)|(?<![#%\w.])[A-Za-z_]\w*")


def scl_source(scheduled: Scheduled) -> str:
    """Return the SCL source of ``scheduled``.

    Raises
    ------
    PlanError
        As ``plc_program``.
    """
    program = plc_program(scheduled)
    instance = f"{program.block.name}_data"
    lines = [
        *_table_block(program.block),
        *_function_block(program.block),
        "",
        f'DATA_BLOCK "{instance}"',
        "{ S7_Optimized_Access := 'TRUE' }",
        "VERSION : 0.1",
        "NON_RETAIN",
        f'"{program.block.name}"',
        "BEGIN",
        "END_DATA_BLOCK",
        "",
        *_organisation_block(program, instance),
    ]
    return "\n".join(lines) + "\n"


def _table_of(pou: Pou) -> str:
    return f"{pou.name}_table"


def _arrays(pou: Pou) -> list[Variable]:
    return [variable for block in pou.blocks for variable in block.variables if variable.values]


def _table_block(pou: Pou) -> Iterator[str]:
    """Yield the data block of the tables of a long sequence; nothing without tables."""
    arrays = _arrays(pou)
    if not arrays:
        return
    yield f'DATA_BLOCK "{_table_of(pou)}"'
    yield "{ S7_Optimized_Access := 'TRUE' }"
    yield "VERSION : 0.1"
    yield "NON_RETAIN"
    yield "  VAR"
    for array in arrays:
        last, note = len(array.values) - 1, st_comment(array.note)
        yield f"    {array.name} : Array[0..{last}] of {_TYPES[array.type]};  // {note}"
    yield "  END_VAR"
    yield "BEGIN"
    for array in arrays:
        for index, value in enumerate(array.values):
            if value != _BY_ITSELF[array.type]:
                yield f"  {array.name}[{index}] := {value};"
    yield "END_DATA_BLOCK"
    yield ""


def _function_block(pou: Pou) -> Iterator[str]:
    yield f'FUNCTION_BLOCK "{pou.name}"'
    yield "{ S7_Optimized_Access := 'TRUE' }"
    yield "VERSION : 0.1"
    for note in pou.notes:
        yield f"// {st_comment(note)}"
    arrays = {array.name for array in _arrays(pou)}
    for block in pou.blocks:
        if not any(variable.values for variable in block.variables):
            yield from _scl_variables(block)
    yield "BEGIN"
    local = {variable.name for block in pou.blocks for variable in block.variables} - arrays
    for line in pou.body:
        marked = _local(line, local)
        yield f"  {_of_table(marked, arrays, _table_of(pou))}" if line else ""
    yield "END_FUNCTION_BLOCK"


def _scl_variables(block: Block) -> Iterator[str]:
    yield f"  {block.kind}"
    for variable in block.variables:
        yield f"    {_declaration(variable)}"
    yield "  END_VAR"


def _declaration(variable: Variable) -> str:
    initial = f" := {variable.initial}" if variable.initial else ""
    note = f"  // {st_comment(variable.note)}" if variable.note else ""
    return f"{variable.name} : {_TYPES[variable.type]}{initial};{note}"


def _local(line: str, names: set[str]) -> str:
    """Return a line with ``#`` before every local name; string texts and comments stay.

    A string text that is an address takes the form of this PLC, ``%I0.0``.
    """

    def marked(match: re.Match[str]) -> str:
        if match[0].startswith("'%"):
            return _address(match[0])
        return f"#{match[0]}" if match[0] in names else match[0]

    return _NAME.sub(marked, line)


def _of_table(line: str, arrays: set[str], table: str) -> str:
    """Return a line with the data block before every name of an array."""
    return _ARRAY.sub(
        lambda match: f'"{table}".{match[0]}' if match[0] in arrays else match[0], line
    )


def _address(standard: str) -> str:
    return standard.replace("X", "", 1)


def _located(program: PlcProgram) -> dict[str, str]:
    """Return the address of every tag, in the order of the machine file."""
    variables = [v for block in program.main.blocks for v in block.variables]
    return {v.name: v.address for v in variables if v.address}


def _organisation_block(program: PlcProgram, instance: str) -> Iterator[str]:
    """Yield the organisation block for a cyclic interrupt with the period of the scan."""
    arguments = [
        f'{name} {":=" if address.startswith("%I") else "=>"} "{name}"'
        for name, address in _located(program).items()
    ]
    yield f'ORGANIZATION_BLOCK "{program.main.name}"'
    yield "{ S7_Optimized_Access := 'TRUE' }"
    yield "VERSION : 0.1"
    yield f"// Make it a cyclic interrupt of {program.interval_ms} ms. What has no address is for a"
    yield f"// panel: it is read and written in {instance}."
    yield "BEGIN"
    yield f'  "{instance}"('
    for number, argument in enumerate(arguments, start=1):
        yield f"    {argument}{'' if number == len(arguments) else ','}"
    yield "  );"
    yield "END_ORGANIZATION_BLOCK"


def scl_tags(scheduled: Scheduled) -> str:
    """Return the table of tags: name, type and address in the form of this PLC, ``%I0.0``."""
    rows = [
        f"{name},Bool,{_address(address)}"
        for name, address in _located(plc_program(scheduled)).items()
    ]
    return "\n".join(("Name,Data Type,Logical Address", *rows)) + "\n"


def scl_alarms(program: PlcProgram) -> str:
    """Return the table of alarms: value of ``fault_code``, its text, and the variable."""
    variable = f"{program.block.name}_data.fault_code"
    rows = [f"{code},{text},{variable}" for code, text in enumerate(FAULTS.values()) if code]
    return "\n".join(("ID,Alarm text,Trigger variable", *rows)) + "\n"


def scl_panel(program: PlcProgram) -> str:
    """Return the table of the variables for a panel: name, type, access and path in the PLC."""
    located = _located(program)
    rows = [
        f"{variable.name},{_TYPES[variable.type]},"
        f"{'write' if block.kind == 'VAR_INPUT' else 'read'},"
        f"{program.block.name}_data.{variable.name}"
        for block in program.block.blocks
        if block.kind in {"VAR_INPUT", "VAR_OUTPUT"}
        for variable in block.variables
        if variable.name not in located
    ]
    return "\n".join(("Name,Data Type,Access,PLC variable", *rows)) + "\n"


def write_scl(scheduled: Scheduled, path: Path) -> list[Written]:
    """Write the source to ``path``, and three tables beside it.

    ``NAME.tags.csv`` has the tags, ``NAME.alarms.csv`` the alarm texts, and ``NAME.hmi.csv`` the
    variables for a panel.
    """
    program = plc_program(scheduled)
    tables = {"tags": scl_tags(scheduled), "alarms": scl_alarms(program), "hmi": scl_panel(program)}
    beside = [path.with_name(f"{path.stem}.{name}.csv") for name in tables]
    with together():
        for file, content in zip(
            (path, *beside), (scl_source(scheduled), *tables.values()), strict=True
        ):
            with atomic_file(file) as stream:
                stream.write(content.encode("ascii"))
        return [sized(scheduled, program, path), *map(written, beside)]


NAMESPACE = "http://www.plcopen.org/xml/tc6_0201"
XHTML = "http://www.w3.org/1999/xhtml"
EPOCH = "2000-01-01T00:00:00"
"""Default creation time; it is fixed, so that the same job gives the same file."""
_LISTS = {
    "VAR_INPUT": "inputVars",
    "VAR_OUTPUT": "outputVars",
    "VAR": "localVars",
    "VAR CONSTANT": "localVars",
}
_KINDS = {"FUNCTION_BLOCK": "functionBlock", "PROGRAM": "program"}


def plcopen_xml(scheduled: Scheduled, created: str = EPOCH) -> bytes:
    """Return the PLCopen XML project of ``scheduled``.

    Parameters
    ----------
    created
        Creation time, ISO 8601 without a zone.

    Raises
    ------
    PlanError
        As ``plc_program``.
    """
    program = plc_program(scheduled)
    project = ET.Element("project", {"xmlns": NAMESPACE, "xmlns:xhtml": XHTML})
    ET.SubElement(
        project,
        "fileHeader",
        {
            "companyName": "Threadline",
            "productName": "Threadline",
            "productVersion": __version__,
            "creationDateTime": created,
        },
    )
    content = ET.SubElement(project, "contentHeader", {"name": plain(scheduled.job.name)})
    coordinates = ET.SubElement(content, "coordinateInfo")
    for language in ("fbd", "ld", "sfc"):
        ET.SubElement(ET.SubElement(coordinates, language), "scaling", {"x": "1", "y": "1"})
    types = ET.SubElement(project, "types")
    ET.SubElement(types, "dataTypes")
    units = ET.SubElement(types, "pous")
    for pou in (program.block, program.main):
        _pou(units, pou)
    _instances(project, program)
    ET.indent(project)
    text: bytes = ET.tostring(project, encoding="utf-8", xml_declaration=True)
    return text + b"\n"


def _pou(parent: ET.Element, pou: Pou) -> None:
    element = ET.SubElement(parent, "pou", {"name": pou.name, "pouType": _KINDS[pou.kind]})
    interface = ET.SubElement(element, "interface")
    for block in pou.blocks:
        _plcopen_variables(interface, block)
    body = ET.SubElement(ET.SubElement(element, "body"), "ST")
    ET.SubElement(body, "xhtml:p").text = "\n".join(pou.body) + "\n"
    documentation = ET.SubElement(element, "documentation")
    ET.SubElement(documentation, "xhtml:p").text = plain(" ".join(pou.notes))


def _plcopen_variables(parent: ET.Element, block: Block) -> None:
    constant = {"constant": "true"} if block.kind == "VAR CONSTANT" else {}
    element = ET.SubElement(parent, _LISTS[block.kind], constant)
    for variable in block.variables:
        _variable(element, variable)


def _variable(parent: ET.Element, variable: Variable) -> None:
    at = {"address": variable.address} if variable.address else {}
    element = ET.SubElement(parent, "variable", {"name": variable.name, **at})
    kind = ET.SubElement(element, "type")
    if variable.values:
        array = ET.SubElement(kind, "array")
        ends = {"lower": "0", "upper": str(len(variable.values) - 1)}
        ET.SubElement(array, "dimension", ends)
        kind = ET.SubElement(array, "baseType")
    if variable.derived:
        ET.SubElement(kind, "derived", {"name": variable.type})
    else:
        # The schema has string types as elements of their own, in lower case.
        ET.SubElement(kind, "string" if variable.type == "STRING" else variable.type)
    if variable.initial:
        initial = ET.SubElement(element, "initialValue")
        ET.SubElement(initial, "simpleValue", {"value": variable.initial})
    if variable.values:
        initial = ET.SubElement(ET.SubElement(element, "initialValue"), "arrayValue")
        for literal, count in variable.runs:
            repeated = {"repetitionValue": str(count)} if count > 1 else {}
            value = ET.SubElement(initial, "value", repeated)
            ET.SubElement(value, "simpleValue", {"value": literal})
    if variable.note:
        documentation = ET.SubElement(element, "documentation")
        ET.SubElement(documentation, "xhtml:p").text = plain(variable.note)


def _instances(project: ET.Element, program: PlcProgram) -> None:
    configurations = ET.SubElement(ET.SubElement(project, "instances"), "configurations")
    configuration = ET.SubElement(configurations, "configuration", {"name": program.configuration})
    resource = ET.SubElement(configuration, "resource", {"name": program.resource})
    interval = f"T#{program.interval_ms}ms"
    task = ET.SubElement(
        resource, "task", {"name": program.task, "interval": interval, "priority": "0"}
    )
    ET.SubElement(task, "pouInstance", {"name": program.instance, "typeName": program.main.name})


def write_plcopen(scheduled: Scheduled, path: Path) -> list[Written]:
    """Write the PLCopen XML project to ``path``."""
    with atomic_file(path) as stream:
        stream.write(plcopen_xml(scheduled))
    return [sized(scheduled, plc_program(scheduled), path)]
