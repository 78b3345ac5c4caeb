"""Seams, embroidery designs and move lists, drawn at random and written in several ways."""

from __future__ import annotations

import io
import random
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from decimal import Decimal
from types import MappingProxyType
from typing import Any

import pystitch
from tools.fuzz_designs import WRITERS
from tools.fuzz_works import Change, Work, Written, library, machine_changes

_UNIT = Decimal("0.0254")  # a thousandth of an inch, mm
_INCH = Decimal("25.4")

# --- seams ---


@dataclass(frozen=True)
class Seam:
    """A seam of one contour: lengths in thousandths of an inch."""

    points: tuple[tuple[int, int], ...]
    stitch: int
    speed: int
    settings: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class SeamStyle:
    """How a seam is written: by default in the plainest way."""

    inches: bool = False
    split: bool = False
    dwell: bool = False
    comments: bool = False
    names: bool = False
    words: bool = False
    by: tuple[int, int] = (0, 0)
    mirrored: tuple[int, int] = (1, 1)


def seam_text(rng: random.Random, seam: Seam, style: SeamStyle) -> str:
    """Return a seam file; without a style nothing in it is at random."""
    unit, one = ("in", _UNIT / _INCH) if style.inches else ("mm", _UNIT)
    points = [
        ((x + by) * way for x, by, way in zip(point, style.by, style.mirrored, strict=True))
        for point in seam.points
    ]
    places = [tuple(Decimal(x) * one for x in point) for point in points]
    if style.split:
        at = rng.randrange(1, len(places))
        a, b = places[at - 1], places[at]
        share = rng.choice((Decimal("0.5"), Decimal("0.25")))
        places.insert(at, tuple(p + share * (q - p) for p, q in zip(a, b, strict=True)))
    settings = {
        "stitch_length": f'"{seam.stitch * one} {unit}"',
        "needle_speed": f'"{seam.speed} stitch/s"',
        **{key: f'"{value}"' for key, value in seam.settings.items()},
    }
    if style.dwell:
        settings["trim"] = '"0 s"'
    if style.words:
        settings["needle_speed"] = f'"{seam.speed}.0 stitch/s"'
        settings["stitch_length"] = f'"{seam.stitch * _UNIT / 1000} m"'
        settings |= {"lock_start": "0", "reverse": "false"}
        settings = dict(rng.sample(list(settings.items()), len(settings)))
    lines = ["[stitching]", *(f"{key} = {value}" for key, value in settings.items())]
    if style.names:
        lines += ["[[seam]]", f'name = "n{rng.randrange(10**6)}"']
    rows = ", ".join(f"[{x}, {y}]" for x, y in places)
    contour = ["[[contour]]", f'unit = "{unit}"', f"points = [{rows}]"]
    lines += contour if not style.words else [contour[0], contour[2], contour[1]]
    return "\n".join(_remarked(rng, lines) if style.comments else lines) + "\n"


def _remarked(rng: random.Random, lines: Sequence[str]) -> list[str]:
    found = []
    for line in lines:
        if rng.random() < 0.4:
            found.append(rng.choice(("", "# a word", '# unit = "in"', "   ")))
        found.append(line + rng.choice(("", "  # [[contour]]", " # dwell = 3")))
    return found


class Stitcher:
    """Seams on the stitcher."""

    name = "stitcher"
    often: Mapping[str, int] = MappingProxyType({})

    def __init__(self) -> None:
        styles = {
            "inches": SeamStyle(inches=True),
            "a move split in two": SeamStyle(split=True),
            "a dwell of 0": SeamStyle(dwell=True),
            "comments": SeamStyle(comments=True),
            "other words for the same moves": SeamStyle(words=True),
            "other names: labels, numbers, file": SeamStyle(names=True),
        }
        self.changes: dict[str, Change] = {
            **{change: self._in_style(style) for change, style in styles.items()},
            "mirrored": lambda rng, work: self._styled(
                rng, work, SeamStyle(mirrored=rng.choice(((-1, 1), (1, -1), (-1, -1))))
            ),
            "shifted": lambda rng, work: self._styled(
                rng, work, SeamStyle(by=(rng.randint(-400, 400), rng.randint(-400, 400)))
            ),
            **machine_changes(self.plain),
        }

    def drawn(self, rng: random.Random, number: int) -> Work:
        """Return a line of a few stitches, or two with a corner."""
        machine, text, overlays = library("stitcher")
        stitch, speed = rng.choice((80, 100)), rng.choice((20, 40, 60))
        place = rng.randint(1, 4) * 100, rng.randint(1, 4) * 100
        points = [place]
        for _ in range(rng.randint(1, 2)):
            x, y = rng.choice(((1, 0), (0, 1), (0.6, 0.8), (-0.8, 0.6)))
            way = stitch * rng.randint(3, 6)
            place = round(place[0] + x * way), round(place[1] + y * way)
            points.append(place)
        settings = {} if number % 4 else {"needle": "follow", "needle_slowest": "5 stitch/s"}
        words = {"interpolation": rng.choice(("auto", "auto", "linear"))}
        return Work(machine, text, overlays, words, Seam(tuple(points), stitch, speed, settings))

    def lacks(self, *_: object) -> bool:
        """Return False: every change can be made."""
        return False

    def plain(self, work: Work) -> Written:
        """Return the seam in mm."""
        return self._styled(random.Random(0), work, SeamStyle())

    def _in_style(self, style: SeamStyle) -> Change:
        return lambda rng, work: self._styled(rng, work, style)

    def _styled(self, rng: random.Random, work: Work, style: SeamStyle) -> Written:
        text = seam_text(rng, work.drawn, style)
        name = f"s{rng.randrange(10**6)}" if style.names else "job"
        shifted = style.by != (0, 0)
        moved = style.split or style.inches or shifted or style.mirrored != (1, 1)
        ways = zip("XY", style.by, style.mirrored, strict=True)
        by = {axis: float(way * _UNIT) * 1e-3 * sign for axis, way, sign in ways}
        return Written(
            f"{name}.seam.toml", text.encode(), work.machine, work.words, moved=moved,
            signs=dict(zip("XY", style.mirrored, strict=True)), by=by, from_start=shifted,
        )  # fmt: skip


