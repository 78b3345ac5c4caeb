"""The process between an executor and LinuxCNC's HAL, and the link to it.

HAL plays the rows that it holds by itself: if this process or the executor dies, HAL plays on until
the rows end at rest. This process ends HAL once the axes stand.
"""

from __future__ import annotations

import shutil
import signal
import socket
import time
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress

from threadline.base.arrays import IntArray
from threadline.base.importing import import_and_call
from threadline.commands.plan import Plan
from threadline.errors import LinkFaultError, OptionError
from threadline.live.hal_rows import HalRows
from threadline.live.hal_session import (
    AXES_AT_MOST,
    HAL_KEY,
    HalSession,
    as_user,
    in_use,
    words_to_end,
)
from threadline.live.supervised import ExecutedLink
from threadline.live.wire import Connection, Message, machine_end, process_link
from threadline.machine import Machine
from threadline.proof.kinds import kind_of

_LOOK_S = 0.005
"""Interval between two readings of HAL's samples, s."""
CHILD = import_and_call("threadline.live.hal_link", "hal_main")


@contextmanager
def hal_link(machine: Machine, start: IntArray, *, plant: bool) -> Iterator[Connection]:
    """Start HAL and the process in front of it, and yield the link.

    Parameters
    ----------
    machine, start, plant
        See ``HalSession``.
    """
    with process_link(CHILD, (machine, start, plant)) as connection:
        yield connection


def hal_main() -> None:
    """Serve as the machine that the parent process describes through a pipe."""
    end, (machine, start, plant) = machine_end()
    serve_hal(end, machine, start, plant=plant)


def serve_hal(end: socket.socket, machine: Machine, start: IntArray, *, plant: bool) -> None:
    """Serve at a socket until the executor leaves or is gone, and HAL stands."""
    # Keys and signals are for the executor, which brakes; this process is the machine.
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
    with suppress(LinkFaultError):  # HAL is gone, or bytes are no message: nobody commands
        _serve(connection, rows)
    connection.close()
    hal.close()


def _serve(connection: Connection, rows: HalRows) -> None:
    looked_s = time.monotonic()
    while not (connection.lost or rows.left):
        message = connection.receive(looked_s + _LOOK_S - time.monotonic())
        if (now_s := time.monotonic()) >= looked_s + _LOOK_S:
            rows.go_on(now_s - looked_s)  # first: the played rows decide which refills fit
            looked_s = now_s
        if message is not None:
            rows.take(message)


WHAT = {
    "loopback": "a loopback: HAL returns its commands; nothing is measured",
    "plant": "HAL's plant, a lag for each axis: not the machine",
}
"""Description of the far end, by the word after ``hal:``."""
_PROGRAMS = ("halcmd", "halrun")


def check_hal(machine: Machine) -> None:
    """Refuse a machine or a computer that HAL cannot run on; nothing is started.

    Raises
    ------
    OptionError
        If HAL cannot run the machine, is not installed, or runs already; the message says which.
    """
    if "ticks" not in kind_of(machine).targets or len(machine.axes) > AXES_AT_MOST:
        raise OptionError(
            f"{machine.name} is not driven by tables of ticks of at most {AXES_AT_MOST} axes",
            remedy="Use --link sim.",
        )
    if (10**9 * machine.tick_clock.period_s).denominator != 1:
        raise OptionError(
            f"the tick of {machine.name} is not a whole number of nanoseconds",
            remedy="Use --link sim.",
        )
    missing = [name for name in _PROGRAMS if shutil.which(name) is None]
    if missing:
        raise OptionError(
            f"LinuxCNC's HAL is not installed: there is no {' and no '.join(missing)}",
            remedy="Install linuxcnc-uspace.",
        )
    as_user()
    if in_use(HAL_KEY):
        raise OptionError(
            "LinuxCNC's HAL runs on this computer already",
            remedy=f"End LinuxCNC; after a run that was killed: {' '.join(words_to_end())}.",
        )


class HalLink(ExecutedLink):
    """The link to LinuxCNC's HAL.

    Parameters
    ----------
    what
        ``loopback`` or ``plant``.
    machine
        The machine whose axes and tick HAL has.

    Raises
    ------
    OptionError
        If there is no such link, HAL cannot run, or the machine has no encoders.
    """

    def __init__(self, what: str, machine: Machine) -> None:
        if what not in WHAT:
            raise OptionError(
                f"there is no link hal:{what[:20]}", remedy="Use hal:loopback or hal:plant."
            )
        super().__init__(1.0)
        self._plant = what == "plant"
        self.label = WHAT[what]
        if self._plant and machine.takes_positions:
            raise OptionError(
                f"{machine.name} has no encoders that a plant could answer with",
                remedy="Use hal:loopback.",
            )
        check_hal(machine)

    @property
    def after_fault(self) -> str:
        """Reaction of HAL to a fault, for people."""
        return "HAL has played the rows that it held, which end at rest."

    def prepare(self, plan: Plan) -> Sequence[str]:  # noqa: ARG002
        """Return the name of the far end."""
        return [self.label]

    def _connected(self, machine: Machine, start: IntArray) -> AbstractContextManager[Connection]:
        """Start HAL and the process between it and the executor."""
        return hal_link(machine, start, plant=self._plant)
