"""Styles of elements, from presentation attributes, style sheets and style attributes."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

from threadline.errors import JobError
from threadline.geometry.svg.document import Element, Tree, ValueRefused, shown

READ = (
    "display", "visibility", "stroke", "fill", "color", "transform", "transform-origin",
    "clip-path", "mask", "stroke-dasharray", "stroke-width",
)  # fmt: skip
"""Properties that decide which shapes are sewn, where they are, and how their lines are drawn."""
_LOOKS = ("stroke-dasharray", "stroke-width")
INHERITED = {
    "visibility": "visible", "stroke": "none", "fill": "black", "color": "black",
    "stroke-dasharray": "none", "stroke-width": "1",
}  # fmt: skip
"""Properties that a child inherits from its parent, each with its value at the root."""
_INITIAL = {
    **INHERITED, "display": "inline", "transform": "none", "transform-origin": "0 0",
    "clip-path": "none", "mask": "none",
}  # fmt: skip
_MOVES = (
    "d", "x", "y", "cx", "cy", "r", "rx", "ry", "width", "height", "translate", "rotate",
    "scale", "zoom", "offset", "offset-path", "transform-box", "all", "clip",
)  # fmt: skip
"""Properties that would change the sewn shapes but are not read from styles; they are refused."""
_COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)
_RULE = re.compile(r"([^{}]*)\{([^{}]*)\}")
_COMPOUND = re.compile(r"(?:\*|[a-zA-Z][\w-]*)?(?:[.#][^\s.#>+~:\[\]()*,]+)*")
_SIMPLE = re.compile(r"[.#]?[^.#]+")
_TOKEN = re.compile(r"""[^;"'()]+|"[^"]*"|'[^']*'|[;"'()]""")

Strength = tuple[int, int, int, int, int, int]


@dataclass(frozen=True, slots=True)
class _Rule:
    """A selector (its compounds with combinators, from right to left) and a declaration."""

    compounds: tuple[tuple[str, str], ...]
    weight: tuple[int, int, int]
    key: str
    value: str
    important: bool


class Styles:
    """The values that styles declare for elements, before inheritance."""

    def __init__(self, tree: Tree) -> None:
        self._tree = tree
        self._rules = [rule for sheet in tree.sheets for rule in _sheet(tree, sheet)]

    def declared(self, element: Element) -> dict[str, tuple[str, bool]]:
        """Return each property that is set on ``element``: its text, and whether a style sets it.

        Raises
        ------
        JobError
            If a style cannot be read, or sets a property that is read only from attributes; names
            the line.
        """
        best: dict[str, tuple[Strength, str, bool]] = {}

        def consider(key: str, value: str, strength: Strength, styled: bool) -> None:
            if key not in best or strength >= best[key][0]:
                best[key] = (strength, value, styled)

        for key in READ:
            if key in element.attributes:
                consider(key, element.attributes[key].strip(), (0, 0, 0, 0, 0, 0), False)
        for order, rule in enumerate(self._rules):
            if _matches(rule.compounds, element):
                consider(rule.key, rule.value, (rule.important, 0, *rule.weight, order + 1), True)
        try:
            for key, value, important in _declarations(element.attributes.get("style", "")):
                consider(key, value, (important, 1, 0, 0, 0, 0), True)
            for key, (_, value, _) in best.items():
                if key in _MOVES and not (key == "transform-box" and value == "view-box"):
                    raise ValueRefused(
                        f"{key} is set to {shown(value)} in a style, where it is not read",
                        "Write it as an attribute, or save as plain SVG.",
                    )
                if key not in _LOOKS and ("var(" in value or "calc(" in value):
                    raise ValueRefused(
                        f"{key} is {shown(value)}, which is not read", "Write it out."
                    )
        except ValueRefused as error:
            raise JobError(
                str(error), place=self._tree.place(element), remedy=error.remedy
            ) from error
        return {key: (value, styled) for key, (_, value, styled) in best.items() if key in READ}


def resolved(key: str, written: str | None, parent: str) -> str:
    """Return the value of a property after inheritance.

    Parameters
    ----------
    key
        Name of the property.
    written
        Declared value; None without one.
    parent
        Value of the parent.
    """
    word = None if written is None else written.strip().lower()
    inherits = key in INHERITED
    if word == "inherit" or (inherits and word in (None, "unset", "revert", "revert-layer")):
        return parent
    if word in (None, "initial", "unset", "revert", "revert-layer"):
        return _INITIAL[key]
    return str(written).strip()


def _declarations(text: str) -> Iterator[tuple[str, str, bool]]:
    """Yield property, value and whether it is marked as important.

    Raises
    ------
    ValueRefused
        If a style ends within quotes or brackets.
    """
    for written in _split_at_semicolons(_COMMENT.sub(" ", text)):
        key, colon, value = written.partition(":")
        key = key.strip().lower()
        if not colon:
            if key:
                raise ValueRefused(f"the style {shown(key)} is not understood")
            continue
        value, mark, word = value.strip().partition("!")
        if mark and word.strip().lower() != "important":
            raise ValueRefused(f"the style {shown(written.strip())} is not understood")
        if key in READ or key in _MOVES:
            yield key, value.strip(), bool(mark)


def _split_at_semicolons(text: str) -> Iterator[str]:
    """Yield the texts between semicolons outside quotes and brackets."""
    begin = depth = 0
    for token in _TOKEN.finditer(text):
        depth += {"(": 1, ")": -1}.get(token[0], 0)
        if depth < 0 or token[0] in ('"', "'"):
            raise ValueRefused(f"the style {shown(text[begin:].strip())} is not understood")
        if token[0] == ";" and not depth:
            yield text[begin : token.start()]
            begin = token.end()
    if depth:
        raise ValueRefused(f"the style {shown(text[begin:].strip())} is not understood")
    yield text[begin:]


def _sheet(tree: Tree, sheet: Element) -> Iterator[_Rule]:
    try:
        if sheet.attributes.get("type", "text/css").strip().lower() not in ("", "text/css"):
            return
        if sheet.attributes.get("media", "all").strip().lower() not in ("", "all", "screen"):
            raise ValueRefused("a style sheet for certain media is not read", "Remove its media.")
        text = _COMMENT.sub(" ", sheet.text).replace("<!--", " ").replace("-->", " ")
        text = re.sub(r"@(?:charset|namespace)\b[^;{}]*;|@font-face\s*\{[^{}]*\}", " ", text)
        at_rule = re.search(r"@[\w-]+", text)
        if at_rule:
            raise ValueRefused(f"{at_rule[0]} in a style sheet is not read", "Save as plain SVG.")
        rest = _RULE.sub(" ", text).strip()
        if rest:
            raise ValueRefused(f"the style sheet is not understood at {shown(rest)}")
        for match in _RULE.finditer(text):
            declarations = list(_declarations(match[2]))
            for selector in match[1].split(",") if declarations else ():
                compounds, weight = _selector(selector.strip())
                for key, value, important in declarations:
                    yield _Rule(compounds, weight, key, value, important)
    except ValueRefused as error:
        raise JobError(str(error), place=tree.place(sheet), remedy=error.remedy) from error


def _selector(text: str) -> tuple[tuple[tuple[str, str], ...], tuple[int, int, int]]:
    """Return the compounds of a selector, from the right, and the weight of the selector.

    Each compound comes with the combinator on its left.
    """
    parts = re.sub(r"\s*>\s*", " > ", text).split()
    compounds: list[tuple[str, str]] = []
    combinator = ""
    for part in parts:
        if part == ">" and compounds and not combinator:
            combinator = ">"
            continue
        if part == ">" or not _COMPOUND.fullmatch(part):
            raise ValueRefused(
                f"the selector {shown(text)} of a style sheet is not read",
                "Use types, classes and ids, or save as plain SVG.",
            )
        compounds.append((part, combinator or " "))
        combinator = ""
    if not compounds or combinator:
        raise ValueRefused(f"the selector {shown(text)} of a style sheet is not understood")
    simple = [s for part, _ in compounds for s in _SIMPLE.findall(part)]
    ids = sum(s.startswith("#") for s in simple)
    classes = sum(s.startswith(".") for s in simple)
    types = len(simple) - ids - classes - sum(s == "*" for s in simple)
    return tuple(reversed(compounds)), (ids, classes, types)


def _matches(compounds: tuple[tuple[str, str], ...], element: Element) -> bool:
    (compound, combinator), rest = compounds[0], compounds[1:]
    if not _matches_compound(compound, element):
        return False
    if not rest:
        return True
    ancestor = element.parent
    while ancestor is not None:
        if _matches(rest, ancestor):
            return True
        if combinator == ">":
            return False
        ancestor = ancestor.parent
    return False


def _matches_compound(compound: str, element: Element) -> bool:
    for simple in _SIMPLE.findall(compound):
        if simple.startswith("#"):
            matched = element.identity == simple[1:]
        elif simple.startswith("."):
            matched = simple[1:] in element.attributes.get("class", "").split()
        else:
            matched = simple in ("*", element.name)
        if not matched:
            return False
    return True
