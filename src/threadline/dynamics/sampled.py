"""Linear models, sampled and continuous: state space with dead time, digital filters, closed loops.

The difference equation is ``u = b0 e + b1 e' + b2 e'' - a1 u' - a2 u''`` in DAC levels, where each
prime means one tick earlier. In the continuous form of a controller a sum over ticks is an integral
and a difference per tick is a derivative. A lead filter is converted by Tustin's rule:
``K (z - A) / (z + B)`` has its zero at ``s = -(2/T)(1 - A)/(1 + A)``, its pole at
``s = -(2/T)(1 + B)/(1 - B)`` and the high-frequency gain ``K (1 + A)/(1 - B)``.

With a dead time of ``d T + f``, ``0 <= f < T``, a held value reaches the plant at the time ``f``
after a tick. Within a tick the older value therefore acts for the time ``f`` and the newer value
for ``T - f``. The effects of both are matrix exponentials, so the dead time is neither rounded to a
tick nor approximated by a rational function (Franklin, Powell and Workman, *Digital Control of
Dynamic Systems*, section 4.3.4).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from threadline.base.arrays import FloatArray, Locked, read_only
from threadline.dynamics.values import Values
from threadline.errors import MachineError, OptionError
from threadline.machine import Machine
from threadline.machine.controllers import (
    LeadFilter,
    PController,
    PdController,
    PiController,
    StateSpaceController,
    VelocityController,
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StateSpace(Locked):
    """``x' = A x + B u(t - delay)``, ``y = C x + D u(t - delay)``, SI throughout.

    Parameters
    ----------
    A
        (n, n).
    B
        (n, inputs).
    C
        (outputs, n).
    D
        (outputs, inputs).
    delay_s
        (inputs,) dead time between the command of an input and its effect, in s.
    states, inputs, outputs
        Names, in the order of the rows and columns.
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    delay_s: FloatArray
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]

    def __post_init__(self) -> None:
        for name in ("A", "B", "C", "D"):
            object.__setattr__(self, name, read_only(getattr(self, name), name, ndim=2))
        object.__setattr__(self, "delay_s", read_only(self.delay_s, "delay_s", ndim=1))
        n, m, p = len(self.states), len(self.inputs), len(self.outputs)
        for name, expected in (
            ("A", (n, n)),
            ("B", (n, m)),
            ("C", (p, n)),
            ("D", (p, m)),
            ("delay_s", (m,)),
        ):
            shape = getattr(self, name).shape
            if shape != expected:
                raise ValueError(f"{name} has shape {shape}, expected {expected}")
        if (self.delay_s < 0).any():
            raise ValueError(f"delay_s must not be negative, got {self.delay_s.tolist()}")

    def poles(self) -> NDArray[np.complex128]:
        """Return the (n,) eigenvalues of A in rad/s."""
        return np.asarray(np.linalg.eigvals(self.A), dtype=np.complex128)

    def select(self, inputs: list[str], outputs: list[str]) -> StateSpace:
        """Return the model with a selection of its inputs and outputs.

        Raises
        ------
        OptionError
            If a name does not exist.
        """
        columns = [_index(name, self.inputs, "input") for name in inputs]
        rows = [_index(name, self.outputs, "output") for name in outputs]
        return StateSpace(
            A=self.A,
            B=self.B[:, columns],
            C=self.C[rows],
            D=self.D[np.ix_(rows, columns)],
            delay_s=self.delay_s[columns],
            states=self.states,
            inputs=tuple(inputs),
            outputs=tuple(outputs),
        )

    def response(self, omega_rad_s: FloatArray) -> NDArray[np.complex128]:
        """Return the (k, outputs, inputs) frequency response, dead time exact.

        Parameters
        ----------
        omega_rad_s
            (k,) frequencies; none may be a pole on the imaginary axis.
        """
        s = 1j * np.asarray(omega_rad_s, dtype=np.float64)
        resolvent = s[:, None, None] * np.eye(len(self.A)) - self.A
        states = np.linalg.solve(resolvent, np.broadcast_to(self.B, (len(s), *self.B.shape)))
        delay = np.exp(-s[:, None] * self.delay_s)
        return np.asarray((self.C @ states + self.D) * delay[:, None, :], dtype=np.complex128)


