"""Measured frequency responses, and the model's response to compare them with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import ComplexArray, FloatArray
from threadline.base.wording import nearest
from threadline.dynamics.linear_model import linear_variants
from threadline.dynamics.loop import Loop
from threadline.dynamics.responses import speed_response
from threadline.dynamics.values import Values
from threadline.errors import OptionError, Place, RecordingError
from threadline.machine import Machine
from threadline.machine.parts import Encoder

LEAST_COHERENCE = 0.8
"""Points below this coherence are left out of a fit."""
OUTPUTS = tuple(
    f"{base}{rate}" for base in ("rad", "m", "count", "V") for rate in ("", "/s", "/s^2")
)
"""Units of an output; a response has one of these units per volt."""
_MAGNITUDES, _FREQUENCIES_HZ = (1e-100, 1e100), (1e-6, 1e9)
MOTOR = "motor"
"""Output of a response: the body that the axis' encoder reads."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MeasuredResponse:
    """A frequency response from the controller's voltage of an axis to one output.

    Parameters
    ----------
    frequency_hz
        (k,) increasing.
    value
        (k,) complex, in ``unit``.
    coherence
        (k,) in 0 to 1; None if it was not measured.
    unit
        SI unit of the output, such as ``"rad/s"``, for a response per volt; empty if the magnitude
        has an unknown reference, so that only its shape is known.
    axis, output
        The axis, and the measured output: ``"sensors.x_pot"``, ``"X.load"``, ``"motor"``; empty if
        the file does not say.
    place
        The file, for messages.
    """

    frequency_hz: FloatArray
    value: ComplexArray
    coherence: FloatArray | None
    unit: str
    axis: str = ""
    output: str = ""
    place: Place | None = None

    @property
    def absolute(self) -> bool:
        """Whether the magnitude has a unit."""
        return bool(self.unit)

    @property
    def magnitude_db(self) -> FloatArray:
        """(k,) magnitude in dB."""
        return np.asarray(20.0 * np.log10(np.abs(self.value)))

    @property
    def phase_deg(self) -> FloatArray:
        """(k,) phase in degrees, unwrapped."""
        return np.asarray(np.degrees(np.unwrap(np.angle(self.value))))

    def against(self, loop: Loop) -> tuple[float, float]:
        """Return the root mean square differences from a model's motor speed, in dB and degrees.

        Magnitudes are compared relative to the first point.

        Raises
        ------
        OptionError
            If the response is not of the motor's speed.
        """
        base, rates = _unit(self)
        if rates != 1 or base not in {"", "rad", "count"} or self.output not in {"", MOTOR}:
            raise OptionError(
                f"the response is of {self.output or self.unit}, not of the motor's speed",
                place=self.place,
                remedy="threadline fit compares any output.",
            )
        magnitude, phase = speed_response(loop, 2 * np.pi * self.frequency_hz)
        level = magnitude - magnitude[0] + self.magnitude_db[0]
        turn = (phase - self.phase_deg + 180.0) % 360.0 - 180.0
        return (
            float(np.sqrt(np.mean((level - self.magnitude_db) ** 2))),
            float(np.sqrt(np.mean(turn**2))),
        )


def check_response(measured: MeasuredResponse) -> None:
    """Refuse a response whose points cannot be compared with a model.

    Raises
    ------
    RecordingError
        If there are no points, frequencies do not increase or lie outside 1e-6 to 1e9 Hz,
        magnitudes lie outside 1e-100 to 1e100, or a coherence is not from 0 to 1.
    """
    hertz, magnitude, coherence = measured.frequency_hz, np.abs(measured.value), measured.coherence
    fault, remedy = "", "Remove or correct the points."
    if not len(hertz):
        fault, remedy = "the response has no points", "Measure again."
    elif (np.diff(hertz) <= 0.0).any():
        row = int(np.argmax(np.diff(hertz) <= 0.0)) + 1
        fault, remedy = f"frequency {hertz[row]:g} Hz does not increase", "Sort the points."
    elif not _FREQUENCIES_HZ[0] <= hertz[0] <= hertz[-1] <= _FREQUENCIES_HZ[1]:
        odd_value = hertz[0] if hertz[0] < _FREQUENCIES_HZ[0] else hertz[-1]
        fault = f"frequency {odd_value:g} Hz is not from 1e-06 to 1e+09 Hz"
    elif not (magnitude.min() >= _MAGNITUDES[0] and magnitude.max() <= _MAGNITUDES[1]):
        outside = ~((magnitude >= _MAGNITUDES[0]) & (magnitude <= _MAGNITUDES[1]))
        row = int(np.argmax(outside))
        fault = f"magnitude {magnitude[row]:g} at {hertz[row]:g} Hz is not from 1e-100 to 1e+100"
    elif coherence is not None and not ((coherence >= 0.0) & (coherence <= 1.0)).all():
        odd_value = coherence[int(np.argmax(np.abs(coherence - 0.5)))]
        fault, remedy = (
            f"coherence {odd_value:g} is not from 0 to 1",
            "Correct the column, or remove it.",
        )
    if fault:
        raise RecordingError(fault, place=measured.place, remedy=remedy)


_RATES = {"": 0, "/s": 1, "/s^2": 2}


@dataclass(frozen=True, slots=True, kw_only=True)
class Path:
    """The path of the linear model that is compared with a measured response.

    Parameters
    ----------
    drive, output
        Input and output of the linear model.
    scale
        Factor from the model's output to the unit of the response.
    rates
        Number of derivatives: 1 for a speed.
    """

    drive: str
    output: str
    scale: float
    rates: int


