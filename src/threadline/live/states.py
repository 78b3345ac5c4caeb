"""The states of an executor, all transitions between them, and the operator's command queue.

A cause without a transition is refused and changes nothing. ``docs/safety.md`` prints the table.
"""

from __future__ import annotations

import socket
from collections import deque
from contextlib import suppress
from enum import StrEnum
from typing import Protocol

from threadline.errors import CommandError
from threadline.files import Channel, RecordingBlock


class State(StrEnum):
    """State of the executor of one machine."""

    DISABLED = "disabled"  # the drives are off, or their state is not known
    ENABLED = "enabled"  # the drives are on; the positions of the axes are not known yet
    HOMING = "homing"
    IDLE = "idle"  # homed, at rest, ready
    JOGGING = "jogging"
    RUNNING = "running"
    HOLDING = "holding"  # braking on the path for a hold, or at rest on it
    STOPPING = "stopping"  # braking on the path for good
    FAULT = "fault"  # nothing moves before a reset


class Hold(StrEnum):
    """When a hold brakes, and how hard."""

    AT_ONCE = "at once"
    """The run brakes along the path as hard as the limits of the axes allow."""
    GENTLY = "gently"
    """The run brakes along the path in about ``braking.GENTLE_HOLD_S``, and starts again in that
    time."""
    AT_REST = "at rest"
    """The run goes on to the next rest of the program, and stands there."""


class Cause(StrEnum):
    """Cause of a transition: a command of the operator, or a reported event."""

    ENABLE = "enable"
    DISABLE = "disable"
    HOME = "home"
    HOMED = "homed"  # reported
    JOG = "jog"
    START = "start"
    HOLD = "hold"
    RESUME = "resume"
    STOP = "stop"
    AT_REST = "at rest"  # reported, after a stop or at the end of a jog
    AT_REST_UNHOMED = "at rest, not homed"  # reported, after a stop of homing
    COMPLETED = "completed"  # reported: every row was played
    FAULT = "fault"  # reported by the machine, the link or a guard
    OVERRIDE = "override"  # reported: speeds were changed; the state stays
    RESET = "reset"

    def refuse_after(self, ended: object | None) -> None:
        """Refuse to hold or resume a run that has ended and whose machine settles.

        Raises
        ------
        CommandError
            If this is a hold or a resume, and the run has ``ended``.
        """
        if ended is not None and self in {Cause.HOLD, Cause.RESUME}:
            raise CommandError(
                f"{self.value!r} is not possible: the run has come to its end",
                remedy="Wait until the machine has settled.",
            )


_S, _C = State, Cause

TRANSITIONS: dict[tuple[State, Cause], State] = {
    (_S.DISABLED, _C.ENABLE): _S.ENABLED,
    (_S.ENABLED, _C.HOME): _S.HOMING,
    (_S.HOMING, _C.HOMED): _S.IDLE,
    (_S.IDLE, _C.HOME): _S.HOMING,
    (_S.IDLE, _C.JOG): _S.JOGGING,
    (_S.IDLE, _C.START): _S.RUNNING,
    (_S.JOGGING, _C.AT_REST): _S.IDLE,
    (_S.RUNNING, _C.COMPLETED): _S.IDLE,
    (_S.RUNNING, _C.HOLD): _S.HOLDING,
    (_S.HOLDING, _C.RESUME): _S.RUNNING,
    # A stop is accepted in every state; at rest it changes nothing.
    (_S.DISABLED, _C.STOP): _S.DISABLED,
    (_S.ENABLED, _C.STOP): _S.ENABLED,
    (_S.IDLE, _C.STOP): _S.IDLE,
    (_S.HOMING, _C.STOP): _S.STOPPING,
    (_S.JOGGING, _C.STOP): _S.STOPPING,
    (_S.RUNNING, _C.STOP): _S.STOPPING,
    (_S.HOLDING, _C.STOP): _S.STOPPING,
    (_S.STOPPING, _C.STOP): _S.STOPPING,
    (_S.FAULT, _C.STOP): _S.FAULT,
    (_S.STOPPING, _C.AT_REST): _S.IDLE,
    (_S.STOPPING, _C.AT_REST_UNHOMED): _S.ENABLED,
    # A fault is accepted in every state.
    **{(state, _C.FAULT): _S.FAULT for state in _S},
    # Drives are switched off only at rest. After a reset the machine has to be homed.
    (_S.ENABLED, _C.DISABLE): _S.DISABLED,
    (_S.IDLE, _C.DISABLE): _S.DISABLED,
    (_S.FAULT, _C.RESET): _S.DISABLED,
}
"""State that follows a state and a cause."""

