"""The process that stands between an executor and LinuxCNC's HAL, and the link to it.

HAL plays by itself what it was sent: where this process or the executor dies, it plays on to the
rest that it holds. This process ends it when it stands.
"""

from __future__ import annotations

import signal
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from threadline.arrays import IntArray
from threadline.errors import LinkFaultError
from threadline.importing import words_of
from threadline.live.hal_rows import HalRows
from threadline.live.hal_session import HalSession
from threadline.live.machine_process import be_told, process_link
from threadline.live.wire import Connection, Message
from threadline.machine import Machine

_LOOK_S = 0.005
"""Time from one look at HAL's samples to the next, s."""
_CHILD = words_of("threadline.live.hal_process", "be_hal")


@contextmanager
def hal_link(machine: Machine, start: IntArray, *, plant: bool) -> Iterator[Connection]:
    """Start HAL and the process in front of it, and yield the link.

    Parameters
    ----------
    machine, start, plant
        See ``HalSession``.
    """
    with process_link(_CHILD, (machine, start, plant)) as connection:
        yield connection


def be_hal() -> None:
    """Serve as the machine that the parent process describes through a pipe."""
    end, (machine, start, plant) = be_told()
    serve_hal(end, machine, start, plant=plant)


def serve_hal(end: socket.socket, machine: Machine, start: IntArray, *, plant: bool) -> None:
    """Serve at a socket until the executor leaves or is gone, and HAL stands."""
    # A key or a signal is for the executor, which brakes: this process is the machine.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    connection = Connection(end)
    try:
        hal = HalSession(machine, start, plant=plant)
    except LinkFaultError as error:
        connection.send(Message("refused", {"what": "hello", "why": error.message}))
        connection.close()
        return
    rows = HalRows(machine, start, connection.send, hal, plant=plant)
    rows.greet()
    with suppress(LinkFaultError):  # HAL is gone, or what came is no message: nobody to obey
        _serve(connection, rows)
    connection.close()
    hal.close()


def _serve(connection: Connection, rows: HalRows) -> None:
    looked = time.monotonic()
    while not (connection.lost or rows.left):
        message = connection.receive(looked + _LOOK_S - time.monotonic())
        if (now := time.monotonic()) >= looked + _LOOK_S:
            rows.go_on(now - looked)  # first: what was played decides on what can be taken
            looked = now
        if message is not None:
            rows.take(message)
