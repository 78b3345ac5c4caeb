"""Judge a recording. Here the simulated machine made it; your machine's file is judged alike.

Run it from the root of the repository: python examples/judge_recording.py
"""

import tempfile
from pathlib import Path

import threadline as tl

proof = tl.prove("examples/x-180.prg", "lathe-winder", interpolation="linear", level="nominal")

with tempfile.TemporaryDirectory() as folder:
    file = Path(folder) / "x.npz"
    proof.record(file)  # times, positions, what was commanded, and what the plan was made from
    judged = tl.judge(file)  # job, machine and options are read from the recording

same = judged.result("contour_error").measured == proof.result("contour_error").measured
print("same contour error as in the proof:", same)