def _index(name: str, names: tuple[str, ...], kind: str) -> int:
    if name not in names:
        raise OptionError(f"no {kind} {name!r}", remedy=f"There are: {', '.join(names)}.")
    return names.index(name)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DigitalFilter(Locked):
    """A controller with its DAC, as a difference equation and in continuous form.

    Parameters
    ----------
    numerator, denominator
        (3,) coefficients of the difference equation: ``b0 b1 b2`` in V/count, and ``1 a1 a2``
        without unit.
    continuous_numerator, continuous_denominator
        Polynomials in s, highest power first, of the continuous form in V/count.
    period_s
        Tick of the controller.
    volt_per_level
        Voltage of one level of the DAC.
    """

    numerator: FloatArray
    denominator: FloatArray
    continuous_numerator: FloatArray
    continuous_denominator: FloatArray
    period_s: float
    volt_per_level: float = 1.0

    def __post_init__(self) -> None:
        for name in ("numerator", "denominator", "continuous_numerator", "continuous_denominator"):
            object.__setattr__(self, name, read_only(getattr(self, name), name, ndim=1))

    def sampled_response(self, omega_rad_s: FloatArray) -> NDArray[np.complex128]:
        """Return the (k,) response of the difference equation at ``z = exp(i w T)``, V/count."""
        delay = np.exp(-1j * np.asarray(omega_rad_s) * self.period_s)
        powers = np.stack([np.ones_like(delay), delay, delay**2])
        return np.asarray((self.numerator @ powers) / (self.denominator @ powers))

    def continuous_response(self, omega_rad_s: FloatArray) -> NDArray[np.complex128]:
        """Return the (k,) response of the continuous form at ``s = i w``, V/count."""
        s = 1j * np.asarray(omega_rad_s)
        numerator = np.polyval(self.continuous_numerator, s)
        return np.asarray(numerator / np.polyval(self.continuous_denominator, s))


def difference_equation(
    machine: Machine, name: str, values: Values
) -> tuple[FloatArray, FloatArray]:
    """Return (variants, 3) ``b0 b1 b2`` in DAC levels per count and (variants, 2) ``a1 a2``.

    Parameters
    ----------
    name
        Name of the controller.
    values
        Replaced numbers of every variant.

    Raises
    ------
    MachineError
        For a state-space controller, which has no difference equation of one error.
    """
    controller, path = machine.controllers[name], f"controllers.{name}"
    if isinstance(controller, StateSpaceController):
        raise MachineError(
            f"controllers.{name} has the kind state-space, but feed-forward, fitting and designs "
            "of filters need a controller with one error, one encoder and one drive",
            place=machine.place,
            remedy="Leave that option out, or give each axis a controller of another kind.",
        )
    numerator, denominator = np.zeros((values.count, 3)), np.zeros((values.count, 2))
    if isinstance(controller, LeadFilter):
        gain = values.at(f"{path}.gain", controller.gain)
        numerator[:, 0] = gain
        numerator[:, 1] = -np.asarray(gain) * values.at(f"{path}.zero", controller.zero)
        denominator[:, 0] = values.at(f"{path}.pole", controller.pole)
        return numerator, denominator
    if isinstance(controller, VelocityController):
        numerator[:, 0] = values.at(f"{path}.gain", controller.gain)
        numerator[:, 1] = -numerator[:, 0]
        return numerator, denominator
    kp = np.asarray(values.at(f"{path}.kp", controller.kp))
    if isinstance(controller, PController):
        numerator[:, 0] = kp
    elif isinstance(controller, PdController):
        kd = np.asarray(values.at(f"{path}.kd", controller.kd))
        numerator[:, 0], numerator[:, 1] = kp + kd, -kd
    else:
        ki = np.asarray(values.at(f"{path}.ki", controller.ki))
        numerator[:, 0], numerator[:, 1], denominator[:, 0] = kp + ki, -kp, -1.0
        if not isinstance(controller, PiController):
            kd = np.asarray(values.at(f"{path}.kd", controller.kd))
            numerator[:, 0] += kd
            numerator[:, 1] -= 2.0 * kd
            numerator[:, 2] = kd
    return numerator, denominator


