"""Short jobs for every kind of machine: what the fuzzers run, one after the other, by the thousand.

Text and nothing else, so that a tool that judges recordings need not load the command line.
"""

from __future__ import annotations

PROGRAM = "%\nO 1;\nN 10 G91 G01 X 5 F 2160;\nN 15 X -5 A 3;\nN 20 M30;\n%\n"
PROGRAM_OF_ALL_AXES = "G21\nG91\nG1 X4 Y1 A6 F1800\nX4 Y-1 A6\nX-3\nM30\n"
"""Each axis of the winder moves, so that each can be hidden."""

DRAWN_SEAM = """
[drawing]
file = "line.csv"

[stitching]
stitch_length = "2.5 mm"
needle_speed = "40 stitch/s"
"""
"""Names a drawing, which is one more input."""

SEAM = """
[stitching]
stitch_length = "2.5 mm"
needle_speed = "20 stitch/s"

[[contour]]
unit = "mm"
points = [[10, 10], [40, 10], [40, 15]]
"""
FOLLOWED_SEAM = SEAM.replace(
    "[[contour",
    """needle = "follow"
needle_slowest = "10 stitch/s"
needle_acceleration = "2000 stitch/s^2"

[[contour""",
)
"""A needle that follows the head: its turns differ in length, and it waits where the head does."""
PROGRAM_OF_STEPS = "G21\nG90\nG1 X20 A60 F3000\nX30 A-20\nX5\nM2\n"
MOVES = """
name = "short"

[[operation]]
step = "start"
valve = "main_air"

[[operation]]
step = "descend"
move = { Z = "100 mm" }

[[operation]]
wait = "z_is_down"

[[operation]]
dwell = "100 ms"
"""
# Tajima's records of three bytes: 0.9 mm along X, X, Y, back along X, and the end.
DESIGN = b"LA:short           \rST:      5\rCO:  0\r".ljust(512) + bytes.fromhex(
    "040003 040003 200003 080003 080003 0000f3"
)