def path_of(machine: Machine, measured: MeasuredResponse, axis: str = "") -> Path:
    """Return the path of a machine's linear model along which a response was measured.

    Parameters
    ----------
    axis
        The axis, if the file does not name it.

    Raises
    ------
    OptionError
        If the axis or its output does not exist, or is not named.
    RecordingError
        If the unit is not the unit of the output.
    """
    axis = _axis(machine, measured, axis)
    controller = machine.controller_of(axis)
    base, rates = _unit(measured)
    output = measured.output or _usual_output(machine, axis, base)
    scale = 1.0
    if output == MOTOR:
        sensor = machine.sensors[controller.sensor]
        if len(sensor.reads) != 1:
            raise OptionError(
                f"sensors.{controller.sensor} reads several bodies, so axis {axis} has no motor "
                "angle",
                place=measured.place,
                remedy="Name the output in the file: '# output: sensors.NAME'.",
            )
        (reads,) = sensor.reads.values()
        unit = reads.unit.removeprefix("count/")
        output, scale = f"sensors.{controller.sensor}", 1.0 / reads.si
    else:
        unit = _unit_of(machine, axis, output, measured)
    if measured.absolute and base != unit:
        raise RecordingError(
            f"the response is in {measured.unit} per volt, but {output} is in {unit}",
            place=measured.place,
            remedy=f"Write it in {unit}/V, {unit}/s/V or {unit}/s^2/V, or name another output.",
        )
    return Path(drive=f"drives.{controller.drive}", output=output, scale=scale, rates=rates)


def _axis(machine: Machine, measured: MeasuredResponse, axis: str) -> str:
    axis_name = measured.axis or axis
    controlled = [name for name, axis_part in machine.axes.items() if axis_part.controller]
    if not axis_name and len(controlled) == 1:
        return controlled[0]
    if not axis_name:
        raise OptionError(
            f"the response does not name its axis, and {machine.name} has {', '.join(controlled)}",
            place=measured.place,
            remedy="Name it with --axis.",
        )
    if axis_name not in controlled:
        raise OptionError(
            f"machine {machine.name!r} has no axis {axis_name!r} with a control loop",
            place=measured.place,
            remedy=f"It has: {', '.join(controlled) or 'none'}.",
        )
    return axis_name


def _unit(measured: MeasuredResponse) -> tuple[str, int]:
    """Return the unit without its rates, and their number; a relative response is a speed."""
    if not measured.absolute:
        return "", 1
    for rate in ("/s^2", "/s"):
        if measured.unit.endswith(rate):
            return measured.unit.removesuffix(rate), _RATES[rate]
    return measured.unit, 0


def _usual_output(machine: Machine, axis: str, base: str) -> str:
    if base == "count":
        return f"sensors.{machine.controller_of(axis).sensor}"
    if base in {"m", "rad"} and machine.axes[axis].kind == {"m": "linear", "rad": "rotary"}[base]:
        return f"{axis}.measured"
    return MOTOR


def _unit_of(machine: Machine, axis: str, output: str, measured: MeasuredResponse) -> str:
    kind, _, name = output.partition(".")
    if kind == "sensors" and name in machine.sensors:
        return "count" if isinstance(machine.sensors[name], Encoder) else "V"
    if output in {f"{axis}.{suffix}" for suffix in ("measured", "load", "frame")}:
        return "m" if machine.axes[axis].kind == "linear" else "rad"
    known = [*(f"sensors.{sensor}" for sensor in machine.sensors), MOTOR, f"{axis}.load"]
    raise OptionError(
        f"machine {machine.name!r} has no output {output!r}",
        place=measured.place,
        remedy=nearest(output, known, "It has"),
    )


def model_response(machine: Machine, values: Values, path: Path, omega: FloatArray) -> ComplexArray:
    """Return the (variants, k) response of the model along a path, in the unit of the response.

    Parameters
    ----------
    omega
        (k,) rad/s.

    Raises
    ------
    OptionError
        If the output does not depend on the input.
    """
    for piece in linear_variants(machine, values, drive=path.drive.removeprefix("drives.")):
        if path.output in piece.outputs:
            response = piece.response(path.drive, path.output, omega)
            return np.asarray(response * path.scale * (1j * omega) ** path.rates)
    raise OptionError(
        f"{path.output} does not move with {path.drive}",
        place=machine.place,
        remedy="Name another output.",
    )


def usable(measured: MeasuredResponse) -> tuple[NDArray[np.bool_], int]:
    """Return the (k,) mask of points with enough coherence, and how many have too little.

    Raises
    ------
    RecordingError
        If more than half of the points have too little.
    """
    if measured.coherence is None:
        return np.ones(len(measured.value), dtype=np.bool_), 0
    is_coherent = measured.coherence >= LEAST_COHERENCE
    left_out = int(np.sum(~is_coherent))
    if 2 * left_out > len(is_coherent):
        worst = measured.frequency_hz[int(np.argmin(measured.coherence))]
        raise RecordingError(
            f"{left_out} of {len(is_coherent)} points have a coherence below {LEAST_COHERENCE:g} "
            "(lowest "
            f"{measured.coherence.min():.2g} at {worst:.4g} Hz)",
            place=measured.place,
            remedy="Measure again, with a larger amplitude or more averages.",
        )
    return is_coherent, left_out
