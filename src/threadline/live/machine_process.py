"""A separate process for the far end of a link, and the link to it."""

from __future__ import annotations

import os
import pickle
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from threadline.base.importing import program_apart
from threadline.live.wire import Connection

_SEND_S = 2.0
"""Time in s after which an unsent message means that the other side is gone."""
_JOIN_S = 10.0


@contextmanager
def process_link(program: str, sent: tuple[Any, ...]) -> Iterator[Connection]:
    """Start a process for a machine, and yield the link to it.

    A forked process would share open files with its parent, and a process of ``multiprocessing``
    would run the main program of the caller again.

    Parameters
    ----------
    program
        Python code that calls ``machine_end`` and serves.
    sent
        Object sent to the process through a pipe.
    """
    ours, theirs = socket.socketpair()
    process = subprocess.Popen(  # noqa: S603  # this interpreter, and words of ours
        [*program_apart(program), str(theirs.fileno())],
        stdin=subprocess.PIPE,
        pass_fds=(theirs.fileno(),),
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        start_new_session=True,  # keys of the terminal are for the executor
    )
    theirs.close()
    assert process.stdin is not None
    with suppress(BrokenPipeError), process.stdin as pipe:  # if it died, no greeting will come
        pickle.dump(sent, pipe)
    ours.settimeout(_SEND_S)
    connection = Connection(ours)
    try:
        yield connection
    finally:
        connection.close()
        try:
            process.wait(_JOIN_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def machine_end() -> tuple[socket.socket, Any]:
    """Return this process's end of the link, and the object from the parent process."""
    sent = pickle.load(sys.stdin.buffer)  # noqa: S301  # of the parent, through a pipe of its own
    return socket.socket(fileno=int(sys.argv[1])), sent
