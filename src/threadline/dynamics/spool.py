"""Tension of a fibre between a braked spool with a spring arm and a mandrel, in compiled code.

With the elongation e of the fibre, the speed w of the spool and the position y of the arm's
roller::

    e' = v - r w - 2 y'                  v: speed at which the fibre leaves the eye
    T  = k e + c e' > 0                  0 while e < 0: the fibre is slack
    J w' = T r - torque(y)               at w > 0; at w = 0 the brake holds up to its stiction
    m y'' = 2 T - preload - ka y - ca y' between two stops, at which y' becomes 0
    torque(y) = torque - release (y - travel / 2) >= 0

The fibre can pull at the spool but not push it, so w is never below 0. Friction in the guides
multiplies the tension at the eye by a factor while the fibre runs out, and divides it by the same
factor while the fibre runs back. The friction reverses gradually over a millimetre of fibre, and
keeps its value at rest. Each change of the mode (the spool sticks or breaks away, the arm reaches
or leaves a stop, the fibre falls slack or becomes taut) is located in time, so that the Runge-Kutta
method keeps its fourth order.
"""

from __future__ import annotations

import math

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.dynamics.values import Values
from threadline.errors import MachineError
from threadline.machine import Machine

E, W, Y, DY, STUCK, STOP, TAUT, SPEED, DRAGS, TENSION = range(10)
"""Indices in a state: elongation of the fibre, m; speed of the spool, rad/s; position, m, and
speed, m/s, of the arm's roller; 1 while the brake holds the spool; -1 or 1 while the arm is at its
lower or upper stop; 1 while the fibre is taut; speed of the fibre at the eye, m/s; acting share of
the friction in the guides, from -1 to 1; tension at the eye, N."""
STATES = 10
R, J, TORQUE, STICTION, FRICTION, K, C, MASS, KA, CA, PRELOAD, TRAVEL, RELEASE = range(13)
"""Indices in the numbers of a spool, SI; ``STICTION`` is a multiple of the torque."""
NUMBERS = 13
_MAX_STEP_RATE = (
    0.2  # largest step times fastest rate: gives an error of 3e-6 of the fastest motion
)
_MOST_STEPS = 4000  # largest number of steps in a tick
_MOST_CHANGES = 64  # largest number of mode changes in a step
_REVERSAL_M = 1e-3  # length of fibre over which the friction in the guides reverses
_LOCATED_SHARE = 1e-12  # a change is located within this share of a step


def spool_numbers(machine: Machine, values: Values) -> FloatArray:
    """Return the (variants, 13) numbers of the spools of all variants.

    Raises
    ------
    ValueError
        If the machine has no spool.
    """
    spool = machine.spool
    if spool is None:
        raise ValueError(f"{machine.name} has no spool")
    numbers, arm = np.empty((values.count, NUMBERS)), spool.arm
    for column, path, quantity in (
        (R, "radius", spool.radius),
        (J, "inertia", spool.inertia),
        (TORQUE, "torque", spool.torque),
        (STICTION, "stiction", spool.stiction),
        (FRICTION, "friction", spool.friction),
        (K, "stiffness", spool.stiffness),
        (C, "damping", spool.damping),
        (MASS, "arm.mass", arm.mass),
        (KA, "arm.stiffness", arm.stiffness),
        (CA, "arm.damping", arm.damping),
        (PRELOAD, "arm.preload", arm.preload),
        (TRAVEL, "arm.travel", arm.travel),
        (RELEASE, "arm.release", arm.release),
    ):
        numbers[:, column] = values.at(f"spool.{path}", quantity)
    if spool.stiction is None:
        numbers[:, STICTION] = 1.0
    else:
        numbers[:, STICTION] = np.maximum(numbers[:, STICTION] / numbers[:, TORQUE], 1.0)
    return numbers


def steps_in(machine: Machine, numbers: FloatArray, tick_s: float) -> IntArray:
    """Return the (variants,) numbers of steps per tick, for (variants, 13) numbers of spools.

    Raises
    ------
    MachineError
        If a spool needs more than 4000 steps.
    """
    compliance = 4.0 / numbers[:, MASS] + numbers[:, R] ** 2 / numbers[:, J]
    arm_rate2 = numbers[:, KA] / numbers[:, MASS]
    rate = np.sqrt(numbers[:, K] * compliance + arm_rate2)
    rate = np.maximum(rate, numbers[:, C] * compliance + numbers[:, CA] / numbers[:, MASS])
    count = np.ceil(rate * tick_s / _MAX_STEP_RATE)
    if count.max() > _MOST_STEPS:
        raise MachineError(
            f"spool: its fibre and arm respond at {rate.max():.4g} 1/s, too fast for ticks of "
            f"{tick_s:.4g} s",
            place=machine.place,
            remedy="Correct the stiffness of the fibre, or a mass that is too light.",
        )
    return np.maximum(count, 1.0).astype(np.int64)