# --- designs ---

Stitches = tuple[tuple[int, int], ...]
_FORMATS = ("exp", "jef", "u01", "xxx")


class Embroiderer:
    """Designs on the schiffli frame, every fourth on the machine with one head."""

    name = "schiffli-frame"
    often: Mapping[str, int] = MappingProxyType({})

    def __init__(self) -> None:
        self.changes: dict[str, Change] = {
            "inches": lambda rng, work: self._written(
                work, work.drawn, suffix=rng.choice(_FORMATS)
            ),
            "a move split in two": lambda rng, work: self._jumping(rng, work, half=True),
            "a dwell of 0": lambda rng, work: self._jumping(rng, work, half=False),
            "comments": lambda rng, work: self._written(
                work, work.drawn, author=f"a word {rng.randrange(10**6)}"
            ),
            "other words for the same moves": lambda rng, work: self._written(
                work, work.drawn, suffix=rng.choice(("pes", "vp3"))
            ),
            "other names: labels, numbers, file": lambda rng, work: self._written(
                work, work.drawn, name=f"n{rng.randrange(10**6)}"
            ),
            "mirrored": lambda rng, work: self._scaled(
                work, *rng.choice(((-1, 1), (1, -1), (-1, -1)))
            ),
            "shifted": self._shifted,
            **machine_changes(self.plain),
        }

    def drawn(self, rng: random.Random, number: int) -> Work:
        """Return three to six stitches."""
        name = "table-embroiderer" if number % 4 == 3 else "schiffli-frame"
        machine, text, overlays = library(name)
        places = [(0, 0)]
        for _ in range(rng.randint(3, 6)):
            x, y = places[-1]
            x, y = x + rng.randint(-40, 40), y + rng.randint(-40, 40)
            places.append((x, y) if (x, y) != places[-1] else (x + 8, y))
        # The search for the speed of each turn takes most of the time.
        words = {} if number % 8 == 0 else {"feed": f"{rng.choice((90, 120, 150))} stitch/min"}
        return Work(machine, text, overlays, words, tuple(places))

    def lacks(self, *_: object) -> bool:
        """Return False: every change can be made."""
        return False

    def plain(self, work: Work) -> Written:
        """Return the design as Tajima's file."""
        return self._written(work, work.drawn)

    def _written(
        self, work: Work, places: Stitches, *, jumps: Mapping[int, tuple[int, int]] | None = None,
        suffix: str = "dst", name: str = "job", author: str = "",
    ) -> Written:  # fmt: skip
        design = pystitch.EmbPattern()
        for k, (x, y) in enumerate(places):
            for at in filter(None, [(jumps or {}).get(k)]):
                design.add_stitch_absolute(pystitch.JUMP, *at)
            design.add_stitch_absolute(pystitch.STITCH, x, y)
        design.end()
        design.extras |= {"name": name, "author": author}
        if author:
            design.extras["copyright"] = author
        out = io.BytesIO()
        WRITERS[suffix](design, out)
        return Written(f"{name}.{suffix}", out.getvalue(), work.machine, work.words)

    def _jumping(self, rng: random.Random, work: Work, *, half: bool) -> Written:
        """Return the design with a jump before a stitch: on half of its way, or of no way."""
        k = rng.randrange(1, len(work.drawn))
        (x, y), (to_x, to_y) = work.drawn[k - 1], work.drawn[k]
        at = ((x + to_x) // 2, (y + to_y) // 2) if half else (x, y)
        return self._written(work, work.drawn, jumps={k: at})

    def _scaled(self, work: Work, x: int, y: int) -> Written:
        places = tuple((x * a, y * b) for a, b in work.drawn)
        return replace(self._written(work, places), signs={"X": x, "Y": y})

    def _shifted(self, rng: random.Random, work: Work) -> Written:
        by = rng.randint(-60, 60), rng.randint(-60, 60)
        places = tuple((x + by[0], y + by[1]) for x, y in work.drawn)
        way = {"X": 1e-4 * by[0], "Y": -1e-4 * by[1]}  # the rows of a design count downwards
        return replace(self._written(work, places), by=way, from_start=True)


# --- move lists ---

Operation = dict[str, Any]


class Placer:
    """Move lists on the letter placer."""

    name = "letter-placer"
    often: Mapping[str, int] = MappingProxyType({})

    def __init__(self) -> None:
        self.changes: dict[str, Change] = {
            "inches": lambda _, work: self._listed(work, inches=True),
            "a move split in two": self._split,
            "a dwell of 0": self._still,
            "comments": lambda rng, work: self._listed(work, remarks=rng),
            "other words for the same moves": lambda rng, work: self._listed(work, words=rng),
            "other names: labels, numbers, file": lambda rng, work: self._listed(work, names=rng),
            **machine_changes(self.plain),
        }

    def drawn(self, rng: random.Random, _: int) -> Work:
        """Return a stroke or two, with dwells and an output between them."""
        machine, text, overlays = library("letter-placer+whole-scans+own-damping")
        first: Operation = {"step": "start", "valve": "main_air"}
        axis, here, there = rng.choice(
            (("Z", "z_is_up", "z_is_down"), ("X", "x_is_left", "x_is_right"))
        )
        far = 100 if axis == "Z" else 200
        found = [first, {"wait": here}, {"step": "go", "move": {axis: far}}, {"wait": there}]
        found.append({"dwell": 10 * rng.randint(4, 20)})
        if axis == "Z" and rng.random() < 0.5:
            found += [{"output": "knife"}, {"dwell": 10 * rng.randint(4, 12)}]
            found.append({"output": "knife", "on": False})
        if rng.random() < 0.5:
            found += [{"step": "back", "move": {axis: 0}}, {"wait": here}]
            found.append({"dwell": 10 * rng.randint(4, 20)})
        words = {"shaper": rng.choice(("zv", "none"))}
        return Work(machine, text, overlays, words, tuple(found))

    def lacks(self, *_: object) -> bool:
        """Return False: every change can be made."""
        return False

    def plain(self, work: Work) -> Written:
        """Return the move list in mm and ms."""
        return self._listed(work)

    def _listed(
        self, work: Work, drawn: Sequence[Operation] | None = None, *, inches: bool = False,
        remarks: random.Random | None = None, words: random.Random | None = None,
        names: random.Random | None = None,
    ) -> Written:  # fmt: skip
        name = f"n{names.randrange(10**6)}" if names else "job"
        lines, steps = [f'name = "{name}"'], {}
        for number, one in enumerate(drawn or work.drawn):
            rows = []
            for key, value in one.items():
                text = _toml_value(value, inches=inches, seconds=words is not None)
                if key == "step" and names:
                    text, steps[f"{value}{number}"] = f'"{value}{number}"', value
                rows.append(f"{key} = {text}")
            if words:
                words.shuffle(rows)
            lines += ["[[operation]]", *rows]
        if remarks:
            lines = _remarked(remarks, lines)
        data = ("\n".join(lines) + "\n").encode()
        return Written(f"{name}.toml", data, work.machine, work.words, names=steps)

    def _split(self, rng: random.Random, work: Work) -> Written:
        """Return a move list in which a dwell is two."""
        at = rng.choice([k for k, one in enumerate(work.drawn) if "dwell" in one])
        whole = work.drawn[at]["dwell"]
        part = 10 * rng.randint(1, whole // 10 - 1)
        two = [{"dwell": part}, {"dwell": whole - part}]
        drawn = [*work.drawn[:at], *two, *work.drawn[at + 1 :]]
        return replace(self._listed(work, drawn), switched=True)

    def _still(self, rng: random.Random, work: Work) -> Written:
        """Return a move list with a dwell of 0 behind a wait."""
        at = rng.choice([k for k, one in enumerate(work.drawn) if "wait" in one])
        drawn = [*work.drawn[: at + 1], {"dwell": 0}, *work.drawn[at + 1 :]]
        return replace(self._listed(work, drawn), switched=True)


def _toml_value(value: Any, *, inches: bool, seconds: bool) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, int):
        return f'"{Decimal(value) / 1000} s"' if seconds else f'"{value} ms"'
    rows = []
    for axis, mm in value.items():
        way = f"{Decimal(mm) / _INCH:.17f} in" if inches else f"{mm} mm"
        rows.append(f'{axis} = "{way}"')
    return f"{{ {', '.join(rows)} }}"
