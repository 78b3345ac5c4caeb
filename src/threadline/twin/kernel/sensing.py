"""Kernel code: sensors with noise, state-space controllers, and profiles of controllers.

The noise of a reading is the sum of twelve even numbers between 0 and 1, less 6: its variance is 1,
and it is within six standard deviations. The numbers come from the generator of Park and Miller
("Random number generators: good ones are hard to find", Communications of the ACM 31, 1988):
``16807 x mod 2^31 - 1``, in floating point without any rounding, so every processor gives the same.
"""

from __future__ import annotations

from threadline.machine.controllers import VELOCITY_HIGH, VELOCITY_LOW
from threadline.twin.kernel.code import Value
from threadline.twin.kernel.lanes import Lanes
from threadline.twin.kernel.names import Field

NOISE_PRIME = (1 << 31) - 1
_FACTOR = 16807.0
_TERMS = 12
_STEPS = 256.0
"""Speeds and positions of profiles are whole 256ths of a count, as in the registers of the motion
chip, so that sums are exact."""


def reading(rows: Lanes, s: int) -> Value:
    """Return the present reading of observing sensor ``s``, in its unit."""
    code, shape = rows.code, rows.shape
    sensor = shape.observing[s]
    value = rows.product(Field.SEES, s, sensor.sees)
    for i in sensor.feels:
        rate = _rate(rows, i)
        value = code.fma(rows[Field.FEELS, s, i], rate, value)
    if shape.quantised:
        if sensor.noisy:
            value = code.fma(rows[Field.NOISE, s], _drawn(rows, s)[0], value)
        if sensor.rounding:
            grain = rows[Field.GRAIN, s]
            value = code.call(sensor.rounding, value / grain + sensor.offset) * grain
    if sensor.limited:
        span = rows[Field.SPAN, s]
        value = code.larger(span * -1.0, code.smaller(span, value))
    return value


def _rate(rows: Lanes, i: int) -> Value:
    """Return the derivative of state ``i``."""
    return rows.product_of((Field.MATRIX, i), rows.shape.matrix[i], rows.columns())


def _drawn(rows: Lanes, s: int) -> tuple[Value, Value]:
    """Return a number of variance 1, and the seed after it."""
    code, seed = rows.code, rows[Field.SEED, s]
    total = code.number(-0.5 * _TERMS)
    for _ in range(_TERMS):
        # Products stay below 2^53 and are exact. The quotient may be rounded up to a whole number.
        product = seed * _FACTOR
        whole = code.call("floor", product * (1.0 / NOISE_PRIME))
        seed = code.fma(whole, -float(NOISE_PRIME), product)
        seed = code.choose(seed < 0.0, seed + float(NOISE_PRIME), seed)
        total = code.fma(seed, 1.0 / NOISE_PRIME, total)
    return total, seed


def write_noise(rows: Lanes) -> None:
    """Draw the noise of every sensor anew, after the readings of an instant."""
    if rows.shape.quantised:
        for s, sensor in enumerate(rows.shape.observing):
            if sensor.noisy:
                rows[Field.SEED, s] = _drawn(rows, s)[1]


def write_bank(
    rows: Lanes, first: int, references: list[Value], readings: list[Value]
) -> list[Value]:
    """Advance a state-space controller by a tick; return its outputs in levels, before the DAC.

    Parameters
    ----------
    first
        Index of its first loop.
    references, readings
        Of its loops, counts.
    """
    code, bank = rows.code, rows.shape.controllers[first].bank
    assert bank is not None
    columns = [rows[Field.HOLDING, first, i] for i in range(len(bank.following))]
    columns += references + readings + [reading(rows, s) for s in bank.sensors]
    outputs, taken = [], []
    for k, pattern in enumerate(bank.output):
        u = rows.product_of((Field.OUT, first, k), pattern, columns)
        low, high = rows[Field.LEVEL_LOW, first + k], rows[Field.LEVEL_HIGH, first + k]
        taken.append(code.larger(low, code.smaller(high, u)) - u)
        outputs.append(u)
    after = [
        rows.product_of((Field.NEXT, first, i), pattern, columns)
        for i, pattern in enumerate(bank.following)
    ]
    for i, pattern in enumerate(bank.back):
        for k in pattern:
            after[i] = code.fma(rows[Field.BACK, first, i, k], taken[k], after[i])
    for i, value in enumerate(after):
        rows[Field.HOLDING, first, i] = value
    return outputs


def write_goals(rows: Lanes, references: list[Value]) -> None:
    """Read the references of a tick: the speed from one to the next, or the target."""
    for c, controller in enumerate(rows.shape.controllers):
        if controller.profile == "speed":
            goal = (references[c] - rows[Field.SEEN, c]) * rows[Field.PER_TICK, c]
            if rows.shape.quantised:
                code = rows.code
                low, high = code.number(VELOCITY_LOW), code.number(VELOCITY_HIGH)
                goal = code.larger(low, code.smaller(high, code.call("rint", goal)))
            rows[Field.GOAL, c], rows[Field.SEEN, c] = goal, references[c]


def profiled(rows: Lanes, c: int, reference: Value) -> Value:
    """Advance the profile of a controller by a tick of its filter; return its position."""
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
    """Return the largest step within the limits that can still stop at the target.

    A speed v that falls by a in each of the following n ticks travels ``(n + 1)(v - n a / 2)``: n
    is the largest number for which n a still stops in time, and v is rounded down to register
    resolution.
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
