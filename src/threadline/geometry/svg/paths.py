"""Paths and basic shapes of SVG as subpaths of exact pieces."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NoReturn

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.geometry.curves import Pieces
from threadline.geometry.svg.document import NUMBER, ValueRefused, numbers, pixels, shown

_COUNT = {"M": 2, "Z": 0, "L": 2, "H": 1, "V": 1, "C": 6, "S": 4, "Q": 4, "T": 2, "A": 7}
_NUMBER = re.compile(rf"\s*,?\s*({NUMBER})")
_FLAG = re.compile(r"\s*,?\s*([01])")
_COMMAND = re.compile(r"\s*([MmZzLlHhVvCcSsQqTtAa])")
_NO_NUMBER = re.compile(r"nan|inf(?:inity)?", re.IGNORECASE)
_REMEDY = "Correct it, or draw the path again and save as plain SVG."
# Matrices from Bernstein coefficients to power coefficients.
_QUADRATIC = np.array([[1.0, 0.0, 0.0], [-2.0, 2.0, 0.0], [1.0, -2.0, 1.0]])
_CUBIC = np.array(
    [[1.0, 0.0, 0.0, 0.0], [-3.0, 3.0, 0.0, 0.0], [3.0, -6.0, 3.0, 0.0], [-1.0, 3.0, -3.0, 1.0]]
)
Point = tuple[float, float]


@dataclass(slots=True)
class Subpath:
    """The segments between two moves; each segment has 2, 3 or 4 control points, or is an arc.

    An arc is given by its centre, its two half axes, the angle at its beginning and its sweep.
    """

    segments: list[tuple[Point, ...] | tuple[Point, Point, Point, float, float]] = field(
        default_factory=list
    )

    def pieces(self, line: int) -> Pieces:
        """Return the pieces of all segments, in order.

        Raises
        ------
        ValueRefused
            If a coordinate is not finite.
        """
        arcs = [k for k, s in enumerate(self.segments) if len(s) == 5]
        cubics = [k for k, s in enumerate(self.segments) if len(s) == 4]
        quadratics = [k for k, s in enumerate(self.segments) if len(s) == 3]
        lines = [k for k, s in enumerate(self.segments) if len(s) == 2]
        count = len(self.segments)
        top = np.zeros((count, 4 if cubics else 3, 2))
        begin_rad, sweep_rad = np.zeros(count), np.zeros(count)
        ends = self._control(lines, 2)
        top[lines, 0], top[lines, 1] = ends[:, 0], ends[:, 1] - ends[:, 0]
        top[quadratics, :3] = np.einsum("kj,njd->nkd", _QUADRATIC, self._control(quadratics, 3))
        if cubics:
            top[cubics] = np.einsum("kj,njd->nkd", _CUBIC, self._control(cubics, 4))
        for k in arcs:
            centre, a, b, begin_rad[k], sweep_rad[k] = self.segments[k]
            top[k, :3] = centre, a, b
        if not (np.isfinite(top).all() and np.isfinite(sweep_rad).all()):
            raise ValueRefused("a coordinate is not a finite number")
        bottom = np.zeros((count, top.shape[1]))
        bottom[:, 0] = 1.0
        return Pieces(
            top=top,
            bottom=bottom,
            begin_rad=begin_rad,
            sweep_rad=sweep_rad,
            line=np.full(count, line, dtype=np.int64),
        )

    def _control(self, index: list[int], count: int) -> FloatArray:
        return np.array([self.segments[k] for k in index], dtype=np.float64).reshape(-1, count, 2)


def path_subpaths(data: str) -> list[Subpath]:
    """Return the subpaths of path data that have segments.

    Raises
    ------
    ValueRefused
        If the grammar does not allow the data; names the character. A browser would draw the path
        up to this character.
    """
    reader = _Reader(data)
    if data.strip() not in ("", "none"):
        while reader.command():
            pass
    return [path for path in reader.found if path.segments]


class _Reader:
    """The position in the data, and the state of the pen."""

    def __init__(self, data: str) -> None:
        self.data = data
        self.at = 0
        self.found: list[Subpath] = []
        self.here: Point = (0.0, 0.0)
        self.first: Point = (0.0, 0.0)
        self.last = ""  # the preceding command, upper case
        self.control: Point = (0.0, 0.0)  # last control point of the preceding command
        self.closed = False

    def command(self) -> bool:
        """Read a command with all its repetitions; return False at the end."""
        match = _COMMAND.match(self.data, self.at)
        if match is None:
            if self.data[self.at :].strip():
                self.refuse()
            return False
        letter = match[1]
        if not self.found and letter not in "Mm":
            raise ValueRefused(
                "the data of a path is wrong: it does not begin with a move", _REMEDY
            )
        self.at = match.end()
        upper = letter.upper()
        while True:
            values = self.values(upper)
            self.draw(upper, values, letter.islower())
            if upper == "Z" or not self._another():
                return True
            if upper == "M":
                upper = "L"  # further pairs after a move are lines

    def _another(self) -> bool:
        return _NUMBER.match(self.data, self.at) is not None

    def values(self, upper: str) -> list[float]:
        found = []
        for k in range(_COUNT[upper]):
            pattern = _FLAG if upper == "A" and k in (3, 4) else _NUMBER
            match = pattern.match(self.data, self.at)
            if match is None or (k == 0 and "," in match[0] and self._after_letter()):
                self.refuse()
            value = float(match[1])
            if not math.isfinite(value):
                raise ValueRefused("a coordinate is not a finite number", _REMEDY)
            found.append(value)
            self.at = match.end()
        return found

    def _after_letter(self) -> bool:
        before = self.at  # keep only the position, because a path may have a million numbers
        while before and self.data[before - 1].isspace():
            before -= 1
        return self.data[before - 1 : before].isalpha()

    def refuse(self) -> NoReturn:
        rest = self.data[self.at :]
        position = self.at + len(rest) - len(rest.lstrip())
        word = re.match(r"[A-Za-z]{2,}|\S+", self.data[position:])
        no_number = _NO_NUMBER.match(self.data[position:])
        if no_number:
            raise ValueRefused(f"{no_number[0]!r} in the data of a path is not a number", _REMEDY)
        found_text = (
            f"{shown(word[0])} at character {position + 1}" if word else "it ends too early"
        )
        raise ValueRefused(f"the data of a path is wrong: {found_text}", _REMEDY)

    def add(self, *segment: object) -> None:
        if self.closed:  # a segment after a closed subpath begins a new subpath at its start
            self.found.append(Subpath())
            self.closed = False
        self.found[-1].segments.append(segment)  # type: ignore[arg-type]

    def draw(self, upper: str, v: list[float], relative: bool) -> None:
        x0, y0 = self.here
        base = (x0, y0) if relative else (0.0, 0.0)
        points = [(v[k] + base[0], v[k + 1] + base[1]) for k in range(0, len(v) - 1, 2)]
        previous_control = self.control  # of the preceding command
        end = points[-1] if points else self.first
        if upper == "M":
            self.found.append(Subpath())
            self.first, self.closed = end, False
        elif upper == "Z":
            # Closing a path whose end is already at its start adds no segment.
            if self.here != self.first or not (self.closed or self.found[-1].segments):
                self.add(self.here, self.first)
            self.closed = True
        elif upper == "L":
            self.add(self.here, end)
        elif upper == "H":
            end = (v[0] + base[0], y0)
            self.add(self.here, end)
        elif upper == "V":
            end = (x0, v[0] + base[1])
            self.add(self.here, end)
        elif upper in "CS":
            first = points[0] if upper == "C" else self._mirrored(previous_control, "CS")
            self.control = points[-2]
            self.add(self.here, first, points[-2], end)
        elif upper in "QT":
            self.control = points[0] if upper == "Q" else self._mirrored(previous_control, "QT")
            self.add(self.here, self.control, end)
        else:
            end = (v[5] + base[0], v[6] + base[1])
            self._arc(v, end)
        self.here, self.last = end, upper

    def _mirrored(self, control: Point, family: str) -> Point:
        """Return the reflected control point; after another kind of command the pen's position."""
        if not self.last or self.last not in family:
            return self.here
        return (2.0 * self.here[0] - control[0], 2.0 * self.here[1] - control[1])

    def _arc(self, v: list[float], end: Point) -> None:
        if end == self.here:
            return
        arc = arc_segment(self.here, end, (v[0], v[1]), v[2], v[3] != 0.0, v[4] != 0.0)
        if arc is None:
            self.add(self.here, end)
        else:
            self.add(*arc)