def digital_filter(machine: Machine, name: str, values: Values | None = None) -> DigitalFilter:
    """Return the controller ``name`` with its DAC, in volts per count.

    ``values`` may replace numbers of the machine; the first variant is used.
    """
    all_values = Values.of(machine) if values is None else values
    controller = machine.controllers[name]
    b, a = difference_equation(machine, name, all_values)
    (b0, b1, b2), (a1, _) = b[0], a[0]
    bits = np.ravel(all_values.at(f"controllers.{name}.dac.bits", controller.dac.bits))[0]
    range_v = np.ravel(all_values.at(f"controllers.{name}.dac.range", controller.dac.range))[0]
    volt_per_level = 2.0 * range_v / 2.0**bits
    period_s = float(machine.clock(controller.clock).period_s)
    if isinstance(controller, LeadFilter):
        # s -> z by Tustin: b0 (z - A)/(z + B).
        numerator = [b0 - b1, (b0 + b1) * 2.0 / period_s]
        denominator = [1.0 - a1, (1.0 + a1) * 2.0 / period_s]
    elif a1 == 0.0:
        # b0 e + b1 e' = (b0 + b1) e - b1 (e - e').
        numerator, denominator = [-b1 * period_s, b0 + b1], [1.0]
    else:
        # Integrating: u - u' = ki e + kp (e - e') + kd (e - 2 e' + e'').
        numerator = [b2 * period_s, -(b1 + 2.0 * b2), (b0 + b1 + b2) / period_s]
        denominator = [1.0, 0.0]
    return DigitalFilter(
        numerator=volt_per_level * b[0],
        denominator=np.array([1.0, *a[0]]),
        continuous_numerator=np.trim_zeros(volt_per_level * np.array(numerator), "f")
        if np.any(numerator)
        else np.zeros(1),
        continuous_denominator=np.array(denominator),
        period_s=period_s,
        volt_per_level=float(volt_per_level),
    )


