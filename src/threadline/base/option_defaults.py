"""Defaults of the planning options, for help texts.

They have a file of their own, so that showing a help text does not import the planner.
"""

from __future__ import annotations

DEFAULT_INTERPOLATION = "default"
"""``--interpolation`` of the machine's own choice: ``firmware`` where its file names the motion
planner of a firmware, else ``AUTO``."""
AUTO = "auto"
USUAL = frozenset({DEFAULT_INTERPOLATION, AUTO})
"""Interpolations that feed-forward replaces by chords, because the user chose no path."""
DEFAULT_LIMITS = "100 %"
DEFAULT_CONTOUR_M = 3e-4
"""Default of ``--contour``, m: largest contour error of the load that the control loops may cause
on the path of ``optimal``. Together with the path tolerance this uses 0.4 mm of the +-0.5 mm
allowed on the winder and the stitcher. The rest covers effects outside the plan: encoder counts,
DAC levels, friction, and the spread from run to run."""
NO_CONTOUR = "none"
"""Value of ``--contour`` for no limit."""
UNSHAPED_WORD = "none"
"""Value of ``--shaper`` for no shaper."""
DEFAULT_TOLERANCE_M = 1e-4
"""Default of ``--tolerance``, m: largest deviation from the programmed path."""
DEFAULT_TOLERANCE = f"{DEFAULT_TOLERANCE_M * 1e3:g} mm"
FEED_FORWARD = "40 ms"
"""Default time over which feed-forward smooths the motion."""
OPTIMAL_FEED_FORWARD = "10 ms"
"""Default with ``optimal``: its acceleration has no steps, so less smoothing is enough."""

MOST_REPEATS = 1000
"""Largest number of runs in one verdict: every run is kept until the last one is judged."""
MOST_RUNS = 1200
"""Runs where twenty come near a limit: with 95 % confidence 99.75 % of all runs are no worse, and
so the worst of any twenty in 19 of 20 cases. 1169 are needed for that."""
