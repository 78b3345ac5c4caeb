"""Commands of the operator while a machine runs: keys of the terminal, and signals."""

from __future__ import annotations

import os
import select
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Annotated

import typer

from threadline.base.progress import Progress
from threadline.cli.messages import note
from threadline.commands.plan import Plan
from threadline.errors import CommandError, OptionError
from threadline.live.continuing import Continued, continued_by, last_executed, operation_at
from threadline.live.derived import Rest
from threadline.live.feed_override import MOST_PERCENT, STEP_PERCENT, feed_words, refuse_override
from threadline.live.job_run import UNATTENDED_S, HoldTimeout, stopping_at_signals
from threadline.live.states import Cause, Desk, State
from threadline.live.store.whole_trace import refuse_other_rows, trace_of, unfinished_run
from threadline.live.supervised import Running

_KEYS = {"h": Cause.HOLD, "r": Cause.RESUME}
_OVERRIDES = {"-": -STEP_PERCENT, "+": STEP_PERCENT}
"""Change of the override in %, by key. Any key without a meaning stops the run."""
_UNATTENDED = (
    f"nobody is at the keyboard: the run stops after {UNATTENDED_S:g} s unless it is resumed"
)


def somebody_at_the_keys() -> bool:
    """Return whether standard input is a terminal; False if it is closed."""
    return sys.stdin is not None and sys.stdin.isatty()


@contextmanager
def at_the_keys(desk: Desk, duration_s: float, progress: Progress | None) -> Iterator[AtTheKeys]:
    """Pass keys and signals to ``desk``; yield an object to call after each step of a run.

    Parameters
    ----------
    desk
        Receives the commands.
    duration_s
        Planned duration of the run.
    progress
        Called with the share done of the run; None for no progress.
    """
    with ExitStack() as stack:
        stack.enter_context(stopping_at_signals(desk))
        terminal = stack.enter_context(_terminal())
        yield AtTheKeys(desk, duration_s, progress, terminal)


class AtTheKeys:
    """Reads keys after each step of a run, and reports changes of state and progress."""

    def __init__(
        self, desk: Desk, duration_s: float, progress: Progress | None, terminal: int | None
    ) -> None:
        self._desk, self._progress, self._terminal = desk, progress, terminal
        self._duration_s = max(duration_s, 1e-9)
        self._last_hold = ""  # message already printed about the current hold
        self._hold_timeout = HoldTimeout(desk)
        self._keys_shown = terminal is None
        self._asked: int | None = None  # override in %, by the latest keys
        self._overridden = MOST_PERCENT  # the override last reported
        self.time_s = 0.0
        """Time of the run at its latest step, s."""

    def confirmed(self) -> bool | None:
        """Return whether ``c`` was pressed, False for any other key; None for no key."""
        if self._terminal is None or (keys := self._pressed(1)) is None:
            return None
        return keys == b"c"

    def _pressed(self, most: int) -> bytes | None:
        """Return pressed keys, b"" if the terminal is gone, None for no key."""
        if self._terminal is None or not select.select([self._terminal], [], [], 0.0)[0]:
            return None
        keys = b""
        with suppress(OSError):  # the terminal hung up
            keys = os.read(self._terminal, most)
        if not keys:
            self._terminal = None
        return keys

    def step(self, executor: Running) -> None:
        """Pass the keys to the desk; print progress, and a message while the run holds."""
        if not self._keys_shown:
            self._keys_shown = True
            note(
                "- and + override the feed by 10 %, h holds, r goes on, any other key stops; none "
                "of them is the emergency stop"
            )
        for key in (self._pressed(16) or b"").decode("utf-8", "replace"):
            if key in _OVERRIDES:
                self._override(executor, _OVERRIDES[key])
            else:
                self._desk.ask(_KEYS.get(key, Cause.STOP))
        self._tell_override(executor)
        self._tell_hold(executor)
        self.time_s = executor.time_s
        if self._progress is not None:
            self._progress("running", min(executor.plan_s / self._duration_s, 1.0))

    def _override(self, executor: Running, by: int) -> None:
        """Ask for an override by a step, or say why there is none."""
        percent = (executor.percent if self._asked is None else self._asked) + by
        try:
            refuse_override(percent, executor.state, executor.no_override)
        except CommandError as error:
            note(str(error))
            return
        self._asked = percent
        self._desk.override(percent)

    def _tell_override(self, executor: Running) -> None:
        """Print an override that is in force."""
        if self._asked == executor.percent:
            self._asked = None
        if executor.percent != self._overridden:
            self._overridden = executor.percent
            note(feed_words(self._overridden))

    def _tell_hold(self, executor: Running) -> None:
        """Print why a run holds and who can resume it; stop a hold that nobody can end."""
        if self._terminal is None:
            self._hold_timeout.step(executor)
        if executor.state is not State.HOLDING:
            self._last_hold = ""
            return
        nobody = self._terminal is None
        options_text = _UNATTENDED if nobody else "r goes on, any other key stops"
        text = (
            f"holding: {executor.why}; {options_text}"
            if executor.why
            else f"holding: {options_text}"
        )
        if text != self._last_hold:
            self._last_hold = text
            note(text)