_ROUNDING = 1e-9
_MOST_TICKS = 4000  # of dead time; each tick is a state, and eigenvalues of 4000 states take 20 s


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SampledPlant:
    """``x[k+1] = transition x[k] + sum(newer u[k-d] + older u[k-d-1])``, ``y = C x``.

    Parameters
    ----------
    transition
        (n, n) matrix of the states over a tick.
    newer, older
        (n, inputs) effect over a tick of the input that is delayed by d ticks, and of the input
        before it.
    ticks
        Whole ticks d of dead time of each input.
    C
        (outputs, n) matrix of the outputs.
    period_s
        Length of a tick.
    """

    transition: FloatArray
    newer: FloatArray
    older: FloatArray
    ticks: tuple[int, ...]
    C: FloatArray
    period_s: float

    def response(self, omega_rad_s: FloatArray) -> NDArray[np.complex128]:
        """Return the (k, outputs, inputs) frequency response at ``z = exp(i w T)``."""
        z = np.exp(1j * np.asarray(omega_rad_s, dtype=np.float64) * self.period_s)
        delay = z[:, None] ** (-np.array(self.ticks, dtype=np.float64))
        input_rows = self.newer * delay[:, None, :] + self.older * (delay / z[:, None])[:, None, :]
        states = np.linalg.solve(
            z[:, None, None] * np.eye(len(self.transition)) - self.transition, input_rows
        )
        return np.asarray(self.C @ states, dtype=np.complex128)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ClosedLoop:
    """``X[k+1] = A X[k] + B r[k]``, ``y[k] = C X[k] + D r[k]``, from references in counts.

    ``outputs`` names the rows of C and D: the outputs of the plant, then ``"controllers.NAME"`` for
    the outputs of the controllers in V.
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    outputs: tuple[str, ...]
    period_s: float

    def eigenvalues(self) -> NDArray[np.complex128]:
        """Return the (n,) closed-loop poles in the z plane."""
        return np.asarray(np.linalg.eigvals(self.A), dtype=np.complex128)

    @property
    def spectral_radius(self) -> float:
        """Largest magnitude of a closed-loop pole; below 1 the loop is stable."""
        return float(np.abs(self.eigenvalues()).max())

    def respond(self, reference: FloatArray) -> FloatArray:
        """Return the (k, outputs) response to (k, inputs) references in counts, from rest."""
        counts = np.asarray(reference, dtype=np.float64)
        states = np.zeros((len(counts) + 1, len(self.A)))
        # The product with B is computed for all ticks at once.
        for k, input_step in enumerate(counts @ self.B.T):
            states[k + 1] = self.A @ states[k] + input_step
        return np.asarray(states[:-1] @ self.C.T + counts @ self.D.T)

    def steady(self) -> FloatArray:
        """Return the (outputs, inputs) steady state after unit steps of the references."""
        settled = np.linalg.solve(np.eye(len(self.A)) - self.A, self.B)
        return np.asarray(self.C @ settled + self.D)


def sample(plant: StateSpace, period_s: float) -> SampledPlant:
    """Return the sampled model of ``plant`` with inputs that are held for a tick.

    Raises
    ------
    ValueError
        If the plant has direct feedthrough (D is not 0).
    """
    if np.any(plant.D):
        raise ValueError("a plant with direct feedthrough cannot be sampled here")
    n, inputs = plant.B.shape
    newer, older, ticks = np.zeros((n, inputs)), np.zeros((n, inputs)), []
    for i, delay in enumerate(plant.delay_s):
        whole_ticks = int(np.floor(delay / period_s + _ROUNDING))
        rest_s = max(0.0, float(delay) - whole_ticks * period_s)
        _, older_part = _advance(plant.A, plant.B[:, i], rest_s)
        rest_transition, newer_part = _advance(plant.A, plant.B[:, i], period_s - rest_s)
        older[:, i], newer[:, i] = rest_transition @ older_part, newer_part
        ticks.append(whole_ticks)
    transition, _ = _advance(plant.A, plant.B[:, 0], period_s)
    return SampledPlant(
        transition=transition,
        newer=newer,
        older=older,
        ticks=tuple(ticks),
        C=plant.C,
        period_s=period_s,
    )


def close_loop(
    plant: StateSpace,
    filters: tuple[DigitalFilter, ...],
    sensors: tuple[str, ...],
    names: tuple[str, ...],
    gains: tuple[float, ...] | None = None,
) -> ClosedLoop:
    """Return the closed loop of ``plant`` with one controller per input.

    Parameters
    ----------
    filters, sensors, names
        Per input: the difference equation of its controller, the controller's sensor output in
        counts, and its name.
    gains
        Factors on the controllers' gains; 1 when None.

    Raises
    ------
    MachineError
        If the dead times have too many ticks: each tick is a state.
    """
    period_s = filters[0].period_s
    sampled = sample(plant, period_s)
    m, n = len(filters), len(plant.A)
    factors = (1.0,) * m if gains is None else gains
    reading_rows = np.array([plant.C[plant.outputs.index(s)] for s in sensors])
    line_lengths = [t + 1 for t in sampled.ticks]
    if sum(line_lengths) > _MOST_TICKS:
        raise MachineError(
            f"{', '.join(f'controllers.{name}' for name in names)}: {sum(sampled.ticks):.6g} ticks "
            f"of {period_s:.4g} s fit into the dead time, but the analysis of a loop allows up to "
            f"{_MOST_TICKS}",
            remedy="Give the controller a longer clock, or its drive a shorter delay.",
        )
    starts = n + np.concatenate(([0], np.cumsum(line_lengths)[:-1])).astype(int)
    memory = n + sum(line_lengths)
    size = memory + 2 * m
    A, B = np.zeros((size, size)), np.zeros((size, m))
    outputs, feedthroughs = [], []
    A[:n, :n] = sampled.transition
    for i, digital in enumerate(filters):
        b, a = factors[i] * digital.numerator, digital.denominator
        first, second = memory + 2 * i, memory + 2 * i + 1
        error, error_in = np.zeros(size), np.zeros(m)
        error[:n], error_in[i] = -reading_rows[i], 1.0
        level, level_in = b[0] * error, b[0] * error_in
        level[first] += 1.0
        # Transposed direct form: s1 = b1 e - a1 u + s2, s2 = b2 e - a2 u.
        A[first], B[first] = b[1] * error - a[1] * level, b[1] * error_in - a[1] * level_in
        A[first, second] += 1.0
        A[second], B[second] = b[2] * error - a[2] * level, b[2] * error_in - a[2] * level_in
        line_start, ticks = int(starts[i]), sampled.ticks[i]
        A[line_start], B[line_start] = level, level_in
        for j in range(1, line_lengths[i]):
            A[line_start + j, line_start + j - 1] = 1.0
        if ticks == 0:
            A[:n] += np.outer(sampled.newer[:, i], level)
            B[:n] += np.outer(sampled.newer[:, i], level_in)
        else:
            A[:n, line_start + ticks - 1] += sampled.newer[:, i]
        A[:n, line_start + ticks] += sampled.older[:, i]
        outputs.append(level)
        feedthroughs.append(level_in)
    rows = np.zeros((len(plant.C), size))
    rows[:, :n] = plant.C
    return ClosedLoop(
        A=A,
        B=B,
        C=np.vstack([rows, outputs]),
        D=np.vstack([np.zeros((len(plant.C), m)), feedthroughs]),
        outputs=(*plant.outputs, *(f"controllers.{name}" for name in names)),
        period_s=period_s,
    )


def _advance(A: FloatArray, b: FloatArray, time_s: float) -> tuple[FloatArray, FloatArray]:
    """Return ``exp(A t)`` and ``integral of exp(A s) b ds`` over ``0 .. t``."""
    n = len(A)
    block = np.zeros((n + 1, n + 1))
    block[:n, :n], block[:n, n] = A, b
    exponential = expm(block * time_s)
    return exponential[:n, :n], exponential[:n, n]
