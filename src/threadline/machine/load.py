"""Load machine files: bases, overlays, checks, and errors that name file, line and remedy."""

from __future__ import annotations

import copy
import difflib
import hashlib
import json
import os
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from itertools import chain
from pathlib import Path
from typing import Any, NoReturn

from pydantic import ValidationError

from threadline.base.reading import note_input, read_text
from threadline.base.wording import field_fault, nearest, toml_fault
from threadline.errors import MachineError, Place
from threadline.machine.model import Machine
from threadline.machine.numbers import (
    ADAPTER,
    field_names,
    field_node,
    in_file,
    kinds_with,
    line_of,
    plain_node,
)
from threadline.machine.parts import switches_in_the_way
from threadline.machine.pneumatics import switch_faults
from threadline.machine.tool import EYE_BODY, EYE_PARTS

MISSING = {"missing", "missing_argument", "union_tag_not_found"}
"""Pydantic's error types for a missing key."""
_SAMPLES = {
    "": "1", "s": "5 ms", "m": "100 mm", "tick": "1e8 tick", "bit": "12 bit",
    "count/rad": "4000 count/rev", "count/m": "100 count/mm", "count/tick": "10 count/tick",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class MissingKey:
    """A required key that a file lacks.

    Parameters
    ----------
    location
        Parts of its dotted name.
    form
        Example of a line that adds it.
    """

    location: tuple[str, ...]
    form: str

    @property
    def quoted_name(self) -> str:
        """Dotted name of the key, in quotes."""
        return repr(".".join(self.location))

    def name_at(self, line: int) -> str:
        """Return the name with its example, and with the line of its table (0 for none)."""
        return f"{self.quoted_name} ({f'line {line}, ' if line else ''}like {self.form})"


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
    keys = []
    for error in errors:
        if error["type"] not in MISSING:
            continue
        tagged = tuple(str(part) for part in error["loc"] if part != "[key]")
        node = field_node(tagged)
        if error["type"] == "union_tag_not_found":
            kinds = node.get("discriminator", {}).get("mapping", {})
            forms = " or ".join(f'"{kind}"' for kind in kinds)
            keys.append(MissingKey((*in_file(tagged), "kind"), f"kind = {forms}"))
            continue
        location = in_file(tagged)
        form = sample(node, _kind(content, location))
        keys.append(MissingKey(location, _assigned(location, node, form)))
    # Pydantic checks rules that concern several keys only after all keys are valid: too late here.
    for table in _missing_tables(content) if keys else ():
        node = field_node((table,))
        form = sample(node, "linear" if table == "axes" else "")
        keys.append(MissingKey((table,), _assigned((table,), node, form)))
    order = list(field_node(())["properties"])
    return sorted(keys, key=lambda key: order.index(key.location[0]))


def _missing_tables(content: Mapping[str, Any]) -> Iterator[str]:
    """Yield the tables that a machine needs because of its other tables."""
    if not {"axes", "cylinders"} & set(content):
        yield "axes"
    drives = content.get("drives")
    names = drives if isinstance(drives, Mapping) else ()
    only_limits = any(_kind(content, ("drives", name, "kind")) == "kinematic" for name in names)
    if "bodies" not in content and not only_limits:
        yield "bodies"
    axes = content.get("axes")
    turns = isinstance(axes, Mapping) and any(
        _kind(content, ("axes", name, "kind")) == "rotary" and not {"radius", "profile"} & set(axis)
        for name, axis in axes.items()
    )
    if turns and "tool" not in content:
        yield "tool"


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
    for choice in ("const", "enum"):
        if choice in node:
            value = node[choice] if choice == "const" else node[choice][0]
            return f'"{value}"'
    if "oneOf" in node:
        return sample(node["oneOf"][0], kind)
    if node.get("type") == "array":
        entries = node.get("prefixItems", [node.get("items", {})])
        return f"[{', '.join(sample(entry, kind) for entry in entries)}]"
    if node.get("type") == "object":
        return f"{{ {', '.join(_sample_rows(node, kind))} }}"
    return {"boolean": "true", "number": "1.0", "integer": "1"}.get(str(node.get("type")), '"text"')


def _sample_rows(node: Mapping[str, Any], kind: str) -> Iterator[str]:
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
    """Return the unit that belongs to the kind of a part, else the first unit."""
    turning = [unit for unit in units if "rad" in unit or "N*m" in unit or "kg*m" in unit]
    if kind == "rotary" and turning:
        return turning[0]
    if kind == "linear":
        return next((unit for unit in units if unit not in turning), units[0])
    return "A/V" if kind == "current" and "A/V" in units else units[0]


def _kind(content: Mapping[str, Any], location: tuple[str, ...]) -> str:
    """Return the kind or mode of the part that a key belongs to; empty if the file lacks it."""
    part: Any = content
    for key in location[:-1]:
        part = part.get(key, {}) if isinstance(part, Mapping) else {}
    if not isinstance(part, Mapping):
        return ""
    return str(part.get("kind") or part.get("mode") or "")


_MAX_BYTES = 1_000_000
_REFERENCE = re.compile(r"([A-Za-z_]+(?:\.[A-Za-z0-9_-]+)*)(?: names the \w+ '([^']*)'|: )")
_DESIGN_KEY = re.compile(r"([A-Za-z_]+(?:\.[A-Za-z0-9_-]+)*): ")
_COMPUTED = ("sha256", "file", "reference", "parameters", "mounted")
"""Fields of ``Machine`` that are not keys of a file."""


def library_names() -> tuple[str, ...]:
    """Return the names of the machines in Threadline's library."""
    folder = resources.files("threadline.machine") / "library"
    names = (entry.name for entry in folder.iterdir())
    return tuple(
        sorted(n[: -len(".toml")] for n in names if n.endswith(".toml") and ".spec." not in n)
    )


def library_file(name: str) -> Path:
    """Return the path of a library machine's file.

    Raises
    ------
    MachineError
        If the library has no such machine.
    """
    _check_name(name)
    return Path(str(resources.files("threadline.machine") / "library" / f"{name}.toml"))


def overlay_names(reference: str | Path) -> tuple[str, ...]:
    """Return the overlays with which a machine can be loaded.

    A machine inherits the overlays of its base; some of them may need parts that it does not have.

    Raises
    ------
    MachineError
        If there is no such machine, or its file cannot be read.
    """
    name, _ = split_reference(str(reference))
    available = _resolve(name, ())[0].get("overlays", {})
    loadable = []
    for overlay in available if isinstance(available, dict) else ():
        try:
            load_machine(f"{name}+{overlay}")
        except MachineError:
            continue
        loadable.append(overlay)
    return tuple(loadable)


def load_machine(reference: str | Path) -> Machine:
    """Read a machine file, or a machine of the library, with overlays.

    Parameters
    ----------
    reference
        ``"lathe-winder"``, ``"machines/mine.toml"``, each with overlays of that file after a
        plus sign: ``"lathe-winder+physical+current"``.

    Raises
    ------
    MachineError
        If there is no such machine, or the file does not describe one.
    """
    name, overlays = split_reference(str(reference))
    try:
        content, text, file = _resolve(name, ())
        content = _overlaid(content, overlays, name, file)
        content.pop("overlays", None)
        if overlays:
            content["name"] = "+".join([str(content.get("name", name)), *overlays])
        canonical = json.dumps(content, sort_keys=True, default=str).encode()
    except RecursionError as error:
        raise MachineError(
            "the file is nested too deeply", place=Place(name), remedy="Use fewer levels."
        ) from error
    content["sha256"] = hashlib.sha256(canonical).hexdigest()
    content["file"] = file
    content["reference"] = str(reference)
    written = _Text(text, file, overlays)
    try:
        machine = ADAPTER.validate_python(content)
    except ValidationError as error:
        _refuse(error, content, written)
    faults = (
        switch_faults(machine.cylinders, machine.contacts),
        switches_in_the_way(machine.axes, machine.inputs),
    )
    for key, fault, remedy in chain.from_iterable(faults):
        raise MachineError(f"{key}: {fault}", place=written.place(*key.split(".")), remedy=remedy)
    return machine


def split_reference(reference: str) -> tuple[str, list[str]]:
    """Return the machine and the overlays of a reference; paths may contain plus signs."""
    end = reference.rfind(".toml") + len(".toml")
    if end < len(".toml") or reference[end : end + 1] not in {"", "+"}:
        end = 0
    head, *overlays = reference[end:].split("+")
    return reference[:end] + head, overlays


def _overlaid(content: dict[str, Any], overlays: list[str], name: str, file: str) -> dict[str, Any]:
    """Return ``content`` with the given overlays merged into it in order."""
    available = content.get("overlays", {})
    if not isinstance(available, dict) or not all(isinstance(o, dict) for o in available.values()):
        raise MachineError(
            "overlays must be tables",
            place=Place(file),
            remedy="Write them like [overlays.heavy.bodies.x].",
        )
    for overlay in overlays:
        if overlay not in available:
            close = difflib.get_close_matches(overlay, available, n=1)
            hint = f"Did you mean {close[0]!r}? " if close else ""
            raise MachineError(
                f"machine {name!r} has no overlay {overlay!r}",
                place=Place(file),
                remedy=f"{hint}It has: {', '.join(available) or 'none'}.",
            )
        content = _merge(content, available[overlay])
    return content


def _resolve(name: str, names_below: tuple[str, ...]) -> tuple[dict[str, Any], str, str]:
    if name in names_below:
        file_above, path_above = _read(names_below[-1])
        raise MachineError(
            "machine files are based on each other in a circle: "
            f"{' -> '.join([*names_below, name])}",
            place=Place(path_above, line_of(file_above, ("base",))),
            remedy="Remove one base.",
        )
    text, file = _read(name)
    try:
        content = copy.deepcopy(_parsed(text))
    except tomllib.TOMLDecodeError as error:
        fault, line = toml_fault(error, text)
        raise MachineError(fault, place=Place(file, line), remedy="Correct that line.") from error
    for key in _COMPUTED:
        if key in content:
            raise MachineError(
                f"unknown key {key!r}",
                place=Place(file, line_of(text, (key,))),
                remedy="Remove it: Threadline computes it.",
            )
    base = content.pop("base", None)
    if base is None:
        return content, text, file
    if not isinstance(base, str):
        raise MachineError(
            f"base must be the name of a machine, got {base!r}",
            place=Place(file, line_of(text, ("base",))),
            remedy='Write it like base = "lathe-winder".',
        )
    base_name, base_overlays = split_reference(base)
    if base_name.endswith(".toml"):
        base_name = os.path.normpath(Path(file).parent / base_name)
    base_content, _, base_file = _resolve(base_name, (*names_below, name))
    base_content = _overlaid(base_content, base_overlays, base_name, base_file)
    # The operator's settings of a base are not inherited.
    base_content.pop("operator", None)
    return _merge(_without_lost_eye(base_content, content), content), text, file


@lru_cache(maxsize=16)
def _parsed(text: str) -> dict[str, Any]:
    """Return a parsed TOML text; do not modify it, because it is cached.

    Searches read a base many times.
    """
    return tomllib.loads(text)


def _read(name: str) -> tuple[str, str]:
    if name.endswith(".toml"):
        path = Path(name)
        for specification in (path.with_suffix(".spec.toml"), path.with_name("spec.toml")):
            note_input(specification)  # the specification beside the file belongs to the machine
        return read_text(path, _MAX_BYTES, MachineError, "machine file"), name
    _check_name(name)
    entry = resources.files("threadline.machine") / "library" / f"{name}.toml"
    note_input(Path(str(entry)))
    return entry.read_text(encoding="utf-8"), f"{name}.toml"


def _check_name(name: str) -> None:
    known = library_names()
    if name not in known:
        hint = nearest(name, known, "The library has")
        file_hint = "A file ends in .toml; threadline new makes one from a controller's settings."
        raise MachineError(f"no machine {name[:80]!r} in the library", remedy=f"{hint} {file_hint}")


def _merge(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    """Return ``below`` with the values of ``above``; tables merge, and ``"none"`` removes a key."""
    merged = copy.deepcopy(below)
    for key, value in above.items():
        if value == "none":
            merged.pop(key, None)
        elif isinstance(value, dict) and isinstance(merged.get(key), dict):
            merged[key] = _merge(merged[key], value)
        else:
            merged[key] = copy.deepcopy(value)
    return merged


def _without_lost_eye(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    """Return ``below``; its eye becomes a plain radius if ``above`` removes an axis of the eye."""
    tool, axes = below.get("tool"), above.get("axes")
    if not isinstance(tool, dict) or not isinstance(axes, dict) or "tool" in above:
        return below
    eye_axes = {part.get("axis") for part in map(tool.get, EYE_PARTS) if isinstance(part, dict)}
    if not any(value == "none" and name in eye_axes for name, value in axes.items()):
        return below
    eye_keys = (*EYE_PARTS, *EYE_BODY, "kind")
    plain_tool = {key: value for key, value in tool.items() if key not in eye_keys}
    return below | {"tool": plain_tool}


def place_in(machine: Machine, key: str) -> Place | None:
    """Return the file and line of ``key``, such as ``"design.settings.crossover"``.

    The line is 0 if a base file holds the key. The result is None for a machine without a file.
    """
    if not machine.file:
        return None
    try:
        name, overlays = split_reference(machine.reference)
        text, _ = _read(name)
    except MachineError:  # removed since loading
        return Place(machine.file)
    return _Text(text, machine.file, overlays).place(*key.split("."))


@dataclass(frozen=True, slots=True)
class _Text:
    """The text of a machine file with its active overlays."""

    text: str
    file: str
    overlays: Sequence[str]

    def line(self, *location: str) -> int:
        return line_of(self.text, location, self.overlays)

    def place(self, *location: str) -> Place:
        return Place(self.file, self.line(*location))


def _refuse(error: ValidationError, content: dict[str, Any], text: _Text) -> NoReturn:
    errors = error.errors(include_url=False)
    # A misspelt key also causes a "missing" error; the error about the unknown key is more useful.
    unknown = {"unexpected_keyword_argument", "extra_forbidden"}
    first = next((e for e in errors if e["type"] in unknown), errors[0])
    # Pydantic adds the tag of a union and "[key]" to the location; the file has neither of them.
    tagged = tuple(str(part) for part in first["loc"] if part != "[key]")
    location = in_file(tagged)
    dotted_key = ".".join(location)
    place = text.place(*location)
    if first["type"] in unknown:
        hint = nearest(
            location[-1],
            [key for key in field_names(tagged[:-1]) if len(location) > 1 or key not in _COMPUTED],
        )
        others = kinds_with(tagged)
        if others:
            hint = f"Kind {' or '.join(map(repr, others))} has it: change kind, or remove the key."
        raise MachineError(f"unknown key {dotted_key!r}", place=place, remedy=hint) from error
    missing = missing_keys(errors, content)
    if missing and first["type"] in MISSING:
        message_text = ", ".join(key.name_at(text.line(*key.location)) for key in missing)
        is_single = len(missing) == 1
        raise MachineError(
            f"{missing[0].quoted_name} is missing"
            if is_single
            else f"{len(missing)} keys are missing: {message_text}",
            place=text.place(*missing[0].location) if is_single else Place(text.file),
            remedy=f"Add it, like {missing[0].form}" if is_single else "Add them.",
        ) from error
    message, remedy = field_fault(first)
    key_match = _REFERENCE.match(message)
    if not location and key_match:
        # Checks of references run on the whole machine; their messages begin with the key.
        place = text.place(*key_match[1].split("."), *([key_match[2]] if key_match[2] else []))
    message_text = f"{dotted_key}: {message}" if dotted_key else message
    key_match = _DESIGN_KEY.match(message)
    is_whole_table = location[:1] in {("design",), ("controllers",)}
    if is_whole_table and first["type"] == "value_error" and key_match:
        # Messages of checks of a whole table begin with the key in that table.
        place = text.place(*location, *key_match[1].split("."))
        message_text = f"{dotted_key}.{message}"
    if first["type"] == "too_long" and isinstance(first["input"], dict):
        extra = list(first["input"])[first["ctx"]["max_length"]]
        place = text.place(*location, extra)
    if missing:
        remedy = f"{remedy} Also missing: {', '.join(key.quoted_name for key in missing)}.".strip()
    raise MachineError(message_text, place=place, remedy=remedy) from error
