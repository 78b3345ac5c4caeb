"""Drawings that are grammatical but odd: paths of all commands, styles, blocks, hairpins, loops.

Of what is accepted it is checked that nothing of the drawing is lost: the stitches of a contour
cover it from its start to its end without a gap, and none leaves it by more than the placement.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path

import numpy as np

from threadline.jobs import Job, Move, read_job
from threadline.machine import load_machine

Target = tuple[str, Callable[[random.Random], bytes], Callable[[Path], object], int]
STITCHER = load_machine("stitcher")
_SLACK_M = 1e-9
_MOST_STITCHES = 3000
_LENGTHS = "1 0.5 2 3.1 10 0 -1 1e-9 0.02 1e5 2em 3mm 50% 1e400 nan .5 +4 7,5".split()  # noqa: SIM905
_TRANSFORMS = (
    "translate(20", "translate(2em,0)", "rotate(30)", "rotate(30deg)", "scale(2)", "scale(0)",
    "scale(-1,1)", "skewX(45)", "skewX(90)", "matrix(1 0 0 1 5 5)", "matrix(1 2 3)", "none",
    "translate(1)rotate(4 5 6),scale(.5)", "scale(1e200)", "scale(1e-200)", "foo(1)", "rotate()",
    "translate(1,,2)", "translate(1 2) x",
)  # fmt: skip
_STYLES = (
    "display:none !important", "display : none", "display:inline!important", "stroke:#0f0",
    "clip-path:url(#c)", "transform:rotate(10deg)", "transform:scale(2);transform-origin:5px 5px",
    "visibility:hidden", "visibility:inherit", "stroke:rgb(1,2", "stroke:inherit;fill:none",
    "d:path('M0 0')", "x:5", "display:none !wichtig", ";;;", "a", "/*", "/* */stroke:red",
    "all:unset",
)  # fmt: skip
_ODD = (
    'transform-origin="5 5"', 'transform-origin="50% left"', 'clip-path="url(#c)"', 'mask="none"',
    'display="none"', 'visibility="collapse"', 'stroke="blurple"', 'stroke="url(#g)"',
    'stroke="currentColor"', 'color="red"', 'class="k"', 'id="c"', 'stroke="hsl(9,9%,9%)"',
)  # fmt: skip
_SHEETS = (
    ".k{display:none}", "path{stroke:red}", "g > .k{visibility:hidden}", "@media print{path{}}",
    "path:hover{stroke:red}", "*{stroke:blue !important}", "path{", "#c .k,rect{fill:none}", "}{",
)  # fmt: skip


def number(rng: random.Random) -> str:
    """A coordinate: most are of a hand's size, some meet each other, some are absurd."""
    kind = rng.randrange(40)
    if rng.randrange(200) == 0:
        return rng.choice(("1e400", "nan", "-", "1e-320", "1e9", "--1", "0x1", "1.2.3", "e5"))
    if kind < 12:
        return str(rng.randrange(0, 60, 10))
    if kind < 16:
        return f"{rng.uniform(0, 0.6):.3f}"
    return f"{rng.uniform(0, 90):.{rng.randrange(4)}f}"


def path_data(rng: random.Random) -> str:
    """Commands of all families after each other, now and then a letter too many."""
    counts = {"M": 2, "L": 2, "H": 1, "V": 1, "C": 6, "S": 4, "Q": 4, "T": 2, "A": 7, "Z": 0}
    letters = "M" + "".join(rng.choices("LHVCSQTAZMlhvcsqtazm", k=rng.randrange(1, 8)))
    parts = []
    for letter in letters:
        values = [number(rng) for _ in range(counts[letter.upper()])]
        if letter in "Aa" and rng.random() < 0.95:
            values[3:5] = [rng.choice("01"), rng.choice("01")]
        parts.append(letter + rng.choice((" ", ",")).join(values))
    if rng.random() < 0.03:
        parts.insert(rng.randrange(len(parts)), rng.choice(("X", "1", "M", ",", "#")))
    if rng.random() < 0.1:  # a hairpin
        x, gap = rng.uniform(20, 120), rng.choice((0.0, 0.05, 0.6, 1.0))
        parts = [f"M20 50C{x} 50 {x} {50 + gap} 20 {50 + gap}"]
    return "".join(parts)