@contextmanager
def _terminal() -> Iterator[int | None]:
    """Yield the descriptor of the terminal, its keys unbuffered; None if there is no terminal."""
    if not somebody_at_the_keys():
        yield None
        return
    import termios
    import tty

    assert sys.stdin is not None

    number = sys.stdin.fileno()
    previous_settings = termios.tcgetattr(number)
    tty.setcbreak(number)
    try:
        yield number
    finally:
        with suppress(termios.error):  # the terminal hung up
            termios.tcsetattr(number, termios.TCSADRAIN, previous_settings)


RestOf = Callable[[int], Rest]
ContinueOption = Annotated[
    str | None,
    typer.Option(
        "--continue",
        metavar="RUN",
        help="Complete a run that was broken off (its name, or last): after homing and your "
        "confirmation the axes move to where the work begins again.",
    ),
]
AtOption = Annotated[
    str | None,
    typer.Option(
        help="With --continue: where the work begins again: block (the interrupted operation), "
        'circuit, "circuit 12", "line 40", "stitch 120", or "back 10" for ten stitches before.'
    ),
]
ConfirmedOption = Annotated[
    bool, typer.Option("--confirmed", help="With --continue: go on without waiting for the key c.")
]


def check_continued(store: Path, run: str | None, at: str | None, *, confirmed: bool) -> None:
    """Check the options of a continued run.

    Raises
    ------
    OptionError
        If --at or --confirmed lack --continue, or nobody is there to confirm.
    StoreError
        If there is no such run, or it is complete.
    """
    if run is None:
        if at is not None or confirmed:
            raise OptionError(
                f"{'--at' if at is not None else '--confirmed'} needs --continue",
                remedy="Name the run to be continued, too.",
            )
        return
    unfinished_run(store, run)
    if not confirmed and not somebody_at_the_keys():
        raise OptionError(
            "--continue: nobody is at the keyboard to confirm the run",
            remedy="Run it from a terminal, or with --confirmed.",
        )


def continued_run(
    store: Path, run: str | None, at: str | None, plan: Plan, rest_of: RestOf, *, asks: bool
) -> tuple[Continued | None, dict[str, str]]:
    """Return the rest of a broken-off run, and the entries of its recording on the first part.

    Both are empty if no run is continued. A message says which part will be run.

    Parameters
    ----------
    store
        Folder of runs.
    run, at
        The run, and where the work begins again, as typed.
    plan
        The plan; its commands must equal the run's, row by row.
    rest_of
        Returns the rest from an operation on, as sent to the link.
    asks
        Whether the operator will be asked.

    Raises
    ------
    StoreError
        If there is no such run, it is complete, or it had other commands.
    """
    if run is None:
        return None, {}
    folder, record = unfinished_run(store, run)
    refuse_other_rows(record, plan)
    operation = operation_at(
        plan, last_executed(trace_of(folder, record)), "block" if at is None else at
    )
    continued = continued_by(plan, rest_of(operation))
    for line in continued.notes:
        note(line)
    if asks:
        note("after homing, c continues the run, any other key ends the command")
    return continued, {"continues": folder.name, "from_operation": str(continued.rest.operation)}