def arc_segment(
    begin: Point, end: Point, radii: Point, turn_deg: float, large: bool, sweep: bool
) -> tuple[Point, Point, Point, float, float] | None:
    """Return an elliptic arc by its centre, or None if it is a straight line.

    Notes
    -----
    SVG 1.1, appendix F.6.5 and F.6.6: radii that are too small are scaled up.
    """
    rx, ry = abs(radii[0]), abs(radii[1])
    if rx == 0.0 or ry == 0.0:
        return None
    c, s = math.cos(math.radians(turn_deg)), math.sin(math.radians(turn_deg))
    dx, dy = (begin[0] - end[0]) / 2.0, (begin[1] - end[1]) / 2.0
    # On the unit circle, whose image is the ellipse.
    x, y = (c * dx + s * dy) / rx, (c * dy - s * dx) / ry
    size = math.hypot(x, y)
    if size == 0.0:  # the ends coincide within rounding
        return None
    if size > 1.0:
        rx, ry, x, y = rx * size, ry * size, x / size, y / size
        size = 1.0
    rise = math.sqrt(max(0.0, 1.0 - size * size)) / size
    sign = -1.0 if large == sweep else 1.0
    u, w = sign * rise * y, -sign * rise * x
    centre = (
        c * rx * u - s * ry * w + (begin[0] + end[0]) / 2.0,
        s * rx * u + c * ry * w + (begin[1] + end[1]) / 2.0,
    )
    first, last = math.atan2(y - w, x - u), math.atan2(-y - w, -x - u)
    angle = last - first
    if sweep and angle < 0.0:
        angle += 2.0 * math.pi
    elif not sweep and angle > 0.0:
        angle -= 2.0 * math.pi
    return centre, (rx * c, rx * s), (-ry * s, ry * c), first, angle


