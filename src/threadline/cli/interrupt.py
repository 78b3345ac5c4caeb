"""Ends of the program that nobody asked for: interrupts and defects, each with its exit status.

An interrupt is SIGINT from a person, SIGTERM from a time limit or a batch system, or SIGHUP from a
terminal that is closed. Only the standard library is imported here.
"""

from __future__ import annotations

import math
import os
import platform
import shlex
import signal
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

from threadline import __version__

if TYPE_CHECKING:
    from sys import UnraisableHookArgs


EXIT_INTERRUPTED = 130  # 128 + SIGINT
_STDERR = 2
_told = threading.Lock()  # taken when the line of an interrupt is written
_SAME_S = 1.0
_AGAIN_S = 0.01
_NOTHING = "nothing was left half-written"
_WHOLE = "what it wrote is there, and whole"
_ENDS = {
    number: (128 + number, f"error: {said}; {_NOTHING}\n")
    for number, said in (
        (signal.SIGINT, "interrupted"),
        (signal.SIGTERM, "terminated"),
        (signal.SIGHUP, "hung up"),
    )
}

_Answer = Callable[[int, FrameType | None], None]


class TerminatedError(KeyboardInterrupt):
    """A signal that ends the program, whatever it could still answer: not from the keyboard."""


class Termination:
    """The signal that ends the program: SIGINT until another one comes."""

    def __init__(self) -> None:
        self.number = signal.SIGINT
        self.was_lost = False
        """Whether an interrupt came where nobody could be told: what failed since failed of it."""
        self._came_s = -math.inf
        self._again: threading.Timer | None = None

    def answer(self, number: int, _frame: FrameType | None) -> None:
        """Raise ``KeyboardInterrupt`` in the running command, which removes its unfinished files.

        Signals that follow within a second are ignored, or they would interrupt the removing.
        """
        now_s = time.monotonic()
        if now_s - self._came_s < _SAME_S:
            return
        self.number, self._came_s = signal.Signals(number), now_s
        raise KeyboardInterrupt if number == signal.SIGINT else TerminatedError

    def repeat(self) -> None:
        """Send the signal once more in a moment: where it was raised, it could not be told."""
        self.was_lost, self._came_s = True, -math.inf
        self._again = threading.Timer(
            _AGAIN_S, signal.pthread_kill, (threading.main_thread().ident, self.number)
        )
        self._again.daemon = True
        self._again.start()

    def over(self) -> None:
        """Answer no signal any more, and send none."""
        self._came_s = math.inf
        if self._again is not None:
            self._again.cancel()
            self._again.join()

    def end(self, *, wrote: bool) -> tuple[int, str]:
        """Return the exit status and the line of the signal; no other signal is told after it.

        Parameters
        ----------
        wrote
            Whether files have appeared before it: they are whole, and they stay.
        """
        _told.acquire(blocking=False)
        status, said = _ENDS[self.number]
        return status, said.replace(_NOTHING, _WHOLE) if wrote else said


@contextmanager
def leaving_on_interrupt() -> Iterator[None]:
    """End the process at an interrupt, while modules are imported and nothing is written.

    An exception would not do: a package may catch it half-way through its own import, and say so
    at length.
    """
    with _answering({number: _leave for number in _ENDS}):
        yield


@contextmanager
def terminating() -> Iterator[Termination]:
    """Treat SIGTERM and SIGHUP as interrupts within the block; yield the signal that came.

    Python drops an exception that is raised in a function that machine code calls (numba's compiler
    does), or while an object is deleted. An interrupt that is lost there is raised once more.
    """
    termination = Termination()
    if _told.locked():  # by an earlier command in this process
        _told.release()
    dropped = sys.unraisablehook

    def repeated(what: UnraisableHookArgs) -> None:
        if issubclass(what.exc_type, KeyboardInterrupt):
            termination.repeat()
        else:
            dropped(what)

    with _answering(dict.fromkeys(_ENDS, termination.answer)):
        sys.unraisablehook = repeated
        try:
            yield termination
        finally:
            sys.unraisablehook = dropped
            termination.over()


@contextmanager
def _answering(answers: dict[signal.Signals, _Answer]) -> Iterator[None]:
    """Handle signals within the block, but for those ignored, as SIGINT is in background jobs."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {
        number: signal.signal(number, answer)
        for number, answer in answers.items()
        if signal.getsignal(number) is not signal.SIG_IGN
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _leave(number: int, _frame: FrameType | None) -> None:
    if not _told.acquire(blocking=False):  # an earlier signal is being answered
        return
    status, said = _ENDS[signal.Signals(number)]
    os.write(_STDERR, said.encode())
    os._exit(status)


EXIT_DEFECT = 70
"""EX_SOFTWARE of sysexits.h; a crash must not end with 1, which says "out of specification"."""
_SHOWN = 120


def keep_traceback(error: Exception, given: Sequence[str]) -> str:
    """Write the traceback of ``error`` to a file of its own; return the line that says where.

    Parameters
    ----------
    error
        The exception that the program did not expect.
    given
        The arguments of the command.
    """
    where = traceback.extract_tb(error.__traceback__)
    at = f" at {Path(where[-1].filename).name}:{where[-1].lineno}" if where else ""
    said = " ".join(str(error).split())[:_SHOWN]
    what = f"{type(error).__name__}{at}{f': {said}' if said else ''}"
    text = "\n".join(
        [
            f"threadline {__version__}, Python {platform.python_version()}, {platform.platform()}",
            f"command: threadline {shlex.join(given)}",
            "",
            "".join(traceback.format_exception(error)),
        ]
    )
    try:
        with tempfile.NamedTemporaryFile(
            "w",
            prefix="threadline-defect-",
            suffix=".txt",
            delete=False,
            encoding="utf-8",
            errors="backslashreplace",
        ) as file:
            file.write(text)
        kept = f"Please report it with the file {file.name}, which has the traceback."
    except OSError as failure:
        kept = f"Its traceback could not be kept: {failure.strerror or failure}."
    return f"[DEFECT] this is a defect of the program, not of the input: {what}. {kept}"
