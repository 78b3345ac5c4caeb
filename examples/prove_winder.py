"""Prove a winding program, then say what limits it and keep the proof.

Run it from the root of the repository: python examples/prove_winder.py
"""

import tempfile
from pathlib import Path

import threadline as tl

proof = tl.prove("examples/x-180.prg", "lathe-winder", interpolation="linear")
print(proof)  # at most ten lines; a notebook shows a table

worst = proof.result("contour_error")
print(f"worst error {1e3 * worst.measured:.2f} mm, in line {worst.job_line} of the program")

with tempfile.TemporaryDirectory() as folder:
    written = proof.write(Path(folder) / "x.proof.json")  # `threadline verify` checks such a file
    print(f"{written.path.name} has SHA-256 {written.sha256[:12]}...")
