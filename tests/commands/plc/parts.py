"""Structured text read by blark in parts: each shape of statement once, with any numbers.

blark takes ten seconds for a whole sequence. If two statements differ only in names, texts, whole
numbers and durations, their trees differ only there. So each shape is parsed once, and the values
are put in. ``test_text`` compares this reading with blark's own of a whole text.
"""

from __future__ import annotations

import copy
import itertools
import re
from functools import cache
from typing import Any

from lark import Token, Tree

from tests.commands.plc.parsed import parsed
from tests.commands.plc.reading import Declared, Table, Unit, unit_of

COMMENT = re.compile(r"\(\*.*?\*\)", re.DOTALL)
UNIT = re.compile(r"\b(FUNCTION_BLOCK|PROGRAM)\b(.*?)\bEND_\1\b", re.DOTALL)
ARRAY = re.compile(r"ARRAY \[0\.\.(\d+)\] OF (\w+) := \[(.*)\]", re.DOTALL)
TEXT = re.compile(r"'[^']*'")
NUMBER = re.compile(r"(?<![\w.%])(T#)?(\d+)(?=(?:ms|s|m|h|d)?(?![\w.]))")
FIRST = 900_001
"""Stands for the first number of a shape; the others follow. No text has such a number."""


def read_in_parts(text: str) -> dict[str, Unit]:
    """Return the units of ``text`` by lower-case name, like ``reading.read``."""
    assert not any("(*" in literal for literal in TEXT.findall(COMMENT.sub(" ", text)))
    units = {}
    for kind, inside in UNIT.findall(COMMENT.sub(" ", text)):
        head, end, body = inside.rpartition("END_VAR")
        unit = _declared(kind, f"{head}{end}")
        assert unit.body is None
        children = [child for part in statements_of(body) for child in _tree(part).children]
        unit.body = Tree("statement_list", children)
        units[unit.name] = unit
    return units


def _declared(kind: str, head: str) -> Unit:
    """Return the unit that a head declares, one declaration read after the other."""
    unit = Unit(kind, head.split(None, 1)[0].lower())
    for section, inside in re.findall(r"(VAR\w*(?: CONSTANT)?)\b(.*?)END_VAR", head, re.DOTALL):
        declarations = [one.strip() for one in inside.split(";") if one.strip()]
        located = [" AT " in one for one in declarations]
        unit.mixed_blocks += any(located) and not all(located)
        for one in declarations:
            before, _, after = one.partition(" : ")
            array = ARRAY.fullmatch(after)
            if array is not None:
                own = _array(before.strip().lower(), section, *array.groups())
                unit.twice += [own.name] if own.name in unit.declared else []
                unit.declared[own.name] = own
                continue
            name, _, address = before.partition(" AT ")
            shape = f"zz{' AT %QX0.0' if address else ''} : {after}"
            found = _one_declaration(kind, section, shape)
            read = copy.deepcopy(found.declared["zz"])
            read.name, read.address = name.strip().lower(), address.strip().upper()
            if read.name in unit.declared:
                unit.twice.append(read.name)
            unit.declared[read.name] = read
    return unit


def _array(name: str, section: str, last: str, kind: str, values: str) -> Declared:
    """Return a constant array; ``3(FALSE)`` stands for three values."""
    assert section == "VAR CONSTANT", name
    found = Table()
    for part in re.findall(r"'[^']*'|[^,\s]+", values):
        count, value = re.fullmatch(r"(?:(\d+)\()?('[^']*'|[^()]+)\)?", part).groups()  # type: ignore[union-attr]
        one = _one_declaration("FUNCTION_BLOCK", section, f"zz : {kind} := {value}")
        found += [one.declared["zz"].initial] * int(count or 1)
    assert len(found) == int(last) + 1, name
    return Declared(name, kind, "VAR", "", found)


@cache
def _one_declaration(kind: str, section: str, declaration: str) -> Unit:
    text = f"{kind} yy\n{section}\n{declaration};\nEND_VAR\nEND_{kind}\n"
    (tree,) = parsed(text).children
    return unit_of(tree)


def statements_of(body: str) -> list[str]:
    """Return the outermost statements of a body, with single blanks."""
    found, words, depth = [], [], 0
    for word in re.findall(r";|[^\s;]+", body):
        words.append(word)
        depth += {"IF": 1, "END_IF": -1, "WHILE": 1, "END_WHILE": -1}.get(word.upper(), 0)
        if word == ";" and depth == 0:
            found.append(" ".join(words))
            words = []
    assert not words
    assert depth == 0
    return found


def _tree(statement: str) -> Tree[Any]:
    named: dict[str, str] = {}

    def masked(match: re.Match[str]) -> str:
        key = f"w{len(named)}w"
        key = f"'{key}'" if match[0][0] == "'" else key
        named[key] = match[0]
        return key

    # Small letters are names of this program; words of the language have capitals.
    statement = re.sub(r"'[^']*'|(?<![#%\w.'])[a-z]\w*", masked, statement)
    numbers = [number for _, number in NUMBER.findall(statement)]
    counter = itertools.count(FIRST)
    shape = NUMBER.sub(lambda match: f"{match[1] or ''}{next(counter)}", statement)
    tree, put = _filled(parsed(shape, "statement_list"), named, numbers)
    assert put == len(numbers), statement
    return tree


def _filled(tree: Tree[Any], named: dict[str, str], numbers: list[str]) -> tuple[Tree[Any], int]:
    """Return a tree with its placeholders replaced by names and numbers, and how many."""
    children: list[Any] = []
    put = 0
    for child in tree.children:
        if isinstance(child, Tree):
            branch, more = _filled(child, named, numbers)
            children.append(branch)
            put += more
        elif isinstance(child, Token) and str(child) in named:
            children.append(Token(child.type, named[str(child)]))
        elif isinstance(child, Token) and child.isdigit() and int(child) >= FIRST:
            children.append(Token(child.type, numbers[int(child) - FIRST]))
            put += 1
        else:
            children.append(child)
    return Tree(tree.data, children), put
