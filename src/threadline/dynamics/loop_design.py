"""Controllers of every kind for a crossover and a phase margin, and the limits of a pure gain.

Controllers are designed in discrete form on the exact response of the plant, including dead time
and held output. With ``d = 1 - 1/z`` they are ``kp + kd d`` (``pd``) and ``kp + ki/d + kd d``
(``pid``). The integral time is 10 / (crossover in rad/s), which costs six degrees of phase at the
crossover. At a crossover w the response of the controller must be ``exp(i (phase margin - 180 deg))
/ G(w)``; its real and imaginary parts give two gains. A controller with one gain (``p``, ``pi``)
has the phase margin at only one crossover.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import ComplexArray, FloatArray
from threadline.dynamics.lead import lead_from_response
from threadline.dynamics.loop import Loop
from threadline.dynamics.margins import unstable_eigenvalues
from threadline.errors import OptionError
from threadline.machine import Machine
from threadline.machine.controllers import (
    COEFFICIENT_HIGH,
    COEFFICIENT_LOW,
    LeadController,
    PController,
    PdController,
    PiController,
    PidController,
)
from threadline.machine.quantity import Provenance, Quantity

ControllerKind: TypeAlias = Literal["p", "pi", "pd", "pid", "lead"]
CONTROLLERS: tuple[ControllerKind, ...] = ("p", "pi", "pd", "pid", "lead")
NAMES: Mapping[ControllerKind, str] = {
    "p": "PE",
    "pi": "PI",
    "pd": "PD",
    "pid": "PID",
    "lead": "lead",
}
NUMBERS: Mapping[ControllerKind, tuple[str, ...]] = {
    "p": ("kp",),
    "pi": ("kp", "ki"),
    "pd": ("kp", "kd"),
    "pid": ("kp", "ki", "kd"),
    "lead": ("gain", "zero", "pole"),
}
"""Names of the gains of each kind of controller."""
LEAST_GAIN_MARGIN = 2.0
"""Smallest gain margin of a designed loop, unless its crossover is given."""
_INTEGRAL = 10.0  # integral time times crossover in rad/s
_GRID_POINTS, _RESONANCE_POINTS = 1500, 120
_CANDIDATES = 240
_SMALL = 0.02  # a phase crossover with a smaller gain does not limit the gain


def with_controller(
    machine: Machine, axis: str, kind: ControllerKind, gains: Mapping[str, float]
) -> Machine:
    """Return a machine in which an axis has another controller, and a new hash.

    Clocks, encoder, drive and DAC of the controller do not change.

    Parameters
    ----------
    gains
        Gains of the new controller in DAC levels per count: ``kp``, ``ki``, ``kd``; or ``gain``,
        and ``zero`` and ``pole`` without unit.
    """
    name, old = machine.axes[axis].controller, machine.controller_of(axis)
    numbers = {
        key: Quantity(
            si=float(value),
            unit="" if key in {"zero", "pole"} else "dac/count",
            tolerance_si=0.0,
            provenance=Provenance.CHECKED,
        )
        for key, value in gains.items()
    }
    common: dict[str, Any] = {
        "clock": old.clock,
        "reference_clock": old.reference_clock,
        "sensor": old.sensor,
        "drive": old.drive,
        "dac": old.dac,
    }
    classes: dict[ControllerKind, Any] = {
        "p": PController,
        "pi": PiController,
        "pd": PdController,
        "pid": PidController,
        "lead": LeadController,
    }
    new = classes[kind](kind=kind, **common, **numbers)
    change_text = repr((name, kind, sorted((key, float(value)) for key, value in gains.items())))
    return dataclasses.replace(
        machine,
        controllers={**machine.controllers, name: new},
        sha256=hashlib.sha256((machine.sha256 + change_text).encode()).hexdigest(),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OpenPlant:
    """The plant of an axis on a grid of frequencies, up to half the rate of its controller.

    Parameters
    ----------
    omega_rad_s, response
        (k,) frequencies, and complex counts per DAC level; the other loops are closed.
    period_s
        Tick of the controller.
    """

    omega_rad_s: FloatArray
    response: ComplexArray
    period_s: float

    def controller(self, kind: ControllerKind, gains: Mapping[str, float]) -> ComplexArray:
        """Return the (k,) response of a controller, DAC levels per count."""
        z = np.exp(1j * self.omega_rad_s * self.period_s)
        if kind == "lead":
            return np.asarray(gains["gain"] * (z - gains["zero"]) / (z + gains["pole"]))
        d = 1.0 - 1.0 / z
        return np.asarray(gains["kp"] + gains.get("ki", 0.0) / d + gains.get("kd", 0.0) * d)


def plant_grid(loop: Loop) -> FloatArray:
    """Return (k,) frequencies, rad/s, for an ``OpenPlant``, dense around the plant's resonances."""
    poles = loop.plant.poles()
    moving = np.abs(poles)[np.abs(poles) > 1e-6 * max(np.abs(poles).max(), 1.0)]
    low = 1e-2 * min(float(moving.min()) if len(moving) else 10.0, 10.0)
    high = np.pi / loop.period_s * (1 - 1e-9)
    parts = [np.geomspace(low, high, _GRID_POINTS)]
    for pole in poles[poles.imag > 0].tolist():
        magnitude = abs(pole)
        width = 6.0 * min(max(abs(pole.real) / magnitude, 1e-3), 0.1)
        parts.append(magnitude * np.linspace(1.0 - width, 1.0 + width, _RESONANCE_POINTS))
    grid = np.unique(np.concatenate(parts))
    return np.asarray(grid[(grid >= low) & (grid <= high)])


