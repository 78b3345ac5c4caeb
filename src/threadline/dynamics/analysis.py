"""Analysis of an axis: its motor without load, its loop's margins and poles, and its modes."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np

from threadline.base.arrays import ComplexArray, FloatArray
from threadline.dynamics.eccentric import current_needed, drive_rate, rigid_motion
from threadline.dynamics.linear_model import Oscillation, free_modes, linear_model, locked_modes
from threadline.dynamics.loop import Loop, Model, axis_loop, axis_loops
from threadline.dynamics.margins import (
    Margins,
    bandwidth_rad_s,
    loop_grid,
    margins_of,
    swinging,
    unstable_count,
    unstable_eigenvalues,
)
from threadline.dynamics.poles import chain_of, closed_poles, stable_gains, zeros_of
from threadline.dynamics.responses import Step, step_response
from threadline.errors import MachineError
from threadline.machine import Machine

_SINGULAR = 1e-12


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Actuator:
    """Response of the motor's speed to the controller's voltage, with every link removed.

    Parameters
    ----------
    dc_gain
        Steady speed per volt, rad/s/V (m/s/V for a linear motor); None if the speed never settles.
    loaded_dc_gain
        Steady speed per volt with the load of the axis, in the same unit.
    poles
        (n,) rad/s, without the integrator from speed to position.
    natural_rad_s, damping
        Natural frequency and damping ratio of the complex pole pair; None if all poles are real.
    delay_s
        Dead time between a voltage and its effect.
    """

    dc_gain: float | None
    loaded_dc_gain: float | None
    poles: ComplexArray
    natural_rad_s: float | None
    damping: float | None
    delay_s: float


def actuator_of(machine: Machine, axis: str) -> Actuator:
    """Return the actuator of an axis."""
    name = machine.controller_of(axis).drive
    drive = machine.motors[name]
    unlinked = dataclasses.replace(machine, links={})
    model = next(m for m in linear_model(unlinked) if f"drives.{name}" in m.inputs)
    rates = [model.states.index(f"{body}'") for body in drive.acts_on]
    coil_states = [k for k, state in enumerate(model.states) if state == f"{name}.i"]
    state_index = rates + coil_states
    A = model.A[np.ix_(state_index, state_index)]
    b = model.B[state_index, model.inputs.index(f"drives.{name}")]
    speed = np.array([q.si for q in drive.acts_on.values()] + [0.0] * len(coil_states))
    poles = np.asarray(np.linalg.eigvals(A), dtype=np.complex128)
    invertible = float(np.abs(poles).min()) > _SINGULAR * max(1.0, float(np.abs(poles).max()))
    oscillating_poles = swinging(A)
    return Actuator(
        dc_gain=float(-speed @ np.linalg.solve(A, b)) if invertible else None,
        loaded_dc_gain=_loaded_dc_gain(machine, axis),
        poles=poles,
        natural_rad_s=float(abs(oscillating_poles[0])) if len(oscillating_poles) else None,
        damping=float(-oscillating_poles[0].real / abs(oscillating_poles[0]))
        if len(oscillating_poles)
        else None,
        delay_s=0.0 if drive.delay is None else drive.delay.si,
    )


def fastest(machine: Machine, axis: str) -> float | None:
    """Return the steady speed of an axis at full output of the motor without load, m/s or rad/s.

    A load that the motor drives through a belt cannot exceed this speed for long. None if the speed
    never settles.
    """
    dc_gain, amplifier = actuator_of(machine, axis).dc_gain, machine.drive_of(axis).amplifier
    if dc_gain is None:
        return None
    volts = machine.controller_of(axis).dac.range.si
    if amplifier.mode == "voltage" and amplifier.voltage_limit is not None:
        volts = min(volts, amplifier.voltage_limit.si / amplifier.gain.si)
    drive_per_axis = drive_rate(machine, axis, rigid_motion(machine, axis))
    return abs(dc_gain * volts / drive_per_axis)


def _loaded_dc_gain(machine: Machine, axis: str) -> float | None:
    drive = machine.drive_of(axis)
    rates = rigid_motion(machine, axis)
    drive_per_axis = drive_rate(machine, axis, rates)
    viscous_a = current_needed(machine, axis, 1.0, 0.0) - current_needed(machine, axis, 0.0, 0.0)
    friction_force = sum(
        abs(rates[n]) * b.friction.si for n, b in machine.bodies.items() if b.friction is not None
    )
    viscous_a -= friction_force / (drive_per_axis * drive.torque_constant.si)
    gain = drive.amplifier.gain.si
    if drive.amplifier.mode == "current":
        return None if viscous_a <= 0 else gain * drive_per_axis / viscous_a
    volts = drive.resistance.si * viscous_a + drive.back_emf.si * drive_per_axis
    return None if volts <= 0 else gain * drive_per_axis / volts


HERTZ = 1.0 / (2.0 * np.pi)
_SCALE_RAD_S = 100.0
_LEAST_GAIN, _MOST_GAIN = 1e-100, 1e100  # V/count: the squares of these are still finite


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LoopFigures:
    """Stability figures of a loop, from one of its two models.

    Parameters
    ----------
    model
        The model: ``"sampled"`` or ``"continuous"``.
    grid_rad_s, response
        (k,) frequencies, dense enough to follow the open-loop response, and the response.
    margins
        Crossovers and margins of the open loop.
    poles
        Closed-loop poles in the s plane, rad/s, rightmost first.
    unstable
        Number of unstable closed-loop poles.
    bandwidth_hz
        Frequency at which the gain from reference to sensor has fallen by 3 dB; None if it never
        falls so far.
    """

    model: Model
    grid_rad_s: FloatArray
    response: ComplexArray
    margins: Margins
    poles: ComplexArray
    unstable: int
    bandwidth_hz: float | None

    @property
    def stable(self) -> bool:
        """Whether every closed-loop pole decays."""
        return self.unstable == 0

    @property
    def gain_margin(self) -> float | None:
        """Factor on the gain at which stability changes; None if it never changes."""
        return self.margins.gain_margin(self.stable)

    def as_json(self) -> dict[str, Any]:
        """Return the figures as JSON content."""
        gain, worst_phase = self.gain_margin, self.margins.worst_phase
        omegas_rad_s = [
            c.omega_rad_s for c in self.margins.phase_crossovers if c.gain_factor == gain
        ]
        return {
            "stable": self.stable,
            "unstable_poles": self.unstable,
            "bandwidth_hz": self.bandwidth_hz,
            "gain_margin": gain,
            "gain_margin_db": None if gain is None else 20.0 * float(np.log10(gain)),
            "gain_margin_below": self.margins.lower_to if self.stable else None,
            "phase_crossover_hz": omegas_rad_s[0] * HERTZ if omegas_rad_s else None,
            "phase_margin_deg": None if worst_phase is None else worst_phase.phase_margin_deg,
            "crossover_hz": None if worst_phase is None else worst_phase.omega_rad_s * HERTZ,
            "delay_margin_s": self.margins.delay_margin_s if self.stable else None,
            "modulus_margin": self.margins.modulus_margin,
            "poles_rad_s": [[float(p.real), float(p.imag)] for p in self.poles[:12]],
        }


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AxisAnalysis:
    """The analysis of one axis.

    Parameters
    ----------
    axis, loop
        Name of the axis, and its loop.
    sampled, continuous
        Figures of the sampled loop, and of the continuous loop with exact dead time. ``continuous``
        is None for a state-space controller, which has no continuous form.
    routh_gains
        Intervals of gain factors with a stable loop, by the textbook method: Routh's array with
        Pade's first-order approximation of the dead time. None if loops share bodies.
    locked, free
        Modes with locked motors, and with free motors.
    actuator
        The motor without load.
    plant_poles, plant_zeros
        Poles and zeros of the plant from this axis' voltage to its sensor, rad/s.
    steps
        Step responses by output, ``"measured"`` and ``"load"``; a response that cannot be computed
        is left out.
    """

    axis: str
    loop: Loop
    sampled: LoopFigures
    continuous: LoopFigures | None
    routh_gains: tuple[tuple[float, float], ...] | None
    locked: tuple[Oscillation, ...]
    free: tuple[Oscillation, ...]
    actuator: Actuator
    plant_poles: ComplexArray
    plant_zeros: ComplexArray
    steps: dict[str, Step]

    @property
    def stable(self) -> bool:
        """Whether the sampled loop is stable."""
        return self.sampled.stable

    def verdict(self) -> str:
        """Return one sentence on the loop's stability, with its margin."""
        return _verdict(self.axis, self.sampled)

    def as_json(self) -> dict[str, Any]:
        """Return the analysis as JSON content, with the sampled loop's figures at top level."""
        motor = self.actuator
        return {
            **self.sampled.as_json(),
            "verdict": self.verdict(),
            "modes_hz": [m.frequency_hz for m in self.locked],
            "modes_damping": [m.damping for m in self.locked],
            "modes_free_hz": [m.frequency_hz for m in self.free],
            "modes_free_damping": [m.damping for m in self.free],
            "dc_gain": motor.dc_gain,
            "dc_gain_loaded": motor.loaded_dc_gain,
            "actuator": {
                "natural_rad_s": motor.natural_rad_s,
                "damping": motor.damping,
                "poles_rad_s": _pairs(motor.poles),
                "delay_s": motor.delay_s,
            },
            "plant_poles_rad_s": _pairs(self.plant_poles),
            "plant_zeros_rad_s": _pairs(self.plant_zeros),
            "routh_pade_gains": None
            if self.routh_gains is None
            else [[low, high if np.isfinite(high) else None] for low, high in self.routh_gains],
            "steps": {name: _step_json(step) for name, step in self.steps.items()},
            "continuous": None if self.continuous is None else self.continuous.as_json(),
        }


