"""Find the highest feed that is in spec in twenty runs, then prove the job with it.

Run it from the root of the repository: python examples/fastest_feed.py
"""

import threadline as tl

JOB, MACHINE = "examples/x-180.prg", "lathe-winder"

found = tl.fastest(JOB, MACHINE, interpolation="b-spline-pulled", margin="5 %")

if found.best is None:
    print("no feed is in spec")
else:
    print(f"{1e3 * found.best:.0f} mm/s, limited by {found.limited_by}")
    proof = tl.prove(JOB, MACHINE, **found.best_options)
    verdict = "in spec" if proof.passed else "out of spec"
    print(f"{verdict} in 20 runs, {proof.plan.duration_s:.2f} s")