def shape(rng: random.Random, depth: int = 0) -> str:
    """An element with odd attributes."""
    extra = ""
    if rng.random() < 0.15:
        extra += f' transform="{rng.choice(_TRANSFORMS)}"'
    if rng.random() < 0.1:
        extra += f' style="{rng.choice(_STYLES)}"'
    if rng.random() < 0.1:
        extra += f" {rng.choice(_ODD)}"
    kind = rng.choice(("path", "path", "path", "rect", "circle", "ellipse", "poly", "g", "use"))
    if kind == "g" and depth < 4:
        inside = "".join(shape(rng, depth + 1) for _ in range(rng.randrange(3)))
        return f"<g{extra}>{inside}</g>"
    if 'stroke="' not in extra:
        extra += ' stroke="red"'
    if kind == "path":
        return f'<path d="{path_data(rng)}"{extra}/>'
    if kind == "poly":
        points = " ".join(number(rng) for _ in range(rng.choice((0, 3, 4, 6, 8))))
        return f'<{rng.choice(("polyline", "polygon"))} points="{points}"{extra}/>'
    if kind == "use":
        return f'<use href="#{rng.choice("abc")}" x="{rng.choice(_LENGTHS)}"{extra}/>'
    keys = {
        "rect": ("x", "y", "width", "height", "rx", "ry"), "circle": ("cx", "cy", "r"),
        "ellipse": ("cx", "cy", "rx", "ry"),
    }.get(kind, ())  # fmt: skip
    values = "".join(
        f' {key}="{rng.choice(_LENGTHS) if rng.random() < 0.2 else number(rng)}"' for key in keys
    )
    return f"<{kind}{values}{extra}/>"


def svg(rng: random.Random) -> bytes:
    """A page with some shapes."""
    size = rng.choice(
        ('width="120mm" height="120mm" viewBox="0 0 120 120"', 'width="90" height="90"', "",
         'viewBox="0 0 100 50"', 'width="3em"', 'viewBox="0 0 0 0"', 'width="9cm" height="50%"',
         'width="120mm" height="60mm" viewBox="-9 -9 120 120" preserveAspectRatio="xMinYMax slice"')
    )  # fmt: skip
    sheet = f"<style>{rng.choice(_SHEETS)}</style>" if rng.random() < 0.2 else ""
    body = "".join(shape(rng) for _ in range(rng.randrange(1, 4)))
    return f'<svg xmlns="http://www.w3.org/2000/svg" {size}>{sheet}{body}</svg>'.encode()


def dxf(rng: random.Random) -> bytes:
    """Entities of R12 with odd numbers, some in blocks that are inserted in each other."""

    def entity(depth: int) -> list[tuple[int, str]]:
        at = [(10, number(rng)), (20, number(rng))]
        kind = rng.choice(("LINE", "ARC", "CIRCLE", "POLYLINE", "INSERT", "POINT", "TEXT"))
        if kind == "LINE":
            return [(0, kind), (8, "A"), *at, (11, number(rng)), (21, number(rng))]
        if kind in ("ARC", "CIRCLE"):
            angles = [(50, number(rng)), (51, number(rng))] if kind == "ARC" else []
            return [(0, kind), (8, "A"), *at, (40, number(rng)), *angles]
        if kind == "POLYLINE":
            rows = [(0, kind), (8, "A"), (66, "1"), (70, rng.choice("01"))]
            for _ in range(rng.randrange(6)):
                rows += [(0, "VERTEX"), (8, "A"), (10, number(rng)), (20, number(rng))]
                rows += [(42, number(rng))] if rng.random() < 0.3 else []
            return [*rows, (0, "SEQEND")]
        if kind == "INSERT":
            rows = [(0, kind), (8, "A"), (2, f"B{rng.randrange(max(1, depth))}"), *at]
            for code in (41, 42, 50, 70, 71, 44, 45):
                rows += [(code, number(rng))] if rng.random() < 0.2 else []
            return rows
        return [(0, kind), (8, "A"), *at, (40, number(rng)), (1, "text")]

    rows = [(0, "SECTION"), (2, "HEADER"), (9, "$ACADVER"), (1, "AC1009"), (9, "$INSUNITS")]
    rows += [(70, rng.choice("44441599")), (0, "ENDSEC"), (0, "SECTION"), (2, "BLOCKS")]
    levels = rng.randrange(4)
    for k in range(levels):
        rows += [(0, "BLOCK"), (8, "0"), (2, f"B{k}"), (70, "0"), (10, "0"), (20, "0")]
        rows += [row for _ in range(rng.randrange(4)) for row in entity(k)]
        rows += [(0, "ENDBLK"), (8, "0")]
    rows += [(0, "ENDSEC"), (0, "SECTION"), (2, "ENTITIES")]
    rows += [row for _ in range(rng.randrange(1, 5)) for row in entity(levels + 1)]
    rows += [(0, "ENDSEC"), (0, "EOF")]
    return "".join(f"{code}\n{value}\n" for code, value in rows).encode()


