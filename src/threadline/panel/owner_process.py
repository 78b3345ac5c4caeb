"""The owner of the machine as a process of its own, and the server's connection to it."""

from __future__ import annotations

import os
import pickle
import signal
import socket
import subprocess
import sys
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from threadline.errors import ThreadlineError
from threadline.importing import words_of
from threadline.live.desk import Desk
from threadline.live.link_operated import at_link, operated
from threadline.live.wire import Connection, Message
from threadline.machine import Machine
from threadline.panel.kept_runs import KeptRuns
from threadline.panel.owner import Owner

_CHILD = words_of("threadline.panel.owner_process", "be_owner")
SEND_S = 2.0
"""Time in s after which a message that cannot be sent means that the other side is gone."""


@dataclass(frozen=True, slots=True)
class Owned:
    """What a process is to own.

    Parameters
    ----------
    machine, spec_file
        The machine, and the specification that its work is judged by; None is its own.
    folder, store
        Folders of the programs and of the runs.
    speed
        Seconds of the simulated machine's time in a second.
    link
        Name of the link to it.
    """

    machine: Machine
    spec_file: Path | None
    folder: Path
    store: Path
    speed: float
    link: str = "sim"


def start_owner(owned: Owned) -> tuple[subprocess.Popen[bytes], Connection]:
    """Start the process, and return it with the connection to it.

    It has a session of its own: a key of the terminal is for the server, which asks it to stop.
    """
    ours, theirs = socket.socketpair()
    process = subprocess.Popen(  # noqa: S603  # this interpreter, and words of ours
        [sys.executable, "-c", _CHILD, str(theirs.fileno())],
        stdin=subprocess.PIPE,
        pass_fds=(theirs.fileno(),),
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        start_new_session=True,
    )
    theirs.close()
    assert process.stdin is not None
    with process.stdin as told:
        pickle.dump(owned, told)
    ours.settimeout(SEND_S)
    return process, Connection(ours)


def be_owner() -> None:
    """Serve as the owner of what the parent process names through a pipe."""
    told: Owned = pickle.load(sys.stdin.buffer)  # noqa: S301  # of the parent, through its pipe
    end = socket.socket(fileno=int(sys.argv[1]))
    end.settimeout(SEND_S)
    own(Connection(end), told)


def own(server: Connection, owned: Owned) -> None:
    """Own a machine until the server leaves, whatever signals come."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # the server is asked, and this stops without it
    serve_owned(server, owned)


def serve_owned(server: Connection, owned: Owned) -> None:
    """Own a machine until the server leaves; where nothing answers, say so."""
    machine, link = owned.machine, owned.link

    def said(text: str, wrong: bool) -> None:
        server.send(Message("said", {"text": text, "wrong": wrong}))

    with closing(Desk()) as desk:
        try:
            label = at_link(link, machine, owned.speed).label
            runs = KeptRuns(
                owned.folder, machine, owned.spec_file, owned.store, link, label, owned.speed, said
            )
            with operated(link, machine, owned.speed, desk, runs) as executor:
                Owner(server, executor, machine, desk, runs).serve()
        except ThreadlineError as error:  # nothing answers there
            server.send(Message("dead", {"why": str(error)}))
