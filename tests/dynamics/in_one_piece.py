"""Feed-forward of one axis in one piece: the reference for the references made block by block.

A moving average over ``w`` makes a motion differentiable once more. A repeated moving average of a
piecewise polynomial is a divided difference of its repeated integral, ``y_n(t) = prod(delta_i /
w_i) I^n y(t)``, so every derivative is exact, without differences of samples. The averages are
centred, so the motion is not delayed. Axes with the same widths round a corner in the same way, and
a straight path stays straight.

A motion chip accepts only position references, so the chip's filter must produce the voltage of the
exact inverse. At tick k the filter must output the voltage that the plant needs one dead time and
half a hold later, ``v = u(t + tau + T/2)``. The inverse of the filter's difference equation gives
the error that produces this voltage; the reference is the predicted sensor reading plus that error.
A reference holds for one reference tick, so each is computed for the instant half a reference tick
after it is due.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Protocol

import numpy as np

from threadline.base.arrays import FloatArray, Locked, read_only
from threadline.dynamics.inverse import Followed, Inverse, decay_and_moments, inverse_of
from threadline.dynamics.loop_ticks import AHEAD, Levels
from threadline.dynamics.preview import timing_of
from threadline.dynamics.values import Values
from threadline.errors import OptionError
from threadline.machine import Machine

if TYPE_CHECKING:
    from scipy.interpolate import PPoly


_GAUSS_AT = 0.5 + 0.5 * np.array([-np.sqrt(0.6), 0.0, np.sqrt(0.6)])
# Coefficients, constant first, of the three parabolas that are 1 at one Gauss point and 0 at the
# others.
_GAUSS_BASIS = np.linalg.inv(np.vander(_GAUSS_AT, increasing=True)).T


class Motion(Protocol):
    """Position of the load over time, with derivatives; m or rad."""

    def __call__(self, time_s: FloatArray, order: int = 0) -> FloatArray:
        """Return the (k,) derivative of ``order`` at (k,) times."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SmoothMotion(Locked):
    """Moving averages of a motion, with exact derivatives.

    Parameters
    ----------
    source
        The motion before averaging, a piecewise polynomial with a piece of rest at either end.
    widths_s
        (n,) widths of the moving averages, in s.
    start_s, end_s
        The averaged motion is at rest before ``start_s`` and after ``end_s``.
    """

    source: PPoly
    widths_s: FloatArray
    start_s: float
    end_s: float

    def __call__(self, time_s: FloatArray, order: int = 0) -> FloatArray:
        """Return the (k,) derivative of order ``order`` at (k,) times."""
        t = np.asarray(time_s, dtype=np.float64)
        n = len(self.widths_s)
        whole = (
            self.source.antiderivative(n - order)
            if order < n
            else self.source.derivative(order - n)
        )
        if order == n:
            whole = self.source
        low, high = self.source.x[0], self.source.x[-1]
        total = np.zeros_like(t)
        for signs in product((-1.0, 1.0), repeat=n):
            at = t + 0.5 * float(np.dot(signs, self.widths_s))
            # Beyond its ends the source is at rest, and its integrals are polynomials.
            total += np.prod(signs) * _beyond(whole, self.source, at, low, high, n - order)
        scale = float(np.prod(self.widths_s)) if n else 1.0
        return np.asarray(total / scale)


