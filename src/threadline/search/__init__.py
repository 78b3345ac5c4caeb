"""Searches over the whole pipeline: the fastest motion in spec."""

from threadline.search.fastest import Fastest, Interval, find_fastest
from threadline.search.feed import fastest_feed, feed_range_m_s

__all__ = ["Fastest", "Interval", "fastest_feed", "feed_range_m_s", "find_fastest"]
