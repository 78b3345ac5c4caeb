"""Structured text read by blark in parts: each shape of statement once, whatever its numbers.

blark takes ten seconds for a whole sequence. Two statements that differ in whole numbers and
durations alone have the same tree but for these, so each shape is parsed once and its numbers are
put in. ``test_text`` holds this reading against blark's own of a whole text.
"""

from __future__ import annotations

import copy
import itertools
import re
from functools import cache
from typing import Any

from blark.parse import parse_source_code
from lark import Token, Tree

from tests.plc.reading import Unit, unit_of

COMMENT = re.compile(r"\(\*.*?\*\)", re.DOTALL)
UNIT = re.compile(r"\b(FUNCTION_BLOCK|PROGRAM)\b(.*?)\bEND_\1\b", re.DOTALL)
NUMBER = re.compile(r"(?<![\w.%])(T#)?(\d+)(?=(?:ms|s|m|h|d)?(?![\w.]))")
FIRST = 900_001
"""Stands for the first number of a shape; the others follow. No text has such a number."""


def read_in_parts(text: str) -> dict[str, Unit]:
    """Return the units of ``text`` by lower-case name, as ``reading.read`` does."""
    assert "'" not in text, "a string could hold what looks like a comment"
    units = {}
    for kind, inside in UNIT.findall(COMMENT.sub(" ", text)):
        head, end, body = inside.rpartition("END_VAR")
        unit = unit_of(_declarations(f"{kind}{head}{end}\nEND_{kind}\n"))
        assert unit.body is None
        children = [child for part in statements_of(body) for child in _tree(part).children]
        unit.body = Tree("statement_list", children)
        units[unit.name] = unit
    return units


@cache
def _declarations(text: str) -> Tree[Any]:
    result = parse_source_code(text)
    assert result.exception is None, result.exception
    (tree,) = result.tree.children
    return tree


def statements_of(body: str) -> list[str]:
    """Return the outermost statements of a body, white space made single."""
    found, words, depth = [], [], 0
    for word in re.findall(r";|[^\s;]+", body):
        words.append(word)
        depth += {"IF": 1, "END_IF": -1}.get(word.upper(), 0)
        if word == ";" and depth == 0:
            found.append(" ".join(words))
            words = []
    assert not words
    assert depth == 0
    return found


def _tree(statement: str) -> Tree[Any]:
    numbers = [number for _, number in NUMBER.findall(statement)]
    counter = itertools.count(FIRST)
    shape = NUMBER.sub(lambda match: f"{match[1] or ''}{next(counter)}", statement)
    tree = copy.deepcopy(_parsed(shape))
    put = 0
    for branch in tree.iter_subtrees():
        for index, child in enumerate(branch.children):
            if isinstance(child, Token) and child.isdigit() and int(child) >= FIRST:
                number = numbers[int(child) - FIRST]
                branch.children[index] = Token(child.type, number)
                put += 1
    assert put == len(numbers), statement
    return tree


@cache
def _parsed(shape: str) -> Tree[Any]:
    result = parse_source_code(shape, starting_rule="statement_list")
    assert result.exception is None, (shape, result.exception)
    return result.tree
