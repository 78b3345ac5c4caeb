"""Compare two interpolations at a slow and a fast feed: one run of the simulated winder each.

Run it from the root of the repository: python examples/compare_interpolations.py
"""

import threadline as tl

compared = tl.compare(
    "examples/x-180.prg",
    "lathe-winder",
    ["linear", "b-spline-pulled"],
    ["10 count/tick", "80 count/tick"],
    level="nominal",
)

for proof in compared.proofs:
    options = proof.plan.options
    error = proof.verdict.result("contour_error")
    verdict = "in spec" if proof.verdict.passed else "out of spec"
    print(
        f"{options['interpolation']:16} {options['feed']:15} {proof.plan.duration_s:6.2f} s "
        f"{1e3 * error.measured:6.3f} mm  {verdict}"
    )
