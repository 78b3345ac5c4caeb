"""The feeds of a part program: what F stands for, and one object for equal feeds."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

from threadline.jobs.gcode.f_words import FRule
from threadline.jobs.gcode.words import ONE
from threadline.jobs.operations import Feed, FeedMode

_MOST = 1000
_MM_PER_M = 1000 * ONE


class KeptFeeds:
    """Feeds by their mode and value, so that equal feeds are one object.

    Parameters
    ----------
    rule
        Meaning of F in G94.
    """

    def __init__(self, rule: FRule) -> None:
        self._rule = rule
        self._kept: dict[tuple[FeedMode, float], Feed] = {}

    def feed(self, value: float, *, inverse_time: bool) -> Feed:
        """Return the feed with ``value`` in m/s, in G93 (``inverse_time``) in 1/s."""
        rule = self._rule
        mode = FeedMode.INVERSE_TIME if inverse_time else rule.mode
        feed = self._kept.get((mode, value))
        if feed is None:
            if len(self._kept) >= _MOST:
                self._kept.clear()
            feed = Feed(mode, value, rule.base_axes if mode is FeedMode.BASE_AXES else ())
            self._kept[mode, value] = feed
        return feed


@lru_cache(maxsize=_MOST)
def travelling(feed: Feed) -> Feed:
    """Return the feed of a G0 that goes at ``feed``."""
    return feed if feed.travels else replace(feed, travel=True)


def value_of(word: int, tenth_mm: int, *, inverse_time: bool) -> float:
    """Return what the word F stands for: m/s, in G93 (``inverse_time``) 1/s.

    Parameters
    ----------
    word
        The word, exactly.
    tenth_mm
        Tenths of a millimetre in the unit of length.
    """
    if inverse_time:
        return word / (60 * ONE)
    return word * tenth_mm / (10 * 60 * _MM_PER_M)
