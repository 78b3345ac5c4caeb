"""Tables of the cylinders of an on/off machine: what their equations are in each state of motion.

A piston slides, sticks, or stands at an end stop. In each state the equations are linear with
constant input, so that a step is one product with a matrix exponential.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.errors import MachineError
from threadline.machine import Machine
from threadline.machine.quantity import Quantity
from threadline.plant.cylinders import cylinder_equations
from threadline.plant.values import Values
from threadline.twin.short_step import exponential_of_short_step

SLIDES, STICKS, AT_START, AT_END = 0, 1, 2, 3
RAMP_STEPS = 8
HALVINGS = 12
STROKE, RATE, FRAME, STOP, STICK, ROWS = 0, 1, 2, 3, 4, 5
LENGTH, RAMP, CUSHION, FRICTION, BREAK, SHARE, SPEED, NUMBERS = 0, 1, 2, 3, 4, 5, 6, 7


class Bank(NamedTuple):
    """The cylinders of one variant as the compiled code reads them; C cylinders, N states at most.

    The last two states of each are the level and a constant 1.

    Parameters
    ----------
    step
        (C, K, HALVINGS + 1, N, N) transition matrices of a step, halved 0 to HALVINGS times, for
        each of the K states of motion that ``switching_cylinder`` numbers.
    rate
        (C, K, N, N) the generators of these, 1/s.
    rows
        (C, ROWS, N) stroke, its rate, the frame, and the forces that hold a standing piston.
    numbers
        (C, NUMBERS) lengths, forces and speeds of each; columns as in ``LENGTH`` and the next.
    masses
        (C, 4) indices of the velocities of piston and housing, of the flow and of the air.
    """

    step: FloatArray
    rate: FloatArray
    rows: FloatArray
    numbers: FloatArray
    masses: IntArray


class Motion(NamedTuple):
    """State of the cylinders; all that changes while they move.

    Parameters
    ----------
    state
        (C, N) state of the linear equations.
    mode
        (C,) SLIDES, STICKS, AT_START or AT_END.
    sense, start
        (C,) sense of motion, 1 or -1, that friction opposes; and stroke at which each last stood,
        m.
    ahead
        (C, N) room for the state at the end of a step.
    """

    state: FloatArray
    mode: IntArray
    sense: FloatArray
    start: FloatArray
    ahead: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cylinders:
    """The cylinders of a machine in every variant.

    The arrays are those of ``Bank``, all but ``masses`` with the variants as their first axis.
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
    """Return the tables of some cylinders of ``machine`` for every variant.

    Raises
    ------
    MachineError
        If a cylinder has no equations, or its motion grows beyond all numbers within a sample.
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
        # The states stand in front, the level and the 1 at the very end.
        n = rate.shape[-1] - 2
        place = np.concatenate((np.arange(n), [size - 2, size - 1]))
        k = rate.shape[1]
        # The shortest part by series, the longer ones each the square of the one before.
        part = exponential_of_short_step(rate * (step_s * 0.5**HALVINGS))
        for halvings in range(HALVINGS, -1, -1):
            if not np.isfinite(part).all():
                raise MachineError(
                    f"cylinders.{names[c]}: its motion grows beyond all numbers within "
                    f"{step_s * 0.5**halvings:.3g} s",
                    place=machine.place,
                    remedy="Correct its masses, its stiffness and how its air is strained.",
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
    # At an end stop only the force of the air counts: what the beam rings with, at 1.6 kHz, would
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
    return np.stack(rates, axis=1), rows, numbers, (plant.piston, plant.housing, n - 2, n - 1)


def _full(matrix: FloatArray, level: FloatArray, push: FloatArray) -> FloatArray:
    """Return (V, n + 2, n + 2) rates with the level and a constant as two more states."""
    count, n = level.shape
    full = np.zeros((count, n + 2, n + 2))
    full[:, :n, :n], full[:, :n, -2], full[:, :n, -1] = matrix, level, push
    return full
