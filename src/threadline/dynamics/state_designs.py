r"""Designs of ``state-space`` controllers.

All designs run on the clock of the references and read only sensors: their knowledge of the load is
the estimate of an observer. The plant is sampled exactly, including dead time (``sampled``):

    X[k+1] = F X[k] + G (u[k] + d[k]),  y[k] = H X[k]

X holds the states of the plant and the voltages that dead time still delays. The unknown, slowly
drifting voltage d stands for friction and for errors of the gains.

``lqg``
    ``u = -K X + N r - d``, the optimal regulator for the cost ``sum (q e)^2 + u^2``, where e is the
    error of the loads in counts and u is in DAC levels. X and d are the estimates of a Kalman
    filter (Franklin, Powell and Workman, *Digital Control of Dynamic Systems*, chapter 9). With an
    integrating plant, q is the static gain of the resulting controller in DAC levels per count.
``preview``
    The same regulator for a reference that is known n ticks ahead (Tomizuka and Rosenthal, "On the
    optimal digital state vector feedback controller with integral and preview actions", Journal of
    Dynamic Systems, Measurement and Control 101, 1979): :math:`u = -K X + M \sum_{j \ge 0}
    (F_c^T)^j C^T q^2 r_{k+1+j}` with :math:`F_c = F - G K`. The reference is assumed constant after
    the last known one. The controller gets the references one by one, so it delays the motion by n
    ticks.
``zpetc``
    The regulator with a filter of its references, which cancels the poles and the decaying zeros of
    the closed loop, and the phase of all other zeros (Tomizuka, "Zero phase error tracking
    algorithm for digital control", Journal of Dynamic Systems, Measurement and Control 109, 1987).
    The filter also looks ahead, so the controller delays the motion by as many ticks.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag, eigvals, solve_discrete_are
from scipy.signal import tf2ss

from threadline.base.arrays import ComplexArray, FloatArray
from threadline.dynamics.groups import connected_groups
from threadline.dynamics.linear_model import linear_variants
from threadline.dynamics.matrix_controller import LoopPart, loop_parts
from threadline.dynamics.sampled import StateSpace, difference_equation, sample
from threadline.dynamics.values import Values
from threadline.errors import MachineError, OptionError
from threadline.machine import Machine
from threadline.machine.controllers import MOST_STATES, Dac
from threadline.machine.parts import Encoder

DESIGNS = ("lqg", "preview", "zpetc", "cross-coupled")
"""Names of all designs; the module ``contouring`` makes the last one."""
PREVIEW = (1, 40)
"""Smallest and largest number of references that a preview looks ahead."""
_LARGEST_CANCELLED = (
    0.999  # a zero with |z| above this, or with a negative real part, would ring if cancelled
)
_AVERAGES = 4  # number of moving averages
_DRIFT_LEVELS = 0.05
_NOISE_LEVELS = 1.0
"""Standard deviations in DAC levels per tick: of the drift of d, and of unknown changes of the
voltage that do not last. The latter is at least the rounding of the DAC."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Designed:
    """A designed state-space controller for one connected piece of a machine.

    Parameters
    ----------
    axes, sensors, drives
        References, sensors and drives of the controller, in the order of the machine file.
    clock, reference_clock
        Clock of the controller, and clock of its references if they come more slowly.
    A, B, C, D, L
        Matrices of the controller, as in the machine file.
    dac
        Output converter of each drive.
    delay_ticks
        Number of ticks by which the controller delays the motion in order to look ahead.
    """

    axes: tuple[str, ...]
    sensors: tuple[str, ...]
    drives: tuple[str, ...]
    clock: str
    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    L: FloatArray
    dac: Dac
    delay_ticks: int = 0
    reference_clock: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Regulator:
    """The plant of a piece on its clock, with feedback and observer; m drives, q sensors, n states.

    Parameters
    ----------
    F, G, push, H
        (n, n), (n, m), (n, m), (q, n): the plant with the delayed voltages as states, per DAC
        level; ``push`` is the effect of the unknown voltage, which is not delayed.
    load
        (m, n) from the states to the loads in counts.
    K
        (m, n) feedback from the states to DAC levels.
    observer
        (n + m, q) gain of the observer on the states and the unknown voltage.
    weight
        (m,) q of the cost, DAC levels per count.
    solution
        (n, n) solution of the Riccati equation of the feedback.
    """

    parts: tuple[LoopPart, ...]
    sensors: tuple[str, ...]
    clock: str
    F: FloatArray
    G: FloatArray
    push: FloatArray
    H: FloatArray
    load: FloatArray
    K: FloatArray
    observer: FloatArray
    weight: FloatArray
    solution: FloatArray

    @property
    def closed(self) -> FloatArray:
        """Return ``F - G K``, (n, n)."""
        return np.asarray(self.F - self.G @ self.K)

    def ahead(self, ticks: int) -> list[FloatArray]:
        """Return the (m, m) gains on the references; the gain on the last known reference is first.

        Parameters
        ----------
        ticks
            Number of ticks that the references are known ahead; 0 for none.
        """
        m, Fc = len(self.parts), self.closed
        input_gain = np.linalg.solve(np.eye(m) + self.G.T @ self.solution @ self.G, self.G.T)
        effect = self.load.T * self.weight**2
        gains = []
        for _ in range(max(ticks - 1, 0)):
            gains.append(input_gain @ effect)
            effect = Fc.T @ effect
        last_gain = input_gain @ np.linalg.solve(np.eye(len(Fc)) - Fc.T, effect)
        return [last_gain, *reversed(gains)]


