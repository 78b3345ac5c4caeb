"""Structured text read by blark and turned into Python, independent of its writer."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

from lark import Token, Tree

from tests.commands.plc.parsed import parsed

UNITS_US = {"hours": 3_600_000_000, "minutes": 60_000_000, "seconds": 1_000_000}
UNITS_US |= {"milliseconds": 1000, "days": 86_400_000_000}
DEFAULTS = {"BOOL": False, "INT": 0, "DINT": 0, "TIME": 0, "STRING": ""}
PYTHON = {"AND": "and", "OR": "or", "=": "==", "<>": "!=", "NOT": "not ", "MOD": "%"}


class Table(list[Any]):
    """The values of an array from 0 on; an index below 0 is an error, as in a controller."""

    def __getitem__(self, index: Any) -> Any:
        assert index >= 0, index
        return super().__getitem__(index)


@dataclass
class Declared:
    name: str
    type: str
    section: str
    address: str = ""
    initial: Any = None

    @property
    def first(self) -> Any:
        """Its value before the first scan."""
        return DEFAULTS[self.type] if self.initial is None else self.initial


@dataclass
class Unit:
    """A program or function block: its declarations, and its statements as a tree."""

    kind: str
    name: str
    declared: dict[str, Declared] = field(default_factory=dict)
    twice: list[str] = field(default_factory=list)
    mixed_blocks: int = 0
    body: Tree[Any] | None = None

    def of(self, section: str) -> list[str]:
        return [n for n, d in self.declared.items() if d.section == section]

    @property
    def private(self) -> set[str]:
        """The plain variables that only this unit can write: for a program there are none."""
        if self.kind == "PROGRAM":
            return set()
        own = [self.declared[name] for name in self.of("VAR")]
        return {d.name for d in own if d.type in DEFAULTS and not d.address}


def name_of(node: Tree[Any]) -> str:
    return next(str(t).lower() for t in tokens(node) if t.type == "IDENTIFIER")


def tokens(node: Tree[Any]) -> list[Token]:
    return list(node.scan_values(lambda t: isinstance(t, Token)))


def read(text: str) -> dict[str, Unit]:
    """Return the units of ``text`` by lower-case name."""
    units: dict[str, Unit] = {}
    for child in parsed(text).children:
        unit = unit_of(child)
        units[unit.name] = unit
    return units


def unit_of(child: Tree[Any]) -> Unit:
    kind = {
        "function_block_type_declaration": "FUNCTION_BLOCK",
        "program_declaration": "PROGRAM",
    }[child.data]
    unit = Unit(kind, "")
    for part in child.children:
        if isinstance(part, Token) and part.type == "IDENTIFIER":
            unit.name = str(part).lower()
        elif isinstance(part, Tree) and part.data == "derived_function_block_name":
            unit.name = name_of(part)
        elif isinstance(part, Tree):
            read_part(part, unit)
    return unit


SECTIONS = {
    "input_declarations": "VAR_INPUT",
    "output_declarations": "VAR_OUTPUT",
    "var_declarations": "VAR",
    "located_var_declarations": "VAR",
}


def read_part(part: Tree[Any], unit: Unit) -> None:
    if part.data in SECTIONS:
        located = list(part.find_data("located_var_decl"))
        plain = list(part.find_data("var1_init_decl"))
        unit.mixed_blocks += bool(located and plain)
        for declaration in [*located, *plain]:
            add(declaration, SECTIONS[part.data], unit)
        nested = {id(d) for d in [*located, *plain]}
        others = [t for t in part.iter_subtrees() if t.data.endswith("_init_decl")]
        assert all(id(t) in nested for t in others), "a declaration of another kind"
    elif part.data in {"statement_list", "function_block_body"}:
        assert unit.body is None
        unit.body = part
    else:
        for child in part.children:
            if isinstance(child, Tree):
                read_part(child, unit)


def add(declaration: Tree[Any], section: str, unit: Unit) -> None:
    names = (
        [name_of(v) for v in declaration.find_data("var1")]
        if declaration.data == "var1_init_decl"
        else [name_of(declaration)]
    )
    spec = next(declaration.find_data("simple_specification"))
    type_name = "".join(tokens(spec)).upper()
    address = ""
    for variable in declaration.find_data("direct_variable"):
        prefix, size, *numbers = tokens(variable)
        address = f"%{prefix}{size}{'.'.join(n.lstrip('.') for n in numbers)}".upper()
    initials = list(declaration.find_data("expression"))
    initial = eval(expression(initials[0], set()), {}) if initials else None
    for name in names:
        if name in unit.declared:
            unit.twice.append(name)
        unit.declared[name] = Declared(name, type_name, section, address, initial)


def constant(node: Tree[Any]) -> str:
    inner = node.children[0]
    if inner.data == "true":
        return "True"
    if inner.data == "false":
        return "False"
    if inner.data == "string_literal":
        return repr(str(inner.children[0])[1:-1])
    if inner.data == "duration":
        total = 0
        for part in inner.children:
            if part is not None:
                total += int(part.children[0]) * UNITS_US[part.data]
        return str(total)
    assert inner.data == "integer_literal", inner.data
    return str(int(next(t for t in tokens(inner) if t.type == "INTEGER")))


def local(name: str) -> str:
    """Return the Python name of a variable, unlike any keyword or name of this module."""
    return f"{name}_"


def expression(node: Any, used: set[str]) -> str:
    """Return the Python of an expression; names are collected in ``used``, fields with a dot."""
    if isinstance(node, Token):
        return PYTHON.get(str(node).upper(), str(node))
    if node.data == "variable_name":
        used.add(name_of(node))
        return local(name_of(node))
    if node.data == "multi_element_variable":
        base, selector = node.children
        if selector.data == "subscript_list":
            (index,) = (c for c in selector.children if c is not None)
            used.add(name_of(base))
            return f"{local(name_of(base))}[{expression(index, used)}]"
        used.add(f"{name_of(base)}.{name_of(selector)}")
        return f"{local(name_of(base))}.v[{name_of(selector)!r}]"
    if node.data == "constant":
        return constant(node)
    parts = [expression(c, used) for c in node.children if c is not None]
    if node.data == "unary_expression" and len(parts) == 2:
        return f"({parts[0]}{parts[1]})"
    return parts[0] if len(parts) == 1 else f"({' '.join(parts)})"


def statements(node: Tree[Any], used: set[str], assigned: list[str], depth: int) -> Iterator[str]:
    """Yield the lines of Python of a list of statements."""
    pad = "  " * depth
    for child in node.children:
        if child is None:
            continue
        if child.data == "assignment_statement":
            target = child.children[0]
            assigned.append(name_of(target))
            used.add(name_of(target))
            yield f"{pad}{local(name_of(target))} = {expression(child.children[-1], used)}"
        elif child.data == "function_call_statement":
            yield pad + call(next(child.find_data("function_call")), used)
        elif child.data == "if_statement":
            yield from conditional(child, used, assigned, depth)
        elif child.data == "while_statement":
            head, body = (c for c in child.children if c is not None)
            yield f"{pad}while {expression(head, used)}:"
            yield from statements(body, used, assigned, depth + 1)
        else:
            assert child.data == "statement_list", f"a statement of another kind: {child.data}"
            yield from statements(child, used, assigned, depth)


def call(node: Tree[Any], used: set[str]) -> str:
    instance = name_of(node.children[0])
    used.add(instance)
    arguments = []
    for parameter in node.children[1:]:
        if parameter is None:
            continue
        assert parameter.data == "param_assignment", parameter.data
        pin = name_of(parameter.children[0])
        used.add(f"{instance}.{pin}")
        arguments.append(f"{pin!r}: {expression(parameter.children[-1], used)}")
    return f"{local(instance)}.call({{{', '.join(arguments)}}}, now)"


def conditional(node: Tree[Any], used: set[str], assigned: list[str], depth: int) -> Iterator[str]:
    pad = "  " * depth
    head, body, *rest = node.children
    yield f"{pad}if {expression(head, used)}:"
    yield from statements(body, used, assigned, depth + 1)
    for part in rest:
        if part is None:
            continue
        if part.data == "else_if_clause":
            yield f"{pad}elif {expression(part.children[0], used)}:"
            yield from statements(part.children[1], used, assigned, depth + 1)
        else:
            yield f"{pad}else:"
            yield from statements(part, used, assigned, depth + 1)


@dataclass
class Code:
    """A unit as Python, with the variables that it reads and writes."""

    run: Callable[[dict[str, Any], int], None]
    used: set[str]
    assigned: list[str]
    lines: list[str]


def code_of(unit: Unit) -> Code:
    """Return ``unit`` as a function: it takes its variables once, and returns the changed ones.

    Nobody else sees them meanwhile. A variable that is never written is a global of the function.
    """
    used: set[str] = set()
    assigned: list[str] = []
    assert unit.body is not None
    body = list(statements(unit.body, used, assigned, 1))
    written = dict.fromkeys(assigned)
    fixed = unit.private - written.keys()
    taken = sorted(name for name in used - fixed if "." not in name)
    lines = [
        "def run(v, now):",
        *(f"  {local(name)} = v[{name!r}]" for name in taken),
        *body,
        *(f"  v[{name!r}] = {local(name)}" for name in written),
    ]
    scope: dict[str, Any] = {local(name): unit.declared[name].first for name in fixed}
    exec("\n".join(lines), scope)
    return Code(scope["run"], used, assigned, lines)


IDENTIFIER = re.compile(r"[a-z](_?[a-z0-9])*")
