"""The process of the simulated machine at the far end of a link: one row for each kind of work.

That process imports only this table, neither the planner nor the judge.

In real time each group of ticks is due at an instant. A group that is played more than half of its
period late is counted as late, and the next groups are not played faster to catch up. At any other
speed the machine's clock advances only after the executor has answered the last report, so that the
load of the computer does not change the result.
"""

from __future__ import annotations

import math
import signal
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from math import ceil

from threadline.base.arrays import IntArray
from threadline.base.importing import import_and_call
from threadline.live.sim_kinds import SimRows, SimScans, SimTurns
from threadline.live.sim_machine import LATE, SimFault, SimMachine
from threadline.live.wire import Connection, Message, machine_end, process_link
from threadline.machine import Machine

_SIMULATED: dict[str, type[SimMachine]] = {
    "ticks": SimRows,
    "switches": SimScans,
    "steps": SimTurns,
}
"""By the value of ``Machine.commanded_by``."""


def simulated_of(machine: Machine) -> type[SimMachine]:
    """Return the type of the simulated machine for ``machine``."""
    return _SIMULATED[machine.commanded_by]


REAL_TIME = 1.0
SLOWER = "sim:slower"
"""Link to a simulated machine that runs in real time, or slower while the computer is busy."""
IN_STEP = math.nextafter(REAL_TIME, 0.0)
"""Speed of ``SLOWER``: practically real time, but the clock waits for the executor, as at any
other."""
HOMING_S = 0.5
"""Duration of homing in real time, s; the simulated machine stands at its home already."""
LEAST_SPEED = 1e-3
"""Least speed above 0: at a lower one the reports come later than the executor waits."""
_WAKE_S = 0.005
"""Period in s of playing in real time; ticks that are shorter are played several at a time."""
_REPORT_S = 0.025
"""Period of reports in s, unless something is urgent."""
CHILD = import_and_call("threadline.live.sim_process", "machine_main")


def group_ticks(machine: Machine, speed: float) -> int:
    """Return the number of ticks that the simulated machine plays at a time."""
    return _ticks_in(_WAKE_S if speed == REAL_TIME else _REPORT_S, machine)


def _ticks_in(duration_s: float, machine: Machine) -> int:
    return max(1, ceil(duration_s / float(machine.command_clock.period_s) - 1e-9))


@contextmanager
def sim_link(
    machine: Machine, start: IntArray, speed: float, fault: SimFault | None = None
) -> Iterator[Connection]:
    """Start a simulated machine in a separate process, and yield the link to it.

    Parameters
    ----------
    machine
        The simulated machine.
    start
        Position when it is switched on, in the units of its commands.
    speed
        Seconds of machine time per second: 1 is real time, 0 is as fast as possible.
    fault
        Injected fault, or None.
    """
    with process_link(CHILD, (machine, start, speed, fault)) as connection:
        yield connection


def machine_main() -> None:
    """Serve as the simulated machine that the parent process describes through a pipe."""
    end, arguments = machine_end()
    serve(end, *arguments)


def serve(
    end: socket.socket,
    machine: Machine,
    start: IntArray,
    speed: float,
    fault: SimFault | None = None,
) -> None:
    """Serve as a simulated machine at the socket ``end`` until the executor leaves or is gone."""
    # Keys and signals are for the executor, which brakes; this process is the machine.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    connection = Connection(end)
    simulated = simulated_of(machine)(machine, start, connection.send, fault)
    simulated.rehearse()
    simulated.greet()
    period_s = float(machine.command_clock.period_s)
    group = group_ticks(machine, speed)
    with suppress(KeyboardInterrupt):
        if speed == REAL_TIME:
            simulated.report_ticks = _ticks_in(_REPORT_S, machine)
            _in_real_time(connection, simulated, group, period_s)
        else:
            in_step(connection, simulated, group, period_s / speed if speed else 0.0)
        while (
            not simulated.standing and simulated.silenced != "power-loss"
        ):  # the executor is gone: play the braking tail
            simulated.play(group)
    connection.close()


def in_step(connection: Connection, simulated: SimMachine, group: int, period_s: float) -> None:
    """Play the ticks that each answer asks for, at least a group, at ``period_s`` for each."""
    due_s = time.monotonic()
    while not (connection.lost or simulated.left):
        message = connection.receive()
        if message is None:
            return
        simulated.take(message)
        if simulated.begun and message.kind == "go":
            ticks = max(group, int(message.head.get("ticks", group)))
            due_s = max(due_s + ticks * period_s, time.monotonic())
            time.sleep(max(0.0, due_s - time.monotonic()))
            simulated.play(ticks)
            if simulated.silenced:
                connection.close()


def _in_real_time(
    connection: Connection, simulated: SimMachine, group: int, period_s: float
) -> None:
    """Play a group of ticks at each due instant."""
    due_s: float | None = None
    while not (connection.lost or simulated.left):
        wait_s = None if due_s is None else due_s - time.monotonic()
        message: Message | None = connection.receive(wait_s)
        if message is not None and message.kind == "home" and simulated.standing:
            _home(connection, simulated, message)
        elif message is not None:
            simulated.take(message)
            # Empty rows are a motion too: to the present position, and over at once.
            if due_s is None and simulated.begun and message.kind == "refill":
                due_s = time.monotonic()
            continue
        if due_s is None or connection.lost:
            continue
        late_s = time.monotonic() - due_s
        late_by = late_s / (period_s * group)
        simulated.play(group, late_by)
        if simulated.silenced:
            connection.close()
        # Never caught up by bursts: after a late tick the others come a whole period apart.
        due_s = (time.monotonic() if late_by > LATE else due_s) + group * period_s


def _home(connection: Connection, simulated: SimMachine, request: Message) -> None:
    """Wait for the duration of homing, and accept a stop during it."""
    until_s = time.monotonic() + HOMING_S
    while (left_s := until_s - time.monotonic()) > 0.0 and not connection.lost:
        message = connection.receive(left_s)
        if message is not None and message.kind == "stop-home":
            connection.send(Message("refused", {"what": "home", "why": "it was stopped"}))
            return
        if message is not None:
            simulated.take(message)
    simulated.take(request)