def slack(runs: int) -> FloatArray:
    """Return (runs, 10) states: arm at its lower stop, spool held, fibre slack without a gap."""
    states = np.zeros((runs, STATES))
    states[:, STUCK], states[:, STOP] = 1.0, -1.0
    return states


def drawn(numbers: FloatArray) -> FloatArray:
    """Return (runs, 10) states: spool held and fibre tight, as after a slow and even motion.

    Arm and brake are in balance, as in ``Spool.tension_n``.

    Parameters
    ----------
    numbers
        (runs, 13) numbers of the spools.
    """
    n = numbers.T
    torque_at_rest = n[TORQUE] + n[RELEASE] * 0.5 * n[TRAVEL]
    arm_m = (2.0 * torque_at_rest / n[R] - n[PRELOAD]) / (n[KA] + 2.0 * n[RELEASE] / n[R])
    states = np.zeros((len(numbers), STATES))
    states[:, Y] = np.clip(arm_m, 0.0, n[TRAVEL])
    states[:, STOP] = np.where(arm_m <= 0.0, -1.0, np.where(arm_m >= n[TRAVEL], 1.0, 0.0))
    pull_n = np.maximum(torque_at_rest - n[RELEASE] * states[:, Y], 0.0) / n[R]
    states[:, E], states[:, STUCK], states[:, TAUT] = pull_n / n[K], 1.0, pull_n > 0.0
    states[:, DRAGS], states[:, TENSION] = 1.0, pull_n * (1.0 + n[FRICTION])
    return states


@njit(nogil=True)
def _brake(y: float, n: FloatArray) -> float:
    torque: float = n[TORQUE] - n[RELEASE] * (y - 0.5 * n[TRAVEL])
    return max(torque, 0.0)


@njit(nogil=True)
def _pull(e: float, w: float, dy: float, taut: bool, v: float, n: FloatArray) -> float:
    """Return the tension between spool and eye, N."""
    if not taut:
        return 0.0
    tension: float = n[K] * e + n[C] * (v - n[R] * w - 2.0 * dy)
    return max(tension, 0.0)


@njit(nogil=True)
def _eye_speed(at_s: float, eye_speed: tuple[float, float, float, float]) -> float:
    """Return the speed of the fibre at the eye; ``eye_speed`` is as in ``_stepped``."""
    v0, v1, mean, tick_s = eye_speed
    share = at_s / tick_s
    curvature = 6.0 * (mean - 0.5 * (v0 + v1))
    return v0 + (v1 - v0) * share + curvature * share * (1.0 - share)


@njit(nogil=True)
def _slope(
    x: tuple[float, float, float, float], mode: tuple[bool, int, bool], v: float, n: FloatArray
) -> tuple[float, float, float, float]:
    """Return the rates of elongation, spool speed, and position and speed of the arm."""
    e, w, y, dy = x
    stuck, stop, taut = mode
    pull = _pull(e, w, dy, taut, v, n)
    turning = 0.0 if stuck else (pull * n[R] - _brake(y, n)) / n[J]
    force = 0.0
    if stop == 0:
        force = (2.0 * pull - n[PRELOAD] - n[KA] * y - n[CA] * dy) / n[MASS]
    return v - n[R] * w - 2.0 * dy, turning, dy, force


@njit(nogil=True)
def _moved(
    x: tuple[float, float, float, float], rates: tuple[float, float, float, float], h: float
) -> tuple[float, float, float, float]:
    return x[0] + h * rates[0], x[1] + h * rates[1], x[2] + h * rates[2], x[3] + h * rates[3]


@njit(nogil=True)
def _stepped(
    x: tuple[float, float, float, float],
    mode: tuple[bool, int, bool],
    eye_speed: tuple[float, float, float, float],
    at_s: float,
    h: float,
    n: FloatArray,
) -> tuple[float, float, float, float]:
    """Return the state a time h later.

    Parameters
    ----------
    x, mode
        Elongation, speed of the spool, position and speed of the arm; and whether the spool is
        held, the stop of the arm (-1, 0, 1), whether the fibre is taut.
    eye_speed
        Speed of the fibre at the beginning and end of the tick, mean speed, and length of the tick.
    at_s, h
        Time since the beginning of the tick, and length of the step.
    """
    middle_speed = _eye_speed(at_s + 0.5 * h, eye_speed)
    a = _slope(x, mode, _eye_speed(at_s, eye_speed), n)
    b = _slope(_moved(x, a, 0.5 * h), mode, middle_speed, n)
    c = _slope(_moved(x, b, 0.5 * h), mode, middle_speed, n)
    d = _slope(_moved(x, c, h), mode, _eye_speed(at_s + h, eye_speed), n)
    sixth = h / 6.0
    return _moved(_moved(_moved(_moved(x, a, sixth), b, 2.0 * sixth), c, 2.0 * sixth), d, sixth)