def seam(rng: random.Random) -> bytes:
    """Points and arcs with odd settings: loops below a stitch, needles that slow down."""
    x, y, points = 0.0, 0.0, ["[0, 0]"]
    step = rng.choice((0.05, 0.3, 2.0, 20.0))
    for _ in range(rng.randrange(1, 9)):
        x, y = x + rng.uniform(-step, step), y + rng.uniform(-step, step)
        arc = rng.choice(("", "", f", bulge = {rng.uniform(-3, 3):.3f}", ", bulge = 1e300"))
        points.append(f"{{ to = [{x:.4f}, {y:.4f}]{arc} }}")
    settings = {
        "needle": ('"constant"', '"slowed"'), "motion": ('"discrete"', '"interpolated"'),
        "bow": ('"0.01 mm"', '"5 mm"', '"1 um"'), "least_stitch": ('"2 mm"', '"0.01 mm"'),
        "placement": ('"0.01 mm"', '"5 mm"'), "lock_start": ("2",), "lock_end": ("1",),
        "reverse": ("true",), "start": ('"1 mm"', '"50 mm"'), "end": ('"3 mm"',),
        "corner_angle": ('"2 deg"', '"170 deg"'), "acceleration": ('"0.01 m/s^2"', '"50 m/s^2"'),
        "allowance": ('"0.5 mm"',), "needle_acceleration": ('"1 stitch/s^2"',),
    }  # fmt: skip
    lines = [
        f"{key} = {rng.choice(values)}" for key, values in settings.items() if rng.random() < 0.25
    ]
    closed = "closed = true\n" if rng.random() < 0.4 else ""
    return (
        "[stitching]\n"
        f'stitch_length = "{rng.choice((0.2, 0.8, 2, 3, 10))} mm"\n'
        f'needle_speed = "{rng.choice((0.1, 20, 75, 900))} stitch/s"\n'
        + "\n".join(lines)
        + f'\n[[contour]]\nunit = "mm"\n{closed}points = [{", ".join(points)}]\n'
    ).encode()


def read_whole(path: Path) -> None:
    """Read a seam and check that what is drawn is sewn.

    Raises
    ------
    AssertionError
        If a contour is not covered from its start to its end, or left too far.
    """
    whole = path.name.endswith(".toml")
    given = {} if whole else {"stitch_length": "2.5 mm", "needle_speed": "20 stitch/s"}
    job: Job = read_job(path, STITCHER, **given)
    last: dict[float | str, float] = {}
    before = np.zeros(2)
    for count, move in enumerate(o for o in job if isinstance(o, Move)):
        here = np.array(move.target)
        if "stitch" in move.tags:
            tags = move.tags
            begin, end = float(tags["from_m"]), float(tags["to_m"])
            contour = tags["contour"]
            assert contour not in last or begin == last[contour], "a stretch is left out"
            last[contour] = end
            chord, arc = float(np.hypot(*(here - before))), abs(end - begin)
            bow = 0.5 * np.sqrt(max(arc * arc - chord * chord, 0.0))
            assert whole or bow <= 5e-4 + _SLACK_M, f"the drawing bows {bow} m out of a stitch"
            assert chord > 0.0, "a stitch goes nowhere"
        before = here
        if count > _MOST_STITCHES:
            return
    for contour, end in last.items():
        length = job.drawn[int(contour)].table.length_m
        # Neither the last lock nor a given end is the end of the line.
        assert whole or abs(end - length) < 1e-9 * max(1.0, length), "the end is not sewn"


def fuzz_drawings() -> dict[str, Target]:
    """Return what is fuzzed here: name, and file, maker, reader and weight of each."""
    return {
        "drawn-svg": ("a.svg", svg, read_whole, 4),
        "drawn-dxf": ("a.dxf", dxf, read_whole, 1),
        "drawn-seam": ("a.seam.toml", seam, read_whole, 2),
    }