def open_plant(loop: Loop, omega_rad_s: FloatArray | None = None) -> OpenPlant:
    """Return the plant of a loop at (k,) frequencies, rad/s, by default ``plant_grid``."""
    grid = plant_grid(loop) if omega_rad_s is None else omega_rad_s
    volts = loop.filters[loop.index].volt_per_level
    return OpenPlant(
        omega_rad_s=grid, response=volts * loop.plant_response(grid), period_s=loop.period_s
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GridMargins:
    """Margins of m loops from their responses on a grid, interpolated linearly between its points.

    Parameters
    ----------
    gain_factor
        (m,) smallest 1 / gain over the phase crossovers above half the first gain crossover; below
        1 for an unstable loop, infinite without such a crossover.
    phase_deg
        (m,) smallest signed phase margin of all gain crossovers; infinite without a crossover.
    crossover_rad_s
        (m,) first gain crossover; 0 if there is none.
    modulus
        (m,) smallest distance of the response from -1.
    """

    gain_factor: FloatArray
    phase_deg: FloatArray
    crossover_rad_s: FloatArray
    modulus: FloatArray


def grid_margins(L: ComplexArray, omega_rad_s: FloatArray) -> GridMargins:
    """Return the margins of (m, k) open-loop responses at (k,) frequencies."""
    L = np.atleast_2d(L)
    log_gain = np.log(np.maximum(np.abs(L), 1e-12))
    crosses = (log_gain[:, :-1] > 0.0) != (log_gain[:, 1:] > 0.0)
    share = _share(log_gain, crosses)
    phase_step = np.angle(L[:, 1:] / L[:, :-1])
    angle = np.degrees(np.angle(-L[:, :-1] * np.exp(1j * share * phase_step)))
    phase = np.where(crosses, angle, np.inf).min(axis=1)
    crossover = omega_rad_s[:-1] + share * np.diff(omega_rad_s)
    first_crossover = np.where(crosses, crossover, np.inf).min(axis=1)
    first_crossover = np.where(np.isfinite(first_crossover), first_crossover, 0.0)
    is_phase_crossover = (L.imag[:, :-1] > 0.0) != (L.imag[:, 1:] > 0.0)
    is_phase_crossover &= L.real[:, :-1] + L.real[:, 1:] < 0.0
    is_phase_crossover &= omega_rad_s[:-1] > 0.5 * first_crossover[:, None]
    flip_share = _share(L.imag, is_phase_crossover)
    real = L.real[:, :-1] + flip_share * np.diff(L.real, axis=1)
    is_phase_crossover &= real < -_SMALL
    factor = np.where(
        is_phase_crossover, -1.0 / np.where(is_phase_crossover, real, -1.0), np.inf
    ).min(axis=1)
    return GridMargins(
        gain_factor=factor,
        phase_deg=phase,
        crossover_rad_s=first_crossover,
        modulus=np.abs(1.0 + L).min(axis=1),
    )


def _share(values: FloatArray, crosses: NDArray[np.bool_]) -> FloatArray:
    """Return the zero crossings of (m, k) values, as (m, k - 1) shares of the grid intervals."""
    rise = np.diff(values, axis=1)
    return np.asarray(np.where(crosses, -values[:, :-1] / np.where(crosses, rise, 1.0), 0.0))


def check_goal(loop: Loop, phase_margin_deg: float, crossover_hz: float | None) -> None:
    """Refuse a phase margin or a crossover that no loop can have.

    Raises
    ------
    OptionError
        If one is out of range; the error names the range.
    """
    if not 0 < phase_margin_deg < 180:
        raise OptionError(
            f"phase margin {phase_margin_deg:g} deg is outside 0 ... 180 deg",
            remedy="Give 30 to 70 deg.",
        )
    nyquist_hz = 0.5 / loop.period_s
    if crossover_hz is not None and not 0 < crossover_hz < nyquist_hz:
        raise OptionError(
            f"crossover {crossover_hz:g} Hz is outside 0 ... {nyquist_hz:g} Hz",
            remedy="Give at most half the controller's rate.",
        )


def design(
    machine: Machine,
    loop: Loop,
    kind: ControllerKind,
    phase_margin_deg: float,
    crossover_hz: float | None = None,
) -> dict[str, float]:
    """Return the gains of a controller for a phase margin, DAC levels per count.

    Parameters
    ----------
    loop
        The loop of the axis with any controller.
    crossover_hz
        Crossover of the loop. By default it is chosen for the largest gain at low frequencies (the
        largest ``ki``, if there is an integral part) with which the loop has the phase margin and a
        gain margin of 2. This gives the smallest error under a constant load or speed
        (Panagopoulos, Astrom and Hagglund, "Design of PID controllers based on constrained
        optimisation", IEE Proc. Control Theory 149, 2002). ``p`` and ``pi`` have one gain: a given
        crossover determines it, and the phase margin is then whatever results.

    Raises
    ------
    OptionError
        If a number is out of range, or no such controller has the phase margin.
    """
    check_goal(loop, phase_margin_deg, crossover_hz)
    plant = open_plant(loop)
    if crossover_hz is not None:
        omega = np.array([2 * np.pi * crossover_hz])
        response = loop.filters[loop.index].volt_per_level * loop.plant_response(omega)
        candidates = _gains(kind, omega, response, phase_margin_deg, loop.period_s)
        if kind in {"p", "pi"}:  # the single gain is set by the crossover, whatever the phase
            kp = 1.0 / np.abs(_shape(kind, omega, loop.period_s) * response)
            candidates = {"kp": kp, "ki": kp * omega * loop.period_s / _INTEGRAL}
            if kind == "p":
                del candidates["ki"]
        if not _gains_possible(kind, candidates)[0]:
            raise OptionError(
                f"axis {loop.axis}: no {NAMES[kind]} controller has {phase_margin_deg:g} deg at "
                f"{crossover_hz:g} Hz",
                remedy="Ask for a lower crossover or another phase margin.",
            )
        return {key: float(value[0]) for key, value in candidates.items()}
    in_range = plant.omega_rad_s < np.pi / loop.period_s * 0.9
    omega = plant.omega_rad_s[in_range]
    response = plant.response[in_range]
    if kind in {"p", "pi"}:
        omega = _single_gain_crossovers(kind, omega, response, phase_margin_deg, loop.period_s)
        response = loop.filters[loop.index].volt_per_level * loop.plant_response(omega)
    else:
        candidate_index = np.unique(np.linspace(0, len(omega) - 1, _CANDIDATES).astype(int))
        omega, response = omega[candidate_index], response[candidate_index]
    candidates = _gains(kind, omega, response, phase_margin_deg, loop.period_s)
    for k in np.argsort(-_slow_gain(kind, candidates)):
        if not _gains_possible(kind, candidates)[k]:
            continue
        gains = {key: float(value[k]) for key, value in candidates.items()}
        L = plant.response * plant.controller(kind, gains)
        margins = grid_margins(L, plant.omega_rad_s)
        # The loop may have further crossovers with less phase.
        has_margins = margins.gain_factor[0] >= LEAST_GAIN_MARGIN
        has_margins &= margins.phase_deg[0] >= phase_margin_deg - 0.5
        if has_margins and _stable(machine, loop, kind, gains):
            return gains
    raise OptionError(
        f"axis {loop.axis}: no {NAMES[kind]} controller has a phase margin of "
        f"{phase_margin_deg:g} deg and a gain margin of {LEAST_GAIN_MARGIN:g}",
        remedy="Ask for a smaller phase margin, or for another controller.",
    )


def _stable(machine: Machine, loop: Loop, kind: ControllerKind, gains: Mapping[str, float]) -> bool:
    from threadline.dynamics.loop import axis_loop

    designed = with_controller(machine, loop.axis, kind, gains)
    return not len(unstable_eigenvalues(axis_loop(designed, loop.axis).closed().A))


def _shape(kind: ControllerKind, omega: FloatArray, period_s: float) -> ComplexArray:
    """Return the (k,) response of a controller with kp = 1, without its differential part."""
    if kind in {"p", "pd"}:
        return np.ones(len(omega), dtype=np.complex128)
    d = 1.0 - np.exp(-1j * omega * period_s)
    return np.asarray(1.0 + omega * period_s / _INTEGRAL / d)


def _gains(
    kind: ControllerKind,
    omega: FloatArray,
    response: ComplexArray,
    margin_deg: float,
    period_s: float,
) -> dict[str, FloatArray]:
    """Return gains for (k,) crossovers; impossible gains are negative or not finite."""
    if kind == "lead":
        gain, zero = lead_from_response(response, omega, margin_deg, period_s, COEFFICIENT_LOW)
        return {"gain": gain, "zero": zero, "pole": np.full(len(omega), COEFFICIENT_LOW)}
    needed = np.exp(1j * np.radians(margin_deg - 180.0)) / response
    shape = _shape(kind, omega, period_s)
    d = 1.0 - np.exp(-1j * omega * period_s)
    kd = np.zeros(len(omega))
    if kind in {"pd", "pid"}:
        # needed = kp shape + kd d, real and imaginary parts.
        ratio, d_ratio = needed / shape, d / shape
        kd = ratio.imag / d_ratio.imag
        kp = ratio.real - kd * d_ratio.real
    else:
        kp = (needed / shape).real
    gains = {"kp": np.asarray(kp)}
    if kind in {"pi", "pid"}:
        gains["ki"] = np.asarray(kp * omega * period_s / _INTEGRAL)
    if kind in {"pd", "pid"}:
        gains["kd"] = np.asarray(kd)
    return gains


def _gains_possible(kind: ControllerKind, gains: Mapping[str, FloatArray]) -> NDArray[np.bool_]:
    if kind == "lead":
        zero = gains["zero"]
        return np.asarray((zero >= COEFFICIENT_LOW) & (zero <= COEFFICIENT_HIGH))
    # A negative kd would delay instead of lead: the loop is then better without it.
    return np.asarray((gains["kp"] > 0.0) & (gains.get("kd", np.zeros(1)) >= 0.0))


def _slow_gain(kind: ControllerKind, gains: Mapping[str, FloatArray]) -> FloatArray:
    """Return the (k,) gains at low frequencies; for an integral part its gain ``ki``."""
    if kind == "lead":
        gain = gains["gain"] * (1.0 - gains["zero"]) / (1.0 + gains["pole"])
    else:
        gain = gains["ki"] if "ki" in gains else gains["kp"]
    return np.asarray(np.nan_to_num(gain, nan=-np.inf))


def _single_gain_crossovers(
    kind: ControllerKind,
    omega: FloatArray,
    response: ComplexArray,
    margin_deg: float,
    period_s: float,
) -> FloatArray:
    """Return the crossovers, between grid points, at which one gain gives the phase margin."""
    angle = np.angle(
        response * _shape(kind, omega, period_s) * np.exp(-1j * np.radians(margin_deg - 180.0))
    )
    crosses = (angle[:-1] > 0.0) & (angle[1:] <= 0.0) & (angle[:-1] - angle[1:] < np.pi)
    share = angle[:-1][crosses] / (angle[:-1] - angle[1:])[crosses]
    return np.asarray(omega[:-1][crosses] + share * np.diff(omega)[crosses])
