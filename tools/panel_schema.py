"""Write the schema of the panel's protocol into the documentation, and the page's types from it."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from threadline.machine import load_machine
from threadline.panel.admission import Admission
from threadline.panel.calculation import Calculation, MachineGuide
from threadline.panel.owner_process import OwnerLink, start_owner
from threadline.panel.panel import Panel
from threadline.panel.server import make_api, schema_of
from threadline.panel.stored_runs import Owned

ROOT = Path(__file__).parents[1]
FILE = ROOT / "docs" / "panel-protocol.json"
TYPES = ROOT / "web" / "src" / "messages.ts"
_HEAD = """/** The messages of the panel, from its schema: python -m tools.panel_schema */

"""
_PLAIN = {"string": "string", "number": "number", "integer": "number", "boolean": "boolean"}


def types_of(schema: Mapping[str, Any]) -> str:
    """Return the messages that the page receives as TypeScript."""
    server = schema["from_panel"]
    models = {**server["$defs"], "Preview": schema["http"]["components"]["schemas"]["Preview"]}
    found = [_interface(name, models[name]) for name in sorted(models)]
    union = " | ".join(sorted(one["$ref"].split("/")[-1] for one in server["oneOf"]))
    return f"{_HEAD}{''.join(found)}export type FromPanel = {union};\n"


def _interface(name: str, model: Mapping[str, Any]) -> str:
    lines = []
    for prop, one in model["properties"].items():
        if "description" in one:
            lines.append(f"  /** {' '.join(one['description'].split())} */")
        lines.append(f"  {prop}: {_type(one)};")
    text = model.get("description", "").split("\n\n")[0]
    return (
        f"/** {' '.join(text.split())} */\nexport interface {name} {{\n"
        + "\n".join(lines)
        + "\n}\n"
    )


def _type(one: Mapping[str, Any]) -> str:
    if "$ref" in one:
        return str(one["$ref"].split("/")[-1])
    if "anyOf" in one:
        return " | ".join(_type(each) for each in one["anyOf"])
    if "const" in one or "enum" in one:
        return " | ".join(json.dumps(each) for each in one.get("enum", [one.get("const")]))
    if one.get("type") == "array":
        item = _type(one["items"])
        return f"({item})[]" if "|" in item else f"{item}[]"
    if one.get("type") == "object":
        return f"Record<string, {_type(one['additionalProperties'])}>"
    return _PLAIN.get(one.get("type", ""), "null")


def published() -> dict[Path, str]:
    """Return the files, with their contents."""
    machine, here = load_machine("lathe-winder"), Path()
    owner = OwnerLink(lambda: start_owner(Owned(machine, None, here, here, 1.0)))  # not called
    panel = Panel(machine, owner, Calculation(machine, None, here, here))
    schema = schema_of(
        make_api(panel, MachineGuide(machine, here), here, here, Admission("127.0.0.1", ""))
    )
    return {FILE: json.dumps(schema, indent=1) + "\n", TYPES: types_of(schema)}


if __name__ == "__main__":
    for file, content in published().items():
        file.write_text(content, encoding="utf-8")