def regulators(
    machine: Machine, gain: float = 1.0, others: tuple[str, ...] = ()
) -> list[Regulator]:
    """Return a regulator for every connected piece with axes.

    Parameters
    ----------
    gain
        q of the cost, as a multiple of the static gain of the present controller. If that
        controller has no static gain, because it integrates for example, 0.02 DAC levels per count
        is used.
    others
        Sensors to read besides the encoders of the axes.

    Raises
    ------
    MachineError
        If the axes of a piece have different clocks or DACs, or no feedback stabilises it.
    OptionError
        If a sensor does not exist, or belongs to no axis with a loop.
    """
    unknown = [name for name in others if name not in machine.observing]
    if unknown:
        raise OptionError(
            f"machine {machine.name!r} has no sensor {unknown[0]!r} without a loop",
            remedy=f"It has: {', '.join(machine.observing) or 'none'}.",
        )
    groups = [group for group in connected_groups(machine) if not group.sources]
    regulators = []
    for group, models in zip(groups, linear_variants(machine), strict=True):
        if not group.axes:
            continue
        parts = loop_parts(machine, group.controllers)
        loop_sensors = tuple(part.settings.sensor for part in parts)
        sensors = loop_sensors + tuple(name for name in others if name in group.sensors)
        weights = {part.axis: gain * _present_static_gain(machine, part) for part in parts}
        regulators.append(_regulator(machine, parts, sensors, models.one(0), weights))
    return regulators


def _present_static_gain(machine: Machine, part: LoopPart) -> float:
    """Return the static gain of the present controller, DAC levels per count."""
    if part.settings.kind == "state-space":
        return _USUAL_GAIN
    b, a = difference_equation(machine, part.controller, Values.of(machine))
    denominator_sum = 1.0 + float(a[0].sum())
    static_gain = float(b[0].sum()) / denominator_sum if abs(denominator_sum) > 1e-9 else 0.0
    return static_gain if static_gain > 0.0 else _USUAL_GAIN


_USUAL_GAIN = 0.02


def _regulator(
    machine: Machine,
    parts: tuple[LoopPart, ...],
    sensors: tuple[str, ...],
    model: StateSpace,
    gains: Mapping[str, float],
) -> Regulator:
    clock = machine.tick_clock
    dacs = {
        (p.settings.dac.bits.si, p.settings.dac.range.si, p.settings.dac.zero_on_reversal)
        for p in parts
    }
    if len(dacs) > 1 or any(not part.axis for part in parts):
        raise MachineError(
            f"the controllers {', '.join(part.controller for part in parts)} are of one connected "
            "piece, and have different DACs or no axis",
            place=machine.place,
            remedy="A design needs one DAC for all of them, and an axis for each.",
        )
    volt_per_level = parts[0].settings.dac.volt_per_level
    plant = model.select(
        [f"drives.{part.settings.drive}" for part in parts],
        [*(f"sensors.{name}" for name in sensors), *(f"{part.axis}.load" for part in parts)],
    )
    sampled = sample(plant, float(clock.period_s))
    m, q, n = len(parts), len(sensors), len(plant.A)
    line_lengths = [t + 1 for t in sampled.ticks]
    size = n + sum(line_lengths)
    F, G = np.zeros((size, size)), np.zeros((size, m))
    F[:n, :n] = sampled.transition
    line_start = n
    for i, ticks in enumerate(sampled.ticks):
        G[line_start, i] = 1.0
        for j in range(1, line_lengths[i]):
            F[line_start + j, line_start + j - 1] = 1.0
        if ticks == 0:
            G[:n, i] += volt_per_level * sampled.newer[:, i]
        else:
            F[:n, line_start + ticks - 1] += volt_per_level * sampled.newer[:, i]
        F[:n, line_start + ticks] += volt_per_level * sampled.older[:, i]
        line_start += line_lengths[i]
    counts = np.array([machine.axes[part.axis].counts.si for part in parts])
    H, load = np.zeros((q, size)), np.zeros((m, size))
    H[:, :n] = plant.C[:q]
    load[:, :n] = counts[:, None] * plant.C[q:]
    noise = np.diag([_variance(machine, name) for name in sensors])
    weight = np.array([gains[part.axis] for part in parts])
    try:
        solution = solve_discrete_are(F, G, load.T * weight**2 @ load, np.eye(m))
        K = np.asarray(np.linalg.solve(np.eye(m) + G.T @ solution @ G, G.T @ solution @ F))
        push = np.zeros((size, m))
        push[:n] = volt_per_level * (sampled.newer + sampled.older)
        observer = _observer(F, push, H, noise)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise MachineError(
            f"axes {', '.join(p.axis for p in parts)}: there is no optimal regulator, {error}",
            place=machine.place,
            remedy="Check bodies, links and sensors of these axes.",
        ) from error
    return Regulator(
        parts=parts, sensors=sensors, clock=clock.name, F=F, G=G, push=push, H=H, load=load, K=K,
        observer=observer, weight=weight, solution=solution,
    )  # fmt: skip


