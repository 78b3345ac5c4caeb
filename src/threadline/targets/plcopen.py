"""PLCopen XML (TC6, version 2.01) of a schedule: the same units as its structured text."""

from __future__ import annotations

import xml.etree.ElementTree as ET  # written only, never parsed
from pathlib import Path

from threadline import __version__
from threadline.escaping import plain
from threadline.signals.files.common import Written, atomic_file, written
from threadline.targets.plc_pou import Block, PlcProgram, Pou, Variable
from threadline.targets.schedule import Scheduled
from threadline.targets.structured_text import plc_program

NAMESPACE = "http://www.plcopen.org/xml/tc6_0201"
XHTML = "http://www.w3.org/1999/xhtml"
EPOCH = "2000-01-01T00:00:00"
"""Creation time that is written unless another is given: the same job gives the same file."""
_LISTS = {
    "VAR_INPUT": "inputVars",
    "VAR_OUTPUT": "outputVars",
    "VAR": "localVars",
    "VAR CONSTANT": "localVars",
}
_KINDS = {"FUNCTION_BLOCK": "functionBlock", "PROGRAM": "program"}


def plcopen_xml(scheduled: Scheduled, created: str = EPOCH) -> bytes:
    """Return the project of ``scheduled`` as XML.

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
        _variables(interface, block)
    body = ET.SubElement(ET.SubElement(element, "body"), "ST")
    ET.SubElement(body, "xhtml:p").text = "\n".join(pou.body) + "\n"
    documentation = ET.SubElement(element, "documentation")
    ET.SubElement(documentation, "xhtml:p").text = plain(" ".join(pou.notes))


def _variables(parent: ET.Element, block: Block) -> None:
    constant = {"constant": "true"} if block.kind == "VAR CONSTANT" else {}
    element = ET.SubElement(parent, _LISTS[block.kind], constant)
    for variable in block.variables:
        _variable(element, variable)


def _variable(parent: ET.Element, variable: Variable) -> None:
    at = {"address": variable.address} if variable.address else {}
    element = ET.SubElement(parent, "variable", {"name": variable.name, **at})
    kind = ET.SubElement(element, "type")
    if variable.derived:
        ET.SubElement(kind, "derived", {"name": variable.type})
    else:
        # The schema has the string types in lower case, as elements of their own.
        ET.SubElement(kind, "string" if variable.type == "STRING" else variable.type)
    if variable.initial:
        initial = ET.SubElement(element, "initialValue")
        ET.SubElement(initial, "simpleValue", {"value": variable.initial})
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
    """Write the project to ``path``."""
    with atomic_file(path) as stream:
        stream.write(plcopen_xml(scheduled))
    return [written(path, scheduled.warnings)]
