"""Numbers, lengths, transforms and colours in the notation of SVG."""

from __future__ import annotations

import colorsys
import math
import re

import numpy as np

from threadline.arrays import FloatArray

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
"""CSS pixels in each unit; a number without unit is in pixels."""
_LENGTH_REMEDY = "Write it in mm, cm, in, pt, pc, px or %, like 12.5mm, without a blank."
_FUNCTION = re.compile(r"([a-zA-Z]+)\s*\(([^()]*)\)\s*,?\s*")
_ANGLES = {"deg": 1.0, "rad": math.degrees(1.0), "grad": 0.9, "turn": 360.0}
_COUNTS = {
    "matrix": (6,), "translate": (1, 2), "scale": (1, 2), "rotate": (1, 3), "skewX": (1,),
    "skewY": (1,), "translateX": (1,), "translateY": (1,), "scaleX": (1,), "scaleY": (1,),
}  # fmt: skip
_IN_STYLES_ALONE = ("translateX", "translateY", "scaleX", "scaleY")
_HEX = re.compile(r"#([0-9a-f]{3,4}|[0-9a-f]{6}|[0-9a-f]{8})")
_CHANNELS = re.compile(r"(rgb|hsl)a?\(\s*([^()]*?)\s*\)")


class ValueRefused(ValueError):  # noqa: N818 - it names what was refused
    """A value that is not understood; ``remedy`` says what to write instead."""

    def __init__(self, message: str, remedy: str = "") -> None:
        super().__init__(message)
        self.remedy = remedy


def shown(text: str) -> str:
    """Return a text for a message: in quotes, and not too long."""
    return repr(text if len(text) <= SHOWN else text[:SHOWN] + "...")


def pixels(key: str, written: str, whole: float = math.nan) -> float:
    """Return a length in pixels; ``whole`` is that of 100 %, NaN where a share has no meaning.

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
        raise ValueRefused(f"{key} is {shown(written)}, no length that can be sewn", _LENGTH_REMEDY)
    return value


def numbers(text: str) -> list[float]:
    """Return numbers that are separated by blanks, commas or only a sign.

    Raises
    ------
    ValueRefused
        If there is anything else.
    """
    found: list[float] = []
    at = 0
    while match := _ITEM.match(text, at):
        found.append(float(match[1]))
        at = match.end()
    if text[at:].strip() or text.rstrip().endswith(","):
        raise ValueRefused(f"{shown(text[at:] or text)} is no number")
    if not all(map(math.isfinite, found)):
        raise ValueRefused("a number is not finite")
    return found


def transform(written: str, in_style: bool = False) -> FloatArray:
    """Return the (3, 3) matrix of a list of transforms.

    Parameters
    ----------
    in_style
        Whether the text is from a style, where lengths and angles have units; in an attribute they
        are numbers alone, in pixels and degrees.

    Raises
    ------
    ValueRefused
        If the text is not a list of transforms.
    """
    result = np.eye(3)
    if written.strip() in ("", "none"):
        return result
    written, at = written.strip(), 0
    while at < len(written):
        match = _FUNCTION.match(written, at)
        if match is None:
            raise ValueRefused(f"the transform {shown(written[at:])} is not understood")
        result = result @ _function(match[1], match[2], in_style)
        at = match.end()
    if not np.isfinite(result).all():
        raise ValueRefused("a number of a transform is not finite")
    return result


def _function(name: str, inside: str, in_style: bool) -> FloatArray:
    said = f"the transform {shown(f'{name}({inside})')}"
    if name not in _COUNTS or (name in _IN_STYLES_ALONE and not in_style):
        raise ValueRefused(f"{said} is not understood")
    try:
        v = _styled(name, inside) if in_style else numbers(inside.strip())
    except ValueRefused:
        raise ValueRefused(f"{said} is not understood", "Write plain numbers.") from None
    if len(v) not in _COUNTS[name]:
        wanted = " or ".join(map(str, _COUNTS[name]))
        raise ValueRefused(f"{said} has {len(v)} numbers, not {wanted}")
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


def _styled(name: str, inside: str) -> list[float]:
    """Return the numbers of a function of a style sheet, lengths in px, angles in degrees."""
    found = []
    for part in inside.split(","):
        match = _LENGTH.fullmatch(part.strip())
        if match is None:
            raise ValueRefused(part)
        value, unit = float(match[1]), match[2]
        if name in ("rotate", "skewX", "skewY"):
            good = unit in _ANGLES or (value == 0.0 and not unit)
            value *= _ANGLES.get(unit, 1.0)
        elif name.startswith("translate"):
            good = unit in PIXELS and bool(unit or value == 0.0)
            value *= PIXELS.get(unit, 1.0)
        else:
            good = not unit
        if not good:
            raise ValueRefused(part)
        found.append(value)
    return found


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
    from svgelements import Color  # it knows the names

    named = Color(text) if text.isalpha() else None
    if named is None or (text != "black" and not (named.red or named.green or named.blue)):
        raise ValueRefused(f"{shown(written)} is no colour that is known", "Write it like #ff0000.")
    return f"#{named.red:02x}{named.green:02x}{named.blue:02x}"


def _channels(kind: str, inside: str, written: str) -> str:
    parts = [part for part in re.split(r"[\s,/]+", inside) if part]
    found = [_LENGTH.fullmatch(part) for part in parts]
    if len(parts) not in (3, 4) or any(m is None or m[2] not in ("", "%", "deg") for m in found):
        raise ValueRefused(f"{shown(written)} is no colour that is known", "Write it like #ff0000.")
    share = [float(m[1]) / 100.0 if m[2] == "%" else float(m[1]) for m in found if m]
    if len(share) == 4 and share[3] <= 0.0:
        return "none"
    if kind == "hsl":
        rgb = colorsys.hls_to_rgb(share[0] / 360.0 % 1.0, share[2], share[1])
    else:
        rgb = tuple(  # type: ignore[assignment]  # three of them
            value if m and m[2] == "%" else value / 255.0
            for value, m in zip(share[:3], found[:3], strict=True)
        )
    return "#" + "".join(f"{round(255 * min(1.0, max(0.0, value))):02x}" for value in rgb)
