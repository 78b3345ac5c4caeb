"""What an interrupt does: the status it ends with, its one line, and how it ends an import.

Only the standard library is imported here.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

EXIT_INTERRUPTED = 130  # 128 + SIGINT
INTERRUPTED = "error: interrupted; nothing was left half-written\n"
_STDERR = 2


@contextmanager
def leaving_on_interrupt() -> Iterator[None]:
    """End the process at an interrupt, while modules are imported and nothing is written.

    An exception would not do: a package may catch it half-way through its own import, and say so
    at length.
    """
    ignored = signal.getsignal(signal.SIGINT) is signal.SIG_IGN  # as a shell asks of a background
    if ignored or threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, _leave)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _leave(_signal: int, _frame: FrameType | None) -> None:
    os.write(_STDERR, INTERRUPTED.encode())
    os._exit(EXIT_INTERRUPTED)
