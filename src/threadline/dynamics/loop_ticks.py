"""Control loops tick by tick, with DACs that lose a tick at each reversal.

Such a DAC outputs 0 for one tick at each change of sign: the voltage of this tick is lost. If the
voltage passes through 0 between two ticks, the phase of the encoder decides which of the two is
lost, so that the motion differs from run to run. ``Levels`` decides it in advance: the tick with
the smaller voltage is lost. Its level gets the new sign and the magnitude of its neighbours, so
that sensor noise cannot move the change of sign. Each neighbour receives half of the lost voltage,
which preserves the sum of the voltages and their first moment (decision 14).
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

_SETTLES = 1e-4  # the response to a change ends when the slowest pole has decayed to this share
_MAX_TICKS = 600
_SPARE_TICKS = 20
_NOTHING_V = 1e-9  # far above rounding errors of levels, far below the effect of a sensor count


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Changes:
    """Response to changes of the references, (k, columns) at k ticks.

    Parameters
    ----------
    load_si
        Position of the load, m or rad.
    levels
        Output of the controller, V.
    current_a
        Current of the motor, computed without inductance and before the amplifier limits it.
    """

    load_si: FloatArray
    levels: FloatArray
    current_a: FloatArray


class LoopTicks:
    """The loop of one axis, tick by tick; the axis must not be coupled to other axes."""

    def __init__(self, machine: Machine, axis: str, inverse: Inverse) -> None:
        loop = inverse.loop
        self._filter = loop.filters[loop.index]
        self._counts_per_unit = loop.counts_per_unit
        outputs = [loop.sensors[loop.index], f"{axis}.load"]
        self._plant = sample(
            loop.plant.select([loop.plant.inputs[loop.index]], outputs), loop.period_s
        )
        drive = machine.drive_of(axis)
        ohms, emf = 1.0, 0.0
        if drive.amplifier.mode == "voltage":
            drive_per_axis = abs(drive_rate(machine, axis, rigid_motion(machine, axis)))
            ohms = drive.resistance.si
            emf = drive.back_emf.si * drive_per_axis / self._counts_per_unit / loop.period_s
        self._per_volt, self._per_count = drive.amplifier.gain.si / ohms, emf / ohms
        radius = min(max(loop.closed().spectral_radius, 1e-3), 1.0 - 1e-9)
        self.memory = min(int(np.ceil(np.log(_SETTLES) / np.log(radius))), _MAX_TICKS)
        self.memory += _SPARE_TICKS

    def current_a(self, acts: FloatArray, counts: FloatArray) -> FloatArray:
        """Return the (k, ...) currents, A, for the DAC's voltages and the sensor's counts."""
        return self._per_volt * acts - self._per_count * np.gradient(counts, axis=0)

    def changed(
        self, more_si: FloatArray, effect: Callable[[int, FloatArray], FloatArray]
    ) -> Changes:
        """Return the response to (k, columns) changes of the references, from an unchanged state.

        Parameters
        ----------
        effect
            Function from a tick and the (columns,) changes of the level to the (columns,) changes
            of the DAC's voltage.
        """
        b, a = self._filter.numerator, self._filter.denominator
        plant, dead_ticks = self._plant, self._plant.ticks[0]
        count, columns = more_si.shape
        state = np.zeros((len(plant.transition), columns))
        first, second = np.zeros(columns), np.zeros(columns)
        delay_line = [np.zeros(columns) for _ in range(dead_ticks + 2)]
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
            delay_line = [acts[k], *delay_line[:-1]]
            state = plant.transition @ state
            state += plant.newer * delay_line[dead_ticks] + plant.older * delay_line[dead_ticks + 1]
        return Changes(load_si=load, levels=levels, current_a=self.current_a(acts, read))


def acting(levels: FloatArray) -> FloatArray:
    """Return the (k,) outputs of a DAC that loses the first tick after a reversal."""
    acts, last_output = levels.copy(), 0.0
    for k, level in enumerate(levels.tolist()):
        acts[k] = last_output = acts_after(last_output, level)
    return acts


def acts_after(before: float, level: float) -> float:
    """Return the DAC's output in V for a level, given its output at the preceding tick.

    A level with a magnitude below ``_NOTHING_V`` is rounding noise and has no sign.
    """
    not_zero = min(abs(level), abs(before)) >= _NOTHING_V
    return 0.0 if not_zero and level * before < 0.0 else level


AHEAD = 3
"""Number of following voltages on which a level depends."""
_NOISE_COUNTS = 2.0
_LEAST_LEVEL_SHARE = 0.5  # a neighbour of a lost tick keeps at least this share of its level


class Levels:
    """Converts the voltages that a plant needs into the controller's output levels, in volts.

    Parameters
    ----------
    numerator
        (n,) numerator of the controller's filter, in volts per count. The sum of the magnitudes is
        the largest effect of one sensor count on the output.
    skips
        Whether the DAC outputs 0 at the first tick after a change of sign; if not, the levels equal
        the voltages.
    """

    def __init__(self, numerator: FloatArray, *, skips: bool) -> None:
        self._skips = skips
        self._band = _NOISE_COUNTS * float(np.abs(numerator).sum())
        self._volts: FloatArray = np.zeros(0)
        # The level of the tick before ``_volts``, and the voltage to add to the next level.
        self._level = np.zeros(2)
        self._sign = 0.0
        self._begun = False

    def feed(self, volts: FloatArray) -> FloatArray:
        """Return levels for the next (k,) voltages, delayed by ``AHEAD`` ticks."""
        if not self._skips:
            pending = np.concatenate([self._volts, volts])
            self._volts = pending[-AHEAD:]
            return np.asarray(pending[:-AHEAD])
        pending = np.concatenate([self._volts, volts])
        levels, self._sign = _levels(pending, self._level, self._sign, self._band)
        self._volts = pending[1 - AHEAD :]
        # The first level belongs to the preceding tick; in the first call there is none.
        levels = levels if self._begun else levels[1:]
        self._begun = True
        return np.asarray(levels)


@njit()
def _levels(volts, held, sign, band):
    """Return the levels of the tick before ``volts`` and of ``volts`` without the last three.

    The sign of the output is returned as well.

    Parameters
    ----------
    volts
        (k,) voltages that the plant needs.
    held
        (2,) the level of the tick before ``volts``, and the voltage to add to the first level of
        ``volts``; both are overwritten with the values for the next call.
    sign
        Sign of the output at the tick before ``volts``. The returned sign is the sign at the last
        tick whose level is returned or held.
    band
        Smallest magnitude of a level, in volts: sensor noise could change the sign of a smaller
        level.
    """
    count = len(volts) - 2
    out = np.empty(count)
    level_before, carried = held[0], held[1]
    for k in range(count):
        volts_now, volts_after = volts[k], volts[k + 1]
        level = volts_now + carried
        carried = 0.0
        has_reversed = sign * volts_now < 0.0
        # The tick before a reversal may have the smaller voltage. If the sign changes for one tick
        # only, either that tick is lost, or the ticks before and after it.
        volts_back = abs(volts[k + 2]) if volts_after * volts[k + 2] < 0.0 else 0.0
        reverses_next = (
            sign * volts_now > 0.0
            and volts_now * volts_after < 0.0
            and abs(volts_now) + volts_back < abs(volts_after)
        )
        if has_reversed or reverses_next:
            lost_level = level
            safe_level = min(abs(level_before), abs(volts_after))
            level = -sign * max(abs(volts_now) if has_reversed else band, safe_level)
            part_before = _limited_change(level_before, 0.5 * lost_level)
            level_before += part_before
            carried = _limited_change(volts_after, lost_level - part_before)
        elif sign * level > 0.0 and abs(level) < band:
            carried = level - sign * band
            level = sign * band
        out[k] = level_before
        sign = 0.0 if has_reversed or reverses_next else np.sign(level)
        level_before = level
    held[0], held[1] = level_before, carried
    return out, sign


@njit()
def _limited_change(level, change):
    """Return ``change``, limited so that at least half of ``level`` remains."""
    if level * change >= 0.0:
        return change
    return -np.sign(level) * min(abs(change), _LEAST_LEVEL_SHARE * abs(level))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class InverseOutput:
    """Output of the exact inverse for one axis at consecutive ticks of its controller.

    Parameters
    ----------
    references_si
        (k,) references of the controller, m or rad.
    levels
        (k,) output of the controller, V, before its DAC loses ticks.
    counts
        (k,) predicted readings of its sensor.
    """

    references_si: FloatArray
    levels: FloatArray
    counts: FloatArray

    def __len__(self) -> int:
        return len(self.levels)

    @classmethod
    def none(cls) -> InverseOutput:
        """Return an empty object."""
        return cls(references_si=np.zeros(0), levels=np.zeros(0), counts=np.zeros(0))

    def joined(self, other: InverseOutput) -> InverseOutput:
        """Return this followed by the ticks of ``other``."""
        return InverseOutput(
            references_si=np.concatenate([self.references_si, other.references_si]),
            levels=np.concatenate([self.levels, other.levels]),
            counts=np.concatenate([self.counts, other.counts]),
        )

    def part(self, first: int, stop: int) -> InverseOutput:
        """Return the ticks from ``first`` to before ``stop``."""
        ticks = slice(first, stop)
        return InverseOutput(
            references_si=self.references_si[ticks],
            levels=self.levels[ticks],
            counts=self.counts[ticks],
        )

    def held(self, more: int) -> InverseOutput:
        """Return this followed by ``more`` ticks at rest."""
        return InverseOutput(
            references_si=np.pad(self.references_si, (0, more), mode="edge"),
            levels=np.pad(self.levels, (0, more)),
            counts=np.pad(self.counts, (0, more), mode="edge"),
        )
