"""When a search has to come to an answer: at a given time, or as soon as somebody asks for it."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

INTERRUPTED, OUT_OF_TIME = "interrupted", "out of time"


class HaltError(Exception):
    """A search that stops before its end; what it knows by then is its answer."""


@dataclass(slots=True)
class Until:
    """The end of the time that a search has, and why it stopped.

    Parameters
    ----------
    end_s
        On the monotonic clock.
    ended
        Why it stopped before its end; empty while it goes on, and where it came to its end.
    """

    end_s: float = math.inf
    ended: str = ""

    @classmethod
    def within(cls, span_s: float | None) -> Until:
        """Return an end that comes ``span_s`` seconds from now; without a span it never comes."""
        return cls(math.inf if span_s is None else time.monotonic() + span_s)

    def check(self) -> None:
        """End the search where its time is over.

        Raises
        ------
        HaltError
            If it is.
        """
        if self.ended or time.monotonic() >= self.end_s:
            self.ended = self.ended or OUT_OF_TIME
            raise HaltError

    def interrupted(self, signal: KeyboardInterrupt) -> bool:
        """Say whether an interrupt asks for the answer of now, and not for the end of the program.

        A person at the keyboard asks for the answer; a signal of another kind, of a class of its
        own, ends the program.
        """
        asks = type(signal) is KeyboardInterrupt
        if asks:
            self.ended = INTERRUPTED
        return asks
