"""What rings under a cylinder: the modes of its frame, and what a step of its valves leaves."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from threadline.errors import MachineError
from threadline.machine import Machine
from threadline.plant.boundaries import DOUBLE, size_of, swinging
from threadline.plant.cylinders import cylinder_equations, network_of


def frame_mode(machine: Machine, axis: str) -> tuple[float, float]:
    """Return undamped frequency, Hz, and damping ratio of the slowest mode under the cylinder.

    Its piston slides freely, as while it moves.

    Raises
    ------
    MachineError
        If nothing rings.
    """
    piece = network_of(machine, axis)
    ringing = swinging(piece.base[0][:, : len(piece.states)])
    if not len(ringing):
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
        If nothing rings, or so slowly beside all else that it cannot be told.
    """
    plant = cylinder_equations(machine, axis)
    matrix = plant.sliding()[0]
    poles, modes = np.linalg.eig(matrix)
    wanted = 2.0 * math.pi * frame_mode(machine, axis)[0]
    # A state that no other feeds, as the lag of a valve, has its pole for itself: however fast it
    # is, the others are known as well as without it.
    fed = (matrix - np.diag(np.diag(matrix))).any(axis=1)
    ringing = np.flatnonzero(poles.imag > DOUBLE * size_of(matrix[np.ix_(fed, fed)]))
    if not len(ringing):
        raise MachineError(
            f"cylinders.{axis}: its frame's {wanted / (2.0 * math.pi):.3g} Hz is lost "
            "beside rates of the cylinder that are ten million times as fast",
            place=machine.place,
            remedy="Look for a mistyped number.",
        )
    # The air spring shifts the mode a little; the nearest pole is it.
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
    """Return undamped frequency, Hz, and damping ratio of the mode that the valves excite.

    The air carries the piston's mass along: the frame rings slower than under a free piston.

    Raises
    ------
    MachineError
        If nothing rings.
    """
    pole = step_ringing(machine, axis).pole
    return abs(pole) / (2.0 * math.pi), -pole.real / abs(pole)
