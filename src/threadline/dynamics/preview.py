"""References from the exact inverse, computed block by block with bounded memory."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.base.compiled import njit
from threadline.dynamics.inverse import Inverse, decay_and_moments, inverse_of
from threadline.dynamics.loop_ticks import AHEAD, InverseOutput, Levels
from threadline.dynamics.values import Values
from threadline.errors import MachineError
from threadline.machine import Machine
from threadline.machine.controllers import ProfileController

_DECAYED_SHARE = 1e-3  # an inner state counts as decayed when it has fallen to this share


@dataclass(frozen=True, slots=True, kw_only=True)
class Timing:
    """Timing of the references of an axis.

    Parameters
    ----------
    tick_s, step_s
        Tick of the controller's filter, and time from one reference to the next.
    early_s
        Time from the tick of a voltage to the instant for which this voltage is computed: the dead
        time plus half a tick.
    held_s
        Time from the tick of a reference to the instant for which this reference is computed: half
        a step if a step is longer than a tick, else 0.
    lead_s
        Time from the first reference to the start of the motion, in whole steps.
    settle_s
        Time from the end of the motion to the last reference. In this time the inner states and the
        filter decay to a thousandth.
    """

    tick_s: float
    step_s: float
    early_s: float
    held_s: float
    lead_s: float
    settle_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Demand:
    """Peak voltage and current that a motion needs from the drive of an axis, by the exact inverse.

    Parameters
    ----------
    axis
        Name of the axis.
    volts, volt_limit
        Largest voltage at the controller's output, and the range of its DAC.
    current_a, current_limit_a
        Largest current in the motor (None if the model has no coil), and the limit of the amplifier
        (infinite for none).
    current_at_s
        Instant of the largest current, on the clock of the motion.
    """

    axis: str
    volts: float
    volt_limit: float
    current_a: float | None
    current_limit_a: float
    current_at_s: float

    @property
    def share(self) -> float:
        """Larger one of the ratios demand / limit; if it is above 1 the machine cannot follow."""
        return max(self.volts / self.volt_limit, (self.current_a or 0.0) / self.current_limit_a)

    def at_least(self, volts: float) -> Demand:
        """Return this demand with a peak voltage of at least ``volts``."""
        return replace(self, volts=max(self.volts, volts))

    @property
    def bound_by(self) -> str:
        """Name of the limit with the smaller reserve: ``"current"`` or ``"voltage"``."""
        current = (self.current_a or 0.0) / self.current_limit_a
        return "current" if current >= self.volts / self.volt_limit else "voltage"


def timing_of(machine: Machine, axis: str, inverse: Inverse) -> Timing:
    """Return the timing of the references of an axis.

    Raises
    ------
    MachineError
        If the filter has no stable inverse, or the controller generates positions itself.
    """
    controller = machine.controller_of(axis)
    if isinstance(controller, ProfileController):
        raise MachineError(
            f"axis {axis}: a controller of kind {controller.kind!r} generates positions itself and "
            f"cannot follow feed-forward references",
            place=machine.place,
            remedy='Give it kind "lead".',
        )
    loop = inverse.loop
    digital = loop.filters[loop.index]
    zeros = np.abs(np.roots(np.trim_zeros(digital.numerator, "b")))
    if (zeros >= 1.0).any():
        raise MachineError(
            f"axis {axis}: its controller has no stable inverse, because of a zero at |z| = "
            f"{zeros.max():.4g}",
            place=machine.place,
            remedy="Raise its proportional gain relative to its differential gain.",
        )
    tick_s = digital.period_s
    step_s = float(machine.clock(controller.reference_clock or controller.clock).period_s)
    held_s = 0.5 * step_s if controller.reference_clock else 0.0
    early_s = float(loop.plant.delay_s[loop.index]) + 0.5 * tick_s
    slowest_decay = -np.linalg.eigvals(inverse.Q).real.max() if len(inverse.Q) else np.inf
    if len(zeros) and zeros.max() > 0.0:
        slowest_decay = min(slowest_decay, -np.log(zeros.max()) / tick_s)
    return Timing(
        tick_s=tick_s,
        step_s=step_s,
        early_s=early_s,
        held_s=held_s,
        lead_s=float(np.ceil((early_s + held_s + 2 * tick_s) / step_s) * step_s),
        settle_s=float(-np.log(_DECAYED_SHARE) / slowest_decay),
    )


class AxisPreview:
    """Computes the references of a controller from the motion of its axis, block by block.

    At tick k the filter must output the voltage that the plant needs ``early_s`` later. The
    reference at tick k is the predicted sensor reading plus the error for which the filter outputs
    this voltage.

    Parameters
    ----------
    model
        Numbers for the inverse; None: the numbers of ``machine``.

    Attributes
    ----------
    latest
        Output of the last call of ``feed``.

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
        self.latest = InverseOutput.none()

    @property
    def orders(self) -> int:
        """Number of columns: the position and its required derivatives."""
        return self.inverse.degree + 1

    @property
    def ahead(self) -> int:
        """Number of ticks by which ``early`` is ahead of ``now`` in ``feed``."""
        return AHEAD

    def feed(self, time_s: FloatArray, now: FloatArray, early: FloatArray) -> FloatArray:
        """Return the (k,) references of the controller in m or rad.

        Parameters
        ----------
        time_s
            (k,) times of the next ticks of the controller; the load is at rest before the first
            tick.
        now
            (k, orders): position of the load and its derivatives at these ticks.
        early
            (k, orders): the same at ``timing.early_s`` plus ``ahead`` ticks after these ticks. In
            the first call the shape is (ahead + k, orders), and the rows begin ``timing.early_s``
            after the first tick.
        """
        from scipy.signal import lfilter

        sensed = self.inverse.outputs(time_s, now, self._sensed.feed(now), self._sensed.start_si)
        last_acts_s = time_s[-1] + self.ahead * self.timing.tick_s + self.timing.early_s
        acts_s = last_acts_s - self.timing.tick_s * np.arange(len(early) - 1, -1, -1.0)
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
        self.latest = InverseOutput(references_si=references, levels=volts, counts=counts)
        return references

    @property
    def demand(self) -> Demand:
        """Peak voltage and current of all blocks so far."""
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
        peak_volts, peak_current, at_s = self._peaks
        if len(volts):
            peak_volts = max(peak_volts, float(np.abs(volts).max()))
        if current_a is not None and len(current_a):
            k = int(np.argmax(np.abs(current_a)))
            if abs(current_a[k]) > peak_current:
                peak_current, at_s = float(abs(current_a[k])), float(time_s[k])
        self._peaks = (peak_volts, peak_current, at_s)


