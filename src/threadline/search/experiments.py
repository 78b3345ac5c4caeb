"""Experiments on the simulated machine, done as on a real machine.

A stepped sine through the closed, quantised loop gives the motor's speed per volt. The actuator's
natural frequency, damping and dead time follow from it. Runs at constant speed give the gain.
Position steps show the size from which the current is limited.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np

from threadline.base.arrays import ComplexArray, FloatArray, IntArray
from threadline.dynamics.eccentric import rigid_motion
from threadline.dynamics.loop import axis_loop
from threadline.errors import OptionError
from threadline.files import Recording, Stream, TickBlock, TickTable
from threadline.machine import Machine
from threadline.twin import simulate

_PERIODS = 12
_CONSTANT_RUN_S = 0.6  # length of a run at constant speed
_SHORTEST_S = 0.25
_SETTLE_SHARE = 0.35
_SATURATED = 1.0 - 1e-6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sweep:
    """Measured speed of the motor per volt of the controller.

    Parameters
    ----------
    frequency_hz
        (k,) frequencies.
    response
        (k,) complex, axis units per second per volt.
    """

    frequency_hz: FloatArray
    response: ComplexArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Identified:
    """A second-order actuator with dead time, fitted to a sweep.

    Parameters
    ----------
    gain
        Axis units per second per volt, at zero frequency.
    natural_rad_s, damping, delay_s
        Natural frequency and damping from the magnitude, dead time from the phase.
    """

    gain: float
    natural_rad_s: float
    damping: float
    delay_s: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StepRun:
    """One position step.

    Parameters
    ----------
    size_si
        Size of the step, in axis units.
    peak_current_a
        Largest magnitude of the current.
    saturated
        Whether the current reached the amplifier's limit.
    rise_s
        Rise time from 10 to 90 % at the sensor.
    overshoot, load_overshoot
        Overshoot at the sensor and of the load, as shares of the step.
    load_si
        Rest position of the load.
    time_s
        (k,) times.
    share, load_share
        (k,) positions of the sensor and of the load as shares of the step.
    current_a
        (k,) largest magnitude since the previous sample.
    """

    size_si: float
    peak_current_a: float
    saturated: bool
    rise_s: float
    overshoot: float
    load_overshoot: float
    load_si: float
    time_s: FloatArray
    share: FloatArray
    load_share: FloatArray
    current_a: FloatArray


def at_filter_rate(machine: Machine) -> Machine:
    """Return ``machine`` with reference ticks at the rate of its controllers.

    A signal generator updates the reference of a real machine at the same rate.
    """
    return dataclasses.replace(
        machine,
        controllers={
            name: dataclasses.replace(controller, reference_clock=None)
            for name, controller in machine.controllers.items()
        },
    )


def stepped_sine(
    machine: Machine, axis: str, frequency_hz: FloatArray, amplitude_counts: float = 40.0
) -> Sweep:
    """Return the response measured by one sine after another through the closed loop.

    Parameters
    ----------
    frequency_hz
        (k,) frequencies below a quarter of the reference tick's rate.
    amplitude_counts
        Amplitude of the reference.

    Raises
    ------
    OptionError
        If a frequency is too high, or references are slower than the controller, so that its volts
        cannot be observed (``at_filter_rate`` speeds the references up).
    """
    index = _axis(machine, axis)
    controller = machine.controller_of(axis)
    if controller.reference_clock not in {None, controller.clock}:
        raise OptionError(
            f"axis {axis}: references come on the clock {controller.reference_clock!r}, slower "
            "than its controller",
            remedy="Remove reference_clock for this experiment.",
        )
    tick_s = float(machine.tick_clock.period_s)
    highest = float(np.max(frequency_hz))
    if highest > 0.25 / tick_s:
        raise OptionError(
            f"{highest:g} Hz is above a quarter of the tick rate, {0.25 / tick_s:g} Hz"
        )
    spans, sines = [], []
    begin = 0
    for hertz in frequency_hz:
        count = int(np.ceil(max(_PERIODS / hertz, _SHORTEST_S) / tick_s))
        spans.append((begin, begin + count))
        sines.append(amplitude_counts * np.sin(2 * np.pi * hertz * tick_s * np.arange(count)))
        begin += count
    recording = _simulate(machine, index, np.rint(np.concatenate(sines)).astype(np.int64))
    (_, volts), (_, measured) = _channels(recording, axis, "voltage", "measured")
    responses = []
    for hertz, (first, last) in zip(frequency_hz, spans, strict=True):
        steady = slice(first + int(_SETTLE_SHARE * (last - first)), last)
        omega_rad_s = 2 * np.pi * float(hertz)
        motion_phasor = _phasor(measured[steady], omega_rad_s * tick_s)
        # A sample is the value held over the previous tick: its centre is half a tick earlier.
        volts_phasor = _phasor(volts[steady], omega_rad_s * tick_s) * np.exp(
            0.5j * omega_rad_s * tick_s
        )
        volts_phasor *= np.sinc(0.5 * omega_rad_s * tick_s / np.pi)
        responses.append(1j * omega_rad_s * motion_phasor / volts_phasor)
    return Sweep(
        frequency_hz=np.asarray(frequency_hz, dtype=np.float64), response=np.array(responses)
    )


def identify(sweep: Sweep) -> Identified:
    """Return the second-order actuator with dead time that fits a sweep best.

    The magnitude gives gain, natural frequency and damping. The remaining phase, which falls in
    proportion to the frequency, gives the dead time.
    """
    from scipy.optimize import least_squares

    omega = 2 * np.pi * sweep.frequency_hz
    magnitude = np.abs(sweep.response)

    def model(p: FloatArray) -> ComplexArray:
        gain, natural, damping = np.exp(p)
        shape = natural**2 / (natural**2 - omega**2 + 2j * damping * natural * omega)
        return np.asarray(gain * shape)

    start = np.log(
        [magnitude[0], omega[int(np.argmin(np.abs(magnitude - 0.7 * magnitude[0])))], 0.7]
    )

    def log_errors(p: FloatArray) -> FloatArray:
        return np.asarray(np.log(np.abs(model(p)) / magnitude))

    fit = least_squares(log_errors, start, method="lm")
    gain, natural, damping = (float(v) for v in np.exp(fit.x))
    delay = dead_time_s(sweep, model(fit.x))
    return Identified(gain=gain, natural_rad_s=natural, damping=damping, delay_s=delay)


def dead_time_s(sweep: Sweep, without: ComplexArray) -> float:
    """Return the dead time of a sweep, s, from the (k,) response ``without`` dead time."""
    omega = 2 * np.pi * sweep.frequency_hz
    phase_left_rad = np.unwrap(np.angle(sweep.response / without))
    phase_left_rad -= 2 * np.pi * np.round(phase_left_rad[0] / (2 * np.pi))
    return -float(omega @ phase_left_rad) / float(omega @ omega)


def constant_speed_gain(machine: Machine, axis: str, speed_si: float) -> float:
    """Return speed over mean voltage at constant speed, axis units per second per volt.

    Raises
    ------
    OptionError
        If the speed is zero, or the axis does not exist.
    """
    index = _axis(machine, axis)
    if speed_si == 0:
        raise OptionError("a gain needs a speed other than 0")
    tick_s = float(machine.tick_clock.period_s)
    counts_per_tick = speed_si * machine.axes[axis].counts.si * tick_s
    ticks = int(np.ceil(_CONSTANT_RUN_S / tick_s))
    position = np.rint(counts_per_tick * np.arange(1, ticks + 1)).astype(np.int64)
    recording = _simulate(machine, index, position)
    (_, volts), (times, measured) = _channels(recording, axis, "voltage", "measured")
    steady = slice(ticks // 2, ticks)
    speed = float(np.polyfit(times[steady], measured[steady], 1)[0])
    return speed / float(np.mean(volts[steady]))


def position_step(machine: Machine, axis: str, size_si: float, run_s: float = 0.8) -> StepRun:
    """Return the response to a position step of ``size_si`` (axis units)."""
    index = _axis(machine, axis)
    counts = round(size_si * machine.axes[axis].counts.si)
    if counts == 0:
        raise OptionError(f"a step of {size_si:g} is less than a count")
    tick_s = float(machine.tick_clock.period_s)
    position = np.full(int(np.ceil(run_s / tick_s)), counts, dtype=np.int64)
    recording = _simulate(machine, index, position)
    (times, measured), (_, load), (_, current) = _channels(
        recording, axis, "measured", "load", "current_peak"
    )
    amplifier = machine.drive_of(axis).amplifier
    peak = float(np.abs(current).max())
    size = counts / machine.axes[axis].counts.si
    share = measured / size
    time_10_s, time_90_s = (float(times[int(np.argmax(share >= level))]) for level in (0.1, 0.9))
    limit = amplifier.current_limit
    return StepRun(
        size_si=size,
        peak_current_a=peak,
        saturated=limit is not None and peak >= _SATURATED * limit.si,
        rise_s=time_90_s - time_10_s,
        overshoot=max(0.0, float(share.max()) - 1.0),
        load_overshoot=max(0.0, float((load / size).max()) - 1.0),
        load_si=float(load[-1]),
        time_s=times,
        share=np.asarray(share),
        load_share=np.asarray(load / size),
        current_a=np.abs(current),
    )


def _axis(machine: Machine, axis: str) -> int:
    if axis not in machine.axes:
        raise OptionError(
            f"machine {machine.name!r} has no axis {axis!r}",
            remedy=f"It has: {', '.join(machine.axes)}.",
        )
    return machine.axis_names.index(axis)


def _channels(
    recording: Recording, axis: str, *kinds: str
) -> tuple[tuple[FloatArray, FloatArray], ...]:
    """Return times in s and values of channels of an axis."""
    names = [f"{axis}.{kind}" for kind in kinds]
    samples = recording.samples_of(names)
    return tuple(samples[name] for name in names)


def _simulate(machine: Machine, index: int, position: IntArray) -> Recording:
    """Simulate references in counts from rest, with the other axes at rest."""
    counts = np.zeros((len(position), len(machine.axes)), dtype=np.int64)
    counts[:, index] = np.diff(position, prepend=0)
    commands = TickTable(
        clock=machine.tick_clock,
        axes=machine.axis_names,
        counts_per_unit=machine.counts_per_unit,
        start_counts=np.zeros(len(machine.axes), dtype=np.int64),
        blocks=Stream.of(
            [
                TickBlock(
                    first_tick=0, counts=counts, operation=np.zeros(len(counts), dtype=np.int64)
                )
            ]
        ),
        job_sha256="experiment",
        machine_sha256=machine.sha256,
    )
    return simulate(commands, machine, settle_s=0.1)


def _phasor(values: FloatArray, angle: float) -> complex:
    """Return the complex amplitude of a sine in ``values``; offset and drift are fitted, too."""
    turns = angle * np.arange(len(values))
    ramp = np.linspace(-1.0, 1.0, len(values))
    basis = np.stack([np.cos(turns), -np.sin(turns), np.ones(len(values)), ramp], axis=1)
    fit = np.linalg.lstsq(basis, values, rcond=None)[0]
    return complex(fit[0], fit[1])


_FREQUENCIES = 40
_HIGHEST_HZ = 200.0
_SWEEP_COUNTS = 60.0
_RUN_RAD_S = 20.0
_STEPS_EIGHTH_PI = (1, 2, 3, 4, 5, 6, 8, 16, 32, 64, -2, -3, -4, -6)
"""Sizes of the steps in eighths of pi at the motor; a slack belt responds differently by
direction."""
_RUN_S = 0.8
_LONG_RUN_S = 3.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Campaign:
    """Results of the experiments on an axis, in terms of its motor's shaft.

    Parameters
    ----------
    axis
        Name of the axis.
    gain
        Speed per volt at constant speed, rad/s/V.
    delay_s
        Dead time from the phase of the sweep.
    fitted
        Second-order actuator, where the motor alone is on the axis; its gain in rad/s/V.
    steps
        Step sizes in rad of the motor, each with its result.
    """

    axis: str
    gain: float
    delay_s: float
    fitted: Identified | None
    steps: tuple[tuple[float, StepRun], ...]

    @property
    def saturates_from_rad(self) -> float | None:
        """Smallest tried step that reached the current limit."""
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
        If a step of an eighth of pi at the motor is less than an encoder count.
    """
    rates = rigid_motion(machine, axis)
    drive = machine.drive_of(axis)
    # Radians of the motor per unit of the axis.
    ratio = abs(sum(q.si * rates[b] for b, q in drive.acts_on.items()))
    fast_machine = at_filter_rate(machine)
    highest_hz = min(_HIGHEST_HZ, 0.2 / float(fast_machine.tick_clock.period_s))
    sweep = stepped_sine(
        fast_machine, axis, np.geomspace(1.0, highest_hz, _FREQUENCIES), _SWEEP_COUNTS
    )
    fitted = identify(sweep) if not machine.links and drive.inductance is not None else None
    if fitted is not None:
        delay_s = fitted.delay_s
        fitted = Identified(
            gain=fitted.gain * ratio,
            natural_rad_s=fitted.natural_rad_s,
            damping=fitted.damping,
            delay_s=delay_s,
        )
    else:
        plant = axis_loop(machine, axis).axis_plant()
        omega = 2 * np.pi * sweep.frequency_hz
        delay_factor = np.exp(1j * omega * plant.delay_s[0])
        delay_s = dead_time_s(sweep, 1j * omega * plant.response(omega)[:, 0, 0] * delay_factor)
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
        gain=constant_speed_gain(fast_machine, axis, speed) * ratio,
        delay_s=delay_s,
        fitted=fitted,
        steps=steps,
    )
