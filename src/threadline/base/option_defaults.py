"""Defaults of the options of planning, which every help text tells.

They stand alone, so that a text that tells them need not wait for what plans by them.
"""

from __future__ import annotations

DEFAULT_INTERPOLATION = "default"
"""What ``--interpolation`` says for what the machine does by itself: ``firmware`` where its file
names the motion planner of a firmware, else ``AUTO``."""
AUTO = "auto"
USUAL = frozenset({DEFAULT_INTERPOLATION, AUTO})
"""Interpolations that choose nothing in particular: feed-forward takes the chords in their place.
"""
DEFAULT_LIMITS = "100 %"
DEFAULT_CONTOUR_M = 3e-4
"""Default of ``--contour``, m: how far the control loops may take the load off the path of
``optimal``. With the tolerance of the path this is 0.4 mm of the +-0.5 mm that the winder and the
stitcher have to keep. The rest is for what the plan does not contain: encoder counts, levels of the
DAC, friction, and the spread from run to run."""
NO_CONTOUR = "none"
"""What ``--contour`` says for no limit."""
UNSHAPED_WORD = "none"
"""What ``--shaper`` says for no shaper."""
DEFAULT_TOLERANCE_M = 1e-4
"""Default of ``--tolerance``, m: largest deviation from the programmed path."""
DEFAULT_TOLERANCE = f"{DEFAULT_TOLERANCE_M * 1e3:g} mm"
FEED_FORWARD = "40 ms"
"""Default time over which feed-forward smooths the motion."""
OPTIMAL_FEED_FORWARD = "10 ms"
"""Default with ``optimal``: its acceleration has no steps, so less smoothing is enough."""

MOST_REPEATS = 1000
"""Runs of a machine in one verdict at most: each is kept until the last one is judged."""
