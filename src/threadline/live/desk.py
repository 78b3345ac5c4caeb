"""The queue of an operator's commands to an executor, in which a stop comes first."""

from __future__ import annotations

import socket
from collections import deque
from contextlib import suppress

from threadline.live.states import Cause


class Desk:
    """Takes commands from keys, signal handlers and other threads, without a lock.

    It wakes an executor that waits on its ``fileno``.
    """

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
        self.wake()

    def wake(self) -> None:
        """Wake an executor that waits, for something that is not in the queue."""
        with suppress(OSError):  # full: it is woken already
            self._writes.send(b"!")

    def take(self) -> Cause | None:
        """Return the next command, a stop before any other; None where there is none.

        A stop drops all commands before it, so that a waiting resume cannot undo it.
        """
        if self._stop:
            self._stop = False
            self._asked.clear()
            return Cause.STOP
        return self._asked.popleft() if self._asked else None

    def fileno(self) -> int:
        """Return the file descriptor that is readable while commands wait."""
        return self._reads.fileno()

    def woken(self) -> None:
        """Clear the signal of waiting commands."""
        with suppress(OSError):
            while self._reads.recv(4096):
                pass

    def close(self) -> None:
        """Close its sockets."""
        self._reads.close()
        self._writes.close()
