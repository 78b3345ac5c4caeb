"""Experiments on the simulated machine, as one would do them on the real one.

A stepped sine through the closed, quantised loop gives the motor's speed per volt, and from it
the actuator's natural frequency, damping and dead time; runs at constant speed give its gain;
position steps show from which size on the current is limited.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from threadline.arrays import ComplexArray, FloatArray, IntArray
from threadline.errors import OptionError
from threadline.machine import Machine
from threadline.signals import Recording, Stream, TickBlock, TickTable
from threadline.twin import simulate

_PERIODS = 12
_SHORTEST_S = 0.25
_SETTLE_SHARE = 0.35
_SATURATED = 1.0 - 1e-6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sweep:
    """Speed of the motor per volt of the controller, measured.

    Parameters
    ----------
    frequency_hz
        (k,).
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
        From magnitude (the first two) and phase (the dead time).
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
        In axis units.
    peak_current_a
        Largest magnitude of the current.
    saturated
        Whether it reached the amplifier's limit.
    rise_s
        From 10 to 90 % at the sensor.
    overshoot, load_overshoot
        Shares of the step, at the sensor and of the load.
    load_si
        Where the load came to rest.
    time_s
        (k,).
    share, load_share
        (k,) positions of the sensor and of the load as shares of the step.
    current_a
        (k,) largest magnitude since the sample before.
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
    """Return ``machine`` with references as fast as its controllers, as a generator gives them."""
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
    """Return the response measured by one sine after the other through the closed loop.

    Parameters
    ----------
    frequency_hz
        (k,) below a quarter of the reference tick's rate.
    amplitude_counts
        Of the reference.

    Raises
    ------
    OptionError
        If a frequency is too high, or references are slower than the controller, whose volts
        could then not be seen (``at_filter_rate`` speeds them up).
    """
    index = _axis(machine, axis)
    controller = machine.controller_of(axis)
    if controller.reference_clock not in {None, controller.clock}:
        raise OptionError(
            f"axis {axis}: references come on the clock {controller.reference_clock!r}, slower "
            "than its controller",
            remedy="Take away reference_clock for this experiment.",
        )
    tick = float(machine.tick_clock.period_s)
    highest = float(np.max(frequency_hz))
    if highest > 0.25 / tick:
        raise OptionError(f"{highest:g} Hz is above a quarter of the tick rate, {0.25 / tick:g} Hz")
    spans, parts = [], []
    at = 0
    for hertz in frequency_hz:
        count = int(np.ceil(max(_PERIODS / hertz, _SHORTEST_S) / tick))
        spans.append((at, at + count))
        parts.append(amplitude_counts * np.sin(2 * np.pi * hertz * tick * np.arange(count)))
        at += count
    recording = _simulate(machine, index, np.rint(np.concatenate(parts)).astype(np.int64))
    _, volts = recording.samples(f"{axis}.voltage")
    _, measured = recording.samples(f"{axis}.measured")
    answers = []
    for hertz, (first, last) in zip(frequency_hz, spans, strict=True):
        kept = slice(first + int(_SETTLE_SHARE * (last - first)), last)
        omega = 2 * np.pi * float(hertz)
        moved = _phasor(measured[kept], omega * tick)
        # A sample is what was held over the tick before it: centred half a tick earlier.
        held = _phasor(volts[kept], omega * tick) * np.exp(0.5j * omega * tick)
        held *= np.sinc(0.5 * omega * tick / np.pi)
        answers.append(1j * omega * moved / held)
    return Sweep(
        frequency_hz=np.asarray(frequency_hz, dtype=np.float64), response=np.array(answers)
    )


