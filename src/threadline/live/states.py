"""The states of an executor, and all transitions between them.

A cause without a transition is refused and changes nothing. ``docs/safety.md`` prints the table.
"""

from __future__ import annotations

from enum import StrEnum

from threadline.errors import CommandError


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


class Cause(StrEnum):
    """Cause of a transition: a command of the operator, or something that is reported."""

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
    RESET = "reset"


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

COMMANDS = frozenset(_C) - {_C.HOMED, _C.AT_REST, _C.AT_REST_UNHOMED, _C.COMPLETED, _C.FAULT}
"""Causes that are commands of the operator; the others are reported."""


_NOT_HOMED = frozenset({_C.HOME, _C.DISABLE, _C.RESET, _C.AT_REST_UNHOMED})


def homed_after(cause: Cause, before: bool) -> bool:
    """Return whether it is known where the axes are after a transition, or were before a fault."""
    return cause is Cause.HOMED or (before and cause not in _NOT_HOMED)


def next_state(state: State, cause: Cause) -> State:
    """Return the state after ``cause``.

    Raises
    ------
    CommandError
        If there is no such transition.
    """
    found = TRANSITIONS.get((state, cause))
    if found is None:
        possible = sorted(c.value for s, c in TRANSITIONS if s is state and c in COMMANDS)
        raise CommandError(
            f"{cause.value!r} is not possible while the machine is {state.value}",
            remedy=f"Possible now: {', '.join(possible)}.",
        )
    return found
