"""Exit status and message of interrupts and defects.

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
_line_written = threading.Lock()  # held once the line of an interrupt has been written
_SAME_S = 1.0
_AGAIN_S = 0.01
_NOTHING = "nothing was left half-written"
_WHOLE = "its files are written completely"
_ENDS = {
    number: (128 + number, f"error: {event}; {_NOTHING}\n")
    for number, event in (
        (signal.SIGINT, "interrupted"),
        (signal.SIGTERM, "terminated"),
        (signal.SIGHUP, "hung up"),
    )
}

_Answer = Callable[[int, FrameType | None], None]


class TerminatedError(KeyboardInterrupt):
    """A terminating signal that did not come from the keyboard: the command cannot go on."""


class Termination:
    """The signal that ends the program: SIGINT until another one arrives."""

    def __init__(self) -> None:
        self.number = signal.SIGINT
        self.was_lost = False
        """Whether an interrupt was raised where Python drops it: later failures are its effect."""
        self._came_s = -math.inf
        self._again: threading.Timer | None = None

    def answer(self, number: int, _frame: FrameType | None) -> None:
        """Raise ``KeyboardInterrupt`` in the running command, which removes its unfinished files.

        Signals within the next second are ignored, or they would interrupt the clean-up.
        """
        now_s = time.monotonic()
        if now_s - self._came_s < _SAME_S:
            return
        self.number, self._came_s = signal.Signals(number), now_s
        raise KeyboardInterrupt if number == signal.SIGINT else TerminatedError

    def repeat(self) -> None:
        """Send the signal again after a moment, because Python dropped its exception."""
        self.was_lost, self._came_s = True, -math.inf
        self._again = threading.Timer(
            _AGAIN_S, signal.pthread_kill, (threading.main_thread().ident, self.number)
        )
        self._again.daemon = True
        self._again.start()

    def over(self) -> None:
        """Stop answering and sending signals."""
        self._came_s = math.inf
        if self._again is not None:
            self._again.cancel()
            self._again.join()

    def end(self, *, wrote: bool) -> tuple[int, str]:
        """Return the exit status and the message of the signal; later signals print nothing.

        Parameters
        ----------
        wrote
            Whether files were written before it: they are complete and stay.
        """
        _line_written.acquire(blocking=False)
        status, message = _ENDS[self.number]
        return status, message.replace(_NOTHING, _WHOLE) if wrote else message


@contextmanager
def leaving_on_interrupt() -> Iterator[None]:
    """End the process at an interrupt while modules are imported and nothing is written.

    An exception would not do: a package may catch it half-way through its own import and print a
    long message.
    """
    with _answering({number: _leave for number in _ENDS}):
        yield


@contextmanager
def terminating() -> Iterator[Termination]:
    """Treat SIGTERM and SIGHUP as interrupts within the block; yield the signal that came.

    Python drops an exception raised in a function that machine code calls (numba's compiler does),
    or while an object is deleted. Such a lost interrupt is raised again.
    """
    termination = Termination()
    if _line_written.locked():  # by an earlier command in this process
        _line_written.release()
    previous_hook = sys.unraisablehook

    def repeated(dropped_error: UnraisableHookArgs) -> None:
        if issubclass(dropped_error.exc_type, KeyboardInterrupt):
            termination.repeat()
        else:
            previous_hook(dropped_error)

    with _answering(dict.fromkeys(_ENDS, termination.answer)):
        sys.unraisablehook = repeated
        try:
            yield termination
        finally:
            sys.unraisablehook = previous_hook
            termination.over()


@contextmanager
def _answering(answers: dict[signal.Signals, _Answer]) -> Iterator[None]:
    """Handle signals within the block, except ignored ones, as SIGINT is in background jobs."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    previous_handlers = {
        number: signal.signal(number, answer)
        for number, answer in answers.items()
        if signal.getsignal(number) is not signal.SIG_IGN
    }
    try:
        yield
    finally:
        for number, handler in previous_handlers.items():
            signal.signal(number, handler)


def _leave(number: int, _frame: FrameType | None) -> None:
    if not _line_written.acquire(blocking=False):  # an earlier signal is being answered
        return
    status, message = _ENDS[signal.Signals(number)]
    os.write(_STDERR, message.encode())
    os._exit(status)


EXIT_DEFECT = 70
"""EX_SOFTWARE of sysexits.h; a crash must not end with 1, which says "out of specification"."""
_SHOWN = 120


def keep_traceback(error: Exception, given: Sequence[str]) -> str:
    """Write the traceback of ``error`` to its own file; return a message that names the file.

    Parameters
    ----------
    error
        The unexpected exception.
    given
        The arguments of the command.
    """
    frames = traceback.extract_tb(error.__traceback__)
    location = f" at {Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else ""
    error_text = " ".join(str(error).split())[:_SHOWN]
    defect = f"{type(error).__name__}{location}{f': {error_text}' if error_text else ''}"
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
        report_request = f"Please report it with the file {file.name}, which has the traceback."
    except OSError as failure:
        report_request = f"Its traceback could not be kept: {failure.strerror or failure}."
    return f"[DEFECT] this is a defect of the program, not of the input: {defect}. {report_request}"
