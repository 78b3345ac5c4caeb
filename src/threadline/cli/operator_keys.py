"""Commands of the operator while a machine runs: keys of the terminal, and signals."""

from __future__ import annotations

import os
import select
import signal
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from types import FrameType

from threadline.cli.told import note
from threadline.live.desk import Desk
from threadline.live.links import Running
from threadline.live.states import Cause, State
from threadline.progress_call import Progress

_KEYS = {"h": Cause.HOLD, "r": Cause.RESUME}
"""Any other key stops."""


@contextmanager
def at_the_keys(desk: Desk, duration_s: float, progress: Progress | None) -> Iterator[AtTheKeys]:
    """Pass keys and signals to ``desk``; yield what looks after each step of a run for keys.

    Parameters
    ----------
    desk
        Receives the commands.
    duration_s
        Planned duration of the run.
    progress
        Called with the share of the run that is done; None for no progress.
    """
    with ExitStack() as stack:
        stack.enter_context(_signals(desk))
        terminal = stack.enter_context(_terminal())
        yield AtTheKeys(desk, duration_s, progress, terminal)


class AtTheKeys:
    """Looks after each step of a run for keys, a change of state, and the progress."""

    def __init__(
        self, desk: Desk, duration_s: float, progress: Progress | None, terminal: int | None
    ) -> None:
        self._desk, self._progress, self._terminal = desk, progress, terminal
        self._duration_s = max(duration_s, 1e-9)
        self._state = State.RUNNING
        self._told = terminal is None

    def confirmed(self) -> bool | None:
        """Return whether ``c`` was pressed, False for any other key; None for no key."""
        if self._terminal is None or not select.select([self._terminal], [], [], 0.0)[0]:
            return None
        return os.read(self._terminal, 1) == b"c"

    def step(self, executor: Running) -> None:
        """Pass the keys to the desk; tell the progress of the run, and that it holds."""
        if not self._told:
            self._told = True
            note("h holds, r goes on, any other key stops; none of them is the emergency stop")
        if self._terminal is not None and select.select([self._terminal], [], [], 0.0)[0]:
            for key in os.read(self._terminal, 16).decode("utf-8", "replace"):
                self._desk.ask(_KEYS.get(key, Cause.STOP))
        if executor.state is not self._state and self._terminal is not None:
            self._state = executor.state
            if self._state is State.HOLDING:
                note("holding: r goes on, any other key stops")
        if self._progress is not None:
            self._progress("running", min(executor.time_s / self._duration_s, 1.0))


@contextmanager
def _signals(desk: Desk) -> Iterator[None]:
    """Answer a first interrupt by a stop along the path, a second by ``KeyboardInterrupt``."""
    came: list[int] = []

    def answer(number: int, _frame: FrameType | None) -> None:
        came.append(number)
        desk.ask(Cause.STOP)
        if len(came) > 1:
            raise KeyboardInterrupt

    before = {number: signal.signal(number, answer) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def _terminal() -> Iterator[int | None]:
    """Yield the descriptor of the terminal, its keys unbuffered; None if there is no terminal."""
    if not sys.stdin.isatty():
        yield None
        return
    import termios
    import tty

    number = sys.stdin.fileno()
    before = termios.tcgetattr(number)
    tty.setcbreak(number)
    try:
        yield number
    finally:
        termios.tcsetattr(number, termios.TCSADRAIN, before)
