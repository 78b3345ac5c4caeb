"""The process of the simulated machine, and the link to it.

At real time each tick has its instant; one that comes more than half a period late is counted,
and the ticks after it are not hurried. At any other speed the machine's time goes on only when the
executor has answered its last report, so that a busy computer changes nothing in what happens.
"""

from __future__ import annotations

import os
import pickle
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from math import ceil

from threadline.arrays import IntArray
from threadline.live.sim_faults import SimFault
from threadline.live.sim_machine import LATE, SimMachine
from threadline.live.wire import Connection, Message
from threadline.machine import Machine

REAL_TIME = 1.0
_WAKE_S = 0.005
"""A Python loop is woken no more often than this: shorter ticks are played several at a time."""
_SEND_S = 2.0
"""A message that cannot be sent for so long, s: the other side no longer reads."""
_JOIN_S = 10.0
_CHILD = "from threadline.live.sim_process import be_machine; be_machine()"
"""Not a fork, which would share what is open, nor a spawned one, which would run the main program
of whoever calls anew."""


def group_ticks(machine: Machine, speed: float) -> int:
    """Return how many ticks the simulated machine plays between two reports."""
    period_s = float(machine.tick_clock.period_s)
    return max(1, ceil((_WAKE_S if speed == REAL_TIME else 5 * _WAKE_S) / period_s - 1e-9))


@contextmanager
def sim_link(
    machine: Machine, start_counts: IntArray, speed: float, fault: SimFault | None = None
) -> Iterator[Connection]:
    """Start a simulated machine in a process of its own, and give the link to it.

    Parameters
    ----------
    machine
        What is simulated.
    start_counts
        (axes,) where it stands when it is switched on.
    speed
        Its seconds in a second: 1 is real time; 0 is as fast as it can.
    fault
        What goes wrong with it.
    """
    ours, theirs = socket.socketpair()
    process = subprocess.Popen(  # noqa: S603  # this interpreter, and words of ours
        [sys.executable, "-c", _CHILD, str(theirs.fileno())],
        stdin=subprocess.PIPE,
        pass_fds=(theirs.fileno(),),
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        start_new_session=True,  # keys of the terminal are for the executor
    )
    theirs.close()
    assert process.stdin is not None
    with suppress(BrokenPipeError), process.stdin as told:  # it may have died: nobody greets then
        pickle.dump((machine, start_counts, speed, fault), told)
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


def be_machine() -> None:
    """Be the simulated machine that the parent of this process describes."""
    told = pickle.load(sys.stdin.buffer)  # noqa: S301  # of the parent, through a pipe of its own
    serve(socket.socket(fileno=int(sys.argv[1])), *told)


def serve(
    end: socket.socket,
    machine: Machine,
    start_counts: IntArray,
    speed: float,
    fault: SimFault | None = None,
) -> None:
    """Be the simulated machine at ``end`` until the executor leaves or is gone."""
    # A key or a signal is for the executor, which brakes: this process is the machine.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    connection = Connection(end)
    simulated = SimMachine(machine, start_counts, connection.send, fault)
    simulated.greet()
    period_s = float(machine.tick_clock.period_s)
    group = group_ticks(machine, speed)
    with suppress(KeyboardInterrupt):
        if speed == REAL_TIME:
            _in_real_time(connection, simulated, group, period_s)
        else:
            _in_step(connection, simulated, group, period_s / speed if speed else 0.0)
        while (
            not simulated.standing and simulated.silenced != "power-loss"
        ):  # nobody is there any more: brake and stand
            simulated.play(group)
    connection.close()


def _in_step(connection: Connection, simulated: SimMachine, group: int, period_s: float) -> None:
    """Play a group of ticks after each answer, and no faster than ``period_s`` for each tick."""
    due = time.monotonic()
    while not (connection.lost or simulated.left):
        message = connection.receive()
        if message is None:
            return
        simulated.take(message)
        if simulated.begun and message.kind == "go":
            due = max(due + group * period_s, time.monotonic())
            time.sleep(max(0.0, due - time.monotonic()))
            simulated.play(group)
            if simulated.silenced:
                connection.close()


def _in_real_time(
    connection: Connection, simulated: SimMachine, group: int, period_s: float
) -> None:
    """Play a group of ticks at each of its instants."""
    due: float | None = None
    while not (connection.lost or simulated.left):
        wait_s = None if due is None else due - time.monotonic()
        message: Message | None = connection.receive(wait_s)
        if message is not None:
            simulated.take(message)
            if due is None and simulated.begun and not simulated.standing:
                due = time.monotonic()
            continue
        if due is None or connection.lost:
            continue
        late_s = time.monotonic() - due
        late_by = late_s / (period_s * group)
        simulated.play(group, late_by)
        if simulated.silenced:
            connection.close()
        # Never caught up by bursts: after a late tick the others come a whole period apart.
        due = (time.monotonic() if late_by > LATE else due) + group * period_s