def _observer(F: FloatArray, push: FloatArray, H: FloatArray, noise: FloatArray) -> FloatArray:
    """Return the (n + m, q) gain of the Kalman filter, which uses the readings of the same tick."""
    n, m = push.shape
    F_and_drift = block_diag(F, np.eye(m))
    F_and_drift[:n, n:] = push
    H_and_drift = np.hstack([H, np.zeros((len(H), m))])
    process = block_diag(_NOISE_LEVELS**2 * push @ push.T, _DRIFT_LEVELS**2 * np.eye(m))
    P = solve_discrete_are(F_and_drift.T, H_and_drift.T, process, noise)
    return np.asarray(np.linalg.solve(H_and_drift @ P @ H_and_drift.T + noise, H_and_drift @ P).T)


def _variance(machine: Machine, name: str) -> float:
    """Return the variance of a sensor's readings due to quantisation (step^2 / 12) and noise."""
    sensor = machine.sensors[name]
    if isinstance(sensor, Encoder):
        return 1.0 / 12.0
    step = 0.0 if sensor.resolution is None else sensor.resolution.si
    noise = 0.0 if sensor.noise is None else sensor.noise.si
    variance = step**2 / 12.0 + noise**2
    if variance == 0.0:
        raise MachineError(
            f"sensors.{name} has neither noise nor resolution, so that an observer would believe "
            "it without bounds",
            place=machine.place,
            remedy="Give it a noise or a resolution.",
        )
    return variance


def lqg(regulator: Regulator) -> Designed:
    """Return the regulator with its observer as a controller."""
    return preview(regulator, 0)


def preview(regulator: Regulator, ticks: int) -> Designed:
    """Return the regulator for references that are known ``ticks`` ahead; 0 for no preview."""
    gains = regulator.ahead(ticks)
    m = len(regulator.parts)
    shift = np.zeros((m * (len(gains) - 1),) * 2)
    shift[m:, : -m or None] = np.eye(max(len(shift) - m, 0)) if len(shift) else 0.0
    first_place = np.zeros((len(shift), m))
    first_place[:m] = np.eye(m)[: len(shift)]
    through = np.hstack(gains[1:]) if len(gains) > 1 else np.zeros((m, 0))
    return _joined(regulator, (shift, first_place, through, gains[0]), ticks)


def zero_phase(regulator: Regulator, delay_ticks: int, smoothing_ticks: int = 1) -> Designed:
    """Return the regulator with a zero-phase filter of its reference.

    Parameters
    ----------
    delay_ticks
        Number of ticks by which the controller delays the motion, at least ``zero_phase_ticks``;
        the same for all axes of a machine, so that they stay synchronous.
    smoothing_ticks
        Length of each of four moving averages of the references before the filter, an odd number.
        They add no phase. They are needed because references are whole counts, and an inverse would
        amplify the steps.
    """
    poles, cancelled, kept_zeros, gain = _reference_to_load(regulator)
    static_gain = regulator.ahead(0)[0][0, 0]
    numerator = np.poly(poles)
    for zero in kept_zeros:
        numerator = np.convolve(numerator, [-zero, 1.0])
    # The moving averages and the reversed zeros of the numerator look ahead by these ticks.
    look_ahead = delay_ticks + len(kept_zeros) + _AVERAGES * (smoothing_ticks - 1) // 2
    denominator = np.convolve(np.poly(cancelled).real * gain, np.eye(1, look_ahead + 1)[0])
    denominator = denominator * np.prod((1.0 - kept_zeros) ** 2).real
    for _ in range(_AVERAGES):
        numerator = np.convolve(numerator, np.full(smoothing_ticks, 1.0 / smoothing_ticks))
    A, B, C, D = tf2ss(numerator.real, denominator)
    A, B, C, D = _balanced(A, B, C, D)
    return _joined(regulator, (A, B, static_gain * C, static_gain * D), delay_ticks)