MOVING = frozenset({_S.HOMING, _S.JOGGING, _S.RUNNING, _S.HOLDING, _S.STOPPING})
"""States in which the machine may be moving."""

COMMANDS = frozenset(_C) - {
    _C.HOMED, _C.AT_REST, _C.AT_REST_UNHOMED, _C.COMPLETED, _C.FAULT, _C.OVERRIDE,
}  # fmt: skip
"""Causes that are commands of the operator; the others are reported."""


_NOT_HOMED = frozenset({_C.HOME, _C.DISABLE, _C.RESET, _C.AT_REST_UNHOMED})


def homed_after(cause: Cause, before: bool) -> bool:
    """Return whether the axis positions are known after a transition, or were before a fault."""
    return cause is Cause.HOMED or (before and cause not in _NOT_HOMED)


def next_state(state: State, cause: Cause) -> State:
    """Return the state after ``cause``.

    Raises
    ------
    CommandError
        If there is no such transition.
    """
    following_state = TRANSITIONS.get((state, cause))
    if following_state is None:
        possible = sorted(c.value for s, c in TRANSITIONS if s is state and c in COMMANDS)
        raise CommandError(
            f"{cause.value!r} is not possible while the machine is {state.value}",
            remedy=f"Possible now: {', '.join(possible)}.",
        )
    return following_state


class Desk:
    """Takes commands from keys, signal handlers and other threads, without a lock.

    It wakes an executor that waits on its ``fileno``.
    """

    def __init__(self) -> None:
        self._asked: deque[Cause] = deque()
        self._stop = False
        self._percent: int | None = None
        self._reads, self._writes = socket.socketpair()
        self._reads.setblocking(False)
        self._writes.setblocking(False)

    def ask(self, cause: Cause) -> None:
        """Queue a command; may be called in a signal handler and from any thread."""
        if cause is Cause.STOP:
            self._stop = True
        else:
            self._asked.append(cause)
        self.wake()

    def override(self, percent: int) -> None:
        """Ask for an override of the feed, in place of an earlier one that was not taken yet."""
        self._percent = percent
        self.wake()

    def take_override(self) -> int | None:
        """Return the override that was asked for, %; None if there is none."""
        percent, self._percent = self._percent, None
        return percent

    def wake(self) -> None:
        """Wake a waiting executor, for something that is not in the queue."""
        with suppress(OSError):  # full: it is woken already
            self._writes.send(b"!")

    def take(self) -> Cause | None:
        """Return the next command, a stop before any other; None if there is none.

        A stop drops all commands before it, so that a waiting resume cannot undo it.
        """
        if self._stop:
            self._stop, self._percent = False, None
            self._asked.clear()
            return Cause.STOP
        return self._asked.popleft() if self._asked else None

    def fileno(self) -> int:
        """Return the file descriptor that is readable while commands wait."""
        return self._reads.fileno()

    def woken(self) -> None:
        """Clear the wake-up signal."""
        with suppress(OSError):
            while self._reads.recv(4096):
                pass

    def close(self) -> None:
        """Close its sockets."""
        self._reads.close()
        self._writes.close()


class Sink(Protocol):
    """The receiver of the events and samples of a run."""

    def begin(self, channels: tuple[Channel, ...], simulated: bool) -> None:
        """Receive the channels of the blocks that follow."""

    def block(self, block: RecordingBlock) -> None:
        """Receive samples and events."""

    def state(self, tick: int, state: State, cause: Cause, text: str) -> None:
        """Receive a change of the executor's state."""
