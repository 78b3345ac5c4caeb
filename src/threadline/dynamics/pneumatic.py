"""Equations of a cylinder, and the ringing of the frame under it.

With the stroke ``s = w - z`` (piston less housing), the flow speed ``v`` and the elongation ``e``
of the air between the flow and the piston::

    v' = (speed level(t - delay) - v) / lag
    e' = v - s'
    F  = k e + c (v - s') - friction,   on the piston; -F on the housing

so that a shaper acts on the flow *speed*, from which the force follows. Bodies and links are
those of the network that every other machine has.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from threadline.base.arrays import FloatArray, Recent
from threadline.dynamics.margins import DOUBLE, size_of, swinging
from threadline.dynamics.network import PiecewiseLinear, piecewise_linear
from threadline.dynamics.values import Values
from threadline.errors import MachineError
from threadline.machine import Machine
from threadline.machine.quantity import Quantity


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CylinderEquations:
    """Linear equations of one cylinder and everything that it is connected with.

    Parameters
    ----------
    axis
        Name of the cylinder.
    states
        (n,) names: those of the network, then ``"flow"`` (m/s) and ``"air"`` (m).
    matrix
        (variants, n, n) rates of the states without the force of the air on the bodies.
    level
        (variants, n) part of the rates that a level of 1 adds.
    force
        (variants, n) part of the rates that 1 N on the piston, with its reaction on the housing,
        adds.
    stroke, stroke_rate
        (n,) rows that give ``s`` and ``s'`` from the states.
    frame
        (variants, n) row that gives the position of the frame.
    piston, housing
        Indices of the velocities of the two bodies.
    piston_share
        (variants,) share of the piston in the inertia of both.
    piston_inertia
        (variants,) in kg.
    air_stiffness, air_damping
        (variants,) in N/m and N s/m.
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
        """Return the (variants, n) row of the air's force in N; ``ramp`` multiplies its damping."""
        damping = self.air_damping * ramp
        row = -damping[:, None] * self.stroke_rate
        row[:, self.states.index("air")] += self.air_stiffness
        row[:, self.states.index("flow")] += damping
        return row

    def joined(self, row: FloatArray) -> FloatArray:
        """Return the (variants, n) common acceleration of piston and housing moving as one.

        Parameters
        ----------
        row
            (variants, n, n) rates of all states while the two move independently.
        """
        share = self.piston_share[:, None]
        return share * row[:, self.piston] + (1.0 - share) * row[:, self.housing]

    def sliding(self, ramp: float = 1.0) -> FloatArray:
        """Return the (variants, n, n) rates while the piston slides on its air."""
        return self.matrix + self.force[:, :, None] * self.air_force(ramp)[:, None, :]

    def standing(self) -> FloatArray:
        """Return the (variants, n, n) rates while the piston stands in its housing."""
        rates = self.matrix.copy()
        together = self.joined(self.matrix)
        rates[:, self.piston] = rates[:, self.housing] = together
        return rates

    def holding(self) -> FloatArray:
        """Return the (variants, n) row of the force in N that keeps the piston in its housing.

        It is the piston's inertia times the acceleration by which its motion in common with the
        housing differs from its motion alone. The force of the air is not in it.
        """
        own = self.joined(self.matrix) - self.matrix[:, self.piston]
        return self.piston_inertia[:, None] * own


def network_of(machine: Machine, axis: str, values: Values | None = None) -> PiecewiseLinear:
    """Return the connected piece of the network on which the cylinder ``axis`` acts.

    Raises
    ------
    MachineError
        If the piece has elements that are not linear, or the cylinder joins two pieces.
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
                    remedy="Leave friction, play and preload out of the bodies that it moves.",
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
        Replaced numbers; the machine's own when None.

    Raises
    ------
    MachineError
        If its piece of the network is not linear, or the cylinder joins two pieces.
    """
    used = Values.of(machine) if values is None else values
    cylinder, piece = machine.cylinders[axis], network_of(machine, axis, used)

    def number(path: str, quantity: Quantity | None) -> FloatArray:
        return np.broadcast_to(np.asarray(used.at(path, quantity), dtype=float), (used.count,))

    states = (*piece.states, "flow", "air")
    n, size = len(states), len(piece.states)
    flow, air = size, size + 1
    matrix = np.zeros((used.count, n, n))
    matrix[:, :size, :size] = piece.base[:, :, :size]
    stroke, rate, force = np.zeros(n), np.zeros(n), np.zeros((used.count, n))
    inertia = {}
    for body, sign in ((cylinder.pushes, 1.0), (cylinder.reacts_on, -1.0)):
        stroke[states.index(body)] = sign
        at = states.index(f"{body}'")
        rate[at] = sign
        inertia[body] = number(f"bodies.{body}.inertia", machine.bodies[body].inertia)
        force[:, at] = sign / inertia[body]
    where = f"cylinders.{axis}"
    lag = number(f"{where}.lag", cylinder.lag)
    level = np.zeros((used.count, n))
    level[:, flow] = number(f"{where}.speed", cylinder.speed) / lag
    matrix[:, flow, flow] = -1.0 / lag
    matrix[:, air] -= rate
    matrix[:, air, flow] += 1.0
    frame = np.zeros((used.count, n))
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
        air_stiffness=number(f"{where}.air_stiffness", cylinder.air_stiffness),
        air_damping=number(f"{where}.air_damping", cylinder.air_damping),
    )


