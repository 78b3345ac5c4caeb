"""Moves of several axes one after the other, as long as somebody renews them and nobody stops."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

from threadline.live.executor import LEASE_S
from threadline.signals import Ended


class MoveSequence:
    """What is left of a sequence of moves; it is dropped where one of them did not get to its end.

    Time is an argument, in s.
    """

    def __init__(self) -> None:
        self._ways: deque[tuple[str, int]] = deque()
        self._stops = 0  # stops that were heard before it was asked for
        self._renewed_s = 0.0
        self._begun = False

    @property
    def left(self) -> int:
        """Number of moves that have not begun."""
        return len(self._ways)

    def begin(self, ways: Iterable[tuple[str, int]], stops: int, now_s: float) -> None:
        """Take up a sequence: axes, and the counts that each moves to."""
        self._ways, self._stops, self._begun = deque(ways), stops, False
        self._renewed_s = now_s

    def renew(self, now_s: float) -> None:
        """Note that somebody still wants it."""
        self._renewed_s = now_s

    def lease_s(self, now_s: float) -> float:
        """Return what is left of the lease since it was renewed last, s."""
        return LEASE_S - (now_s - self._renewed_s)

    def clear(self) -> None:
        """Drop what is left."""
        self._ways.clear()

    def next_one(
        self, stops: int, ended: tuple[Ended, str] | None, now_s: float
    ) -> tuple[str, int] | None:
        """Return the move to begin; None where there is none, and drop all where it has to end.

        Parameters
        ----------
        stops
            Number of stops that were heard until now.
        ended
            How the motion before it ended.
        now_s
            The time.
        """
        whole = not self._begun or ended == (Ended.COMPLETED, "")
        if stops != self._stops or not whole or self.lease_s(now_s) <= 0.0:
            self.clear()
        if not self._ways:
            return None
        self._begun = True
        return self._ways.popleft()
