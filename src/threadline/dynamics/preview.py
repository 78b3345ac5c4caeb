"""References through the exact inverse, block by block: motions of any length in bounded memory."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.base.compiled import njit
from threadline.dynamics.inverse import Inverse, decay_and_moments, inverse_of
from threadline.dynamics.loop_ticks import AHEAD, Levels, Told
from threadline.dynamics.values import Values
from threadline.errors import MachineError
from threadline.machine import Machine
from threadline.machine.controllers import ProfileController

_LEFT = 1e-3  # share of an inner state's amplitude at which it counts as decayed


@dataclass(frozen=True, slots=True, kw_only=True)
class Timing:
    """When the references of an axis are due.

    Parameters
    ----------
    tick_s, step_s
        Tick of the controller's filter; time from reference to reference.
    early_s
        Time from the tick of a voltage to the instant for which it is computed: the dead time and
        half a tick of hold.
    held_s
        Time from the tick of a reference to the instant for which it is computed: half of a step
        where a step is longer than a tick, else 0.
    lead_s
        Time from the first reference to the start of the motion, in whole steps.
    settle_s
        Time from the end of the motion to the last reference: inner states and filter decay to a
        thousandth in it.
    """

    tick_s: float
    step_s: float
    early_s: float
    held_s: float
    lead_s: float
    settle_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Demand:
    """Peak voltage and current that a motion asks of the drive of one axis, by the exact inverse.

    Parameters
    ----------
    axis
        Name of the axis.
    volts, volt_limit
        Largest voltage at the controller's output, and the range of its DAC.
    current_a, current_limit_a
        Largest current in the motor (None where the model has no coil), and the limit of the
        amplifier (infinite where it has none).
    current_at_s
        When the current is largest, on the clock of the motion.
    """

    axis: str
    volts: float
    volt_limit: float
    current_a: float | None
    current_limit_a: float
    current_at_s: float

    @property
    def share(self) -> float:
        """Larger share of the two limits that is used; above 1 the machine cannot follow."""
        return max(self.volts / self.volt_limit, (self.current_a or 0.0) / self.current_limit_a)

    def at_least(self, volts: float) -> Demand:
        """Return the same with a peak voltage of at least ``volts``."""
        return replace(self, volts=max(self.volts, volts))

    @property
    def bound_by(self) -> str:
        """Name of the limit of which most is used: ``"current"`` or ``"voltage"``."""
        current = (self.current_a or 0.0) / self.current_limit_a
        return "current" if current >= self.volts / self.volt_limit else "voltage"


def timing_of(machine: Machine, axis: str, inverse: Inverse) -> Timing:
    """Return when the references of an axis are due.

    Raises
    ------
    MachineError
        If the filter has no stable inverse, or the controller generates its own positions.
    """
    controller = machine.controller_of(axis)
    if isinstance(controller, ProfileController):
        raise MachineError(
            f"axis {axis}: a controller of kind {controller.kind!r} makes its positions itself and "
            f"cannot be given those of feed-forward",
            place=machine.place,
            remedy='Give it kind "lead".',
        )
    loop = inverse.loop
    digital = loop.filters[loop.index]
    zeros = np.abs(np.roots(np.trim_zeros(digital.numerator, "b")))
    if (zeros >= 1.0).any():
        raise MachineError(
            f"axis {axis}: its controller has no stable inverse, a zero lies at |z| = "
            f"{zeros.max():.4g}",
            place=machine.place,
            remedy="Raise its proportional gain against the differential one.",
        )
    tick = digital.period_s
    step = float(machine.clock(controller.reference_clock or controller.clock).period_s)
    held = 0.5 * step if controller.reference_clock else 0.0
    early = float(loop.plant.delay_s[loop.index]) + 0.5 * tick
    slow = -np.linalg.eigvals(inverse.Q).real.max() if len(inverse.Q) else np.inf
    if len(zeros) and zeros.max() > 0.0:
        slow = min(slow, -np.log(zeros.max()) / tick)
    return Timing(
        tick_s=tick,
        step_s=step,
        early_s=early,
        held_s=held,
        lead_s=float(np.ceil((early + held + 2 * tick) / step) * step),
        settle_s=float(-np.log(_LEFT) / slow),
    )


class AxisPreview:
    """Turns the motion of one axis into the references of its controller, block by block.

    At tick k the filter must put out the voltage that the plant needs ``early_s`` later. The
    reference is the predicted reading of the sensor, plus the error that makes the filter put that
    voltage out.

    Parameters
    ----------
    model
        Numbers from which the inverse is made; those of ``machine`` when None.

    Attributes
    ----------
    latest
        What was told by the last call of ``feed``.

    Raises
    ------
    MachineError
        If the axis or its filter has no stable inverse, or the controller generates its own
        positions.
    """

    def __init__(self, machine: Machine, axis: str, model: Values | None = None) -> None:
        self.inverse = inverse_of(machine, axis, model)
        self.timing = timing_of(machine, axis, self.inverse)
        controller = machine.controller_of(axis)
        limit = machine.drive_of(axis).amplifier.current_limit
        self._axis = axis
        self._volt_limit = controller.dac.range.si
        self._current_limit_a = np.inf if limit is None else limit.si
        self._filter = self.inverse.loop.filters[self.inverse.loop.index]
        size = max(len(self._filter.numerator), len(self._filter.denominator)) - 1
        self._memory: FloatArray = np.zeros(size)
        self._sensed = _Inner(self.inverse, self.timing.tick_s)
        self._driven = _Inner(self.inverse, self.timing.tick_s)
        self._peaks = (0.0, 0.0, 0.0)
        self._levels = Levels(self._filter.numerator, skips=controller.dac.zero_on_reversal)
        self.latest = Told.none()

    @property
    def orders(self) -> int:
        """Number of columns of a ladder: the position and all derivatives that are needed."""
        return self.inverse.degree + 1

    @property
    def ahead(self) -> int:
        """Number of ticks by which ``early`` runs ahead of ``now`` in ``feed``."""
        return AHEAD

    def feed(self, time_s: FloatArray, now: FloatArray, early: FloatArray) -> FloatArray:
        """Return the (k,) position in m or rad that the controller should be told at each tick.

        Parameters
        ----------
        time_s
            (k,) times of the next ticks of the controller; before the first of all, the load rests.
        now
            (k, orders) ladder: position of the load and its derivatives at these ticks.
        early
            (k, orders) ladder ``timing.early_s`` and ``ahead`` ticks after these ticks. In the
            first call (ahead + k, orders), beginning ``timing.early_s`` after the first tick.
        """
        from scipy.signal import lfilter

        sensed = self.inverse.outputs(time_s, now, self._sensed.feed(now), self._sensed.start_si)
        last = time_s[-1] + self.ahead * self.timing.tick_s + self.timing.early_s
        acts_s = last - self.timing.tick_s * np.arange(len(early) - 1, -1, -1.0)
        driven = self.inverse.outputs(
            acts_s, early, self._driven.feed(early), self._driven.start_si
        )
        volts = self._levels.feed(driven.volts)
        error, self._memory = lfilter(
            self._filter.denominator, self._filter.numerator, volts, zi=self._memory
        )
        self._note(driven.time_s, driven.volts, driven.current_a)
        counts = sensed.measured_counts
        references = np.asarray((counts + error) / self.inverse.loop.counts_per_unit)
        self.latest = Told(references_si=references, levels=volts, counts=counts)
        return references

    @property
    def demand(self) -> Demand:
        """Peak voltage and current of all that was fed so far."""
        volts, current, at_s = self._peaks
        return Demand(
            axis=self._axis,
            volts=volts,
            volt_limit=self._volt_limit,
            current_a=current if self._has_coil else None,
            current_limit_a=self._current_limit_a,
            current_at_s=at_s,
        )

    @property
    def _has_coil(self) -> bool:
        return sum(name.endswith(".i") for name in self.inverse.plant.states) == 1

    def _note(self, time_s: FloatArray, volts: FloatArray, current_a: FloatArray | None) -> None:
        most, current, at_s = self._peaks
        if len(volts):
            most = max(most, float(np.abs(volts).max()))
        if current_a is not None and len(current_a):
            k = int(np.argmax(np.abs(current_a)))
            if abs(current_a[k]) > current:
                current, at_s = float(abs(current_a[k])), float(time_s[k])
        self._peaks = (most, current, at_s)


class _Inner:
    """The inner states ``eta' = Q eta + R (y ... y^(r-1))`` along equally spaced instants.

    Between two instants the push ``R ladder`` is the cubic with its values and slopes there, known
    from the derivatives; its error is ``T^4 / 384`` of the push's fourth derivative.
    """

    def __init__(self, inverse: Inverse, step_s: float) -> None:
        self._Q, self._R = inverse.Q, inverse.R
        decay, (m0, m1, m2, m3) = decay_and_moments(inverse.Q, step_s, 4)
        # Of one order always: a part of another array would have machine code of its own.
        self._decay: FloatArray = np.ascontiguousarray(decay)
        # Hermite's four cubics: value and slope (times the step) at the start, then at the end.
        self._start = (m0 - 3.0 * m2 + 2.0 * m3, step_s * (m1 - 2.0 * m2 + m3))
        self._end = (3.0 * m2 - 2.0 * m3, step_s * (m3 - m2))
        self._state: FloatArray = np.zeros(len(inverse.Q))
        self._last: FloatArray | None = None
        self.start_si = 0.0

    def feed(self, ladder: FloatArray) -> FloatArray:
        """Return the (k, n) states at the next (k, degree + 1) rows of the ladder."""
        if self._last is None:
            self._last = ladder[:1]
            self.start_si = float(ladder[0, 0])
        if not len(self._Q):
            return np.zeros((len(ladder), 0))
        rows = np.concatenate([self._last, ladder])
        self._last = ladder[-1:]
        away = rows[:, :-1].copy()
        away[:, 0] -= self.start_si
        push, slope = away @ self._R.T, rows[:, 1:] @ self._R.T
        before = push[:-1] @ self._start[0].T + slope[:-1] @ self._start[1].T
        after = push[1:] @ self._end[0].T + slope[1:] @ self._end[1].T
        states = _recur(self._decay, before + after, self._state)
        self._state = states[-1].copy()
        return np.asarray(states)


@njit()
def _recur(decay, push, start):  # type: ignore[no-untyped-def]
    """Return the (k, n) states ``x[k] = decay x[k - 1] + push[k]``, ``x[-1] = start``."""
    count, size = push.shape
    out = np.empty((count, size))
    x = start.copy()
    for k in range(count):
        for i in range(size):
            total = push[k, i]
            for j in range(size):
                total += decay[i, j] * x[j]
            out[k, i] = total
        for i in range(size):
            x[i] = out[k, i]
    return out
