"""Design input shapers for a load that swings at 12 Hz, and see how long each one lasts.

Run it from the root of the repository: python examples/shaper_impulses.py
"""

import threadline as tl

for kind in ("zv", "zvd", "ei"):
    shaper = tl.shaper(f"{kind}:12Hz:0.02")
    impulses = zip(shaper.times_s, shaper.amplitudes, strict=True)
    print(kind, "  ".join(f"{1e3 * t:.1f} ms: {a:.3f}" for t, a in impulses))
