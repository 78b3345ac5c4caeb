"""Write a faster program for a controller with grbl, and print its first lines.

Run it from the root of the repository: python examples/grbl_program.py
"""

import tempfile
from pathlib import Path

import threadline as tl

JOB, MACHINE = "examples/helix.gcode", "stepper-winder"

for feed in ("F 6000", "F 18000"):
    proof = tl.prove(JOB, MACHINE, feed=feed, level="nominal")
    verdict = "in spec" if proof.passed else "out of spec"
    print(f"{feed}: {proof.plan.duration_s:.2f} s, {verdict}")

with tempfile.TemporaryDirectory() as folder:
    out = Path(folder) / "helix.gcode"
    tl.compile(JOB, MACHINE, "grbl", out, feed="F 18000")
    print(*out.read_text(encoding="utf-8").splitlines()[:6], sep="\n")
