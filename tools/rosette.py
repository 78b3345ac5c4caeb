"""Makes ``examples/rosette.dst``: a small design with all that an embroidery frame has to do.

    python -m tools.rosette examples/rosette.dst

Petals in satin, an outline in running stitches, a second colour, a trim, and one stitch of 16.5 mm
that the format holds as a jump and a stitch. A few hundred stitches: proved in a second or two.
"""

from __future__ import annotations

import sys
from math import cos, pi, sin

from pystitch import COLOR_CHANGE, JUMP, STITCH, TRIM, EmbPattern, write_dst

UNIT = 10.0  # in a millimetre
PETALS, ROWS = 5, 22
INNER, OUTER, WIDTH = 4.0, 15.0, 4.2


def petal(angle: float) -> list[tuple[float, float]]:
    """Return satin stitches across a petal, from side to side."""
    found = []
    for row in range(ROWS):
        share = row / (ROWS - 1)
        along = INNER + share * (OUTER - INNER)
        half = 0.3 + 0.5 * WIDTH * sin(pi * share)
        side = half if row % 2 else -half
        found.append(
            (along * cos(angle) - side * sin(angle), along * sin(angle) + side * cos(angle))
        )
    return found


def design() -> EmbPattern:
    """Return the design; Y of the library points down."""
    pattern = EmbPattern()

    def add(command: int, x: float, y: float) -> None:
        pattern.add_stitch_absolute(command, round(x * UNIT), round(-y * UNIT))

    for k in range(PETALS):
        points = petal(2.0 * pi * k / PETALS)
        if k:
            add(JUMP, *points[0])
        for x, y in points:
            add(STITCH, x, y)
    pattern.add_command(TRIM)
    pattern.add_command(COLOR_CHANGE)
    ring = [(17.5 * cos(pi * k / 30), 17.5 * sin(pi * k / 30)) for k in range(61)]
    add(JUMP, *ring[0])
    for x, y in ring:
        add(STITCH, x, y)
    # The longest move: 16.5 mm along X at once.
    add(JUMP, 17.5 - 12.1, 0.0)
    add(STITCH, 1.0, 0.0)
    for k in range(13):
        add(STITCH, 2.0 * cos(pi * k / 6), 2.0 * sin(pi * k / 6))
    pattern.end()
    return pattern


if __name__ == "__main__":
    write_dst(design(), sys.argv[1])
