"""The elements of an SVG with their lines in the file, and the parsers of their values."""

from __future__ import annotations

import colorsys
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any
from xml.parsers import expat

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.errors import JobError, Place
from threadline.geometry.strokes import MAX_STROKES, decode_text

NUMBER = r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
SHOWN = 40
_ITEM = re.compile(rf"({NUMBER})\s*,?\s*")
_LENGTH = re.compile(rf"({NUMBER})([a-zA-Z%]*)")
PIXELS = {
    "": 1.0,
    "px": 1.0,
    "in": 96.0,
    "cm": 96.0 / 2.54,
    "mm": 96.0 / 25.4,
    "pt": 96.0 / 72.0,
    "pc": 16.0,
}
"""Number of CSS pixels per unit; a number without unit is in pixels."""
_LENGTH_REMEDY = "Write it in mm, cm, in, pt, pc, px or %, like 12.5mm, without a blank."
_FUNCTION = re.compile(r"([a-zA-Z]+)\s*\(([^()]*)\)\s*,?\s*")
_ANGLES = {"deg": 1.0, "rad": math.degrees(1.0), "grad": 0.9, "turn": 360.0}
_COUNTS = {
    "matrix": (6,), "translate": (1, 2), "scale": (1, 2), "rotate": (1, 3), "skewX": (1,),
    "skewY": (1,), "translateX": (1,), "translateY": (1,), "scaleX": (1,), "scaleY": (1,),
}  # fmt: skip
_ONLY_IN_STYLES = ("translateX", "translateY", "scaleX", "scaleY")
_HEX = re.compile(r"#([0-9a-f]{3,4}|[0-9a-f]{6}|[0-9a-f]{8})")
_COLOURS = """
aliceblue=f0f8ff antiquewhite=faebd7 aqua=00ffff aquamarine=7fffd4 azure=f0ffff beige=f5f5dc
bisque=ffe4c4 black=000000 blanchedalmond=ffebcd blue=0000ff blueviolet=8a2be2 brown=a52a2a
burlywood=deb887 cadetblue=5f9ea0 chartreuse=7fff00 chocolate=d2691e coral=ff7f50
cornflowerblue=6495ed cornsilk=fff8dc crimson=dc143c cyan=00ffff darkblue=00008b darkcyan=008b8b
darkgoldenrod=b8860b darkgray=a9a9a9 darkgreen=006400 darkgrey=a9a9a9 darkkhaki=bdb76b
darkmagenta=8b008b darkolivegreen=556b2f darkorange=ff8c00 darkorchid=9932cc darkred=8b0000
darksalmon=e9967a darkseagreen=8fbc8f darkslateblue=483d8b darkslategray=2f4f4f darkslategrey=2f4f4f
darkturquoise=00ced1 darkviolet=9400d3 deeppink=ff1493 deepskyblue=00bfff dimgray=696969
dimgrey=696969 dodgerblue=1e90ff firebrick=b22222 floralwhite=fffaf0 forestgreen=228b22
fuchsia=ff00ff gainsboro=dcdcdc ghostwhite=f8f8ff gold=ffd700 goldenrod=daa520 gray=808080
green=008000 greenyellow=adff2f grey=808080 honeydew=f0fff0 hotpink=ff69b4 indianred=cd5c5c
indigo=4b0082 ivory=fffff0 khaki=f0e68c lavender=e6e6fa lavenderblush=fff0f5 lawngreen=7cfc00
lemonchiffon=fffacd lightblue=add8e6 lightcoral=f08080 lightcyan=e0ffff lightgoldenrodyellow=fafad2
lightgray=d3d3d3 lightgreen=90ee90 lightgrey=d3d3d3 lightpink=ffb6c1 lightsalmon=ffa07a
lightseagreen=20b2aa lightskyblue=87cefa lightslategray=778899 lightslategrey=778899
lightsteelblue=b0c4de lightyellow=ffffe0 lime=00ff00 limegreen=32cd32 linen=faf0e6 magenta=ff00ff
maroon=800000 mediumaquamarine=66cdaa mediumblue=0000cd mediumorchid=ba55d3 mediumpurple=9370db
mediumseagreen=3cb371 mediumslateblue=7b68ee mediumspringgreen=00fa9a mediumturquoise=48d1cc
mediumvioletred=c71585 midnightblue=191970 mintcream=f5fffa mistyrose=ffe4e1 moccasin=ffe4b5
navajowhite=ffdead navy=000080 oldlace=fdf5e6 olive=808000 olivedrab=6b8e23 orange=ffa500
orangered=ff4500 orchid=da70d6 palegoldenrod=eee8aa palegreen=98fb98 paleturquoise=afeeee
palevioletred=db7093 papayawhip=ffefd5 peachpuff=ffdab9 peru=cd853f pink=ffc0cb plum=dda0dd
powderblue=b0e0e6 purple=800080 rebeccapurple=663399 red=ff0000 rosybrown=bc8f8f royalblue=4169e1
saddlebrown=8b4513 salmon=fa8072 sandybrown=f4a460 seagreen=2e8b57 seashell=fff5ee sienna=a0522d
silver=c0c0c0 skyblue=87ceeb slateblue=6a5acd slategray=708090 slategrey=708090 snow=fffafa
springgreen=00ff7f steelblue=4682b4 tan=d2b48c teal=008080 thistle=d8bfd8 tomato=ff6347
turquoise=40e0d0 violet=ee82ee wheat=f5deb3 white=ffffff whitesmoke=f5f5f5 yellow=ffff00
yellowgreen=9acd32
"""
_NAMED = dict(entry.split("=") for entry in _COLOURS.split())
"""The named colours of CSS Color Module Level 4, as rrggbb in hexadecimal digits."""
_CHANNELS = re.compile(r"(rgb|hsl)a?\(\s*([^()]*?)\s*\)")