def analyse_axis(machine: Machine, axis: str) -> AxisAnalysis:
    """Return the analysis of one axis.

    Raises
    ------
    OptionError
        If there is no such axis.
    MachineError
        If its loop cannot be analysed.
    """
    loop = axis_loop(machine, axis)
    _check_gain(machine, loop)
    axis_plant = loop.axis_plant()
    steps = {name: step_response(loop, name) for name in ("measured", "load")}
    return AxisAnalysis(
        axis=axis,
        loop=loop,
        sampled=loop_figures(loop, "sampled"),
        continuous=loop_figures(loop, "continuous") if loop.single else None,
        routh_gains=_routh(loop) if len(loop.filters) == 1 else None,
        locked=locked_modes(machine, axis),
        free=free_modes(machine, axis),
        actuator=actuator_of(machine, axis),
        plant_poles=_sorted(axis_plant.poles()),
        plant_zeros=_sorted(zeros_of(axis_plant)),
        steps={name: step for name, step in steps.items() if step is not None},
    )


def _check_gain(machine: Machine, loop: Loop) -> None:
    """Refuse a loop whose controller has a gain of zero, or a gain outside numerical range."""
    if not loop.single:
        return
    largest_gain = float(np.abs(loop.filters[loop.index].numerator).max())
    if _LEAST_GAIN <= largest_gain <= _MOST_GAIN:
        return
    fault = (
        "gives 0 V for any error, so there is no loop to analyse"
        if largest_gain == 0.0
        else f"gives {largest_gain:.3g} V for an error of a count, outside "
        f"{_LEAST_GAIN:g} ... {_MOST_GAIN:g}"
    )
    raise MachineError(
        f"axes.{loop.axis}: controllers.{loop.controllers[loop.index]} {fault}",
        place=machine.place,
        remedy="Correct its gains.",
    )


