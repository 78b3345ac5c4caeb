"""Sew one seam at several needle speeds, with and without feed-forward: one simulated run each.

Run it from the root of the repository: python examples/needle_speeds.py
"""

import threadline as tl

SEAM = "examples/stitcher-test-path.seam.toml"
SPEC = "examples/stitcher-place.spec.toml"  # place and length of the stitches, nothing else

for speed in (25, 45, 65):
    for feed_forward in (False, True):
        proof = tl.prove(
            SEAM,
            "stitcher",
            spec=SPEC,
            needle=f"{speed} stitch/s",
            feed_forward=feed_forward,
            level="nominal",
        )
        length = proof.result("stitch_length_error")
        print(
            f"{speed} stitch/s, feed-forward {'on ' if feed_forward else 'off'}: "
            f"stitch length off by {100 * length.measured:4.1f} %, "
            f"{'in spec' if proof.passed else 'out of spec'}"
        )
