"""References with which the load of an axis follows a motion, through the loop that the axis has.

A motion chip accepts nothing but position references, so the voltage of the exact inverse has to
come out of the chip's own filter. At tick k the filter must put out the voltage that the plant
needs one dead time and half a hold later, ``v = u(t + tau + T/2)``. The inverse of the filter's
difference equation gives the error that produces this voltage; the reference is the predicted
reading of the sensor plus that error. A reference holds for one reference tick, so each is
computed for the instant half a reference tick after it is due.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from threadline.arrays import FloatArray
from threadline.control.inverse import Followed, Motion, inverse_of
from threadline.control.lost_ticks import AHEAD, Levels
from threadline.control.preview import timing_of
from threadline.machine import Machine
from threadline.plant.values import Values


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FeedForward:
    """References for one axis, and what they ask of its drive.

    Parameters
    ----------
    reference_si
        (k,) position to command at each reference tick, m or rad, from ``start_s`` on.
    start_s
        Time of the first reference, on the clock of the motion: earlier than the start of the
        motion, since references act late.
    period_s
        Time from reference to reference.
    followed
        Load, sensor, voltage and current at each tick of the controller.
    peak_volts, peak_current_a
        Largest magnitudes at the controller's output and in the motor (None without a coil).
    volt_limit, current_limit_a
        Largest voltage of the DAC and current of the amplifier (infinite where it has no limit).
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
        """Name of the limit that the motion comes closest to: ``"current"`` or ``"voltage"``."""
        current = 0.0 if self.peak_current_a is None else self.peak_current_a / self.current_limit_a
        return "current" if current >= self.peak_volts / self.volt_limit else "voltage"


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
    """Return the references with which the loop of ``axis`` follows ``motion``.

    Parameters
    ----------
    motion
        Position of the load, m or rad, with as many derivatives as there are integrations from
        voltage to load (5 for a belt behind a motor with a coil).
    start_s, end_s
        The load rests before the one and after the other, on the clock of the motion.
    settle_s
        How long references go on after ``end_s``. By default until a swing inside the plant (of
        the frame, say) has decayed to a thousandth: the motor has to yield to it until then.
    model
        Numbers from which the inverse is made; those of ``machine`` when None.

    Raises
    ------
    MachineError
        If the axis or its filter has no stable inverse, or the controller generates its own
        positions (a ``ProfileController``).
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
    # Twice as fine as the ticks: the volts are wanted in the middle of a hold.
    count = int(np.ceil((end_s + settle_s + lead - begin) / tick)) + 2
    ticks: FloatArray = np.asarray(begin + tick * np.arange(count))
    sensed = inverse.follow(motion, ticks)
    driven = inverse.follow(motion, np.asarray(ticks + early))
    levels = Levels(digital.numerator, skips=controller.dac.zero_on_reversal)
    volts = levels.feed(np.append(driven.volts, np.repeat(driven.volts[-1:], AHEAD)))
    error = lfilter(digital.denominator, digital.numerator, volts)
    wanted = (sensed.measured_counts + error) / loop.counts_per_unit
    rows = int(np.floor((ticks[-1] - held - begin) / step)) + 1
    due = begin + step * np.arange(rows)
    limit = machine.drive_of(axis).amplifier.current_limit
    return FeedForward(
        reference_si=np.interp(due + held, ticks, wanted),
        start_s=begin,
        period_s=step,
        followed=driven,
        peak_volts=float(np.abs(driven.volts).max()),
        peak_current_a=None if driven.current_a is None else float(np.abs(driven.current_a).max()),
        volt_limit=controller.dac.range.si,
        current_limit_a=np.inf if limit is None else limit.si,
    )
