"""Read and replace numbers of a machine by their dotted names, and find them in its file."""

from __future__ import annotations

import dataclasses
import hashlib
import re
from collections.abc import Mapping, Sequence
from fractions import Fraction
from functools import cache
from typing import Any, get_args, get_type_hints

from pydantic import TypeAdapter

from threadline.base.wording import toml_string
from threadline.errors import OptionError
from threadline.machine.model import Machine
from threadline.machine.quantity import Quantity, Units

ADAPTER: TypeAdapter[Machine] = TypeAdapter(Machine)


@cache
def schema() -> dict[str, Any]:
    """Return the JSON schema of a machine file, cached because it is slow to make."""
    return ADAPTER.json_schema(mode="validation")


def field_node(location: tuple[str, ...]) -> dict[str, Any]:
    """Return the schema of the key at ``location``; empty if there is no such key.

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
    """Return the kinds of a part that have the last key of ``location``.

    The present kind of the part lacks this key. The result is empty for a part without kinds.
    """
    part_location, key = location[:-2], location[-1]
    kinds = field_node(part_location).get("discriminator", {}).get("mapping", {})
    return [kind for kind in kinds if key in field_names((*part_location, kind))]


def plain_node(node: Any) -> dict[str, Any]:
    """Return a schema node with references resolved; for an optional key, its non-null variant."""
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
    """Return ``location`` as in the file: without the kind of a controller, drive or sensor."""
    tagged = len(location) > 2 and location[0] in {"controllers", "drives", "sensors"}
    return location[:2] + location[3:] if tagged else location


def line_of(text: str, location: tuple[str, ...], overlays: Sequence[str] = ()) -> int:
    """Return the line (from 1) of the deepest part of ``location`` in the text; 0 for none.

    Parameters
    ----------
    overlays
        Applied overlays of the file. The line comes from the last overlay that contains at least as
        many keys of ``location`` as the file itself; else from the file itself.
    """
    best_line, best_depth = _deepest(text, location)
    for overlay in overlays:
        line, depth = _deepest(text, ("overlays", overlay, *location))
        if depth > 2 and depth - 2 >= best_depth:
            best_line, best_depth = line, depth - 2
    return best_line


def _deepest(text: str, location: tuple[str, ...]) -> tuple[int, int]:
    """Return the line of the deepest part of ``location``, and its depth in keys."""
    table: tuple[str, ...] = ()
    best_line, best_depth = 0, 0
    for number, line in enumerate(text.splitlines(), start=1):
        # A row of an array, [1.0, 2.0], is not a header.
        header = re.match(r"\s*\[\[?([A-Za-z][^\],]*)\]\]?\s*(?:#.*)?$", line)
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
            depth = len(location)  # a header [a.b.c] also opens the tables a and a.b
        if depth > best_depth:
            best_line, best_depth = number, depth
    return best_line, best_depth


_PER_SECOND = 10**9


def number_at(machine: Machine, path: str) -> Quantity:
    """Return the number of ``machine`` called ``path``, such as ``"links.x_belt.stiffness"``.

    Raises
    ------
    OptionError
        If the machine has no such number.
    """
    node: Any = machine
    for key in path.split("."):
        node = node.get(key) if isinstance(node, Mapping) else getattr(node, key, None)
    if not isinstance(node, Quantity):
        raise OptionError(
            f"machine {machine.name!r} has no number {path!r}", remedy="Name a number in its file."
        )
    return node


def number_tables(texts: Mapping[str, str]) -> list[str]:
    r"""Return lines of a machine file that set numbers, with a blank line before each table.

    Parameters
    ----------
    texts
        Path of each number, as in ``number_at``, to its text with unit and tolerance.

    Examples
    --------
    >>> print(*number_tables({"bodies.x.inertia": "2 kg exact, assumed"}), sep="\n")
    <BLANKLINE>
    [bodies.x]
    inertia = "2 kg exact, assumed"
    """
    tables: dict[str, list[str]] = {}
    for path, text in texts.items():
        table, _, key = path.rpartition(".")
        tables.setdefault(table, []).append(f"{key} = {toml_string(text)}")
    return [line for table, rows in sorted(tables.items()) for line in ("", f"[{table}]", *rows)]


def is_whole(machine: Machine, path: str) -> bool:
    """Return whether a number must be whole, such as the bits of a converter."""
    node: Any = machine
    *parents, last = path.split(".")
    for key in parents:
        node = node.get(key) if isinstance(node, Mapping) else getattr(node, key, None)
    if isinstance(node, Mapping) or node is None:
        return False
    kind: Any = type(node)  # Any: mypy would say that a type is not hashable
    return last in _whole_numbers(kind)


@cache
def _whole_numbers(kind: Any) -> frozenset[str]:
    """Return the keys of a part that are whole numbers."""
    hints = get_type_hints(kind, include_extras=True)  # takes some ms, hence the cache
    return frozenset(
        key
        for key, hint in hints.items()
        if any(isinstance(mark, Units) and mark.whole for mark in get_args(hint))
    )


def with_numbers(machine: Machine, numbers: Mapping[str, float]) -> Machine:
    """Return ``machine`` with new numbers (SI, by dotted names) and a new hash.

    Relative tolerances are kept. A time becomes an exact fraction of a second that differs from the
    given number by less than 1e-18 s.

    Raises
    ------
    OptionError
        If the machine has no such number.
    """
    new_values: dict[str, Any] = {}
    for path, value in numbers.items():
        old_quantity = number_at(machine, path)
        factor = 1.0 if old_quantity.si == 0.0 else abs(value / old_quantity.si)
        exact_s = None if old_quantity.exact_s is None else exact_time_s(value)
        *parents, last = path.split(".")
        table = new_values
        for key in parents:
            table = table.setdefault(key, {})
        table[last] = dataclasses.replace(
            old_quantity,
            si=float(value),
            tolerance_si=old_quantity.tolerance_si * factor,
            exact_s=exact_s,
        )
    note = repr(sorted((path, float(value)) for path, value in numbers.items()))
    new_values["sha256"] = hashlib.sha256((machine.sha256 + note).encode()).hexdigest()
    # Replace all numbers at once: a check of two related numbers may refuse one new number alone.
    new_machine: Machine = _replaced(machine, new_values)
    return new_machine


def exact_time_s(seconds: float) -> Fraction:
    """Return a time in s as a fraction with a denominator of at most 1e9."""
    return Fraction(float(seconds)).limit_denominator(_PER_SECOND)


def _replaced(node: Any, new_values: Mapping[str, Any]) -> Any:
    is_mapping = isinstance(node, Mapping)
    replaced = {}
    for key, value in new_values.items():
        part = node[key] if is_mapping else getattr(node, key)
        replaced[key] = _replaced(part, value) if isinstance(value, Mapping) else value
    return {**node, **replaced} if is_mapping else dataclasses.replace(node, **replaced)
