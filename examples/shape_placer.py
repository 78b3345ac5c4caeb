"""Prove a pick-and-place cycle with and without an input shaper on its valves.

Run it from the root of the repository: python examples/shape_placer.py
"""

import threadline as tl

MACHINE = "letter-placer+whole-scans+own-damping"  # the library machine with two overlays

for shaper in (None, "zv"):
    proof = tl.prove("examples/letter-cycle.toml", MACHINE, shaper=shaper, level="nominal")
    swing = proof.result("residual_vibration")
    print(
        f"shaper {shaper}: {'in spec' if proof.passed else 'out of spec'}, "
        f"cycle {proof.plan.duration_s:.2f} s, load still swings {1e3 * swing.measured:.2f} mm"
    )
