"""Equations of a cylinder, and the vibration of the frame under it.

With the stroke ``s = w - z`` (position of the piston minus position of the housing), the flow speed
``v`` and the elongation ``e`` of the air between flow and piston::

    v' = (speed level(t - delay) - v) / lag
    e' = v - s'
    F  = k e + c (v - s') - friction,   on the piston; -F on the housing

A shaper therefore acts on the *speed* of the flow, which determines the force. Bodies and links are
part of the network, as in any other machine.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from threadline.base.arrays import FloatArray, Recent
from threadline.dynamics.margins import DOUBLE, size_of, swinging
from threadline.dynamics.network import PiecewiseLinear, piecewise_linear
from threadline.dynamics.values import Values
from threadline.errors import MachineError
from threadline.machine import Machine
from threadline.machine.pneumatics import ATMOSPHERE_PA, SPRING_OF_FORCE
from threadline.machine.quantity import Quantity


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CylinderEquations:
    """Linear equations of one cylinder and its network piece.

    Parameters
    ----------
    axis
        Name of the cylinder.
    states
        (n,) names: the states of the network, then ``"flow"`` (v, m/s) and ``"air"`` (e, m).
    matrix
        (variants, n, n) rates of the states without the force of the air on the bodies.
    level
        (variants, n) contribution of a level of 1 to the rates.
    force
        (variants, n) contribution of a force of 1 N on the piston, and of its reaction on the
        housing, to the rates.
    stroke, stroke_rate
        (n,) rows of ``s`` and ``s'``.
    frame
        (variants, n) row of the position of the frame.
    piston, housing
        Indices of the velocities of the two bodies.
    piston_share
        (variants,) piston inertia / (piston inertia + housing inertia).
    piston_inertia
        (variants,) in kg.
    air_stiffness, air_damping
        (variants,) in N/m and N s/m.

    For a rotary cylinder the stroke is in rad, forces are torques in N m, and inertias are in
    kg m^2.
    """

    axis: str
    states: tuple[str, ...]
    matrix: FloatArray
    level: FloatArray
    force: FloatArray
    stroke: FloatArray
    stroke_rate: FloatArray
    frame: FloatArray
    piston: int
    housing: int
    piston_share: FloatArray
    piston_inertia: FloatArray
    air_stiffness: FloatArray
    air_damping: FloatArray

    def air_force(self, ramp: float = 1.0) -> FloatArray:
        """Return the (variants, n) row of the air force in N; ``ramp`` multiplies its damping."""
        damping = self.air_damping * ramp
        row = -damping[:, None] * self.stroke_rate
        row[:, self.states.index("air")] += self.air_stiffness
        row[:, self.states.index("flow")] += damping
        return row

    def joined(self, row: FloatArray) -> FloatArray:
        """Return the (variants, n) row of the joint acceleration of a piston stuck in its housing.

        Parameters
        ----------
        row
            (variants, n, n) rates of all states while piston and housing move independently.
        """
        share = self.piston_share[:, None]
        return share * row[:, self.piston] + (1.0 - share) * row[:, self.housing]

    def sliding(self, ramp: float = 1.0) -> FloatArray:
        """Return the (variants, n, n) rates while the piston slides, driven by the air."""
        return self.matrix + self.force[:, :, None] * self.air_force(ramp)[:, None, :]

    def standing(self) -> FloatArray:
        """Return the (variants, n, n) rates while the piston sticks in its housing."""
        rates = self.matrix.copy()
        joint_row = self.joined(self.matrix)
        rates[:, self.piston] = rates[:, self.housing] = joint_row
        return rates

    def holding(self) -> FloatArray:
        """Return the (variants, n) row of the force in N that holds the piston in its housing.

        The force is the inertia of the piston times the difference between its acceleration
        together with the housing and its free acceleration. The force of the air is not included.
        """
        acceleration = self.joined(self.matrix) - self.matrix[:, self.piston]
        return self.piston_inertia[:, None] * acceleration


def network_of(machine: Machine, axis: str, values: Values | None = None) -> PiecewiseLinear:
    """Return the network piece on which the cylinder ``axis`` acts.

    Raises
    ------
    MachineError
        If the piece has nonlinear elements, or the cylinder connects two pieces.
    """
    cylinder = machine.cylinders[axis]
    for piece in piecewise_linear(machine, values):
        if cylinder.pushes in piece.group.bodies:
            if cylinder.reacts_on not in piece.group.bodies:
                raise MachineError(
                    f"cylinders.{axis}: {cylinder.pushes!r} and {cylinder.reacts_on!r} are not "
                    "connected",
                    remedy="Join them with a link; its stiffness may be 0.",
                )
            if piece.elements:
                raise MachineError(
                    f"cylinders.{axis}: {piece.elements[0].name} is not linear",
                    remedy="Omit friction, play and preload of the bodies that it moves.",
                )
            return piece
    raise MachineError(f"cylinders.{axis} pushes a body that does not exist")


def cylinder_equations(
    machine: Machine, axis: str, values: Values | None = None
) -> CylinderEquations:
    """Return the equations of the cylinder ``axis`` in every variant.

    Parameters
    ----------
    values
        Numbers that replace the machine's; None for the machine's numbers.

    Raises
    ------
    MachineError
        If its network piece is not linear, or the cylinder connects two pieces.
    """
    all_values = Values.of(machine) if values is None else values
    cylinder, piece = machine.cylinders[axis], network_of(machine, axis, all_values)

    def number(path: str, quantity: Quantity | None) -> FloatArray:
        return np.broadcast_to(
            np.asarray(all_values.at(path, quantity), dtype=float), (all_values.count,)
        )

    states = (*piece.states, "flow", "air")
    n, size = len(states), len(piece.states)
    flow, air = size, size + 1
    matrix = np.zeros((all_values.count, n, n))
    matrix[:, :size, :size] = piece.base[:, :, :size]
    stroke, rate, force = np.zeros(n), np.zeros(n), np.zeros((all_values.count, n))
    inertia = {}
    for body, sign in ((cylinder.pushes, 1.0), (cylinder.reacts_on, -1.0)):
        stroke[states.index(body)] = sign
        rate_index = states.index(f"{body}'")
        rate[rate_index] = sign
        inertia[body] = number(f"bodies.{body}.inertia", machine.bodies[body].inertia)
        force[:, rate_index] = sign / inertia[body]
    where = f"cylinders.{axis}"
    lag = number(f"{where}.lag", cylinder.lag)
    level = np.zeros((all_values.count, n))
    level[:, flow] = number(f"{where}.speed", cylinder.speed) / lag
    matrix[:, flow, flow] = -1.0 / lag
    matrix[:, air] -= rate
    matrix[:, air, flow] += 1.0
    frame = np.zeros((all_values.count, n))
    for body, weight in cylinder.frame.items():
        frame[:, states.index(body)] = number(f"{where}.frame.{body}", weight)
    piston_inertia = inertia[cylinder.pushes]
    return CylinderEquations(
        axis=axis,
        states=states,
        matrix=matrix,
        level=level,
        force=force,
        stroke=stroke,
        stroke_rate=rate,
        frame=frame,
        piston=states.index(f"{cylinder.pushes}'"),
        housing=states.index(f"{cylinder.reacts_on}'"),
        piston_share=piston_inertia / (piston_inertia + inertia[cylinder.reacts_on]),
        piston_inertia=piston_inertia,
        air_stiffness=_air_stiffness(machine, axis, number),
        air_damping=number(f"{where}.air_damping", cylinder.air_damping),
    )


def _air_stiffness(
    machine: Machine, axis: str, number: Callable[[str, Quantity | None], FloatArray]
) -> FloatArray:
    """Return the (variants,) stiffness of the air, as given or from pressure, area and radius."""
    cylinder, path = machine.cylinders[axis], f"cylinders.{axis}"
    torque = cylinder.torque
    if torque is None:
        return number(f"{path}.air_stiffness", cylinder.air_stiffness)
    pistons: FloatArray | float = 1.0
    if torque.pistons is not None:
        pistons = number(f"{path}.torque.pistons", torque.pistons)
    area_radius = number(f"{path}.torque.area", torque.area) * number(
        f"{path}.torque.radius", torque.radius
    )
    pressure_pa = number(f"{path}.torque.pressure", torque.pressure) + ATMOSPHERE_PA
    stroke = number(f"{path}.stroke", cylinder.stroke)
    return np.asarray(SPRING_OF_FORCE * pressure_pa * area_radius * pistons / stroke)


def frame_mode(machine: Machine, axis: str) -> tuple[float, float]:
    """Return undamped frequency in Hz and damping ratio of the slowest mode of the network.

    The piston slides freely and the air exerts no force.

    Raises
    ------
    MachineError
        If the network has no vibration mode.
    """
    piece = network_of(machine, axis)
    ringing = swinging(piece.base[0][:, : len(piece.states)])
    if not len(ringing):
        raise MachineError(f"cylinders.{axis}: its network has no vibration mode")
    slowest = min(ringing, key=abs)
    return abs(slowest) / (2.0 * math.pi), float(-slowest.real / abs(slowest))


@dataclass(frozen=True, slots=True)
class StepRinging:
    """Vibration of the frame after a step of the valve level.

    Parameters
    ----------
    pole
        Pole of the frame's slowest mode in 1/s, imaginary part positive.
    amplitude_m
        Complex amplitude of the frame for a step of 1: at time t after the step, the mode displaces
        the frame by ``Re(amplitude exp(pole t))`` from its rest position.
    """

    pole: complex
    amplitude_m: complex


def _same_cylinder(one: tuple[Machine, str], other: tuple[Machine, str]) -> bool:
    return one[0] is other[0] and one[1] == other[1]


# Cached, because every run of a cycle needs the ringing of the same nominal machine.
_RECENT: Recent[tuple[Machine, str], StepRinging] = Recent(8, _same_cylinder)


def step_ringing(machine: Machine, axis: str) -> StepRinging:
    """Return the vibration after a step of the level, by eigenvectors of the sliding cylinder.

    The delay of the valves is omitted, because it shifts every step equally.

    Raises
    ------
    MachineError
        If the network has no vibration mode, or its slowest mode is so slow, compared with other
        rates, that rounding errors hide it.
    """
    return _RECENT.of((machine, axis), lambda: _step_ringing(machine, axis))


def _step_ringing(machine: Machine, axis: str) -> StepRinging:
    plant = cylinder_equations(machine, axis)
    matrix = plant.sliding()[0]
    poles, modes = np.linalg.eig(matrix)
    frame_rad_s = 2.0 * math.pi * frame_mode(machine, axis)[0]
    # A state that does not depend on other states, such as the lag of a valve, does not affect the
    # accuracy of the other poles, so its rate is excluded from the norm.
    is_coupled = (matrix - np.diag(np.diag(matrix))).any(axis=1)
    ringing = np.flatnonzero(poles.imag > DOUBLE * size_of(matrix[np.ix_(is_coupled, is_coupled)]))
    if not len(ringing):
        raise MachineError(
            f"cylinders.{axis}: the mode of its frame at {frame_rad_s / (2.0 * math.pi):.3g} Hz "
            "is lost "
            "in rounding: rates of the cylinder are ten million times as fast",
            place=machine.place,
            remedy="Look for a mistyped number.",
        )
    # The air spring shifts the mode a little, so take the nearest pole.
    index = int(ringing[np.argmin(np.abs(np.abs(poles[ringing]) - frame_rad_s))])
    # x is a sum over modes; the amplitude of a mode after a step is (left vector . b) / pole. The
    # zero poles of a free stroke make the matrix defective, but the vectors of this simple pole are
    # still exact.
    left_poles, left_vectors = np.linalg.eig(matrix.T)
    match = left_vectors[:, int(np.argmin(np.abs(left_poles - poles[index])))]
    share = (match @ plant.level[0]) / (match @ modes[:, index]) / poles[index]
    return StepRinging(
        complex(poles[index]), complex(2.0 * share * (plant.frame[0] @ modes[:, index]))
    )


def opening_ringing_m(machine: Machine, axis: str, level: float, open_s: float) -> float:
    """Return the vibration amplitude of the frame, m, after a flow of ``level`` for ``open_s``.

    The flow is a step and, ``open_s`` later, the opposite step: ``|a (exp(p t) - 1)|``.

    Raises
    ------
    MachineError
        As for ``step_ringing``.
    """
    step = step_ringing(machine, axis)
    return float(abs(level * step.amplitude_m * (np.exp(step.pole * open_s) - 1.0)))


def flow_mode(machine: Machine, axis: str) -> tuple[float, float]:
    """Return undamped frequency in Hz and damping ratio of the mode excited by the valves.

    The air couples the mass of the piston to the frame. The frequency is therefore lower than with
    a free piston (``frame_mode``).

    Raises
    ------
    MachineError
        If the network has no vibration mode.
    """
    pole = step_ringing(machine, axis).pole
    return abs(pole) / (2.0 * math.pi), -pole.real / abs(pole)


def short_of_torque(machine: Machine) -> list[str]:
    """Return a warning for each rotary cylinder with too little torque for its load.

    The speed follows the flow with a first-order lag, so the initial acceleration of the load is
    the speed divided by the lag. At this time the exhaust still has pressure, which reduces the
    available torque.
    """
    warnings = []
    for name, cylinder in machine.cylinders.items():
        if cylinder.torque is None:
            continue
        inertia, friction = machine.bodies[cylinder.pushes].inertia.si, cylinder.friction
        needed = inertia * cylinder.speed.si / cylinder.lag.si
        needed += 0.0 if friction is None else friction.si
        available = cylinder.torque.torque_n_m
        if needed > available:
            speed = cylinder.pace(cylinder.speed.si, ".4g")
            warnings.append(
                f"cylinders.{name}: {inertia:.4g} kg m^2 come to {speed} within the lag of "
                f"{1e3 * cylinder.lag.si:.4g} ms by a torque of {needed:.4g} N m, and pressure, "
                f"area and radius give {available:.4g} N m: the arm will be slower"
            )
    return warnings
