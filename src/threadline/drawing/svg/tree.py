"""The elements of an SVG with their lines; dangerous constructs are refused while it is parsed."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any
from xml.parsers import expat

from threadline.drawing.strokes import MAX_STROKES, decode_text
from threadline.errors import JobError, Place

INKSCAPE = "http://www.inkscape.org/namespaces/inkscape "
_SVG = "http://www.w3.org/2000/svg "
_XLINK = "http://www.w3.org/1999/xlink "
_MAX_DEPTH = 200
_PLAIN = "Save the drawing as plain SVG."


@dataclass(slots=True, eq=False)
class Element:
    """An element: its name (without the SVG namespace), attributes, line and children.

    ``parent`` is None for the root; ``text`` is kept for style sheets only.
    """

    name: str
    attributes: dict[str, str]
    line: int
    parent: Element | None
    children: list[Element] = field(default_factory=list)
    text: str = ""

    @property
    def identity(self) -> str:
        """Its id, empty without one."""
        return self.attributes.get("id", "")

    @property
    def target(self) -> str:
        """The id that a ``use`` names."""
        if self.name != "use":
            return ""
        return self.attributes.get("href", self.attributes.get(f"{_XLINK}href", "")).lstrip("#")


@dataclass(frozen=True, slots=True, eq=False)
class Tree:
    """An SVG: the file's name, its root, elements by id, and the style sheets in order."""

    file: str
    root: Element
    by_id: dict[str, Element]
    sheets: tuple[Element, ...]

    def place(self, element: Element) -> Place:
        """Return the place of an element."""
        return Place(self.file, element.line)


def svg_tree(content: bytes, file: str) -> Tree:
    """Return the elements of an SVG.

    Raises
    ------
    JobError
        With the line, if the file is not well-formed XML or no SVG, declares entities, has its
        styles in another file, or nests or clones elements too deeply.
    """
    text = decode_text(content, file, "SVG drawing")
    # What is left of a declaration would name an encoding that the text no longer has.
    declaration = re.match(r"\s*<\?xml\s[^>]*\?>", text)
    if declaration:
        text = "\n" * declaration[0].count("\n") + text[declaration.end() :]
    visit = _Visit(file)
    try:
        visit.parser.Parse(text.encode(), True)
    except expat.ExpatError as error:
        raise JobError(
            f"not well-formed XML: {expat.errors.messages[error.code]}",
            place=Place(file, error.lineno),
            remedy="Save the drawing again as plain SVG.",
        ) from error
    assert visit.root is not None  # a document without one is not well-formed
    tree = Tree(file, visit.root, visit.by_id, tuple(visit.sheets))
    _refuse_endless_clones(tree)
    return tree


class _Visit:
    """Handlers of the XML parser; the stack holds the open elements."""

    def __init__(self, file: str) -> None:
        self.file = file
        self.root: Element | None = None
        self.stack: list[Element] = []
        self.by_id: dict[str, Element] = {}
        self.sheets: list[Element] = []
        self.parser = expat.ParserCreate(namespace_separator=" ")
        self.parser.StartElementHandler = self.start
        self.parser.EndElementHandler = self.end
        self.parser.CharacterDataHandler = self.characters
        self.parser.EntityDeclHandler = self.entity
        self.parser.ProcessingInstructionHandler = self.instruction
        self.parser.buffer_text = True

    def place(self) -> Place:
        return Place(self.file, self.parser.CurrentLineNumber)

    def entity(self, name: str, *_: Any) -> None:
        raise JobError(
            f"the SVG declares the entity {name[:40]!r}; entities are not read",
            place=self.place(),
            remedy=_PLAIN,
        )

    def instruction(self, target: str, _: str) -> None:
        if target.lower() == "xml-stylesheet":
            raise JobError(
                "the style sheet lies in another file", place=self.place(), remedy=_PLAIN
            )

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        name = tag.removeprefix(_SVG)
        if not self.stack and name != "svg":
            raise JobError(
                f"the root element is {name[:60]!r}, not an svg of the SVG namespace",
                place=self.place(),
                remedy="Save the drawing as SVG.",
            )
        if len(self.stack) > _MAX_DEPTH:
            raise JobError(f"elements are nested more than {_MAX_DEPTH} deep", place=self.place())
        parent = self.stack[-1] if self.stack else None
        element = Element(name, attributes, self.parser.CurrentLineNumber, parent)
        href = attributes.get("href", attributes.get(f"{_XLINK}href", ""))
        if name == "use" and href and not href.startswith("#"):
            raise JobError(
                f"a clone of {href[:60]!r}, which lies in another file", place=self.place()
            )
        if name == "symbol" and "viewBox" in attributes:
            raise JobError(
                "a symbol with a viewBox is not read",
                place=self.place(),
                remedy="Turn the symbol into a group (in Inkscape: Object > Symbols, unlink).",
            )
        if parent is None:
            self.root = element
        else:
            parent.children.append(element)
        self.stack.append(element)
        if element.identity:
            self.by_id.setdefault(element.identity, element)
        if name == "style":
            self.sheets.append(element)

    def end(self, _: str) -> None:
        self.stack.pop()

    def characters(self, text: str) -> None:
        if self.stack and self.stack[-1].name == "style":
            self.stack[-1].text += text


def _below(tree: Tree, element: Element) -> Iterator[Element]:
    yield from element.children
    if element.target in tree.by_id:
        yield tree.by_id[element.target]


def _refuse_endless_clones(tree: Tree) -> None:
    """Refuse elements that are clones of themselves, and too many clones of clones."""
    sizes: dict[int, int] = {}
    order: list[tuple[Element, bool]] = [(tree.root, False)]
    open_elements: set[int] = set()
    while order:
        element, done = order.pop()
        if done:
            open_elements.discard(id(element))
            sizes[id(element)] = 1 + sum(sizes[id(child)] for child in _below(tree, element))
            if sizes[id(element)] > MAX_STROKES:
                raise JobError(
                    f"clones make more than {MAX_STROKES} elements", place=tree.place(element)
                )
            continue
        if id(element) in sizes:
            continue
        open_elements.add(id(element))
        order.append((element, True))
        for child in _below(tree, element):
            if id(child) in open_elements:
                raise JobError(
                    f"the element {child.identity[:60]!r} is a clone of itself",
                    place=tree.place(element),
                )
            order.append((child, False))
