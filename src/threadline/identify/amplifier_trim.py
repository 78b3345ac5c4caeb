"""Trim the gains of servo amplifiers: the same speed for the same volts on every axis.

The winder thesis set the potentiometers of its amplifiers by hand: a voltage was typed at the
keyboard and the speed was watched. Here each axis runs to and fro at four constant speeds in its
loop. Friction and an offset of the amplifier need volts that do not depend on the speed; ``V = v/G
+ f sign(v) + c`` separates them from the gain G. The volts of the same commands on the simulated
machine of the file are subtracted, so that the remaining transients cancel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.dynamics.loop import axis_loop
from threadline.errors import LinkFaultError, OptionError, RecordingError
from threadline.files import Recording, RunEnd
from threadline.files.recording import columns_of
from threadline.identify.experiment_run import measure, predict
from threadline.identify.planned_experiment import Experiment, experiment
from threadline.machine import Machine
from threadline.twin.simulate import simulate

_TRAVEL = 0.15  # amplitude as a share of the travel
_TURN = 4.0 * np.pi  # amplitude of an endless axis, rad
_SPEEDS = (0.15, 0.35, 0.7, 1.0)  # shares of the fastest
_FASTEST = 0.3  # share of the speed limit
_STRETCH_S = 0.5  # least duration of the way to one side
_STEADY_SHARE = 0.5  # share of a stretch of constant speed that is used, at its end
_LEAST_TICKS = 24
_SPEEDS_AT_LEAST = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class AxisTrim:
    """The gain of the amplifier of one axis.

    Parameters
    ----------
    axis, drive
        Names of the axis and of its drive.
    speed_per_volt, wanted
        Counts per second and volt of the controller: measured, and by the machine file.
    interval
        Relative half width of the 95 % interval of ``speed_per_volt``.
    """

    axis: str
    drive: str
    speed_per_volt: float
    wanted: float
    interval: float

    @property
    def factor(self) -> float:
        """Factor by which the potentiometer must change the gain."""
        return self.wanted / self.speed_per_volt


def trim(
    machine: Machine,
    axes: Sequence[str] = (),
    *,
    link: str = "sim",
    actual: Machine | None = None,
    amplitude: float | None = None,
) -> tuple[AxisTrim, ...]:
    """Run axes at constant speeds over a link; return how far their amplifiers are off.

    Parameters
    ----------
    axes
        Names of axes; empty: all axes with a control loop.
    link, actual
        See ``measure``.
    amplitude
        Largest deviation from the start, m or rad; by default 15 % of the travel, and two turns of
        an endless axis.

    Raises
    ------
    OptionError
        If there is no such axis, it has no loop, or its volts are not recorded at every tick.
    LimitError
        If a run would leave the travel, or reach the speed or the current limit; nothing has moved.
    LinkFaultError
        If a run ended early.
    RecordingError
        If the volts do not grow with the speed, positions or volts are missing, or the axis is
        steady at fewer than four speeds.
    """
    names = list(axes) or [name for name, axis_run in machine.axes.items() if axis_run.controller]
    if not names:
        raise OptionError(
            f"machine {machine.name!r} has no control loops", remedy="It has nothing to trim."
        )
    planned = [_runs(machine, name, amplitude) for name in names]
    for name in names:
        controller = machine.controller_of(name)
        if machine.clock(controller.clock).period_s != machine.tick_clock.period_s:
            raise OptionError(
                f"axis {name}: its controller runs faster than its references, so its volts are "
                "seen at some of its ticks only",
                remedy=f"Fit drives.{controller.drive}.amplifier.gain to a sweep.",
            )
    for axis_run in planned:
        predict(machine, axis_run)
    trims = []
    for axis_run in planned:
        wanted = _steady_gain(machine, axis_run.axis)
        predicted = _stretches(machine, axis_run, simulate(axis_run.commands, machine))
        measurement = measure(machine, axis_run, link=link, actual=actual)
        if measurement.ended is not RunEnd.COMPLETED:
            raise LinkFaultError(f"the run of axis {axis_run.axis} ended early: {measurement.why}")
        slope, spread = _slope(_stretches(machine, axis_run, measurement.recording), predicted)
        slope += 1.0 / wanted
        if slope <= 2.0 * spread:
            raise RecordingError(
                f"axis {axis_run.axis} needs no more volts at a higher speed",
                remedy="Give a larger --amplitude.",
            )
        trims.append(
            AxisTrim(
                axis=axis_run.axis,
                drive=machine.controller_of(axis_run.axis).drive,
                speed_per_volt=1.0 / slope,
                wanted=wanted,
                interval=2.0 * spread / slope,
            )
        )
    return tuple(trims)


def _runs(machine: Machine, axis: str, amplitude: float | None) -> Experiment:
    """Return the runs of an axis, slow enough to be steady on the way."""
    if axis not in machine.axes or amplitude is not None:
        amplitude_si = amplitude
    elif (travel := machine.axes[axis].travel) is None:
        amplitude_si = _TURN
    else:  # the runs go both ways from the start
        low, high = (end.si for end in travel)
        amplitude_si = min(_TRAVEL * (high - low), 0.8 * high, -0.8 * low)
    fastest = _FASTEST
    if axis in machine.axes and amplitude_si is not None:
        fastest = min(_FASTEST, amplitude_si / _STRETCH_S / machine.axes[axis].velocity.si)
    speeds = [share * fastest for share in _SPEEDS]
    return experiment(machine, axis, "constant", amplitude=amplitude_si, speeds=speeds)


def _steady_gain(machine: Machine, axis: str) -> float:
    """Return the steady counts per second per volt by the linear model."""
    omega = np.array([1e-6])
    return float(np.abs(axis_loop(machine, axis).axis_plant().response(omega)).ravel()[0] * 1e-6)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Stretches:
    """Runs at constant speeds: (n,) counts per second, mean volts, and numbers of ticks."""

    speed: FloatArray
    volts: FloatArray
    ticks: FloatArray


def _stretches(machine: Machine, planned: Experiment, recording: Recording) -> _Stretches:
    """Return the stretches of a recording at constant speeds.

    Raises
    ------
    RecordingError
        If fewer than four are long enough to be steady, or positions or volts are missing.
    """
    axis = planned.axis
    columns = {name.partition(" ")[0]: v for name, v in columns_of(recording).items()}
    counts = machine.axes[axis].counts.si
    try:
        commanded, position = (
            columns[f"{axis}.{channel_kind}"] * counts for channel_kind in ("commanded", "measured")
        )
        volts = columns[f"{axis}.voltage"]
    except KeyError as missing:
        raise RecordingError(
            f"it has no channel {missing.args[0]}", remedy="Trim over a link that reports it."
        ) from missing
    tick_s = float(machine.tick_clock.period_s)
    stretches = [
        (
            (position[last] - position[first]) / ((last - first) * tick_s),
            volts[first + 1 : last + 1].mean(),
            last - first,
        )
        for first, last in _steady(commanded)
    ]
    if len(stretches) < _SPEEDS_AT_LEAST:
        raise RecordingError(
            f"axis {axis} is steady at {len(stretches)} speeds, and the gain needs "
            f"{_SPEEDS_AT_LEAST}",
            remedy="Give a larger --amplitude.",
        )
    speed, mean, ticks = np.array(stretches, dtype=np.float64).T
    return _Stretches(speed=speed, volts=mean, ticks=ticks)


def _slope(measured: _Stretches, predicted: _Stretches) -> tuple[float, float]:
    """Return the difference of two slopes of volts over speed, and its deviation.

    The stretches have the same commands, so both have the same remaining transients.
    """
    v, weight = measured.speed, np.sqrt(measured.ticks)
    basis = np.stack([v, np.sign(v), np.ones(len(v))], axis=1) * weight[:, None]
    volts_apart = (measured.volts - predicted.volts) * weight
    solution, *_ = np.linalg.lstsq(basis, volts_apart, rcond=None)
    residual = volts_apart - basis @ solution
    variance = residual @ residual / max(len(v) - 3, 1) * np.linalg.inv(basis.T @ basis)[0, 0]
    return float(solution[0]), float(np.sqrt(variance))


def _steady(commanded: FloatArray) -> list[tuple[int, int]]:
    """Return the later halves of the stretches with one commanded speed, as sample numbers."""
    speed = np.diff(commanded)
    is_even = np.abs(speed[1:] - speed[:-1]) <= 1.0 + 1e-6  # rounded to counts
    # A slow ramp changes by less than a count as well, so a stretch keeps its first speed.
    stretches, first = [], 0
    total = np.concatenate(([0.0], np.cumsum(speed)))
    for k in range(1, len(speed) + 1):
        continues = k < len(speed) and bool(is_even[k - 1])
        if continues:
            mean = (total[k] - total[first]) / (k - first)
            continues = abs(speed[k] - mean) <= 1.0 + 1e-6
        if continues:
            continue
        length = k - first
        start = first + round((1.0 - _STEADY_SHARE) * length)
        if length >= _LEAST_TICKS and abs(total[k] - total[first]) > length * 0.5:
            stretches.append((start, k))
        first = k
    return stretches
