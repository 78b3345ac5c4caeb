"""Searches over the whole pipeline: the fastest motion in spec, and comparisons."""

from threadline.search.allowance import Bound, FastestJob, Rung
from threadline.search.compare import PLACEMENT, Comparison, compare, placement_spec
from threadline.search.fastest import Fastest, find_fastest
from threadline.search.feed import fastest_feed, fastest_needle, feed_range_m_s, needle_range_hz
from threadline.search.forbidden import Interval
from threadline.search.least_limits import fastest_job
from threadline.search.mismatch import Mismatch, feed_over_tolerances, needle_over_tolerances

__all__ = [
    "PLACEMENT",
    "Bound",
    "Comparison",
    "Fastest",
    "FastestJob",
    "Interval",
    "Mismatch",
    "Rung",
    "compare",
    "fastest_feed",
    "fastest_job",
    "fastest_needle",
    "feed_over_tolerances",
    "feed_range_m_s",
    "find_fastest",
    "needle_over_tolerances",
    "needle_range_hz",
    "placement_spec",
]
