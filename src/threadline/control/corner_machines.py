"""What machines that are not as their file says make of the exact inverse of that file's machine.

The references of feed-forward are the inverse ``1 / T0`` of the machine as its file says, applied
to the intended motion of the load. A machine whose closed loop is ``T`` answers with ``T / T0``.
Dead time, the hold of the references and their grid are the same in both and cancel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from threadline.arrays import FloatArray
from threadline.machine import Machine
from threadline.plant.loop import Loop, axis_loop
from threadline.plant.sampled import sample


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CornerResponse:
    """The load and the motor of one machine, by frequency.

    Parameters
    ----------
    load
        (k,) velocity of the load over the intended one.
    current_s_a_m
        (k,) current of the motor over the intended velocity, A s/m or A s/rad; None without a coil.
    """

    load: NDArray[np.complex128]
    current_s_a_m: NDArray[np.complex128] | None


def corner_responses(
    machine: Machine, axis: str, corners: Sequence[Machine], omega_rad_s: FloatArray
) -> list[CornerResponse]:
    """Return the response of each of ``corners`` to references that are planned for ``machine``.

    Parameters
    ----------
    omega_rad_s
        (k,) frequencies above 0.
    """
    believed, _ = _closed(axis_loop(machine, axis), omega_rad_s)
    found = []
    for corner in corners:
        load, current = _closed(axis_loop(corner, axis), omega_rad_s)
        found.append(
            CornerResponse(
                load=load / believed,
                current_s_a_m=None if current is None else current * (load / believed),
            )
        )
    return found


def _closed(
    loop: Loop, omega: FloatArray
) -> tuple[NDArray[np.complex128], NDArray[np.complex128] | None]:
    """Return the loop from its reference to its load, and the current over the load's velocity."""
    plant = loop.plant
    coil = [k for k, name in enumerate(plant.states) if name.endswith(".i")]
    rows = [f"{loop.axis}.load", loop.sensors[loop.index]]
    seen = plant.select([plant.inputs[loop.index]], rows)
    sampled = sample(seen, loop.period_s).response(omega)[:, :, 0]
    D = loop.filters[loop.index].sampled_response(omega)
    closed = sampled[:, 0] * D / (1.0 + sampled[:, 1] * D)
    if len(coil) != 1:
        return closed, None
    state = np.zeros((1, len(plant.A)))
    state[0, coil[0]] = 1.0
    with_coil = replace(
        seen,
        C=np.vstack([seen.C[:1], state]),
        D=np.zeros((2, 1)),
        outputs=(rows[0], plant.states[coil[0]]),
    ).response(omega)[:, :, 0]
    return closed, with_coil[:, 1] / (1j * omega * with_coil[:, 0])
