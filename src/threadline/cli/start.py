"""Where the program begins: answers an interrupt before there is anything to interrupt.

Only the standard library is imported here, and it takes a moment; the commands are imported with
an interrupt answered in one line, as it is later on.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

EXIT_INTERRUPTED = 130
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


def run() -> None:
    """Run the program with the arguments of the shell."""
    with leaving_on_interrupt():
        from threadline.cli.main import main
    main()


if __name__ == "__main__":
    run()
