"""What people ask of an executor, from a key, a signal or another thread: a stop ahead of all."""

from __future__ import annotations

import socket
from collections import deque
from contextlib import suppress

from threadline.live.states import Cause


class Desk:
    """Takes commands at any time, without any lock, and wakes who waits for them."""

    def __init__(self) -> None:
        self._asked: deque[Cause] = deque()
        self._stop = False
        self._reads, self._writes = socket.socketpair()
        self._reads.setblocking(False)
        self._writes.setblocking(False)

    def ask(self, cause: Cause) -> None:
        """Ask for something; may be called in a signal handler and from any thread."""
        if cause is Cause.STOP:
            self._stop = True
        else:
            self._asked.append(cause)
        with suppress(OSError):  # full: it is woken already
            self._writes.send(b"!")

    def take(self) -> Cause | None:
        """Return what was asked for first, a stop before anything else; None for nothing.

        What was asked for before a stop is dropped with it: a resume that waits must not undo it.
        """
        if self._stop:
            self._stop = False
            self._asked.clear()
            return Cause.STOP
        return self._asked.popleft() if self._asked else None

    def fileno(self) -> int:
        """Return the number to wait on."""
        return self._reads.fileno()

    def woken(self) -> None:
        """Forget what has woken it."""
        with suppress(OSError):
            while self._reads.recv(4096):
                pass

    def close(self) -> None:
        """Let go of what it waits with."""
        self._reads.close()
        self._writes.close()
