"""The same moves in every dialect, and the same machine files, written in another way."""

from __future__ import annotations

import dataclasses
import random
import re
from dataclasses import dataclass
from decimal import Decimal

Move = tuple[bool, dict[str, Decimal], int]
"""Whether it is a rapid, where it ends (mm or degrees), and F of it in mm/min."""

PRINTERS = ("marlin", "klipper", "reprapfirmware")
DIALECTS = ("winder", "linuxcnc", "grbl", "fluidnc", "marlin", "fanuc")
_INCH = Decimal("25.4")
_UNIT = Decimal("0.0254")  # a thousandth of an inch: what has few digits in both units


@dataclass(frozen=True)
class Style:
    """How the same moves are written: by default in the plainest way."""

    inches: bool = False
    absolute: bool = False
    comments: bool = False
    numbers: bool = False
    words: bool = False
    split: bool = False
    dwell: bool = False


def moves_of(rng: random.Random) -> list[Move]:
    """Return a few moves from 0 that a small machine has room for."""
    place = {"X": Decimal(0), "Y": Decimal(0)}
    turns = rng.random() < 0.5
    if turns:
        place["A"] = Decimal(0)
    found: list[Move] = []
    for _ in range(rng.randint(2, 6)):
        for axis in rng.sample(sorted(place), rng.randint(1, len(place))):
            steps = rng.choice((1, -1)) * 2 * rng.randint(20, 150)
            far = abs(place[axis] + steps * _UNIT) > 15
            place[axis] += (-steps if far else steps) * _UNIT
        found.append((bool(found) and rng.random() < 0.15, dict(place), 127 * rng.randint(4, 20)))
    return found


def style_of(rng: random.Random, moves: list[Move], dialect: str) -> Style:
    """Return a random way to write moves; F of a move of A alone is no length everywhere."""
    turns = "A" in moves[0][1]
    chances = {field.name: rng.random() < 0.4 for field in dataclasses.fields(Style)}
    chances["inches"] &= not turns and dialect != "marlin"  # its G20 is an option of the build
    chances["numbers"] &= dialect != "marlin"  # a number asks for a checksum there
    return Style(**chances)


def text_of(rng: random.Random, moves: list[Move], style: Style, dialect: str) -> str:
    """Return the program of moves in a dialect; without a style nothing in it is at random."""
    unit = _INCH if style.inches else Decimal(1)
    lines = ["G20" if style.inches else "G21", "G90" if style.absolute else "G91"]
    if style.dwell:
        lines.append("G4 P0")  # it is at rest there anyway
    last = {axis: Decimal(0) for axis in moves[0][1]}
    modal: tuple[bool | None, int | None] = None, None
    for rapid, place, feed in moves:
        ends = [place]
        if style.split and not rapid and rng.random() < 0.5:
            ends.insert(0, {axis: (last[axis] + place[axis]) / 2 for axis in place})
        for end in ends:
            words = []
            for axis in end:
                way = end[axis] if style.absolute else end[axis] - last[axis]
                if end[axis] != last[axis] or (style.words and rng.random() < 0.3):
                    words.append(f"{axis}{_number(rng, way / (1 if axis == 'A' else unit), style)}")
            if not words:
                continue
            if style.words:
                rng.shuffle(words)
            if modal[0] != rapid or style.words or dialect in PRINTERS:
                words.insert(0, "G0" if rapid else "G1")
            if not rapid and (modal[1] != feed or style.words):
                words.append(f"F{_number(rng, Decimal(feed) / unit, style)}")
            modal = rapid, modal[1] if rapid else feed
            lines.append(" ".join(words))
            last = end
    if style.dwell:
        lines.append("G4 P0")
    if dialect not in ("klipper", "reprapfirmware"):  # no word of theirs, and deletes a file
        lines.append("M30")
    return "\n".join(_with_remarks(rng, lines, style, dialect)) + "\n"


def _number(rng: random.Random, value: Decimal, style: Style) -> str:
    text = format(value.normalize(), "f")
    if not style.words:
        return text
    text += "" if "." in text else "."
    return text + "0" * rng.randrange(3)


def _with_remarks(rng: random.Random, lines: list[str], style: Style, dialect: str) -> list[str]:
    found = []
    for number, line in enumerate(lines, start=1):
        if style.comments and rng.random() < 0.3:
            found.append(rng.choice(("", "; a word", "   ")))
        text = f"N{10 * number} {line}" if style.numbers else line
        if style.comments and rng.random() < 0.3:
            text += " ; a word" if dialect in PRINTERS or rng.random() < 0.5 else " (X1 M30)"
        found.append(text)
    return found


# --- machine files ---

_UNITS = {
    "mm": ("m", -3), "ms": ("s", -3), "us": ("ms", -3), "A": ("mA", 3), "mH": ("H", -3),
    "V": ("mV", 3), "kg": ("g", 3), "N": ("kN", -3), "Hz": ("kHz", -3), "m/s": ("mm/s", 3),
    "m/s^2": ("mm/s^2", 3), "bar": ("mbar", 3),
}  # fmt: skip
_QUANTITY = re.compile(r'"(-?\d+(?:\.\d+)?(?:e-?\d+)?) ([^ ,"]+)(?=[ ,"])')


def in_other_units(rng: random.Random, text: str) -> str:
    """Return a machine file with some of its numbers in units a power of ten away."""

    def other(found: re.Match[str]) -> str:
        known = _UNITS.get(found[2])
        if known is None or rng.random() < 0.5:
            return found[0]
        return f'"{Decimal(found[1]).scaleb(known[1]):f} {known[0]}'

    return _QUANTITY.sub(other, text)


def in_another_order(rng: random.Random, text: str) -> str:
    """Return a machine file with its tables, and the keys within them, in another order."""
    head, *tables = re.split(r"(?m)^(?=\[)", text)
    parts = []
    for table in tables:
        first, *lines = table.splitlines()
        pairs = [line for line in lines if line.strip() and not line.startswith("#")]
        if all(re.match(r"[\w.]+ = ", x) and x.count("[") == x.count("]") for x in pairs):
            rng.shuffle(pairs)
            lines = [f"{line}  # {rng.random()}" for line in pairs]
        parts.append("\n".join([first, *lines]))
    if not any(part.startswith("[[") for part in parts):
        rng.shuffle(parts)
    return head + "\n" + "\n".join(parts) + "\n"
