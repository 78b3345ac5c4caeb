"""One run of a proven plan: it is executed, stored and judged."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, suppress
from contextlib import closing as closed
from dataclasses import dataclass
from types import FrameType
from typing import Any, Protocol

from threadline.base.arrays import finite
from threadline.commands.plan import Plan
from threadline.errors import LinkFaultError, OptionError, RecordingError, StoreError
from threadline.files import Recording, RunEnd
from threadline.live.continuing import Continued
from threadline.live.guards import clock_s
from threadline.live.links import Link
from threadline.live.sim_process import LEAST_SPEED
from threadline.live.states import Cause, Desk, Hold, State
from threadline.live.store.run_store import OpenRun
from threadline.live.store.whole_trace import joined_with, whole_recording
from threadline.live.supervised import Conduct, Interventions, Running
from threadline.verdict import Spec, Verdict, judge, verdict_json

_MOST_SPEED = 1e6
UNATTENDED_S = 10.0
"""Longest hold in s while nobody is at the keyboard to end it."""


def checked_speed(speed: float) -> float:
    """Return a speed of the simulated machine, a multiple of real time; 0: as fast as it can.

    Raises
    ------
    OptionError
        If no link has that speed.
    """
    if not 0.0 <= speed <= _MOST_SPEED:
        raise OptionError(
            f"--speed {max(min(speed, 1e300), -1e300):g} is not between 0 and {_MOST_SPEED:g}",
            remedy="1 is real time, 0 is as fast as it can.",
        )
    if 0.0 < speed < LEAST_SPEED:
        raise OptionError(
            f"--speed {speed:g} is slower than the link can wait",
            remedy=f"Give {LEAST_SPEED:g} or more, or 0 for as fast as it can.",
        )
    return speed


class Attending(Protocol):
    """Somebody, or something, that attends a run."""

    time_s: float
    """Time of the run at its latest step, s."""

    def step(self, executor: Running) -> None:
        """Pass commands on, after each step of the run."""

    def confirmed(self) -> bool | None:
        """Return whether the run may go on from where it was broken off; None: no answer yet."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Manner:
    """How a plan is run.

    Parameters
    ----------
    may
        Holds and feed overrides that do not spoil the work of the plan.
    recorded
        Entries of the recording's origin besides the options of the plan, such as ``link``.
    pass_stops
        Whether stops of the program are passed without an answer.
    again
        The rest of a run that was broken off; None for a whole run.
    confirmed
        Whether the rest is run without asking.
    """

    may: Interventions
    recorded: Mapping[str, str]
    pass_stops: bool = False
    again: Continued | None = None
    confirmed: bool = False


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Executed:
    """A run that is over.

    Parameters
    ----------
    open_run
        Its folder in the store.
    ended, text
        How it ended, and why.
    time_s
        Time of the run at its latest step, s.
    """

    open_run: OpenRun
    ended: RunEnd
    text: str
    time_s: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JudgedRun:
    """A run that was judged, or that ended before there was anything to judge.

    Parameters
    ----------
    recording
        Its recording, with the parts of the runs that it continues.
    verdict
        The verdict; None if there was nothing to judge.
    text
        Why it ended, or why there is no verdict.
    content
        The verdict with its details, as stored in the folder of the run; empty without a verdict.
    before
        Earlier runs that this run continues; they were judged with it.
    warned
        Why the index of the store could not be written; empty if it was.
    """

    recording: Recording
    verdict: Verdict | None
    text: str
    content: Mapping[str, Any]
    before: tuple[str, ...] = ()
    warned: str = ""


def execute(
    over: Link,
    plan: Plan,
    open_run: OpenRun,
    manner: Manner,
    attended: Callable[[Desk], AbstractContextManager[Attending]],
) -> Executed:
    """Run a checked plan, and close the folder of the run.

    Parameters
    ----------
    over
        The link, prepared.
    open_run
        The folder of the run.
    attended
        Returns who attends the run and gives commands to the desk.

    Raises
    ------
    LinkFaultError
        If the run could not be stored; the machine may have moved.
    """
    with moved(open_run), closed(Desk()) as desk, attended(desk) as keys, open_run:
        conduct = Conduct(
            pass_stops=manner.pass_stops,
            hold=manner.may.hold,
            no_override=manner.may.no_override,
            watch=keys.step,
            again=manner.again,
            confirmed=(lambda: True) if manner.confirmed else keys.confirmed,
        )
        ended, text = over.run(plan, desk, open_run, conduct)
    with suppress(StoreError):  # a locked index may be free when the verdict is stored
        open_run.over(ended.value, text)
    return Executed(open_run=open_run, ended=ended, text=text, time_s=keys.time_s)