class ValueRefused(ValueError):  # noqa: N818 - it names the refused value
    """A value that is not understood; ``remedy`` says what may be written instead."""

    def __init__(self, message: str, remedy: str = "") -> None:
        super().__init__(message)
        self.remedy = remedy


def shown(text: str) -> str:
    """Return a text in quotes and shortened, for a message."""
    return repr(text if len(text) <= SHOWN else text[:SHOWN] + "...")


def pixels(key: str, written: str, whole: float = math.nan) -> float:
    """Return a length in pixels; ``whole`` is the length of 100 %, NaN if percents are not allowed.

    Raises
    ------
    ValueRefused
        If the text is not a length.
    """
    match = _LENGTH.fullmatch(written.strip())
    value = math.nan
    if match and match[2] == "%":
        value = float(match[1]) / 100.0 * whole
    elif match and match[2] in PIXELS:
        value = float(match[1]) * PIXELS[match[2]]
    if not math.isfinite(value):
        raise ValueRefused(
            f"{key} is {shown(written)}, not a length in known units", _LENGTH_REMEDY
        )
    return value


def numbers(text: str) -> list[float]:
    """Return the numbers in a text, which are separated by blanks, commas or only by a sign.

    Raises
    ------
    ValueRefused
        If the text contains anything else.
    """
    found: list[float] = []
    position = 0
    while match := _ITEM.match(text, position):
        found.append(float(match[1]))
        position = match.end()
    if text[position:].strip() or text.rstrip().endswith(","):
        raise ValueRefused(f"{shown(text[position:] or text)} is not a number")
    if not all(map(math.isfinite, found)):
        raise ValueRefused("a number is not finite")
    return found


def transform(written: str, in_style: bool = False) -> FloatArray:
    """Return the (3, 3) matrix of a list of transforms.

    Parameters
    ----------
    in_style
        Whether the text is from a style, in which lengths and angles have units. In an attribute
        they are plain numbers, in pixels and degrees.

    Raises
    ------
    ValueRefused
        If the text is not a list of transforms.
    """
    result = np.eye(3)
    if written.strip() in ("", "none"):
        return result
    written, position = written.strip(), 0
    while position < len(written):
        match = _FUNCTION.match(written, position)
        if match is None:
            raise ValueRefused(f"the transform {shown(written[position:])} is not understood")
        result = result @ _function(match[1], match[2], in_style)
        position = match.end()
    if not np.isfinite(result).all():
        raise ValueRefused("a number of a transform is not finite")
    return result


def _function(name: str, arguments: str, in_style: bool) -> FloatArray:
    quoted = f"the transform {shown(f'{name}({arguments})')}"
    if name not in _COUNTS or (name in _ONLY_IN_STYLES and not in_style):
        raise ValueRefused(f"{quoted} is not understood")
    try:
        v = _styled(name, arguments) if in_style else numbers(arguments.strip())
    except ValueRefused:
        raise ValueRefused(f"{quoted} is not understood", "Write plain numbers.") from None
    if len(v) not in _COUNTS[name]:
        allowed = " or ".join(map(str, _COUNTS[name]))
        raise ValueRefused(f"{quoted} has {len(v)} numbers, not {allowed}")
    if name == "matrix":
        return np.array([[v[0], v[2], v[4]], [v[1], v[3], v[5]], [0.0, 0.0, 1.0]])
    if name.startswith("translate"):
        x = v[0] if name != "translateY" else 0.0
        y = v[0] if name == "translateY" else v[1] if len(v) > 1 else 0.0
        return np.array([[1.0, 0.0, x], [0.0, 1.0, y], [0.0, 0.0, 1.0]])
    if name.startswith("scale"):
        x = v[0] if name != "scaleY" else 1.0
        y = v[-1] if name != "scaleX" else 1.0
        return np.diag([x, y, 1.0])
    angle = math.radians(v[0])
    if name == "rotate":
        c, s = math.cos(angle), math.sin(angle)
        x, y = v[1:] if len(v) == 3 else (0.0, 0.0)
        return np.array([[c, -s, x - c * x + s * y], [s, c, y - s * x - c * y], [0.0, 0.0, 1.0]])
    result = np.eye(3)
    result[(0, 1) if name == "skewX" else (1, 0)] = math.tan(angle)
    return result


