"""Write a winding program of half a day: ``python -m tools.long_winding FILE [MOVES]``.

Circuits of 55 degrees on a tube of 100 mm by 300 mm, each turned on from the one before by a
band; 14 moves along the tube and five about each of its ends. Positions have three
decimals, as planners write them. F counts a degree as a millimetre: 8563 moves take 12 hours.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

_RADIUS_MM, _LENGTH_MM, _ANGLE_DEG = 50.0, 300.0, 55.0
_ALONG, _ABOUT = 14, 5  # moves
_DWELL_DEG, _BAND_DEG = 190.0, 4.63
_F = 480.54


def blocks() -> Iterator[str]:
    """Yield a block for each move, without end."""
    x_mm, a_deg, forth = 0.0, 0.0, True
    turn_deg = math.degrees(_LENGTH_MM * math.tan(math.radians(_ANGLE_DEG)) / _RADIUS_MM)
    while True:
        way_mm = _LENGTH_MM if forth else -_LENGTH_MM
        for _ in range(_ALONG):
            x_mm += way_mm / _ALONG
            a_deg += turn_deg / _ALONG
            yield f"G1 X{abs(x_mm):.3f} A{a_deg:.3f}"
        for _ in range(_ABOUT):
            a_deg += (_DWELL_DEG + (0.0 if forth else _BAND_DEG)) / _ABOUT
            yield f"G1 A{a_deg:.3f}"
        forth = not forth


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("moves", type=int, nargs="?", default=8563)
    arguments = parser.parse_args()
    body = islice(blocks(), arguments.moves)
    text = "\n".join([f"G21 G90 G94 F{_F:g}", *body, "M30\n"])
    arguments.file.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
