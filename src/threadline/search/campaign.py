"""The stitcher thesis's campaign of experiments on one axis: sweep, constant speed, steps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from threadline.machine import Machine
from threadline.plant.loop import axis_loop
from threadline.plant.rigid import rigid_motion
from threadline.search.experiments import (
    Identified,
    StepRun,
    at_filter_rate,
    constant_speed_gain,
    dead_time_s,
    identify,
    position_step,
    stepped_sine,
)

_FREQUENCIES = 40
_HIGHEST_HZ = 200.0
_SWEEP_COUNTS = 60.0
_RUN_RAD_S = 20.0
_STEPS_EIGHTH_PI = (1, 2, 3, 4, 5, 6, 8, 16, 32, 64, -2, -3, -4, -6)
"""Steps in both senses, because a belt that falls slack answers differently in each."""
_RUN_S = 0.8
_LONG_RUN_S = 3.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Campaign:
    """What the experiments on an axis found, in terms of its motor's shaft.

    Parameters
    ----------
    axis
        Its name.
    gain
        Speed per volt at constant speed, rad/s/V.
    delay_s
        Dead time from the phase of the sweep.
    fitted
        Second-order actuator, where nothing but the motor is on the axis; its gain in rad/s/V.
    steps
        Size in rad of the motor and what came of it.
    """

    axis: str
    gain: float
    delay_s: float
    fitted: Identified | None
    steps: tuple[tuple[float, StepRun], ...]

    @property
    def saturates_from_rad(self) -> float | None:
        """Smallest step tried that reached the current limit."""
        return min((abs(size) for size, run in self.steps if run.saturated), default=None)

    def as_json(self) -> dict[str, Any]:
        """Return the campaign as JSON content."""
        fitted = self.fitted
        return {
            "gain_rad_s_v": self.gain,
            "delay_s": self.delay_s,
            "natural_rad_s": None if fitted is None else fitted.natural_rad_s,
            "damping": None if fitted is None else fitted.damping,
            "saturates_from_rad": self.saturates_from_rad,
            "steps": [
                {
                    "motor_rad": size,
                    "load": run.load_si,
                    "peak_current_a": run.peak_current_a,
                    "saturated": run.saturated,
                    "rise_s": run.rise_s,
                    "overshoot": run.overshoot,
                    "load_overshoot": run.load_overshoot,
                }
                for size, run in self.steps
            ],
        }

    def summary(self) -> str:
        """Return one line on gain, dead time and saturation."""
        onset = self.saturates_from_rad
        limit = "no step saturates" if onset is None else f"saturates from {onset:.3f} rad on"
        second = (
            ""
            if self.fitted is None
            else f"{self.fitted.natural_rad_s:.1f} rad/s, damping {self.fitted.damping:.3f}, "
        )
        return (
            f"axis {self.axis}, simulated and quantised: {second}{self.gain:.2f} rad/s/V, dead "
            f"time {self.delay_s * 1e3:.3f} ms, {limit}"
        )

    def table(self) -> tuple[str, list[str], list[list[str]]]:
        """Return title, header and rows of the steps."""
        header = ["motor rad", "load", "peak A", "limited", "rise ms", "overshoot %", "load %"]
        rows = [
            [
                f"{size:.4f}",
                f"{run.load_si:.6f}",
                f"{run.peak_current_a:.2f}",
                "yes" if run.saturated else "no",
                f"{run.rise_s * 1e3:.1f}",
                f"{run.overshoot * 100:.1f}",
                f"{run.load_overshoot * 100:.1f}",
            ]
            for size, run in self.steps
        ]
        return f"Steps of axis {self.axis} on the simulated machine", header, rows


def run_experiments(machine: Machine, axis: str) -> Campaign:
    """Sweep, run and step one axis of the simulated machine.

    Raises
    ------
    OptionError
        If a step of an eighth of pi at the motor is less than a count of the encoder.
    """
    rates = rigid_motion(machine, axis)
    drive = machine.drive_of(axis)
    # Radians of the motor per unit of the axis.
    ratio = abs(sum(q.si * rates[b] for b, q in drive.acts_on.items()))
    fast = at_filter_rate(machine)
    highest = min(_HIGHEST_HZ, 0.2 / float(fast.tick_clock.period_s))
    sweep = stepped_sine(fast, axis, np.geomspace(1.0, highest, _FREQUENCIES), _SWEEP_COUNTS)
    found = identify(sweep) if not machine.links and drive.inductance is not None else None
    if found is not None:
        delay = found.delay_s
        found = Identified(
            gain=found.gain * ratio,
            natural_rad_s=found.natural_rad_s,
            damping=found.damping,
            delay_s=delay,
        )
    else:
        own = axis_loop(machine, axis).own()
        omega = 2 * np.pi * sweep.frequency_hz
        late = np.exp(1j * omega * own.delay_s[0])
        delay = dead_time_s(sweep, 1j * omega * own.response(omega)[:, 0, 0] * late)
    steps = tuple(
        (
            k * np.pi / 8,
            position_step(machine, axis, k * np.pi / 8 / ratio, _LONG_RUN_S if k > 16 else _RUN_S),
        )
        for k in _STEPS_EIGHTH_PI
    )
    speed = _RUN_RAD_S / ratio
    return Campaign(
        axis=axis,
        gain=constant_speed_gain(fast, axis, speed) * ratio,
        delay_s=delay,
        fitted=found,
        steps=steps,
    )
