"""Loops tick by tick, as their DACs make them: changed references, lost ticks, and the inverse.

Such a DAC loses the voltage of one tick at each change of sign. Where the voltage passes through 0
between two ticks, the phase of the encoder decides which of the two ticks is lost, so that the
motion differs from run to run. ``Levels`` decides it beforehand: the tick with the smaller voltage
is the lost one. That tick is given the new sign and a magnitude as large as its neighbours', so
that noise of the sensor cannot move the change of sign. Each neighbour receives half of the lost
voltage, which leaves the sum of the voltages and their first moment as they were
(decision 14).
"""
# mypy: disable-error-code="no-untyped-def,untyped-decorator"

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.base.compiled import njit
from threadline.dynamics.eccentric import drive_rate, rigid_motion
from threadline.dynamics.inverse import Inverse
from threadline.dynamics.sampled import sample
from threadline.machine import Machine

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


AHEAD = 3
"""Number of voltages after a tick on which its level depends."""
_NOISE_COUNTS = 2.0
_LEAST = 0.5  # share of its level that a tick beside a lost one keeps at least


class Levels:
    """Turns the voltages that a plant needs into the levels that its controller has to put out.

    Levels are in volts, too.

    Parameters
    ----------
    numerator
        (n,) numerator of the controller's filter, in volts per count: the sum of its magnitudes is
        the change of output that one count of the sensor can make.
    skips
        Whether the DAC puts out nothing at the first tick after a change of sign; otherwise the
        levels equal the voltages.
    """

    def __init__(self, numerator: FloatArray, *, skips: bool) -> None:
        self._skips = skips
        self._band = _NOISE_COUNTS * float(np.abs(numerator).sum())
        self._volts: FloatArray = np.zeros(0)
        # The level of the tick before ``_volts``, and what is added to the level of the next one.
        self._level = np.zeros(2)
        self._sign = 0.0
        self._begun = False

    def feed(self, volts: FloatArray) -> FloatArray:
        """Return the next levels for the next (k,) voltages; the last ``AHEAD`` of them wait."""
        if not self._skips:
            held = np.concatenate([self._volts, volts])
            self._volts = held[-AHEAD:]
            return np.asarray(held[:-AHEAD])
        held = np.concatenate([self._volts, volts])
        levels, self._sign = _levels(held, self._level, self._sign, self._band)
        self._volts = held[1 - AHEAD :]
        # The first level is that of the tick before: before any tick there is none.
        levels = levels if self._begun else levels[1:]
        self._begun = True
        return np.asarray(levels)


@njit()
def _levels(volts, held, sign, band):
    """Return the levels of the tick before ``volts`` and of all but their last three, and a sign.

    Parameters
    ----------
    volts
        (k,) voltages that the plant needs.
    held
        (2,) the level of the tick before ``volts``, and what is added to the level of the first of
        them; both are overwritten with those of the next call.
    sign
        Sign of the output at the tick before ``volts``. The sign that is returned is that of the
        last tick whose level is returned or held.
    band
        Smallest magnitude of a level, in volts: noise of the sensor can change the sign of a
        smaller one.
    """
    count = len(volts) - 2
    out = np.empty(count)
    before, given = held[0], held[1]
    for k in range(count):
        now, after = volts[k], volts[k + 1]
        level = now + given
        given = 0.0
        away = sign * now < 0.0
        # The tick before a reversal may have less to lose. Where the sign changes for one tick
        # alone, either that tick is lost, or the tick before it and the tick after it are.
        back = abs(volts[k + 2]) if after * volts[k + 2] < 0.0 else 0.0
        soon = sign * now > 0.0 and now * after < 0.0 and abs(now) + back < abs(after)
        if away or soon:
            lost = level
            sure = min(abs(before), abs(after))
            level = -sign * max(abs(now) if away else band, sure)
            share = _kept(before, 0.5 * lost)
            before += share
            given = _kept(after, lost - share)
        elif sign * level > 0.0 and abs(level) < band:
            given = level - sign * band
            level = sign * band
        out[k] = before
        sign = 0.0 if away or soon else np.sign(level)
        before = level
    held[0], held[1] = before, given
    return out, sign


@njit()
def _kept(level, change):
    """Return ``change``, cut so that at least half of ``level`` is left with its sign."""
    if level * change >= 0.0:
        return change
    return -np.sign(level) * min(abs(change), _LEAST * abs(level))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Told:
    """What an inverse makes of the motion of one axis at consecutive ticks of its controller.

    Parameters
    ----------
    references_si
        (k,) what the controller is told, m or rad.
    levels
        (k,) what it puts out, V, before its DAC loses any of it.
    counts
        (k,) what its sensor reads.
    """

    references_si: FloatArray
    levels: FloatArray
    counts: FloatArray

    def __len__(self) -> int:
        return len(self.levels)

    @classmethod
    def none(cls) -> Told:
        """Return what is told at no ticks."""
        return cls(references_si=np.zeros(0), levels=np.zeros(0), counts=np.zeros(0))

    def joined(self, other: Told) -> Told:
        """Return this and the ticks behind it."""
        return Told(
            references_si=np.concatenate([self.references_si, other.references_si]),
            levels=np.concatenate([self.levels, other.levels]),
            counts=np.concatenate([self.counts, other.counts]),
        )

    def part(self, first: int, stop: int) -> Told:
        """Return the ticks from one to before another."""
        some = slice(first, stop)
        return Told(
            references_si=self.references_si[some],
            levels=self.levels[some],
            counts=self.counts[some],
        )

    def held(self, more: int) -> Told:
        """Return the same with ``more`` ticks at rest behind it."""
        return Told(
            references_si=np.pad(self.references_si, (0, more), mode="edge"),
            levels=np.pad(self.levels, (0, more)),
            counts=np.pad(self.counts, (0, more), mode="edge"),
        )
