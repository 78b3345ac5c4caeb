"""A first pass over an SVG: refuses what is dangerous, and notes line and layer of each element.

The notes are attributes put into the text that svgelements then reads; it hands them on to
the shapes, through groups and clones.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Any
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

from threadline.errors import JobError, Place
from threadline.jobs.seam.drawing import MAX_STROKES, decode_text

LINE, LAYER, HIDDEN, CLONE = "tl-line", "tl-layer", "tl-hidden", "tl-clone"
_MAX_DEPTH = 200
_INKSCAPE = "http://www.inkscape.org/namespaces/inkscape "
_SVG = "http://www.w3.org/2000/svg "
_XLINK = "http://www.w3.org/1999/xlink "
_UNSEEN = ("mask", "marker", "symbol", "clipPath", "pattern", "linearGradient", "radialGradient")
_PHYSICAL = re.compile(r"\s*(\d+\.?\d*|\.\d+)\s*(mm|cm|in|pt|pc)\s*")
_UNIT_M = {"mm": 1e-3, "cm": 1e-2, "in": 0.0254, "pt": 0.0254 / 72.0, "pc": 0.0254 / 6.0}
# Of these svgelements takes the number and leaves other units out: 3em would be 3 pixels.
_SIZED = ("svg", "rect", "circle", "ellipse", "line", "use")
_LENGTHS = ("width", "height", "x", "y", "cx", "cy", "r", "rx", "ry", "x1", "y1", "x2", "y2")
_KNOWN_LENGTH = re.compile(
    r"\s*(?:auto|[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?(?:mm|cm|in|pt|pc|px|%)?)\s*"
)
# What no path data has; svgelements would take the path up to there, and leave the rest out.
_STRAY = re.compile(r"[^MmZzLlHhVvCcSsQqTtAa0-9eE+\-.,\s]+|[eE](?![-+]?[0-9])|(?<![0-9.])[eE]")
_NO_NUMBER = re.compile(r"nan|inf", re.IGNORECASE)  # these are told when the path is read
_TEXTS = ("text", "tspan", "textPath", "flowRoot")


@dataclass(slots=True)
class _Node:
    identity: str
    target: str
    children: list[_Node] = field(default_factory=list)


@dataclass(slots=True)
class SvgScan:
    """What the first pass found.

    Parameters
    ----------
    text
        The SVG with line and layer noted on its elements.
    texts
        Line and layer of each visible text; images and foreign objects under ``others``.
    size_m
        Width and height, where the drawing states them with physical units.
    """

    text: str = ""
    texts: list[tuple[int, str]] = field(default_factory=list)
    others: list[tuple[str, int, str]] = field(default_factory=list)
    size_m: tuple[float, float] | None = None


def scan_svg(content: bytes, file: str) -> SvgScan:
    """Return the annotated SVG and what it holds besides shapes.

    Raises
    ------
    JobError
        If it is not well-formed XML, no SVG, declares entities, nests or clones without end;
        with the line.
    """
    text = decode_text(content, file, "SVG drawing")
    # What is left of a declaration would name an encoding that the text no longer has.
    declaration = re.match(r"\s*<\?xml[^>]*\?>", text)
    if declaration:
        text = "\n" * declaration[0].count("\n") + text[declaration.end() :]
    raw = text.encode()
    visit = _Visit(file, raw)
    try:
        visit.parser.Parse(raw, True)
    except expat.ExpatError as error:
        raise JobError(
            f"not well-formed XML: {expat.errors.messages[error.code]}",
            place=Place(file, error.lineno),
            remedy="Save the drawing again as plain SVG.",
        ) from error
    visit.check_clones()
    visit.scan.text = visit.annotated()
    return visit.scan


class _Visit:
    """Handlers of the XML parser; the stack holds the open elements."""

    def __init__(self, file: str, raw: bytes) -> None:
        self.file = file
        self.raw = raw
        self.scan = SvgScan()
        self.layers = [""]
        self.hidden = [False]
        self.nodes = [_Node("", "")]
        self.by_id: dict[str, _Node] = {}
        self.notes: list[tuple[int, str]] = []
        self.parser = expat.ParserCreate(namespace_separator=" ")
        self.parser.StartElementHandler = self.start
        self.parser.EndElementHandler = self.end
        self.parser.EntityDeclHandler = self.entity
        self.parser.buffer_text = True

    def place(self) -> Place:
        return Place(self.file, self.parser.CurrentLineNumber)

    def entity(self, name: str, *_: Any) -> None:
        raise JobError(
            f"the SVG declares the entity {name[:40]!r}; entities are not read",
            place=self.place(),
            remedy="Save the drawing as plain SVG.",
        )

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        name = tag.removeprefix(_SVG)
        depth = len(self.nodes) - 1
        if depth == 0:
            self._root(name, attributes)
        if depth > _MAX_DEPTH:
            raise JobError(f"elements are nested more than {_MAX_DEPTH} deep", place=self.place())
        if name in _SIZED:
            self._refuse_lengths(name, attributes)
        if name == "path":
            self._refuse_stray(attributes.get("d", ""))
        layer = self.layers[-1]
        note = f' {LINE}="{self.parser.CurrentLineNumber}"'
        label = attributes.get(f"{_INKSCAPE}label", attributes.get("id", ""))
        if name == "g" and (
            attributes.get(f"{_INKSCAPE}groupmode") == "layer" or (depth == 1 and label)
        ):
            layer = label
            note += f" {LAYER}={quoteattr(label)}"
        hidden = self.hidden[-1] or name in _UNSEEN or _is_invisible(attributes)
        if name in _UNSEEN:
            note += f' {HIDDEN}="{name}"'
        if name == "use":
            note += f' {CLONE}="1"'
        self._note(note)
        if not hidden and name in _TEXTS[:1] + _TEXTS[3:]:
            self.scan.texts.append((self.parser.CurrentLineNumber, layer))
        if not hidden and name in ("image", "foreignObject"):
            self.scan.others.append((name, self.parser.CurrentLineNumber, layer))
        self.layers.append(layer)
        self.hidden.append(hidden or name == "defs")
        href = attributes.get("href", attributes.get(f"{_XLINK}href", ""))
        node = _Node(attributes.get("id", ""), href.lstrip("#") if name == "use" else "")
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
        self.nodes[-1].children.append(node)
        self.nodes.append(node)
        if node.identity:
            self.by_id[node.identity] = node

    def _refuse_lengths(self, name: str, attributes: dict[str, str]) -> None:
        for key in _LENGTHS:
            written = attributes.get(key, "0")
            # A page's size may have a blank before its unit: it is read here.
            page = name == "svg" and _PHYSICAL.fullmatch(written)
            if not (page or _KNOWN_LENGTH.fullmatch(written)):
                raise JobError(
                    f"{key} is {written[:40]!r}, no length that can be sewn",
                    place=self.place(),
                    remedy="Write it in mm, cm, in, pt, pc, px or %, like 12.5mm, without a blank.",
                )

    def _refuse_stray(self, data: str) -> None:
        stray = None if _NO_NUMBER.search(data) else _STRAY.search(data)
        if stray is not None:
            raise JobError(
                f"the data of a path is wrong: {stray[0][:40]!r} at character {stray.start() + 1}",
                place=self.place(),
                remedy="Correct it, or draw the path again and save as plain SVG.",
            )

    def end(self, _: str) -> None:
        self.layers.pop()
        self.hidden.pop()
        self.nodes.pop()

    def _root(self, name: str, attributes: dict[str, str]) -> None:
        if name != "svg":
            raise JobError(
                f"the root element is {name[:60]!r}, not an svg of the SVG namespace",
                place=self.place(),
                remedy="Save the drawing as SVG.",
            )
        sizes = [_PHYSICAL.fullmatch(attributes.get(key, "")) for key in ("width", "height")]
        if sizes[0] and sizes[1]:
            width, height = (float(m[1]) * _UNIT_M[m[2]] for m in sizes if m)
            self.scan.size_m = (width, height)

    def _note(self, note: str) -> None:
        at = self.parser.CurrentByteIndex
        name = re.compile(rb"<[^\s/>]+").match(self.raw, at)
        assert name is not None
        self.notes.append((name.end(), note))

    def annotated(self) -> str:
        """Return the text with the notes put in."""
        parts, last = [], 0
        for at, note in self.notes:
            parts += [self.raw[last:at], note.encode()]
            last = at
        return b"".join([*parts, self.raw[last:]]).decode()

    def check_clones(self) -> None:
        """Refuse clones of themselves, and clones of clones without end."""
        sizes: dict[int, int] = {}
        order: list[tuple[_Node, bool]] = [(self.nodes[0], False)]
        open_nodes: set[int] = set()
        while order:
            node, done = order.pop()
            target = self.by_id.get(node.target) if node.target else None
            below = [*node.children, *([target] if target else [])]
            if done:
                open_nodes.discard(id(node))
                sizes[id(node)] = 1 + sum(sizes[id(child)] for child in below)
                if sizes[id(node)] > MAX_STROKES:
                    raise JobError(
                        f"clones make more than {MAX_STROKES} elements", place=Place(self.file)
                    )
                continue
            if id(node) in sizes:
                continue
            if id(node) in open_nodes:
                raise JobError(
                    f"the element {node.identity[:60]!r} is a clone of itself",
                    place=Place(self.file),
                )
            open_nodes.add(id(node))
            order.append((node, True))
            for child in below:
                if id(child) in open_nodes:
                    raise JobError(
                        f"the element {child.identity[:60]!r} is a clone of itself",
                        place=Place(self.file),
                    )
                order.append((child, False))


def _is_invisible(attributes: dict[str, str]) -> bool:
    style = attributes.get("style", "").replace(" ", "")
    return attributes.get("display") == "none" or "display:none" in style