class _Inner:
    """Inner states ``eta' = Q eta + R (y ... y^(r-1))`` at equally spaced instants.

    Between two instants the input ``R (y ... y^(r-1))`` is approximated by the cubic with the same
    values and slopes at both instants; the slopes are known from the derivatives. The error is
    ``T^4 / 384`` times the fourth derivative of the input.
    """

    def __init__(self, inverse: Inverse, step_s: float) -> None:
        self._Q, self._R = inverse.Q, inverse.R
        decay, (m0, m1, m2, m3) = decay_and_moments(inverse.Q, step_s, 4)
        # Always contiguous: numba would compile another version of ``_recur`` for another layout.
        self._decay: FloatArray = np.ascontiguousarray(decay)
        # Hermite's four cubics: for value and slope (times the step) at the start and at the end.
        self._start = (m0 - 3.0 * m2 + 2.0 * m3, step_s * (m1 - 2.0 * m2 + m3))
        self._end = (3.0 * m2 - 2.0 * m3, step_s * (m3 - m2))
        self._state: FloatArray = np.zeros(len(inverse.Q))
        self._last: FloatArray | None = None
        self.start_si = 0.0

    def feed(self, derivatives: FloatArray) -> FloatArray:
        """Return the (k, n) states at the next (k, degree + 1) rows: position and derivatives."""
        if self._last is None:
            self._last = derivatives[:1]
            self.start_si = float(derivatives[0, 0])
        if not len(self._Q):
            return np.zeros((len(derivatives), 0))
        rows = np.concatenate([self._last, derivatives])
        self._last = derivatives[-1:]
        from_start = rows[:, :-1].copy()
        from_start[:, 0] -= self.start_si
        values, slope = from_start @ self._R.T, rows[:, 1:] @ self._R.T
        start_push = values[:-1] @ self._start[0].T + slope[:-1] @ self._start[1].T
        end_push = values[1:] @ self._end[0].T + slope[1:] @ self._end[1].T
        states = _recur(self._decay, start_push + end_push, self._state)
        self._state = states[-1].copy()
        return np.asarray(states)


@njit()
def _recur(decay, push, start):  # type: ignore[no-untyped-def]
    """Return the (k, n) states ``x[k] = decay x[k - 1] + push[k]``, ``x[-1] = start``."""
    count, size = push.shape
    states = np.empty((count, size))
    x = start.copy()
    for k in range(count):
        for i in range(size):
            total = push[k, i]
            for j in range(size):
                total += decay[i, j] * x[j]
            states[k, i] = total
        for i in range(size):
            x[i] = states[k, i]
    return states
