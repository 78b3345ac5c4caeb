"""When a search has to come to an answer: at a given time, or as soon as somebody asks for it."""

from __future__ import annotations

import math
import signal as signals
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass

from threadline.errors import OptionError

INTERRUPTED, OUT_OF_TIME = "interrupted", "out of time"


class HaltError(BaseException):
    """A search that stops before its end; what it knows by then is its answer.

    It may come in the middle of a plan, so that nothing that handles errors of plans takes it.
    """


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
        if self.over():
            raise HaltError

    def over(self) -> bool:
        """Say whether the search has to answer now, and note why."""
        if not self.ended and time.monotonic() >= self.end_s:
            self.ended = OUT_OF_TIME
        return bool(self.ended)

    def interrupted(self, signal: KeyboardInterrupt) -> bool:
        """Say whether an interrupt asks for the answer of now, and not for the end of the program.

        A person at the keyboard asks for the answer; a signal of another kind, of a class of its
        own, ends the program.
        """
        asks = type(signal) is KeyboardInterrupt
        if asks:
            self.ended = INTERRUPTED
        return asks

    @contextmanager
    def interrupting(self) -> Iterator[None]:
        """End what this block does when the time is over, wherever it is by then.

        Signals come to the main thread alone; in another one, and on systems without timers, the
        block goes on to its end.

        Raises
        ------
        HaltError
            When the time is over.
        """
        able = threading.current_thread() is threading.main_thread()
        if not able or math.isinf(self.end_s) or not hasattr(signals, "setitimer"):
            yield
            return
        before = signals.signal(signals.SIGALRM, self._halt)
        signals.setitimer(signals.ITIMER_REAL, max(self.end_s - time.monotonic(), 1e-3))
        try:
            yield
        finally:
            signals.setitimer(signals.ITIMER_REAL, 0.0)
            signals.signal(signals.SIGALRM, before)

    def _halt(self, *_: object) -> None:
        if not self.ended:
            self.ended = OUT_OF_TIME
            raise HaltError


@contextmanager
def with_answer() -> Iterator[None]:
    """Search in this block, and refuse to have been given less time than one plan takes.

    Raises
    ------
    OptionError
        If the time was over before a plan was judged.
    """
    try:
        yield
    except HaltError as halt:
        raise no_answer() from halt


@contextmanager
def as_far_as(until: Until | None, known: Callable[[], object]) -> Iterator[None]:
    """Search in this block; where its time is over or a person asks, leave it with what is known.

    Parameters
    ----------
    until
        When the search has to come to an answer; None for a search that goes to its end.
    known
        Returns whether there is anything to answer with.

    Raises
    ------
    HaltError, KeyboardInterrupt
        If nothing is known yet, or the interrupt is one that ends the program.
    """
    try:
        with nullcontext() if until is None else until.interrupting():
            yield
    except HaltError:
        if not known():
            raise
    except KeyboardInterrupt as signal:
        if until is None or not known() or not until.interrupted(signal):
            raise


def no_answer() -> OptionError:
    """Return the error of a search whose time was over before it had judged a plan."""
    return OptionError(
        "no plan could be judged in that time", remedy="Give --within a longer time."
    )
