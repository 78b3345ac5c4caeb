"""The web server's side of the connection to the process that owns the machine."""

from __future__ import annotations

import asyncio
import subprocess
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

from threadline.errors import LinkFaultError
from threadline.live.lateness import clock_s
from threadline.live.wire import Connection, Message

_ENDS_S = 2.0
"""Time in s in which an owner that was left has freed the link; it may judge a run for longer."""
_GONE = "the process that owns the machine is gone; the machine has braked by itself"


class OwnerLink:
    """Sends requests to the owner, and keeps what it says.

    Parameters
    ----------
    start
        Starts an owner.

    Attributes
    ----------
    now
        Latest report: state, axes, progress; see ``Owner``.
    heard_s
        When it came, on the clock that counts sleep.
    gone
        Why there is no owner; empty while there is one.
    """

    def __init__(
        self, start: Callable[[], tuple[subprocess.Popen[bytes] | None, Connection]]
    ) -> None:
        self._start = start
        self.now: Mapping[str, Any] = {}
        self.heard_s = clock_s()
        self.gone = "not connected"
        self._heard: Callable[[Message], None] = lambda _: None
        self._process: subprocess.Popen[bytes] | None = None
        self._connection: Connection | None = None
        self._beginning: asyncio.Task[None] | None = None

    def connect(self, heard: Callable[[Message], None]) -> None:
        """Start an owner, and listen to it in a thread; to be called on the event loop.

        An owner before it is left first, and waited for, as it may still have the machine's link.

        Parameters
        ----------
        heard
            Called on the loop with each message but the reports of the machine.
        """
        if self._beginning is not None:
            return  # it is being begun
        before = self._leave()
        self._heard, self.now, self.gone = heard, {}, ""
        if before is None:
            self._begin()
        else:
            self._beginning = asyncio.create_task(self._begin_after(before))

    async def _begin_after(self, before: subprocess.Popen[bytes]) -> None:
        await asyncio.to_thread(_wait_for, before)
        self._beginning = None
        self._begin()

    def _begin(self) -> None:
        try:
            self._process, self._connection = self._start()
        except OSError as error:
            why = error.strerror or error
            self.gone = f"the process that owns the machine cannot be started: {why}"
            return
        loop = asyncio.get_running_loop()
        threading.Thread(target=self._listen, args=(self._connection, loop), daemon=True).start()

    def send(self, kind: str, **head: Any) -> None:
        """Send a request, with the time at which it was asked for."""
        if self._connection is not None:
            self._connection.send(Message(kind, {"at_s": clock_s(), **head}))

    def _listen(self, connection: Connection, loop: asyncio.AbstractEventLoop) -> None:
        while True:
            try:
                message = connection.receive()
            except (LinkFaultError, OSError, ValueError):
                message = None
            with suppress(RuntimeError):  # the loop is closed: the server ends
                loop.call_soon_threadsafe(self._take, connection, message)
            if message is None:
                return

    def _take(self, connection: Connection, message: Message | None) -> None:
        if connection is not self._connection:
            return  # of an owner before this one
        if message is None:
            self.gone = self.gone or _GONE
        elif message.kind == "now":
            self.now, self.heard_s = message.head, clock_s()
        elif message.kind == "dead":
            self.gone = str(message.head["why"])
        else:
            self._heard(message)

    def _leave(self) -> subprocess.Popen[bytes] | None:
        """Leave the owner, which stops the machine and ends; return its process, if it has one."""
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.close()
        process, self._process = self._process, None
        return process

    async def close(self) -> None:
        """Leave the owner, which stops the machine and ends; wait for it a little."""
        if self._beginning is not None:
            self._beginning.cancel()
        if (process := self._leave()) is not None:
            await asyncio.to_thread(_wait_for, process)


def _wait_for(process: subprocess.Popen[bytes]) -> None:
    with suppress(subprocess.TimeoutExpired):
        process.wait(_ENDS_S)
