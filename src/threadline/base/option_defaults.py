"""Defaults of the planning options, for help texts.

They are in a separate file, so that showing a help text does not import the planner.
"""

from __future__ import annotations

DEFAULT_INTERPOLATION = "default"
"""Value of ``--interpolation`` for the default of the machine: ``firmware`` if its file has the
motion planner of a firmware, else ``AUTO``."""
AUTO = "auto"
USUAL = frozenset({DEFAULT_INTERPOLATION, AUTO})
"""Interpolations that feed-forward replaces by chords, because the user did not choose a path."""
DEFAULT_LIMITS = "100 %"
DEFAULT_CONTOUR_M = 3e-4
"""Default of ``--contour``, m: largest contour error of the load that the control loops may cause
on the path of ``optimal``. Together with the path tolerance this is 0.4 mm of the +-0.5 mm that are
allowed on the winder and the stitcher. The remainder covers effects outside of the plan: encoder
counts, DAC levels, friction, and the spread from run to run."""
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
"""Number of runs if twenty runs come near a limit. With 95 % confidence, 99.75 % of all runs are no
worse than the worst of these. The worst of any twenty further runs is then no worse in 19 of 20
cases. This needs 1169 runs."""