def smooth_motion(
    break_s: FloatArray, coefficients: FloatArray, widths_s: FloatArray
) -> SmoothMotion:
    """Return the moving averages of a piecewise polynomial, at rest before and after.

    Parameters
    ----------
    break_s
        (m + 1,) increasing times.
    coefficients
        (degree + 1, m) coefficients of the position on each interval, highest power first, in the
        time since the start of the interval (scipy's ``PPoly``).
    widths_s
        (n,) widths of the moving averages, in s.

    Raises
    ------
    OptionError
        If a width is not above zero.
    """
    from scipy.interpolate import PPoly

    widths = read_only(widths_s, "widths_s", ndim=1)
    if (widths <= 0).any():
        raise OptionError(f"widths of moving averages must be above 0 s, got {widths.tolist()}")
    times = read_only(break_s, "break_s", ndim=1)
    powers = read_only(coefficients, "coefficients", ndim=2)
    source = PPoly(powers, times)
    rest = float(widths.sum()) + 1e-9
    first, last = float(source(times[0])), float(source(times[-1]))
    padded = np.zeros((len(powers), powers.shape[1] + 2))
    padded[:, 1:-1] = powers
    padded[-1, 0], padded[-1, -1] = first, last
    whole = PPoly(padded, np.concatenate([[times[0] - rest], times, [times[-1] + rest]]))
    half = 0.5 * float(widths.sum())
    return SmoothMotion(
        source=whole,
        widths_s=widths,
        start_s=float(times[0]) - half,
        end_s=float(times[-1]) + half,
    )


def _beyond(
    whole: PPoly, source: PPoly, at: FloatArray, low: float, high: float, integrals: int
) -> FloatArray:
    """Return ``whole``, an integral or derivative of ``source``, extended beyond its ends at rest.

    ``integrals`` is the number of integrations; a negative number means derivatives.
    """
    inside = np.asarray(whole(np.clip(at, low, high)), dtype=np.float64)
    if integrals <= 0:
        if integrals < 0:
            inside = np.where((at < low) | (at > high), 0.0, inside)
        return inside
    # Taylor series at the end: beyond it the source is constant and its integrals are polynomials.
    for end, out in ((low, at < low), (high, at > high)):
        if not out.any():
            continue
        past = at[out] - end
        value = np.zeros_like(past)
        factor = np.ones_like(past)
        for k in range(integrals + 1):
            left = integrals - k
            level = source.antiderivative(left)(end) if left else source(end)
            value += float(level) * factor
            factor = factor * past / (k + 1)
        inside[out] = value
    return inside


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FeedForward:
    """References for one axis, and the voltage and current that they need.

    Parameters
    ----------
    reference_si
        (k,) position to command at each reference tick, m or rad, from ``start_s`` on.
    start_s
        Time of the first reference, on the clock of the motion: before the start of the motion,
        because references act with a delay.
    period_s
        Time from reference to reference.
    followed
        Load, sensor, voltage and current at each tick of the controller.
    peak_volts, peak_current_a
        Largest magnitudes of the controller's output and the motor's current (None without a coil).
    volt_limit, current_limit_a
        Largest voltage of the DAC and current of the amplifier (infinite without a limit).
    """

    reference_si: FloatArray
    start_s: float
    period_s: float
    followed: Followed
    peak_volts: float
    peak_current_a: float | None
    volt_limit: float
    current_limit_a: float

    @property
    def within_limits(self) -> bool:
        """Whether peak voltage and peak current are within the limits of the drive."""
        current = self.peak_current_a is None or self.peak_current_a <= self.current_limit_a
        return current and self.peak_volts <= self.volt_limit

    @property
    def bound_by(self) -> str:
        """The limit with the least reserve: ``"current"`` or ``"voltage"``."""
        current = 0.0 if self.peak_current_a is None else self.peak_current_a / self.current_limit_a
        return "current" if current >= self.peak_volts / self.volt_limit else "voltage"


def follow(inverse: Inverse, motion: Motion, time_s: FloatArray) -> Followed:
    """Return sensor, voltage and current while the load follows ``motion`` from rest.

    Parameters
    ----------
    motion
        Position of the load with ``degree`` derivatives, at rest at ``time_s[0]``.
    time_s
        (k,) equally spaced instants, in s. The inner states are exact to rounding only where
        no derivative jumps between two of them.
    """
    t = np.asarray(time_s, dtype=np.float64)
    derivatives = np.stack([motion(t, order) for order in range(inverse.degree + 1)], axis=1)
    return inverse.outputs(t, derivatives, _inner(inverse, motion, t), float(derivatives[0, 0]))


