"""The deadline of a search: a given time, or a user's request for the answer."""

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
    """A search that stops early; its answer is the result found so far.

    The error may come in the middle of a plan. It derives from ``BaseException``, so that no
    handler of plan errors catches it.
    """


@dataclass(slots=True)
class Deadline:
    """The deadline of a search, and the reason why it stopped.

    Parameters
    ----------
    end_s
        Deadline on the monotonic clock.
    ended
        Reason for which the search stopped early; empty while it runs, and if it was completed.
    """

    end_s: float = math.inf
    ended: str = ""

    @classmethod
    def within(cls, span_s: float | None) -> Deadline:
        """Return a deadline ``span_s`` seconds from now; None: no deadline."""
        return cls(math.inf if span_s is None else time.monotonic() + span_s)

    def check(self) -> None:
        """End the search if its time is over.

        Raises
        ------
        HaltError
            If the time is over.
        """
        if self.over():
            raise HaltError

    def over(self) -> bool:
        """Return whether the search must answer now, and note the reason."""
        if not self.ended and time.monotonic() >= self.end_s:
            self.ended = OUT_OF_TIME
        return bool(self.ended)

    def interrupted(self, signal: KeyboardInterrupt) -> bool:
        """Return whether an interrupt asks for the answer so far, and not for the program's end.

        A user at the keyboard asks for the answer. Another signal raises a subclass of
        KeyboardInterrupt, which ends the program.
        """
        asks = type(signal) is KeyboardInterrupt
        if asks:
            self.ended = INTERRUPTED
        return asks

    @contextmanager
    def interrupting(self) -> Iterator[None]:
        """End this block at any point once the time is over.

        Only the main thread gets signals. In another thread, and on systems without timers, the
        block runs to its end.

        Raises
        ------
        HaltError
            When the time is over.
        """
        in_main_thread = threading.current_thread() is threading.main_thread()
        if not in_main_thread or math.isinf(self.end_s) or not hasattr(signals, "setitimer"):
            with _from_machine_code():
                yield
            return
        previous_handler = signals.signal(signals.SIGALRM, self._halt)
        signals.setitimer(signals.ITIMER_REAL, max(self.end_s - time.monotonic(), 1e-3))
        try:
            with _from_machine_code():
                yield
        finally:
            signals.setitimer(signals.ITIMER_REAL, 0.0)
            signals.signal(signals.SIGALRM, previous_handler)

    def _halt(self, *_: object) -> None:
        if not self.ended:
            self.ended = OUT_OF_TIME
            raise HaltError


@contextmanager
def _from_machine_code() -> Iterator[None]:
    """Raise the exception of a signal that arrived during machine code.

    A signal during a call of machine code makes it fail with a ``SystemError``, whose cause, or the
    cause of whose cause, is the signal's exception.
    """
    try:
        yield
    except SystemError as error:
        cause: BaseException | None = error
        while isinstance(cause, SystemError):
            cause = cause.__cause__
        if isinstance(cause, HaltError | KeyboardInterrupt):
            raise cause from error
        raise


@contextmanager
def with_answer() -> Iterator[None]:
    """Search in this block; refuse a time that is too short for one plan.

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
def until_deadline(until: Deadline | None, known: Callable[[], object]) -> Iterator[None]:
    """Search in this block; if its time ends or a user asks, leave it with the results so far.

    Parameters
    ----------
    until
        Deadline of the search; None for a search that runs to its end.
    known
        Returns a true value if there is a result to answer with.

    Raises
    ------
    HaltError, KeyboardInterrupt
        If no result is known yet, or the interrupt ends the program.
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
    """Return the error for a search whose time was over before a plan was judged."""
    return OptionError(
        "no plan could be judged in that time", remedy="Give --within a longer time."
    )
