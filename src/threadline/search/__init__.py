"""Searches for the fastest motion in spec, and comparisons of plans, over the whole pipeline."""

from threadline.search.allowance import Candidate, FastestJob
from threadline.search.compare import PLACEMENT, Comparison, compare, placement_spec
from threadline.search.fastest import Fastest, Grid, find_fastest
from threadline.search.feed import fastest_feed, fastest_needle, feed_range_m_s, needle_range_hz
from threadline.search.feed_ranges import Interval
from threadline.search.least_limits import fastest_job
from threadline.search.least_times import Bound
from threadline.search.mismatch import Certainty, Mismatch
from threadline.search.paced import Question

__all__ = [
    "PLACEMENT", "Bound", "Candidate", "Certainty", "Comparison", "Fastest", "FastestJob", "Grid",
    "Interval", "Mismatch", "Question", "compare", "fastest_feed", "fastest_job", "fastest_needle",
    "feed_range_m_s", "find_fastest", "needle_range_hz", "placement_spec",
]  # fmt: skip