def zero_phase_ticks(regulator: Regulator, smoothing_ticks: int = 1) -> int:
    """Return the smallest number of ticks by which a zero-phase filter must look ahead.

    Raises
    ------
    MachineError
        If drives of several axes share bodies.
    """
    if len(regulator.parts) > 1:
        raise MachineError(
            f"axes {', '.join(part.axis for part in regulator.parts)} are one connected piece, and "
            "zero-phase tracking is made for one drive and one load",
            remedy="Choose another design.",
        )
    poles, cancelled, _, _ = _reference_to_load(regulator)
    return len(poles) - len(cancelled) + _AVERAGES * (smoothing_ticks - 1) // 2


def _reference_to_load(
    regulator: Regulator,
) -> tuple[ComplexArray, ComplexArray, ComplexArray, float]:
    """Return poles, zeros to cancel, other zeros, and gain, from reference to load."""
    Fc, G = regulator.closed, regulator.G * regulator.ahead(0)[0]
    n = len(Fc)
    system = np.block([[Fc, G], [regulator.load, np.zeros((1, 1))]])
    pencil = block_diag(np.eye(n), np.zeros((1, 1)))
    zeros: ComplexArray = np.asarray(eigvals(system, pencil), dtype=np.complex128)
    zeros = zeros[np.isfinite(zeros) & (np.abs(zeros) < _LARGEST_ZERO)]
    poles = np.linalg.eigvals(Fc).astype(np.complex128)
    is_kept = (np.abs(zeros) > _LARGEST_CANCELLED) | (zeros.real < 0.0)
    cancelled, kept_zeros = zeros[~is_kept], zeros[is_kept]
    z = np.exp(0.3j)
    response = (regulator.load @ np.linalg.solve(z * np.eye(n) - Fc, G))[0, 0]
    gain = response * np.prod(z - poles) / np.prod(z - zeros)
    return poles, np.asarray(cancelled), np.asarray(kept_zeros), float(gain.real)


_LARGEST_ZERO = 1e4


def _balanced(
    A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the same filter with states of similar magnitude."""
    size = np.maximum(np.abs(C).max(axis=0), 1e-12) ** 0.5
    return A * size[:, None] / size[None, :], B * size[:, None], C / size, D


def _joined(
    regulator: Regulator,
    filtered: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    delay_ticks: int,
) -> Designed:
    """Return feedback, observer and a filter of the references as one controller.

    The output of the filter is the contribution of the references to the outputs.
    """
    Af, Bf, Cf, Df = filtered
    m, n, q = len(regulator.parts), len(regulator.F), len(regulator.H)
    F = block_diag(regulator.F, np.eye(m))
    F[:n, n:] = regulator.push
    G = np.vstack([regulator.G, np.zeros((m, m))])
    H = np.hstack([regulator.H, np.zeros((q, m))])
    K = np.hstack([regulator.K, np.eye(m)])
    prediction = np.eye(n + m) - regulator.observer @ H
    f = len(Af)
    A = np.zeros((n + m + f, n + m + f))
    A[: n + m, : n + m] = (F - G @ K) @ prediction
    A[: n + m, n + m :] = G @ Cf
    A[n + m :, n + m :] = Af
    B = np.zeros((n + m + f, m + q))
    B[: n + m, :m], B[: n + m, m:] = G @ Df, (F - G @ K) @ regulator.observer
    B[n + m :, :m] = Bf
    if len(A) > MOST_STATES:
        raise MachineError(
            f"axes {', '.join(p.axis for p in regulator.parts)}: the design has {len(A)} states, "
            f"limit {MOST_STATES}",
            remedy="Choose fewer references ahead, or a design without an observer.",
        )
    return Designed(
        axes=tuple(part.axis for part in regulator.parts),
        sensors=regulator.sensors,
        drives=tuple(part.settings.drive for part in regulator.parts),
        clock=regulator.clock,
        A=A,
        B=B,
        C=np.hstack([-K @ prediction, Cf]),
        D=np.hstack([Df, -K @ regulator.observer]),
        L=np.vstack([G, np.zeros((f, m))]),
        dac=regulator.parts[0].settings.dac,
        delay_ticks=delay_ticks,
    )
