"""The cylinders of an on/off machine: their equations in each state of motion, and their steps.

A piston slides, sticks, or stands at an end stop. In each state the equations are linear with
constant input, so a step is one product with a matrix exponential.

The instant at which a piston stops is found by halving the step. A standing piston breaks away only
at the beginning of a step. A step that is cut by an arriving command is composed of halved steps,
down to 2^-12 of a step, and a Taylor series for the remainder.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.dynamics.pneumatic import cylinder_equations
from threadline.dynamics.values import Values
from threadline.errors import MachineError
from threadline.machine import Machine
from threadline.machine.quantity import Quantity
from threadline.twin.prescribed import exponential_of_short_step

SLIDES, STICKS, AT_START, AT_END = 0, 1, 2, 3
RAMP_STEPS = 8
HALVINGS = 12
STROKE, RATE, FRAME, STOP, STICK, ROWS = 0, 1, 2, 3, 4, 5
LENGTH, RAMP, CUSHION, FRICTION, BREAK, SHARE, SPEED, ADHESION, NUMBERS = 0, 1, 2, 3, 4, 5, 6, 7, 8


class Bank(NamedTuple):
    """The cylinders of one variant for the compiled code: C cylinders with at most N states.

    The last two states of each are the flow level and a constant 1.

    Parameters
    ----------
    step
        (C, K, HALVINGS + 1, N, N) transition matrices of a step that is halved 0 to HALVINGS times,
        for each of the K states of motion; see ``key_of``.
    rate
        (C, K, N, N) generators of the transition matrices, 1/s.
    rows
        (C, ROWS, N) stroke, its rate, the frame, and the forces that hold a standing piston, from
        the state.
    numbers
        (C, NUMBERS) lengths, forces and speeds of each; ``LENGTH`` and the following constants are
        the columns.
    masses
        (C, 4) indices of the velocities of piston and housing, of the flow and of the air.
    """

    step: FloatArray
    rate: FloatArray
    rows: FloatArray
    numbers: FloatArray
    masses: IntArray


class Motion(NamedTuple):
    """State of the cylinders during a simulation.

    Parameters
    ----------
    state
        (C, N) state of the linear equations.
    mode
        (C,) SLIDES, STICKS, AT_START or AT_END.
    sense, start
        (C,) direction of motion, 1 or -1, against which friction acts; and the stroke at which the
        piston last stood, m.
    ahead
        (C, N) buffer for the state at the end of a step.
    """

    state: FloatArray
    mode: IntArray
    sense: FloatArray
    start: FloatArray
    ahead: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cylinders:
    """The cylinders of a machine in every variant.

    The arrays are as in ``Bank``, but all except ``masses`` have the variants as first dimension.
    """

    step: FloatArray
    rate: FloatArray
    rows: FloatArray
    numbers: FloatArray
    masses: IntArray

    def bank(self, variant: int = 0) -> Bank:
        """Return the cylinders of one variant."""
        return Bank(
            self.step[variant], self.rate[variant], self.rows[variant], self.numbers[variant],
            self.masses,
        )  # fmt: skip

    def at_rest(self, variant: int = 0) -> Motion:
        """Return the state at the start: pistons at 0, valves shut."""
        count, size = self.rows.shape[1], self.rows.shape[3]
        state = np.zeros((count, size))
        state[:, -1] = 1.0
        mode = np.where(self.numbers[variant, :, FRICTION] > 0.0, STICKS, SLIDES)
        zero = np.zeros(count)
        return Motion(state, mode.astype(np.int64), zero, zero.copy(), np.zeros_like(state))


def cylinders_of(
    machine: Machine, names: Sequence[str], values: Values, step_s: float
) -> Cylinders:
    """Return the tables of the cylinders ``names`` of ``machine`` for every variant.

    Raises
    ------
    MachineError
        If a cylinder has no equations, or its motion overflows within a sample.
    """
    made = [_tables(machine, name, values) for name in names]
    size = max(rate.shape[-1] for rate, *_ in made)
    keys = max(rate.shape[1] for rate, *_ in made)
    count = values.count
    step = np.zeros((count, len(made), keys, HALVINGS + 1, size, size))
    rates = np.zeros((count, len(made), keys, size, size))
    all_rows = np.zeros((count, len(made), ROWS, size))
    numbers = np.zeros((count, len(made), NUMBERS))
    masses = np.zeros((len(made), 4), dtype=np.int64)
    for c, (rate, rows, own, pair) in enumerate(made):
        # The states come first; the level and the constant 1 come last.
        n = rate.shape[-1] - 2
        place = np.concatenate((np.arange(n), [size - 2, size - 1]))
        k = rate.shape[1]
        # The series gives the shortest step; each longer one is the square of the previous.
        part = exponential_of_short_step(rate * (step_s * 0.5**HALVINGS))
        for halvings in range(HALVINGS, -1, -1):
            if not np.isfinite(part).all():
                raise MachineError(
                    f"cylinders.{names[c]}: its motion grows beyond all numbers within "
                    f"{step_s * 0.5**halvings:.3g} s",
                    place=machine.place,
                    remedy="Correct its masses, its stiffness and the strain of its air.",
                )
            block = step[:, c, :k, halvings]
            block[:, :, place[:, None], place] = part
            if halvings:
                with np.errstate(over="ignore", invalid="ignore"):
                    part = part @ part
        block = rates[:, c, :k]
        block[:, :, place[:, None], place] = rate
        all_rows[:, c][:, :, place] = rows
        numbers[:, c], masses[c] = own, pair
    return Cylinders(step=step, rate=rates, rows=all_rows, numbers=numbers, masses=masses)


def _tables(
    machine: Machine, name: str, values: Values
) -> tuple[FloatArray, FloatArray, FloatArray, tuple[int, int, int, int]]:
    """Return generators (V, K, n + 2, n + 2), rows (V, ROWS, n + 2), numbers (V, NUMBERS)."""
    cylinder, plant = machine.cylinders[name], cylinder_equations(machine, name, values)
    count, n, where = values.count, len(plant.states), f"cylinders.{name}"

    def number(key: str, quantity: Quantity | None) -> FloatArray:
        value = np.asarray(values.at(f"{where}.{key}", quantity), dtype=np.float64)
        return np.broadcast_to(value, (count,))

    friction = number("friction", cylinder.friction)
    stiction = friction if cylinder.stiction is None else number("stiction", cylinder.stiction)
    cushion = cylinder.cushion
    flows = [np.ones(count)]
    if cushion is not None:
        flows.append(number("cushion.flow", cushion.flow))
    ramps = RAMP_STEPS if cylinder.air_ramp is not None else 1
    senses = (-1.0, 1.0) if cylinder.friction is not None else (0.0,)
    rates = [_full(plant.standing(), plant.level, np.zeros((count, n)))]
    for sense in senses:
        for flow in flows:
            for ramp in range(1, ramps + 1):
                push = -sense * friction[:, None] * plant.force
                rates.append(_full(plant.sliding(ramp / ramps), flow[:, None] * plant.level, push))
    rows = np.zeros((count, ROWS, n + 2))
    rows[:, STROKE, :n], rows[:, RATE, :n] = plant.stroke, plant.stroke_rate
    rows[:, FRAME, :n] = plant.frame
    # At an end stop only the force of the air counts: the vibration of the beam, at 1.6 kHz, would
    # lift the piston by less than a micrometre, a thousand times a second.
    rows[:, STOP, :n] = -plant.air_force()
    rows[:, STICK, :n] = plant.holding() - plant.air_force(1.0 / RAMP_STEPS)
    numbers = np.zeros((count, NUMBERS))
    numbers[:, LENGTH] = number("stroke", cylinder.stroke)
    numbers[:, RAMP] = number("air_ramp", cylinder.air_ramp)
    numbers[:, CUSHION] = -1.0 if cushion is None else number("cushion.length", cushion.length)
    numbers[:, FRICTION] = friction
    numbers[:, BREAK] = stiction
    numbers[:, SHARE] = plant.piston_share
    numbers[:, SPEED] = number("speed", cylinder.speed)
    full = plant.air_stiffness * _EMPTY * numbers[:, LENGTH]
    numbers[:, ADHESION] = _ADHESION_N if cylinder.kind == "linear" else _ADHESION_SHARE * full
    return np.stack(rates, axis=1), rows, numbers, (plant.piston, plant.housing, n - 2, n - 1)


def _full(matrix: FloatArray, level: FloatArray, push: FloatArray) -> FloatArray:
    """Return (V, n + 2, n + 2) rates with the level and a constant as two additional states."""
    count, n = level.shape
    full = np.zeros((count, n + 2, n + 2))
    full[:, :n, :n], full[:, :n, -2], full[:, :n, -1] = matrix, level, push
    return full


PARTS = 1 << HALVINGS
_STANDSTILL_M_S = 1e-3
_ADHESION_N, _ADHESION_SHARE = 1.0, 1e-3
"""A piston leaves its stop only under a larger force; under a smaller one it would leave the stop
and return to it at every step. In N; of a rotary cylinder a share of the force of its full air."""
_TAYLOR = 8
_EMPTY = 1.0 / (4.0 * 1.4)
"""Strain of the air when the exhaust of a piston pressed against its stop is empty, as a fraction
of the stroke.

