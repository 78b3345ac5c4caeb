"""The shares of the limits that a search for the fastest has tried, and how far it is with them."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass, field

from threadline.errors import LimitError
from threadline.progress_call import Progress
from threadline.search.fastest import Fastest
from threadline.search.rungs import Rung
from threadline.search.until import HaltError, Until

LONG_S = 300.0
"""A job that takes longer, however fast it was so far, is not searched with shares of the limits
with which it takes longer still."""


@dataclass(slots=True, kw_only=True)
class Shares:
    """What is known of each share of the limits.

    Parameters
    ----------
    searched
        Returns the feeds in spec with a share, from how many feeds are scanned, how many near each
        edge, and whom to tell how far that is.
    duration_s
        Returns how long the job takes with a share at the best of its feeds.
    at_top_s
        Returns how long it takes with a share at the highest feed of all.
    expected
        How many searches of one share there will be, most likely.
    progress, until
        As a search takes them.
    rungs, left_out
        What was found, by share; and shares with which even the highest feed takes no less time
        than the best so far.
    top_s
        How long the job takes with all of the limits at the highest feed; None until it is asked.
    steps, told
        How many searches were begun, and how much of all was told to be done.
    """

    searched: Callable[[float, int, int, Progress | None], Fastest]
    duration_s: Callable[[float, Fastest], float | None]
    at_top_s: Callable[[float], float]
    expected: int
    progress: Progress | None
    until: Until | None
    rungs: dict[float, Rung] = field(default_factory=dict)
    left_out: set[float] = field(default_factory=set)
    top_s: float | None = None
    steps: int = 0
    told: float = 0.0

    def tried(self, share: float, points: int, near: int = 0) -> Rung | None:
        """Return what was found with a share, searched unless that is known; None: left out.

        Raises
        ------
        HaltError
            If the time is over, or somebody asks for the answer, after this share was known.
        """
        if share in self.rungs and not near:
            return self.rungs[share]
        telling = self._telling(share)
        self.steps += 1
        if share in self.left_out or (share not in self.rungs and self._hopeless(share)):
            return None
        found = self.searched(share, points, near, telling)
        try:
            duration_s = self.duration_s(share, found)
        except KeyboardInterrupt as signal:
            # It takes one plan more to answer with what was found.
            if self.until is None or not self.until.interrupted(signal):
                raise
            duration_s = self.duration_s(share, found)
        self.rungs[share] = Rung(share=share, found=found, duration_s=duration_s)
        if not found.complete or (self.until is not None and self.until.ended):
            raise HaltError
        return self.rungs[share]

    @property
    def long(self) -> bool:
        """Whether the job takes long, however fast it was so far, or at the highest feed."""
        if not self.rungs:
            if self.top_s is None:
                try:
                    self.top_s = self.at_top_s(1.0)
                except LimitError:  # it breaks a limit: how long it would take says nothing
                    self.top_s = 0.0
            return self.top_s > LONG_S
        return LONG_S < self._best_s < math.inf

    @property
    def _best_s(self) -> float:
        durations = (rung.duration_s for rung in self.rungs.values())
        return min((value for value in durations if value is not None), default=math.inf)

    def _telling(self, share: float) -> Progress | None:
        """Return what is told how far the search of one share is."""
        if self.progress is None:
            return None
        progress, each = self.progress, 1.0 / max(self.expected, self.steps + 1)
        done = self.steps * each

        def telling(_: str, part: float) -> None:
            # Searches that nobody expected make the others a smaller part of all.
            self.told = max(self.told, done + part * each)
            progress(f"limits {share:.0%}", self.told)

        telling("", 0.0)
        return telling

    def _hopeless(self, share: float) -> bool:
        """Say whether nothing of a share can be the answer: even the highest feed is too slow."""
        if not self.rungs or not self.long:
            return False
        try:
            with nullcontext() if self.until is None else self.until.interrupting():
                if self.at_top_s(share) < self._best_s:
                    return False
        except LimitError:  # the highest feed breaks a limit: it is no plan to compare with
            return False
        self.left_out.add(share)
        return True
