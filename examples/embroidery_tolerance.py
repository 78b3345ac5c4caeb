"""How much sooner an embroidery frame is done if the needle may miss its place by more.

Run it from the root of the repository: python examples/embroidery_tolerance.py
"""

import threadline as tl

for tolerance in ("0.05 mm", "0.1 mm", "0.2 mm"):
    proof = tl.prove("examples/rosette.dst", "schiffli-frame", tolerance=tolerance, level="nominal")
    print(f"tolerance {tolerance}: {proof.plan.duration_s:.1f} s")