SHAPES = ("path", "rect", "circle", "ellipse", "line", "polyline", "polygon")


def shape_subpaths(
    name: str, attributes: Mapping[str, str], viewport: tuple[float, float]
) -> list[Subpath]:
    """Return the subpaths of a shape, in pixels of its own coordinate system.

    Parameters
    ----------
    viewport
        Width and height to which percents of lengths refer; NaN if the drawing has none.

    Raises
    ------
    ValueRefused
        If a value is not understood.
    """
    if name == "path":
        return path_subpaths(attributes.get("d", ""))
    if name in ("polyline", "polygon"):
        return _polygon(numbers(attributes.get("points", "").strip()), name == "polygon")
    width, height = viewport
    full_lengths = {
        **dict.fromkeys(("x", "cx", "rx", "x1", "x2", "width"), width),
        **dict.fromkeys(("y", "cy", "ry", "y1", "y2", "height"), height),
        "r": math.hypot(width, height) / math.sqrt(2.0),
    }

    def length(key: str, signed: bool = True) -> float:
        value = pixels(key, attributes.get(key, "0"), full_lengths[key])
        if value < 0.0 and not signed:
            raise ValueRefused(f"{key} is {attributes[key]!r}, less than nothing")
        return value

    if name == "line":
        ends = ((length("x1"), length("y1")), (length("x2"), length("y2")))
        return [Subpath([ends])]
    if name == "circle":
        radius = length("r", signed=False)
        return _ellipse(length("cx"), length("cy"), radius, radius)
    radii: dict[str, float | None] = {
        key: None if attributes.get(key, "auto").strip() == "auto" else length(key, signed=False)
        for key in ("rx", "ry")
    }
    rx = radii["rx"] if radii["rx"] is not None else radii["ry"] or 0.0
    ry = radii["ry"] if radii["ry"] is not None else rx
    if name == "ellipse":
        return _ellipse(length("cx"), length("cy"), rx, ry)
    size = length("width", signed=False), length("height", signed=False)
    return _rectangle(length("x"), length("y"), size, rx, ry)


def _polygon(values: list[float], closed: bool) -> list[Subpath]:
    if len(values) % 2:
        raise ValueRefused("the points of a polyline are an odd count of numbers")
    points = list(zip(values[::2], values[1::2], strict=True))
    if closed and len(points) > 1 and points[-1] != points[0]:
        points.append(points[0])
    path = Subpath()
    path.segments.extend(pairwise(points))
    return [path] if path.segments else []


def _quarter(cx: float, cy: float, rx: float, ry: float, begin: int) -> tuple[object, ...]:
    return (cx, cy), (rx, 0.0), (0.0, ry), begin * math.pi / 2.0, math.pi / 2.0


def _ellipse(cx: float, cy: float, rx: float, ry: float) -> list[Subpath]:
    if rx == 0.0 or ry == 0.0:
        return []
    return [Subpath([_quarter(cx, cy, rx, ry, k) for k in range(4)])]  # type: ignore[misc]


def _rectangle(
    x: float, y: float, size: tuple[float, float], rx: float, ry: float
) -> list[Subpath]:
    width, height = size
    if width == 0.0 or height == 0.0:
        return []
    rx, ry = min(rx, width / 2.0), min(ry, height / 2.0)
    if rx == 0.0 or ry == 0.0:
        rx = ry = 0.0
    right, low = x + width, y + height
    corners: tuple[tuple[Point, Point, Point], ...] = (
        ((x + rx, y), (right - rx, y), (right - rx, y + ry)),
        ((right, y + ry), (right, low - ry), (right - rx, low - ry)),
        ((right - rx, low), (x + rx, low), (x + rx, low - ry)),
        ((x, low - ry), (x, y + ry), (x + rx, y + ry)),
    )
    path = Subpath()
    for k, (begin, end, centre) in enumerate(corners):
        if begin != end:
            path.segments.append((begin, end))
        if rx:
            path.segments.append(_quarter(*centre, rx, ry, (k + 3) % 4))  # type: ignore[arg-type]
    return [path]
