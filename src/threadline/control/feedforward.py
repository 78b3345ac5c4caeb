"""References that make the loop as it is follow a motion with its load.

No hardware changes: the motion chip takes references only, so the volts of the exact inverse go
in through its own filter. At tick k the filter shall put out what the plant needs one dead time
and half a hold later, ``v = u(t + tau + T/2)``; the error that makes it do so comes from the
inverse of its difference equation, and the reference is that error on top of what the sensor will
read. References change only every reference tick: they are taken half of one ahead.
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
    """A motion prepared for one axis.

    Parameters
    ----------
    reference_si
        (k,) position to command at each reference tick, m or rad, from ``start_s`` on.
    start_s
        When the first is due, on the clock of the motion; before the motion starts, by the
        preview.
    period_s
        Reference tick.
    followed
        What the axis does, tick by tick of its controller.
    peak_volts, peak_current_a
        Largest magnitudes at the controller's output and in the motor (None without a coil).
    volt_limit, current_limit_a
        What the DAC and the amplifier have; infinite where there is no limit.
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
        """Whether the machine has the volts and amperes that the motion needs."""
        current = self.peak_current_a is None or self.peak_current_a <= self.current_limit_a
        return current and self.peak_volts <= self.volt_limit

    @property
    def bound_by(self) -> str:
        """Which limit is used most: ``"current"`` or ``"voltage"``."""
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
        Of the load, m or rad, at rest outside ``start_s .. end_s``, with as many derivatives as
        the axis has integrations (5 for a belt behind a motor with a coil).
    settle_s
        How long to go on after its end; by default until what swings inside the plant (a frame)
        has decayed to a thousandth, since the motor must give way to it until then.
    model
        The numbers that the inverse believes in; the machine's own when None.

    Raises
    ------
    MachineError
        If the axis or its filter has no stable inverse, or the filter makes its positions itself.
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
