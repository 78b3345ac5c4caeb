"""Write a part program of any length: ``python -m tools.big_program BLOCKS FILE``.

A mandrel that turns for ever under a carriage that goes to and fro: what a long winding is.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

CHUNK = 100_000


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("blocks", type=int)
    parser.add_argument("file", type=Path)
    arguments = parser.parse_args()
    with arguments.file.open("w") as file:
        file.write("%\nO 1;\nN 1 G01 F 2000;\nN 2 G90;\n")
        for first in range(0, arguments.blocks, CHUNK):
            k = np.arange(first, min(first + CHUNK, arguments.blocks))
            rows = zip(
                k.tolist(),
                (k * 0.4).tolist(),
                (200.0 * np.sin(k * 0.003)).tolist(),
                (50.0 + 40.0 * np.cos(k * 0.003)).tolist(),
                strict=True,
            )
            file.write("".join(f"N{n} A{a:.3f} X{x:.3f} Y{y:.3f};\n" for n, a, x, y in rows))
        file.write("M30;\n%\n")


if __name__ == "__main__":
    main()