def frame_mode(machine: Machine, axis: str) -> tuple[float, float]:
    """Return undamped frequency in Hz and damping ratio of the slowest mode of the network.

    The piston slides freely in it, as while it moves, and the air exerts no force.

    Raises
    ------
    MachineError
        If the network has no mode that rings.
    """
    piece = network_of(machine, axis)
    ringing = swinging(piece.base[0][:, : len(piece.states)])
    if not len(ringing):
        raise MachineError(f"cylinders.{axis}: nothing under it rings, so there is no mode")
    slowest = min(ringing, key=abs)
    return abs(slowest) / (2.0 * math.pi), float(-slowest.real / abs(slowest))


@dataclass(frozen=True, slots=True)
class StepRinging:
    """The ringing of the frame after a step of the valves by one level.

    Parameters
    ----------
    pole
        Pole of the frame's slowest mode in 1/s, imaginary part positive.
    amplitude_m
        Complex amplitude of the frame for a step of 1: from the step on, the mode moves the frame
        by ``Re(amplitude exp(pole t))`` about its rest.
    """

    pole: complex
    amplitude_m: complex


def _alike(one: tuple[Machine, str], other: tuple[Machine, str]) -> bool:
    return one[0] is other[0] and one[1] == other[1]


# Each run that a cycle is judged by asks for those of the machine that it was planned for.
_RECENT: Recent[tuple[Machine, str], StepRinging] = Recent(8, _alike)


def step_ringing(machine: Machine, axis: str) -> StepRinging:
    """Return the ringing after a step of the level, by the eigenvectors of the sliding cylinder.

    The delay of the valves, by which every step is shifted alike, is left out.

    Raises
    ------
    MachineError
        If the network has no mode that rings, or one so slow beside other rates that rounding
        hides it.
    """
    return _RECENT.of((machine, axis), lambda: _step_ringing(machine, axis))


def _step_ringing(machine: Machine, axis: str) -> StepRinging:
    plant = cylinder_equations(machine, axis)
    matrix = plant.sliding()[0]
    poles, modes = np.linalg.eig(matrix)
    wanted = 2.0 * math.pi * frame_mode(machine, axis)[0]
    # The pole of a state that depends on no other, such as the lag of a valve, does not limit how
    # well the other poles are known, however fast it is.
    fed = (matrix - np.diag(np.diag(matrix))).any(axis=1)
    ringing = np.flatnonzero(poles.imag > DOUBLE * size_of(matrix[np.ix_(fed, fed)]))
    if not len(ringing):
        raise MachineError(
            f"cylinders.{axis}: its frame's {wanted / (2.0 * math.pi):.3g} Hz is lost "
            "beside rates of the cylinder that are ten million times as fast",
            place=machine.place,
            remedy="Look for a mistyped number.",
        )
    # The air spring shifts the mode a little: the nearest pole is that of the mode.
    index = int(ringing[np.argmin(np.abs(np.abs(poles[ringing]) - wanted))])
    # x = sum over modes; a step's share is (left vector . b) / pole. The zero poles of a free
    # stroke make the matrix defective, which leaves this simple pole's own vectors exact.
    left_poles, left = np.linalg.eig(matrix.T)
    match = left[:, int(np.argmin(np.abs(left_poles - poles[index])))]
    share = (match @ plant.level[0]) / (match @ modes[:, index]) / poles[index]
    return StepRinging(
        complex(poles[index]), complex(2.0 * share * (plant.frame[0] @ modes[:, index]))
    )


def flow_mode(machine: Machine, axis: str) -> tuple[float, float]:
    """Return undamped frequency in Hz and damping ratio of the mode that the valves excite.

    The air couples the piston's mass to the frame, which therefore rings slower than under a free
    piston (``frame_mode``).

    Raises
    ------
    MachineError
        If the network has no mode that rings.
    """
    pole = step_ringing(machine, axis).pole
    return abs(pole) / (2.0 * math.pi), -pole.real / abs(pole)