def judge_run(done: Executed, plan: Plan, spec: Spec, manner: Manner) -> JudgedRun:
    """Judge the recording of a run, and keep the verdict in its folder.

    Raises
    ------
    RecordingError
        If a trace cannot be read, or a completed run recorded nothing that could be judged.
    LinkFaultError
        If the verdict could not be stored.
    """
    open_run, text, is_whole = done.open_run, done.text, manner.again is None
    earlier_runs = () if is_whole else joined_with(open_run.trace)
    recording = whole_recording(open_run.trace)
    try:
        verdict = judge([recording], plan, spec)
    except RecordingError as error:
        if done.ended is RunEnd.COMPLETED and is_whole:
            raise
        text = text or f"NOT PROVEN: the rest of a job alone is not judged ({error.message})"
        with moved(open_run):
            open_run.unjudged(done.ended.value, text)
        return JudgedRun(recording=recording, verdict=None, text=text, content={})
    content = _content(verdict, plan, done, manner, earlier_runs)
    with moved(open_run):
        warned = open_run.judged(content, done.ended.value, text)
    return JudgedRun(
        recording=recording, verdict=verdict, text=text, content=content, before=earlier_runs,
        warned=warned,
    )  # fmt: skip


def _content(
    verdict: Verdict, plan: Plan, done: Executed, manner: Manner, earlier_runs: tuple[str, ...]
) -> dict[str, Any]:
    may = manner.may
    return {
        **verdict_json(verdict, plan),
        **manner.recorded,
        "run": done.open_run.path.name,
        "trace": str(done.open_run.trace),
        "ended": done.ended.value,
        "hold_deviation_m": finite(may.hold_deviation_m),
        "hold": may.hold.value,
        "hold_waits_for_rest": may.hold is Hold.AT_REST,
        "spoiled_by_holds": [
            {"name": r.name, "axis": r.axis, "measured": r.measured, "limit": r.limit}
            for r in may.spoiled_by_holds
        ],
        "no_feed_override": may.no_override,
        **({"judged_with": earlier_runs} if earlier_runs else {}),
    }


@contextmanager
def moved(open_run: OpenRun) -> Iterator[None]:
    """Report a failure to store a run as a fault of the machine, since it may have moved.

    Errors of the executor from before any motion pass unchanged.

    Raises
    ------
    LinkFaultError
        If the run could not be stored.
    """
    try:
        yield
    except (OSError, StoreError) as error:
        why = error.message if isinstance(error, StoreError) else error.strerror or str(error)
        raise LinkFaultError(
            f"the run could not be kept in {open_run.path}: {why}",
            remedy="The machine may have moved: look at it, then home it. Make room, or give "
            "another folder with --store.",
        ) from error


def fault_of(done: Executed, over: Link) -> LinkFaultError:
    """Return the error that tells the fault of a run, and where its recording is."""
    return LinkFaultError(
        done.text,
        remedy=f"What was recorded is in {done.open_run.path}. {over.after_fault} Look at the "
        "machine, then home it.",
    )


class HoldTimeout:
    """Ends a hold after ``UNATTENDED_S``, where nobody is at the keyboard.

    Parameters
    ----------
    desk
        Receives the stop.
    """

    def __init__(self, desk: Desk) -> None:
        self._desk = desk
        self._deadline_s: float | None = None

    def step(self, executor: Running) -> None:
        """Stop a run that holds for longer than ``UNATTENDED_S``."""
        if executor.state is not State.HOLDING:
            self._deadline_s = None
            return
        now_s = clock_s()
        self._deadline_s = now_s + UNATTENDED_S if self._deadline_s is None else self._deadline_s
        if now_s >= self._deadline_s:
            executor.stopped_by = "Threadline: nobody is at the keyboard to resume"
            self._desk.ask(Cause.STOP)


class Unattended:
    """Attends a run without an operator: it ends long holds, and confirms nothing."""

    def __init__(self, desk: Desk) -> None:
        self._hold_timeout = HoldTimeout(desk)
        self.time_s = 0.0

    def step(self, executor: Running) -> None:
        """Note the time, and end a hold that lasts."""
        self.time_s = executor.time_s
        self._hold_timeout.step(executor)

    def confirmed(self) -> bool | None:
        """Confirm nothing: nobody looked at the machine."""
        return False


@contextmanager
def unattended(desk: Desk) -> Iterator[Unattended]:
    """Attend a run without an operator; signals stop it."""
    with stopping_at_signals(desk):
        yield Unattended(desk)


@contextmanager
def stopping_at_signals(desk: Desk) -> Iterator[None]:
    """Stop along the path at the first interrupt, raise ``KeyboardInterrupt`` at the second.

    Python hands signals to the main thread; a run in another thread is stopped by its desk alone.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    received_signals: list[int] = []

    def handle(number: int, _frame: FrameType | None) -> None:
        received_signals.append(number)
        desk.ask(Cause.STOP)
        if len(received_signals) > 1:
            raise KeyboardInterrupt

    signal_numbers = [signal.SIGINT, signal.SIGTERM]
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # nohup: the run outlives it
        signal_numbers.append(signal.SIGHUP)
    previous_handlers = {number: signal.signal(number, handle) for number in signal_numbers}
    try:
        yield
    finally:
        for number, handler in previous_handlers.items():
            signal.signal(number, handler)
