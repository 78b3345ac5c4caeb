"""Writes a seam of any number of stitches: rows forth and back, 0.5 m wide, 0.28 m high.

``python -m tools.long_seam 1e6 FOLDER`` writes ``long.csv`` and ``long.seam.toml``.
"""

from __future__ import annotations

import sys
from pathlib import Path

STITCH_MM, WIDTH_MM, HEIGHT_MM, SPEED_HZ = 0.5, 500.0, 280.0, 200.0
_SEAM = f"""[drawing]
file = "long.csv"

[stitching]
stitch_length = "{STITCH_MM:g} mm"
needle_speed = "{SPEED_HZ:g} stitch/s"
motion = "discrete"
"""


def write_long_seam(stitches: int, folder: Path) -> Path:
    """Write the drawing and the seam file; return the latter."""
    rows = max(1, round(stitches * STITCH_MM / WIDTH_MM))
    lines = ["x [mm],y [mm]"]
    for row in range(rows):
        x, y = 0.5 * WIDTH_MM, HEIGHT_MM * (row / rows - 0.5)
        begin, end = (-x, x) if row % 2 == 0 else (x, -x)
        lines += [f"{begin:g},{y:.4f}", f"{end:g},{y:.4f}"]
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "long.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    seam = folder / "long.seam.toml"
    seam.write_text(_SEAM, encoding="utf-8")
    return seam


if __name__ == "__main__":
    print(write_long_seam(int(float(sys.argv[1])), Path(sys.argv[2])))
