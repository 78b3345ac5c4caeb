"""Equations of a cylinder: a flow that sets its speed, a lag, the spring of the air, the network.

With the stroke ``s = w - z`` (piston less housing), the flow speed ``v`` and the elongation ``e``
of the air between the flow and the piston::

    v' = (speed level(t - delay) - v) / lag
    e' = v - s'
    F  = k e + c (v - s') - friction,   on the piston; -F on the housing

so that a shaper acts on *speed*: the force follows from it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from threadline.arrays import FloatArray
from threadline.errors import MachineError
from threadline.machine import Machine
from threadline.plant.network import PiecewiseLinear, piecewise_linear


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CylinderPlant:
    """Linear equations of one cylinder and everything that it is connected with.

    Parameters
    ----------
    axis
        The cylinder.
    states
        (n,) names: those of the network, then ``"flow"`` (m/s) and ``"air"`` (m).
    matrix
        (n, n) of the network alone with flow and air: no air force, no damping of the air.
    level
        (n,) what a level of 1 adds to the derivative.
    force
        (n,) what 1 N of the piston, with its reaction, adds to the derivative.
    stroke, stroke_rate
        (n,) rows of ``s`` and ``s'``.
    frame
        (n,) row of the frame.
    flow, air
        Indices of the two states.
    """

    axis: str
    states: tuple[str, ...]
    matrix: FloatArray
    level: FloatArray
    force: FloatArray
    stroke: FloatArray
    stroke_rate: FloatArray
    frame: FloatArray
    flow: int
    air: int

    def air_force(self, stiffness: float, damping: float) -> FloatArray:
        """Return the (n,) row of the force of the air, N."""
        row = -damping * self.stroke_rate
        row[self.air] += stiffness
        row[self.flow] += damping
        return row


def network_of(machine: Machine, axis: str) -> PiecewiseLinear:
    """Return the piece of the network that the cylinder ``axis`` acts on.

    Raises
    ------
    MachineError
        If the piece has elements that are not linear, or the cylinder joins two pieces.
    """
    cylinder = machine.cylinders[axis]
    for piece in piecewise_linear(machine):
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
                    remedy="Leave friction, play and preload out of the bodies that it moves.",
                )
            return piece
    raise MachineError(f"cylinders.{axis} pushes a body that does not exist")


def cylinder_plant(machine: Machine, axis: str) -> CylinderPlant:
    """Return the equations of the cylinder ``axis``.

    Raises
    ------
    MachineError
        If it has none.
    """
    cylinder, piece = machine.cylinders[axis], network_of(machine, axis)
    states = (*piece.states, "flow", "air")
    n, size = len(states), len(piece.states)
    flow, air = size, size + 1
    matrix = np.zeros((n, n))
    matrix[:size, :size] = piece.base[0][:, :size]
    stroke, rate, force = np.zeros(n), np.zeros(n), np.zeros(n)
    for body, sign in ((cylinder.pushes, 1.0), (cylinder.reacts_on, -1.0)):
        stroke[states.index(body)] = sign
        at = states.index(f"{body}'")
        rate[at] = sign
        force[at] = sign / machine.bodies[body].inertia.si
    level = np.zeros(n)
    level[flow] = cylinder.speed.si / cylinder.lag.si
    matrix[flow, flow] = -1.0 / cylinder.lag.si
    matrix[air] -= rate
    matrix[air, flow] += 1.0
    frame = np.zeros(n)
    for body, weight in cylinder.frame.items():
        frame[states.index(body)] = weight.si
    return CylinderPlant(
        axis=axis,
        states=states,
        matrix=matrix,
        level=level,
        force=force,
        stroke=stroke,
        stroke_rate=rate,
        frame=frame,
        flow=flow,
        air=air,
    )


def frame_mode(machine: Machine, axis: str) -> tuple[float, float]:
    """Return undamped frequency, Hz, and damping ratio of the slowest mode under the cylinder.

    Its piston slides freely, as while it moves.

    Raises
    ------
    MachineError
        If nothing rings.
    """
    piece = network_of(machine, axis)
    poles = np.linalg.eigvals(piece.base[0][:, : len(piece.states)])
    ringing = [p for p in poles if p.imag > 1e-6]
    if not ringing:
        raise MachineError(f"cylinders.{axis}: nothing under it rings, so there is no mode")
    slowest = min(ringing, key=abs)
    return abs(slowest) / (2.0 * math.pi), float(-slowest.real / abs(slowest))


@dataclass(frozen=True, slots=True)
class StepRinging:
    """What a step of one level leaves ringing in the frame.

    Parameters
    ----------
    pole
        1/s, of the frame's slowest mode, imaginary part positive.
    amplitude_m
        Complex amplitude of the frame at the step, per level: behind it the frame moves as
        ``Re(amplitude exp(pole t))`` about its rest.
    """

    pole: complex
    amplitude_m: complex


def step_ringing(machine: Machine, axis: str) -> StepRinging:
    """Return what one step of the level leaves, by the eigenvectors of the sliding cylinder.

    Delay is left out: it shifts every step alike.

    Raises
    ------
    MachineError
        If nothing rings.
    """
    cylinder, plant = machine.cylinders[axis], cylinder_plant(machine, axis)
    force = plant.air_force(cylinder.air_stiffness.si, cylinder.air_damping.si)
    matrix = plant.matrix + np.outer(plant.force, force)
    poles, modes = np.linalg.eig(matrix)
    wanted = 2.0 * math.pi * frame_mode(machine, axis)[0]
    # The air spring shifts the mode a little; the nearest pole is it.
    ringing = np.flatnonzero(poles.imag > 1e-6)
    index = int(ringing[np.argmin(np.abs(np.abs(poles[ringing]) - wanted))])
    # x = sum over modes; a step's share is (left vector . b) / pole. The zero poles of a free
    # stroke make the matrix defective, which leaves this simple pole's own vectors exact.
    left_poles, left = np.linalg.eig(matrix.T)
    match = left[:, int(np.argmin(np.abs(left_poles - poles[index])))]
    share = (match @ plant.level) / (match @ modes[:, index]) / poles[index]
    return StepRinging(
        complex(poles[index]), complex(2.0 * share * (plant.frame @ modes[:, index]))
    )


def flow_mode(machine: Machine, axis: str) -> tuple[float, float]:
    """Return undamped frequency, Hz, and damping ratio of the mode that the valves excite.

    The air carries the piston's mass along: the frame rings slower than under a free piston.

    Raises
    ------
    MachineError
        If nothing rings.
    """
    pole = step_ringing(machine, axis).pole
    return abs(pole) / (2.0 * math.pi), -pole.real / abs(pole)
