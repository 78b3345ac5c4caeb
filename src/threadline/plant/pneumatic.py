"""The ringing of a frame under a cylinder: its modes, and its motion after a step of the valves."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from threadline.errors import MachineError
from threadline.machine import Machine
from threadline.plant.boundaries import DOUBLE, size_of, swinging
from threadline.plant.cylinders import cylinder_equations, network_of
from threadline.recent import Recent


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
