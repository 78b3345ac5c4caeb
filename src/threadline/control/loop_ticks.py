"""One loop, tick by tick, as its DAC makes it: what changed references change."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from threadline.arrays import FloatArray
from threadline.control.inverse import Inverse
from threadline.machine import Machine
from threadline.plant.rigid import drive_rate, rigid_motion
from threadline.plant.sampled import sample

_SETTLES = 1e-4  # share of the slowest pole's motion at which a change is followed no more
_MOST_TICKS = 600
_SPARE_TICKS = 20
_NOTHING_V = 1e-9  # far above the rounding of levels, far below what a count of a sensor makes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Changes:
    """What changes of the references change, (k, columns) at k ticks.

    Parameters
    ----------
    load_si
        Position of the load, m or rad.
    levels
        Output of the controller, V.
    current_a
        Current of the motor, as of a winding without a coil; before the amplifier limits it.
    """

    load_si: FloatArray
    levels: FloatArray
    current_a: FloatArray


class LoopTicks:
    """The loop of one axis that moves on its own."""

    def __init__(self, machine: Machine, axis: str, inverse: Inverse) -> None:
        loop = inverse.loop
        self._filter = loop.filters[loop.index]
        self._counts_per_unit = loop.counts_per_unit
        seen = [loop.sensors[loop.index], f"{axis}.load"]
        self._plant = sample(
            loop.plant.select([loop.plant.inputs[loop.index]], seen), loop.period_s
        )
        drive = machine.drive_of(axis)
        ohms, emf = 1.0, 0.0
        if drive.amplifier.mode == "voltage":
            turning = abs(drive_rate(machine, axis, rigid_motion(machine, axis)))
            ohms = drive.resistance.si
            emf = drive.back_emf.si * turning / self._counts_per_unit / loop.period_s
        self._per_volt, self._per_count = drive.amplifier.gain.si / ohms, emf / ohms
        radius = min(max(loop.closed().spectral_radius, 1e-3), 1.0 - 1e-9)
        self.memory = min(int(np.ceil(np.log(_SETTLES) / np.log(radius))), _MOST_TICKS)
        self.memory += _SPARE_TICKS

    def current_a(self, acts: FloatArray, counts: FloatArray) -> FloatArray:
        """Return the (k, ...) currents at voltages that act and counts that are read."""
        return self._per_volt * acts - self._per_count * np.gradient(counts, axis=0)

    def changed(
        self, more_si: FloatArray, effect: Callable[[int, FloatArray], FloatArray]
    ) -> Changes:
        """Return what (k, columns) changes of the references change, from no change on.

        Parameters
        ----------
        effect
            From the number of a tick and the (columns,) changes of the level to those of the
            voltage that acts.
        """
        b, a = self._filter.numerator, self._filter.denominator
        plant, late = self._plant, self._plant.ticks[0]
        count, columns = more_si.shape
        state = np.zeros((len(plant.transition), columns))
        first, second = np.zeros(columns), np.zeros(columns)
        line = [np.zeros(columns) for _ in range(late + 2)]
        load, levels = np.empty((count, columns)), np.empty((count, columns))
        acts, read = np.empty((count, columns)), np.empty((count, columns))
        for k in range(count):
            read[k], load[k] = plant.C @ state
            error = more_si[k] * self._counts_per_unit - read[k]
            # Transposed direct form of the controller's difference equation.
            levels[k] = b[0] * error + first
            first = b[1] * error - a[1] * levels[k] + second
            second = b[2] * error - a[2] * levels[k]
            acts[k] = effect(k, levels[k])
            line = [acts[k], *line[:-1]]
            state = plant.transition @ state
            state += plant.newer * line[late] + plant.older * line[late + 1]
        return Changes(load_si=load, levels=levels, current_a=self.current_a(acts, read))


def acting(levels: FloatArray) -> FloatArray:
    """Return (k,) levels as a DAC puts them out that loses the first tick after a reversal."""
    acts, before = levels.copy(), 0.0
    for k, level in enumerate(levels.tolist()):
        acts[k] = before = acts_after(before, level)
    return acts


def acts_after(before: float, level: float) -> float:
    """Return what such a DAC puts out for a level, by what it put out at the tick before, V.

    A level at rest is 0, which rounding gives a sign: below ``_NOTHING_V`` it has none.
    """
    signed = min(abs(level), abs(before)) >= _NOTHING_V
    return 0.0 if signed and level * before < 0.0 else level
