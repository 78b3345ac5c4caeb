"""Kernel code: positions that a controller makes itself, filter tick by filter tick.

Speeds and positions are whole 256ths of a count, as in the motion chip's registers, so that every
sum below is exact.
"""

from __future__ import annotations

from threadline.machine.controllers import VELOCITY_HIGH, VELOCITY_LOW
from threadline.twin.kernel.code import Value
from threadline.twin.kernel.lanes import Lanes
from threadline.twin.kernel.names import Field

_STEPS = 256.0


def write_goals(rows: Lanes, references: list[Value]) -> None:
    """Take up the references of a tick: the speed from one to the next, or where to go."""
    for c, controller in enumerate(rows.shape.controllers):
        if controller.profile == "speed":
            goal = (references[c] - rows[Field.SEEN, c]) * rows[Field.PER_TICK, c]
            if rows.shape.quantised:
                code = rows.code
                low, high = code.number(VELOCITY_LOW), code.number(VELOCITY_HIGH)
                goal = code.larger(low, code.smaller(high, code.call("rint", goal)))
            rows[Field.GOAL, c], rows[Field.SEEN, c] = goal, references[c]


def profiled(rows: Lanes, c: int, reference: Value) -> Value:
    """Move the profile of a controller on by a tick of its filter; return its position."""
    code = rows.code
    target = rows.shape.controllers[c].profile == "target"
    moved = _towards_target(rows, c, reference) if target else _towards_speed(rows, c)
    at = rows[Field.POSITION, c] + moved
    rows[Field.POSITION, c] = at
    return code.call("floor", at) if rows.shape.quantised else at


def _towards_speed(rows: Lanes, c: int) -> Value:
    code, most = rows.code, rows[Field.ACCELERATION, c]
    change = rows[Field.GOAL, c] - rows[Field.SPEED, c]
    change = code.larger(most * -1.0, code.smaller(most, change))
    rows[Field.SPEED, c] = rows[Field.SPEED, c] + change
    return rows[Field.SPEED, c]


def _towards_target(rows: Lanes, c: int, reference: Value) -> Value:
    """Return the step that keeps to the limits and can still be stopped before the target.

    A speed v that falls by a in each of the n ticks after this one goes ``(n + 1)(v - n a / 2)``:
    n is the most for which n a still stops in time, v is rounded down to what the registers hold.
    """
    code, a = rows.code, rows[Field.ACCELERATION, c]
    arrived = rows[Field.GOAL, c].equals(rows[Field.POSITION, c])
    whole = code.call("floor", reference * _STEPS) * (1.0 / _STEPS)
    goal = code.choose(arrived, whole, rows[Field.GOAL, c])
    speed = code.choose(arrived, code.number(0.0), rows[Field.SPEED, c])
    left = goal - rows[Field.POSITION, c]
    size = code.call("fabs", left)
    falls = code.call("floor", (code.call("sqrt", size * 8.0 / a + 1.0) - 1.0) * 0.5)
    stoppable = size / (falls + 1.0) + falls * a * 0.5
    stoppable = code.call("floor", stoppable * _STEPS) * (1.0 / _STEPS)
    speed = code.smaller(code.smaller(speed + a, rows[Field.FASTEST, c]), stoppable)
    rows[Field.GOAL, c], rows[Field.SPEED, c] = goal, speed
    return code.call("copysign", speed, left)