def analyse(machine: Machine) -> dict[str, AxisAnalysis]:
    """Return the analysis of every axis."""
    return {axis: analyse_axis(machine, axis) for axis in machine.axes}


def loop_figures(loop: Loop, model: Model) -> LoopFigures:
    """Return the figures of a loop from one of its two models.

    Raises
    ------
    MachineError
        If a pole of the continuous loop lies on the imaginary axis.
    """
    grid = loop_grid(loop, model)
    response = loop.responder(model)
    poles: ComplexArray
    if model == "sampled":
        closed_loop = loop.closed()
        z = closed_loop.eigenvalues()
        unstable = len(unstable_eigenvalues(closed_loop.A))
        # A pole with |z| < 0.1 decays within a tick, so its value in the s plane has no meaning.
        poles = np.asarray(np.log(z[np.abs(z) > 0.1]) / loop.period_s, dtype=np.complex128)
    else:
        try:
            unstable = unstable_count(loop)
        except ValueError as error:
            raise MachineError(
                f"axes.{loop.axis}: {error.args[0]}, so its loop is neither stable nor unstable",
                remedy="Correct the numbers of its controller and its plant.",
            ) from error
        poles = closed_poles(loop)

    bandwidth = bandwidth_rad_s(loop.follower(model), grid)
    return LoopFigures(
        model=model,
        grid_rad_s=grid,
        response=response(grid),
        margins=margins_of(response, grid),
        poles=_sorted(poles),
        unstable=unstable,
        bandwidth_hz=None if bandwidth is None else bandwidth * HERTZ,
    )