def _styled(name: str, arguments: str) -> list[float]:
    """Return the arguments of a function of a style sheet: lengths in px, angles in degrees."""
    values = []
    for part in arguments.split(","):
        match = _LENGTH.fullmatch(part.strip())
        if match is None:
            raise ValueRefused(part)
        value, unit = float(match[1]), match[2]
        if name in ("rotate", "skewX", "skewY"):
            unit_known = unit in _ANGLES or (value == 0.0 and not unit)
            value *= _ANGLES.get(unit, 1.0)
        elif name.startswith("translate"):
            unit_known = unit in PIXELS and bool(unit or value == 0.0)
            value *= PIXELS.get(unit, 1.0)
        else:
            unit_known = not unit
        if not unit_known:
            raise ValueRefused(part)
        values.append(value)
    return values


def colour(written: str) -> str:
    """Return a paint as ``"#rrggbb"``, ``"none"``, or ``"url(#...)"`` for a gradient or pattern.

    Raises
    ------
    ValueRefused
        If the text is not a known colour.
    """
    text = written.strip()
    if text.startswith("url("):
        return text[: text.find(")") + 1] or text
    text = text.lower()
    if text in ("none", "transparent"):
        return "none"
    match = _HEX.fullmatch(text)
    if match:
        digits = match[1] if len(match[1]) > 4 else "".join(2 * c for c in match[1])
        return "none" if digits[6:] == "00" else f"#{digits[:6]}"
    channels = _CHANNELS.fullmatch(text)
    if channels:
        return _channels(channels[1], channels[2], written)
    if text not in _NAMED:
        raise ValueRefused(f"{shown(written)} is not a known colour", "Write it like #ff0000.")
    return f"#{_NAMED[text]}"


def _channels(kind: str, arguments: str, written: str) -> str:
    parts = [part for part in re.split(r"[\s,/]+", arguments) if part]
    matches = [_LENGTH.fullmatch(part) for part in parts]
    if len(parts) not in (3, 4) or any(m is None or m[2] not in ("", "%", "deg") for m in matches):
        raise ValueRefused(f"{shown(written)} is not a known colour", "Write it like #ff0000.")
    values = [float(m[1]) / 100.0 if m[2] == "%" else float(m[1]) for m in matches if m]
    if len(values) == 4 and values[3] <= 0.0:
        return "none"
    if kind == "hsl":
        rgb = colorsys.hls_to_rgb(values[0] / 360.0 % 1.0, values[2], values[1])
    else:
        rgb = tuple(  # type: ignore[assignment]  # three of them
            value if m and m[2] == "%" else value / 255.0
            for value, m in zip(values[:3], matches[:3], strict=True)
        )
    return "#" + "".join(f"{round(255 * min(1.0, max(0.0, value))):02x}" for value in rgb)


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
        """Id of the element, empty without one."""
        return self.attributes.get("id", "")

    @property
    def target(self) -> str:
        """The id of the element that a ``use`` clones."""
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
        """Return the file and line of an element."""
        return Place(self.file, element.line)


def svg_tree(content: bytes, file: str) -> Tree:
    """Return the elements of an SVG.

    Raises
    ------
    JobError
        If the file is not well-formed XML or not an SVG, declares entities, has its styles in
        another file, or nests or clones elements too deeply; names the line.
    """
    text = decode_text(content, file, "SVG drawing")
    # Remove the XML declaration: it names the file's encoding, and the text is decoded already.
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
    assert visit.root is not None  # a document without a root is not well-formed
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


def _drawn_children(tree: Tree, element: Element) -> Iterator[Element]:
    yield from element.children
    if element.target in tree.by_id:
        yield tree.by_id[element.target]


def _refuse_endless_clones(tree: Tree) -> None:
    """Refuse elements that clone themselves, and clones that make too many elements."""
    sizes: dict[int, int] = {}
    stack: list[tuple[Element, bool]] = [(tree.root, False)]
    open_elements: set[int] = set()
    while stack:
        element, children_done = stack.pop()
        if children_done:
            open_elements.discard(id(element))
            sizes[id(element)] = 1 + sum(
                sizes[id(child)] for child in _drawn_children(tree, element)
            )
            if sizes[id(element)] > MAX_STROKES:
                raise JobError(
                    f"clones make more than {MAX_STROKES} elements", place=tree.place(element)
                )
            continue
        if id(element) in sizes:
            continue
        open_elements.add(id(element))
        stack.append((element, True))
        for child in _drawn_children(tree, element):
            if id(child) in open_elements:
                raise JobError(
                    f"the element {child.identity[:60]!r} is a clone of itself",
                    place=tree.place(element),
                )
            stack.append((child, False))