The stiffness of the air is 1.4 p A (1/l1 + 1/l2), in the middle of the stroke 5.6 p A / stroke. The
force of a full chamber against an empty exhaust is p A.
"""


def _dot(rows: FloatArray, c: int, row: int, x: FloatArray) -> float:
    """Return the product of a row of cylinder ``c`` and its state in ``x`` (C, N)."""
    # Direct indices: a view of the array would cost more than these few products.
    total = 0.0
    for j in range(x.shape[1]):
        total += rows[c, row, j] * x[c, j]
    return total


def _times(
    tables: FloatArray, c: int, key: int, halved: int, x: FloatArray, ahead: FloatArray
) -> None:
    """Write to ``ahead`` the product of a matrix in ``tables`` (C, K, H, N, N) and ``x``."""
    count = x.shape[1]
    for i in range(count):
        total = 0.0
        for j in range(count):
            total += tables[c, key, halved, i, j] * x[c, j]
        ahead[c, i] = total


def _put(x: FloatArray, c: int, values: FloatArray) -> None:
    for i in range(x.shape[1]):
        x[c, i] = values[c, i]


def _stroke_of(c: int, bank: Bank, motion: Motion) -> float:
    return dot(bank.rows, c, STROKE, motion.state)


def _frame_of(c: int, bank: Bank, motion: Motion) -> float:
    return dot(bank.rows, c, FRAME, motion.state)


def _key(c: int, bank: Bank, motion: Motion) -> int:
    """Return the index of the current table, and update where the piston last stood."""
    numbers = bank.numbers
    rate = dot(bank.rows, c, RATE, motion.state)
    place = dot(bank.rows, c, STROKE, motion.state)
    if abs(rate) < _STANDSTILL_M_S or motion.mode[c] != SLIDES:
        motion.start[c] = place
    if motion.mode[c] != SLIDES:
        return 0
    ramps, ramp = 1, 1
    if numbers[c, RAMP] > 0.0:
        ramps = RAMP_STEPS
        gone = abs(place - motion.start[c]) / numbers[c, RAMP]
        ramp = min(RAMP_STEPS, 1 + int(min(gone, 1.0) * RAMP_STEPS))
    flows, flow = 1, 0
    if numbers[c, CUSHION] >= 0.0:
        flows = 2
        ending = rate > 0.0 and place > numbers[c, LENGTH] - numbers[c, CUSHION]
        if ending or (rate < 0.0 and place < numbers[c, CUSHION]):
            flow = 1
    sense = 1 if numbers[c, FRICTION] > 0.0 and motion.sense[c] > 0.0 else 0
    return 1 + (sense * flows + flow) * ramps + ramp - 1


def _stops(c: int, bank: Bank, motion: Motion) -> bool:
    """Return whether a sliding piston stops or reverses by the state ``motion.ahead``."""
    rate = dot(bank.rows, c, RATE, motion.ahead)
    place = dot(bank.rows, c, STROKE, motion.ahead)
    stroke, sense = bank.numbers[c, LENGTH], motion.sense[c]
    at_stop = (place >= stroke and rate > 0.0) or (place <= 0.0 and rate < 0.0)
    return at_stop or (sense != 0.0 and rate * sense < 0.0)


def _released(c: int, bank: Bank, motion: Motion) -> float:
    """Return the direction in which a standing piston breaks away; 0 if it does not."""
    mode, least = motion.mode[c], bank.numbers[c, BREAK]
    row = STICK
    if mode in (AT_START, AT_END):
        row, least = STOP, max(least, bank.numbers[c, ADHESION])
    holding = dot(bank.rows, c, row, motion.state)
    if holding < -least and mode != AT_END:
        return 1.0
    if holding > least and mode != AT_START:
        return -1.0
    return 0.0


def _change(c: int, bank: Bank, motion: Motion) -> None:
    x, numbers = motion.state, bank.numbers
    if motion.mode[c] != SLIDES:
        motion.sense[c] = released(c, bank, motion) if numbers[c, FRICTION] > 0.0 else 0.0
        motion.mode[c] = SLIDES
        return
    piston, housing = bank.masses[c, 0], bank.masses[c, 1]
    # The piston stops in its housing: both continue with their common momentum.
    share = numbers[c, SHARE]
    together = share * x[c, piston] + (1.0 - share) * x[c, housing]
    x[c, piston] = x[c, housing] = together
    place = dot(bank.rows, c, STROKE, x)
    if place >= numbers[c, LENGTH] - 1e-9:
        motion.mode[c] = AT_END
    elif place <= 1e-9:
        motion.mode[c] = AT_START
    else:
        motion.mode[c] = STICKS


def _advance(c: int, halved: int, bank: Bank, motion: Motion) -> None:
    """Advance a cylinder by a step that is halved ``halved`` times."""
    if motion.mode[c] != SLIDES and released(c, bank, motion) != 0.0:
        # A standing piston breaks away at the beginning of a step, to within one step.
        change(c, bank, motion)
    key = key_of(c, bank, motion)
    x, ahead = motion.state, motion.ahead
    times(bank.step, c, key, halved, x, ahead)
    if motion.mode[c] != SLIDES or not stops(c, bank, motion):
        put(x, c, ahead)
        return
    # Halves, quarters ... of the step that end before the event, and one shortest step more.
    left = 1 << (HALVINGS - halved)
    for halvings in range(halved + 1, HALVINGS + 1):
        times(bank.step, c, key, halvings, x, ahead)
        if not stops(c, bank, motion):
            put(x, c, ahead)
            left -= 1 << (HALVINGS - halvings)
    times(bank.step, c, key, HALVINGS, x, ahead)
    put(x, c, ahead)
    left -= 1
    change(c, bank, motion)
    # The piston stands for the rest of the step.
    key = key_of(c, bank, motion)
    for halvings in range(halved + 1, HALVINGS + 1):
        if left & (1 << (HALVINGS - halvings)):
            times(bank.step, c, key, halvings, x, ahead)
            put(x, c, ahead)


def _advance_share(c: int, share: float, step_s: float, bank: Bank, motion: Motion) -> None:
    """Advance a cylinder by a share of a step, in (0, 1]."""
    parts = int(share * PARTS)
    for halvings in range(HALVINGS + 1):
        if parts & (1 << (HALVINGS - halvings)):
            advance(c, halvings, bank, motion)
    rest_s = (share - parts / PARTS) * step_s
    if rest_s > 0.0:
        # Events are ignored in this remainder, which is at most 0.24 us of a step of 1 ms.
        key, count = key_of(c, bank, motion), motion.state.shape[1]
        term, then = np.empty(count), np.empty(count)
        for i in range(count):
            term[i] = motion.state[c, i]
        for power in range(1, _TAYLOR + 1):
            for i in range(count):
                total = 0.0
                for j in range(count):
                    total += bank.rate[c, key, i, j] * term[j]
                then[i] = total * (rest_s / power)
            for i in range(count):
                term[i] = then[i]
                motion.state[c, i] += term[i]


def _exhaust(c: int, bank: Bank, motion: Motion) -> None:
    """Limit the strain of the air of a piston that is pressed against its stop.

    The strain ends where the exhaust is empty. On the way back the other chamber is the exhaust,
    with full pressure from the first instant.
    """
    mode = motion.mode[c]
    if mode not in (AT_START, AT_END):
        return
    sign = 1.0 if mode == AT_END else -1.0
    x, flow, air = motion.state, bank.masses[c, 2], bank.masses[c, 3]
    most = _EMPTY * bank.numbers[c, LENGTH]
    if sign * x[c, air] > 0.9 * most and sign * x[c, flow] < 0.0:
        x[c, air] = 0.0
    elif sign * x[c, air] > most:
        x[c, air] = sign * most


dot = njit(nogil=True)(_dot)
put = njit(nogil=True)(_put)
times = njit(nogil=True)(_times)
stroke_of = njit(nogil=True)(_stroke_of)
frame_of = njit(nogil=True)(_frame_of)
key_of = njit(nogil=True)(_key)
stops = njit(nogil=True)(_stops)
released = njit(nogil=True)(_released)
change = njit(nogil=True)(_change)
advance = njit(nogil=True)(_advance)
exhaust = njit(nogil=True)(_exhaust)
advance_share = njit(nogil=True)(_advance_share)