def _inner(inverse: Inverse, motion: Motion, t: FloatArray) -> FloatArray:
    """Integrate the inner states under the parabola through each step's three Gauss points."""
    inner = np.zeros((len(t), len(inverse.Q)))
    if not len(inverse.Q) or len(t) < 2:
        return inner
    step = float(t[1] - t[0])
    decay, moments = decay_and_moments(inverse.Q, step, 3)
    first = float(motion(t[:1], 0)[0])
    push = np.zeros((len(t) - 1, len(inverse.Q)))
    for at, parabola in zip(_GAUSS_AT, _GAUSS_BASIS, strict=True):
        times = t[:-1] + at * step
        derivatives = np.stack([motion(times, order) for order in range(inverse.degree)], axis=1)
        derivatives[:, 0] -= first
        push += derivatives @ inverse.R.T @ np.tensordot(parabola, moments, axes=1).T
    for k in range(len(t) - 1):
        inner[k + 1] = decay @ inner[k] + push[k]
    return inner


def feed_forward(
    machine: Machine,
    axis: str,
    motion: Motion,
    start_s: float,
    end_s: float,
    *,
    settle_s: float | None = None,
    model: Values | None = None,
) -> FeedForward:
    """Return the references with which the load of ``axis`` follows ``motion``.

    Parameters
    ----------
    motion
        Position of the load, m or rad, with as many derivatives as integrations from voltage to
        load (5 for a belt behind a motor with a coil).
    start_s, end_s
        The load is at rest before ``start_s`` and after ``end_s``, on the clock of the motion.
    settle_s
        Duration of references after ``end_s``. By default until an internal oscillation (of the
        frame, for example) has decayed to a thousandth, because the motor must compensate it until
        then.
    model
        Numbers for the inverse; None: the numbers of ``machine``.

    Raises
    ------
    MachineError
        If the axis or its filter has no stable inverse, or the controller generates positions
        itself (a ``ProfileController``).
    """
    from scipy.signal import lfilter

    controller = machine.controller_of(axis)
    inverse = inverse_of(machine, axis, model)
    loop = inverse.loop
    timing = timing_of(machine, axis, inverse)
    if settle_s is None:
        settle_s = timing.settle_s
    digital = loop.filters[loop.index]
    tick, step, held, early = timing.tick_s, timing.step_s, timing.held_s, timing.early_s
    lead = timing.lead_s
    begin = start_s - lead
    # The volts are needed in the middle of a hold, hence the shift by ``early``.
    count = int(np.ceil((end_s + settle_s + lead - begin) / tick)) + 2
    ticks: FloatArray = np.asarray(begin + tick * np.arange(count))
    sensed = follow(inverse, motion, ticks)
    driven = follow(inverse, motion, np.asarray(ticks + early))
    levels = Levels(digital.numerator, skips=controller.dac.zero_on_reversal)
    volts = levels.feed(np.append(driven.volts, np.repeat(driven.volts[-1:], AHEAD)))
    error = lfilter(digital.denominator, digital.numerator, volts)
    expected = (sensed.measured_counts + error) / loop.counts_per_unit
    rows = int(np.floor((ticks[-1] - held - begin) / step)) + 1
    due = begin + step * np.arange(rows)
    limit = machine.drive_of(axis).amplifier.current_limit
    return FeedForward(
        reference_si=np.interp(due + held, ticks, expected),
        start_s=begin,
        period_s=step,
        followed=driven,
        peak_volts=float(np.abs(driven.volts).max()),
        peak_current_a=None if driven.current_a is None else float(np.abs(driven.current_a).max()),
        volt_limit=controller.dac.range.si,
        current_limit_a=np.inf if limit is None else limit.si,
    )