@njit(nogil=True)
def _crossed_boundary(
    x: tuple[float, float, float, float], mode: tuple[bool, int, bool], v: float, n: FloatArray
) -> int:
    """Return which boundary of its mode a state has crossed; 0 for none.

    Boundary 1 belongs to the spool (held or turning), 2 and 3 to the arm's lower and upper stop,
    and 4 to the fibre (slack or taut).
    """
    e, w, y, dy = x
    stuck, stop, taut = mode
    pull = _pull(e, w, dy, taut, v, n)
    if stuck:
        if pull * n[R] > n[STICTION] * _brake(y, n):
            return 1
    elif w < 0.0:
        return 1
    if stop == 0:
        if y < 0.0:
            return 2
        if y > n[TRAVEL]:
            return 3
    elif stop < 0:
        if 2.0 * pull > n[PRELOAD]:
            return 2
    elif 2.0 * pull < n[PRELOAD] + n[KA] * n[TRAVEL]:
        return 3
    if (e < 0.0) if taut else (e > 0.0):
        return 4
    return 0


@njit(nogil=True)
def _changed(
    x: tuple[float, float, float, float], mode: tuple[bool, int, bool], end: int, n: FloatArray
) -> tuple[tuple[float, float, float, float], tuple[bool, int, bool]]:
    """Return state and mode after the boundary ``end`` was crossed."""
    e, w, y, dy = x
    stuck, stop, taut = mode
    if end == 1:
        return (e, 0.0, y, dy), (not stuck, stop, taut)
    if end == 4:
        return (0.0, w, y, dy), (stuck, stop, not taut)
    if stop != 0:
        return (e, w, y, 0.0), (stuck, 0, taut)
    if end == 2:
        return (e, w, 0.0, 0.0), (stuck, -1, taut)
    return (e, w, n[TRAVEL], 0.0), (stuck, 1, taut)


@njit(nogil=True)
def _one_step(
    x: tuple[float, float, float, float],
    mode: tuple[bool, int, bool],
    eye_speed: tuple[float, float, float, float],
    begin_s: float,
    h: float,
    n: FloatArray,
) -> tuple[tuple[float, float, float, float], tuple[bool, int, bool]]:
    """Return state and mode a time h later, including all changes of the mode in this time."""
    at_s, left_s = begin_s, h
    for _ in range(_MOST_CHANGES):
        next_state = _stepped(x, mode, eye_speed, at_s, left_s, n)
        end = _crossed_boundary(next_state, mode, _eye_speed(at_s + left_s, eye_speed), n)
        if end == 0:
            return next_state, mode
        low_s, high_s = 0.0, left_s
        while high_s - low_s > _LOCATED_SHARE * h:
            middle_s = 0.5 * (low_s + high_s)
            middle_state = _stepped(x, mode, eye_speed, at_s, middle_s, n)
            middle_end = _crossed_boundary(
                middle_state, mode, _eye_speed(at_s + middle_s, eye_speed), n
            )
            if middle_end == 0:
                low_s = middle_s
            else:
                high_s, next_state, end = middle_s, middle_state, middle_end
        x, mode = _changed(next_state, mode, end, n)
        at_s += high_s
        left_s -= high_s
        if left_s <= _LOCATED_SHARE * h:
            return x, mode
    return _stepped(x, mode, eye_speed, at_s, left_s, n), mode


@njit(nogil=True)
def unwind(
    z: FloatArray, n: FloatArray, used_m: float, speed_m_s: float, tick_s: float, steps: int
) -> None:
    """Advance the state of a spool by a tick in which a length of fibre leaves the eye.

    Parameters
    ----------
    z
        (10,) state, which this function updates.
    n
        (13,) numbers of the spool.
    used_m
        Length of fibre that leaves the eye in the tick, m; negative if fibre runs back.
    speed_m_s
        Speed of the fibre at the end of the tick, m/s. The state has the speed at the beginning.
        Within the tick the length is the cubic with these speeds and this total length.
    tick_s, steps
        Length of the tick, s, and number of equal steps in it.
    """
    given = (z[SPEED], speed_m_s, used_m / tick_s, tick_s)
    x = (z[E], z[W], z[Y], z[DY])
    mode = (z[STUCK] != 0.0, int(z[STOP]), z[TAUT] != 0.0)
    h = tick_s / steps
    for step in range(steps):
        x, mode = _one_step(x, mode, given, step * h, h, n)
    z[E], z[W], z[Y], z[DY] = x
    z[STUCK], z[STOP], z[TAUT] = mode[0], mode[1], mode[2]
    z[SPEED] = speed_m_s
    z[DRAGS] = min(max(z[DRAGS] + used_m / _REVERSAL_M, -1.0), 1.0)
    pull = _pull(x[0], x[1], x[3], mode[2], speed_m_s, n)
    z[TENSION] = pull * math.pow(1.0 + n[FRICTION], z[DRAGS])
