"""Exact inverse of an axis: from the motion of its load to the controller's voltage.

The solution of ``x' = Q x + f(t)`` after a step T is ``x(T) = e^(QT) x(0) + int e^(Q(T-s)) f(s)
ds``. Here f is replaced by the polynomial through its known values. The integral for a polynomial
is exact, by the phi functions of Q T (Hochbruck and Ostermann, Exponential integrators, Acta
Numerica 2010). Quadrature of the whole integrand would be accurate only if ``|Q| T`` is small,
which is not so for instance with the zero k/c of a damped belt.

From the controller's voltage u to the load y there are r integrations: ``y^(r) = C A^r x + g u``.
The states are the position and the derivatives of the load and, if the plant has zeros (the Y frame
of the stitcher), inner states that depend only on the motion: ``eta' = Q eta + R (y ... y^(r-1))``.
The eigenvalues of Q are the zeros of the plant; an inverse exists only if all of them decay. The
inverse includes belt, load damping, frame, motor and coil. It does not include the dead time: the
caller sends the voltage earlier by the dead time.

The references of feed-forward are the inverse ``1 / T0`` of the nominal machine, applied to the
intended motion of the load. A machine with the closed loop ``T`` responds with ``T / T0``. Dead
time, the hold of the references and the grid of the references are the same in T and T0 and cancel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm, null_space

from threadline.base.arrays import FloatArray
from threadline.dynamics.loop import Loop, axis_loop
from threadline.dynamics.margins import not_decaying
from threadline.dynamics.poles import Chain, chain_of
from threadline.dynamics.sampled import StateSpace, sample
from threadline.dynamics.values import Values
from threadline.errors import MachineError
from threadline.machine import Machine


def decay_and_moments(Q: FloatArray, step_s: float, count: int) -> tuple[FloatArray, FloatArray]:
    """Return ``e^(Q T)`` and ``T int_0^1 e^(Q T (1-z)) z^k dz`` for k from 0 to ``count`` - 1.

    Parameters
    ----------
    Q
        (n, n) matrix of the states, in 1/s.
    step_s
        Length T of the step, in s.
    count
        Number of powers z^k: the degree of the force's polynomial + 1.

    Returns
    -------
    The (n, n) decay, and the (count, n, n) moments in s.
    """
    n = len(Q)
    block = np.zeros((n * (count + 1), n * (count + 1)))
    block[:n, :n] = Q * step_s
    for k in range(count):
        block[n * k : n * (k + 1), n * (k + 1) : n * (k + 2)] = np.eye(n)
    row = expm(block)[:n]
    factorials = np.cumprod([1.0, *range(1, count)])
    moments = [step_s * factorials[k] * row[:, n * (k + 1) : n * (k + 2)] for k in range(count)]
    return row[:, :n], np.stack(moments)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Followed:
    """Sensor reading, voltage and current of an axis whose load follows a motion exactly.

    Parameters
    ----------
    time_s
        (k,) instants, in s.
    load_si
        (k,) position of the load, m or rad.
    measured_counts
        (k,) reading of the controller's sensor, in counts.
    volts
        (k,) voltage that acts on the plant at these instants: dead time is not included.
    current_a
        (k,) current of the motor, in A; None if it is not a state of the plant.
    """

    time_s: FloatArray
    load_si: FloatArray
    measured_counts: FloatArray
    volts: FloatArray
    current_a: FloatArray | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Inverse:
    """The inverse of an axis in normal form: ``x = from_load (y ... y^(r-1)) + from_inner eta``.

    Parameters
    ----------
    axis, loop
        Name of the axis, and its loop.
    plant
        State space, with n states, from the controller's voltage to the load in m or rad.
    chain
        The r integrations from the controller's voltage to the load.
    from_load, from_inner
        (n, r) matrix from the position and the derivatives of the load to the states of the plant,
        and (n, n - r) matrix from the inner states to them.
    Q, R
        (n - r, n - r) and (n - r, r): ``eta' = Q eta + R (y ... y^(r-1))``.
    """

    axis: str
    loop: Loop
    plant: StateSpace
    chain: Chain
    from_load: FloatArray
    from_inner: FloatArray
    Q: FloatArray
    R: FloatArray

    @property
    def degree(self) -> int:
        """Number r of derivatives of the motion that the inverse needs; only the r-th may step."""
        return self.chain.degree

    def outputs(
        self, time_s: FloatArray, derivatives: FloatArray, inner: FloatArray, start_si: float
    ) -> Followed:
        """Return sensor reading, voltage and current for a motion of the load and inner states.

        Parameters
        ----------
        time_s
            (k,) instants, in s.
        derivatives
            (k, degree + 1) position of the load and its derivatives.
        inner
            (k, n - degree) inner states; they are 0 at rest.
        start_si
            Position of the load before the motion, m or rad.
        """
        r = self.degree
        states = derivatives[:, :r] @ self.from_load.T + inner @ self.from_inner.T
        states += self._rest(start_si)
        volts = (derivatives[:, r] - states @ self.chain.rows[r]) / self.chain.gain
        coil_states = [k for k, name in enumerate(self.plant.states) if name.endswith(".i")]
        return Followed(
            time_s=time_s,
            load_si=derivatives[:, 0],
            measured_counts=states @ self.loop.axis_plant().C[0],
            volts=volts,
            current_a=states[:, coil_states[0]] if len(coil_states) == 1 else None,
        )

    def _rest(self, start_si: float) -> FloatArray:
        # Inner states are relative to their values at rest, which depend on the load's position.
        if not len(self.Q) or start_si == 0.0:
            return np.zeros(len(self.plant.A))
        rest_derivatives = np.zeros(self.degree)
        rest_derivatives[0] = start_si
        return np.asarray(self.from_inner @ -np.linalg.solve(self.Q, self.R @ rest_derivatives))


def _check_single(machine: Machine, loop: Loop) -> None:
    """Refuse an axis whose connected piece has a state-space controller."""
    if not loop.single:
        raise MachineError(
            f"axis {loop.axis}: controllers.{machine.axes[loop.axis].controller} or one beside it "
            "has the kind state-space; options that need the exact inverse of a loop "
            "(feed-forward, learning, a limit on the contour) are for one error, one encoder and "
            "one drive",
            place=machine.place,
            remedy="Leave that option out, or give the axis a controller of another kind.",
        )


def inverse_of(machine: Machine, axis: str, values: Values | None = None) -> Inverse:
    """Return the exact inverse of an axis, from the load's motion to the controller's voltage.

    Parameters
    ----------
    values
        Numbers for the inverse; None: the numbers of ``machine``.

    Raises
    ------
    OptionError
        If there is no such axis.
    MachineError
        If other drives act on the same bodies, or the plant's zeros do not decay.
    """
    loop = axis_loop(machine, axis, values)
    _check_single(machine, loop)
    if len(loop.filters) > 1:
        raise MachineError(
            f"axis {axis} shares bodies with the drives of other axes",
            place=machine.place,
            remedy="Only an axis whose bodies no other drive moves has an inverse.",
        )
    plant = loop.plant.select([loop.plant.inputs[loop.index]], [f"{axis}.load"])
    chain = chain_of(plant)
    r, n = chain.degree, len(plant.A)
    # The inner states are combinations W x on which the voltage does not act: W b = 0.
    chain_rows = chain.rows[:r]
    scale = np.linalg.norm(chain_rows, axis=1)[:, None]
    inner_space = null_space(plant.B.T / np.linalg.norm(plant.B)).T
    inner_rows = _independent(inner_space, chain_rows / scale, n - r)
    transform = np.vstack([chain_rows / scale, inner_rows])
    inverse_transform = np.linalg.inv(transform)
    from_load, from_inner = inverse_transform[:, :r] / scale.T, inverse_transform[:, r:]
    Q, R = inner_rows @ plant.A @ from_inner, inner_rows @ plant.A @ from_load
    not_decaying_zeros = not_decaying(Q)
    if len(not_decaying_zeros):
        worst_zero = not_decaying_zeros[0]
        raise MachineError(
            f"axis {axis}: its inverse is unstable, the plant has a zero at {worst_zero:.4g} rad/s",
            place=machine.place,
            remedy="Give the frame damping, or define the load as the body next to the motor.",
        )
    return Inverse(
        axis=axis,
        loop=loop,
        plant=plant,
        chain=chain,
        from_load=from_load,
        from_inner=from_inner,
        Q=Q,
        R=R,
    )


def _independent(candidates: FloatArray, rows: FloatArray, count: int) -> FloatArray:
    """Return ``count`` combinations of ``candidates`` that are independent of ``rows``."""
    if count == 0:
        return np.empty((0, candidates.shape[1]))
    # The component of the candidates' space that is orthogonal to ``rows``.
    projected = rows @ candidates.T @ candidates
    _, _, vectors = np.linalg.svd(projected @ candidates.T)
    rank = candidates.shape[0] - count
    return np.asarray(vectors[rank:] @ candidates)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CornerResponse:
    """Frequency response of load, sensor and motor current of a machine to planned references.

    Parameters
    ----------
    load
        (k,) velocity of the load / intended velocity.
    sensor
        (k,) reading of the controller's sensor / its reading on the machine for which the
        references were planned.
    current_s_a_m
        (k,) current of the motor / intended velocity, A s/m or A s/rad; None without a coil.
    """

    load: NDArray[np.complex128]
    sensor: NDArray[np.complex128]
    current_s_a_m: NDArray[np.complex128] | None


def corner_responses(
    machine: Machine, axis: str, corners: Sequence[Machine], omega_rad_s: FloatArray
) -> list[CornerResponse]:
    """Return the response of each of ``corners`` to references planned for ``machine``.

    Parameters
    ----------
    omega_rad_s
        (k,) frequencies above 0.
    """
    nominal = closed_responses(machine, axis, omega_rad_s)
    responses = []
    for corner in corners:
        actual = closed_responses(corner, axis, omega_rad_s)
        load, current = actual.load / nominal.load, actual.current_s_a_m
        responses.append(
            CornerResponse(
                load=load,
                sensor=actual.sensor / nominal.sensor,
                current_s_a_m=None if current is None else current * load,
            )
        )
    return responses


def closed_responses(machine: Machine, axis: str, omega_rad_s: FloatArray) -> CornerResponse:
    """Return the closed-loop responses of an axis to its reference, sampled at the filter's ticks.

    Parameters
    ----------
    omega_rad_s
        (k,) frequencies above 0.

    Returns
    -------
    CornerResponse
        ``load``: m or rad per count of the reference. ``sensor``: counts per count of the
        reference. ``current_s_a_m``: current / velocity of the load.
    """
    loop, omega = axis_loop(machine, axis), omega_rad_s
    _check_single(machine, loop)
    plant = loop.plant
    coil_states = [k for k, name in enumerate(plant.states) if name.endswith(".i")]
    rows = [f"{loop.axis}.load", loop.sensors[loop.index]]
    load_and_sensor = plant.select([plant.inputs[loop.index]], rows)
    sampled = sample(load_and_sensor, loop.period_s).response(omega)[:, :, 0]
    D = loop.filters[loop.index].sampled_response(omega)
    load = sampled[:, 0] * D / (1.0 + sampled[:, 1] * D)
    sensor = sampled[:, 1] * D / (1.0 + sampled[:, 1] * D)
    if len(coil_states) != 1:
        return CornerResponse(load=load, sensor=sensor, current_s_a_m=None)
    coil_row = np.zeros((1, len(plant.A)))
    coil_row[0, coil_states[0]] = 1.0
    with_coil = replace(
        load_and_sensor,
        C=np.vstack([load_and_sensor.C[:1], coil_row]),
        D=np.zeros((2, 1)),
        outputs=(rows[0], plant.states[coil_states[0]]),
    ).response(omega)[:, :, 0]
    current = with_coil[:, 1] / (1j * omega * with_coil[:, 0])
    return CornerResponse(load=load, sensor=sensor, current_s_a_m=current)
