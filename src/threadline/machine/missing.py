"""Keys that a machine file lacks, all of them at once, each with an example of its value."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from threadline.machine.schema import field_node, in_file, plain_node

MISSING = {"missing", "missing_argument", "union_tag_not_found"}
"""Pydantic's types of error for a missing key."""
_SAMPLES = {
    "": "1",
    "s": "5 ms",
    "m": "100 mm",
    "tick": "1e8 tick",
    "bit": "12 bit",
    "count/rad": "4000 count/rev",
    "count/m": "100 count/mm",
    "count/tick": "10 count/tick",
}
_AXES = ("axes",)
_BODIES = ("bodies",)


@dataclass(frozen=True, slots=True)
class MissingKey:
    """A required key that a file lacks.

    Parameters
    ----------
    location
        Parts of its dotted name.
    form
        Example of the line that would add it.
    """

    location: tuple[str, ...]
    form: str

    @property
    def said(self) -> str:
        """Dotted name of the key, in quotes."""
        return repr(".".join(self.location))

    def said_at(self, line: int) -> str:
        """Return the name with its example, and with the line of its table (0 for none)."""
        return f"{self.said} ({f'line {line}, ' if line else ''}like {self.form})"


def missing_keys(
    errors: Sequence[Mapping[str, Any]], content: Mapping[str, Any]
) -> list[MissingKey]:
    """Return the missing keys, in the order of the fields of ``Machine``.

    Parameters
    ----------
    errors
        Errors of pydantic about ``content``.
    content
        The machine file, overlays merged into it.
    """
    found = []
    for error in errors:
        if error["type"] not in MISSING:
            continue
        tagged = tuple(str(part) for part in error["loc"] if part != "[key]")
        node = field_node(tagged)
        if error["type"] == "union_tag_not_found":
            kinds = node.get("discriminator", {}).get("mapping", {})
            forms = " or ".join(f'"{kind}"' for kind in kinds)
            found.append(MissingKey((*in_file(tagged), "kind"), f"kind = {forms}"))
            continue
        location = in_file(tagged)
        form = sample(node, _kind(content, location))
        found.append(MissingKey(location, _assigned(location, node, form)))
    if found and not {"axes", "cylinders"} & set(content):
        # Rules that need several keys are checked only when all others are right: too late here.
        node = field_node(_AXES)
        found.append(MissingKey(_AXES, _assigned(_AXES, node, sample(node, "linear"))))
    if found and "bodies" not in content and not _limits_alone(content):
        node = field_node(_BODIES)
        found.append(MissingKey(_BODIES, _assigned(_BODIES, node, sample(node))))
    turns = any(
        _kind(content, (*_AXES, name, "kind")) == "rotary"
        and not {"radius", "profile"} & set(content["axes"][name])
        for name in _axes_of(content)
    )
    if found and turns and "tool" not in content:
        node = field_node(("tool",))
        found.append(MissingKey(("tool",), _assigned(("tool",), node, sample(node))))
    order = list(field_node(())["properties"])
    return sorted(found, key=lambda key: order.index(key.location[0]))


def sample(node: Mapping[str, Any], kind: str = "") -> str:
    """Return an example of a key's value in TOML.

    Parameters
    ----------
    node
        Node of the key in the schema of machine files.
    kind
        Kind or mode of its part (``rotary``, ``current``), which may decide the unit.
    """
    node = plain_node(node)
    if "x-units" in node:
        unit = _unit(node["x-units"], kind)
        return f'"{_SAMPLES.get(unit, f"1 {unit}")} exact, assumed"'
    for kept in ("const", "enum"):
        if kept in node:
            value = node[kept] if kept == "const" else node[kept][0]
            return f'"{value}"'
    if "oneOf" in node:
        return sample(node["oneOf"][0], kind)
    if node.get("type") == "array":
        return f"[{', '.join(_entries(node, kind))}]"
    if node.get("type") == "object":
        return f"{{ {', '.join(_rows(node, kind))} }}"
    return {"boolean": "true", "number": "1.0", "integer": "1"}.get(str(node.get("type")), '"text"')


def _entries(node: Mapping[str, Any], kind: str) -> Iterator[str]:
    for entry in node.get("prefixItems", [node.get("items", {})]):
        yield sample(entry, kind)


def _rows(node: Mapping[str, Any], kind: str) -> Iterator[str]:
    properties = node.get("properties")
    if properties is None:
        patterns = node.get("patternProperties", {})
        pattern, entry = next(iter(patterns.items()), ("", node.get("additionalProperties")))
        if isinstance(entry, Mapping):
            yield f"{'X' if pattern == '^[A-Z]$' else 'name'} = {sample(entry, kind)}"
        return
    for key in node.get("required", []):
        form = sample(properties[key], kind)
        if key in {"kind", "mode"}:
            kind = form.strip('"')
        yield f"{key} = {form}"


def _assigned(location: tuple[str, ...], node: Mapping[str, Any], form: str) -> str:
    """Return the line that adds a key; for a table of tables, its header and its keys."""
    if len(location) == 1 and node.get("type") == "object":
        pattern, entry = next(iter(node.get("patternProperties", {}).items()), ("", {}))
        required = plain_node(entry).get("required")
        if required:
            name = "X" if pattern == "^[A-Z]$" else "name"
            return f"[{location[0]}.{name}] with {', '.join(required)}"
        return f"[{location[0]}] {form[1:-1].strip()}"
    return f"{location[-1]} = {form}"


def _unit(units: Sequence[str], kind: str) -> str:
    """Return the unit that suits the kind of a part, or the first one for any kind."""
    turning = [unit for unit in units if "rad" in unit or "N*m" in unit or "kg*m" in unit]
    if kind == "rotary" and turning:
        return turning[0]
    if kind == "linear":
        return next((unit for unit in units if unit not in turning), units[0])
    return "A/V" if kind == "current" and "A/V" in units else units[0]


def _limits_alone(content: Mapping[str, Any]) -> bool:
    drives = content.get("drives")
    parts = drives.values() if isinstance(drives, Mapping) else ()
    return any(isinstance(part, Mapping) and part.get("kind") == "kinematic" for part in parts)


def _axes_of(content: Mapping[str, Any]) -> list[str]:
    axes = content.get("axes")
    return list(axes) if isinstance(axes, Mapping) else []


def _kind(content: Mapping[str, Any], location: tuple[str, ...]) -> str:
    """Return the kind or mode of the part that a key belongs to, as far as the file says."""
    part: Any = content
    for key in location[:-1]:
        part = part.get(key, {}) if isinstance(part, Mapping) else {}
    if not isinstance(part, Mapping):
        return ""
    return str(part.get("kind") or part.get("mode") or "")
