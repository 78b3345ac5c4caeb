"""The schema of a machine file, walked by its dotted keys, and the line of a key in a file."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import cache
from typing import Any

from pydantic import TypeAdapter

from threadline.machine.model import Machine

ADAPTER: TypeAdapter[Machine] = TypeAdapter(Machine)


@cache
def schema() -> dict[str, Any]:
    """Return the JSON schema of a machine file; it is cached, since making it takes long."""
    return ADAPTER.json_schema(mode="validation")


def field_node(location: tuple[str, ...]) -> dict[str, Any]:
    """Return the schema of the key at ``location``; empty where there is no such key.

    Parameters
    ----------
    location
        Location in pydantic's form, with the kind of a controller or sensor after its name.
    """
    node: Any = schema()
    for part in location:
        node = plain_node(node)
        kinds = node.get("discriminator", {}).get("mapping", {})
        if part in kinds:
            node = {"$ref": kinds[part]}
            continue
        entries = [node.get("additionalProperties"), *node.get("patternProperties", {}).values()]
        node = node.get("properties", {}).get(part) or next((e for e in entries if e), {})
    return plain_node(node)


def field_names(location: tuple[str, ...]) -> list[str]:
    """Return the keys allowed at ``location``, given as for ``field_node``."""
    return list(field_node(location).get("properties", {}))


def kinds_with(location: tuple[str, ...]) -> list[str]:
    """Return the kinds of a part that have the last key of ``location``, which its own kind lacks.

    There are none for a part without kinds.
    """
    among, key = location[:-2], location[-1]
    kinds = field_node(among).get("discriminator", {}).get("mapping", {})
    return [kind for kind in kinds if key in field_names((*among, kind))]


def plain_node(node: Any) -> dict[str, Any]:
    """Return a node of the schema with references resolved, and of an optional key the value."""
    definitions = schema().get("$defs", {})
    while isinstance(node, dict):
        if "$ref" in node:
            node = definitions[node["$ref"].rsplit("/", 1)[1]]
        elif "anyOf" in node:
            node = next((n for n in node["anyOf"] if n.get("type") != "null"), {})
        else:
            return node
    return {}


def in_file(location: tuple[str, ...]) -> tuple[str, ...]:
    """Return ``location`` as in the file, without the kind of a controller, drive or sensor."""
    tagged = len(location) > 2 and location[0] in {"controllers", "drives", "sensors"}
    return location[:2] + location[3:] if tagged else location


def line_of(text: str, location: tuple[str, ...], overlays: Sequence[str] = ()) -> int:
    """Return the line (from 1) of the deepest part of ``location`` that the text holds; 0 for none.

    Parameters
    ----------
    overlays
        Overlays of the file that were applied. The last one that holds at least as much of
        ``location`` as the file itself gives the line.
    """
    best, best_depth = _deepest(text, location)
    for overlay in overlays:
        line, depth = _deepest(text, ("overlays", overlay, *location))
        if depth > 2 and depth - 2 >= best_depth:
            best, best_depth = line, depth - 2
    return best


def _deepest(text: str, location: tuple[str, ...]) -> tuple[int, int]:
    """Return the line of the deepest part of ``location``, and how many of its keys lead there."""
    table: tuple[str, ...] = ()
    best, best_depth = 0, 0
    for number, line in enumerate(text.splitlines(), start=1):
        header = re.match(r"\s*\[\[?([^\]]+)\]\]?", line)
        key = re.match(r'\s*("?[A-Za-z0-9_.-]+"?)\s*=', line)
        if header:
            table = tuple(part.strip(' "') for part in header[1].split("."))
            path = table
        elif key:
            path = table + tuple(part.strip(' "') for part in key[1].split("."))
        else:
            continue
        depth = len(path) if path == location[: len(path)] else 0
        if header and depth == 0 and location == table[: len(location)]:
            depth = len(location)  # a header such as [a.b.c] opens the tables a and a.b, too
        if depth > best_depth:
            best, best_depth = number, depth
    return best, best_depth
