"""Write the tables of keys in ``docs/machine-file.md`` from the declarations of a machine's parts.

``python -m tools.machine_reference`` writes them; a test compares the page with what this writes.
The text of a key is the docstring below its field in ``threadline.machine``. The sentence that
begins with "Without it:" says what a machine file without the key means.
"""

from __future__ import annotations

import ast
import inspect
import re
import textwrap
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

from threadline.machine import (
    controllers,
    mandrel,
    model,
    motion_planner,
    parts,
    pneumatics,
    shaft,
    sources,
    spool,
    tables,
    tool,
)
from threadline.machine.numbers import field_node, plain_node

PAGE = Path(__file__).parents[1] / "docs" / "machine-file.md"
NOT_IN_THE_FILE = frozenset({"sha256", "file", "reference", "parameters", "mounted"})
"""Fields of ``Machine`` that no file has."""
_MODULES: tuple[ModuleType, ...] = (
    controllers, mandrel, model, motion_planner, parts, pneumatics, shaft, sources, spool, tables,
    tool,
)  # fmt: skip
_TABLE = re.compile(r"(<!-- keys of (.+?) -->\n).*?(?=<!-- end of keys -->)", re.DOTALL)
_WITHOUT = "Without it: "


def page(text: str) -> str:
    """Return the page with its tables made anew.

    A table stands between ``<!-- keys of PLACE, PLACE -->`` and ``<!-- end of keys -->``. A place
    is a dotted name such as ``drives.x.stepper``, with the kind of a part after its name, or
    ``machine`` for the top of the file.
    """
    return _TABLE.sub(lambda found: found[1] + _table(found[2].split(", ")), text)


def places(text: str) -> list[str]:
    """Return the places whose tables a page has."""
    return [place for found in _TABLE.finditer(text) for place in found[2].split(", ")]


def _table(of: list[str]) -> str:
    rows: dict[str, list[tuple[str, str, str]]] = {}
    for place in of:
        node = field_node(() if place == "machine" else tuple(place.split(".")))
        node = plain_node(node.get("items", node))  # a list of tables
        required = node.get("required", [])
        texts = _texts(node["title"])
        order = ["kind", *texts]
        order += [key for key in node["properties"] if key not in order]
        for key in filter(node["properties"].__contains__, order):
            value = node["properties"][key]
            if place == "machine" and key in NOT_IN_THE_FILE:
                continue
            text, _, without = texts.get(key, "").partition(_WITHOUT)
            without = without.rstrip(".") or _default(value)
            rows.setdefault(key, []).append(
                (text.strip(), _value(value), "refused" if key in required else without)
            )
    lines = ["| key | is | value | without it |\n", "|---|---|---|---|\n"]
    for key, found in rows.items():
        columns = [", ".join(_distinct(column)) for column in list(zip(*found, strict=True))[1:]]
        text = " ".join(_distinct(tuple(row[0] for row in found))).removesuffix(".")
        lines.append(f"| `{key}` | {text} | {' | '.join(columns)} |\n")
    return "".join(lines)


def _distinct(texts: tuple[str, ...]) -> list[str]:
    return [text for text in dict.fromkeys(texts) if text]


@cache
def _texts(name: str) -> dict[str, str]:
    """Return the docstring of each field of a part, those of the classes it extends included."""
    kind = next(getattr(m, name) for m in _MODULES if hasattr(m, name))
    return {
        key: text
        for base in reversed(kind.__mro__)
        if base.__module__.startswith("threadline.machine")
        for key, text in _own_texts(base)
    }


def _own_texts(kind: type) -> Iterator[tuple[str, str]]:
    (declared,) = ast.parse(textwrap.dedent(inspect.getsource(kind))).body
    assert isinstance(declared, ast.ClassDef)
    for field, below in zip(declared.body, declared.body[1:], strict=False):
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name):
            match below:
                case ast.Expr(value=ast.Constant(value=str(text))):
                    yield field.target.id, re.sub(r"\s+", " ", text).strip().replace("``", "`")


def _default(node: dict[str, Any]) -> str:
    match node.get("default"):
        case bool() as value:
            return "true" if value else "false"
        case str() as value if value:
            return f"`{value}`"
        case int() | float() as value:
            return f"{value:g}"
    return "none"


def _value(node: dict[str, Any]) -> str:
    """Return what may stand for a key: units, choices, or the kind of table or list."""
    node = plain_node(node)
    if units := node.get("x-units"):
        return ", ".join(unit or "plain number" for unit in units)
    if choices := node.get("enum", [node["const"]] if "const" in node else []):
        return ", ".join(f"`{choice}`" for choice in choices)
    inner = [*node.get("patternProperties", {}).values(), node.get("additionalProperties")]
    if below := next((one for one in inner if isinstance(one, dict)), None):
        return _of("table", _value(below))
    if node.get("type") == "array":
        pair = node.get("prefixItems")
        return _of("two" if pair else "list", _value(pair[0] if pair else node["items"]))
    words = {"boolean": "`true`, `false`", "string": "text", "number": "number"}
    return words.get(node.get("type", ""), "table")


def _of(holder: str, held: str) -> str:
    """Return the words for a table or list: a table of tables is a table."""
    plural = {"text": "texts", "table": "tables", "number": "numbers"}
    return f"{holder}: {held}" if held not in plural else f"{holder} of {plural[held]}"


if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    print(PAGE.relative_to(PAGE.parents[1]))