def identify(sweep: Sweep) -> Identified:
    """Return the second-order actuator with dead time that fits a sweep best.

    Magnitude gives gain, natural frequency and damping; the phase that is left over, which must
    fall in proportion to the frequency, gives the dead time.
    """
    from scipy.optimize import least_squares

    omega = 2 * np.pi * sweep.frequency_hz
    size = np.abs(sweep.response)

    def model(p: FloatArray) -> ComplexArray:
        gain, natural, damping = np.exp(p)
        shape = natural**2 / (natural**2 - omega**2 + 2j * damping * natural * omega)
        return np.asarray(gain * shape)

    start = np.log([size[0], omega[int(np.argmin(np.abs(size - 0.7 * size[0])))], 0.7])

    def miss(p: FloatArray) -> FloatArray:
        return np.asarray(np.log(np.abs(model(p)) / size))

    fit = least_squares(miss, start, method="lm")
    gain, natural, damping = (float(v) for v in np.exp(fit.x))
    delay = dead_time_s(sweep, model(fit.x))
    return Identified(gain=gain, natural_rad_s=natural, damping=damping, delay_s=delay)


def dead_time_s(sweep: Sweep, without: ComplexArray) -> float:
    """Return the dead time by which a sweep lags behind the (k,) response ``without`` one."""
    omega = 2 * np.pi * sweep.frequency_hz
    left = np.unwrap(np.angle(sweep.response / without))
    left -= 2 * np.pi * np.round(left[0] / (2 * np.pi))
    return -float(omega @ left) / float(omega @ omega)


def constant_speed_gain(machine: Machine, axis: str, speed_si: float, run_s: float = 0.6) -> float:
    """Return speed per mean volt at a constant speed, axis units per second per volt.

    Raises
    ------
    OptionError
        If the speed is zero or there is no such axis.
    """
    index = _axis(machine, axis)
    if speed_si == 0:
        raise OptionError("a gain needs a speed other than 0")
    tick = float(machine.tick_clock.period_s)
    counts = speed_si * machine.axes[axis].counts.si * tick
    ticks = int(np.ceil(run_s / tick))
    position = np.rint(counts * np.arange(1, ticks + 1)).astype(np.int64)
    recording = _simulate(machine, index, position)
    _, volts = recording.samples(f"{axis}.voltage")
    times, measured = recording.samples(f"{axis}.measured")
    kept = slice(ticks // 2, ticks)
    speed = float(np.polyfit(times[kept], measured[kept], 1)[0])
    return speed / float(np.mean(volts[kept]))


def position_step(machine: Machine, axis: str, size_si: float, run_s: float = 0.8) -> StepRun:
    """Return what a position step of ``size_si`` (axis units) does."""
    index = _axis(machine, axis)
    counts = round(size_si * machine.axes[axis].counts.si)
    if counts == 0:
        raise OptionError(f"a step of {size_si:g} is less than a count")
    tick = float(machine.tick_clock.period_s)
    position = np.full(int(np.ceil(run_s / tick)), counts, dtype=np.int64)
    recording = _simulate(machine, index, position)
    times, measured = recording.samples(f"{axis}.measured")
    _, load = recording.samples(f"{axis}.load")
    _, current = recording.samples(f"{axis}.current_peak")
    amplifier = machine.drive_of(axis).amplifier
    peak = float(np.abs(current).max())
    size = counts / machine.axes[axis].counts.si
    share = measured / size
    low, high = (float(times[int(np.argmax(share >= level))]) for level in (0.1, 0.9))
    limit = amplifier.current_limit
    return StepRun(
        size_si=size,
        peak_current_a=peak,
        saturated=limit is not None and peak >= _SATURATED * limit.si,
        rise_s=high - low,
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


def _simulate(machine: Machine, index: int, position: IntArray) -> Recording:
    """Simulate references in counts from rest; the other axes stand still."""
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
    """Return the complex amplitude of a sine in ``values``, offset and drift fitted along."""
    turns = angle * np.arange(len(values))
    ramp = np.linspace(-1.0, 1.0, len(values))
    basis = np.stack([np.cos(turns), -np.sin(turns), np.ones(len(values)), ramp], axis=1)
    fit = np.linalg.lstsq(basis, values, rcond=None)[0]
    return complex(fit[0], fit[1])
