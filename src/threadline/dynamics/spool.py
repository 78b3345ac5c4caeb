"""Tension of a fibre between a braked spool with a spring arm and a mandrel, compiled.

With the elongation e of the fibre, the speed w of the spool and the way y of the arm's roller::

    e' = v - r w - 2 y'                  v: speed at which the eye gives out fibre
    T  = k e + c e' > 0                  0 while e < 0: the fibre is slack
    J w' = T r - torque(y)               at w > 0; at w = 0 the brake holds up to its stiction
    m y'' = 2 T - preload - ka y - ca y' between two stops, which take up all of its speed
    torque(y) = torque - release (y - travel / 2) >= 0

The fibre pulls at the spool and never pushes, so w is never below 0. At the eye the tension is
larger by the share that the guides add while the fibre runs out, and lower by it while it runs
back; it turns round over a millimetre of fibre, and a rest keeps it. Each change (the spool sticks
or breaks away, the arm reaches or leaves a stop, the fibre falls slack or becomes taut) is located
in time, so the method of Runge and Kutta keeps its fourth order.
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
"""Entries of a state: elongation of the fibre, m; speed of the spool, rad/s; way and speed of the
arm's roller; 1 while the brake holds the spool; -1 and 1 while the arm is at its lower and upper
stop; 1 while the fibre is taut; speed of the fibre at the eye, m/s; share of the guides' friction
that acts, from -1 to 1; tension at the eye, N."""
STATES = 10
R, J, TORQUE, STICTION, FRICTION, K, C, MASS, KA, CA, PRELOAD, TRAVEL, RELEASE = range(13)
"""Numbers of a spool, in SI: ``STICTION`` as a share of the torque."""
NUMBERS = 13
_PER_RATE = 0.2  # of a step, times the fastest rate: an error of 3e-6 of the fastest motion
_MOST_STEPS = 4000  # in a tick
_MOST_CHANGES = 64  # in a step
_TURNS_M = 1e-3  # way of the fibre in which the guides' friction turns round
_FINE = 1e-12  # of a step: a change is located to this


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
    found, arm = np.empty((values.count, NUMBERS)), spool.arm
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
        found[:, column] = values.at(f"spool.{path}", quantity)
    if spool.stiction is None:
        found[:, STICTION] = 1.0
    else:
        found[:, STICTION] = np.maximum(found[:, STICTION] / found[:, TORQUE], 1.0)
    return found


def steps_in(machine: Machine, numbers: FloatArray, tick_s: float) -> IntArray:
    """Return the (variants,) numbers of steps in a tick that (variants, 13) spools need.

    Raises
    ------
    MachineError
        If one of them is too large.
    """
    soft = 4.0 / numbers[:, MASS] + numbers[:, R] ** 2 / numbers[:, J]
    own = numbers[:, KA] / numbers[:, MASS]
    rate = np.sqrt(numbers[:, K] * soft + own)
    rate = np.maximum(rate, numbers[:, C] * soft + numbers[:, CA] / numbers[:, MASS])
    count = np.ceil(rate * tick_s / _PER_RATE)
    if count.max() > _MOST_STEPS:
        raise MachineError(
            f"spool: its fibre and arm respond at {rate.max():.4g} 1/s, too fast for ticks of "
            f"{tick_s:.4g} s",
            place=machine.place,
            remedy="Correct the stiffness of the fibre, or a mass that is too light.",
        )
    return np.maximum(count, 1.0).astype(np.int64)


def slack(runs: int) -> FloatArray:
    """Return (runs, 10) states: the arm at its lower stop, the spool held, the fibre just slack."""
    found = np.zeros((runs, STATES))
    found[:, STUCK], found[:, STOP] = 1.0, -1.0
    return found


def drawn(numbers: FloatArray) -> FloatArray:
    """Return (runs, 10) states: the spool held, as it stops after a slow and even motion.

    Arm and brake balance as ``Spool.tension_n`` says.

    Parameters
    ----------
    numbers
        (runs, 13).
    """
    n = numbers.T
    most = n[TORQUE] + n[RELEASE] * 0.5 * n[TRAVEL]
    way = (2.0 * most / n[R] - n[PRELOAD]) / (n[KA] + 2.0 * n[RELEASE] / n[R])
    found = np.zeros((len(numbers), STATES))
    found[:, Y] = np.clip(way, 0.0, n[TRAVEL])
    found[:, STOP] = np.where(way <= 0.0, -1.0, np.where(way >= n[TRAVEL], 1.0, 0.0))
    pull = np.maximum(most - n[RELEASE] * found[:, Y], 0.0) / n[R]
    found[:, E], found[:, STUCK], found[:, TAUT] = pull / n[K], 1.0, pull > 0.0
    found[:, DRAGS], found[:, TENSION] = 1.0, pull * (1.0 + n[FRICTION])
    return found


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
def _given(at_s: float, given: tuple[float, float, float, float]) -> float:
    """Return the speed of the fibre at the eye; ``given`` is as in ``_stepped``."""
    v0, v1, mean, tick_s = given
    share = at_s / tick_s
    bump = 6.0 * (mean - 0.5 * (v0 + v1))
    return v0 + (v1 - v0) * share + bump * share * (1.0 - share)


@njit(nogil=True)
def _slope(
    x: tuple[float, float, float, float], mode: tuple[bool, int, bool], v: float, n: FloatArray
) -> tuple[float, float, float, float]:
    """Return the rates of elongation, spool, way and speed of the arm."""
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
    x: tuple[float, float, float, float], by: tuple[float, float, float, float], h: float
) -> tuple[float, float, float, float]:
    return x[0] + h * by[0], x[1] + h * by[1], x[2] + h * by[2], x[3] + h * by[3]


@njit(nogil=True)
def _stepped(
    x: tuple[float, float, float, float],
    mode: tuple[bool, int, bool],
    given: tuple[float, float, float, float],
    at_s: float,
    h: float,
    n: FloatArray,
) -> tuple[float, float, float, float]:
    """Return the state a time h later.

    Parameters
    ----------
    x, mode
        Elongation, speed of the spool, way and speed of the arm; whether the spool is held, the
        stop of the arm, whether the fibre is taut.
    given
        Speed of the fibre at the ends of the tick, its mean, and the length of the tick.
    at_s, h
        Time since the beginning of the tick, and step.
    """
    middle = _given(at_s + 0.5 * h, given)
    a = _slope(x, mode, _given(at_s, given), n)
    b = _slope(_moved(x, a, 0.5 * h), mode, middle, n)
    c = _slope(_moved(x, b, 0.5 * h), mode, middle, n)
    d = _slope(_moved(x, c, h), mode, _given(at_s + h, given), n)
    part = h / 6.0
    return _moved(_moved(_moved(_moved(x, a, part), b, 2.0 * part), c, 2.0 * part), d, part)


@njit(nogil=True)
def _beyond(
    x: tuple[float, float, float, float], mode: tuple[bool, int, bool], v: float, n: FloatArray
) -> int:
    """Return the end of its mode that a state is beyond; 0 for none.

    The ends are: 1 the spool's, 2 the arm's lower and 3 its upper one, 4 the fibre's.
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
    """Return state and mode behind an end."""
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
    given: tuple[float, float, float, float],
    begin_s: float,
    h: float,
    n: FloatArray,
) -> tuple[tuple[float, float, float, float], tuple[bool, int, bool]]:
    """Return state and mode a time h later, with the changes of the mode on the way."""
    at, left = begin_s, h
    for _ in range(_MOST_CHANGES):
        after = _stepped(x, mode, given, at, left, n)
        end = _beyond(after, mode, _given(at + left, given), n)
        if end == 0:
            return after, mode
        low, high = 0.0, left
        while high - low > _FINE * h:
            middle = 0.5 * (low + high)
            there = _stepped(x, mode, given, at, middle, n)
            found = _beyond(there, mode, _given(at + middle, given), n)
            if found == 0:
                low = middle
            else:
                high, after, end = middle, there, found
        x, mode = _changed(after, mode, end, n)
        at += high
        left -= high
        if left <= _FINE * h:
            return x, mode
    return _stepped(x, mode, given, at, left, n), mode


@njit(nogil=True)
def unwind(
    z: FloatArray, n: FloatArray, used_m: float, speed_m_s: float, tick_s: float, steps: int
) -> None:
    """Advance the state of a spool by a tick in which the eye gives out a length of fibre.

    Parameters
    ----------
    z
        (10,) state, which is updated.
    n
        (13,) numbers of the spool.
    used_m
        Length of fibre that the eye gives out in the tick, m; negative: it gives it back.
    speed_m_s
        Speed of the fibre at the end of the tick, m/s. The state has its speed at the beginning;
        between them the length is the cubic with these speeds and this length.
    tick_s, steps
        Length of the tick, s, and the number of equal steps in it.
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
    z[DRAGS] = min(max(z[DRAGS] + used_m / _TURNS_M, -1.0), 1.0)
    pull = _pull(x[0], x[1], x[3], mode[2], speed_m_s, n)
    z[TENSION] = pull * math.pow(1.0 + n[FRICTION], z[DRAGS])