def _verdict(axis: str, figures: LoopFigures) -> str:
    gain = figures.gain_margin
    if figures.stable:
        worst_phase = figures.margins.worst_phase
        phase = (
            "" if worst_phase is None else f", phase margin {worst_phase.phase_margin_deg:.1f} deg"
        )
        gain_text = "any gain" if gain is None else f"up to {gain:.3g} times the gain"
        return f"axis {axis}: the loop is stable with {gain_text}{phase}"
    if gain is None:
        remedy = "no gain makes it stable"
    elif gain < 1:
        remedy = f"it is at its limit at {gain:.3g} times the gain"
    else:
        remedy = f"its poles reach the limit at {gain:.3g} times the gain"
    return f"axis {axis}: the loop is UNSTABLE ({figures.unstable} poles); {remedy}"


def unstable_loops(machine: Machine) -> list[str]:
    """Return one sentence, with the margin, for every axis whose sampled loop is unstable.

    The continuous loop is not computed: if a clock is a thousand times too slow, the dead time of
    half a tick rotates the phase thousands of times, and the calculation would take long.
    """
    sentences = []
    for axis, loop in axis_loops(machine).items():
        if len(unstable_eigenvalues(loop.closed().A)):
            _check_gain(machine, loop)
            sentences.append(_verdict(axis, loop_figures(loop, "sampled")))
    return sentences


def _routh(loop: Loop) -> tuple[tuple[float, float], ...]:
    """Return the stable gains by Routh's array with a Pade dead time; s is in 100 rad/s."""
    plant, digital = loop.axis_plant(), loop.filters[loop.index]
    chain, zeros, poles = chain_of(plant), zeros_of(plant), plant.poles()
    degree = len(poles) - len(zeros)
    numerator = np.poly(zeros / _SCALE_RAD_S).real * chain.gain / _SCALE_RAD_S**degree
    denominator = np.poly(poles / _SCALE_RAD_S).real
    numerator = np.polymul(numerator, _in_hundreds(digital.continuous_numerator))
    denominator = np.polymul(denominator, _in_hundreds(digital.continuous_denominator))
    delay = float(loop.delays_s()[loop.index]) * _SCALE_RAD_S
    if delay > 0:
        numerator, denominator = (
            np.polymul(numerator, [-delay, 2.0]),
            np.polymul(denominator, [delay, 2.0]),
        )
    return stable_gains(np.asarray(numerator), np.asarray(denominator))


def _in_hundreds(polynomial: FloatArray) -> FloatArray:
    return polynomial * _SCALE_RAD_S ** np.arange(len(polynomial) - 1, -1, -1)


def _sorted(poles: ComplexArray) -> ComplexArray:
    order = np.lexsort((-poles.imag, np.abs(poles.imag), -np.round(poles.real, 6)))
    return np.asarray(poles[order])


def _pairs(poles: ComplexArray) -> list[list[float]]:
    return [[float(p.real), float(p.imag)] for p in poles]


def _step_json(step: Step) -> dict[str, float]:
    return {
        "rise_s": step.rise_s,
        "settling_s": step.settling_s,
        "overshoot": step.overshoot,
        "peak_s": step.peak_s,
        "steady_state_error": step.steady_state_error,
    }
