"""The web server's side of the connection to the process that owns the machine."""

from __future__ import annotations

import asyncio
import os
import pickle
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping
from contextlib import closing, suppress
from typing import Any

from threadline.base.importing import import_and_call, program_apart
from threadline.errors import LinkFaultError, ThreadlineError
from threadline.live.guards import clock_s
from threadline.live.links import at_link, operated
from threadline.live.states import Desk
from threadline.live.wire import Connection, Message
from threadline.panel.owner import Owner
from threadline.panel.stored_runs import Owned, StoredRuns

_ENDS_S = 2.0
"""Longest time in s for an abandoned owner to release the link; its judging may take longer."""
_GONE = "the process that owns the machine is gone; the machine has braked by itself"


class OwnerLink:
    """Sends requests to the owner, and keeps its reports.

    Parameters
    ----------
    start
        Starts an owner.

    Attributes
    ----------
    now
        Latest report: state, axes, progress; see ``Owner``.
    heard_s
        Instant of the latest report, s, on a clock that also runs while the computer sleeps.
    gone
        Reason why there is no owner; empty while there is one.
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
        """Start an owner, and listen to it in a thread; call this method on the event loop.

        A previous owner is left first. The start waits for its end, because it may still hold the
        machine's link.

        Parameters
        ----------
        heard
            Called on the loop with each message except the reports of the machine.
        """
        if self._beginning is not None:
            return  # an owner is starting
        previous_process = self._leave()
        self._heard, self.now, self.gone = heard, {}, ""
        if previous_process is None:
            self._begin()
        else:
            self._beginning = asyncio.create_task(self._begin_after(previous_process))

    async def _begin_after(self, previous_process: subprocess.Popen[bytes]) -> None:
        await asyncio.to_thread(_wait_for, previous_process)
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
        """Send a request, with the time of the request."""
        if self._connection is not None:
            self._connection.send(Message(kind, {"at_s": clock_s(), **head}))

    def _listen(self, connection: Connection, loop: asyncio.AbstractEventLoop) -> None:
        while True:
            try:
                message = connection.receive()
            except (LinkFaultError, OSError, ValueError):
                message = None
            with suppress(RuntimeError):  # the event loop is closed, because the server ends
                loop.call_soon_threadsafe(self._take, connection, message)
            if message is None:
                return

    def _take(self, connection: Connection, message: Message | None) -> None:
        if connection is not self._connection:
            return  # from a previous owner
        if message is None:
            self.gone = self.gone or _GONE
        elif message.kind == "now":
            self.now, self.heard_s = message.head, clock_s()
        elif message.kind == "dead":
            self.gone = str(message.head["why"])
        else:
            self._heard(message)

    def _leave(self) -> subprocess.Popen[bytes] | None:
        """Leave the owner, which stops the machine and ends; return its process, if any."""
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


CHILD = import_and_call("threadline.panel.owner_process", "owner_main")
SEND_S = 2.0
"""Time in s after which an unsent message means that the other side is gone."""


def start_owner(owned: Owned) -> tuple[subprocess.Popen[bytes], Connection]:
    """Start the process, and return it with the connection to it.

    It has a session of its own, so that Ctrl-C in the terminal reaches the server alone; the server
    then asks it to stop.
    """
    ours, theirs = socket.socketpair()
    process = subprocess.Popen(  # noqa: S603  # this interpreter with fixed arguments
        [*program_apart(CHILD), str(theirs.fileno())],
        stdin=subprocess.PIPE,
        pass_fds=(theirs.fileno(),),
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        start_new_session=True,
    )
    theirs.close()
    assert process.stdin is not None
    with process.stdin as pipe:
        pickle.dump(owned, pipe)
    ours.settimeout(SEND_S)
    return process, Connection(ours)


def owner_main() -> None:
    """Serve as the owner of the machine that the parent process names through a pipe."""
    owned: Owned = pickle.load(sys.stdin.buffer)  # noqa: S301  # written by the parent process
    server_socket = socket.socket(fileno=int(sys.argv[1]))
    server_socket.settimeout(SEND_S)
    own(Connection(server_socket), owned)


def own(server: Connection, owned: Owned) -> None:
    """Own a machine until the server leaves; signals are ignored."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # the server handles signals, and sends a stop
    serve_owned(server, owned)


def serve_owned(server: Connection, owned: Owned) -> None:
    """Own a machine until the server leaves; report if nothing answers on the link."""
    machine, link = owned.machine, owned.link

    def said(text: str, wrong: bool) -> None:
        server.send(Message("said", {"text": text, "wrong": wrong}))

    with closing(Desk()) as desk:
        try:
            label = at_link(link, machine, owned.speed).label
            runs = StoredRuns(owned, label, said)
            with operated(link, machine, owned.speed, desk, runs) as executor:
                Owner(server, executor, machine, desk, runs).serve()
        except ThreadlineError as error:  # nothing answers on the link
            server.send(Message("dead", {"why": str(error)}))
